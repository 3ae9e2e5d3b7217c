"""The finder service: answers find-object goals from the clouds of one camera."""

from __future__ import annotations

import contextlib
import difflib
import logging
import threading
import time
from collections import OrderedDict
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field, JsonValue

from zsight.action.server import ActionServer
from zsight.catalogue import type_files
from zsight.catalogue.server import serve_catalogue
from zsight.convert import points_of
from zsight.errors import ConnectionLost, UsageError, ZsightError
from zsight.finding import answering
from zsight.finding.find_progress import FindProgress
from zsight.finding.scene_cache import SceneCache
from zsight.finding.tracks import Tracks
from zsight.hosts.clocks import ask_clocks
from zsight.settings import Live
from zsight.settings import Settings as ServiceSettings
from zsight.transforms import TransformBuffer, TransformUnknown
from zsight_core import find as find_core
from zsight_core import level
from zsight_core import scene as scene_core
from zsight_core.errors import Cancelled, CoreError
from zsight_core.find import Answer
from zsight_core.scene_limits import SceneLimits
from zsight_protocol.find_object import ANY_TYPE, Capture, FindObjectGoal, FindObjectResult, ResultCode, Status
from zsight_protocol.geometry import TransformList
from zsight_protocol.message import Header, Time
from zsight_protocol.object_type import CatalogAnswer, Teaching
from zsight_protocol.point_cloud import PointCloud2
from zsight_protocol.scene import Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from zsight.action.server import GoalHandle
    from zsight.bus import Bus, Reader
    from zsight.catalogue.type_files import Catalogue
    from zsight_core.find import Detection

__all__ = ["FindObject", "Settings", "run"]

log = logging.getLogger(__name__)

_STAGES = 512  # clouds whose way is remembered; no goal works on an older one
_WAIT_STEP = 0.02  # seconds between two looks at the goal's deadline while it waits for a cloud
_GOAL_PATIENCE = 1.0  # seconds that the shape of a type is left for a goal
_CLOCKS_EVERY = 10.0  # seconds between two looks at the clocks of all hosts
_TRANSFORM_PATIENCE = 0.3  # seconds that a cloud waits for the transforms of its time


class Settings(ServiceSettings):
    """Settings of the finder service."""

    name: str = Field("finder", description="name of the finder in the keys")
    camera: str = Field("kinect", description="camera whose clouds are searched")
    catalogue: str = Field("", description="folder of further object types (YAML files)")
    parallel: int = Field(1, ge=1, le=64, description="goals at work at once (1 to 64)")
    queue: Live[int] = Field(
        16, ge=0, le=10000, description="goals that may wait; more are refused as busy (0 to 10000)"
    )
    oldest: Live[float] = Field(
        2.0, gt=0, le=3600, description="greatest age of a cloud that is searched, seconds (above 0, up to 3600)"
    )
    extrinsic_position: Live[float] = Field(
        0.002, ge=0, le=1, description="standard deviation of the camera's known place, metres along each axis (0 to 1)"
    )
    extrinsic_rotation: Live[float] = Field(
        0.001, ge=0, le=1, description="standard deviation of its known direction, radians about each axis (0 to 1)"
    )
    scene_rate: Live[float] = Field(
        2.0,
        ge=0,
        le=100,
        description="scenes a second that are published without a goal, where somebody reads them (0 to 100)",
    )
    lowest: Live[float] = Field(
        0.003,
        gt=0,
        le=0.2,
        description="height above a surface from which a point is of a thing, metres (above 0 to 0.2)",
    )
    highest: Live[float] = Field(
        0.6,
        gt=0,
        le=5,
        description="height above a surface up to which things are looked at, metres (above 0, up to 5)",
    )
    margin: Live[float] = Field(
        0.015, ge=0, le=0.5, description="how far things may hang over the outline of a surface, metres (0 to 0.5)"
    )
    smallest: Live[int] = Field(
        60, ge=12, le=10_000, description="pixels of a 640 x 480 image that a thing has at least (12 to 10000)"
    )
    largest: Live[float] = Field(
        0.7, gt=0, le=10, description="length of the longest thing, metres (above 0, up to 10)"
    )

    def limits(self) -> SceneLimits:
        """What counts as a thing."""
        return SceneLimits.of(self.model_dump())


