"""Find objects of known types in a cloud, and say how sure.

``find`` reads as the figure: scene, hypotheses, a quick look at each, refinement and verification of the best, one
answer a place. What comes after the hypotheses knows nothing of shapes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from zsight_core import render
from zsight_core import scene as scene_stage
from zsight_core.errors import ModelError
from zsight_core.model import ObjectModel, Surface, size_of
from zsight_core.scene import Checkpoint, Scene, go_on, understand
from zsight_core.search import (
    bits,
    candidates,
    claims,
    clues,
    contest,
    contour,
    model_bits,
    overlap,
    peek,
    recognise,
    refine,
    verify,
)
from zsight_core.search.candidates import DOUBTFUL, Candidate, Candidates, Counts, Trials, is_sure, net
from zsight_core.search.claims import Claim, consistent, contradict
from zsight_core.search.contest import TELLING, mark
from zsight_core.search.overlap import hull_area, radius, shared
from zsight_core.search.recognise import votes
from zsight_core.search.recognise.surface import surfaces
from zsight_core.search.symmetry import least_turned
from zsight_core.solid import Solid, solid_of
from zsight_core.transform import inverse

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from zsight_core.points import Points
    from zsight_core.scene import Segment
    from zsight_core.search.clues import Clues, Hypothesis
    from zsight_core.search.verify import Evidence

__all__ = ["Answer", "Detection", "find", "prepare", "warm_up"]

Status = Literal["found", "not_found", "cannot_tell"]

BOX_MARGIN = 0.01
"""Metres around a detection's box that still count as of it."""

SAME_SURFACE = 0.005
"""Metres within which two poses put the surface at one place, as the symmetries of a shape do."""

NOISE_SHARED = 6.5
"""Pixels and outline samples that share one error: depth is rounded, and neighbours are smoothed by the sensor."""

ACCEPTED = 0.5
"""Probability from which a candidate is reported."""

FARTHEST_SHARING = 0.4
"""Solids whose middles are farther apart than the larger one's reach and this part of the smaller one's do not share
ROOM_SHARED: of a rod, the worst case, three tenths lie farther out than four tenths of its reach."""

GUESSED_WITHIN = 0.01
"""Metres by which a hypothesis may be off."""

GUESSED_SHARED = 0.05
"""Room that a hypothesis must share with a candidate, from which its fit may contradict it."""

SURELY_SEEN = 0.5
"""Probability of having been seen below which an absent object makes the answer cannot_tell."""


@dataclass(frozen=True, eq=False)
class Detection:
    """One object found."""

    type: str
    score: float
    """Probability that it is there, 0..1."""
    T_camera_model: NDArray[np.float64]
    """(4, 4) pose in the cloud's frame."""
    T_world_model: NDArray[np.float64] | None
    """(4, 4) pose in the world, where the camera's pose is known."""
    size: tuple[float, float, float]
    """Along the model's axes, metres; of a surface, its extents."""
    measured_height: float
    """Metres from its foot to the highest points measured on it; of a surface, 0."""
    covariance: NDArray[np.float64]
    """(6, 6) of position (m) and rotation vector (rad) in the support's frame; the camera's pose has no part."""
    visible_fraction: float
    support: int
    """Number of the support surface."""
    base: float
    """Height of its foot over the support surface, metres."""
    truncated: bool
    """The image's border cuts it."""
    occluded: bool
    """Something in front hides a part of it."""
    equivalents: tuple[NDArray[np.float64], ...] = ()
    """Other poses (4, 4) in the cloud's frame that fit what is seen equally well."""
    runner_up: str | None = None
    """The type that fits second best here."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What a query comes to."""

    status: Status
    detections: tuple[Detection, ...]
    """Most probable first."""
    p_absent: float
    """Probability that no further object of the type is there, given that it would be seen where the view is free."""
    obstacles: tuple[Segment, ...] = ()
    """Segments that no detection explains: unknown things with a box around them."""
    explained: dict[int, str] = field(default_factory=dict)
    """Labels of the other segments, with the type that explains each."""
    report: dict[str, Any] = field(default_factory=dict)
    """Stages with counts, milliseconds, and the candidates rejected with what cut them."""


