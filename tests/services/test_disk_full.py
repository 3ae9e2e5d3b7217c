"""A disk that is full: said clearly, the file is whole, nobody waits, and it goes on or ends as told."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from typing import TYPE_CHECKING, Any

import pytest
from tests.services.recordings import START, cloud, sample
from tests.services.waiting import soon

from zsight.recording.checking import check
from zsight.recording.conversion import convert
from zsight.recording.disk_writer import DiskPolicy, DiskWriter, OnFull
from zsight.recording.export import export
from zsight.recording.file_series import Split
from zsight.recording.mcap_copy import copy
from zsight.recording.mcap_file import McapFile
from zsight.recording.mcap_writer import McapWriter
from zsight.recording.recording_file import LOSSES, RecordingFile

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

MIB = 1 << 20


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 12 MiB."""
    if os.geteuid() != 0:
        pytest.skip("needs root, to mount a small file system")
    place = tmp_path / "disk"
    place.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=12m", "tmpfs", str(place)]
    mounted = subprocess.run(command, capture_output=True, check=False)
    if mounted.returncode:
        pytest.skip(f"no file system can be mounted here: {mounted.stderr.decode().strip()}")
    yield place
    subprocess.run(["umount", "--lazy", str(place)], check=True)


PICTURE = cloud(1, size=(100, 640))  # 1 MiB


def put(writer: DiskWriter, first: int, count: int) -> float:
    """Hand messages over; the longest that one took, seconds."""
    longest = 0.0
    for number in range(first, first + count):
        begun = time.perf_counter()
        writer.put(sample("cell/kinect/points", PICTURE, START + number, sequence=number + 1))
        longest = max(longest, time.perf_counter() - begun)
    return longest


def writer_on(disk: Path, **policy: Any) -> DiskWriter:
    return DiskWriter(disk / "a.mcap", "cell", {}, DiskPolicy(compression="none", **policy), in_force=[])


def test_the_recording_ends_with_a_whole_file_and_says_so(small_disk: Path) -> None:
    writer = writer_on(small_disk, reserve=2 * MIB)
    assert put(writer, 0, 40) < 5.0  # no disk is waited for, however slow the machine
    assert soon(lambda: writer.ended)
    assert "disk full" in writer.words
    assert "ends here" in writer.words
    put(writer, 40, 10)
    writer.close()
    report = check(small_disk / "a.mcap")
    assert report["sound"]
    assert 4 <= report["messages"] <= 10
    assert writer.losses() == {"cell/kinect/points": 50 - report["messages"]}
    with McapFile.open(small_disk / "a.mcap") as file:
        assert 0 < int({m.name: m.entries for m in file.metadata}[LOSSES]["cell/kinect/points"]) <= 46


def test_it_goes_on_when_there_is_room_again(small_disk: Path) -> None:
    ballast = small_disk / "ballast"
    ballast.write_bytes(bytes(6 * MIB))
    writer = writer_on(small_disk, reserve=2 * MIB, on_full=OnFull.WAIT)
    put(writer, 0, 20)
    assert soon(lambda: writer.full)
    assert "goes on when there is room" in writer.words
    assert soon(lambda: writer.messages + sum(writer.losses().values()) >= 20)
    ballast.unlink()
    assert soon(lambda: not writer.full)
    put(writer, 20, 2)
    assert soon(lambda: writer.safe_ns == START + 21)
    writer.close()
    first, second = writer.series.files
    assert check(first)["sound"]
    assert check(second)["sound"]
    with McapFile.open(second) as file:
        assert [entry.sequence for entry in file.messages()] == [21, 22]
    written = check(first)["messages"] + 2
    assert writer.losses() == {"cell/kinect/points": 22 - written}


def test_the_oldest_file_gives_way(small_disk: Path) -> None:
    writer = writer_on(small_disk, reserve=2 * MIB, on_full=OnFull.OLDEST, split=Split(bytes=2 * MIB))
    for number in range(0, 40, 2):
        put(writer, number, 2)
        assert soon(lambda: writer.messages + sum(writer.losses().values()) >= number + 2)  # noqa: B023  at once
    writer.close()
    assert writer.series.files[0].name != "a_0.mcap"
    assert sorted(small_disk.iterdir()) == sorted(writer.series.files)
    assert all(check(path)["sound"] for path in writer.series.files)
    last = [path for path in writer.series.files if check(path)["messages"]][-1]
    with McapFile.open(last) as file:
        assert [entry.sequence for entry in file.messages()][-1] == 40


def fill(path: Path) -> None:
    """Use up whatever is left of a disk."""
    with contextlib.suppress(OSError), path.open("wb", buffering=0) as rest:
        while rest.write(bytes(4096)):
            pass


def test_without_room_even_for_the_index_the_last_chunks_give_way(small_disk: Path) -> None:
    writer = McapWriter(small_disk / "a.mcap", "test", chunk_bytes=MIB)
    channel = writer.channel("/a", 0, "x", {})
    count = 0

    def write_one() -> bool:
        writer.add(channel, count, count, count, [bytes(MIB // 2)])
        try:
            writer.close_chunk()
        except OSError:
            return False
        return True

    while write_one():
        count += 1
    fill(small_disk / "fill")
    writer.finish()
    with McapFile.open(small_disk / "a.mcap") as file:
        assert file.damage == ""
        kept = [entry.sequence for entry in file.messages()]
    assert kept == list(range(len(kept)))
    assert count - 2 <= len(kept) < count
    assert writer.statistics.messages == len(kept)


@pytest.mark.parametrize("count", [2, 30])  # less than a chunk, and more than the disk
@pytest.mark.parametrize(
    "take",
    [
        lambda source, target: copy([source], target),
        convert,
        lambda source, target: export(source, target, "mcap"),
    ],
)
def test_a_file_made_of_another_appears_whole_or_not_at_all(
    small_disk: Path, tmp_path: Path, count: int, take: Callable[[Path, Path], object]
) -> None:
    source = RecordingFile(tmp_path / "a.mcap", "cell", {})
    for number in range(count):
        source.write(sample("cell/kinect/points", PICTURE, START + number, sequence=number + 1))
    source.finish()
    (small_disk / "ballast").write_bytes(bytes(11 * MIB))
    with pytest.raises(OSError, match="No space left"):
        take(tmp_path / "a.mcap", small_disk / "new.mcap")
    assert [file.name for file in small_disk.iterdir()] == ["ballast"]
