"""Settings of running processes: listed with their ranges, read, set where that is possible, and saved."""

from __future__ import annotations

from enum import Enum
from typing import TYPE_CHECKING, Any, Literal

import pytest
from pydantic import Field, ValidationError
from tests.services.running import running
from tests.services.waiting import DEADLINE, soon

from zsight import voxel
from zsight.client import CellClient
from zsight.convert import cloud_from_points
from zsight.errors import NobodyAnswers, RequestRefused, UsageError
from zsight.parameters import Parameters, Saved, load, serve_parameters
from zsight.services import SERVICES
from zsight.settings import Live, Settings, variable
from zsight_core.points import from_xyz
from zsight_protocol.message import Time
from zsight_protocol.parameter import Parameter
from zsight_protocol.point_cloud import PointCloud2

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.bus import Bus


class Colour(Enum):
    RED = "red"
    BLUE = "blue"


class Odd(Settings):
    """One setting of every kind."""

    leaf: Live[float] = Field(0.02, gt=0, le=10, description="edge, metres")
    rate: Live[float | None] = Field(None, ge=0.5, lt=100, description="hertz")
    count: int = Field(3, ge=1, description="how many")
    name: str = Field("kinect", description="a name")
    mode: Live[Literal["fast", "exact"]] = Field("fast", description="how")
    colour: Live[Colour] = Field(Colour.RED, description="which")
    keys: tuple[str, ...] = Field((), description="a list")


@pytest.fixture(autouse=True)
def saved(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Saved:
    """Where the settings of these tests are saved."""
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path))
    return Saved("test", "odd")


@pytest.fixture
def settings() -> Odd:
    return Odd()


@pytest.fixture
def parameters(settings: Odd, saved: Saved) -> Parameters:
    return Parameters(settings, saved)


# The declaration.


def test_what_is_not_live_is_read_only(settings: Odd) -> None:
    with pytest.raises(ValidationError, match="frozen"):
        settings.count = 4  # type: ignore[misc, unused-ignore]
    settings.leaf = 1.0
    with pytest.raises(ValidationError, match="less than or equal to 10"):
        settings.leaf = 11.0
    assert (settings.leaf, settings.count) == (1.0, 3)


def test_a_parameter_tells_its_range(parameters: Parameters) -> None:
    assert parameters.get("leaf") == Parameter(
        name="leaf",
        kind="float",
        value=0.02,
        default=0.02,
        minimum=0.0,
        minimum_excluded=True,
        maximum=10.0,
        live=True,
        description="edge, metres",
    )
    rate, count = parameters.get("rate"), parameters.get("count")
    assert (rate.kind, rate.value, rate.minimum, rate.maximum_excluded) == ("float", None, 0.5, True)
    assert (count.kind, count.minimum, count.maximum, count.live) == ("int", 1.0, None, False)
    assert (parameters.get("mode").kind, parameters.get("mode").choices) == ("str", ("fast", "exact"))
    assert (parameters.get("colour").value, parameters.get("colour").choices) == ("red", ("red", "blue"))
    assert (parameters.get("keys").kind, parameters.get("keys").value) == ("json", [])


@pytest.mark.parametrize("row", SERVICES, ids=lambda row: row.name)
def test_every_setting_of_every_service_can_be_told(row: Any, saved: Saved) -> None:
    kind = row.settings()
    told = Parameters(kind(), saved).list()
    assert [parameter.name for parameter in told] == list(kind.model_fields)
    assert all(parameter.value == parameter.default and parameter.description for parameter in told)


# Changes.


@pytest.mark.parametrize(
    ("name", "given", "becomes"),
    [("leaf", "0.5", 0.5), ("rate", 2, 2.0), ("mode", "exact", "exact"), ("rate", None, None)],
)
def test_a_live_setting_changes_where_the_service_reads_it(
    settings: Odd, parameters: Parameters, name: str, given: Any, becomes: Any
) -> None:
    assert f"{name} is {becomes}" in parameters.set(name, given, save=False)
    assert getattr(settings, name) == parameters.get(name).value == becomes


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("leaf", 0, "setting leaf is 0: Input should be greater than 0"),
        ("leaf", "fine", "setting leaf is 'fine'"),
        ("mode", "slow", "'fast' or 'exact'"),
        ("leef", 1, "no setting is called leef; known are leaf, rate"),
        ("count", 4, "count is read at the start alone: save it"),
        ("count", 0, "greater than or equal to 1"),
    ],
)
@pytest.mark.parametrize("save", [False, True])
def test_a_bad_change_changes_nothing(
    settings: Odd, parameters: Parameters, saved: Saved, name: str, value: Any, words: str, save: bool
) -> None:
    if save and words.endswith("save it"):
        return
    with pytest.raises(UsageError, match=words):
        parameters.set(name, value, save=save)
    assert settings == Odd()
    assert not saved.path.exists()


# What was saved.


def test_saved_values_hold_from_the_next_start_on(parameters: Parameters, settings: Odd) -> None:
    assert parameters.set("leaf", 0.5, save=True) == "leaf is 0.5, saved"
    assert parameters.set("count", 7, save=True) == "count is 7 from the next start on"
    assert (settings.leaf, settings.count) == (0.5, 3)
    assert [parameter.name for parameter in parameters.list() if parameter.saved] == ["leaf", "count"]
    assert load(Odd, "odd", "test", {}) == Odd(leaf=0.5, count=7)
    assert load(Odd, "odd", "other", {}) == load(Odd, "even", "test", {}) == Odd()