def run(bus: Bus, settings: Settings) -> None:
    """Answer goals until told to stop."""
    own_folder = Path(settings.catalogue) if settings.catalogue else None
    catalogue = type_files.load(type_files.shipped_folder(), *([own_folder] if own_folder else []))
    work = FindObject(bus, settings, catalogue)
    # Types can be told of before kernels are there.
    told = bus.writer(bus.cell.catalogue(settings.name), CatalogAnswer)
    warm = threading.Event()

    def tell(types: CatalogAnswer) -> None:
        told.send(types)
        if warm.is_set():  # before a goal asks for them
            find_core.prepare(catalogue.models())

    catalogue_server = serve_catalogue(bus, catalogue, own_folder, work.teach, tell)
    find_core.warm_up()
    work.start_reading()
    server = ActionServer(bus, settings.name, FindObjectGoal, work, settings)
    bus.ready()
    warm.set()
    for model in catalogue.models():  # between goals, which themselves work out those shapes that they need
        server.rest(_GOAL_PATIENCE)
        find_core.prepare([model])
    bus.stopping.wait()
    catalogue_server.close()
    server.close()


class FindObject:
    """The find-object action on the newest cloud."""

    def __init__(self, bus: Bus, settings: Settings, catalogue: Catalogue) -> None:
        """Args: bus; settings; catalogue of the types that are known."""
        self._settings = settings
        self._catalogue = catalogue
        self._stopping = bus.stopping
        self._buffer = TransformBuffer()
        self._clouds = bus.reader(bus.cell.points(settings.camera), PointCloud2)
        self._bus = bus
        self._warnings: list[str] = []
        self._static = bus.reader(bus.cell.tf_static, TransformList)
        self._moving = bus.reader(bus.cell.tf, TransformList)
        self._newest: tuple[PointCloud2, float] | None = None
        self._came = threading.Condition()
        self._stages: OrderedDict[int, dict[str, float]] = OrderedDict()
        self._tracks = Tracks()
        self._scenes = SceneCache(bus.writer(bus.cell.scene(settings.camera), Scene), settings.name)

    def start_reading(self) -> None:
        """Keep the newest cloud and all transforms, and publish scenes, on threads that end with the bus."""
        threading.Thread(target=self._read_clouds, args=(self._clouds,), name="clouds", daemon=True).start()
        threading.Thread(target=self._publish_scenes, name="scenes", daemon=True).start()
        threading.Thread(target=self._watch_clocks, name="clocks", daemon=True).start()
        for reader, static in ((self._static, True), (self._moving, False)):
            threading.Thread(
                target=self._read_transforms, args=(reader, static), name="transforms", daemon=True
            ).start()

    def _read_clouds(self, reader: Reader[PointCloud2]) -> None:
        while (received := reader.take()) is not None:
            with self._came:
                self._newest = (received.message, time.monotonic())
                self._stages[received.message.header.stamp.ns] = received.stages_ms()
                if len(self._stages) > _STAGES:
                    self._stages.popitem(last=False)
                self._came.notify_all()
        with self._came:  # nobody need wait for another cloud
            self._came.notify_all()

    def _read_transforms(self, reader: Reader[TransformList], static: bool) -> None:
        for transforms in reader:
            self._buffer.put(transforms, static=static)

    def _publish_scenes(self) -> None:
        """Understand the newest cloud at the rate of the settings while somebody reads the scenes."""
        last, said = None, ""
        while not self._stopping.wait(1 / (self._settings.scene_rate or 1.0)):
            newest = self._newest
            wanted = self._settings.scene_rate > 0 and self._scenes.is_read()
            if newest is None or newest[0] is last or not wanted:
                continue
            last = newest[0]
            trouble = self._scene_trouble(last)
            wrong = "" if trouble is None else str(trouble) or type(trouble).__name__
            if wrong and wrong != said:  # a camera that goes on so must not fill the log
                bug = None if isinstance(trouble, ZsightError | CoreError) else trouble
                log.warning("no scene of the cloud at %d ns: %s", last.header.stamp.ns, wrong, exc_info=bug)
            said = wrong

    def _scene_trouble(self, cloud: PointCloud2) -> Exception | None:
        """Make and publish the scene of a cloud; why there is none, or nothing."""
        try:
            self._scenes.of(cloud, T_world_camera=self._gravity(cloud), limits=self._settings.limits())
        except Exception as error:  # noqa: BLE001  told by who asks, and no cloud ends the scenes of those after it
            return error
        return None

    def teach(self, name: str, asked: Teaching) -> CatalogAnswer:
        """Measure a thing in the newest cloud for a type of this name.

        Raises:
            UsageError: no cloud, another camera, no thing or several, no shape that fits.
        """
        if asked.camera not in ("", self._settings.camera):
            raise UsageError(f"this finder reads camera {self._settings.camera}, not {asked.camera}")
        type_files.require_type_name(name)
        with self._came:
            came = self._came.wait_for(
                lambda: self._age() <= self._settings.oldest or self._stopping.is_set(), self._settings.oldest
            )
            newest = self._newest
        if not came or newest is None or self._stopping.is_set():
            raise UsageError(f"no cloud comes on {self._clouds.counter.key}: is the camera running?")
        cloud = newest[0]
        frame = asked.frame_id or self._buffer.root_of(cloud.header.frame_id)
        T_frame_camera = self._buffer.lookup(frame, cloud.header.frame_id, cloud.header.stamp.ns)
        scene = self._scenes.of(cloud, T_world_camera=self._gravity(cloud), limits=self._settings.limits())
        header = Header(stamp=cloud.header.stamp, frame_id=frame)
        # It draws pictures, which nothing else here needs: half of what the finder imports.
        from zsight.catalogue import teaching

        kind, taught = teaching.teach(name, asked, points_of(cloud), scene, header, T_frame_camera)
        return CatalogAnswer(ok=True, types=(kind,), taught=taught)

    def _age(self) -> float:
        """Seconds since the newest cloud came; endless where none did."""
        return float("inf") if self._newest is None else time.monotonic() - self._newest[1]

    def _watch_clocks(self) -> None:
        """Warn of hosts whose clocks are off; in the log once, and in every answer."""
        told: set[str] = set()
        while not self._stopping.wait(_CLOCKS_EVERY):
            with contextlib.suppress(ConnectionLost):
                wrong = [clock for clock in ask_clocks(self._bus) if clock.warning]
                self._warnings = [clock.warning for clock in wrong]
                for clock in wrong:
                    if clock.host not in told:
                        log.warning("%s", clock.warning)
                told = {clock.host for clock in wrong}

    # The action.

    def refuse(self, goal: FindObjectGoal) -> FindObjectResult | None:
        """An unknown type is refused with the nearest names."""
        try:
            self._catalogue.wanted(goal.object_type)
        except UsageError as error:
            return self._no_answer(ResultCode.CODE_NOT_RECOGNISED, str(error))
        if goal.camera not in ("", self._settings.camera):
            wrong = f"this finder reads camera {self._settings.camera}, not {goal.camera}"
            return self._no_answer(ResultCode.CODE_NOT_RECOGNISED, wrong)
        return self._refuse_frame(goal.frame_id)

    def _refuse_frame(self, frame: str) -> FindObjectResult | None:
        """A frame that nobody has told of is refused, as soon as any frame is known."""
        known = self._buffer.frames()
        if not frame or not known or frame in known:
            return None
        near = difflib.get_close_matches(frame, known, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(sorted(known))}"
        return self._no_answer(ResultCode.CODE_NOT_RECOGNISED, f"no frame is called {frame!r}: {hint}")

    def busy(self, goal: FindObjectGoal) -> FindObjectResult:
        """No room."""
        del goal
        limits = f"{self._settings.parallel} at work and {self._settings.queue} waiting"
        return self._no_answer(ResultCode.BUSY, f"the finder is busy: {limits}; ask again later")

    def stopped(self, handle: GoalHandle[FindObjectGoal, FindObjectResult]) -> FindObjectResult:
        """Cancelled, or too late: with what is known so far."""
        where = f"at stage {handle.stage}" if handle.stage else "while it waited for its turn"
        if handle.deadline_passed:
            words = f"deadline of {handle.goal.timeout:g} s passed {where}"
            known = handle.known or self._no_answer(ResultCode.NOT_FOUND, "")
            result = known.model_copy(update={"message": words, "deadline_passed": True})
        else:
            result = self._no_answer(ResultCode.CANCELLED, f"cancelled {where}")
        return result.model_copy(update={"report": {**self._about(handle.goal), **handle.notes}})

    def failed(self, goal: FindObjectGoal, error: Exception) -> FindObjectResult:
        """Something in the cloud or the goal that no search is possible with."""
        words = str(error) if isinstance(error, ZsightError | CoreError) else f"{type(error).__name__}: {error}"
        code = ResultCode.CODE_NOT_RECOGNISED if isinstance(error, UsageError) else ResultCode.NOT_FOUND
        return self._no_answer(code, words).model_copy(update={"report": self._about(goal)})

    def _about(self, goal: FindObjectGoal) -> dict[str, JsonValue]:
        """What was asked, for whoever reads the report later."""
        return {"object_type": goal.object_type, "camera": self._settings.camera, "warnings": list(self._warnings)}

    def execute(self, handle: GoalHandle[FindObjectGoal, FindObjectResult]) -> FindObjectResult:
        """Wait for a cloud, understand its scene, look for the object."""
        goal = handle.goal
        started = time.monotonic()
        cloud = self._cloud_for(handle)
        if cloud is None:
            return self._no_cloud(handle)
        waited = time.monotonic() - started
        handle.notes["stamp_ns"] = cloud.header.stamp.ns
        frame, T_frame_camera = self._frame_for(handle, cloud)
        gravity = self._gravity(cloud)
        known_height = answering.height_in_world(goal.known_height, frame, T_frame_camera, gravity)
        name = self._catalogue.wanted(goal.object_type)
        progress = FindProgress(handle.checkpoint, len(self._catalogue.models()) if name == ANY_TYPE else 1)
        scene = self._scenes.of(
            cloud,
            T_world_camera=gravity,
            known_height=known_height,
            limits=self._settings.limits(),
            checkpoint=progress,
        )
        handle.notes |= {"supports": len(scene.supports), "segments": len(scene.segments)}
        sure: list[Detection] = []

        def result_of(answer: Answer) -> FindObjectResult:
            return answering.result_of(
                answer,
                self._catalogue,
                scene=scene,
                T_frame_camera=T_frame_camera,
                stamp=cloud.header.stamp,
                frame_id=frame,
                finder=self._settings.name,
                ids=self._ids(answer, cloud),
                extrinsic=self._extrinsic(frame, cloud),
            )

        try:
            answer = answering.find(
                points_of(cloud),
                self._catalogue,
                name,
                scene=scene,
                T_frame_camera=T_frame_camera,
                region=goal.region,
                maximum=goal.maximum,
                checkpoint=progress,
                on_found=sure.append,
            )
        except Cancelled:
            handle.known = result_of(Answer("found", tuple(sure), 1.0)) if sure else None
            raise
        self._scenes.tell(scene, answer.explained)
        result = answering.of_region(result_of(answer), goal.region, points_of(cloud), T_frame_camera)
        return self._with_circumstances(result, handle, cloud, waited)

    def _ids(self, answer: Answer, cloud: PointCloud2) -> list[str]:
        """Names that stay with the objects, by where they are in the world, or before the camera where that is all."""
        gravity = self._gravity(cloud)
        T_root_camera = np.eye(4) if gravity is None else gravity
        places = [(T_root_camera @ detection.T_camera_model)[:3, 3] for detection in answer.detections]
        return self._tracks.follow([d.type for d in answer.detections], np.array(places).reshape(-1, 3))

    def _extrinsic(self, frame: str, cloud: PointCloud2) -> answering.Extrinsic | None:
        """How well it is known where the camera is in the frame of the answer; in its own there is no doubt."""
        if frame == cloud.header.frame_id:
            return None
        return answering.Extrinsic(self._settings.extrinsic_position, self._settings.extrinsic_rotation)

    def _with_circumstances(
        self,
        result: FindObjectResult,
        handle: GoalHandle[FindObjectGoal, FindObjectResult],
        cloud: PointCloud2,
        waited: float,
    ) -> FindObjectResult:
        """The result with its cloud, its times, and what seems wrong where nothing was found."""
        timings: dict[str, float] = {
            **self._stages.get(cloud.header.stamp.ns, {}),
            "wait_for_cloud": waited * 1e3,
            "age_of_cloud": (Time.now().ns - cloud.header.stamp.ns) / 1e6,
            "in_finder": (time.monotonic() - handle.started) * 1e3,
        }
        about: dict[str, JsonValue] = {
            **self._about(handle.goal),
            "stamp_ns": cloud.header.stamp.ns,
            "cloud_frame": cloud.header.frame_id,
            "points": cloud.width * cloud.height,
            "transforms": [
                {"parent": parent, "child": child, "static": static}
                for parent, child, static in self._buffer.links(result.header.frame_id, cloud.header.frame_id)
            ],
        }
        return result.model_copy(
            update={
                "message": "" if result.objects else self._frame_mistake(cloud, handle) or result.message,
                "timings_ms": {**result.timings_ms, **timings},
                "report": {**result.report, **about},
            }
        )

    def _frame_mistake(self, cloud: PointCloud2, handle: GoalHandle[FindObjectGoal, FindObjectResult]) -> str:
        """Whether the camera's pose contradicts the level surface that its cloud shows.

        The answer is ready by then: its progress stands still, and a deadline that passes meanwhile ends only this.
        """
        T_world_camera = self._gravity(cloud)
        if T_world_camera is None:
            return ""
        try:
            free = scene_core.understand(
                points_of(cloud), checkpoint=lambda _stage, _fraction: handle.checkpoint(handle.stage, handle.fraction)
            )
        except Cancelled:
            return ""
        return level.frame_mistake(free.supports[0].normal, T_world_camera) if free.supports else ""

    def _cloud_for(self, handle: GoalHandle[FindObjectGoal, FindObjectResult]) -> PointCloud2 | None:
        """The cloud that the goal asks for; none where the camera is late."""
        patience = time.monotonic() + min(self._settings.oldest, handle.seconds_left() * 0.9)
        asked = handle.accepted.ns
        handle.checkpoint("cloud", 0.0)
        with self._came:
            while True:
                newest = self._newest
                if newest is not None and self._suits(newest, handle.goal, asked):
                    return newest[0]
                if time.monotonic() >= patience:
                    return None
                self._came.wait(_WAIT_STEP)
                handle.checkpoint("cloud", 0.0)

    def _suits(self, newest: tuple[PointCloud2, float], goal: FindObjectGoal, asked_ns: int) -> bool:
        cloud, came = newest
        if goal.capture is Capture.NEW:
            return cloud.header.stamp.ns >= asked_ns
        return time.monotonic() - came <= self._settings.oldest

    def _no_cloud(self, handle: GoalHandle[FindObjectGoal, FindObjectResult]) -> FindObjectResult:
        key, newest = self._clouds.counter.key, self._newest
        if newest is None:
            words = f"no cloud has come on {key}: is the camera running? See: zsight node list"
        elif handle.goal.capture is Capture.NEW and newest[1] > handle.started:
            early = (handle.accepted.ns - newest[0].header.stamp.ns) / 1e9
            words = (
                f"clouds come on {key}, but the newest was measured {early:.1f} s before the question by its stamp: "
                "do the hosts' clocks agree? See: zsight node clocks"
            )
        else:
            age = time.monotonic() - newest[1]
            words = f"the newest cloud on {key} came {age:.1f} s ago: has the camera stopped? See: zsight node list"
        log.warning("goal %s: %s", handle.goal_id, words)
        return self._no_answer(ResultCode.NOT_FOUND, words).model_copy(update={"report": self._about(handle.goal)})

    def _frame_for(
        self, handle: GoalHandle[FindObjectGoal, FindObjectResult], cloud: PointCloud2
    ) -> tuple[str, NDArray[np.float64]]:
        """The frame of the answer, and where the camera was in it: the goal's, else the root above the camera.

        A cloud may be here before the transforms of its time: they get a moment.
        """
        camera, stamp = cloud.header.frame_id, cloud.header.stamp.ns
        patience = time.monotonic() + min(_TRANSFORM_PATIENCE, handle.seconds_left() / 2)
        for reader in (self._static, self._moving):
            # What has come before the cloud must be known, or it is made up from what is older and newer.
            reader.caught_up(max(patience - time.monotonic(), 0.0))
        while True:
            frame = handle.goal.frame_id or self._buffer.root_of(camera)
            try:
                return frame, self._buffer.lookup(frame, camera, stamp)
            except TransformUnknown:
                if time.monotonic() >= patience:
                    raise
                handle.checkpoint("transforms", 0.0)
                self._stopping.wait(_WAIT_STEP)

    def _gravity(self, cloud: PointCloud2) -> NDArray[np.float64] | None:
        """Where the camera is in the world, if the world is known: its z is up."""
        camera = cloud.header.frame_id
        root = self._buffer.root_of(camera)
        return None if root == camera else self._buffer.lookup(root, camera, cloud.header.stamp.ns)

    def _no_answer(self, code: ResultCode, message: str, *, deadline_passed: bool = False) -> FindObjectResult:
        return FindObjectResult(
            header=Header(stamp=Time.now()),
            code=code,
            status=Status.CANNOT_TELL,
            message=message,
            finder=self._settings.name,
            deadline_passed=deadline_passed,
        )
