"""The catalogue of object types: one YAML file a type, with a mesh beside it where the shape is one."""

from __future__ import annotations

import difflib
import logging
import re
import threading
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import ValidationError

from zsight.errors import UsageError
from zsight_core.errors import CoreError
from zsight_core.files.atomic_file import atomic_file
from zsight_protocol.find_object import ANY_TYPE
from zsight_protocol.object_type import ObjectType

if TYPE_CHECKING:
    from collections.abc import Mapping

    from zsight_core.model import ObjectModel, Shape
    from zsight_protocol.find_object import DetectedObject

__all__ = [
    "REMOVED",
    "Catalogue",
    "load",
    "mesh_beside",
    "read_type",
    "require_type_name",
    "shipped_folder",
    "write_type",
]

log = logging.getLogger(__name__)

LARGEST = 3.0
"""Metres; a larger one is taken for a mistaken unit."""

REMOVED = ".removed"
"""A file of this suffix in a folder says that a type of an earlier folder is removed."""

_NAME = re.compile(r"[a-z][a-z0-9_]{0,63}")


def shipped_folder() -> Path:
    """Folder of the types that come with zsight."""
    return Path(str(resources.files("zsight") / "types"))


class Catalogue:
    """Types by name, and the folder that each one's mesh lies in; may be changed while others read it.

    ``types`` is replaced and never changed in place: a goal that goes through it sees one state of it, whatever is
    added or removed meanwhile.
    """

    def __init__(self) -> None:
        """Empty."""
        self.types: Mapping[str, ObjectType] = {}
        self._folders: dict[str, Path] = {}
        self._models: dict[str, tuple[ObjectType, ObjectModel]] = {}
        self._broken: dict[str, ObjectType] = {}
        self._lock = threading.RLock()

    def resolve(self, wanted: str) -> ObjectType:
        """The type with this name, or with this number of the book.

        Raises:
            UsageError: there is none; names the nearest ones.
        """
        types = self.types
        if wanted in types:
            return types[wanted]
        by_code = {str(known.code): known for known in types.values() if known.code is not None}
        if wanted in by_code:
            return by_code[wanted]
        near = difflib.get_close_matches(wanted, types, n=3, cutoff=0.4)
        hint = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(sorted(types))}"
        raise UsageError(f"no object type is called {wanted!r}: {hint}")

    def wanted(self, asked: str) -> str:
        """The name of the type that a goal asks for by name or number, or ANY_TYPE.

        Raises:
            UsageError: there is no such type; names the nearest ones.
        """
        return asked if asked == ANY_TYPE else self.resolve(asked).name

    def model(self, name: str) -> ObjectModel:
        """What the recognisers need of a type; a mesh is read the first time.

        Raises:
            UsageError: there is no such type, or its mesh is of no likely size.
            CoreError: its mesh cannot be read.
        """
        return self._made(self.resolve(name))

    def models(self) -> list[ObjectModel]:
        """All that can be used, by name; what is wrong with the others is logged once."""
        types = self.types
        made = [self._made_or_told(types[name]) for name in sorted(types)]
        return [model for model in made if model is not None]

    def _made(self, kind: ObjectType) -> ObjectModel:
        with self._lock:
            made_of, model = self._models.get(kind.name, (None, None))
            if model is None or made_of is not kind:
                model = _model_of(kind, self._folders[kind.name])
                self._models[kind.name] = kind, model
            return model

    def _made_or_told(self, kind: ObjectType) -> ObjectModel | None:
        """The model of a type; of one that has none the log says why, the first time."""
        if self._broken.get(kind.name) is kind:
            return None
        try:
            return self._made(kind)
        except (UsageError, CoreError) as error:
            self._broken[kind.name] = kind
            log.warning("object type %s cannot be found: %s", kind.name, error)
            return None

    def outline(self, found: DetectedObject) -> Shape | None:
        """What to draw of an object: its type's shape, or its box where the type is not known; of a surface a flat box.

        Returns:
            The shape in the object's own frame; none of a surface without an extent.
        """
        from zsight_core.model import Box, Surface

        shape = self.model(found.type).shape if found.type in self.types else Box(found.size)
        if isinstance(shape, Surface):
            length, width, _ = found.size
            return Box((length, width, 1e-3)) if length > 0 and width > 0 else None
        return shape

    def add(self, kind: ObjectType, folder: Path) -> None:
        """Take a type in, in place of one of the same name."""
        with self._lock:
            self.types = {**self.types, kind.name: kind}
            self._folders[kind.name] = folder

    def remove(self, name: str) -> None:
        """Forget a type.

        Raises:
            UsageError: there is none of this name.
        """
        with self._lock:
            removed = self.resolve(name)
            self.types = {other: kind for other, kind in self.types.items() if kind is not removed}


