"""Finding in a file, in this process and without a network."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np

from zsight import cloud_input
from zsight.catalogue import type_files
from zsight.catalogue.type_files import require_type_name
from zsight.errors import DeadlinePassed, UsageError
from zsight.finding import answering
from zsight_core import scene as scene_core
from zsight_core.errors import Cancelled
from zsight_protocol.message import Header, Time

if TYPE_CHECKING:
    from pathlib import Path

    from zsight_protocol.find_object import FindObjectResult
    from zsight_protocol.geometry import Region
    from zsight_protocol.object_type import ObjectType, Taught, Teaching

__all__ = ["find_in_file", "teach_from_file"]


def find_in_file(
    path: Path,
    object_type: str,
    *,
    intrinsics: Path | None = None,
    pose: str = "",
    catalogue: Path | None = None,
    known_height: float | None = None,
    region: Region | None = None,
    maximum: int = 1,
    timeout: float = 10.0,
    picture: Path | None = None,
) -> FindObjectResult:
    """What a finder would answer on the cloud in a file.

    Args:
        path: the cloud, see zsight.cloud_input.
        object_type: catalogue name, or the book's number as text.
        intrinsics: camera file of an image pair.
        pose: "x y z qx qy qz qw" of the camera in the world, or "viewpoint" for the one in the file; empty: the answer
            is in the camera's frame, and the support surface is found without knowing which way is up.
        catalogue: folder of further object types.
        known_height: height of the support surface in the world, metres; needs a pose.
        region: only what lies inside, in the frame of the answer.
        maximum: most objects; 0 for all.
        timeout: seconds for the search, without reading the file.
        picture: PNG file to draw the answer into.

    Raises:
        UsageError: the type or the pose makes no sense.
        CoreError: the cloud cannot be read or searched.
        DeadlinePassed: the time was over first.
    """
    folders = [type_files.shipped_folder(), *([catalogue] if catalogue is not None else [])]
    types = type_files.load(*folders)
    name = types.wanted(object_type)
    cloud = cloud_input.read(path, intrinsics)
    points = cloud.points
    T_world_camera = cloud_input.camera_pose(pose, cloud)
    if known_height is not None and T_world_camera is None:
        raise UsageError("a known height is a height in the world: give the camera's pose in it as well")
    T_frame_camera = np.eye(4) if T_world_camera is None else T_world_camera
    frame = "camera" if T_world_camera is None else "world"
    deadline = time.monotonic() + timeout

    def checkpoint(stage: str, fraction: float) -> None:
        del fraction
        if time.monotonic() > deadline:
            raise Cancelled(stage)

    try:
        scene = scene_core.understand(
            points, T_world_camera=T_world_camera, known_height=known_height, checkpoint=checkpoint
        )
        answer = answering.find(
            points,
            types,
            name,
            scene=scene,
            T_frame_camera=T_frame_camera,
            region=region,
            maximum=maximum,
            checkpoint=checkpoint,
        )
    except Cancelled as stopped:
        raise DeadlinePassed(f"no answer within {timeout:g} s: stopped at stage {stopped}") from None
    stamp = Time.from_ns(path.stat().st_mtime_ns)
    result = answering.result_of(
        answer,
        types,
        scene=scene,
        T_frame_camera=T_frame_camera,
        stamp=stamp,
        frame_id=frame,
        finder="in-process",
        extrinsic=None if T_world_camera is None else answering.Extrinsic(),
    )
    result = answering.of_region(result, region, points, T_frame_camera)
    if picture is not None:
        from zsight.pictures import draw_answer

        draw_answer(picture, points, result, types, T_frame_camera)
    return result


def teach_from_file(
    path: Path, name: str, asked: Teaching, *, intrinsics: Path | None = None, pose: str = ""
) -> tuple[ObjectType, Taught]:
    """The type of a thing in the cloud of a file; see zsight.catalogue.teaching.teach for the errors besides.

    Args:
        path: the cloud, see zsight.cloud_input.
        name: of the new type.
        asked: which thing; its place is in the world where the pose is given, else in the camera's frame.
        intrinsics: camera file of an image pair.
        pose: of the camera in the world, as for find_in_file.

    Raises:
        UsageError: the pose makes no sense, or no type can have this name.
        CoreError: the cloud cannot be read.
    """
    from zsight.catalogue.teaching import teach

    require_type_name(name)
    cloud = cloud_input.read(path, intrinsics)
    T_world_camera = cloud_input.camera_pose(pose, cloud)
    scene = scene_core.understand(cloud.points, T_world_camera=T_world_camera)
    header = Header(
        stamp=Time.from_ns(path.stat().st_mtime_ns), frame_id="camera" if T_world_camera is None else "world"
    )
    return teach(name, asked, cloud.points, scene, header, np.eye(4) if T_world_camera is None else T_world_camera)
