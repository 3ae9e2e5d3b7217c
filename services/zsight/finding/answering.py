"""One find, from a cloud and a goal to the answer as it is sent: used by the finder service and without a network."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import pose_of, vector
from zsight.errors import UsageError
from zsight.finding.verifiers import verified
from zsight_core.points import xyz
from zsight_core.transform import inverse, transform_xyz
from zsight_protocol.find_object import (
    ANY_TYPE,
    DetectedObject,
    FindObjectResult,
    Obstacle,
    ResultCode,
    Status,
    Support,
)
from zsight_protocol.message import Header

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray
    from pydantic import JsonValue

    from zsight.catalogue.type_files import Catalogue
    from zsight_core.find import Answer, Detection
    from zsight_core.points import Points
    from zsight_core.scene import Scene
    from zsight_protocol.geometry import Region
    from zsight_protocol.message import Time

__all__ = ["Extrinsic", "find", "height_in_world", "of_region", "result_of", "with_extrinsic"]

_UPRIGHT = np.cos(np.radians(1))  # beyond this a height along the z of a frame is another one at each place


def height_in_world(
    known_height: float | None,
    frame: str,
    T_frame_camera: NDArray[np.float64],
    T_world_camera: NDArray[np.float64] | None,
) -> float | None:
    """World z of a support surface whose height is known along the z of the frame of the answer, metres.

    Args:
        known_height: metres along the frame's z; None where it is not known, as then is the result.
        frame: name of the frame of the answer.
        T_frame_camera: (4, 4) where the camera is in it.
        T_world_camera: (4, 4) where the camera is in a world with z up; None where no world is known.

    Raises:
        UsageError: no world is known, or the frame's z is not up in it.
    """
    if known_height is None:
        return None
    if T_world_camera is None:
        raise UsageError(
            f"a known height is one above a level: which way is up in {frame} is not known, for no transform leads "
            "from the camera to a world; give the camera its pose, or ask without a known height"
        )
    T_world_frame = T_world_camera @ inverse(T_frame_camera)
    if T_world_frame[2, 2] < _UPRIGHT:
        degrees = np.degrees(np.arccos(np.clip(T_world_frame[2, 2], -1, 1)))
        raise UsageError(
            f"a known height is one along the z of {frame}, which is {degrees:.0f} degrees off the world's: "
            "ask in a frame that stands upright, such as the world's"
        )
    return known_height + float(T_world_frame[2, 3])


def find(
    points: Points,
    catalogue: Catalogue,
    name: str,
    *,
    scene: Scene,
    T_frame_camera: NDArray[np.float64],
    region: Region | None = None,
    maximum: int = 1,
    checkpoint: Callable[[str, float], None],
    on_found: Callable[[Detection], object] = lambda _: None,
) -> Answer:
    """Look for a type of the catalogue, with all its other types as rivals.

    Args:
        points: (H, W) cloud, camera frame, metres.
        catalogue: what there may be.
        name: the type that is wanted, or ANY_TYPE for all of them.
        scene: what the scene stage made of the cloud.
        T_frame_camera: (4, 4) where the camera is in the frame of the answer, to which ``region`` belongs.
        region: only what lies inside.
        maximum: most objects; 0 for all.
        checkpoint: called often; raises Cancelled to stop.
        on_found: called with each detection when it is sure.
    """
    from zsight_core import find as finder

    known = catalogue.models()
    wanted = known if name == ANY_TYPE else [catalogue.model(name)]
    rivals = known if name == ANY_TYPE else [model for model in known if model.name != name]
    answer = finder.find(
        points,
        wanted,
        scene=scene,
        T_world_camera=T_frame_camera,
        region=None if region is None else (region.low, region.high),
        maximum=maximum or None,
        rivals=rivals,
        checkpoint=checkpoint,
        on_found=on_found,
    )
    return verified(answer, points, scene)


def result_of(
    answer: Answer,
    catalogue: Catalogue,
    *,
    scene: Scene,
    T_frame_camera: NDArray[np.float64],
    stamp: Time,
    frame_id: str,
    finder: str = "",
    ids: Sequence[str] = (),
    extrinsic: Extrinsic | None = None,
) -> FindObjectResult:
    """The answer as it is sent: poses in the frame that was asked for, stamped with the cloud's stamp.

    Args:
        answer: what was found.
        catalogue: for the numbers of types.
        scene: what it was found in.
        T_frame_camera: (4, 4) the camera in the frame of the answer.
        stamp: the cloud's.
        frame_id: name of the frame.
        finder: who found it.
        ids: of the objects, in order.
        extrinsic: how well it is known where the camera is in that frame; none where the frame is the camera's own.
    """
    found = answer.status == "found"
    timings = {name: float(value) for name, value in answer.report.get("timings_ms", {}).items()}
    report = {name: _plain(value) for name, value in answer.report.items() if name != "timings_ms"}
    return FindObjectResult(
        header=Header(stamp=stamp, frame_id=frame_id),
        code=ResultCode.FOUND if found else ResultCode.NOT_FOUND,
        status=Status(answer.status),
        finder=finder,
        objects=tuple(
            _object_of(detection, name, catalogue, scene, T_frame_camera, extrinsic)
            for detection, name in zip(answer.detections, ids or [""] * len(answer.detections), strict=True)
        ),
        obstacles=_obstacles_of(answer, scene, T_frame_camera),
        p_absent=_p_absent(answer),
        report=report,
        timings_ms=timings,
    )


def of_region(
    result: FindObjectResult, region: Region | None, points: Points, T_frame_camera: NDArray[np.float64]
) -> FindObjectResult:
    """An answer for a region of its frame: where nothing was found, nor measured, nobody knows what is there.

    Args:
        result: what was answered.
        region: where was looked; None: everywhere.
        points: (H, W) cloud, camera frame, metres.
        T_frame_camera: (4, 4) where the camera is in the frame of the answer.
    """
    if region is None or result.objects:
        return result
    seen = transform_xyz(T_frame_camera, xyz(points).reshape(-1, 3))
    if ((seen >= region.low) & (seen <= region.high)).all(axis=1).any():
        return result
    frame = result.header.frame_id
    words = f"nothing was measured between {region.low} and {region.high} of {frame}: is it in view, and in that frame?"
    return result.model_copy(update={"status": Status.CANNOT_TELL, "message": words, "p_absent": 0.0})


def _p_absent(answer: Answer) -> float:
    """Probability that no object of the type is there."""
    if not answer.detections:
        return float(np.clip(answer.p_absent, 0, 1))
    return float(np.prod([1 - np.clip(detection.score, 0, 1) for detection in answer.detections]))


@dataclass(frozen=True)
class Extrinsic:
    """How well it is known where a camera is: standard deviations along and about each axis, metres and radians.

    What is given if nothing is said is what a careful calibration by hand comes to.
    """

    position: float = 0.002
    rotation: float = 0.001


def with_extrinsic(
    covariance: NDArray[np.float64],
    place: NDArray[np.float64],
    camera: NDArray[np.float64],
    extrinsic: Extrinsic,
) -> NDArray[np.float64]:
    """A covariance (6, 6) of position and rotation, with what the camera's pose adds.

    A camera that is turned by w and moved by t from where it is said to be moves what it sees by t + w x arm.

    Args:
        covariance: in a frame that does not move with the camera.
        place: (3,) of the object in that frame, metres.
        camera: (3,) of the camera, likewise.
        extrinsic: standard deviations.
    """
    x, y, z = place - camera
    from_turn = np.vstack([np.array([[0, z, -y], [-z, 0, x], [y, -x, 0]]), np.eye(3)])
    added: NDArray[np.float64] = covariance + extrinsic.rotation**2 * from_turn @ from_turn.T
    added[:3, :3] += extrinsic.position**2 * np.eye(3)
    return added


def _obstacles_of(answer: Answer, scene: Scene, T_frame_camera: NDArray[np.float64]) -> tuple[Obstacle, ...]:
    """What stands there and is not known: segments, and regions without depth that are no shadows."""
    things = [
        Obstacle(
            pose=pose_of(T_frame_camera @ segment.T_camera_box),
            size=_extents(segment.size),
            label=segment.label,
            points=segment.points,
        )
        for segment in answer.obstacles
    ]
    unseen = [
        Obstacle(pose=pose_of(T_frame_camera @ hole.T_camera_box), size=_extents([*hole.size, 0.0]))
        for hole in scene.holes
        if not hole.is_shadow
    ]
    return (*things, *unseen)


def _extents(size: Sequence[float] | NDArray[np.float64]) -> tuple[float, float, float]:
    length, width, height = (max(float(edge), 0.0) for edge in size)
    return length, width, height


def _object_of(
    detection: Detection,
    name: str,
    catalogue: Catalogue,
    scene: Scene,
    T_frame_camera: NDArray[np.float64],
    extrinsic: Extrinsic | None,
) -> DetectedObject:
    kind = catalogue.types.get(detection.type)
    T_frame_support = T_frame_camera @ scene.supports[detection.support].T_camera_support
    T_frame_model = T_frame_camera @ detection.T_camera_model
    in_frame = _turned(detection.covariance, T_frame_support)
    in_world = in_frame
    if extrinsic is not None:
        in_world = with_extrinsic(in_frame, T_frame_model[:3, 3], T_frame_camera[:3, 3], extrinsic)
    length, width, height = (float(edge) for edge in detection.size)
    return DetectedObject(
        id=name,
        type=detection.type,
        code=kind.code if kind is not None else None,
        score=float(np.clip(detection.score, 0, 1)),
        pose=pose_of(T_frame_model),
        size=(length, width, height),
        covariance=_row_by_row(in_frame),
        covariance_support=_row_by_row(detection.covariance),
        covariance_world=_row_by_row(in_world),
        visible_fraction=float(np.clip(detection.visible_fraction, 0, 1)),
        measured_height=max(float(detection.measured_height), 0.0),
        support=Support(
            point=vector(_foot(detection, T_frame_support, T_frame_camera)), normal=vector(T_frame_support[:3, 2])
        ),
        truncated=detection.truncated,
        occluded=detection.occluded,
        runner_up=detection.runner_up or "",
        equivalent_poses=tuple(pose_of(T_frame_camera @ T) for T in detection.equivalents),
    )


def _row_by_row(covariance: NDArray[np.float64]) -> tuple[float, ...]:
    return tuple(float(value) for value in covariance.ravel())


def _turned(covariance: NDArray[np.float64], T: NDArray[np.float64]) -> NDArray[np.float64]:
    """A covariance (6, 6) of position and rotation, seen from another frame."""
    turn = np.zeros((6, 6))
    turn[:3, :3] = turn[3:, 3:] = T[:3, :3]
    turned: NDArray[np.float64] = turn @ covariance @ turn.T
    return turned


def _foot(
    detection: Detection, T_frame_support: NDArray[np.float64], T_frame_camera: NDArray[np.float64]
) -> NDArray[np.floating]:
    """The point of the support surface below an object."""
    centre = T_frame_camera @ detection.T_camera_model[:, 3]
    on_support = transform_xyz(inverse(T_frame_support), centre[:3])
    return transform_xyz(T_frame_support, np.array([on_support[0], on_support[1], 0.0]))


def _plain(value: object) -> JsonValue:
    """Values that every msgpack library carries."""
    if isinstance(value, dict):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, np.generic | np.ndarray):
        return _plain(value.tolist())
    return value if isinstance(value, str | int | float | bool | None) else str(value)
