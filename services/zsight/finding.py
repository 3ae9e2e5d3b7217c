"""One find, from a cloud and a goal to the answer as it is sent: used by the finder service and without a network."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from zsight.convert import pose_of, vector
from zsight_core.transform import inverse, transform_xyz
from zsight_protocol.find_object import DetectedObject, FindObjectResult, ResultCode, Status, Support
from zsight_protocol.message import Header

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray
    from pydantic import JsonValue

    from zsight.object_catalogue import Catalogue
    from zsight_core.find import Answer, Detection
    from zsight_core.points import Points
    from zsight_core.scene import Scene
    from zsight_protocol.geometry import Region
    from zsight_protocol.message import Time

__all__ = ["find", "result_of"]


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
) -> Answer:
    """Look for a type of the catalogue, with all its other types as rivals.

    Args:
        points: (H, W) cloud, camera frame, metres.
        catalogue: what there may be.
        name: the type that is wanted.
        scene: what the scene stage made of the cloud.
        T_frame_camera: (4, 4) where the camera is in the frame of the answer, to which ``region`` belongs.
        region: only what lies inside.
        maximum: most objects; 0 for all.
        checkpoint: called often; raises Cancelled to stop.
    """
    from zsight_core import find as finder

    wanted = catalogue.model(name)
    rivals = [model for model in catalogue.models() if model.name != name]
    return finder.find(
        points,
        [wanted],
        scene=scene,
        T_world_camera=T_frame_camera,
        region=None if region is None else (region.low, region.high),
        maximum=maximum or None,
        rivals=rivals,
        checkpoint=checkpoint,
    )


def result_of(
    answer: Answer,
    catalogue: Catalogue,
    *,
    scene: Scene,
    T_frame_camera: NDArray[np.float64],
    stamp: Time,
    frame_id: str,
    finder: str = "",
) -> FindObjectResult:
    """The answer as it is sent: poses in the frame that was asked for, stamped with the cloud's stamp."""
    found = answer.status == "found"
    timings = {name: float(value) for name, value in answer.report.get("timings_ms", {}).items()}
    report = {name: _plain(value) for name, value in answer.report.items() if name != "timings_ms"}
    return FindObjectResult(
        header=Header(stamp=stamp, frame_id=frame_id),
        code=ResultCode.FOUND if found else ResultCode.NOT_FOUND,
        status=Status(answer.status),
        finder=finder,
        objects=tuple(_object_of(d, catalogue, scene, T_frame_camera) for d in answer.detections),
        p_absent=_p_absent(answer),
        report=report,
        timings_ms=timings,
    )


def _p_absent(answer: Answer) -> float:
    """Probability that no object of the type is there."""
    if not answer.detections:
        return float(np.clip(answer.p_absent, 0, 1))
    return float(np.prod([1 - np.clip(detection.score, 0, 1) for detection in answer.detections]))


def _object_of(
    detection: Detection, catalogue: Catalogue, scene: Scene, T_frame_camera: NDArray[np.float64]
) -> DetectedObject:
    kind = catalogue.types.get(detection.type)
    T_frame_support = T_frame_camera @ scene.supports[detection.support].T_camera_support
    _foot(detection, T_frame_support, T_frame_camera)
    length, width, height = (float(edge) for edge in detection.size)
    return DetectedObject(
        type=detection.type,
        code=kind.code if kind is not None else None,
        score=float(np.clip(detection.score, 0, 1)),
        pose=pose_of(T_frame_camera @ detection.T_camera_model),
        size=(length, width, height),
        covariance=tuple(float(v) for v in _turned(detection.covariance, T_frame_support).ravel()),
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