def find(
    points: Points,
    models: Sequence[ObjectModel],
    *,
    scene: Scene | None = None,
    T_world_camera: NDArray[np.float64] | None = None,
    known_height: float | None = None,
    region: tuple[Sequence[float], Sequence[float]] | None = None,
    maximum: int | None = None,
    rivals: Sequence[ObjectModel] = (),
    checkpoint: Checkpoint = go_on,
    on_found: Callable[[Detection], object] = lambda _: None,
) -> Answer:
    """Find all objects of some types.

    Args:
        points: (H, W) organised or (1, N) cloud, metres.
        models: types to look for.
        scene: what ``scene.understand`` made of the same cloud; None: it is made here.
        T_world_camera: (4, 4) pose of the cloud's frame in a world with z up, or None.
        known_height: world z of the support surface, metres, or None.
        region: low and high corner (3,) of an axis-aligned box in the world frame, or the cloud's frame where
            T_world_camera is None; only objects with their centre inside are reported.
        maximum: most objects to report, the most probable ones; None: all.
        rivals: types that may stand there instead; a place that a rival explains better is not reported.
        checkpoint: called at every stage and within long loops; what it raises ends the search.
        on_found: called with each detection when it is sure, for a caller that may stop the search.

    Returns:
        The answer; for the same cloud and arguments the same, bit for bit.

    Raises:
        PointsError: nothing finite in the cloud, or not in metres.
        ModelError: a model has no recognisable shape.
        Cancelled: raised by the checkpoint.
    """
    start = perf_counter()
    if scene is None:
        scene = understand(points, T_world_camera=T_world_camera, known_height=known_height, checkpoint=checkpoint)
    report: dict[str, Any] = {
        "timings_ms": dict(scene.timings_ms),
        "supports": len(scene.supports),
        "segments": len(scene.segments),
        "hypotheses": 0,
        "refined": 0,
        "rejected": [],
    }
    search = _Search(scene, T_world_camera, region, checkpoint, report, on_found, models=models)
    found: list[Detection] = []
    doubtful = False
    seen = 1.0
    for number, model in enumerate(models):
        checkpoint("contest", number / len(models))
        if isinstance(model.shape, Surface):
            found += search.surfaces(model)
            continue
        detections, unsure, p_seen = search.solids(model, rivals)
        found += detections
        doubtful |= unsure
        seen = min(seen, p_seen)
    found.sort(key=lambda d: -d.score)
    report["timings_ms"]["total"] = (perf_counter() - start) * 1e3
    if found:
        explained = search.explained(found)
        obstacles = tuple(segment for segment in scene.segments if segment.label not in explained)
        return Answer("found", tuple(found[:maximum]), seen, obstacles, explained, report)
    unsure = doubtful or not scene.supports or seen < SURELY_SEEN
    status: Status = "cannot_tell" if unsure else "not_found"
    return Answer(status, (), seen if scene.supports else 0.0, tuple(scene.segments), {}, report)


def prepare(models: Sequence[ObjectModel]) -> None:
    """Work out what is known of types before any scene, so that no search waits for it.

    Args:
        models: types that will be asked for, or that will be rivals.

    Raises:
        ModelError: a model has no recognisable shape.
    """
    for model in models:
        if not isinstance(model.shape, Surface):
            solid_of(model.shape)
            radius(solid_of(model.shape, coarse=True))
            recognise.prepare(model.shape)


def warm_up() -> None:
    """Compile all kernels of the finder (or load them from their cache)."""
    scene_stage.warm_up()
    of_shapes = (overlap, model_bits)
    for module in (clues, *of_shapes, render, contour, refine, verify, bits, votes, peek, contest, claims, candidates):
        module.warm_up()


_Member = tuple[ObjectModel, Candidate, Claim]