def test_options_come_before_saved_values_and_those_before_the_environment(
    parameters: Parameters, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ZSIGHT_ODD_LEAF", "1")
    monkeypatch.setenv("ZSIGHT_ODD_COUNT", "9")
    monkeypatch.setenv("ZSIGHT_ODD_NAME", "")
    assert load(Odd, "odd", "test", {}) == Odd(leaf=1, count=9)
    parameters.set("leaf", 2, save=True)
    assert load(Odd, "odd", "test", {}) == Odd(leaf=2, count=9)
    assert load(Odd, "odd", "test", {"leaf": "3"}) == Odd(leaf=3, count=9)


def test_a_name_of_two_words_has_a_variable() -> None:
    assert (
        variable("left-eye.2", "world-frame")
        == variable("left-eye.2", "world_frame")
        == "ZSIGHT_LEFT_EYE_2_WORLD_FRAME"
    )


@pytest.mark.parametrize("text", ["{", "5", "\udc00"])
def test_damaged_saved_settings_are_named(saved: Saved, text: str) -> None:
    saved.path.parent.mkdir(parents=True)
    saved.path.write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(UsageError, match=r"odd\.json .*repair or remove"):
        load(Odd, "odd", "test", {})


def test_saved_settings_that_are_no_longer_legal_end_the_start(saved: Saved) -> None:
    saved.keep("leaf", 99)
    with pytest.raises(UsageError, match="setting leaf is 99"):
        load(Odd, "odd", "test", {})


# Over the network.


@pytest.fixture
def cell(join: Callable[[], Bus], parameters: Parameters) -> CellClient:
    """A client of a cell with the same process on two hosts, and another on one."""
    for host, process in (("near", "odd"), ("far", "odd"), ("near", "single")):
        serve_parameters(join(), host, process, "odd", parameters)
    return CellClient(join())


def test_all_processes_are_listed(cell: CellClient) -> None:
    assert soon(lambda: len(cell.parameters.list()) == 3)
    answers = cell.parameters.list()
    assert [(a.host, a.process) for a in answers] == [("far", "odd"), ("near", "odd"), ("near", "single")]
    assert all(len(a.parameters) == 7 for a in answers)
    assert [a.host for a in cell.parameters.list("odd")] == ["far", "near"]


def test_one_is_read_and_set(cell: CellClient, settings: Odd) -> None:
    assert soon(lambda: len(cell.parameters.list()) == 3)
    answer = cell.parameters.set("single", "leaf", 0.25)
    assert (answer.message, answer.parameters[0].value, settings.leaf) == ("leaf is 0.25", 0.25, 0.25)
    assert cell.parameters.get("near/odd", "leaf").value == 0.25
    with pytest.raises(UsageError, match="there are far/odd, near/odd: name one"):
        cell.parameters.set("odd", "leaf", 0.5)
    with pytest.raises(RequestRefused, match="setting leaf is -1"):
        cell.parameters.set("near/odd", "leaf", -1)
    with pytest.raises(NobodyAnswers, match="no process even"):
        cell.parameters.get("even", "leaf")
    with pytest.raises(UsageError, match="lower-case"):
        cell.parameters.get("../odd", "leaf")
    assert settings == Odd(leaf=0.25)


def test_whoever_looks_for_a_setting_that_is_not_there_troubles_nobody(
    cell: CellClient, caplog: pytest.LogCaptureFixture
) -> None:
    assert soon(lambda: len(cell.parameters.list()) == 3)
    with pytest.raises(RequestRefused, match="no setting is called lief"):
        cell.parameters.get("single", "lief")
    assert [record for record in caplog.records if record.levelname == "WARNING"] == []
    with pytest.raises(RequestRefused, match="setting leaf is -1"):
        cell.parameters.set("single", "leaf", -1)
    assert soon(lambda: "refused a change of settings: setting leaf is -1" in caplog.text)


def test_bytes_that_are_no_request_are_refused(cell: CellClient) -> None:
    assert soon(lambda: len(cell.parameters.list()) == 3)
    with pytest.raises(RequestRefused, match="ParameterRequest"):
        cell.bus.ask(cell.bus.cell.parameters("near", "odd"), b"\xc1", 1.0).take(DEADLINE)


@pytest.mark.usefixtures("warm_kernels")
def test_a_running_service_takes_a_change_from_its_next_cloud_on(join_memory: Callable[[], Bus], saved: Saved) -> None:
    service, test = join_memory(), join_memory()
    settings = voxel.Settings(leaf=10.0)
    serve_parameters(service, "here", "voxel", "voxel", Parameters(settings, saved))
    out = test.reader(test.cell.voxel_points("kinect"), PointCloud2)
    into = test.writer(test.cell.points("kinect"), PointCloud2)
    points = from_xyz([[[0.1, 0.1, 0.1], [1.1, 0.1, 0.1], [2.1, 0.1, 0.1]]])

    def averaged() -> int:
        into.send(cloud_from_points(points, Time(nanosec=1), "eye"))
        received = out.take(DEADLINE)
        assert received is not None
        return received.message.width * received.message.height

    with running(voxel.run, service, settings):
        assert averaged() == 1
        CellClient(test).parameters.set("voxel", "leaf", 0.5)
        assert averaged() == 3
