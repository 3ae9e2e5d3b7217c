"""An object type as the catalogue keeps it and the network carries it."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, Strict, StringConstraints, model_validator

from zsight_protocol.message import Extras, Float64, Message

__all__ = [
    "BoxShape",
    "CatalogAnswer",
    "CatalogRequest",
    "Channel8",
    "CylinderShape",
    "MeshShape",
    "ObjectType",
    "ShapeOf",
    "SphereShape",
    "SurfaceShape",
    "TypeName",
]

Length = Annotated[Float64, Field(gt=0, le=100)]
TypeName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
Channel8 = Annotated[int, Field(ge=0, le=255)]


class BoxShape(Message):
    """A cuboid: edges along x, y and z, metres."""

    size: Annotated[tuple[Length, Length, Length], Strict(False)]


class CylinderShape(Message):
    """A circular cylinder about z, metres."""

    diameter: Length
    height: Length


class SphereShape(Message):
    """A ball, metres."""

    diameter: Length


class MeshShape(Message):
    """A triangle mesh in a file beside the type's own (STL, PLY, OBJ, GLB); scale turns its units into metres."""

    file: Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_.-]*\.(stl|ply|obj|glb)$")]
    scale: Annotated[Float64, Field(gt=0)] = 1.0


class SurfaceShape(Message):
    """A flat support such as a table top, at least this large, square metres."""

    minimum_area: Annotated[Float64, Field(gt=0)] = 0.05


class ShapeOf(Message):
    """Exactly one of the shapes."""

    box: BoxShape | None = None
    cylinder: CylinderShape | None = None
    sphere: SphereShape | None = None
    mesh: MeshShape | None = None
    surface: SurfaceShape | None = None

    @model_validator(mode="after")
    def _require_one(self) -> Self:
        given = [name for name in type(self).model_fields if getattr(self, name) is not None]
        if len(given) != 1:
            raise ValueError(
                f"got {', '.join(given) or 'no shape'}; expected exactly one of box, cylinder, sphere, mesh, surface"
            )
        return self


class ObjectType(Message):
    """A type of object: its name, its number in the book if it has one, its shape, and what else users carry."""

    name: TypeName
    code: Annotated[int, Field(ge=0, lt=2**31)] | None = None
    shape: ShapeOf
    colour: Annotated[tuple[Channel8, Channel8, Channel8], Strict(False)] | None = None
    notes: Annotated[str, Field(max_length=2000)] = ""
    grasps: Annotated[tuple[Extras, ...], Strict(False), Field(max_length=64)] = ()
    properties: Extras = Field(default_factory=dict)


class CatalogRequest(Message):
    """What to do with the catalogue: get or list (no type given), put, delete; a type by its name or its number."""

    action: Annotated[str, StringConstraints(pattern=r"^(list|get|put|delete)$")]
    name: Annotated[str, StringConstraints(pattern=r"^([a-z][a-z0-9_]{0,63}|[0-9]{1,10})$")] | None = None
    type: ObjectType | None = None


class CatalogAnswer(Message):
    """The types asked for, or why not."""

    ok: bool
    message: str = ""
    types: Annotated[tuple[ObjectType, ...], Strict(False)] = ()
