"""Every key is made by Cell, is legal for Zenoh, and leads back to its row of the table."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import zenoh
from hypothesis import example, given
from hypothesis import strategies as st

from zsight_protocol.channels import CHANNELS, Cell, Channel, Delivery, channel_of, require_name
from zsight_protocol.errors import KeyNameError
from zsight_protocol.message import Message

KeyOf = Callable[[Cell, str, str], str]

# Method of Cell by pattern of its row; two names are given to each, and it takes the first one or two.
KEYS: dict[str, KeyOf] = {
    "*/points": lambda cell, a, _b: cell.points(a),
    "*/points/voxel": lambda cell, a, _b: cell.voxel_points(a),
    "*/camera_info": lambda cell, a, _b: cell.camera_info(a),
    "*/selected_points": lambda cell, a, _b: cell.selected_points(a),
    "*/plane": lambda cell, a, _b: cell.plane(a),
    "*/plane/points": lambda cell, a, _b: cell.plane_points(a),
    "*/plane/above": lambda cell, a, _b: cell.points_above_plane(a),
    "*/scene": lambda cell, a, _b: cell.scene(a),
    "tf": lambda cell, _a, _b: cell.tf,
    "tf_static": lambda cell, _a, _b: cell.tf_static,
    "find_object/*": lambda cell, a, _b: cell.find_object(a),
    "find_object/*/cancel": lambda cell, a, _b: cell.cancel(a),
    "find_object/*/result": lambda cell, a, _b: cell.result(a),
    "find_object/*/status": lambda cell, a, _b: cell.status(a),
    "find_object/*/feedback": lambda cell, a, _b: cell.feedback(a),
    "find_object/*/goal": lambda cell, a, _b: cell.goal(a),
    "find_object/*/catalogue": lambda cell, a, _b: cell.catalogue(a),
    "catalog/*": lambda cell, a, _b: cell.catalog(a),
    "param/*/*": lambda cell, a, b: cell.parameters(a, b),
    "clock": lambda cell, _a, _b: cell.clock,
    "@recorder/*": lambda cell, a, _b: cell.recorder(a),
    "@recorder/*/status": lambda cell, a, _b: cell.recorder_status(a),
    "@player/*": lambda cell, a, _b: cell.player(a),
    "@player/*/status": lambda cell, a, _b: cell.player_status(a),
    "@health/*/*": lambda cell, a, b: cell.health(a, b),
    "@log/*/*": lambda cell, a, b: cell.log(a, b),
    "@host/*": lambda cell, a, _b: cell.host(a),
    "@alive/*/*": lambda cell, a, b: cell.alive(a, b),
}
RESERVED = {
    "tf",
    "tf_static",
    "find_object",
    "catalog",
    "param",
    "clock",
    "@recorder",
    "@player",
    "@health",
    "@log",
    "@host",
    "@alive",
}
RESERVED_AT = {name for name in RESERVED if name.startswith("@")}

# The words of the table itself are the names most likely to be mistaken for a row.
words = sorted({chunk for row in CHANNELS for chunk in row.pattern.split("/")} - {"*"} - RESERVED_AT)
names = st.sampled_from(words) | st.from_regex(r"[a-z0-9_][a-z0-9_.\-]{0,8}", fullmatch=True)
rows = pytest.mark.parametrize("row", CHANNELS, ids=lambda row: row.pattern)


def is_camera_row(row: Channel) -> bool:
    return row.pattern.startswith("*")


def test_every_row_has_its_method() -> None:
    assert [row.pattern for row in CHANNELS] == list(KEYS)


def test_every_method_of_cell_has_its_row() -> None:
    methods = [name for name in vars(Cell) if not name.startswith("_")]
    assert len(methods) == len(CHANNELS)


@rows
@example(namespace="zsight", first="points", second="points")
@given(namespace=names, first=names, second=names)
def test_a_key_is_legal_and_leads_back_to_its_row(row: Channel, namespace: str, first: str, second: str) -> None:
    if is_camera_row(row) and first in RESERVED:
        return
    key = KEYS[row.pattern](Cell(namespace), first, second)
    assert str(zenoh.KeyExpr(key)) == key
    assert str(zenoh.KeyExpr.autocanonize(key)) == key
    assert channel_of(key, namespace) is row


@rows
def test_a_key_for_any_name_leads_to_the_same_row(row: Channel) -> None:
    assert channel_of(f"cell/{row.pattern}", "cell") is row


@rows
@pytest.mark.parametrize(
    "name", ["", "A", "a/b", "a b", "**", "a*", "$a", "#a", "?a", "@a", "-a", ".", "..", "a\n", "é"]
)
def test_a_name_that_cannot_stand_in_a_key_is_refused(row: Channel, name: str) -> None:
    if "*" not in row.pattern:
        return
    if row.pattern.startswith(("@health", "@log", "@host", "@alive", "param")) and name == "A":
        assert KEYS[row.pattern](Cell(), "A", "a") == KEYS[row.pattern](Cell(), "a", "a")  # hosts ignore case
        return
    with pytest.raises(KeyNameError, match="expected lower-case letters"):
        KEYS[row.pattern](Cell(), name, name)
    with pytest.raises(KeyNameError):
        channel_of(f"zsight/{row.pattern.replace('*', name)}", "zsight")


@rows
@pytest.mark.parametrize("name", sorted(RESERVED))
def test_a_camera_cannot_take_the_name_of_another_row(row: Channel, name: str) -> None:
    if is_camera_row(row):
        with pytest.raises(KeyNameError, match="camera is"):
            KEYS[row.pattern](Cell(), name, name)


@pytest.mark.parametrize(
    ("key", "said"),
    [
        ("other/kinect/points", "expected it to start with zsight/"),
        ("zsight", "expected it to start with zsight/"),
        ("zsightly/kinect/points", "expected it to start with zsight/"),
        ("zsight/", "and one of */points"),
        ("zsight//points", "and one of */points"),
        ("zsight/kinect", "and one of */points"),
        ("zsight/kinect/points/voxel/more", "and one of */points"),
        ("zsight/**", "and one of */points"),
        ("zsight/@alive/points", "and one of */points"),
    ],
)
def test_a_key_of_no_row_is_refused(key: str, said: str) -> None:
    with pytest.raises(KeyNameError) as caught:
        channel_of(key, "zsight")
    assert said in str(caught.value)


def test_a_recorder_of_everything_gets_no_housekeeping() -> None:
    everything = zenoh.KeyExpr("zsight/**")
    heard = {p for p, key in KEYS.items() if everything.includes(zenoh.KeyExpr(key(Cell(), "a", "b")))}
    assert set(KEYS) - heard == {key for key in KEYS if key.startswith("@")}


def test_a_namespace_hears_nothing_of_another() -> None:
    mine = zenoh.KeyExpr("cell1/**")
    assert not any(mine.intersects(zenoh.KeyExpr(key(Cell("cell2"), "a", "b"))) for key in KEYS.values())


def test_what_is_a_token_and_what_a_message() -> None:
    for row in CHANNELS:
        assert (row.message is None) == (row.delivery is Delivery.TOKEN)
        assert row.message is None or issubclass(row.message, Message)


def test_a_name_is_given_back() -> None:
    assert require_name("kinect_1.front-left", "camera") == "kinect_1.front-left"
