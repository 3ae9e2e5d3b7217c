"""The scenes of one camera's clouds: each is understood once, shared by all goals, and published."""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from zsight.convert import points_of
from zsight.scene_message import scene_of
from zsight_core import scene as scene_core

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from zsight.bus import Writer
    from zsight_core.scene import Checkpoint, Scene
    from zsight_core.scene_limits import SceneLimits
    from zsight_protocol import scene as message
    from zsight_protocol.point_cloud import PointCloud2

__all__ = ["SceneCache"]

_KEPT = 2  # scenes with their clouds, which may be large: of two clouds, or of one with and without a height given
_STEP = 0.01  # seconds between two looks at whether the goal was cancelled


@dataclass(eq=False)
class _Seen:
    """A cloud, what was known of it beforehand, its scene, and what finds have told of its segments."""

    cloud: PointCloud2
    known_height: float | None
    levelled: bool
    scene: Scene
    types: dict[int, str] = field(default_factory=dict)

    def suits(self, cloud: PointCloud2, known_height: float | None, levelled: bool, limits: SceneLimits) -> bool:
        """Whether this is the scene of that cloud; some cameras give all clouds one stamp, so it must be the same."""
        known = self.known_height == known_height and self.levelled == levelled
        return self.cloud is cloud and known and self.scene.limits == limits


class SceneCache:
    """Makes scenes, keeps the last few, publishes them where somebody reads them."""

    def __init__(self, writer: Writer[message.Scene], finder: str) -> None:
        """Args: writer of the camera's scenes; name of the finder."""
        self._writer = writer
        self._finder = finder
        self._kept: list[_Seen] = []
        self._lock = threading.Lock()

    def of(
        self,
        cloud: PointCloud2,
        *,
        T_world_camera: NDArray[np.float64] | None,
        known_height: float | None = None,
        limits: SceneLimits,
        checkpoint: Checkpoint = scene_core.go_on,
    ) -> Scene:
        """The scene of a cloud, made and published by whoever asks first; see zsight_core.scene.understand."""
        levelled = T_world_camera is not None
        while not self._lock.acquire(timeout=_STEP):
            checkpoint("scene", 0.0)  # another goal makes a scene meanwhile, which this one need not wait for
        try:
            for seen in self._kept:
                if seen.suits(cloud, known_height, levelled, limits):
                    return seen.scene
            scene = scene_core.understand(
                points_of(cloud),
                T_world_camera=T_world_camera,
                known_height=known_height,
                limits=limits,
                checkpoint=checkpoint,
            )
            seen = _Seen(cloud, known_height, levelled, scene)
            self._kept = [seen, *self._kept[: _KEPT - 1]]
            self._publish(seen)
            return scene
        finally:
            self._lock.release()

    def tell(self, scene: Scene, types: Mapping[int, str]) -> None:
        """What a find told of some segments, by label; a scene is published again when that is news."""
        with self._lock:
            for seen in self._kept:
                if seen.scene is scene and not types.items() <= seen.types.items():
                    seen.types |= types
                    self._publish(seen)

    def is_read(self) -> bool:
        """True where somebody reads the scenes."""
        return self._writer.has_readers()

    def _publish(self, seen: _Seen) -> None:
        if self.is_read():
            self._writer.send(scene_of(seen.scene, seen.cloud.header, seen.types, self._finder))
