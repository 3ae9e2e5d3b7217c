"""The catalogue of object types: one YAML file a type, with a mesh beside it where the shape is one."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml
from pydantic import ValidationError

from zsight.errors import UsageError
from zsight_protocol.object_type import ObjectType

if TYPE_CHECKING:
    from zsight_core.model import ObjectModel, Shape
    from zsight_protocol.find_object import DetectedObject

__all__ = ["Catalogue", "load", "read_type", "shipped_folder"]


def shipped_folder() -> Path:
    """Folder of the types that come with zsight."""
    return Path(str(resources.files("zsight") / "types"))


@dataclass
class Catalogue:
    """Types by name, and the folder that each one's mesh lies in.

    ``types`` is replaced and never changed in place: a goal that goes through it sees one state of it, whatever is
    added or removed meanwhile.
    """

    types: dict[str, ObjectType] = field(default_factory=dict)
    folders: dict[str, Path] = field(default_factory=dict)
    _models: dict[str, tuple[ObjectType, ObjectModel]] = field(default_factory=dict)

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

    def model(self, name: str) -> ObjectModel:
        """What the recognisers need of a type; a mesh is read the first time.

        Raises:
            UsageError: there is no such type, or its mesh cannot be read.
        """
        return self._model_of(self.resolve(name))

    def models(self) -> list[ObjectModel]:
        """All of them, by name."""
        types = self.types
        return [self._model_of(types[name]) for name in sorted(types)]

    def _model_of(self, kind: ObjectType) -> ObjectModel:
        made_of, model = self._models.get(kind.name, (None, None))
        if model is None or made_of is not kind:
            model = _model_of(kind, self.folders[kind.name])
            self._models[kind.name] = kind, model
        return model

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
        self.folders[kind.name] = folder
        self.types = {**self.types, kind.name: kind}

    def remove(self, name: str) -> None:
        """Forget a type.

        Raises:
            UsageError: there is none of this name.
        """
        removed = self.resolve(name)
        self.types = {known: kind for known, kind in self.types.items() if kind is not removed}


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


def _model_of(kind: ObjectType, folder: Path) -> ObjectModel:
    from zsight_core.model import ObjectModel

    return ObjectModel(kind.name, shape_of(kind.shape, folder), kind.colour)


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
    from zsight_core.mesh_file import read

    return read(folder / shape.mesh.file, shape.mesh.scale)
