"""The object types that the finders of a cell know, as a program lists, adds, removes and teaches them."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict, Unpack

from pydantic import ValidationError

from zsight.errors import RequestRefused, UsageError
from zsight.question import PATIENCE, ask_question
from zsight_protocol.errors import DecodeError
from zsight_protocol.object_type import CatalogAnswer, CatalogRequest, Taught, Teaching

if TYPE_CHECKING:
    import builtins
    from collections.abc import Sequence

    from zsight.bus import Bus
    from zsight_protocol.object_type import Derived, ObjectType

__all__ = ["Catalog", "Lesson"]

_EVERY = "*"


class Lesson(TypedDict, total=False):
    """What may be said of a thing that a type is made of.

    place: any place in the thing or near it, metres; left out: the only thing on the best surface.
    frame: of the place and of the answer; empty: the world where it is known, else the camera's.
    camera: whose clouds are looked at; empty: any that a finder reads.
    shape: box, cylinder, lying cylinder or sphere; empty: the one that fits best.
    code: number of the type.
    notes: for people.
    keep: False: it is only measured.
    timeout: seconds; 20 if not given.
    """

    place: tuple[float, float, float] | None
    frame: str
    camera: str
    shape: str
    code: int | None
    notes: str
    keep: bool
    timeout: float


class Catalog:
    """The object types that the finders of a cell know; what is changed is changed at all of them."""

    def __init__(self, bus: Bus) -> None:
        """Args: bus of the cell."""
        self._bus = bus

    def list(self) -> builtins.list[ObjectType]:
        """All types that any finder knows, by name."""
        answers = self._ask(CatalogRequest(action="list"), _EVERY)
        known = {kind.name: kind for answer in answers for kind in answer.types}
        return [known[name] for name in sorted(known)]

    def get(self, name: str, version: int | None = None) -> ObjectType:
        """One type by name or number, as it is or as it was in some version.

        Raises:
            RequestRefused: it is not known.
        """
        request = _about("get", name).model_copy(update={"version": version})
        return self._ask(request, name)[0].types[0]

    def derived(self, name: str) -> Derived:
        """What follows from the shape of a type: size, symmetries, stable poses.

        Raises:
            RequestRefused: it is not known, or its mesh cannot be read.
        """
        told = [answer.derived for answer in self._ask(_about("get", name), name) if answer.derived is not None]
        if not told:
            raise RequestRefused(f"no finder tells anything of the shape of {name}")
        return told[0]

    def add(self, kind: ObjectType, mesh: bytes = b"") -> str:
        """Add a type to every finder, or change the one of its name; what they say.

        Args:
            kind: the type.
            mesh: its mesh file, where it has one that the finders lack.

        Raises:
            RequestRefused: every finder refused it: its mesh is missing or cannot be read.
        """
        return _words(self._ask(CatalogRequest(action="put", type=kind, mesh=mesh), kind.name))

    def remove(self, name: str) -> str:
        """Remove a type from every finder that knows it; what they say.

        Raises:
            RequestRefused: none knows it.
        """
        return _words([answer for answer in self._ask(_about("delete", name), name) if answer.ok])

    def teach(self, name: str, **lesson: Unpack[Lesson]) -> tuple[ObjectType, Taught]:
        """Make a type of a thing that stands before a camera, and add it to every finder.

        A type of this name that is there becomes the next version of itself, and keeps its number, notes, grasps and
        properties where no others are given.

        Args:
            name: of the type.
            lesson: see Lesson.

        Returns:
            The type as the finders have it, and where the thing stands, how well the shape explains it, and a picture
            (PNG).

        Raises:
            RequestRefused: no thing or several are meant, no shape fits, or the view does not show all dimensions.
            NobodyAnswers: no finder is there.
            UsageError: an argument makes no sense.
        """
        try:
            asked = Teaching(
                camera=lesson.get("camera", ""),
                place=lesson.get("place"),
                frame_id=lesson.get("frame", ""),
                shape=lesson.get("shape", ""),
                code=lesson.get("code"),
                notes=lesson.get("notes", ""),
            )
        except ValidationError as error:
            raise UsageError(str(DecodeError.from_validation("lesson", error))) from None
        request = _about("teach", name).model_copy(update={"teaching": asked})
        answer = self._ask(request, name, lesson.get("timeout", 20.0))[0]
        if answer.taught is None:
            raise RequestRefused(f"the finder measured nothing for {name}")
        kind = answer.types[0]
        if not lesson.get("keep", True):
            return kind, answer.taught
        for known in self.list():
            if known.name == name:
                kind = _relearnt(known, kind)
        self.add(kind)
        return self.get(name), answer.taught

    def _ask(self, request: CatalogRequest, name: str, timeout: float = PATIENCE) -> Sequence[CatalogAnswer]:
        """The finders' answers, those that agree first; an error where all of them refuse."""
        key = self._bus.cell.catalog(name)
        answers = ask_question(self._bus, key, request, CatalogAnswer, everyone=True, timeout=timeout)
        if not any(answer.ok for answer in answers):
            raise RequestRefused(_words(answers))
        return sorted(answers, key=lambda answer: not answer.ok)


def _relearnt(known: ObjectType, measured: ObjectType) -> ObjectType:
    """A type that was measured anew, with what else is known of it."""
    return measured.model_copy(
        update={
            "code": known.code if measured.code is None else measured.code,
            "notes": measured.notes or known.notes,
            "grasps": known.grasps,
            "properties": known.properties,
        }
    )


def _words(answers: Sequence[CatalogAnswer]) -> str:
    """What several finders say, each thing once."""
    return "; ".join(dict.fromkeys(answer.message for answer in answers))


def _about(action: str, name: str) -> CatalogRequest:
    try:
        return CatalogRequest(action=action, name=name)
    except ValidationError:
        expected = "expected lower-case letters, digits and '_', such as toy_block, or a number of the book"
        raise UsageError(f"no type can be called {name!r}; {expected}") from None
