"""The catalogue on the network: types are listed, added, changed and removed while finders run."""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zsight.bus.link import Closable
from zsight.bus.request_queue import RequestQueue
from zsight.catalogue.type_files import REMOVED, Catalogue, mesh_beside, read_type, require_type_name, write_type
from zsight.convert import pose_of
from zsight.errors import UsageError, ZsightError
from zsight_core.errors import CoreError
from zsight_core.files.atomic_file import atomic_file
from zsight_core.model import Surface, size_of
from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.object_type import (
    CatalogAnswer,
    CatalogRequest,
    Derived,
    ShapeOf,
    StablePose,
    SymmetryAxis,
    Teaching,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from zsight.bus import Bus, RawRequest
    from zsight_protocol.geometry import Quaternion
    from zsight_protocol.object_type import ObjectType

__all__ = ["answer", "serve_catalogue"]

log = logging.getLogger(__name__)

VERSIONS = "versions"
"""Folder, in that of the types, of what they were before they were changed or removed."""


def serve_catalogue(
    bus: Bus,
    catalogue: Catalogue,
    folder: Path | None,
    teach: Callable[[str, Teaching], CatalogAnswer] | None = None,
    tell: Callable[[CatalogAnswer], object] = lambda _: None,
) -> Closable:
    """Serve the catalogue; changes are kept in the folder, or until the process ends where there is none.

    Args:
        bus: of the process.
        catalogue: what is served.
        folder: of the types that were added.
        teach: measures a thing for a type of this name; takes a second, for which nothing else waits.
        tell: told all types, at once and after every change: for watchers and recorders.
    """
    # Poses in which a type rests, meshes, and all types after a change take long for the link's thread.
    requests, lessons = RequestQueue("catalogue"), RequestQueue("teaching")

    def changed() -> None:
        tell(answer(CatalogRequest(action="list"), catalogue, folder))

    def asked(request: RawRequest) -> None:
        try:
            wanted = decode(CatalogRequest, request.payload)
        except ProtocolError as error:
            _reply(request, CatalogAnswer(ok=False, message=str(error)))
            return
        if wanted.action == "teach":
            lessons.put(request, lambda _: _reply_safely(request, lambda: _taught(wanted, teach)))
        else:
            requests.put(request, lambda _: done(request, wanted))

    def done(request: RawRequest, wanted: CatalogRequest) -> None:
        before = catalogue.types
        try:
            _reply_safely(request, lambda: answer(wanted, catalogue, folder))
        finally:  # whoever asked may have gone
            if catalogue.types is not before:
                changed()

    changed()
    server = bus.serve(bus.cell.catalog("*"), asked)

    def close() -> None:
        for closed in (server, requests, lessons):
            closed.close()

    return Closable(close)


def _reply_safely(request: RawRequest, work: Callable[[], CatalogAnswer]) -> None:
    """Reply with what the work comes to, or why it does not."""
    try:
        reply = work()
    except (ZsightError, CoreError, OSError) as error:
        reply = CatalogAnswer(ok=False, message=str(error))
    _reply(request, reply)


def _reply(request: RawRequest, reply: CatalogAnswer) -> None:
    if not reply.ok:
        log.warning("refused a catalogue request: %s", reply.message)
    request.reply(encode(reply))
    request.close()


def _taught(wanted: CatalogRequest, teach: Callable[[str, Teaching], CatalogAnswer] | None) -> CatalogAnswer:
    if teach is None:
        raise UsageError("no camera is read here: nothing can be taught")
    return teach(wanted.name or "", wanted.teaching or Teaching())


def answer(request: CatalogRequest, catalogue: Catalogue, folder: Path | None) -> CatalogAnswer:
    """Do what a request asks.

    Raises:
        UsageError: the type is unknown, or none was given.
        CoreError: its mesh cannot be read, or the folder cannot be written.
    """
    if request.action == "list":
        types = catalogue.types
        return CatalogAnswer(ok=True, types=tuple(types[name] for name in sorted(types)))
    if request.action == "put":
        return _put(request, catalogue, folder)
    kind = catalogue.resolve(request.name or "")
    if request.action == "delete":
        return _delete(kind, catalogue, folder)
    if request.version not in (None, kind.version):
        return CatalogAnswer(ok=True, types=(_former(kind, request.version or 0, folder),))
    return CatalogAnswer(ok=True, types=(kind,), derived=_derived(kind, catalogue))


def _put(request: CatalogRequest, catalogue: Catalogue, folder: Path | None) -> CatalogAnswer:
    kind = request.type
    if kind is None:
        raise UsageError("no type was given with put; expected one")
    require_type_name(kind.name)
    for other in catalogue.types.values():
        if kind.code is not None and other.code == kind.code and other.name != kind.name:
            raise UsageError(f"number {kind.code} is that of {other.name}: choose another one")
    known = catalogue.types.get(kind.name)
    kind = kind.model_copy(update={"version": 1 + _last_version(kind.name, known, folder)})
    mesh = kind.shape.mesh
    if mesh is not None:
        others = {other.shape.mesh.file for other in catalogue.types.values() if other.shape.mesh and other != known}
        _require_mesh(mesh.file, request.mesh, folder, others)
    _require_model(kind, request.mesh, folder)
    if folder is not None:
        _archive(kind.name, folder)
        if mesh is not None and request.mesh:
            with atomic_file(folder / mesh.file, overwrite=True) as file:
                file.write(request.mesh)
        write_type(kind, folder / f"{kind.name}.yaml", overwrite=True)
        (folder / f"{kind.name}{REMOVED}").unlink(missing_ok=True)
    catalogue.add(kind, folder or Path())
    kept = f"in {folder.name}" if folder is not None else "until the finder stops (it has no catalogue folder)"
    done = "changed" if known is not None else "added"
    return CatalogAnswer(ok=True, message=f"{done} {kind.name}, version {kind.version}, kept {kept}", types=(kind,))


def _delete(kind: ObjectType, catalogue: Catalogue, folder: Path | None) -> CatalogAnswer:
    if folder is not None:
        with atomic_file(folder / f"{kind.name}{REMOVED}", overwrite=True):
            pass
        _archive(kind.name, folder)
        (folder / f"{kind.name}.yaml").unlink(missing_ok=True)
    catalogue.remove(kind.name)
    return CatalogAnswer(ok=True, message=f"removed {kind.name}")


def _require_mesh(name: str, mesh: bytes, folder: Path | None, others: set[str]) -> None:
    """That a mesh file came along or is there, and would not take the place of another type's."""
    if folder is None:
        raise UsageError(
            "a type with a mesh needs a finder with a catalogue folder to keep it in: start it with --catalogue FOLDER"
        )
    place = folder / name
    if not mesh and not place.is_file():
        raise UsageError(f"mesh {name} is not in the finder's catalogue folder, and none came along")
    if mesh and name in others and place.is_file() and place.read_bytes() != mesh:
        raise UsageError(f"another type's mesh is called {name}: rename this one")


def _require_model(kind: ObjectType, mesh: bytes, folder: Path | None) -> None:
    """That a type's mesh can be read and is of a likely size; one that came along is not in its place before it is."""
    trial = Catalogue()
    if kind.shape.mesh is None or not mesh:
        trial.add(kind, folder or Path())
        trial.model(kind.name)
        return
    with tempfile.TemporaryDirectory() as aside:
        (Path(aside) / kind.shape.mesh.file).write_bytes(mesh)
        trial.add(kind, Path(aside))
        trial.model(kind.name)


def _versions(name: str, folder: Path) -> dict[int, Path]:
    """Former versions of a type that are kept."""
    return {int(path.suffixes[-2][1:]): path for path in (folder / VERSIONS).glob(f"{name}.[0-9]*.yaml")}


def _last_version(name: str, known: ObjectType | None, folder: Path | None) -> int:
    """The greatest version that there has been, or 0."""
    former = _versions(name, folder) if folder is not None else {}
    return max([known.version if known is not None else 0, *former])


def _archive(name: str, folder: Path) -> None:
    """Keep the file of a type as a former version, and beside it its mesh, which the next one may replace."""
    path = folder / f"{name}.yaml"
    if not path.is_file():
        return
    former = read_type(path)
    kept = folder / VERSIONS / f"{name}.{former.version}.yaml"
    kept.parent.mkdir(exist_ok=True)
    mesh = mesh_beside(former, path)
    if former.shape.mesh is not None and mesh:
        own = f"{name}.{former.version}{Path(former.shape.mesh.file).suffix}"
        shape = ShapeOf(mesh=former.shape.mesh.model_copy(update={"file": own}))
        former = former.model_copy(update={"shape": shape})
        with atomic_file(kept.with_name(own), overwrite=True) as file:
            file.write(mesh)
    write_type(former, kept, overwrite=True)


def _former(kind: ObjectType, version: int, folder: Path | None) -> ObjectType:
    known = _versions(kind.name, folder) if folder is not None else {}
    if version not in known:
        told = ", ".join(str(number) for number in sorted([*known, kind.version]))
        raise UsageError(f"{kind.name} has no version {version} here; there is {told}")
    return read_type(known[version])


def _derived(kind: ObjectType, catalogue: Catalogue) -> Derived:
    """What follows from the shape of a type."""
    from zsight_core.search.symmetry import symmetries_of
    from zsight_core.simulation.settle import resting_poses  # scipy comes with these, which a start need not wait for

    shape = catalogue.model(kind.name).shape
    length, width, height = size_of(shape)
    return Derived(
        size=(length, width, height),
        symmetries=tuple(SymmetryAxis(axis=turn.axis, order=turn.order) for turn in symmetries_of(shape)),
        stable_poses=tuple(
            StablePose(orientation=_upright(pose.R), height=pose.below, share=min(pose.share, 1.0))
            for pose in ([] if isinstance(shape, Surface) else resting_poses(shape))
        ),
    )


def _upright(R: NDArray[np.float64]) -> Quaternion:
    T = np.eye(4)
    T[:3, :3] = R
    return pose_of(T).orientation
