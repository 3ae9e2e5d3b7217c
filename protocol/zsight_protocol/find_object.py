"""The find-object action: what is asked, what is reported on the way, what is answered."""

from __future__ import annotations

from enum import IntEnum, StrEnum
from typing import Annotated

from pydantic import Field, Strict

from zsight_protocol.action import GoalId
from zsight_protocol.geometry import Pose, Region, Vector3
from zsight_protocol.message import Bare, Count, Extras, Float64, Header, Message, Tuple3

__all__ = [
    "ANY_TYPE",
    "Capture",
    "DetectedObject",
    "FindObjectGoal",
    "FindObjectResult",
    "Obstacle",
    "ResultCode",
    "Status",
    "Support",
]

ANY_TYPE = "any"
"""Asks for all types of the catalogue at once; no type has this name."""

Probability = Annotated[Float64, Field(ge=0, le=1)]
Name = Annotated[str, Field(min_length=1, max_length=128)]
Extent = Annotated[Float64, Field(ge=0)]
Covariance = Annotated[tuple[Float64, ...], Strict(False), Field(min_length=36, max_length=36)]


class ResultCode(IntEnum):
    """How a find ended, with the codes of the book's object finder."""

    FOUND = 0
    NOT_FOUND = 1
    CODE_NOT_RECOGNISED = 2
    BUSY = 3
    CANCELLED = 4


class Status(StrEnum):
    """What is known: an object that is not found may be absent, or be where the camera cannot tell."""

    FOUND = "found"
    NOT_FOUND = "not_found"
    CANNOT_TELL = "cannot_tell"


class Capture(StrEnum):
    """Which cloud to look at: the last one that came, or the first one measured after the goal arrived."""

    LAST = "last"
    NEW = "new"


class FindObjectGoal(Message):
    """What to find and how to answer.

    ``object_type`` is a catalogue name or the book's number as text (1000 toy block, 1001 upright Coke can, 1002
    table surface), or "any" for all types that can be found. ``frame_id`` is the frame of the answer, of ``region`` and
    of ``known_height`` (metres along its z, which must be up); empty: the world if the camera's pose is known, else the
    cloud's own frame. ``maximum`` 0 asks for all instances. ``timeout`` is seconds from the goal's arrival, so that
    clocks of two hosts need not agree.
    """

    goal_id: GoalId
    object_type: Name
    camera: Annotated[str, Field(max_length=128)] = ""
    frame_id: Annotated[str, Field(max_length=256)] = ""
    known_height: Float64 | None = None
    region: Region | None = None
    capture: Annotated[Capture, Bare()] = Capture.LAST
    maximum: Annotated[int, Field(ge=0, le=1000)] = 1
    timeout: Annotated[Float64, Field(gt=0, le=3600)] = 10.0


class Support(Message):
    """The surface that an object stands on: a point of it and its upward unit normal, in the frame of the answer."""

    point: Vector3
    normal: Vector3


class Obstacle(Message):
    """Something unknown that stands there: a box around what is seen of it, in the frame of the answer, metres.

    ``label`` is that of the segment in the scene of the cloud; 0 is a region of a surface without depth that is no
    object's shadow, whose height is not known and zero in ``size``. ``points`` counts its pixels.
    """

    pose: Pose
    size: Annotated[tuple[Extent, Extent, Extent], Strict(False)]
    label: Annotated[int, Field(ge=0, lt=2**15)] = 0
    points: Count = 0


class DetectedObject(Message):
    """One object that was found (after vision_msgs/Detection3D).

    ``id`` stays with the object over successive finds of one finder. ``score`` is the probability that an object of
    this type is there; ``size`` the edges of its bounding box, metres. Covariances are 6 x 6 row by row of x y z and
    rotation about x y z (m^2, m rad, rad^2): ``covariance`` in the frame of the answer and ``covariance_support`` in
    that of the surface (z along its normal) hold what the image leaves open, ``covariance_world`` besides, in the frame
    of the answer, how well it is known where the camera is. ``visible_fraction`` is the share of its silhouette that
    no other object hides and the image holds; ``measured_height`` from its foot to the highest points measured on it,
    metres, zero for a surface.
    """

    id: Annotated[str, Field(max_length=128)] = ""
    type: Name
    code: Count | None = None
    score: Probability
    pose: Pose
    size: Tuple3
    covariance: Covariance
    covariance_support: Covariance | None = None
    covariance_world: Covariance | None = None
    visible_fraction: Probability
    measured_height: Extent = 0.0
    support: Support | None = None
    truncated: bool = False
    occluded: bool = False
    runner_up: str = ""
    equivalent_poses: Annotated[tuple[Pose, ...], Strict(False)] = ()


class FindObjectResult(Message):
    """The answer, stamped with the time and the frame in which the cloud was measured and the poses are given."""

    header: Header
    code: Annotated[ResultCode, Bare()]
    status: Annotated[Status, Bare()]
    message: str = ""
    finder: str = ""
    objects: Annotated[tuple[DetectedObject, ...], Strict(False)] = ()
    obstacles: Annotated[tuple[Obstacle, ...], Strict(False)] = ()
    p_absent: Probability = 0.0
    deadline_passed: bool = False
    report: Extras = Field(default_factory=dict)
    timings_ms: dict[str, Float64] = Field(default_factory=dict)
