"""The main job on one machine: every process of a cell, the table and the toy block found, the errors told."""

from __future__ import annotations

import socket
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight import scene_file
from zsight.bus import Bus
from zsight.bus.zenoh_link import open_link
from zsight.catalogue import type_files
from zsight.client import CellClient
from zsight.convert import matrix_of, points_of
from zsight.errors import ZsightError
from zsight.hosts.cell_file import ProcessEntry
from zsight.hosts.supervisor import Supervisor
from zsight.network import Network
from zsight_core.transform import angle_between, from_rpy, inverse
from zsight_protocol.channels import Cell
from zsight_protocol.find_object import Capture
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from zsight_protocol.find_object import FindObjectResult

__all__ = ["Demonstration", "demonstrate"]

_BLOCK, _TABLE, _CAMERA = "toy_block", "table_surface", "kinect"


@dataclass(frozen=True)
class Demonstration:
    """What came out, as ``demo --json`` prints it."""

    report: dict[str, Any]

    @property
    def found(self) -> bool:
        """Whether the block was found."""
        return bool(self.report["found"])


def demonstrate(
    *, scene: str = "book", seed: int | None = None, picture: Path | None = None, say: Callable[[str], None]
) -> Demonstration:
    """Start router, camera, voxel, planes and finder as processes, ask for the table and the block, stop them all.

    Args:
        scene: the simulated scene: a name or a .yaml file.
        seed: of its noise, in place of the scene's own.
        picture: PNG file of the answer; left out: one in the temporary folder.
        say: told what happens, one line a step.

    Raises:
        ZsightError: a process does not come up or does not answer.
    """
    file = scene_file.read(scene_file.find_scene(scene))
    camera: dict[str, Any] = {"camera": _CAMERA, "source": scene, **({} if seed is None else {"seed": seed})}
    table = tuple(
        ProcessEntry(name, name, camera if name == "camera" else {})
        for name in ("router", "camera", "voxel", "planes", "finder")
    )
    network = Network(namespace="demo").on(f"tcp/127.0.0.1:{_free_port()}")
    say("starting router, camera, voxel, planes and finder")
    with Supervisor(table, network, say=say, echo=False) as supervisor:
        supervisor.wait_ready(60.0)
        processes = [{"name": child.entry.name, "pid": child.pid} for child in supervisor.children]
        say("up: " + ", ".join(f"{process['name']} ({process['pid']})" for process in processes))
        with CellClient(Bus(open_link(network), Cell(network.namespace))) as cell:
            report = _ask(cell, file, picture, say)
    say("all stopped")
    return Demonstration({**report, "processes": processes})


def _ask(
    cell: CellClient, file: scene_file.SceneFile, picture: Path | None, say: Callable[[str], None]
) -> dict[str, Any]:
    clouds = cell.bus.reader(cell.bus.cell.points(_CAMERA), PointCloud2)
    table = cell.find(_TABLE, capture=Capture.NEW)
    block = cell.find(_BLOCK)
    cloud = clouds.take(2.0)
    if cloud is None:
        raise ZsightError("the camera sends no clouds")
    report = _report(table, block, file, say)
    path = picture or Path(tempfile.gettempdir()) / "zsight_demo.png"
    _draw(path, points_of(cloud.message), block, file, report)
    say(f"picture: {path}")
    return {**report, "picture": str(path)}


def _report(
    table: FindObjectResult, block: FindObjectResult, file: scene_file.SceneFile, say: Callable[[str], None]
) -> dict[str, Any]:
    height = table.objects[0].pose.position.z if table.objects else None
    say(f"table: {'not found' if height is None else f'{height:.4f} m above the ground'}")
    true_poses = [entry.T_world_model for entry in file.objects if entry.type == _BLOCK]
    report: dict[str, Any] = {
        "found": bool(block.objects),
        "status": block.status.value,
        "position": None,
        "orientation": None,
        "truth": None,
        "error_mm": None,
        "error_deg": None,
        "table_height": height,
        "p_absent": block.p_absent,
        "timings_ms": block.timings_ms,
    }
    if true_poses:
        report["truth"] = _pose_json(true_poses[0])
        say(f"block is at  {_words(true_poses[0])}")
    if not block.objects:
        say(f"block: {block.status.value} {block.message}")
        return report
    T_found = matrix_of(block.objects[0].pose)
    report |= _pose_json(T_found)
    say(f"found it at  {_words(T_found)}")
    if true_poses:
        report["error_mm"], report["error_deg"] = min(_errors(T_found, T_true) for T_true in true_poses)
        say(f"error: {report['error_mm']:.3f} mm, {report['error_deg']:.3f} degrees")
    return report


def _errors(T_found: NDArray[np.float64], T_true: NDArray[np.float64]) -> tuple[float, float]:
    """Millimetres and degrees between two poses of the block, whose symmetries do not count as errors.

    It looks the same after half a turn about any of its axes, and after a quarter about its long one, y.
    """
    error = 1e3 * float(np.linalg.norm(T_found[:3, 3] - T_true[:3, 3]))
    quarter_turns = [from_rpy((0, 0, 0), (0, k * np.pi / 2, 0)) for k in range(4)]
    flips = (np.eye(4), from_rpy((0, 0, 0), (0, 0, np.pi)))
    angle = min(angle_between(T_found, T_true @ flip @ turn) for flip in flips for turn in quarter_turns)
    return error, float(np.degrees(angle))


def _pose_json(T: NDArray[np.float64]) -> dict[str, list[float]]:
    from zsight_core.transform import quaternion

    return {"position": T[:3, 3].tolist(), "orientation": quaternion(T).tolist()}


def _words(T: NDArray[np.float64]) -> str:
    x, y, z = T[:3, 3]
    yaw = np.arctan2(-T[0, 1], T[1, 1])
    return f"({x:.4f}, {y:.4f}, {z:.4f}) m, yaw {np.mod(yaw + np.pi / 2, np.pi) - np.pi / 2:.4f} rad"


def _draw(path: Path, points: Any, block: FindObjectResult, file: scene_file.SceneFile, report: dict[str, Any]) -> None:
    from zsight.pictures import draw_answer

    types = type_files.load(type_files.shipped_folder())
    scene = scene_file.build(file, types)
    T_world_camera = scene.camera.T_world_camera
    lines = [f"table\t{report['table_height']:.4f} m"] if report["table_height"] is not None else []
    if report["position"] is not None:
        lines.append(f"found\t{_words(matrix_of(block.objects[0].pose))}")
    if report["truth"] is not None:
        lines.append(f"true\t{_words(scene.truth(_BLOCK)[0])}")
    if report["error_mm"] is not None:
        lines.append(f"error\t{report['error_mm']:.3f} mm, {report['error_deg']:.3f} degrees")
    draw_answer(
        path, points, block, types, T_world_camera, title=f"zsight find {_BLOCK}", lines=tuple(lines),
        eye=_eye(inverse(T_world_camera), block),
    )  # fmt: skip


def _eye(T_camera_world: NDArray[np.float64], block: FindObjectResult) -> Any:
    """From the front and somewhat above the block, or from the camera where there is none."""
    from zsight_core.picture import eye_around

    if not block.objects:
        return None
    place = block.objects[0].pose.position
    target = T_camera_world @ np.array([place.x, place.y, place.z, 1.0])
    return eye_around(target[:3], T_camera_world[:3, 2], distance=1.6, azimuth=0.35, elevation=0.75)


def _free_port() -> int:
    """A port that nobody listens on now; the router that takes it says so if somebody was faster."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