class _Pool:
    """Candidates of which those that contradict each other cannot all be there."""

    def __init__(self, candidates: Candidates) -> None:
        self.candidates = candidates
        self.members: list[_Member] = []

    def add(self, model: ObjectModel, candidate: Candidate, beside: Claim | None = None) -> Claim | None:
        """Take in a candidate that is not hopeless, and its claim; with one beside it, only if both cannot be there."""
        if candidate.probability > DOUBTFUL and all(candidate is not known for _, known, _ in self.members):
            claim = self.candidates.claim(model.shape, candidate)
            if beside is None or contradict(claim, beside):
                self.members.append((model, candidate, claim))
                return claim
        return None

    @cached_property
    def there(self) -> set[int]:
        """Which members, by identity of the candidate, are there."""
        probable = [(candidate, claim) for _, candidate, claim in self.members if candidate.probability >= ACCEPTED]
        return {id(probable[k][0]) for k in consistent([claim for _, claim in probable])}

    @cached_property
    def owners(self) -> NDArray[np.int16]:
        """Which member, by its number, explains each pixel (H, W) of those that are there."""
        scene = self.candidates.scene
        owners = self.candidates.nobody.copy()
        for number, (_, candidate, (solid, T, _, _)) in enumerate(self.members):
            if self.is_there(candidate):
                mark(scene.view.depth, scene.view.pinhole, solid.vertices, solid.faces, T, scene.noise, number, owners)
        return owners

    def number_of(self, candidate: Candidate) -> int:
        """Where it is in the list of members."""
        return next(number for number, (_, known, _) in enumerate(self.members) if known is candidate)

    def is_there(self, candidate: Candidate) -> bool:
        """True where it is of the set that explains most."""
        return id(candidate) in self.there

    def rival_of(self, candidate: Candidate) -> str | None:
        """The other type that contradicts a member and explains most, those that are there before others."""
        model, own = next((model, claim) for model, known, claim in self.members if known is candidate)
        against = [
            (id(other) in self.there, claim.worth, other_model.name)
            for other_model, other, claim in self.members
            if other_model.name != model.name and contradict(own, claim)
        ]
        return max(against)[2] if against else None


