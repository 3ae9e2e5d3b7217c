"""Clouds of a recording as files: PCD, PLY, pairs of colour and depth images, or MCAP with plain PointCloud2 alone."""

from __future__ import annotations

from collections import Counter
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from zsight.convert import points_of
from zsight.errors import UsageError
from zsight.recording.opening import open_recording
from zsight.recording.recording_file import RecordingFile
from zsight_core import depth_image, pinhole
from zsight_core.errors import CoreError
from zsight_core.files import depth_camera, pcd, ply
from zsight_core.points import colours, has_colour, is_organised
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.errors import ProtocolError
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.recording.played import Line, Played, Recorded
    from zsight_core.pinhole import Pinhole
    from zsight_core.points import Points

__all__ = ["KINDS", "export"]

KINDS = ("pcd", "ply", "rgbd", "mcap")

_DEPTH_SCALE = 0.0001  # metres a unit of an exported depth image: 6.5 m at most
_LARGEST_RESIDUAL = 0.5  # pixels; a cloud that fits a pinhole worse is no depth image's


def export(
    source: Path,
    folder: Path,
    kind: str,
    *,
    key: str = "",
    overwrite: bool = False,
    say: Callable[[float], object] = lambda _: None,
) -> tuple[int, dict[str, int]]:
    """Write every cloud of a recording as a file of its own, named after its key and its stamp.

    Args:
        source: a recording.
        folder: made if it is not there; for mcap, the new file.
        kind: pcd, ply, rgbd (pairs NAME-color.png and NAME-depth.png with camera.toml), or mcap: everything in one
            file, depth-coded clouds as plain ones.
        key: only clouds on this key, without namespace.
        overwrite: clouds that are there; an MCAP file is never overwritten.
        say: told the share of it that is done, 0 to 1.

    Returns:
        Clouds that were written; by key, those that could not.

    Raises:
        UsageError: the source cannot be read or is damaged, there are no such clouds, or a file is there already.
    """
    if kind not in KINDS:
        raise UsageError(f"clouds are to become {kind!r}; expected one of {', '.join(KINDS)}")
    recording = open_recording(source)
    try:
        lines = [line for line in recording.lines if _wanted(line, kind, key)]
        if not lines:
            known = ", ".join(sorted({line.key for line in recording.lines if line.kind is PointCloud2})) or "none"
            raise UsageError(f"{source} holds no clouds{f' on {key}' if key else ''}; keys with clouds: {known}")
        if kind == "mcap":
            return _as_mcap(recording, lines, folder)
        folder.mkdir(parents=True, exist_ok=True)
        return _as_files(recording, lines, folder, kind, say, overwrite=overwrite)
    finally:
        recording.close()


def _wanted(line: Line, kind: str, key: str) -> bool:
    return (not key or line.key == key) and (kind == "mcap" or line.kind is PointCloud2)


def _as_mcap(recording: Recorded, lines: list[Line], target: Path) -> tuple[int, dict[str, int]]:
    from zsight.recording.conversion import as_sample

    file, sent, left, count = RecordingFile(target, "zsight", {}), Counter[int](), Counter[str](), 0
    try:
        for played in recording.messages(recording.start_ns, None, lines):
            sent[played.line.number] += 1
            try:
                sample = as_sample(played, "zsight", sent[played.line.number])
            except ProtocolError:
                left[played.line.key] += 1
                continue
            count += 1
            if file.write(sample):
                file.mcap.close_chunk(recording.compression)
        file.finish(recording.compression, whole=True)
    except BaseException:
        target.unlink(missing_ok=True)
        raise
    return count, dict(left)


def _as_files(
    recording: Recorded,
    lines: list[Line],
    folder: Path,
    kind: str,
    say: Callable[[float], object],
    *,
    overwrite: bool,
) -> tuple[int, dict[str, int]]:
    write, ending = _WRITERS[kind]
    span, made, left = max(recording.end_ns - recording.start_ns, 1), set[str](), Counter[str]()
    for played in recording.messages(recording.start_ns, None, lines):
        say((played.log_time - recording.start_ns) / span)
        try:
            cloud = played.load()
            if isinstance(cloud, PointCloud2):
                name = f"{played.line.key.replace('/', '_')}_{cloud.header.stamp.ns}"
                if name in made:
                    left[f"{played.line.key}: there is a cloud of the same stamp before it"] += 1
                    continue
                file = folder / f"{name}{ending}"
                if file.exists() and not overwrite:
                    raise UsageError(f"{file} is there already: choose another folder, or overwrite with --force")
                write(folder, name, points_of(cloud), partial(_calibration, recording, played))
                made.add(name)
        except (ProtocolError, CoreError) as error:
            left[f"{played.line.key}: {error}"] += 1
    return len(made), dict(left)


def _write_pcd(folder: Path, name: str, points: Points, _: Any) -> None:
    pcd.write(folder / f"{name}.pcd", points, overwrite=True)


def _write_ply(folder: Path, name: str, points: Points, _: Any) -> None:
    ply.write(folder / f"{name}.ply", points, overwrite=True)


def _write_rgbd(folder: Path, name: str, points: Points, calibration: Callable[[], Pinhole | None]) -> None:
    from PIL import Image

    camera = calibration() or _known(folder) or _fitted(points)
    if points.shape != (camera.height, camera.width):
        raise UsageError(
            f"a cloud of {points.shape} does not fit {camera}: choose another folder, or one key with --key"
        )
    depth = depth_image.from_points(points, camera, depth_scale=_DEPTH_SCALE)
    _write_camera(folder / "camera.toml", camera)
    colour = colours(points) if has_colour(points) else np.zeros((*points.shape, 3), np.uint8)
    Image.fromarray(depth).save(folder / f"{name}-depth.png")
    Image.fromarray(colour).save(folder / f"{name}-color.png")


_WRITERS = {"pcd": (_write_pcd, ".pcd"), "ply": (_write_ply, ".ply"), "rgbd": (_write_rgbd, "-depth.png")}


def _known(folder: Path) -> Pinhole | None:
    """The camera that the folder has already: of clouds without calibration the first decides."""
    found = depth_camera.find(folder)
    return None if found is None else found.pinhole


def _fitted(points: Points) -> Pinhole:
    """The camera behind an organised cloud.

    Raises:
        UsageError: there is none.
    """
    if is_organised(points):
        fit = pinhole.fit(points)
        if fit.holds(_LARGEST_RESIDUAL) and fit.signs == (1, 1, 1):
            return fit.pinhole
    raise UsageError("the cloud is no depth image's, or not in its camera's frame: export it as pcd or ply")


def _calibration(recording: Recorded, cloud: Played) -> Pinhole | None:
    """The pinhole of the cloud's camera, where it was recorded and has no distortion."""
    camera = cloud.line.key.partition("/")[0]
    infos = [line for line in recording.lines if line.key == f"{camera}/camera_info"]
    found = recording.last_before(cloud.log_time + 1, infos) if infos else None
    info = None if found is None else found.load()
    if not isinstance(info, CameraInfo) or not info.k[0] or any(info.d):
        return None
    return pinhole.Pinhole(info.width, info.height, info.k[0], info.k[4], info.k[2], info.k[5])


def _write_camera(path: Path, camera: Pinhole) -> None:
    numbers = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy, "depth_scale": _DEPTH_SCALE}
    lines = [f"width = {camera.width}", f"height = {camera.height}"]
    text = "\n".join([*lines, *(f"{name} = {float(value)!r}" for name, value in numbers.items())]) + "\n"
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise UsageError(f"{path} is of another camera: choose another folder, or one key with --key")
    path.write_text(text, encoding="utf-8")
