"""``zsight bag``: recordings."""

from __future__ import annotations

import contextlib
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from zsight.cli.options import Connect, Json, Namespace, network_of
from zsight.cli.output import print_json, print_table, say
from zsight.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from zsight.recording.player import Player
    from zsight_core.scene_limits import SceneLimits
    from zsight_protocol.recording import PlayerState, RecorderState

__all__ = ["app"]

app = typer.Typer(help="Record, play, look into and mend recordings.", no_args_is_help=True, rich_markup_mode=None)

File = Annotated[Path, typer.Argument(metavar="FILE", help="A recording: .mcap, .bag, or a folder.")]


@app.command()
def record(
    keys: Annotated[
        list[str] | None,
        typer.Argument(metavar="[KEY]...", help="Key expressions; everything of the cell if not given."),
    ] = None,
    output: Annotated[
        str, typer.Option("--output", "-o", metavar="FILE", help="The file; named after the time if not given.")
    ] = "",
    include: Annotated[str, typer.Option("--include", metavar="REGEX", help="Only keys that contain this.")] = "",
    exclude: Annotated[str, typer.Option("--exclude", metavar="REGEX", help="No keys that contain this.")] = "",
    duration: Annotated[float | None, typer.Option("--duration", help="Stop after so many seconds.")] = None,
    compression: Annotated[str, typer.Option("--compression", help="auto, none, lz4 or zstd.")] = "auto",
    depth_coded: Annotated[
        bool, typer.Option("--depth-coded", help="Depth cameras' clouds as images, where they come back within 0.1 mm.")
    ] = False,
    split_size: Annotated[float, typer.Option("--split-size", help="Another file after so many MiB.")] = 0,
    split_time: Annotated[float, typer.Option("--split-time", help="Another file after so many seconds.")] = 0,
    keep: Annotated[int, typer.Option("--keep", help="Keep only the last so many files.")] = 0,
    on_full: Annotated[
        str, typer.Option("--on-full", help="When the disk is full: stop, wait for room, or drop the oldest file.")
    ] = "stop",
    reserve: Annotated[float, typer.Option("--reserve", help="MiB of the disk that are left free.")] = 64,
    ring: Annotated[
        float, typer.Option("--ring", help="Keep so many seconds in memory, and write when triggered.")
    ] = 0,
    after: Annotated[float, typer.Option("--after", help="Seconds that are recorded after a trigger.")] = 5,
    trigger_key: Annotated[str, typer.Option("--trigger-key", help="Trigger on a message of this key.")] = "",
    trigger_failed_find: Annotated[
        bool, typer.Option("--trigger-failed-find", help="Trigger when a find ends without the object.")
    ] = False,
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Record until Ctrl-C; exit code 1 where messages were lost."""
    from zsight.recording import recorder
    from zsight.runtime import join
    from zsight.settings import parse

    values = {
        "start": not ring, "keys": " ".join(keys or ()), "include": include, "exclude": exclude,
        "compression": compression, "depth_coded": depth_coded, "split_size": split_size, "split_time": split_time, "keep": keep,
        "on_full": on_full, "reserve": reserve, "ring": ring, "after": after, "trigger_key": trigger_key,
        "trigger_failed_find": trigger_failed_find, "name": "command",
    }  # fmt: skip
    settings = parse(recorder.Settings, values)
    with join(network_of(connect, namespace)) as bus:
        taking = recorder.Recorder(bus, settings)
        try:
            if not ring:
                say(f"recording to {taking.start(output).path}; stop with Ctrl-C")
            with _until_told(), _line() as line:
                ends = None if duration is None else time.monotonic() + duration
                while ends is None or time.monotonic() < ends:
                    bus.stopping.wait(0.25 if ends is None else max(min(0.25, ends - time.monotonic()), 0.0))
                    taking.beat()
                    state = taking.state()
                    line(_recording_words(state))
                    if not ring and state.state.value == "idle":
                        break
        finally:
            taking.close()
        state = taking.state()
    if json:
        print_json(state.model_dump(mode="json", exclude={"header", "ok"}))
    else:
        _say_recorded(state)
    raise typer.Exit(1 if state.lost else 0)


@contextlib.contextmanager
def _until_told() -> Iterator[None]:
    """Ctrl-C, a request to end and a terminal that is closed are no failure here."""
    import signal

    from zsight.stop_signals import stop_signals

    def interrupt(number: int, _: object) -> None:
        if number == signal.SIGHUP:  # which the shell and the system both send: the second one must end nothing
            signal.signal(number, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in stop_signals()}
    try:
        with contextlib.suppress(KeyboardInterrupt):
            yield
    finally:
        for number, handler in before.items():
            if signal.getsignal(number) is interrupt:
                signal.signal(number, handler)


@contextlib.contextmanager
def _line() -> Iterator[Any]:
    """A line on stderr that is written anew, at a terminal only."""
    is_terminal = sys.stderr.isatty()

    def show(words: str) -> None:
        if is_terminal:
            sys.stderr.write(f"\r\x1b[K{words}")
            sys.stderr.flush()

    yield show
    show("")


def _recording_words(state: RecorderState) -> str:
    if state.state.value == "armed":
        return f"waiting for a trigger, {state.in_memory:.1f} s in memory"
    lost = f", {state.lost} LOST" if state.lost else ""
    return (
        f"{state.seconds:6.1f} s  {state.messages} messages  {_size(state.bytes_written)}  "
        f"{state.bytes_per_second / 1e6:.1f} MB/s ({state.compression}){lost}  {_size(state.disk_free)} left"
        + (f"  {state.message}" if state.message else "")
    )


def _say_recorded(state: RecorderState) -> None:
    if not state.path:
        say("nothing was recorded")
        return
    files = f" and {state.files - 1} before it" if state.files > 1 else ""
    say(f"{state.path}{files}: {state.messages} messages in {state.seconds:.1f} s, {_size(state.bytes_written)}")
    for loss in state.losses:
        say(f"  {loss.lost} of {loss.key} are not in it")
    if state.message:
        say(state.message)


def _size(number: float) -> str:
    for unit in ("B", "KiB", "MiB"):
        if number < 1024:
            return f"{number:.0f} {unit}" if unit == "B" else f"{number:.1f} {unit}"
        number /= 1024
    return f"{number:.1f} GiB"


@app.command()
def play(
    file: File,
    rate: Annotated[float, typer.Option("--rate", help="Times as fast as it was recorded.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", help="Begin again after the end.")] = False,
    start: Annotated[float, typer.Option("--start", help="Start so many seconds from the beginning.")] = 0.0,
    end: Annotated[float | None, typer.Option("--end", help="End so many seconds from the beginning.")] = None,
    duration: Annotated[float | None, typer.Option("--duration", help="End so many seconds after the start.")] = None,
    paused: Annotated[bool, typer.Option("--pause", help="Wait to be told to play.")] = False,
    topics: Annotated[str, typer.Option("--topics", metavar="REGEX", help="Only keys that contain this.")] = "",
    exclude: Annotated[str, typer.Option("--exclude", metavar="REGEX", help="No keys that contain this.")] = "",
    remap: Annotated[
        list[str] | None, typer.Option("--remap", metavar="OLD=NEW", help="Send a key or topic on another key.")
    ] = None,
    clock: Annotated[bool, typer.Option("--clock", help="Tell the recording's time on the key clock.")] = False,
    stamps: Annotated[str, typer.Option("--stamps", help="Stamps of messages: kept, or moved to now.")] = "kept",
    housekeeping: Annotated[
        bool, typer.Option("--housekeeping", help="Send health and other keys that begin with @ as well.")
    ] = False,
    name: Annotated[str, typer.Option("--name", help="Name of the player in the keys.")] = "player",
    json: Json = False,
    connect: Connect = None,
    namespace: Namespace = None,
) -> None:
    """Send a recording as if it were live; exit code 1 where damaged parts of it were left out.

    At a terminal: space pauses and goes on, . sends the next message, the arrow keys seek by 1 and 10 seconds, + and -
    change the rate, q ends. Programs do the same by requests.
    """
    from zsight.cli.player_keys import PlayerKeys
    from zsight.recording import player
    from zsight.runtime import join
    from zsight.settings import parse

    values = {
        "name": name, "rate": rate, "loop": loop, "start": start, "end": end, "duration": duration, "paused": paused,
        "topics": topics, "exclude": exclude, "remap": " ".join(remap or ()), "clock": clock, "stamps": stamps,
        "housekeeping": housekeeping,
    }  # fmt: skip
    settings = parse(player.Settings, values)
    with join(network_of(connect, namespace)) as bus:
        playing = player.Player(bus, settings)
        try:
            playing.open(str(file))
            with _until_told(), _line() as line, PlayerKeys(playing) as keys:
                _watch(playing, keys, line)
            state = playing.state()
        finally:
            playing.close()
    if json:
        print_json(state.model_dump(mode="json", exclude={"header", "ok"}))
    else:
        say(f"{state.sent} messages sent; {state.late_p99_ms:.2f} ms late at most, but for 1 % of them")
        if state.skipped:
            say(f"{state.skipped} messages were not sent: {state.message or 'we have no message of their type'}")
        if state.damaged:
            say(f"{state.damaged} damaged chunks were left out; mend it with: zsight bag recover {file}")
    raise typer.Exit(1 if state.damaged else 0)


def _watch(playing: Player, keys: Any, line: Any) -> None:
    """Until the end of the recording, or until somebody says so."""
    while True:
        playback = playing.playback
        if playback is None or keys.ended:
            return
        has_ended = playback.wait_ended(0.1)
        if playback.error is not None:
            raise playback.error
        if has_ended and not keys.is_on:
            return
        line(_playing_words(playing.state()))
        playing.tell()


def _playing_words(state: PlayerState) -> str:
    width = 30
    done = int(width * min(state.position / state.duration, 1.0)) if state.duration else width
    bar = "=" * done + " " * (width - done)
    return f"[{bar}] {state.position:.1f} of {state.duration:.1f} s, {state.state.value}, rate {state.rate:g}"


@app.command()
def info(file: File, json: Json = False) -> None:
    """What is in a recording."""
    from zsight.recording.about import about

    report = about(file)
    if json:
        print_json(report)
        return
    rows: list[tuple[str, object]] = [
        ("file", report["file"]),
        ("size", _size(report["size"])),
        ("made by", report["library"] or "-"),
        ("begins", report["begins"]),
        ("lasts", f"{report['seconds']:.3f} s"),
        ("messages", report["messages"]),
        ("compression", ", ".join(f"{name} ({n} chunks)" for name, n in report["compression"].items()) or "-"),
    ]
    print_table((), rows)
    print_table(
        ("key", "type", "messages", "Hz", "source"),
        [(t["key"], t["type"], t["messages"], f"{t['hz']:.1f}", t["source"]) for t in report["topics"]],
    )
    for source, count in report["skipped"].items():
        say(f"{count} messages of {source} cannot be played: we have no message of that type")
    for key, count in report["losses"].items():
        say(f"{count} messages of {key} came and could not be written")
    if report["damage"]:
        say(f"DAMAGED: {report['damage']}. It can be played as it is; mend it with: zsight bag recover {file}")


Target = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The new file.")]
Compression = Annotated[
    str | None, typer.Option("--compression", help="none, lz4 or zstd; that of the source if not given.")
]


@app.command()
def recover(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="An .mcap file that its writer did not close.")],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FILE", help="NAME.recovered.mcap if not given.")
    ] = None,
    compression: Compression = None,
    json: Json = False,
) -> None:
    """Make a good file of a torn one; the torn one stays as it is."""
    from zsight.recording.mcap_copy import copy

    target = output or file.with_name(f"{file.stem}.recovered.mcap")
    with _progress() as say_share:
        copied = copy([file], target, compression=compression, walk=True, say=say_share)
    report = {"file": str(target), "messages": copied.messages, "damage": copied.damage}
    if json:
        print_json(report)
        return
    for words in copied.damage:
        say(words)
    say(f"{target}: {copied.messages} messages")


@app.command()
def check(file: Annotated[Path, typer.Argument(metavar="FILE", help="An .mcap file.")], json: Json = False) -> None:
    """Whether a recording is sound; exit code 1 where it is not."""
    from zsight.recording.checking import check as check_file

    report = check_file(file)
    if json:
        print_json(report)
    else:
        for words in report["errors"]:
            say(words)
        for topic, count in report["gaps"].items():
            say(f"{count} messages of {topic} are not in it")
        say(
            f"{report['messages']} messages in {report['chunks']} chunks: {'sound' if report['sound'] else 'NOT SOUND'}"
        )
    raise typer.Exit(0 if report["sound"] else 1)


@app.command()
def cut(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="An .mcap file.")],
    output: Target,
    start: Annotated[float | None, typer.Option("--start", help="Seconds from the beginning.")] = None,
    end: Annotated[float | None, typer.Option("--end", help="Seconds from the beginning.")] = None,
    topics: Annotated[str, typer.Option("--topics", metavar="REGEX", help="Only keys that contain this.")] = "",
    exclude: Annotated[str, typer.Option("--exclude", metavar="REGEX", help="No keys that contain this.")] = "",
    compression: Compression = None,
    json: Json = False,
) -> None:
    """A part of a recording as a file of its own, which begins with what was in force there."""
    from zsight.recording.mcap_copy import Part
    from zsight.recording.mcap_file import McapFile

    with McapFile.open(file) as opened:
        first, last = opened.statistics.start, opened.statistics.end
    times = [None if seconds is None else first + int(seconds * 1e9) for seconds in (start, end)]
    begin, stop = first if times[0] is None else times[0], last + 1 if times[1] is None else times[1]
    if max(begin, first) >= min(stop, last + 1):
        raise UsageError(f"the part from {start or 0:g} s on is empty: {file} is {(last - first) / 1e9:.3f} s long")
    _copy([file], output, Part(times[0], times[1], topics, exclude), compression, json)


@app.command()
def merge(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help=".mcap files.")],
    output: Target,
    compression: Compression = None,
    json: Json = False,
) -> None:
    """Several recordings as one, in the order of time."""
    _copy(files, output, None, compression, json)


def _copy(files: list[Path], output: Path, part: Any, compression: str | None, json: bool) -> None:
    from zsight.recording.mcap_copy import copy

    with _progress() as say_share:
        copied = copy(files, output, part=part, compression=compression, say=say_share)
    if json:
        print_json({"file": str(output), "messages": copied.messages, "damage": copied.damage})
        return
    for words in copied.damage:
        say(words)
    say(f"{output}: {copied.messages} messages")


@app.command()
def convert(
    file: File,
    output: Target,
    compression: Compression = None,
    namespace: Annotated[str, typer.Option("--namespace", help="Of the keys in the new file.")] = "zsight",
    json: Json = False,
) -> None:
    """A recording of any kind as an MCAP file of a cell: topics become keys, depth images clouds."""
    from zsight.recording.conversion import convert as convert_file

    with _progress() as say_share:
        count, left = convert_file(file, output, namespace=namespace, compression=compression, say=say_share)
    if json:
        print_json({"file": str(output), "messages": count, "left_out": left})
        return
    for source, number in left.items():
        say(f"{number} messages of {source} are left out: we have no message of that type, or they are damaged")
    say(f"{output}: {count} messages")


@app.command()
def export(
    file: File,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="FOLDER", help="Where the files go.")],
    kind: Annotated[str, typer.Option("--to", help="pcd, ply, rgbd (image pairs), or mcap (plain clouds).")] = "pcd",
    key: Annotated[str, typer.Option("--key", help="Only clouds on this key, without namespace.")] = "",
    force: Annotated[bool, typer.Option("--force", help="Overwrite clouds that are there.")] = False,
    json: Json = False,
) -> None:
    """Every cloud of a recording as a file of its own; exit code 1 where some cannot be."""
    from zsight.recording.export import export as export_clouds

    with _progress() as say_share:
        count, left = export_clouds(file, output, kind, key=key, overwrite=force, say=say_share)
    if json:
        print_json({"output": str(output), "written": count, "left_out": left})
    else:
        for words, number in left.items():
            say(f"{number} times {words}")
        say(f"{output}: {count} {'messages' if kind == 'mcap' else 'clouds'}")
    raise typer.Exit(1 if left else 0)


@app.command()
def rerun(
    file: File,
    catalogue: Annotated[
        Path | None, typer.Option("--catalogue", metavar="FOLDER", help="Folder of further object types.")
    ] = None,
    tolerance_mm: Annotated[float, typer.Option("--tolerance-mm", help="How far an object may have moved.")] = 5.0,
    tolerance_deg: Annotated[float, typer.Option("--tolerance-deg", help="How far it may have turned.")] = 5.0,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Try it with another setting of the finder; may be repeated."),
    ] = None,
    json: Json = False,
) -> None:
    """Every recorded goal once more against its own cloud, with today's code; exit code 1 on regressions."""
    from zsight.catalogue import type_files
    from zsight.recording.rerun import Tolerance
    from zsight.recording.rerun import rerun as run_again

    folders = [type_files.shipped_folder(), *([catalogue] if catalogue is not None else [])]
    types = type_files.load(*folders)
    with _line() as line:
        rows = run_again(
            file,
            types,
            tolerance=Tolerance(tolerance_mm, tolerance_deg),
            limits=_tried(settings or []),
            say=lambda _, share: line(f"{share:.0%}"),
        )
    regressions = sum(bool(row["regression"]) for row in rows)
    if json:
        print_json({"file": str(file), "goals": rows, "regressions": regressions})
    elif rows:
        headings = ("type", "then", "now", "moved (mm)", "turned (deg)", "score", "ms then", "ms now", "new", "")
        print_table(headings, [_rerun_row(row) for row in rows])
    if not rows:
        raise UsageError(f"{file} holds no goal with its answer and its cloud: record all keys of the cell")
    raise typer.Exit(1 if regressions else 0)


def _tried(settings: list[str]) -> SceneLimits:
    """What counts as a thing, with settings of the finder that are to be tried.

    Raises:
        UsageError: a name is unknown, does not matter here, or a value is out of range.
    """
    from dataclasses import asdict

    from zsight.finder import Settings
    from zsight.settings import parse
    from zsight_core.scene_limits import SceneLimits

    chosen = dict(setting.partition("=")[::2] for setting in settings)
    if idle := sorted(set(chosen) - set(asdict(SceneLimits()))):
        known = ", ".join(asdict(SceneLimits()))
        raise UsageError(f"--set {idle[0]} changes no answer of a recording; what does: {known}, as NAME=VALUE")
    return parse(Settings, chosen).limits()


def _rerun_row(row: dict[str, Any]) -> tuple[object, ...]:
    then = "-" if row["ms_then"] is None else f"{row['ms_then']:.0f}"
    differences = [f"{row[name]:.2f}" if name in row else "-" for name in ("moved_mm", "turned_deg", "score_change")]
    others = (then, f"{row['ms_now']:.0f}", row.get("new", "-"))
    return (row["object_type"], row["then"], row["now"], *differences, *others, row["regression"])


@contextlib.contextmanager
def _progress() -> Iterator[Any]:
    """A share that is done, written anew at a terminal."""
    with _line() as line:
        yield lambda share: line(f"{share:.0%}")