class _Search:
    """One query's scene, limits and record."""

    def __init__(
        self,
        scene: Scene,
        T_world_camera: NDArray[np.float64] | None,
        region: tuple[Sequence[float], Sequence[float]] | None,
        checkpoint: Checkpoint,
        report: dict[str, Any],
        on_found: Callable[[Detection], object],
        *,
        models: Sequence[ObjectModel],
    ) -> None:
        self.scene = scene
        self.T_world_camera = T_world_camera
        self.region = region
        self.checkpoint = checkpoint
        self.report = report
        self.on_found = on_found
        self.models = models
        self.many = len(models) > 1
        self.pool: _Pool | None = None

    @cached_property
    def candidates(self) -> Candidates:
        """Candidates of any type, looked for when first asked for."""
        return Candidates(self.scene, self.checkpoint)

    @property
    def clues(self) -> Clues:
        """What there is to see in the scene."""
        return self.candidates.clues

    def surfaces(self, model: ObjectModel) -> list[Detection]:
        """Support surfaces that are large enough."""
        if not isinstance(model.shape, Surface):
            raise ModelError(f"{model.name} is a {type(model.shape).__name__}; expected a surface")
        found = []
        for number, support in surfaces(model.shape, self.scene):
            T_support_model, extents = _rectangle_around(support.outline)
            T = support.T_camera_support @ T_support_model
            if not self._wanted(T):
                continue
            covariance = np.zeros((6, 6))
            covariance[2:5, 2:5] = support.covariance
            world = None if self.T_world_camera is None else self.T_world_camera @ T
            size = (extents[0], extents[1], 0.0)
            score = 1.0 - np.exp(-support.inliers / 300)
            found.append(
                Detection(
                    model.name,
                    float(score),
                    T,
                    world,
                    size,
                    0.0,
                    covariance,
                    1.0,
                    number,
                    0.0,
                    truncated=False,
                    occluded=False,
                )
            )
        return found

    def explained(self, found: list[Detection]) -> dict[int, str]:
        """Labels of the segments of which at least half lies in boxes of detections, with the type of the fullest."""
        known: dict[int, str] = {}
        solids = [detection for detection in found if detection.size[2] > 0]  # a surface is not what stands on it
        for piece in self.clues.segments:
            T_camera_support = self.scene.supports[piece.support].T_camera_support
            inside, fullest = np.zeros(len(piece.points), np.bool_), 0.0
            for detection in solids:
                T = inverse(detection.T_camera_model) @ T_camera_support
                reach = float(np.linalg.norm(detection.size)) / 2 + 2 * BOX_MARGIN
                if float(np.linalg.norm(piece.beyond(-T[:3, :3].T @ T[:3, 3]))) > reach:
                    continue
                there = np.abs(piece.points @ T[:3, :3].T + T[:3, 3])
                within = (there < np.array(detection.size) / 2 + BOX_MARGIN).all(axis=1)
                inside |= within
                if within.mean() > fullest:
                    fullest = float(within.mean())
                    known[piece.segment] = detection.type
            if inside.mean() < 0.5:
                known.pop(piece.segment, None)
        return known

    def solids(self, model: ObjectModel, rivals: Sequence[ObjectModel]) -> tuple[list[Detection], bool, float]:
        """Objects of one type, whether one may be there half hidden, and how likely it would have been seen."""
        trials, pool = self._trials(model), self._pool(model, rivals)
        found, doubtful = [], False
        for candidate, ways in zip(trials.kept, trials.ways, strict=True):
            if not self._wanted(self._in_cloud(candidate.hypothesis)):
                continue
            if candidate.probability < ACCEPTED:
                doubtful |= candidate.probability > DOUBTFUL and _is_cut(candidate.evidence)
                self._reject(model, candidate)
                continue
            rival = pool.rival_of(candidate)
            if not pool.is_there(candidate):
                self._reject(model, candidate, rival)
                continue
            best, equals = self._told(model, candidate, ways, pool)
            found.append(self._detection(model, best, equals, rival))
            self.on_found(found[-1])
        return found, doubtful, self._seen(size_of(model.shape))

    def _told(
        self, model: ObjectModel, candidate: Candidate, ways: list[Candidate], pool: _Pool
    ) -> tuple[Candidate, list[Candidate]]:
        """The way to be there that what others do not explain is most for, and those not told from it."""
        if len(ways) == 1:
            return candidate, []
        own = pool.number_of(candidate)
        best, alike = self.candidates.best_of(model.shape, ways, pool.owners, own, TELLING)
        return best, _apart_from(best, alike, solid_of(model.shape, coarse=True))

    def _trials(self, model: ObjectModel) -> Trials:
        """Candidates of a type asked for."""
        if not self.scene.supports:
            return Trials([], [], [])
        trials, counts = self._known[id(model)]
        self.report["hypotheses"] += counts.hypotheses
        self.report["refined"] += counts.refined
        return trials

    @cached_property
    def _known(self) -> dict[int, tuple[Trials, Counts]]:
        """Candidates of all types asked for; the largest first, for small things may be seen on sides of large ones."""
        solids = _largest_first([model for model in self.models if not isinstance(model.shape, Surface)])
        found, turns = {}, self.candidates.in_turn(solids)
        for number, model in enumerate(solids):
            self.checkpoint("search", number / len(solids))
            start = perf_counter()
            found[id(model)] = next(turns)
            self.report["timings_ms"][model.name] = (perf_counter() - start) * 1e3
        return found

    def _pool(self, model: ObjectModel, rivals: Sequence[ObjectModel]) -> _Pool:
        """All that may be there and contradict each other: candidates of what is asked for and of its rivals."""
        if self.many and self.pool is not None:
            return self.pool
        asked = [m for m in self.models if not isinstance(m.shape, Surface)] if self.many else [model]
        pool = self.pool = _Pool(self.candidates)
        if not self.scene.supports:
            return pool
        for one in asked:
            for candidate in self._known[id(one)][0].kept:
                pool.add(one, candidate)
        names = {one.name for one in asked}
        others = [rival for rival in rivals if rival.name not in names and not isinstance(rival.shape, Surface)]
        probable = [member for member in pool.members if member[1].probability >= ACCEPTED]
        beaten: set[int] = set()
        for one, candidate, claim in probable:
            for rival in _largest_first(others) if not is_sure(candidate) else ():
                if id(candidate) in beaten:
                    break
                if self._most_pixels(rival, candidate.hypothesis) > net(candidate):
                    for other in self._candidates_of_rival(rival, one, candidate):
                        against = pool.add(rival, other, beside=claim)
                        if against and other.probability >= ACCEPTED:
                            beaten |= _beaten_by(against, probable)
        return pool

    def _most_pixels(self, rival: ObjectModel, there: Hypothesis) -> float:
        """Pixels that the rival covers at most at a place: half the area of its hull, seen straight on."""
        z = float((self.clues.frames[there.support] @ there.T_support_model[:, 3])[2]) - max(size_of(rival.shape)) / 2
        fx, fy, _, _ = self.scene.view.pinhole
        return hull_area(solid_of(rival.shape, coarse=True)) / 2 * fx * fy / max(z, 0.1) ** 2

    def _candidates_of_rival(self, rival: ObjectModel, model: ObjectModel, candidate: Candidate) -> list[Candidate]:
        """Candidates of a rival: all where many types are asked for, else those where the candidate is."""
        if self.many or self.candidates.knows(rival):
            return self.candidates.of(rival)[0].kept
        there, solid = candidate.hypothesis, solid_of(model.shape, coarse=True)
        T = there.T_support_model
        z = solid.vertices @ T[2, :3] + T[2, 3]
        less, more = sorted((radius(solid), radius(solid_of(rival.shape, coarse=True))))
        apart = more + FARTHEST_SHARING * less + GUESSED_WITHIN
        heights = (float(z.min()) - GUESSED_WITHIN, float(z.max()) + GUESSED_WITHIN)
        around = self.clues.near(T[:2, 3], less + more, apart, there.support, heights)

        def suits(guess: Hypothesis) -> bool:
            T_a, T_b = (self.clues.frames[h.support] @ h.T_support_model for h in (there, guess))
            return shared(solid, T_a, solid_of(rival.shape, coarse=True), T_b) > GUESSED_SHARED

        return self.candidates.among(rival, around, candidate.probability * net(candidate), suits)[1]

    def _in_cloud(self, hypothesis: Hypothesis) -> NDArray[np.float64]:
        T: NDArray[np.float64] = self.scene.supports[hypothesis.support].T_camera_support @ hypothesis.T_support_model
        return T

    def _wanted(self, T_camera_model: NDArray[np.float64]) -> bool:
        """True where the centre lies in the region asked for."""
        if self.region is None:
            return True
        T = T_camera_model if self.T_world_camera is None else self.T_world_camera @ T_camera_model
        low, high = np.asarray(self.region[0]), np.asarray(self.region[1])
        return bool((T[:3, 3] >= low).all() and (T[:3, 3] <= high).all())

    def _reject(self, model: ObjectModel, candidate: Candidate, rival: str | None = None) -> None:
        evidence = candidate.evidence
        self.report["rejected"].append(
            {
                "type": model.name,
                "probability": round(candidate.probability, 4),
                "threshold": ACCEPTED,
                "rival": rival,
                "position": [round(float(x), 4) for x in self._in_cloud(candidate.hypothesis)[:3, 3]],
                "agreement": round(evidence.agreement, 3),
                "outline": round(evidence.outline, 3),
                "visible": round(evidence.visible, 3),
            }
        )

    def _detection(
        self, model: ObjectModel, candidate: Candidate, equals: list[Candidate], runner_up: str | None
    ) -> Detection:
        hypothesis, evidence = candidate.hypothesis, candidate.evidence
        T = self._least_turned(self._in_cloud(hypothesis), model, hypothesis.support)
        return Detection(
            type=model.name,
            score=candidate.probability,
            T_camera_model=T,
            T_world_model=None if self.T_world_camera is None else self.T_world_camera @ T,
            size=size_of(model.shape),
            measured_height=self._height_at(hypothesis, max(size_of(model.shape))),
            covariance=self._covariance(candidate, equals),
            visible_fraction=evidence.visible,
            support=hypothesis.support,
            base=hypothesis.base,
            truncated=evidence.beyond > 0.02 * evidence.pixels,
            occluded=evidence.hidden > 0.05 * evidence.pixels,
            equivalents=tuple(self._in_cloud(equal.hypothesis) for equal in equals),
            runner_up=runner_up,
        )

    def _least_turned(self, T: NDArray[np.float64], model: ObjectModel, support: int) -> NDArray[np.float64]:
        """Of all poses in the cloud that look like T, the one turned least in the world, or else on its surface."""
        known = self.scene.T_world_camera
        R = (inverse(self.scene.supports[support].T_camera_support) if known is None else known)[:3, :3]
        turned = T.copy()
        turned[:3, :3] = T[:3, :3] @ least_turned(R @ T[:3, :3], model.shape)
        return turned

    def _height_at(self, hypothesis: Hypothesis, reach: float) -> float:
        """Metres from the foot to the highest points of the segment here."""
        place = hypothesis.T_support_model[:2, 3]
        near = [
            piece.points
            for piece in self.clues.segments
            if piece.support == hypothesis.support
            and (piece.beyond(place) < reach / 2).all()
            and (((piece.points[:, :2] - place) ** 2).sum(axis=1) < reach * reach / 4).mean() > 0.5
        ]
        if not near:
            return 0.0
        return float(np.quantile(np.concatenate(near)[:, 2], 0.97)) - hypothesis.base

    def _covariance(self, candidate: Candidate, equals: list[Candidate]) -> NDArray[np.float64]:
        """(6, 6): x, y, height and yaw from the fit and from equivalent poses, tilts from the support surface."""
        covariance = np.zeros((6, 6))
        fitted = NOISE_SHARED * np.linalg.inv(candidate.information)
        for equal in equals:
            apart = _apart(candidate.hypothesis.T_support_model, equal.hypothesis.T_support_model)
            fitted += np.outer(apart, apart) / (len(equals) + 1)
        rows = np.array([0, 1, 2, 5])
        covariance[np.ix_(rows, rows)] = fitted
        if not candidate.hypothesis.turns:
            covariance[5, :] = covariance[:, 5] = 0.0
            covariance[5, 5] = np.pi**2 / 3
        surface = self.scene.supports[candidate.hypothesis.support].covariance
        covariance[3:5, 3:5] += surface[1:, 1:]
        covariance[2, 2] += surface[0, 0]
        return covariance

    @cached_property
    def _everywhere(self) -> NDArray[np.float64]:
        """Places (N, 2) all over the best support."""
        outline = self.scene.supports[0].outline
        low, high = outline.min(axis=0), outline.max(axis=0)
        x, y = np.meshgrid(*(np.linspace(a, b, 24) for a, b in zip(low, high, strict=True)))
        xy = np.stack([x.ravel(), y.ravel()], axis=1)
        inside: NDArray[np.float64] = xy[_inside(xy, outline)]
        return inside

    def _seen(self, size: tuple[float, float, float]) -> float:
        """Share of the best support where the middle of such an object would be seen."""
        if not self.scene.supports:
            return 0.0
        view, xy, T = self.scene.view, self._everywhere, self.clues.frames[0]
        places = np.column_stack([xy, np.full(len(xy), min(size) / 2)]) @ T[:3, :3].T + T[:3, 3]
        u = np.round(places[:, 0] / places[:, 2] * view.fx + view.cx).astype(np.int64)
        v = np.round(places[:, 1] / places[:, 2] * view.fy + view.cy).astype(np.int64)
        inside = (u >= 0) & (v >= 0) & (u < view.depth.shape[1]) & (v < view.depth.shape[0]) & (places[:, 2] > 0)
        measured = np.zeros(len(xy))
        measured[inside] = view.depth[v[inside], u[inside]]
        free = inside & (measured > places[:, 2] - 0.03)
        return float(free.mean()) if len(free) else 0.0