def load(*folders: Path) -> Catalogue:
    """All types in some folders; a later folder's type replaces an earlier one's of the same name.

    Raises:
        UsageError: a folder is missing, or a file is not a type; says which and where.
    """
    catalogue = Catalogue()
    for folder in folders:
        if not folder.is_dir():
            raise UsageError(f"catalogue folder {folder} does not exist; expected YAML files of object types in it")
        for path in sorted(folder.glob("*.yaml")):
            catalogue.add(read_type(path), folder)
        for path in folder.glob(f"*{REMOVED}"):
            if path.stem in catalogue.types:
                catalogue.remove(path.stem)
    return catalogue


def read_type(path: Path) -> ObjectType:
    """One type from its file.

    Raises:
        UsageError: the file is not a type; names the line.
    """
    try:
        node = yaml.compose(path.read_text(encoding="utf-8"), Loader=yaml.SafeLoader)
        entries = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise UsageError(f"{path}: not readable as YAML: {error}") from None
    try:
        return ObjectType.model_validate(entries)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise UsageError(
            f"{path}, line {_line_of(node, first['loc'])}: {where}: {first['msg'].removeprefix('Value error, ')}"
        ) from None


def _line_of(node: yaml.Node | None, location: tuple[int | str, ...]) -> int:
    """Line of the innermost part of a location that the file has."""
    line = 1
    for part in location:
        if node is None:
            break
        line = node.start_mark.line + 1
        node = _child(node, part)
    return node.start_mark.line + 1 if node is not None else line


def _child(node: yaml.Node, part: int | str) -> yaml.Node | None:
    if isinstance(node, yaml.MappingNode):
        return next((value for key, value in node.value if key.value == part), None)
    if isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
        child: yaml.Node = node.value[part]
        return child
    return None


def write_type(kind: ObjectType, path: Path, *, overwrite: bool = False) -> None:
    """Write a type's file; it appears whole or not at all.

    Raises:
        FileError: it cannot be written, or is there already and may not be overwritten.
    """
    values = kind.model_dump(mode="json", exclude_defaults=True)
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120)
    with atomic_file(path, overwrite=overwrite) as file:
        file.write(text.encode())


def mesh_beside(kind: ObjectType, path: Path) -> bytes:
    """The mesh file that lies beside a type's file; nothing where it has none or it is not there."""
    if kind.shape.mesh is None:
        return b""
    mesh = path.parent / kind.shape.mesh.file
    return mesh.read_bytes() if mesh.is_file() else b""


def require_type_name(name: str) -> None:
    """That a type can have this name.

    Raises:
        UsageError: it cannot.
    """
    if not _NAME.fullmatch(name) or name == ANY_TYPE:
        raise UsageError(
            f"no type can be called {name!r}; expected lower-case letters, digits and '_', a letter first, and not"
            f" {ANY_TYPE}, which means all types"
        )


def _model_of(kind: ObjectType, folder: Path) -> ObjectModel:
    from zsight_core.model import ObjectModel, size_of

    model = ObjectModel(kind.name, shape_of(kind.shape, folder), kind.colour)
    largest, mesh = max(size_of(model.shape)), kind.shape.mesh
    if kind.shape.surface is None and largest > LARGEST:
        what = kind.name if mesh is None else f"mesh {mesh.file} with scale {mesh.scale:g}"
        mend = "Sizes are metres" if mesh is None else "Then its scale is 0.001"
        raise UsageError(
            f"{what} is {largest:.4g} m large; expected at most {LARGEST:g} m: is its unit millimetres? {mend}"
        )
    return model


def shape_of(shape: Any, folder: Path) -> Shape:
    """The core's shape of a ShapeOf message; a mesh file lies in the folder."""
    from zsight_core.model import Box, Cylinder, Sphere, Surface

    if shape.box is not None:
        return Box(shape.box.size)
    if shape.cylinder is not None:
        return Cylinder(shape.cylinder.diameter, shape.cylinder.height)
    if shape.sphere is not None:
        return Sphere(shape.sphere.diameter)
    if shape.surface is not None:
        return Surface(shape.surface.minimum_area)
    from zsight_core.files.mesh_file import read

    return read(folder / shape.mesh.file, shape.mesh.scale)
