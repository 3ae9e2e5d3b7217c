"""The channel table: every key, what travels on it, and how it is delivered. All else derives from it."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from zsight_protocol.action import CancelRequest, GoalStatusList, ResultRequest, Update
from zsight_protocol.camera_info import CameraInfo
from zsight_protocol.errors import KeyNameError
from zsight_protocol.find_object import FindObjectGoal, FindObjectResult
from zsight_protocol.geometry import Plane, TransformList
from zsight_protocol.health import Health
from zsight_protocol.host_report import HostReport
from zsight_protocol.log_event import LogEvent
from zsight_protocol.object_type import CatalogAnswer, CatalogRequest
from zsight_protocol.parameter import ParameterRequest
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.recording import Clock, PlayerRequest, PlayerState, RecorderRequest, RecorderState
from zsight_protocol.scene import Scene

if TYPE_CHECKING:
    from zsight_protocol.message import Message

__all__ = ["ANY_FINDER", "CHANNELS", "DEFAULT_NAMESPACE", "Cell", "Channel", "Delivery", "channel_of", "require_name"]

DEFAULT_NAMESPACE = "zsight"
ANY_FINDER = "any"
"""Every finder serves goals under this name too, and the network hands each to the best match."""


class Delivery(StrEnum):
    """What a reader may count on."""

    LATEST = "latest"  # only the newest matters: a slow reader never queues and never slows a writer
    EVERY = "every"  # in order, none lost silently
    LATCHED = "latched"  # a late joiner gets the last value at once
    REQUEST = "request"  # a question that somebody answers
    TOKEN = "token"  # noqa: S105  a liveliness token, not a secret


@dataclass(frozen=True)
class Channel:
    """One row: the key behind the namespace (``*`` stands for a name), its message, its delivery."""

    pattern: str
    message: type[Message] | None
    delivery: Delivery


CHANNELS = (
    Channel("*/points", PointCloud2, Delivery.LATEST),
    Channel("*/points/voxel", PointCloud2, Delivery.LATEST),
    Channel("*/camera_info", CameraInfo, Delivery.LATCHED),
    Channel("*/selected_points", PointCloud2, Delivery.EVERY),
    Channel("*/plane", Plane, Delivery.LATEST),
    Channel("*/plane/points", PointCloud2, Delivery.LATEST),
    Channel("*/plane/above", PointCloud2, Delivery.LATEST),
    Channel("*/scene", Scene, Delivery.LATEST),
    Channel("tf", TransformList, Delivery.EVERY),
    Channel("tf_static", TransformList, Delivery.LATCHED),
    Channel("find_object/*", FindObjectGoal, Delivery.REQUEST),
    Channel("find_object/*/cancel", CancelRequest, Delivery.REQUEST),
    Channel("find_object/*/result", ResultRequest, Delivery.REQUEST),
    Channel("find_object/*/status", GoalStatusList, Delivery.LATCHED),
    Channel("find_object/*/feedback", Update[FindObjectResult], Delivery.EVERY),
    Channel("find_object/*/goal", FindObjectGoal, Delivery.EVERY),
    Channel("find_object/*/catalogue", CatalogAnswer, Delivery.LATCHED),
    Channel("catalog/*", CatalogRequest, Delivery.REQUEST),
    Channel("param/*/*", ParameterRequest, Delivery.REQUEST),
    Channel("clock", Clock, Delivery.LATEST),
    Channel("@recorder/*", RecorderRequest, Delivery.REQUEST),
    Channel("@recorder/*/status", RecorderState, Delivery.LATCHED),
    Channel("@player/*", PlayerRequest, Delivery.REQUEST),
    Channel("@player/*/status", PlayerState, Delivery.LATCHED),
    Channel("@health/*/*", Health, Delivery.LATEST),
    Channel("@log/*/*", LogEvent, Delivery.EVERY),
    Channel("@host/*", HostReport, Delivery.REQUEST),
    Channel("@alive/*/*", None, Delivery.TOKEN),
)

_NAME = re.compile(r"[a-z0-9_][a-z0-9_.-]*")


# A camera of such a name would give its keys to another row.
_RESERVED = frozenset(first for channel in CHANNELS if (first := channel.pattern.split("/")[0]) != "*")


def require_name(name: str, what: str) -> str:
    """The name, where it can stand in a key.

    Raises:
        KeyNameError: it cannot.
    """
    if not _NAME.fullmatch(name):
        raise KeyNameError(
            f"{what} is {name!r}; expected lower-case letters, digits, '_', '-' and '.', such as 'kinect'"
        )
    return name


def _camera(name: str) -> str:
    if name in _RESERVED:
        raise KeyNameError(f"camera is {name!r}; expected a name other than {', '.join(sorted(_RESERVED))}")
    return _name_or_any(name, "camera")


def _name_or_any(name: str, what: str) -> str:
    return name if name == "*" else require_name(name, what)


def _fits(pattern: str, chunk: str) -> bool:
    if pattern == "*":
        return chunk == "*" or _NAME.fullmatch(chunk) is not None
    return pattern == chunk


def channel_of(key: str, namespace: str) -> Channel:
    """The row that a key belongs to.

    Raises:
        KeyNameError: the key is in no row, or not in the namespace.
    """
    if not key.startswith(f"{namespace}/"):
        raise KeyNameError(f"key is {key!r}; expected it to start with {namespace}/")
    chunks = key[len(namespace) + 1 :].split("/")
    for channel in sorted(CHANNELS, key=lambda row: row.pattern.startswith("*")):  # cameras' keys come last
        pattern = channel.pattern.split("/")
        if len(pattern) == len(chunks) and all(map(_fits, pattern, chunks)):
            return channel
    known = ", ".join(channel.pattern for channel in CHANNELS)
    raise KeyNameError(f"key is {key!r}; expected {namespace}/ and one of {known}")


class Cell:
    """The keys of one cell: every key expression of the project is made here."""

    def __init__(self, namespace: str = DEFAULT_NAMESPACE) -> None:
        """Args: namespace of the cell or robot.

        Raises:
            KeyNameError: it cannot stand in a key.
        """
        self.namespace = require_name(namespace, "namespace")

    def _key(self, *chunks: str) -> str:
        return "/".join((self.namespace, *chunks))

    def points(self, camera: str) -> str:
        """Clouds as the camera measures them; '*' for any camera, here and below."""
        return self._key(_camera(camera), "points")

    def voxel_points(self, camera: str) -> str:
        """Down-sampled clouds."""
        return self._key(_camera(camera), "points", "voxel")

    def camera_info(self, camera: str) -> str:
        """Calibration of a camera."""
        return self._key(_camera(camera), "camera_info")

    def selected_points(self, camera: str) -> str:
        """Patches that a person selected."""
        return self._key(_camera(camera), "selected_points")

    def plane(self, camera: str) -> str:
        """Planes of selected patches."""
        return self._key(_camera(camera), "plane")

    def plane_points(self, camera: str) -> str:
        """Coplanar points of those planes."""
        return self._key(_camera(camera), "plane", "points")

    def points_above_plane(self, camera: str) -> str:
        """Points that stand above those planes."""
        return self._key(_camera(camera), "plane", "above")

    def scene(self, camera: str) -> str:
        """What the finders see on its clouds: surfaces, what stands there, and where nothing was measured."""
        return self._key(_camera(camera), "scene")

    @property
    def tf_static(self) -> str:
        """Transforms that never change."""
        return self._key("tf_static")

    @property
    def tf(self) -> str:
        """Transforms that do."""
        return self._key("tf")

    def find_object(self, finder: str) -> str:
        """Goals of one finder; '*' for any."""
        return self._key("find_object", _name_or_any(finder, "finder"))

    def cancel(self, finder: str) -> str:
        """Cancel requests of one finder; '*' for all."""
        return self._key("find_object", _name_or_any(finder, "finder"), "cancel")

    def result(self, finder: str) -> str:
        """Requests for results that a finder keeps; '*' for all."""
        return self._key("find_object", _name_or_any(finder, "finder"), "result")

    def status(self, finder: str) -> str:
        """Goals that a finder holds; '*' for all."""
        return self._key("find_object", _name_or_any(finder, "finder"), "status")

    def feedback(self, finder: str) -> str:
        """Updates of all goals of a finder, for watchers; '*' for all."""
        return self._key("find_object", _name_or_any(finder, "finder"), "feedback")

    def goal(self, finder: str) -> str:
        """Goals that a finder took, for watchers and recorders."""
        return self._key("find_object", require_name(finder, "finder"), "goal")

    def catalogue(self, finder: str) -> str:
        """All types that a finder knows, for watchers and recorders."""
        return self._key("find_object", require_name(finder, "finder"), "catalogue")

    def catalog(self, name: str) -> str:
        """One type of the catalogue; '*' for all."""
        return self._key("catalog", _name_or_any(name, "type"))

    def parameters(self, host: str, process: str) -> str:
        """Settings of a process; '*' for any host or process."""
        return self._key("param", _name_or_any(host.lower(), "host"), _name_or_any(process, "process"))

    @property
    def clock(self) -> str:
        """The time that a player has reached."""
        return self._key("clock")

    def recorder(self, name: str) -> str:
        """Requests to a recorder; '*' for any."""
        return self._key("@recorder", _name_or_any(name, "recorder"))

    def recorder_status(self, name: str) -> str:
        """How a recorder stands; '*' for all."""
        return self._key("@recorder", _name_or_any(name, "recorder"), "status")

    def player(self, name: str) -> str:
        """Requests to a player; '*' for any."""
        return self._key("@player", _name_or_any(name, "player"))

    def player_status(self, name: str) -> str:
        """How a player stands; '*' for all."""
        return self._key("@player", _name_or_any(name, "player"), "status")

    def health(self, host: str, process: str) -> str:
        """Beats of a process; '*' for any host or process. Hosts stand in lower case: their case says nothing."""
        return self._key("@health", _name_or_any(host.lower(), "host"), _name_or_any(process, "process"))

    def log(self, host: str, process: str) -> str:
        """Events of a process's log; '*' for any host or process."""
        return self._key("@log", _name_or_any(host.lower(), "host"), _name_or_any(process, "process"))

    def host(self, host: str) -> str:
        """What the supervisor of a host tells; '*' for all."""
        return self._key("@host", _name_or_any(host.lower(), "host"))

    def alive(self, host: str, process: str) -> str:
        """Liveliness token of a process; '*' for any host or process."""
        return self._key("@alive", _name_or_any(host.lower(), "host"), _name_or_any(process, "process"))
