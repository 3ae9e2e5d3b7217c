"""A simulated world from a scene file: what stands where, the camera that looks at it, its noise."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, Self

import numpy as np
import yaml
from pydantic import Field, Strict, ValidationError, model_validator

from zsight.catalogue.type_files import Catalogue, shape_of
from zsight.errors import UsageError
from zsight_core import transform
from zsight_protocol.message import Float64, Message, Tuple3, Tuple4
from zsight_protocol.object_type import Channel8, ShapeOf

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight_core.model import ObjectModel
    from zsight_core.simulation.camera import Noise
    from zsight_core.simulation.world import Camera, World

__all__ = ["Scene", "SceneFile", "build", "find_scene", "read"]


class Step(Message):
    """One step of the chain from the world to the camera: the child's place in its parent, metres, radians."""

    parent: str
    frame: str
    position: Tuple3 = (0.0, 0.0, 0.0)
    rpy: Tuple3 | None = None
    orientation: Tuple4 | None = None

    @model_validator(mode="after")
    def _require_rotation(self) -> Self:
        if self.orientation is not None and abs(float(np.linalg.norm(self.orientation)) - 1) > 1e-3:
            raise ValueError(f"orientation {self.orientation} is no unit quaternion x y z w")
        return self

    @property
    def T_parent_child(self) -> NDArray[np.float64]:
        """The step as a matrix (4, 4)."""
        if self.orientation is not None:
            return transform.from_quaternion(self.position, self.orientation)
        return transform.from_rpy(self.position, self.rpy or (0, 0, 0))


class CameraEntry(Message):
    """The simulated camera."""

    frame: str
    chain: Annotated[tuple[Step, ...], Strict(False), Field(min_length=1)]
    width: Annotated[int, Field(ge=1, le=8192)] = 640
    height: Annotated[int, Field(ge=1, le=8192)] = 480
    hfov: Annotated[Float64, Field(gt=0, lt=3.1)] = 1.047
    rate: Annotated[Float64, Field(gt=0, le=1000)] = 10.0

    @model_validator(mode="after")
    def _require_chain(self) -> Self:
        for step, following in zip(self.chain, self.chain[1:], strict=False):
            if step.frame != following.parent:
                raise ValueError(f"the chain breaks: {step.frame} is followed by a step from {following.parent}")
        if self.chain[-1].frame != self.frame:
            raise ValueError(f"the chain ends at {self.chain[-1].frame}; expected the camera's frame {self.frame}")
        return self


class NoiseEntry(Message):
    """What the sensor adds to the truth."""

    model: Literal["none", "kinect", "time_of_flight"] = "none"
    seed: Annotated[int, Field(ge=0)] = 0


class ObjectEntry(Message):
    """One object: a catalogue type or a shape, and where it is."""

    name: str = ""
    type: str | None = None
    shape: ShapeOf | None = None
    colour: Annotated[tuple[Channel8, Channel8, Channel8], Strict(False)] | None = None
    position: Tuple3
    yaw: Float64 = 0.0
    rpy: Tuple3 | None = None
    reflects: Annotated[Float64, Field(ge=0, le=1)] = 1.0

    @model_validator(mode="after")
    def _require_one(self) -> Self:
        if (self.type is None) == (self.shape is None):
            raise ValueError("expected either a catalogue type or a shape")
        return self

    @property
    def T_world_model(self) -> NDArray[np.float64]:
        """Its place as a matrix (4, 4)."""
        return transform.from_rpy(self.position, self.rpy or (0, 0, self.yaw))


class SceneFile(Message):
    """A scene file as it is written."""

    name: str
    world_frame: str = "world"
    camera: CameraEntry
    noise: NoiseEntry = NoiseEntry()
    objects: Annotated[tuple[ObjectEntry, ...], Strict(False)] = ()


@dataclass(frozen=True)
class Scene:
    """A scene ready to be looked at."""

    file: SceneFile
    world: World
    camera: Camera
    noise: Noise | None

    def truth(self, kind: str) -> list[NDArray[np.float64]]:
        """T_world_model (4, 4) of every object of a catalogue type."""
        return [entry.T_world_model for entry in self.file.objects if entry.type == kind]


def find_scene(name: str) -> Path:
    """The file of a scene: a path, or the name of one that comes with zsight.

    Raises:
        UsageError: there is no such scene.
    """
    path = Path(name)
    if path.suffix == ".yaml":
        if not path.is_file():
            raise UsageError(f"scene file {path} does not exist")
        return path
    folder = Path(str(resources.files("zsight") / "scenes"))
    shipped = folder / f"{name}.yaml"
    if not shipped.is_file():
        known = ", ".join(sorted(p.stem for p in folder.glob("*.yaml")))
        raise UsageError(f"no scene is called {name!r}; expected one of {known}, or a .yaml file")
    return shipped


def read(path: Path) -> SceneFile:
    """A scene file.

    Raises:
        UsageError: it is not readable, or not a scene; says where.
    """
    try:
        return SceneFile.model_validate(yaml.safe_load(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from None
    except (UnicodeDecodeError, yaml.YAMLError) as error:
        raise UsageError(f"{path}: not readable as YAML: {error}") from None
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise UsageError(f"{path}: {where}: {first['msg'].removeprefix('Value error, ')}") from None


def build(file: SceneFile, catalogue: Catalogue) -> Scene:
    """The world, camera and noise of a scene file.

    Raises:
        UsageError: an object's type is not in the catalogue.
    """
    from zsight_core.pinhole import Pinhole
    from zsight_core.simulation.kinect import Kinect
    from zsight_core.simulation.time_of_flight import TimeOfFlight
    from zsight_core.simulation.world import Body, Camera, World

    bodies = tuple(
        Body(entry.name or entry.type or "object", _model_of(entry, catalogue), entry.T_world_model, entry.reflects)
        for entry in file.objects
    )
    focal = file.camera.width / 2 / np.tan(file.camera.hfov / 2)
    centre = ((file.camera.width - 1) / 2, (file.camera.height - 1) / 2)
    pinhole = Pinhole(file.camera.width, file.camera.height, focal, focal, *centre)
    T_world_camera = np.eye(4)
    for step in file.camera.chain:
        T_world_camera = T_world_camera @ step.T_parent_child
    noises: dict[str, Noise | None] = {"none": None, "kinect": Kinect(), "time_of_flight": TimeOfFlight()}
    return Scene(file, World(bodies), Camera(pinhole, T_world_camera), noises[file.noise.model])


def _model_of(entry: ObjectEntry, catalogue: Catalogue) -> ObjectModel:
    from zsight_core.model import ObjectModel

    if entry.shape is not None:
        return ObjectModel(entry.name or "object", shape_of(entry.shape, Path()), entry.colour)
    model = catalogue.model(catalogue.resolve(entry.type or "").name)
    return model if entry.colour is None else ObjectModel(model.name, model.shape, entry.colour)
