"""Recording and playing beside mcap's own writer and foxglove-sdk: throughput, keeping up, timing, seeking, crashes.

Files are written where the temporary files are, or in ZSIGHT_BENCH_FOLDER; in memory (/dev/shm) the disk is left out.
"""

from __future__ import annotations

import itertools
import os
import random
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from bench_row import row

from zsight.bus import Bus
from zsight.bus.attachment import Attachment
from zsight.bus.memory_link import MemoryLink, MemoryNetwork
from zsight.convert import cloud_from_points
from zsight.recording.checking import check
from zsight.recording.disk_writer import DiskPolicy, DiskWriter
from zsight.recording.mcap_copy import copy
from zsight.recording.mcap_file import McapFile
from zsight.recording.mcap_writer import McapWriter
from zsight.recording.player import Player
from zsight.recording.player import Settings as PlayerSettings
from zsight.recording.recording_file import RecordingFile
from zsight.recording.sample import Sample
from zsight_core.depth_image import to_points
from zsight_core.pinhole import Pinhole
from zsight_protocol.channels import Cell
from zsight_protocol.codec import encode
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.recording import Playing
from zsight_protocol.ros_message import ros_type, to_cdr

REPOSITORY = Path(__file__).resolve().parent.parent
CLOUDS = 40  # a turn of one writer
TURNS = 5
SECONDS = 6.0  # of each run that must keep up
KILLS = int(os.environ.get("ZSIGHT_BENCH_KILLS", "100"))
SEEKS = 200


def run() -> list[dict[str, Any]]:
    """All rows."""
    place = Path(tempfile.mkdtemp(dir=os.environ.get("ZSIGHT_BENCH_FOLDER")))
    try:
        return [*throughput(place), *keeping_up(place), *playing(place), *seeking(place), *crashing(place)]
    finally:
        shutil.rmtree(place)


def view(seed: int = 0) -> PointCloud2:
    """640 x 480 XYZRGB of a depth camera: a smooth scene with noise in depth and colour."""
    rng = np.random.default_rng(seed)
    u, v = np.meshgrid(np.arange(640), np.arange(480))
    depth = (1.2 + 0.3 * np.sin(u / 90) * np.cos(v / 70) + rng.normal(0, 0.001, u.shape)).astype(np.float32)
    colour = (np.stack([u / 3, v / 2, (u + v) / 5], -1) + rng.normal(0, 4, (480, 640, 3))).clip(0, 255)
    points = to_points(depth, Pinhole(640, 480, 525.0, 525.0, 319.5, 239.5), colour=colour.astype(np.uint8))
    return cloud_from_points(points, Time.from_ns(1_700_000_000_000_000_000 + seed), "optical")


# Throughput: the same messages, serialised beforehand, in turn.


def throughput(place: Path) -> list[dict[str, Any]]:
    payloads = [b"".join(to_cdr(view(number))) for number in range(8)]
    writers = {"ours": write_ours, "mcap": write_mcap, "foxglove-sdk": write_foxglove}
    rows: list[dict[str, Any]] = []
    for compression in ("none", "lz4", "zstd"):
        speeds: dict[str, list[float]] = {}
        for turn in range(TURNS):
            for name, write in writers.items():
                path = place / f"{name}_{turn}.mcap"
                begun = time.perf_counter()
                try:
                    write(path, payloads, compression)
                except ModuleNotFoundError:
                    continue
                speeds.setdefault(name, []).append(CLOUDS * len(payloads[0]) / 1e6 / (time.perf_counter() - begun))
                path.unlink()
        ours = speeds.pop("ours")
        for peer, values in speeds.items():
            ratio = statistics.median(a / b for a, b in zip(ours, values, strict=True))
            rows.append({
                "name": f"write, {compression}", "value": statistics.median(ours), "unit": "MB/s", "peer": peer,
                "peer_value": statistics.median(values), "ratio": ratio, "target": 1.0, "holds": ratio >= 1.0,
            })  # fmt: skip
    return rows


