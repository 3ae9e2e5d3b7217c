"""Readers that are no packages of this project agree bit for bit; see .ci/install_readers, which the CI runs."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from tests.services.recordings import START, cloud, sample, transform

from zsight.recording.recording_file import RecordingFile
from zsight.sources import camera_info
from zsight_core.pinhole import Pinhole
from zsight_protocol.ros_message import from_cdr, to_cdr

if TYPE_CHECKING:
    from zsight_protocol.message import Message

HERE = Path(__file__).resolve().parent
READERS = HERE.parents[1] / ".readers"


def bytes_of(message: Message) -> bytes:
    return b"".join(to_cdr(message))


def run(*command: object) -> str:
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run([*map(str, command)], capture_output=True, text=True, check=False, env=kept, timeout=100)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_mcap_core_and_rosmsg2_serialization_read_what_was_sent(tmp_path: Path) -> None:
    if not (READERS / "node" / "installed").is_file() or shutil.which("node") is None:
        pytest.skip("@mcap/core is not installed: .ci/install_readers does it")
    file = RecordingFile(tmp_path / "a.mcap", "cell", {})
    for number in range(10):
        file.write(sample("cell/kinect/points", cloud(number, size=(20, 30)), START + 2 * number))
        file.write(sample("cell/tf", transform(number + 0.1), START + 2 * number + 1))
    file.finish()
    lines = [json.loads(line) for line in run("node", HERE / "read_mcap.mjs", READERS / "node", file.path).splitlines()]
    assert [int(line["logTime"]) for line in lines] == [START + n for n in range(20)]
    for number in range(10):
        sent, read = cloud(number, size=(20, 30)), lines[2 * number]["message"]
        assert lines[2 * number]["topic"] == "/cell/kinect/points"
        assert read["data"] == hashlib.sha256(sent.data).hexdigest()
        assert read["fields"] == [field.model_dump(mode="json") for field in sent.fields]
        assert (
            read["header"]
            == {
                "stamp": {"sec": sent.header.stamp.sec, "nsec": sent.header.stamp.nanosec},
                "frame_id": "eye",
            }
            or read["header"]["stamp"] == sent.header.stamp.model_dump()
        )
        assert (read["height"], read["width"], read["is_dense"]) == (20, 30, sent.is_dense)
        (moved,) = lines[2 * number + 1]["message"]["transforms"]
        assert moved["transform"]["translation"]["x"] == number + 0.1


def test_rclpy_reads_what_was_sent_and_writes_the_same_bytes(tmp_path: Path) -> None:
    python = READERS / "rclpy" / "bin" / "python"
    if not (READERS / "rclpy" / "installed").is_file():
        pytest.skip("rclpy is not installed: .ci/install_readers does it")
    sent = cloud(7, size=(480, 640))
    info = camera_info(Pinhole(640, 480, 525.0, 526.0, 319.5, 239.5), "eye")
    (tmp_path / "cloud.cdr").write_bytes(bytes_of(sent))
    (tmp_path / "info.cdr").write_bytes(bytes_of(info))
    said = run(python, HERE / "read_rclpy.py", tmp_path).split()
    stamp = sent.header.stamp
    assert said == [str(stamp.sec), str(stamp.nanosec), "eye", "480", "640"]
    assert (tmp_path / "cloud.data").read_bytes() == bytes(sent.data)
    for name, message in (("cloud", sent), ("info", info)):
        again = (tmp_path / f"{name}.again").read_bytes()
        assert len(again) == len(bytes_of(message))
        # Fast-CDR leaves whatever was in memory between values, so theirs is brought into our form first.
        assert bytes_of(from_cdr(type(message), again)) == bytes_of(message)
