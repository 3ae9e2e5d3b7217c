"""The bridge to Rerun: a file of it, read with its own reader."""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.services.bridged import CLOUD, FRAME, STAMP, T_CAMERA, T_FOUND, XYZ, answer, bridged
from tests.services.waiting import soon

from zsight_core.transform import quaternion

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.bus import Bus
    from zsight.things import Thing
    from zsight_protocol.geometry import TransformList
    from zsight_protocol.point_cloud import PointCloud2

rerun = pytest.importorskip("rerun", reason="needs the extra rerun: pip install 'zsight[rerun]'")


class Counted:
    """A sink that counts what it hands on to another."""

    def __init__(self, inner: Any) -> None:
        self.inner = inner
        self.seen: list[str] = []

    def cloud(self, camera: str, cloud: PointCloud2) -> None:
        self.inner.cloud(camera, cloud)
        self.seen.append("cloud")

    def transforms(self, transforms: TransformList, *, static: bool) -> None:
        self.inner.transforms(transforms, static=static)
        self.seen.append("transforms")

    def things(self, things: list[Thing]) -> None:
        self.inner.things(things)
        self.seen.append(f"things {len(things)}")

    def again(self) -> None:
        self.inner.again()

    def close(self) -> None:
        self.inner.close()


def columns(path: Path, entity: str) -> dict[str, list[Any]]:
    """All that a file says of an entity, by component, in the order of its times."""
    from rerun.chunk import RrdReader

    found: dict[str, list[Any]] = {}
    for chunk in RrdReader(str(path)).store().stream().to_chunks():
        if str(chunk.entity_path) == f"/{entity}":
            batch = chunk.to_record_batch()
            for name, column in zip(batch.schema.names, batch.columns, strict=True):
                whole = column.cast("int64") if "timestamp" in str(column.type) else column
                found.setdefault(name.rpartition(":")[2], []).extend(value for value in whole.to_pylist() if value)
    return found


def test_a_file_holds_clouds_frames_and_what_was_found(join_memory: Callable[[], Bus], tmp_path: Path) -> None:
    from zsight.bridge.rerun_sink import RerunSink

    sink = Counted(RerunSink(str(tmp_path / "cell.rrd"), 1000))
    with contextlib.contextmanager(bridged)(join_memory, sink) as send:
        send(CLOUD, answer("toy_block"))
        assert soon(lambda: {"cloud", "transforms", "things 1"} <= set(sink.seen))
        send(answer())
        assert soon(lambda: "things 0" in sink.seen)
    cloud = columns(tmp_path / "cell.rrd", "clouds/kinect")
    np.testing.assert_array_equal(cloud["positions"][0], XYZ[[0, 2]])  # holes are left out
    assert [f"{colour:08x}" for colour in cloud["colors"][0]] == ["fa0a14ff", "1e28c8ff"]
    assert cloud["frame"][0] == [FRAME]
    assert cloud["stamp"] == [STAMP.ns]
    frame = columns(tmp_path / "cell.rrd", f"frames/{FRAME}")
    np.testing.assert_allclose(frame["translation"][0][0], T_CAMERA[:3, 3], rtol=1e-6)
    np.testing.assert_allclose(frame["quaternion"][0][0], quaternion(T_CAMERA), atol=1e-6)
    assert (frame["parent_frame"][0], frame["child_frame"][0]) == (["world"], [FRAME])
    block = columns(tmp_path / "cell.rrd", "found/toy_block_0")
    np.testing.assert_allclose(np.mean(block["vertex_positions"][0], axis=0), T_FOUND[:3, 3], atol=1e-6)
    assert block["is_recursive"] == [[True]]  # cleared by the answer that found none
    assert columns(tmp_path / "cell.rrd", "found/toy_block_0/axes")["labels"][0][0] == "toy_block 97%"