def write_ours(path: Path, payloads: list[bytes], compression: str) -> None:
    """As the recorder does it: chunk by chunk, with checksums."""
    stored = "" if compression == "none" else compression
    writer, ros = McapWriter(path, "bench"), ros_type(PointCloud2)
    channel = writer.channel("/points", writer.schema(ros.name, "ros2msg", ros.text.encode()), "cdr", {})
    for number in range(CLOUDS):
        if writer.add(channel, number, number, number, [payloads[number % len(payloads)]]):
            writer.close_chunk(stored)
    writer.finish(stored, sync=False)


def write_mcap(path: Path, payloads: list[bytes], compression: str) -> None:
    from mcap.writer import CompressionType, Writer

    kind = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}[compression]
    ros = ros_type(PointCloud2)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=kind)
        writer.start("ros2", "bench")
        schema = writer.register_schema(ros.name, "ros2msg", ros.text.encode())
        channel = writer.register_channel("/points", "cdr", schema)
        for number in range(CLOUDS):
            writer.add_message(channel, number, payloads[number % len(payloads)], number, number)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap's own


def write_foxglove(path: Path, payloads: list[bytes], compression: str) -> None:
    import foxglove
    from foxglove.mcap import MCAPCompression, MCAPWriteOptions

    kinds = {"none": None, "lz4": MCAPCompression.Lz4, "zstd": MCAPCompression.Zstd}
    ros = ros_type(PointCloud2)
    context = foxglove.Context()
    schema = foxglove.Schema(name=ros.name, encoding="ros2msg", data=ros.text.encode())
    channel = foxglove.Channel("/points", schema=schema, message_encoding="cdr", context=context)
    options = MCAPWriteOptions(compression=kinds[compression], profile="ros2")
    with foxglove.open_mcap(path, context=context, writer_options=options):
        for number in range(CLOUDS):
            channel.log(payloads[number % len(payloads)], log_time=number)


# Keeping up: messages as they come off the wire, at their rate; nothing may be dropped.


def keeping_up(place: Path) -> list[dict[str, Any]]:
    return [
        kept_up(place, "two cameras at 30 Hz, no compression", 2, "none"),
        kept_up(place, "one camera at 30 Hz, lz4", 1, "lz4"),
        kept_up(place, "two cameras at 30 Hz, auto", 2, "auto"),
    ]


def kept_up(place: Path, name: str, cameras: int, compression: str) -> dict[str, Any]:
    payloads = [encode(view(number)) for number in range(8)]
    path = place / "kept.mcap"
    writer = DiskWriter(path, "cell", {}, DiskPolicy(compression=compression), in_force=[])
    begun, longest, deepest = time.monotonic(), 0.0, 0
    for number in range(int(SECONDS * 30)):
        time.sleep(max(begun + number / 30 - time.monotonic(), 0.0))
        for camera in range(cameras):
            now = time.time_ns() + camera
            attachment = Attachment(camera + 1, number + 1, now)
            put = time.perf_counter()
            writer.put(Sample(f"cell/camera{camera}/points", payloads[number % 8], attachment, now))
            longest = max(longest, time.perf_counter() - put)
        deepest = max(deepest, writer.waiting_bytes)
    writer.close()
    lost, size = sum(writer.losses().values()), path.stat().st_size
    path.unlink()
    words = {"came_mb_per_s": writer.bytes_in / 1e6 / SECONDS, "file_mb_per_s": size / 1e6 / SECONDS,
             "longest_put_ms": longest * 1e3, "most_waiting_mb": deepest / 1e6}  # fmt: skip
    return row(f"{name}: lost", lost, "messages", 0, least=False, **words)


# Playing.


