"""Types are listed, added, changed and removed over the network."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any

import pytest

from zsight.catalogue import server as catalogue_server
from zsight.catalogue import type_files
from zsight.catalogue.client import Catalog
from zsight.catalogue.server import serve_catalogue
from zsight.catalogue.type_files import load, mesh_beside, read_type, shipped_folder
from zsight.errors import NobodyAnswers, RequestRefused, UsageError
from zsight_core.model import Box, size_of
from zsight_protocol.codec import encode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.object_type import (
    BoxShape,
    CatalogAnswer,
    CatalogRequest,
    CylinderShape,
    MeshShape,
    ObjectType,
    ShapeOf,
    SphereShape,
)

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from zsight.bus import Bus
    from zsight.catalogue.type_files import Catalogue
    from zsight_core.model import ObjectModel

CRATE = ObjectType(name="crate", code=77, shape=ShapeOf(box=BoxShape(size=(0.3, 0.2, 0.1))), notes="Fraß, 壊れ物")


@pytest.fixture
def known() -> Catalogue:
    return load(shipped_folder())


@pytest.fixture
def catalog(join_memory: Callable[[], Bus], known: Catalogue, tmp_path: Path) -> Catalog:
    """A client of a finder that keeps its types in a folder."""
    serve_catalogue(join_memory(), known, tmp_path)
    return Catalog(join_memory())


def test_all_types_are_listed_by_name(catalog: Catalog, known: Catalogue) -> None:
    assert catalog.list() == [known.types[name] for name in sorted(known.types)]


@pytest.mark.parametrize("name", ["toy_block", "1000"])
def test_one_type_by_name_or_number(catalog: Catalog, name: str) -> None:
    assert catalog.get(name).name == "toy_block"


def test_an_unknown_type_is_refused_with_the_nearest_name(catalog: Catalog) -> None:
    for ask in (catalog.get, catalog.remove):
        with pytest.raises(RequestRefused, match="did you mean toy_block"):
            ask("toy_blok")


@pytest.mark.parametrize("name", ["", "Toy Block", "a/b", "*", "**", "x" * 200])
def test_a_name_that_none_can_have_is_refused(catalog: Catalog, name: str) -> None:
    with pytest.raises((UsageError, RequestRefused, ProtocolError)):
        catalog.get(name)


def test_an_added_type_is_known_kept_and_survives(catalog: Catalog, known: Catalogue, tmp_path: Path) -> None:
    assert catalog.add(CRATE) == f"added crate, version 1, kept in {tmp_path.name}"
    assert catalog.get("77") == CRATE
    assert known.model("crate").shape == Box((0.3, 0.2, 0.1))
    assert read_type(tmp_path / "crate.yaml") == CRATE
    assert load(shipped_folder(), tmp_path).resolve("crate") == CRATE
    assert [path.name for path in tmp_path.iterdir()] == ["crate.yaml"]


def test_a_changed_type_is_another(catalog: Catalog, tmp_path: Path) -> None:
    catalog.add(CRATE)
    changed = CRATE.model_copy(update={"notes": "Sturdy."})
    assert catalog.add(changed).startswith("changed crate")
    expected = changed.model_copy(update={"version": 2})
    assert catalog.get("crate") == read_type(tmp_path / "crate.yaml") == expected
    assert catalog.get("crate", version=1) == CRATE
    with pytest.raises(RequestRefused, match="crate has no version 3 here; there is 1, 2"):
        catalog.get("crate", version=3)


def test_a_removed_type_is_gone(catalog: Catalog, tmp_path: Path) -> None:
    catalog.add(CRATE)
    assert catalog.remove("crate") == "removed crate"
    with pytest.raises(RequestRefused):
        catalog.get("crate")
    assert not (tmp_path / "crate.yaml").exists()
    assert "added crate, version 2" in catalog.add(CRATE)


def test_a_shipped_type_that_was_removed_stays_removed(catalog: Catalog, tmp_path: Path) -> None:
    catalog.remove("cube")
    assert "cube" not in load(shipped_folder(), tmp_path).types
    cube = ObjectType(name="cube", shape=CRATE.shape)
    catalog.add(cube)
    assert load(shipped_folder(), tmp_path).types["cube"].shape == CRATE.shape


def test_a_number_belongs_to_one_type(catalog: Catalog) -> None:
    with pytest.raises(RequestRefused, match="number 1000 is that of toy_block"):
        catalog.add(CRATE.model_copy(update={"code": 1000}))


def test_what_follows_from_a_shape_is_told(catalog: Catalog) -> None:
    can, mug, table = (catalog.derived(name) for name in ("coke_can", "mug", "table_surface"))
    assert can.size == (0.066, 0.066, 0.122)
    assert [(turn.axis, turn.order) for turn in can.symmetries] == [((1, 0, 0), 2), ((0, 1, 0), 2), ((0, 0, 1), 0)]
    assert {round(pose.height, 4) for pose in can.stable_poses} == {0.061, 0.033}
    assert sum(pose.share for pose in can.stable_poses) == pytest.approx(1)
    assert [turn for turn in mug.symmetries if turn.order == 0] == []
    assert (table.symmetries, table.stable_poses) == ((), ())


def test_a_mesh_comes_along(catalog: Catalog, known: Catalogue, tmp_path: Path) -> None:
    bracket = (shipped_folder() / "l_bracket.stl").read_bytes()
    part = ObjectType(name="part", shape=ShapeOf(mesh=MeshShape(file="part.stl")))
    assert "added part" in catalog.add(part, bracket)
    assert (tmp_path / "part.stl").read_bytes() == bracket
    assert size_of(known.model("part").shape) == pytest.approx((0.08, 0.04, 0.06), abs=1e-6)
    other = ObjectType(name="other", shape=part.shape)
    with pytest.raises(RequestRefused, match=r"another type's mesh is called part.stl"):
        catalog.add(other, (shipped_folder() / "mug.stl").read_bytes())


def test_a_mesh_that_is_refused_for_its_size_leaves_the_one_that_is_there(catalog: Catalog, tmp_path: Path) -> None:
    bracket, mug = ((shipped_folder() / name).read_bytes() for name in ("l_bracket.stl", "mug.stl"))
    part = ObjectType(name="part", shape=ShapeOf(mesh=MeshShape(file="part.stl")))
    catalog.add(part, bracket)
    large = ObjectType(name="part", shape=ShapeOf(mesh=MeshShape(file="part.stl", scale=1000)))
    with pytest.raises(RequestRefused, match="with scale 1000 is"):
        catalog.add(large, mug)
    assert (tmp_path / "part.stl").read_bytes() == bracket
    assert catalog.get("part") == part


@pytest.mark.parametrize(
    "shape",
    [
        ShapeOf(box=BoxShape(size=(65.0, 75.0, 95.0))),
        ShapeOf(cylinder=CylinderShape(diameter=66.0, height=10.0)),
        ShapeOf(sphere=SphereShape(diameter=67.0)),
    ],
)
def test_a_shape_in_millimetres_is_refused(catalog: Catalog, known: Catalogue, shape: ShapeOf) -> None:
    with pytest.raises(RequestRefused, match=r"thing is .* m large; expected at most 3 m: is its unit millimetres"):
        catalog.add(ObjectType(name="thing", shape=shape))
    assert "thing" not in known.types


def test_a_former_version_keeps_its_mesh(catalog: Catalog, tmp_path: Path) -> None:
    bracket, mug = ((shipped_folder() / name).read_bytes() for name in ("l_bracket.stl", "mug.stl"))
    part = ObjectType(name="part", shape=ShapeOf(mesh=MeshShape(file="part.stl")))
    catalog.add(part, bracket)
    catalog.add(part, mug)
    assert (tmp_path / "part.stl").read_bytes() == mug
    former = tmp_path / "versions" / "part.1.yaml"
    kind = read_type(former)
    assert kind == catalog.get("part", version=1)
    assert mesh_beside(kind, former) == bracket


def test_types_may_change_while_others_read_them(known: Catalogue, tmp_path: Path) -> None:
    failures: list[Exception] = []
    ended = threading.Event()

    def read() -> None:
        while not ended.is_set():
            try:
                assert len(known.models()) >= len(load(shipped_folder()).types) - 1
                known.resolve("1000")
            except Exception as error:  # noqa: BLE001  asserted on below
                failures.append(error)
                return

    readers = [threading.Thread(target=read) for _ in range(2)]
    for reader in readers:
        reader.start()
    for _ in range(200):
        known.add(CRATE, tmp_path)
        known.remove("crate")
    ended.set()
    for reader in readers:
        reader.join()
    assert failures == []


def test_a_mesh_must_be_there(catalog: Catalog, known: Catalogue) -> None:
    part = ObjectType(name="part", shape=ShapeOf(mesh=MeshShape(file="part.stl")))
    with pytest.raises(RequestRefused, match=r"part.stl is not in the finder's catalogue folder, and none came along"):
        catalog.add(part)
    assert "part" not in known.types


def test_a_bad_mesh_leaves_everything_as_it_was(catalog: Catalog, known: Catalogue, tmp_path: Path) -> None:
    (tmp_path / "crate.stl").write_bytes(b"this is no mesh")
    catalog.add(CRATE)
    bad = ObjectType(name="crate", shape=ShapeOf(mesh=MeshShape(file="crate.stl")))
    with pytest.raises(RequestRefused, match=r"crate.stl"):
        catalog.add(bad)
    assert catalog.get("crate") == CRATE
    assert known.model("crate").shape == Box((0.3, 0.2, 0.1))
    assert len(known.models()) == len(known.types)
    with pytest.raises(RequestRefused):
        catalog.add(ObjectType(name="other", shape=bad.shape))
    assert len(known.models()) == len(known.types)


def test_without_a_folder_a_type_is_kept_until_the_end(join_memory: Callable[[], Bus], known: Catalogue) -> None:
    serve_catalogue(join_memory(), known, None)
    catalog = Catalog(join_memory())
    assert "until the finder stops" in catalog.add(CRATE)
    assert catalog.get("crate") == CRATE
    with pytest.raises(RequestRefused, match="catalogue folder"):
        catalog.add(ObjectType(name="part", shape=ShapeOf(mesh=MeshShape(file="part.stl"))))


def test_every_finder_learns_of_a_type_and_all_types_are_listed(join_memory: Callable[[], Bus], tmp_path: Path) -> None:
    kept, lost = load(shipped_folder()), load(shipped_folder())
    serve_catalogue(join_memory(), kept, tmp_path)
    serve_catalogue(join_memory(), lost, None)
    catalog = Catalog(join_memory())
    assert "kept in" in (said := catalog.add(CRATE))
    assert "until the finder stops" in said
    assert kept.types["crate"] == lost.types["crate"] == CRATE
    lost.remove("crate")  # as if it had been started again
    assert CRATE in catalog.list()
    assert catalog.get("crate") == CRATE
    assert catalog.remove("crate") == "removed crate"
    assert "crate" not in kept.types


def test_a_type_that_goes_while_all_are_looked_at_is_no_error(
    known: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = type_files._model_of

    def slow(kind: ObjectType, folder: Path) -> ObjectModel:
        if "tea_box" in known.types:
            known.remove("tea_box")
        return real(kind, folder)

    monkeypatch.setattr(type_files, "_model_of", slow)
    assert "tea_box" in [model.name for model in known.models()]
    assert "tea_box" not in [model.name for model in known.models()]


def test_the_links_thread_waits_for_no_answer(
    join_memory: Callable[[], Bus], known: Catalogue, monkeypatch: pytest.MonkeyPatch
) -> None:
    server, client = join_memory(), join_memory()
    going_on = threading.Event()
    real = catalogue_server.answer

    def slow(wanted: CatalogRequest, *rest: Any) -> CatalogAnswer:
        assert wanted.action == "list" or going_on.wait(10)
        return real(wanted, *rest)

    monkeypatch.setattr(catalogue_server, "answer", slow)
    serving = serve_catalogue(server, known, None)
    request = encode(CatalogRequest(action="get", name="cube"))
    replies = client.ask(client.cell.catalog("cube"), request, 10.0)  # in memory, the asker's is the link's thread
    going_on.set()
    assert replies.take(10.0) is not None
    serving.close()


def test_all_types_are_told_again_where_they_have_changed_and_only_there(
    join_memory: Callable[[], Bus], known: Catalogue
) -> None:
    told: list[CatalogAnswer] = []
    serving = serve_catalogue(join_memory(), known, None, tell=told.append)
    catalog = Catalog(join_memory())
    catalog.list()
    catalog.get("cube")
    for refused in (
        lambda: catalog.remove("no_such_type"),
        lambda: catalog.teach("thing"),
        lambda: catalog.add(CRATE.model_copy(update={"code": 1000})),
    ):
        with pytest.raises(RequestRefused):
            refused()
    catalog.add(CRATE)
    catalog.remove("crate")
    serving.close()
    assert [CRATE in types.types for types in told] == [False, True, False]


def test_bad_bytes_are_answered(join_memory: Callable[[], Bus], known: Catalogue) -> None:
    server, client = join_memory(), join_memory()
    serve_catalogue(server, known, None)
    reply = client.ask(client.cell.catalog("*"), b"\xc1", 1.0).take(1.0)
    assert reply is not None
    assert b"not a CatalogRequest" in reply


def test_nobody_serves_a_catalogue(join_memory: Callable[[], Bus]) -> None:
    with pytest.raises(NobodyAnswers, match="zsight up"):
        Catalog(join_memory()).list()
