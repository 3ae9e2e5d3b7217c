"""Where a camera service gets its clouds: a simulated scene, the book's ellipse, files, RGB-D images."""

from __future__ import annotations

import contextlib
import functools
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zsight import scene_file
from zsight.catalogue import type_files
from zsight.convert import matrix_of, stamped
from zsight.errors import UsageError
from zsight_core import transform
from zsight_core.errors import CoreError, FileError
from zsight_core.files import cloud_file, depth_camera, rgbd
from zsight_core.points import is_organised
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Header, Time

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from zsight_core.files.cloud_file import LoadedCloud
    from zsight_core.files.pcd_header import Viewpoint
    from zsight_core.pinhole import Pinhole
    from zsight_core.points import Points

__all__ = ["Source", "camera_info", "open_source", "placed", "pose_matrix", "viewpoint_matrix", "viewpoint_of"]

_CLOUDS = (".pcd", ".ply")
_AS_KNOWN = ("", "viewpoint")
_LARGEST_RESIDUAL = 0.5  # pixels; a cloud that fits a pinhole worse was not measured by one


@dataclass(frozen=True)
class Source:
    """A stream of clouds and what is known of the camera that measures it.

    ``clouds`` starts the stream: an iterator that ends with the last cloud, or never. It raises FileError in the place
    of a file that cannot be read, and goes on behind it.
    """

    frame_id: str
    rate: float
    clouds: Callable[[], Iterator[Points]]
    transforms: TransformList | None = None
    camera_info: CameraInfo | None = None


def open_source(
    name: str, *, frame: str, pose: str = "", world_frame: str = "world", seed: int | None = None
) -> Source:
    """The source with this name.

    Args:
        name: ``ellipse``; a scene's name or .yaml file; a .pcd or .ply file; a folder of such files, or of RGB-D pairs;
            a recording (.mcap, .bag, the folder of a ROS 2 bag), perhaps with ``#`` and a key without namespace.
        frame: frame of clouds from files.
        pose: "x y z qx qy qz qw" of that frame in the world, where it is known, or "viewpoint": the one in the first
            .pcd file.
        world_frame: name of the world's frame for such a pose.
        seed: of a scene's noise, in place of the one in its file.

    Raises:
        UsageError: there is no such source.
    """
    path = Path(name).expanduser()
    if name == "ellipse":
        return Source(frame, 1.0, _ellipses, _pose(pose, frame, world_frame))
    recording, _, key = name.partition("#")
    if Path(recording).suffix.lower() in (".mcap", ".bag") or _is_bag_folder(Path(recording).expanduser()):
        return _recording(Path(recording).expanduser(), key, _pose(pose, frame, world_frame))
    files = cloud_file.list_clouds(path) if path.is_dir() else [path] if path.suffix.lower() in _CLOUDS else []
    if files:
        first = _first_readable(files)
        return _files(files, first, frame, _pose(pose, frame, world_frame, first.viewpoint))
    if path.is_dir():
        return _pairs(path, frame, _pose(pose, frame, world_frame))
    scene = _scene(name, seed)
    return replace(scene, transforms=placed(scene, pose, world_frame))


def placed(source: Source, pose: str, world_frame: str) -> TransformList | None:
    """The transforms of a source whose camera stands somewhere else.

    Args:
        source: as it was opened.
        pose: "x y z qx qy qz qw" of the clouds' frame in the world; empty or "viewpoint": where the source says.
        world_frame: name of the world's frame, where the source does not know it.

    Raises:
        UsageError: the pose is not that.
    """
    if pose in _AS_KNOWN:
        return source.transforms
    T_world_camera = pose_matrix(pose)
    if source.transforms is None:
        return TransformList(transforms=(stamped(T_world_camera, world_frame, source.frame_id, Time.now()),))
    first, *rest = source.transforms.transforms
    T_first_camera = functools.reduce(np.matmul, [matrix_of(step.transform) for step in rest], np.eye(4))
    T_world_first = T_world_camera @ transform.inverse(T_first_camera)
    moved = stamped(T_world_first, first.header.frame_id, first.child_frame_id, Time.now())
    return TransformList(transforms=(moved, *rest))


def _is_bag_folder(path: Path) -> bool:
    return (path / "metadata.yaml").is_file() or (path.is_dir() and any(path.glob("*.mcap")))


def _recording(path: Path, key: str, transforms: TransformList | None) -> Source:
    """The clouds of a recording in their own frame; a pose that is given counts more than the recorded transforms."""
    from zsight.recording.recorded_source import RecordedClouds

    found = RecordedClouds.open(path, key)
    return Source(found.frame_id, found.rate, found.clouds, transforms or found.transforms, found.camera_info)


def _pose(pose: str, frame: str, world_frame: str, viewpoint: Viewpoint | None = None) -> TransformList | None:
    if not pose:
        return None
    T_world_frame = viewpoint_matrix(viewpoint) if pose == "viewpoint" and viewpoint else pose_matrix(pose)
    return TransformList(transforms=(stamped(T_world_frame, world_frame, frame, Time.now()),))


