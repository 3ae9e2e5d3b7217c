"""After warm_up a request compiles nothing: every kernel has met the types it is called with."""

from __future__ import annotations

import subprocess
import sys

CODE = """
import sys
import numpy as np
from numba.core.dispatcher import Dispatcher
from tests.core import book_scene as book
from zsight_core import find as finder
from zsight_core.model import Mesh, ObjectModel, Sphere
from zsight_core.points import from_xyz, xyz
from zsight_core.simulation import camera
from zsight_core.simulation.kinect import Kinect
from zsight_core.solid import solid_of

def signatures():
    modules = [m for name, m in sys.modules.items() if name.startswith("zsight_core.") and "simulation" not in name]
    kernels = {id(k): k for m in modules for k in vars(m).values() if isinstance(k, Dispatcher)}
    return {k.py_func.__qualname__ + " of " + k.py_func.__module__: len(k.signatures) for k in kernels.values()}

points = book.cloud((book.TOY_BLOCK, book.T_WORLD_BLOCK), (book.COKE_CAN, book.at(0.7, -0.1, 0.8357)), noise=Kinect())
cube = solid_of(book.TOY_BLOCK.shape)
mesh = ObjectModel("mesh", Mesh(cube.vertices, cube.faces))
models = [book.TOY_BLOCK, book.COKE_CAN, ObjectModel("ball", Sphere(0.07)), mesh, book.TABLE]
flat = xyz(points).reshape(-1, 3)
loose = from_xyz(flat[np.isfinite(flat).all(axis=1)])
finder.warm_up()
before = signatures()
finder.find(points, models[:1], T_world_camera=book.T_WORLD_CAMERA, rivals=models)
print("scipy.spatial" in sys.modules)
finder.find(points, models, T_world_camera=book.T_WORLD_CAMERA, rivals=models)
points.flags.writeable = False
finder.find(points, models[:1])
finder.find(loose, models, T_world_camera=book.T_WORLD_CAMERA)
after = signatures()
print({name: count for name, count in after.items() if count > before.get(name, 0)})
"""


def test_no_kernel_is_compiled_within_a_request_and_a_box_waits_for_no_import() -> None:
    answer = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, check=True, timeout=110)
    assert answer.stdout.strip() == "False\n{}"
