"""What a program gets from the client: answers, errors, and one answer of many finders."""

from __future__ import annotations

import asyncio
import threading
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from tests.services.gated_work import Gated, result
from tests.services.told_health import tell_health
from tests.services.waiting import soon

from zsight.action.server import ActionServer, Policy
from zsight.async_client import AsyncCellClient
from zsight.catalogue.server import serve_catalogue
from zsight.catalogue.type_files import load, shipped_folder
from zsight.client import CellClient, Cloud, answer_of
from zsight.convert import cloud_from_points
from zsight.errors import (
    DeadlinePassed,
    GoalCancelled,
    NobodyAnswers,
    RequestRefused,
    ServerBusy,
    UsageError,
    ZsightError,
)
from zsight.merging import MergedAnswer, merge
from zsight_core.points import from_xyz, xyz
from zsight_protocol.action import GoalState, Update, new_goal_id
from zsight_protocol.find_object import DetectedObject, FindObjectGoal, FindObjectResult, ResultCode, Status
from zsight_protocol.geometry import Point, Pose
from zsight_protocol.message import Header, Time
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from zsight.bus import Bus
    from zsight.bus.link import RawRequest

    Join = Callable[[], Bus]


def final(answer: FindObjectResult | None, state: GoalState = GoalState.SUCCEEDED) -> Update[FindObjectResult]:
    return Update[FindObjectResult](goal_id=new_goal_id(), state=state, final=True, result=answer)


# Errors.


@pytest.mark.parametrize(
    ("code", "state", "error", "exit_code"),
    [
        (ResultCode.CODE_NOT_RECOGNISED, GoalState.REJECTED, RequestRefused, 2),
        (ResultCode.BUSY, GoalState.REJECTED, ServerBusy, 3),
        (ResultCode.CANCELLED, GoalState.CANCELLED, GoalCancelled, 5),
        (ResultCode.CANCELLED, GoalState.ABORTED, GoalCancelled, 5),
        (ResultCode.NOT_FOUND, GoalState.CANCELLED, GoalCancelled, 5),
    ],
)
def test_codes_become_errors(code: ResultCode, state: GoalState, error: type[ZsightError], exit_code: int) -> None:
    with pytest.raises(error, match="because") as caught:
        answer_of(final(result("because", code), state))
    assert caught.value.exit_code == exit_code


@pytest.mark.parametrize("code", [ResultCode.FOUND, ResultCode.NOT_FOUND])
def test_answers_are_no_errors(code: ResultCode) -> None:
    answer = result("words", code)
    assert answer_of(final(answer)) is answer


def test_a_deadline_and_no_result_are_errors() -> None:
    late = result("late", ResultCode.NOT_FOUND).model_copy(update={"deadline_passed": True})
    with pytest.raises(DeadlinePassed) as caught:
        answer_of(final(late, GoalState.ABORTED))
    assert caught.value.known is late
    with pytest.raises(RequestRefused, match="aborted without a result"):
        answer_of(final(None, GoalState.ABORTED))


# Many finders.


def box(x: float, score: float, size: tuple[float, float, float] = (0.1, 0.2, 0.05)) -> DetectedObject:
    return DetectedObject(
        type="crate",
        score=score,
        pose=Pose(position=Point(x=x)),
        size=size,
        covariance=(0.0,) * 36,
        visible_fraction=1.0,
    )


def said(finder: str, *objects: DetectedObject) -> FindObjectResult:
    return FindObjectResult(
        header=Header(), code=ResultCode.FOUND, status=Status.FOUND, finder=finder, objects=tuple(objects)
    )


def test_answers_on_one_place_are_one_object() -> None:
    merged = merge([said("a", box(0.0, 0.6)), said("b", box(0.02, 0.9), box(1.0, 0.5))])
    assert [(m.finder, m.best.score, [name for name, _ in m.others]) for m in merged] == [
        ("b", 0.9, ["a"]),
        ("b", 0.5, []),
    ]
    assert [m.disagreement_m for m in merged] == pytest.approx([0.02, 0.0])


def test_one_finder_tells_its_own_objects_apart() -> None:
    merged = merge([said("a", box(0.0, 0.6), box(0.02, 0.9))])
    assert [m.best.score for m in merged] == [0.9, 0.6]


def test_what_is_farther_than_half_an_edge_is_another() -> None:
    assert len(merge([said("a", box(0.0, 0.6)), said("b", box(0.026, 0.9))])) == 2
    assert merge([]) == ()