def viewpoint_matrix(viewpoint: Viewpoint) -> NDArray[np.float64]:
    """T_world_camera (4, 4) of a PCD file's viewpoint x y z qw qx qy qz."""
    x, y, z, qw, qx, qy, qz = viewpoint
    return transform.from_quaternion((x, y, z), (qx, qy, qz, qw))


def viewpoint_of(T_world_camera: NDArray[np.float64]) -> Viewpoint:
    """A PCD file's viewpoint x y z qw qx qy qz of a pose (4, 4)."""
    x, y, z = map(float, T_world_camera[:3, 3])
    qx, qy, qz, qw = map(float, transform.quaternion(T_world_camera))
    return x, y, z, qw, qx, qy, qz


def pose_matrix(text: str) -> NDArray[np.float64]:
    """T (4, 4) of "x y z qx qy qz qw".

    Raises:
        UsageError: the text is not that.
    """
    try:
        numbers = [float(part) for part in text.replace(",", " ").split()]
        if len(numbers) != 7:
            raise ValueError(f"{len(numbers)} numbers")
        if not all(map(math.isfinite, numbers)):
            raise ValueError("not all finite")
        return transform.from_quaternion(numbers[:3], numbers[3:])
    except (ValueError, CoreError) as error:
        raise UsageError(f"the pose is {text!r} ({error}); expected seven numbers: x y z qx qy qz qw") from None


def _ellipses() -> Iterator[Points]:
    from zsight_core.ellipse import ellipse

    while True:
        yield ellipse()


def _scene(name: str, seed: int | None) -> Source:
    file = scene_file.read(scene_file.find_scene(name))
    scene = scene_file.build(file, type_files.load(type_files.shipped_folder()))
    stamp = Time.now()
    chain = tuple(stamped(step.T_parent_child, step.parent, step.frame, stamp) for step in file.camera.chain)
    info = camera_info(scene.camera.pinhole, file.camera.frame)
    first = file.noise.seed if seed is None else seed
    return Source(
        file.camera.frame, file.camera.rate, lambda: _captures(scene, first), TransformList(transforms=chain), info
    )


def _captures(scene: scene_file.Scene, seed: int) -> Iterator[Points]:
    """The scene stands still: it is rendered once, and every cloud has noise of its own."""
    from zsight_core.simulation.camera import expose
    from zsight_core.simulation.raycast import render

    view = render(scene.world, scene.camera)
    points = expose(view, scene.camera.pinhole, scene.noise, seed)
    while True:
        yield points
        if scene.noise is not None:
            seed += 1
            points = expose(view, scene.camera.pinhole, scene.noise, seed)


def _pairs(folder: Path, frame: str, transforms: TransformList | None) -> Source:
    pairs = rgbd.list_pairs(folder)
    if not pairs:
        expected = "expected .pcd or .ply files, or pairs NAME-color.png and NAME-depth.png"
        raise UsageError(f"folder {folder} holds nothing to publish; {expected}")
    camera = depth_camera.find(folder)
    if camera is None:
        raise UsageError(f"folder {folder} has image pairs but no camera.toml or camera.json with their intrinsics")
    info = camera_info(camera.pinhole, frame)

    def read(pair: rgbd.RgbdPair) -> Points:
        return rgbd.read(pair.colour, pair.depth, camera)

    return Source(frame, 1.0, lambda: map(read, pairs), transforms, info)


def _first_readable(files: list[Path]) -> LoadedCloud:
    """The first cloud of some files; the others are told of when their turn comes."""
    for file in files[:-1]:
        with contextlib.suppress(FileError):
            return cloud_file.read(file)
    return cloud_file.read(files[-1])


def _files(files: list[Path], first: LoadedCloud, frame: str, transforms: TransformList | None) -> Source:
    info = _fitted_info(first.points, frame)
    one = [_in_bytes(first.points)] if len(files) == 1 else []  # which is not read again thirty times a second
    return Source(frame, 1.0, lambda: iter(one) if one else map(_read_file, files), transforms, info)


def _in_bytes(points: Points) -> Points:
    """The same points in bytes of their own, which are sent faster than a view of an array."""
    if not points.flags.c_contiguous:
        return points
    copied: Points = np.frombuffer(points.tobytes(), points.dtype)
    return copied.reshape(points.shape)


def _read_file(path: Path) -> Points:
    return cloud_file.read(path).points


def _fitted_info(points: Points, frame: str) -> CameraInfo | None:
    """Intrinsics behind an organised cloud, where it fits a pinhole."""
    from zsight_core import pinhole

    if not is_organised(points):
        return None
    try:
        fit = pinhole.fit(points)
    except CoreError:
        return None
    return camera_info(fit.pinhole, frame) if fit.residual <= _LARGEST_RESIDUAL else None


def camera_info(pinhole: Pinhole, frame: str) -> CameraInfo:
    """The message of a pinhole camera without distortion."""
    fx, fy, cx, cy = pinhole.fx, pinhole.fy, pinhole.cx, pinhole.cy
    return CameraInfo(
        header=Header(stamp=Time.now(), frame_id=frame),
        height=pinhole.height,
        width=pinhole.width,
        d=(0.0, 0.0, 0.0, 0.0, 0.0),
        k=(fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0),
        r=(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0),
        p=(fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0),
    )