def record(path: Path, seconds: float, rate: float, size: tuple[int, int] = (480, 640)) -> None:
    """Two cameras and transforms, evenly."""
    file, start = RecordingFile(path, "cell", {}), 1_700_000_000_000_000_000
    message = view()
    if size != (480, 640):
        part = np.zeros(size, np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<f4")]))
        message = cloud_from_points(part, Time.from_ns(start), "optical")
    payload = encode(message)
    for number in range(int(seconds * rate)):
        for camera in range(2):
            at = start + int(number / rate * 1e9) + camera * 1_000_000
            sample = Sample(f"cell/camera{camera}/points", payload, Attachment(camera + 1, number + 1, at), at)
            if file.write(sample):
                file.mcap.close_chunk()
    file.finish()


def playing(place: Path) -> list[dict[str, Any]]:
    record(place / "play.mcap", 5, 30)
    rows = []
    for rate, size in ((1.0, "two cameras 640 x 480 at 30 Hz"), (1.0, "again")):
        late, took = play(place / "play.mcap", rate)
        rows.append(row(f"play {size}: late p99", late, "ms", 2.0, least=False, took_s=took))
    record(place / "fast.mcap", 30, 30, (48, 64))
    _, took = play(place / "fast.mcap", 10.0)
    wanted = (30 - 1 / 30) / 10
    rows.append(row("play at rate 10: rate", 10 * wanted / took, "", None, least=True))
    rows[-1] |= {"target": "10 +- 2 %", "holds": abs(wanted / took - 1) <= 0.02}
    return rows


def play(path: Path, rate: float) -> tuple[float, float]:
    """Milliseconds that 99 % of the messages were at most late, and seconds from the first to the last."""
    player = Player(Bus(MemoryLink(MemoryNetwork()), Cell("cell")), PlayerSettings(rate=rate, paused=True))
    times: list[float] = []
    send = player._send  # noqa: SLF001  watched

    def noted(ready: Any) -> None:
        times.append(time.monotonic())
        send(ready)

    player._send = noted  # type: ignore[method-assign]  # noqa: SLF001  watched
    player.open(str(path))
    assert player.playback is not None
    player.playback.play()
    player.playback.wait_ended()
    late = player.playback.late_p99() * 1e3
    player.close()
    return late, times[-1] - times[0]


def seeking(place: Path) -> list[dict[str, Any]]:
    record(place / "seek.mcap", 60, 10, (120, 160))
    player = Player(Bus(MemoryLink(MemoryNetwork()), Cell("cell")), PlayerSettings(paused=True))
    player.open(str(place / "seek.mcap"))
    playback, recording = player.playback, player._recording  # noqa: SLF001
    assert playback is not None
    assert recording is not None
    chance, times = random.Random(1), []  # noqa: S311
    for _ in range(SEEKS):
        begun = time.perf_counter()
        playback.seek(recording.start_ns + int(chance.uniform(0, 59.9) * 1e9))
        playback.wait_settled(60)
        times.append((time.perf_counter() - begun) * 1e3)
        assert playback.state is Playing.PAUSED
    player.close()
    return [row("seek in 60 s, with what was in force: median", statistics.median(times), "ms", None, least=False)]


# kill -9.


def crashing(place: Path) -> list[dict[str, Any]]:
    """A recorder killed at random moments: what it had said was safe is there, and was never a second behind."""
    chance, bad, behind = random.Random(2), 0, []  # noqa: S311
    for number, compression in zip(range(KILLS), itertools.cycle(("none", "lz4", "auto")), strict=False):
        path, mended = place / f"kill_{number}.mcap", place / f"mended_{number}.mcap"
        killed, safe = killed_at(path, compression, chance.uniform(0.0, 1.5))
        try:
            copy([path], mended, walk=True)
            with McapFile.open(mended) as file:
                last = file.statistics.end
            sound = check(mended)
            bad += not (sound["sound"] and not sound["gaps"] and last >= safe)
            behind.append((killed - last) / 1e9)
        except Exception as error:  # noqa: BLE001  counted
            print(f"kill {number}: {error}", file=sys.stderr)
            bad += 1
        for file_path in (path, mended):
            file_path.unlink(missing_ok=True)
    return [
        row(f"{KILLS} kills: not recovered, or something safe missing", bad, "", 0, least=False),
        row("kill -9 loses: most", max(behind), "s", 1.0, least=False, median=statistics.median(behind)),
    ]


def killed_at(path: Path, compression: str, after: float) -> tuple[int, int]:
    """Record in a process of its own and kill it; when, and until when everything was said to be safe."""
    command = [sys.executable, "-m", "tests.services.crashing_writer", str(path), compression, "48"]
    process = subprocess.Popen(command, cwd=REPOSITORY, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    first = process.stdout.readline()
    time.sleep(after)
    process.kill()
    killed = time.time_ns()
    rest = process.stdout.read().splitlines()
    process.wait()
    process.stdout.close()
    whole = [line for line in [first.strip(), *rest] if len(line.split()) == 3]
    return killed, int(whole[-1].split()[0])