def test_who_did_not_find_it_is_told_and_who_could_not_tell_is_not() -> None:
    blind = said("c").model_copy(update={"status": Status.CANNOT_TELL})
    no = said("b").model_copy(update={"status": Status.NOT_FOUND})
    (thing,) = merge([said("a", box(0.0, 0.9)), no, blind])
    assert thing.denied == ("b",)
    assert MergedAnswer((thing,), (no, blind)).status is Status.NOT_FOUND
    assert MergedAnswer((), (blind,)).status is Status.CANNOT_TELL


def test_answers_in_different_frames_are_never_joined() -> None:
    elsewhere = said("b", box(0.0, 0.9)).model_copy(update={"header": Header(frame_id="attic")})
    merged = merge([said("a", box(0.0, 0.6)), elsewhere])
    assert [(m.finder, m.frame_id, m.denied) for m in merged] == [("b", "attic", ()), ("a", "", ())]


class Finders:
    """Some finders, each with its own work, and a client."""

    def __init__(self, join: Join, *names: str) -> None:
        self.works = {name: Gated() for name in names}
        self.servers = {}
        self.buses: dict[str, Bus] = {}
        for name, work in self.works.items():
            bus = join()
            self.buses[name] = bus
            self.servers[name] = ActionServer(bus, name, FindObjectGoal, work, Policy(1, 0))
        self.client = CellClient(join())

    def close(self) -> None:
        for name, server in self.servers.items():
            self.works[name].gate.set()
            server.close()


@pytest.fixture
def finder(join_memory: Join) -> Iterator[Finders]:
    finders = Finders(join_memory, "finder")
    yield finders
    finders.close()


def test_any_finder_answers_without_its_name(finder: Finders) -> None:
    finder.works["finder"].gate.set()
    assert finder.client.find("cube").message == "done"
    with pytest.raises(NobodyAnswers, match="find_object/other"):
        finder.client.find("cube", finder="other")


def test_updates_are_handed_out_on_the_way(finder: Finders) -> None:
    stages: list[str] = []

    def note(update: Update[FindObjectResult]) -> None:
        stages.append(update.stage)
        if update.stage == "waiting":
            finder.works["finder"].gate.set()

    finder.client.find("cube", on_update=note)
    assert "waiting" in stages


def test_an_id_that_no_goal_can_have_is_told(finder: Finders) -> None:
    for ask in (finder.client.results, finder.client.cancel):
        with pytest.raises(UsageError, match="no goal is called mug"):
            ask("mug")


