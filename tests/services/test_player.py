"""The player: what was recorded comes again, in order and in time, from any place, as its keys and requests say."""

from __future__ import annotations

import itertools
import json
import os
from typing import TYPE_CHECKING, Any, cast

import pytest
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore
from tests.services.recordings import START, cloud, damage, follow, sample, transform
from tests.services.running import running
from tests.services.waiting import DEADLINE, soon
from typer.testing import CliRunner

from zsight.cli import bag
from zsight.cli.player_keys import PlayerKeys
from zsight.convert import points_of
from zsight.errors import NobodyAnswers, RequestRefused, UsageError
from zsight.recording import player, recorder
from zsight.recording.mcap_file import McapFile
from zsight.recording.recording_file import RecordingFile
from zsight.recording_client import PlayerClient, RecorderClient
from zsight_protocol.codec import decode
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Time
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.recording import Clock, PlayerState, Playing

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path
    from typing import TextIO

    from zsight.bus import Bus

    Join = Callable[[], Bus]

STEP = 20_000_000  # ns between two messages
COUNT = 60  # 1.2 seconds


def moment(number: int) -> int:
    return START + number * STEP


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Clouds with a moving camera, and a transform that changed once in between."""
    path = tmp_path_factory.mktemp("recorded") / "a.mcap"
    file = RecordingFile(path, "lab", {})
    for number in range(COUNT):
        if number in (0, 30):
            file.write(sample("lab/tf_static", transform(number, child="stand"), moment(number) - 2, writer=1))
        file.write(sample("lab/tf", transform(number, stamp_ns=moment(number)), moment(number) - 1, writer=2))
        file.write(sample("lab/kinect/points", cloud(number, stamp_ns=moment(number)), moment(number), writer=3))
        if number % 7 == 6:
            file.mcap.close_chunk("lz4")
    file.finish()
    return path


def play(bus: Bus, path: Path, **values: Any) -> player.Player:
    playing = player.Player(bus, player.Settings(**values))
    playing.open(str(path))
    return playing


def to_the_end(playing: player.Player) -> PlayerState:
    assert playing.playback is not None
    assert playing.playback.wait_ended(DEADLINE)
    state = playing.state()
    playing.close()
    return state


def number_of(payload: bytes) -> int:
    return int(points_of(decode(PointCloud2, payload))["x"][0, 0])


def test_every_message_comes_once_in_order_as_it_was(join: Join, recorded: Path) -> None:
    here, there = join(), join()
    ns = here.cell.namespace
    came = follow(there, f"{ns}/**")
    playing = play(here, recorded, paused=True, rate=10)
    test = PlayerClient(there)
    assert soon(playing._outlets["lab/kinect/points".replace("lab", ns)]._writer.has_readers)  # type: ignore[union-attr]
    test.play()
    state = to_the_end(playing)
    found = came.wait(2 * COUNT + 2)
    assert (state.sent, state.skipped) == (2 * COUNT + 2, 0)
    clouds = [decode(PointCloud2, payload) for key, payload in found if key == f"{ns}/kinect/points"]
    assert clouds == [cloud(n, stamp_ns=moment(n)) for n in range(COUNT)]
    statics = [decode(TransformList, payload) for key, payload in found if key == f"{ns}/tf_static"]
    assert statics == [transform(0, child="stand"), transform(30, child="stand")]


def test_record_play_record_is_the_same(join_memory: Join, recorded: Path, tmp_path: Path) -> None:
    here, there = join_memory(), join_memory()
    with running(recorder.run, there, recorder.Settings(folder=str(tmp_path), reserve=0.25)):
        control = RecorderClient(here)
        control.start("again.mcap")
        to_the_end(play(here, recorded, rate=20))
        assert soon(lambda: control.status().messages == 2 * COUNT + 2)
        control.stop()
    with McapFile.open(recorded) as first, McapFile.open(tmp_path / "again.mcap") as second:
        one = [(e.channel.topic.replace("/lab", "/test"), bytes(e.data)) for e in first.messages()]
        two = [(e.channel.topic, bytes(e.data)) for e in second.messages()]
    assert one == two


def test_messages_come_in_time(join_memory: Join, recorded: Path) -> None:
    """Loosely, on a machine that others use too: how exactly is measured by ``bench bag``."""
    here, there = join_memory(), join_memory()
    times: list[tuple[float, int]] = []
    playing = player.Player(here, player.Settings(rate=4))
    send = playing._send

    def noted(ready: Any) -> None:
        times.append((ready.due, ready.log_time))
        send(ready)

    playing._send = noted  # type: ignore[method-assign]  # watched
    playing.open(str(recorded))
    state = to_the_end(playing)
    del there
    spans = [(due - times[0][0]) - (log - times[0][1]) / 1e9 / 4 for due, log in times]
    assert max(map(abs, spans)) < 1e-6
    assert state.late_p99_ms < 200


@pytest.mark.parametrize(("start", "number"), [(0.0, 0), (0.31, 15), (0.65, 32), (1.11, 55)])
def test_a_seek_gives_what_was_in_force_there(join_memory: Join, recorded: Path, start: float, number: int) -> None:
    here, there = join_memory(), join_memory()
    came = follow(there, "test/**")
    playing = play(here, recorded, paused=True)
    state = PlayerClient(there).seek(start)
    assert state.position == pytest.approx(start)
    assert state.state is Playing.PAUSED
    found = [(key, payload) for key, payload in came.all if key != "test/tf"]
    expected = transform(0 if number < 30 else 30, child="stand")
    statics = [decode(TransformList, payload) for key, payload in found if key == "test/tf_static"]
    assert statics == ([expected] if number else [])
    assert [number_of(p) for key, p in found if key == "test/kinect/points"] == ([number] if number else [])
    moving = [decode(TransformList, payload) for key, payload in came.all if key == "test/tf"]
    if number:
        assert transform(number, stamp_ns=moment(number)) in moving
        assert transform(number + 1, stamp_ns=moment(number + 1)) not in moving
    playing.close()


def test_after_a_seek_it_goes_on_from_there(join_memory: Join, recorded: Path) -> None:
    here, there = join_memory(), join_memory()
    came = follow(there, "test/kinect/points")
    playing = play(here, recorded, paused=True, rate=10)
    control = PlayerClient(there)
    control.seek(1.0)
    control.play()
    assert soon(lambda: control.status().state is Playing.ENDED)
    forward = [number_of(payload) for _, payload in came.all]
    control.seek(0.9)
    assert control.status().state is Playing.PAUSED
    control.play()
    assert soon(lambda: control.status().state is Playing.ENDED)
    back = [number_of(payload) for _, payload in came.all[len(forward) :]]
    playing.close()
    assert forward == list(range(49, COUNT))
    assert back == list(range(44, COUNT))


def test_it_steps_message_by_message(join_memory: Join, recorded: Path) -> None:
    here, there = join_memory(), join_memory()
    came = follow(there, "test/**")
    playing = play(here, recorded, paused=True)
    control = PlayerClient(there)
    for number in range(1, 5):
        assert control.step().sent == number
        assert len(came.all) == number
    assert control.status().position == pytest.approx((moment(1) - START + 1) / 1e9, abs=0.01)
    playing.close()


def test_it_begins_again_in_a_loop_until_told_otherwise(join_memory: Join, recorded: Path) -> None:
    here, there = join_memory(), join_memory()
    came = follow(there, "test/kinect/points")
    playing = play(here, recorded, rate=50, loop=True)
    came.wait(2 * COUNT + 5)
    PlayerClient(there).set_loop(loop=False)
    to_the_end(playing)
    numbers = [number_of(payload) for _, payload in came.all]
    assert numbers == [n % COUNT for n in range(len(numbers))]
    assert len(numbers) % COUNT == 0


@pytest.mark.parametrize(
    ("values", "first", "last"),
    [
        ({"start": 0.4}, 19, 60),
        ({"end": 0.4}, 0, 20),
        ({"start": 0.2, "duration": 0.2}, 9, 20),
        ({"start": 0.2, "end": 0.3}, 9, 15),
    ],
)
def test_a_part_is_played(join_memory: Join, recorded: Path, values: dict[str, float], first: int, last: int) -> None:
    here, there = join_memory(), join_memory()
    came = follow(there, "test/kinect/points")
    to_the_end(play(here, recorded, rate=20, **values))
    assert [number_of(payload) for _, payload in came.all] == list(range(first, last))


def test_keys_are_chosen_and_moved(join_memory: Join, recorded: Path) -> None:
    here, there = join_memory(), join_memory()
    came = follow(there, "**")
    to_the_end(play(here, recorded, rate=50, exclude="^tf$", remap="kinect/points=left/points"))
    assert {key for key, _ in came.all} == {"test/tf_static", "test/left/points"}
    came = follow(there, "**")
    to_the_end(play(here, recorded, rate=50, topics="tf"))
    assert {key for key, _ in came.all} == {"test/tf_static", "test/tf"}


def test_stamps_are_moved_together(join_memory: Join, recorded: Path) -> None:
    here, there = join_memory(), join_memory()
    came = follow(there, "test/**")
    before = Time.now().ns
    to_the_end(play(here, recorded, stamps="now", end=0.1))
    clouds = [decode(PointCloud2, p).header.stamp.ns for key, p in came.all if key == "test/kinect/points"]
    moving = [decode(TransformList, p).transforms[0].header.stamp.ns for key, p in came.all if key == "test/tf"]
    assert before - 10_000_000 < clouds[0] < Time.now().ns
    gaps = [b - a for a, b in itertools.pairwise(clouds)]
    assert all(abs(gap - STEP) < 1_000_000 for gap in gaps)
    assert all(abs(a - b) < 1_000_000 for a, b in zip(clouds, moving, strict=True))


def test_the_clock_is_told(join_memory: Join, recorded: Path) -> None:
    here, there = join_memory(), join_memory()
    came = follow(there, "test/clock")
    to_the_end(play(here, recorded, clock=True, end=0.2))
    times = [decode(Clock, payload).clock.ns for _, payload in came.all]
    assert len(times) >= 3
    assert times == sorted(times)
    assert times[0] in range(START - 10, START + 10)


def test_a_player_says_no_with_its_reason(join_memory: Join, recorded: Path, tmp_path: Path) -> None:
    here, there = join_memory(), join_memory()
    control = PlayerClient(there)
    with pytest.raises(NobodyAnswers):
        control.play()
    (tmp_path / "text.mcap").write_text("no recording at all")
    with running(player.run, here, player.Settings()):
        assert control.status().state is Playing.EMPTY
        with pytest.raises(RequestRefused, match="no recording is open"):
            control.play()
        with pytest.raises(RequestRefused, match="there is no recording"):
            control.open(str(tmp_path / "nothing.mcap"))
        with pytest.raises(RequestRefused, match="no MCAP file"):
            control.open(str(tmp_path / "text.mcap"))
        assert control.open(str(recorded)).duration == pytest.approx(1.18, abs=0.01)
    with pytest.raises(UsageError, match="is empty"):
        play(there, recorded, start=99.0)
    with pytest.raises(UsageError, match="OLD=NEW"):
        player.Player(there, player.Settings(remap="nonsense"))


def test_a_torn_file_is_played_as_far_as_it_goes(join_memory: Join, recorded: Path, tmp_path: Path) -> None:
    (tmp_path / "torn.mcap").write_bytes(recorded.read_bytes()[: recorded.stat().st_size // 2])
    here, there = join_memory(), join_memory()
    came = follow(there, "test/kinect/points")
    state = to_the_end(play(here, tmp_path / "torn.mcap", rate=20))
    assert "without its index" in state.message
    numbers = [number_of(payload) for _, payload in came.all]
    assert 10 < len(numbers) < COUNT
    assert numbers == list(range(len(numbers)))


def test_a_damaged_chunk_is_left_out_and_told(join_memory: Join, recorded: Path, tmp_path: Path) -> None:
    damaged = damage(recorded, 3, tmp_path / "damaged.mcap")
    here, there = join_memory(), join_memory()
    came = follow(there, "test/kinect/points")
    playing = play(here, damaged, rate=20)
    state = to_the_end(playing)
    assert (state.damaged, "is damaged" in state.message) == (1, True)
    assert [number_of(payload) for _, payload in came.all] == [n for n in range(COUNT) if n // 7 != 3]


def test_the_command_says_that_a_chunk_was_left_out(
    join_memory: Join, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("zsight.runtime.join", lambda _: join_memory())
    damaged = str(damage(recorded, 3, tmp_path / "damaged.mcap"))
    told = CliRunner().invoke(bag.app, ["play", damaged, "--rate", "20"])
    assert (told.exit_code, "1 damaged chunks were left out" in told.stderr) == (1, True)
    counted = CliRunner().invoke(bag.app, ["play", damaged, "--rate", "20", "--json"])
    assert (counted.exit_code, json.loads(counted.stdout)["damaged"]) == (1, 1)
    assert CliRunner().invoke(bag.app, ["play", str(recorded), "--rate", "20"]).exit_code == 0


def test_the_command_fails_where_a_bag_cannot_be_read_on(
    join_memory: Join, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = get_typestore(Stores.ROS1_NOETIC)
    path = tmp_path / "a.bag"
    writer = Writer(path)
    writer.set_compression(Writer.CompressionFormat.BZ2)
    with writer as made:
        topic = made.add_connection("/kinect/points", "sensor_msgs/msg/PointCloud2", typestore=store)
        made.write(topic, START, bytes(1000))
    content = bytearray(path.read_bytes())
    content[content.index(b"BZh9") + 10] ^= 0xFF
    path.write_bytes(content)
    monkeypatch.setattr("zsight.runtime.join", lambda _: join_memory())
    told = CliRunner().invoke(bag.app, ["play", str(path), "--rate", "20"])
    assert isinstance(told.exception, UsageError)
    assert "a.bag is damaged" in str(told.exception)


def test_what_no_row_knows_is_sent_as_it_came(join_memory: Join, tmp_path: Path) -> None:
    file = RecordingFile(tmp_path / "a.mcap", "lab", {})
    file.write(sample("elsewhere/key", b"\x01\x02", START))
    file.write(sample("lab/unknown/key", b"\x03", START + 1))
    file.finish()
    here, there = join_memory(), join_memory()
    came = follow(there, "**")
    to_the_end(play(here, tmp_path / "a.mcap"))
    assert came.wait(2) == [("elsewhere/key", b"\x01\x02"), ("test/unknown/key", b"\x03")]


# Keys.


def test_keys_at_a_terminal_control_the_player(join_memory: Join, recorded: Path) -> None:
    bus = join_memory()
    playing = play(bus, recorded, paused=True)
    keyboard, terminal = os.openpty()
    with os.fdopen(terminal, "r+b", buffering=0) as stream, PlayerKeys(playing, cast("TextIO", stream)) as keys:

        def typed(signs: str, happened: Callable[[PlayerState], bool]) -> bool:
            os.write(keyboard, signs.encode())
            return soon(lambda: happened(playing.state()))

        assert typed("++-", lambda state: state.rate == 2.0)
        assert typed("\x1b[C", lambda state: state.position == pytest.approx(1.0))
        assert typed("\x1b[D", lambda state: state.position == 0.0)
        sent = playing.state().sent
        assert typed("x.", lambda state: state.sent > sent)
        assert playing.state().state is Playing.PAUSED
        assert typed(" ", lambda state: state.state in {Playing.PLAYING, Playing.ENDED})
        assert not keys.ended
        assert typed("q", lambda _: keys.ended)
    os.close(keyboard)


def test_keys_that_are_no_terminal_do_nothing(join_memory: Join, recorded: Path) -> None:
    playing = play(join_memory(), recorded, paused=True)
    read, write = os.pipe()
    os.write(write, b"++q")
    with os.fdopen(read) as stream, PlayerKeys(playing, stream) as keys:
        assert not keys.is_on
    os.close(write)
    assert (playing.state().rate, keys.ended) == (1.0, False)