def _apart_from(candidate: Candidate, others: list[Candidate], solid: Solid) -> list[Candidate]:
    """Those others that put the surface elsewhere than the candidate and those before."""
    found: list[Candidate] = []
    for other in others:
        if all(_differ(solid, other.hypothesis, known.hypothesis) for known in [candidate, *found]):
            found.append(other)
    return found


def _differ(solid: Solid, a: Hypothesis, b: Hypothesis) -> bool:
    """True where the surface of one pose is more than SAME_SURFACE from that of the other; a coarse solid will do."""
    one, two = (T[:3, :3] @ solid.vertices.T + T[:3, 3:] for T in (a.T_support_model, b.T_support_model))
    squares = ((one[:, :, np.newaxis] - two[:, np.newaxis]) ** 2).sum(axis=0)
    return bool(squares.min(axis=1).max() > SAME_SURFACE**2)


def _apart(T_a: NDArray[np.float64], T_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """x, y, height and yaw (4,) from one pose to the other."""
    R = T_b[:3, :3] @ T_a[:3, :3].T
    return np.append(T_b[:3, 3] - T_a[:3, 3], np.arctan2(R[1, 0] - R[0, 1], R[0, 0] + R[1, 1]))


def _largest_first(models: list[ObjectModel]) -> list[ObjectModel]:
    """Solids by the area of their hulls, which need not be known of one alone."""
    return sorted(models, key=lambda model: -hull_area(solid_of(model.shape, coarse=True))) if models[1:] else models


def _beaten_by(rival: Claim, probable: list[_Member]) -> set[int]:
    """Those candidates, by identity, that a rival contradicts and outweighs all together; no further one is needed."""
    against = [(candidate, claim.worth) for _, candidate, claim in probable if contradict(claim, rival)]
    outweighs = rival.worth > sum(worth for _, worth in against)
    return {id(candidate) for candidate, _ in against} if outweighs else set()


def _is_cut(evidence: Evidence) -> bool:
    """True where a good part of it is hidden, not measured or beyond the image."""
    return evidence.hidden + evidence.unknown + evidence.beyond > 0.3 * evidence.pixels


def _rectangle_around(outline: NDArray[np.float64]) -> tuple[NDArray[np.float64], tuple[float, float]]:
    """T_support_model (4, 4) at the middle of the smallest rectangle around, x along its longer side, and its sides."""
    best: tuple[float, NDArray[np.float64], tuple[float, float]] | None = None
    for step in np.roll(outline, -1, axis=0) - outline:
        x = step / max(float(np.linalg.norm(step)), 1e-12)
        y = np.array([-x[1], x[0]])
        along, across = outline @ x, outline @ y
        sides = (float(np.ptp(along)), float(np.ptp(across)))
        if best is None or sides[0] * sides[1] < best[0]:
            if sides[0] < sides[1]:
                x, y, along, across, sides = y, -x, across, -along, (sides[1], sides[0])
            if x[0] < 0:
                x, y, along, across = -x, -y, -along, -across
            middle = x * (along.min() + along.max()) / 2 + y * (across.min() + across.max()) / 2
            T = np.eye(4)
            T[:2, 0], T[:2, 1], T[:2, 3] = x, y, middle
            best = (sides[0] * sides[1], T, sides)
    if best is None:
        return np.eye(4), (0.0, 0.0)
    return best[1], best[2]


def _inside(xy: NDArray[np.float64], outline: NDArray[np.float64]) -> NDArray[np.bool_]:
    """True (N,) for points in the counter-clockwise convex outline."""
    step = np.roll(outline, -1, axis=0) - outline
    offset = xy[:, np.newaxis] - outline
    left: NDArray[np.float64] = step[:, 0] * offset[..., 1] - step[:, 1] * offset[..., 0]
    return np.asarray(left.min(axis=1) >= 0)
