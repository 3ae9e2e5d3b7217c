"""An object type as the catalogue keeps it and the network carries it."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, Strict, StringConstraints, model_validator

from zsight_protocol.geometry import Pose, Quaternion
from zsight_protocol.message import Extras, Float64, Header, Message, Tuple3

__all__ = [
    "BoxShape",
    "CatalogAnswer",
    "CatalogRequest",
    "Channel8",
    "CylinderShape",
    "Derived",
    "MeshShape",
    "ObjectType",
    "ShapeOf",
    "SphereShape",
    "StablePose",
    "SurfaceShape",
    "SymmetryAxis",
    "Taught",
    "Teaching",
    "TypeName",
]

Length = Annotated[Float64, Field(gt=0, le=100)]
TypeName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_]{0,63}$")]
Extent = Annotated[Float64, Field(ge=0)]
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
    """A type of object: its name, its number in the book if it has one, its shape, and what else users carry.

    ``version`` counts its changes; the catalogue sets it.
    """

    name: TypeName
    version: Annotated[int, Field(ge=1, lt=2**31)] = 1
    code: Annotated[int, Field(ge=0, lt=2**31)] | None = None
    shape: ShapeOf
    colour: Annotated[tuple[Channel8, Channel8, Channel8], Strict(False)] | None = None
    notes: Annotated[str, Field(max_length=2000)] = ""
    grasps: Annotated[tuple[Extras, ...], Strict(False), Field(max_length=64)] = ()
    properties: Extras = Field(default_factory=dict)


class SymmetryAxis(Message):
    """A full turn over ``order`` about this axis of the model leaves the shape as it is; order 0: any angle does."""

    axis: Tuple3
    order: Annotated[int, Field(ge=0, lt=1000)]


class StablePose(Message):
    """A way to rest on a level surface.

    ``orientation`` takes the model to a frame with z up, ``height`` is that of its origin above the surface, metres;
    ``share`` how often it is met.
    """

    orientation: Quaternion
    height: Extent
    share: Annotated[Float64, Field(ge=0, le=1)]


class Derived(Message):
    """What follows from a type's shape: edges of its bounding box (metres), symmetries, stable poses."""

    size: Annotated[tuple[Extent, Extent, Extent], Strict(False)]
    symmetries: Annotated[tuple[SymmetryAxis, ...], Strict(False)] = ()
    stable_poses: Annotated[tuple[StablePose, ...], Strict(False)] = ()


class Teaching(Message):
    """Which thing before a camera a type is to be made of, and what cannot be seen of it.

    ``place`` is any place in or near it, metres in ``frame_id`` (empty: the world where the camera's pose in it is
    known, else the cloud's frame); none: the only thing on the best surface. ``camera`` empty: any. ``shape`` empty:
    the one that fits best.
    """

    camera: Annotated[str, Field(max_length=128)] = ""
    place: Tuple3 | None = None
    frame_id: Annotated[str, Field(max_length=256)] = ""
    shape: Annotated[str, StringConstraints(pattern=r"^(|box|cylinder|lying cylinder|sphere)$")] = ""
    code: Annotated[int, Field(ge=0, lt=2**31)] | None = None
    notes: Annotated[str, Field(max_length=2000)] = ""


class Taught(Message):
    """What was measured of a thing: where it stands, how well each shape explains it, and a picture (PNG).

    ``explained`` is the share of the pixels of thing and shape together that agree; ``misfit`` the root mean square
    distance in depth of those pixels, metres.
    """

    header: Header
    pose: Pose
    explained: Annotated[Float64, Field(ge=0, le=1)]
    misfit: Annotated[Float64, Field(ge=0)]
    explained_by: dict[str, Float64] = Field(default_factory=dict)
    picture: bytes = b""


class CatalogRequest(Message):
    """What to do with the catalogue: get or list (no type given), put, delete; a type by its name or its number.

    ``version``: get the type as it was in that version, as far as the catalogue keeps it on disk. ``mesh`` is the mesh
    file of a type that is put, where it has one that is to be kept beside it. ``teach`` measures a thing before a
    camera and answers with a type of this name; it is not put yet.
    """

    action: Annotated[str, StringConstraints(pattern=r"^(list|get|put|delete|teach)$")]
    name: Annotated[str, StringConstraints(pattern=r"^([a-z][a-z0-9_]{0,63}|[0-9]{1,10})$")] | None = None
    type: ObjectType | None = None
    version: Annotated[int, Field(ge=1, lt=2**31)] | None = None
    mesh: bytes = b""
    teaching: Teaching | None = None


class CatalogAnswer(Message):
    """The types asked for, or why not; of a single type also what follows from its shape."""

    ok: bool
    message: str = ""
    types: Annotated[tuple[ObjectType, ...], Strict(False)] = ()
    derived: Derived | None = None
    taught: Taught | None = None
