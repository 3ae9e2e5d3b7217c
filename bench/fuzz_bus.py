"""Mutated messages over all channels at a cell of real services: nothing may fall, grow, hang or go uncounted.

A router, the voxel, planes and finder services as ``zsight run`` starts them, and a process that reads every channel.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from bench_row import print_rows, row
from bus_processes import _tell, cell, member
from hypothesis import Phase, given, settings

from zsight_protocol.channels import CHANNELS, Cell, Delivery

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # the tests know how to draw every legal message

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

    from zsight.bus import Bus
    from zsight.network import Network
    from zsight_protocol.message import Message

_HOST = "bench"  # what the services take for the name of this host
_READ = {
    "*/points": "kinect/points",
    "*/camera_info": "kinect/camera_info",
    "*/selected_points": "kinect/selected_points",
    "find_object/*": "find_object/finder",
    "find_object/*/cancel": "find_object/finder/cancel",
    "find_object/*/result": "find_object/finder/result",
    "catalog/*": "catalog/toy_block",
    "param/*/*": f"param/{_HOST}/voxel",
}
"""What services read or answer, by pattern."""
_LEGAL = 20  # legal messages of a kind, of which mutated ones are made
_SERVICES = ("router", "voxel", "planes", "finder")
_START = 90.0  # seconds for the services to be ready
_PATIENCE = 10.0  # seconds within which every request must end
_REVEAL = 0.5  # seconds without a message after which one more is sent on the channels that may drop one
_UNNUMBERED = 0.05  # share of messages whose attachment is mutated, where none is dropped
_AT_ONCE = 200  # messages between two looks whether the reader of all channels keeps up


def run(messages: int = 100_000, seed: int = 0) -> list[dict[str, Any]]:
    """Rows as ``zsight bench --json`` prints them."""
    from zsight.runtime import join

    network = cell()
    with ExitStack() as stack:
        services = _start(stack, network)
        bus = stack.enter_context(join(network, wait=_START))
        _wait_for(bus, len(services))
        tally = stack.enter_context(member(read_everything, network))
        fuzzer = _Fuzzer(bus, random.Random(seed), tally)  # noqa: S311  mutations are no secret
        fuzzer.fire(messages // 20)
        before = {name: _resident(process.pid) for name, process in services.items()} | {"reader": tally.resident()}
        fuzzer.fire(messages - messages // 20)
        fuzzer.settle()
        alive = {name: process.poll() is None for name, process in services.items()} | {
            "reader": tally.process.is_alive()
        }
        grown = {name: _resident(process.pid) - before[name] for name, process in services.items() if alive[name]}
        grown["reader"] = tally.resident() - before["reader"]
        counted = tally.figures()
    return _rows(fuzzer, alive, grown, counted)


def _rows(
    fuzzer: _Fuzzer, alive: dict[str, bool], grown: dict[str, int], counted: dict[str, Any]
) -> list[dict[str, Any]]:
    total = {kind: sum(c[kind] for c in counted.values()) for kind in ("received", "superseded", "lost", "refused")}
    figures = [
        ("processes that fell", sum(not lives for lives in alive.values()), "", 0.0),
        ("requests without an end", fuzzer.hung, f"of {fuzzer.asked}", 0.0),
        ("messages not accounted for", abs(fuzzer.sent - sum(total.values())), f"of {fuzzer.sent}", 0.0),
        ("greatest growth of a process", max(grown.values()) / 2**20, "MiB", 8.0),
    ]
    about = {"fates": total, "growth_mib": {name: round(size / 2**20, 2) for name, size in grown.items()}}
    return [row(*figure, **about) for figure in figures]


def _start(stack: ExitStack, network: Network) -> dict[str, subprocess.Popen[bytes]]:
    settings_folder = stack.enter_context(TemporaryDirectory())  # what a mutated request saves is gone with it
    own = {"ZSIGHT_HOST": _HOST, "XDG_CONFIG_HOME": settings_folder}
    environment = os.environ | network.environment() | own
    services = {}
    for name in _SERVICES:
        command = [sys.executable, "-m", "zsight", "run", name]
        process = subprocess.Popen(command, env=environment, stderr=subprocess.DEVNULL)
        stack.callback(process.wait)
        stack.callback(process.terminate)
        services[name] = process
    return services


def _wait_for(bus: Bus, services: int) -> None:
    deadline = time.monotonic() + _START
    while len(bus.link.alive(bus.cell.alive("*", "*"), 1.0)) < services:
        if time.monotonic() > deadline:
            raise TimeoutError(f"the services are not ready after {_START:g} s")
        time.sleep(0.1)


def _resident(pid: int) -> int:
    words = Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()
    return (int(words[1]) - int(words[2])) * 4096


def read_everything(pipe: Connection, network: Network) -> None:
    """Reads every channel that is not asked; tells what each reader counted, by pattern."""
    from zsight.runtime import join

    bus = join(network)
    readers = {}
    for channel in CHANNELS:
        if channel.message is not None and channel.delivery is not Delivery.REQUEST:
            reader = bus.reader(_key(bus.cell, channel.pattern), channel.message, delivery=channel.delivery)
            readers[channel.pattern] = reader
            threading.Thread(target=lambda reader=reader: [None for _ in reader], daemon=True).start()
    _tell(pipe, lambda: {name: reader.counter.health().model_dump() for name, reader in readers.items()})
    threading.Event().wait()


def _key(cell: Cell, pattern: str) -> str:
    """Where the services read it; a name of its own for what they write, so that only what is sent here is counted."""
    return f"{cell.namespace}/{_READ.get(pattern, pattern.replace('*', 'fuzz'))}"


class _Fuzzer:
    def __init__(self, bus: Bus, rng: random.Random, tally: Any) -> None:
        self.sent = self.asked = self.hung = 0
        self._bus, self._rng, self._tally = bus, rng, tally
        self._legal = {channel.pattern: _legal(channel.message) for channel in CHANNELS if channel.message is not None}
        self._channels = [channel for channel in CHANNELS if channel.message is not None]
        self._writers: dict[str, Any] = {}
        self._sequences: dict[str, int] = {}
        self._open: list[tuple[Any, float]] = []

    def fire(self, messages: int) -> None:
        for number in range(messages):
            channel = self._channels[number % len(self._channels)]
            payload = mutated(self._rng.choice(self._legal[channel.pattern]), self._rng)
            if channel.delivery is Delivery.REQUEST:
                self._ask(_key(self._bus.cell, channel.pattern), payload)
            else:
                # What has no number cannot be missed: none where the network may drop a message.
                numbered = channel.delivery is Delivery.LATEST or self._rng.random() >= _UNNUMBERED
                self._put(channel.pattern, channel.delivery, payload, numbered=numbered)
            if number % _AT_ONCE == 0:
                self.settle()

    def _put(self, pattern: str, delivery: Delivery, payload: bytes, *, numbered: bool = True) -> None:
        from zsight.bus.attachment import Attachment

        if pattern not in self._writers:
            self._writers[pattern] = self._bus.link.writer(_key(self._bus.cell, pattern), delivery)
            while not self._writers[pattern].has_readers():
                time.sleep(0.01)
        sequence = self._sequences[pattern] = self._sequences.get(pattern, 0) + numbered
        attachment = Attachment(hash(pattern) % 2**64, sequence, time.time_ns()).pack()
        if not numbered:
            attachment = mutated(attachment, self._rng)
            attachment = attachment if len(attachment) != 24 else attachment[:-1]
        self._writers[pattern].put(payload, b"", attachment)
        self.sent += 1

    def _ask(self, key: str, payload: bytes) -> None:
        self.asked += 1
        self._open.append((self._bus.ask(key, payload, _PATIENCE), time.monotonic()))

    def settle(self) -> None:
        """Wait until every request has ended and the reader of all channels has caught up."""
        from zsight.errors import ZsightError

        for replies, since in self._open:
            try:
                replies.take(since + _PATIENCE - time.monotonic())
            except TimeoutError:
                self.hung += 1
            except ZsightError:
                pass  # refused with words: an end like any other
            replies.close()
        self._open.clear()
        self._wait_until_counted()

    def _wait_until_counted(self) -> None:
        deadline, patience = time.monotonic() + _PATIENCE, time.monotonic() + _REVEAL
        while self._uncounted() and time.monotonic() < deadline:
            if time.monotonic() > patience:
                self._reveal()
                patience = time.monotonic() + _REVEAL
            time.sleep(0.005)

    def _uncounted(self) -> int:
        counts = self._tally.figures().values()
        return self.sent - sum(c["received"] + c["superseded"] + c["lost"] + c["refused"] for c in counts)

    def _reveal(self) -> None:
        """One more message where the network may have dropped the last: a gap shows when the next one comes."""
        for channel in self._channels:
            if channel.delivery is Delivery.LATEST and channel.pattern in self._writers:
                self._put(channel.pattern, channel.delivery, self._legal[channel.pattern][0])


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Some bytes changed, cut out, put in or repeated."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 4, 16))):
        at = rng.randrange(len(changed) + 1)
        kind = rng.randrange(5)
        if kind == 0 and at < len(changed):
            changed[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            changed[at : at + 1] = bytes([rng.choice((0, 1, 0x7F, 0x80, 0xC0, 0xC6, 0xDD, 0xDF, 0xFF))])
        elif kind == 2:
            del changed[at : at + rng.randrange(1, 9)]
        elif kind == 3:
            changed[at:at] = rng.randbytes(rng.randrange(1, 9))
        else:
            changed[at:at] = changed[at : at + rng.randrange(1, 33)]
    return bytes(changed)


def _legal(kind: type[Message]) -> list[bytes]:
    """The bytes of some legal messages of a kind, drawn as the tests of the protocol draw them."""
    from tests.protocol.legal_messages import messages

    from zsight_protocol.action import new_goal_id
    from zsight_protocol.codec import encode
    from zsight_protocol.find_object import FindObjectGoal

    if kind is FindObjectGoal:  # one that ends soon
        return [encode(FindObjectGoal(goal_id=new_goal_id(), object_type="toy_block", timeout=0.05))]
    drawn: list[bytes] = []

    @settings(max_examples=_LEGAL, derandomize=True, database=None, phases=[Phase.generate], deadline=None)
    @given(messages(kind))
    def draw(message: Message) -> None:
        drawn.append(encode(message))

    draw()
    return drawn


def main() -> None:
    """Print the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", action="store_true", help="one JSON object on stdout")
    parser.add_argument("--messages", type=int, default=100_000)
    arguments = parser.parse_args()
    started = time.monotonic()
    rows = run(arguments.messages)
    if arguments.json:
        print(json.dumps({"rows": rows}))
        return
    print_rows(rows)
    print(rows[0]["fates"], rows[0]["growth_mib"], f"{time.monotonic() - started:.0f} s")


if __name__ == "__main__":
    main()