def test_a_number_is_asked_for_as_its_text_is(finder: Finders, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    monkeypatch.setattr(Gated, "refuse", lambda _, goal: asked.append(goal.object_type))
    finder.works["finder"].gate.set()
    assert finder.client.find(1000).message == "done"
    assert asked == ["1000"]


def test_a_goal_is_cancelled_by_its_call_and_by_its_id(finder: Finders) -> None:
    for cancel_it in (
        lambda c: c.cancel(),
        lambda c: finder.client.cancel(c.goal_id),
        lambda _: finder.client.cancel(),
    ):
        call = finder.client.start_find("cube")
        assert any(update.stage == "waiting" for update in call)
        cancel_it(call)
        with pytest.raises(GoalCancelled):
            answer_of(call.wait())
    assert {update.state for update in finder.client.results()} == {GoalState.CANCELLED}


@pytest.fixture
def two(join_memory: Join) -> Iterator[Finders]:
    """Two finders, each with room for one goal, known by their health."""
    finders = Finders(join_memory, "left", "right")
    for name, bus in finders.buses.items():
        tell_health(bus, name)
    yield finders
    finders.close()


def test_all_finders_are_asked_and_who_is_silent_is_told(two: Finders) -> None:
    two.works["left"].gate.set()
    two.works["left"].answer = said("left", box(0.0, 0.9))
    two.works["right"].answer = said("right", box(0.01, 0.8))
    two.works["right"].gate.set()
    (thing,) = two.client.find_all("crate")
    assert (thing.finder, [name for name, _ in thing.others]) == ("left", ["right"])
    two.works["right"].gate.clear()
    answer = two.client.find_all("crate", timeout=0.3)
    assert [thing.finder for thing in answer] == ["left"]
    assert "deadline" in answer.silent["right"]


@pytest.mark.parametrize("twin", ["sync", "async"])
def test_a_busy_or_lost_finder_is_replaced_by_another(two: Finders, twin: str) -> None:
    def find(**options: Any) -> FindObjectResult:
        if twin == "sync":
            return two.client.find("cube", **options)
        return asyncio.run(AsyncCellClient(two.client).find("cube", **options))

    working = two.client.start_find("cube", finder="left")
    assert any(update.stage == "waiting" for update in working)
    with pytest.raises(ServerBusy):
        find(finder="left")
    two.works["right"].gate.set()
    assert find(finder="left", retry=True).message == "done"
    assert len(two.works["right"].runs) == 1
    two.works["left"].gate.set()
    working.wait()
    with pytest.raises(NobodyAnswers):
        find(finder="gone")
    assert find(finder="gone", retry=True).message == "done"


def test_nobody_is_asked_where_nobody_is(join_memory: Join) -> None:
    client = CellClient(join_memory())
    with pytest.raises(NobodyAnswers, match="zsight up"):
        client.find_all("cube")
    with pytest.raises(NobodyAnswers):
        client.cancel()


# Clouds.


def test_clouds_are_arrays_with_their_stamp_and_frame(join_memory: Join) -> None:
    sender, client = join_memory(), CellClient(join_memory())
    points = from_xyz(np.arange(18.0).reshape(2, 3, 3))
    clouds = client.clouds("left/points", timeout=0.2)
    writer = sender.writer(sender.cell.points("left"), PointCloud2)

    def send() -> None:
        if soon(writer.has_readers):
            writer.send(cloud_from_points(points, Time(sec=3), "eye"))

    thread = threading.Thread(target=send)
    thread.start()
    cloud = next(clouds)
    thread.join()
    assert isinstance(cloud, Cloud)
    assert (cloud.stamp_ns, cloud.frame_id, cloud.shape) == (3_000_000_000, "eye", (2, 3))
    np.testing.assert_array_equal(xyz(cloud), xyz(points))
    row = cloud[0]
    assert (row.stamp_ns, row.frame_id) == (3_000_000_000, "eye")
    assert list(clouds) == []
    assert not writer.has_readers()


# Asyncio.


def test_the_asyncio_twin_finds_and_cancels(finder: Finders) -> None:
    async def use() -> None:
        client = AsyncCellClient(finder.client)
        call = await client.start_find("cube")
        async for update in call:
            if update.stage == "waiting":
                await call.cancel()
        with pytest.raises(GoalCancelled):
            await call.result()
        finder.works["finder"].gate.set()
        assert (await client.find("cube")).message == "done"

    asyncio.run(use())


def test_the_asyncio_twin_knows_the_catalogue_and_the_finders(two: Finders) -> None:
    known = load(shipped_folder())
    serve_catalogue(two.buses["left"], known, None)

    async def use() -> None:
        client = AsyncCellClient(two.client)
        assert await client.finders() == ["left", "right"]
        kind = await client.catalog.get("toy_block")
        assert (await client.catalog.derived("toy_block")).size == (0.035, 0.2, 0.035)
        with pytest.raises(RequestRefused, match="nothing can be taught"):
            await client.catalog.teach("bar")
        await client.catalog.remove("toy_block")
        assert "toy_block" not in [other.name for other in await client.catalog.list()]
        await client.catalog.add(kind)
        assert (await client.catalog.get("toy_block")).shape == kind.shape
        assert await client.results() == []

    asyncio.run(use())


def test_a_cancelled_task_cancels_its_goal(finder: Finders) -> None:
    async def use() -> None:
        client = AsyncCellClient(finder.client)
        task = asyncio.create_task(client.find("cube"))
        assert await asyncio.to_thread(soon, lambda: bool(finder.works["finder"].runs))
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(use())
    (goal_id,) = finder.works["finder"].runs
    assert soon(lambda: finder.client.results(goal_id)[0].state is GoalState.CANCELLED)


def test_a_task_that_waits_for_clouds_can_be_cancelled(join_memory: Join) -> None:
    bus = join_memory()

    async def use() -> None:
        async def read() -> None:
            async for _ in AsyncCellClient(CellClient(bus)).clouds():
                pass

        task = asyncio.create_task(read())
        assert await asyncio.to_thread(soon, lambda: bool(bus.readers))
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    asyncio.run(use())  # which ends when all its threads have
    assert bus.readers == []


def test_a_find_that_takes_too_long_is_told_so_where_nobody_cancels_it(join_memory: Join) -> None:
    server, client = join_memory(), CellClient(join_memory())
    kept: list[RawRequest] = []
    server.serve(server.cell.find_object("finder"), kept.append)

    async def use() -> None:
        goal = await AsyncCellClient(client).start_find("cube", finder="finder", timeout=0.1)
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(goal.result(), 0.01)

    asyncio.run(use())
