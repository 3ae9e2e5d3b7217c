"""The public names of the package: whoever adds, renames or removes one changes this list, and the changelog."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING

import pytest
from tests.protocol.legal_messages import MODULES, all_kinds

if TYPE_CHECKING:
    from zsight_protocol.message import Message

PUBLIC = {
    "action": [
        "CancelCode",
        "CancelRequest",
        "CancelResponse",
        "ENDED",
        "GoalId",
        "GoalState",
        "GoalStatus",
        "GoalStatusList",
        "LEGAL_MOVES",
        "ResultRequest",
        "Update",
        "UpdateList",
        "move",
        "new_goal_id",
    ],
    "camera_info": ["CameraInfo"],
    "channels": [
        "ANY_FINDER",
        "CHANNELS",
        "Cell",
        "Channel",
        "DEFAULT_NAMESPACE",
        "Delivery",
        "channel_of",
        "require_name",
    ],
    "codec": ["ALIGNMENT", "decode", "encode", "encode_parts"],
    "errors": ["DecodeError", "EncodeError", "KeyNameError", "ProtocolError", "shortened"],
    "find_object": [
        "ANY_TYPE",
        "Capture",
        "DetectedObject",
        "FindObjectGoal",
        "FindObjectResult",
        "Obstacle",
        "ResultCode",
        "Status",
        "Support",
    ],
    "geometry": [
        "Plane",
        "Point",
        "Pose",
        "PoseStamped",
        "Quaternion",
        "Region",
        "Transform",
        "TransformList",
        "TransformStamped",
        "Vector3",
    ],
    "health": ["Health", "Latency", "Level", "ReaderHealth", "WriterHealth"],
    "host_report": ["Crash", "HostReport", "ProcessReport"],
    "known_head": ["KnownHead"],
    "log_event": ["LogEvent", "LogTail"],
    "message": ["Bare", "Count", "Extras", "Float64", "Header", "Message", "Time", "Tuple2", "Tuple3", "Tuple4"],
    "object_type": [
        "BoxShape",
        "CatalogAnswer",
        "CatalogRequest",
        "Channel8",
        "CylinderShape",
        "Derived",
        "MeshShape",
        "ObjectType",
        "ShapeOf",
        "SphereShape",
        "StablePose",
        "SurfaceShape",
        "SymmetryAxis",
        "Taught",
        "Teaching",
        "TypeName",
    ],
    "parameter": ["Parameter", "ParameterAnswer", "ParameterRequest"],
    "point_cloud": ["Buffer", "Datatype", "MAXIMUM_BYTES", "MAXIMUM_POINTS", "PointCloud2", "PointField"],
    "recent": ["MOST", "Recent"],
    "recording": [
        "Clock",
        "DepthCodedCloud",
        "KeyLoss",
        "PlayerRequest",
        "PlayerState",
        "Playing",
        "RecorderRequest",
        "RecorderState",
        "Recording",
    ],
    "ros_cdr": ["read_cdr", "write_cdr"],
    "ros_definition": [
        "Definitions",
        "PRIMITIVES",
        "RosField",
        "SEPARATOR",
        "STRINGS",
        "parse_definition",
        "short_name",
    ],
    "ros_message": ["RosType", "from_cdr", "from_values", "ros_type", "to_cdr"],
    "scene": ["HeightLayer", "LabelImage", "MissingDepth", "Scene", "SceneSegment", "SupportSurface"],
}


def test_every_module_is_listed() -> None:
    assert [f"zsight_protocol.{name}" for name in PUBLIC] == MODULES


@pytest.mark.parametrize("name", PUBLIC)
def test_a_module_exports_its_public_names(name: str) -> None:
    module = importlib.import_module(f"zsight_protocol.{name}")
    assert sorted(module.__all__) == sorted(PUBLIC[name])
    assert all(hasattr(module, public) for public in PUBLIC[name])


@pytest.mark.parametrize("kind", [pytest.param(kind, id=kind.__name__) for kind in all_kinds()])
def test_a_message_is_public_read_only_and_refuses_what_it_does_not_know(kind: type[Message]) -> None:
    name = kind.__name__.partition("[")[0]
    assert any(name in names for names in PUBLIC.values())
    assert kind.model_config["frozen"]
    assert kind.model_config["strict"]
    assert kind.model_config["extra"] == "forbid"
