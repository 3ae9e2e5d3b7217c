"""The catalogue on the network: types are listed, added, changed and removed while finders run."""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import yaml

from zsight.errors import UsageError
from zsight.object_catalogue import Catalogue
from zsight_core.errors import CoreError
from zsight_protocol.codec import decode, encode
from zsight_protocol.errors import ProtocolError
from zsight_protocol.object_type import CatalogAnswer, CatalogRequest

if TYPE_CHECKING:
    from zsight.bus import Bus, RawRequest
    from zsight.bus.link import Closable
    from zsight_protocol.object_type import ObjectType

__all__ = ["answer", "serve_catalogue"]

log = logging.getLogger(__name__)


def serve_catalogue(bus: Bus, catalogue: Catalogue, folder: Path | None) -> Closable:
    """Serve the catalogue; changes are kept in the folder, or until the process ends where there is none."""

    def asked(request: RawRequest) -> None:
        try:
            reply = answer(decode(CatalogRequest, request.payload), catalogue, folder)
        except (ProtocolError, UsageError, CoreError, OSError) as error:
            log.warning("refused a catalogue request: %s", error)
            reply = CatalogAnswer(ok=False, message=str(error))
        request.reply(encode(reply))
        request.close()

    return bus.serve(bus.cell.catalog("*"), asked)


def answer(request: CatalogRequest, catalogue: Catalogue, folder: Path | None) -> CatalogAnswer:
    """Do what a request asks.

    Raises:
        UsageError: the type is unknown, or none was given.
        CoreError: its mesh cannot be read.
    """
    if request.action == "list":
        types = catalogue.types
        return CatalogAnswer(ok=True, types=tuple(types[name] for name in sorted(types)))
    if request.action == "put":
        return _put(request.type, catalogue, folder)
    kind = catalogue.resolve(request.name or "")
    if request.action == "delete":
        catalogue.remove(kind.name)
        if folder is not None:
            (folder / f"{kind.name}.yaml").unlink(missing_ok=True)
        return CatalogAnswer(ok=True, message=f"removed {kind.name}")
    return CatalogAnswer(ok=True, types=(kind,))


def _put(kind: ObjectType | None, catalogue: Catalogue, folder: Path | None) -> CatalogAnswer:
    if kind is None:
        raise UsageError("no type was given with put; expected one")
    if kind.shape.mesh is not None and (folder is None or not (folder / kind.shape.mesh.file).is_file()):
        raise UsageError(f"mesh {kind.shape.mesh.file} is not in the finder's catalogue folder: copy it there first")
    trial = Catalogue()
    trial.add(kind, folder or Path())
    trial.model(kind.name)  # a mesh that cannot be read is not taken in
    known = kind.name in catalogue.types
    catalogue.add(kind, folder or Path())
    if folder is not None:
        _keep(kind, folder)
    kept = f"in {folder.name}" if folder is not None else "until the finder stops (it has no catalogue folder)"
    return CatalogAnswer(ok=True, message=f"{'changed' if known else 'added'} {kind.name}, kept {kept}", types=(kind,))


def _keep(kind: ObjectType, folder: Path) -> None:
    """Write a type's file whole or not at all."""
    text = yaml.safe_dump(kind.model_dump(mode="json", exclude_defaults=True), sort_keys=False, allow_unicode=True)
    with tempfile.NamedTemporaryFile("w", dir=folder, suffix=".part", delete=False, encoding="utf-8") as beside:
        beside.write(text)
    Path(beside.name).replace(folder / f"{kind.name}.yaml")
