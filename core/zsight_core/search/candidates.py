"""From hypotheses to candidates: a quick look at each, the best fitted roughly, the best of those fitted well.

Each step looks at fewer poses and takes longer for each. What is found of a type in a scene is kept with the scene, so
that all queries share it.
"""

from __future__ import annotations

from functools import cached_property
from math import log
from typing import TYPE_CHECKING, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from zsight_core.jit import njit
from zsight_core.model import Mesh, Sphere, size_of
from zsight_core.search import refine, verify
from zsight_core.search.claims import ROOM_SHARED, Claim, claimed, contradict
from zsight_core.search.clues import Clues, Hypothesis, clues_of
from zsight_core.search.contest import NOBODY, lead
from zsight_core.search.contour import MOST
from zsight_core.search.overlap import shared
from zsight_core.search.recognise import hypotheses, turned
from zsight_core.search.score import logit_of, probability
from zsight_core.search.verify import Evidence
from zsight_core.solid import Solid, solid_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from numpy.typing import NDArray

    from zsight_core.model import ObjectModel, Shape
    from zsight_core.scene import Checkpoint, Scene

__all__ = [
    "Candidate",
    "Candidates",
    "Counts",
    "Trials",
    "is_sure",
    "near",
    "net",
    "not_astray",
    "rank_of",
    "warm_up",
]

ON_SURFACE, ON_TOP, ON_NOTHING = 2e-5, 0.0015, 0.004
"""Metres by which the height of a foot may be off on the surface, on a top that is seen, and on what is not seen."""

HANDICAP = 2.7
"""Logarithm of odds that something has to make up for when nothing is seen that it could stand on."""

QUICK_PIXELS = 200
"""Raster of a quick look at a hypothesis."""

ROUGH_OUTLINE = 50
"""Samples of the outline in a quick look and in a rough fit, about."""

STILL_GROWS = 1.5
"""By how much the fit of what a quick look saw may let it explain more pixels."""

QUICK_TOLERANCE = 0.008
"""Metres in depth, besides noise, by which it may be off."""

TOLERANCE = 0.002
"""The same of a fitted pose."""

LOOKS_AT_ONCE = 200
"""Quick looks between two checkpoints."""

FITS_AT_ONCE = 10
"""Fits between two checkpoints."""

ROUGHLY_FITTED = 120
"""Hypotheses that are roughly fitted at most, the best of the quick looks."""

A_PLACE = 8
"""Hypotheses of one place that are roughly fitted at most."""

WELL_FITTED = 5
"""Hypotheses of one place that are well fitted at most."""

PROMISING, PROMISING_UNSEEN = 0.85, 0.95
"""Least promise of a hypothesis that is fitted, and of one on what is not seen; of 371 that became right answers in 56
train scenes all had more than 0.93 and 1.04."""

BEHIND = 0.3
"""Promise by which a hypothesis may be behind the best of its place and still be fitted."""

ROUGH_STEPS = 5
"""Iterations of a rough fit."""

ROUGH_NOISE = 5e-4
"""1/m; what a rough fit leaves of its first error counts as noise of inverse depth."""

LIKELY = -4.0
"""Least logarithm of odds of a rough fit that is fitted well; 99 of 100 true ones have more, and 6 of 100 others."""

RANKED_BEHIND = 8.0
"""Logarithm of odds by which a rough fit may be behind the best of its place and still be fitted well."""

EXPLAINED = 15.0
"""Logarithm of odds that a pose gains by explaining e times the pixels of another one."""

TURNED_BEHIND = 40.0
"""Pixels by which a rough fit of another way to rest may be behind and still be fitted well."""

WELL_TURNED = 10
"""Other ways to rest at a place that are well fitted at most."""

DOUBTFUL = 0.15
"""Probability from which a candidate is fitted once more."""

ASTRAY = 0.005
"""Metres from which one more fit has led elsewhere."""

FIT_COUNTS = 5.0
"""Pixels that a pose is ahead of another one for each e times that its odds are better."""

SAME_POSE = 0.005, 5.0
"""Metres and degrees within which another pose is no other way to be there."""

SLIDE, FARTHEST_SLIDE = 0.01, 0.4
"""Steps, metres, in which a candidate is slid along its own axes, and how far at most, as a share of its length."""

ONE_SIDE, SEEN_AROUND = 0.3, 0.7
"""A candidate is slid where a larger share of one side's outline says no, or less of the whole outline is seen."""

SLID_BEHIND = 0.05
"""Promise by which a slid pose may be behind the one that was found and still be fitted."""

SLID = 4
"""Slid poses that are roughly fitted at most."""


SURE = 0.97, 0.7, 0.85
"""Probability, share of the outline that is seen, and share of that which says yes, from which nothing else is looked
for in the pixels that a candidate explains; of 1279 answers in 150 crowded train scenes 83 of 100 had more, and one of
15 wrong ones."""


class Candidate(NamedTuple):
    """A hypothesis with what the image says of it."""

    hypothesis: Hypothesis
    evidence: Evidence
    information: NDArray[np.float64]
    """(4, 4) of x, y, height and yaw."""
    probability: float
    logit: float
    """Logarithm of the odds, wherever it stands."""


class Trials(NamedTuple):
    """What became of the hypotheses of a type."""

    tried: list[Candidate]
    """All that were fitted well."""
    kept: list[Candidate]
    """The best of each place."""
    ways: list[list[Candidate]]
    """Of each of them, all poses that were tried there, itself among them."""


class Counts(NamedTuple):
    """How much was done for a type."""

    hypotheses: int
    refined: int


class _Known(NamedTuple):
    shape: Shape
    trials: Trials
    counts: Counts


_known: WeakKeyDictionary[Scene, dict[tuple[int, ...], _Known]] = WeakKeyDictionary()
"""By the shapes that were asked for, the one looked for last."""


class Candidates:
    """Candidates of any type in one scene."""

    def __init__(self, scene: Scene, checkpoint: Checkpoint) -> None:
        self.scene = scene
        self.clues = clues_of(scene)
        self.checkpoint = checkpoint
        self._known = _known.setdefault(scene, {})

    def of(self, model: ObjectModel) -> tuple[Trials, Counts]:
        """All candidates of a type; in a scene each type is looked for once."""
        return next(self.in_turn([model]))

    def in_turn(self, models: Sequence[ObjectModel]) -> Iterator[tuple[Trials, Counts]]:
        """Candidates of some types, each looked for in what those before it leave unexplained; once in a scene."""
        clues, explained = self.clues, np.zeros(self.scene.view.depth.size, np.bool_)
        for number, model in enumerate(models):
            asked = tuple(id(other.shape) for other in models[: number + 1])
            known = self._known.get(asked)
            if known is None:
                tried, kept, counts = self.among(model, clues)
                settled = [self._settled(model.shape, candidate, tried) for candidate in kept]
                trials = Trials(tried, [best for best, _ in settled], [ways for _, ways in settled])
                known = self._known[asked] = _Known(model.shape, trials, counts)
            yield known.trials, known.counts
            sure = [candidate for candidate in known.trials.kept if is_sure(candidate)]
            for candidate in sure:
                self._explain(model.shape, candidate, explained)
            clues = clues.without(explained) if sure else clues

    def _explain(self, shape: Shape, candidate: Candidate, explained: NDArray[np.bool_]) -> None:
        """Mark the pixels (H * W,) that show the surface of a candidate, in place."""
        width = self.scene.view.depth.shape[1]
        first = self.claim(shape, candidate).pixels
        for beside in (0, 1, width, width + 1):  # a claim holds every second pixel of every second row
            explained[np.minimum(first + beside, len(explained) - 1)] = True

    def claim(self, shape: Shape, candidate: Candidate) -> Claim:
        """What a candidate of a shape explains."""
        view, solid = self.scene.view, solid_of(shape, coarse=True)
        T = self.clues.frames[candidate.hypothesis.support] @ candidate.hypothesis.T_support_model
        pixels = claimed(view.depth, view.pinhole, solid.vertices, solid.faces, T, self.scene.noise)
        return Claim(solid, T, pixels, candidate.probability * net(candidate))

    def knows(self, model: ObjectModel) -> bool:
        """True where the type was looked for already."""
        return (id(model.shape),) in self._known

    def among(
        self,
        model: ObjectModel,
        clues: Clues,
        fewest: float = 0.0,
        suits: Callable[[Hypothesis], bool] = lambda _: True,
    ) -> tuple[list[Candidate], list[Candidate], Counts]:
        """Candidates of a type that follow from some clues: all that were fitted well, and the best of each place.

        Args:
            model: the type.
            clues: what to look at.
            fewest: pixels that a candidate must explain to be of use.
            suits: whether a hypothesis, some millimetres and degrees off, is of use.
        """
        guesses = hypotheses(model.shape, clues, self.checkpoint)
        best = [guess for guess in self._most_promising(model, guesses, fewest) if suits(guess)]
        solid = solid_of(model.shape)
        first = solid if isinstance(model.shape, Mesh) else solid_of(model.shape, coarse=True)
        rough = self._fitted(first, best, pixels=300, steps=ROUGH_STEPS, look=800)
        rough = [candidate for candidate in rough if candidate.logit > LIKELY]
        chosen = _best_few_of_each_place(rough, min(size_of(model.shape)))
        tried = self._fitted(solid, chosen, pixels=900, steps=8, look=4000)
        kept = self._polished(solid, _one_a_place(tried, solid_of(model.shape, coarse=True)))
        return tried, kept, Counts(len(guesses), len(best))

    def _polished(self, solid: Solid, candidates: list[Candidate]) -> list[Candidate]:
        """Fitted once more: the first fit may have come from too far for its finest steps to catch every face."""
        doubtful = [candidate.hypothesis for candidate in candidates if candidate.probability >= DOUBTFUL]
        again = iter(self._fitted(solid, doubtful, pixels=3000, steps=14, look=4000))
        return [
            not_astray(candidate, next(again)) if candidate.probability >= DOUBTFUL else candidate
            for candidate in candidates
        ]

    def _settled(self, shape: Shape, found: Candidate, tried: list[Candidate]) -> tuple[Candidate, list[Candidate]]:
        """The pose at a place that the image is most for, and all that were tried there."""
        if found.probability <= DOUBTFUL:
            return found, [found]
        solid, hull, here = solid_of(shape), solid_of(shape, coarse=True), found.hypothesis
        guesses = [*turned(shape, self.clues, here), *self._slid(shape, found)]

        own = self.claim(shape, found)

        def is_here(other: Candidate) -> bool:
            T, same = other.hypothesis.T_support_model, other.hypothesis.support == here.support
            return same and (
                shared(hull, here.T_support_model, hull, T) > ROOM_SHARED or contradict(self.claim(shape, other), own)
            )

        rough = self._fitted(solid, guesses, pixels=300, steps=ROUGH_STEPS, look=800)
        rough = [candidate for candidate in rough if candidate.logit > LIKELY and is_here(candidate)]
        ahead = [self._lead(shape, candidate, found, self.nobody, 0) for candidate in rough]
        close = [k for k in np.argsort(-np.array(ahead), kind="stable") if ahead[k] > -TURNED_BEHIND][:WELL_TURNED]
        others = [candidate for candidate in tried if is_here(candidate)]
        others += self._fitted(solid, [rough[k].hypothesis for k in close], pixels=900, steps=8, look=4000)
        others = [
            other for other in others if other.probability > DOUBTFUL and not near(other.hypothesis, here, *SAME_POSE)
        ]
        ways = [found, *sorted(others, key=lambda other: -rank_of(other))]
        best, others = self.best_of(shape, ways, self.nobody, 0)
        return best, [best, *others]

    def best_of(
        self, shape: Shape, ways: list[Candidate], owners: NDArray[np.int16], own: int, behind: float = np.inf
    ) -> tuple[Candidate, list[Candidate]]:
        """The one of some poses at a place that the image is most for, and those that are not far behind.

        Args:
            shape: of all.
            ways: the poses; the first one was fitted with care, another one that is ahead of it is so here.
            owners: (H, W) numbers of the candidates that explain pixels.
            own: number of this one.
            behind: pixels by which a pose is left out.
        """
        best, ahead = ways[0], [0.0] * len(ways)
        for k, other in enumerate(ways[1:], 1):
            ahead[k] = -self._lead(shape, other, best, owners, own)
            if ahead[k] < 0:
                best, ahead[:k] = other, [self._lead(shape, other, way, owners, own) for way in ways[:k]]
                ahead[k] = 0.0
        others = [way for way, by in zip(ways, ahead, strict=True) if way is not best and by < behind]
        return best if best is ways[0] else self._polished(solid_of(shape), [best])[0], others

    def _lead(self, shape: Shape, one: Candidate, other: Candidate, owners: NDArray[np.int16], own: int) -> float:
        """Pixels by which one pose of a shape is ahead of another one."""
        view, solid = self.scene.view, solid_of(shape)
        T_a, T_b = (self.clues.frames[c.hypothesis.support] @ c.hypothesis.T_support_model for c in (one, other))
        scene = view.depth, view.pinhole, solid.vertices, solid.faces
        return lead(*scene, T_a, T_b, self.scene.noise, owners, own) + FIT_COUNTS * (one.logit - other.logit)

    @cached_property
    def nobody(self) -> NDArray[np.int16]:
        """That no pixel (H, W) is known to be explained by anything."""
        return np.full(self.scene.view.depth.shape, NOBODY, np.int16)

    def _slid(self, shape: Shape, found: Candidate) -> list[Hypothesis]:
        """Where else along its own axes it may be, if not all of its outline is where it was found."""
        evidence, here = found.evidence, found.hypothesis
        if isinstance(shape, Sphere) or (evidence.worst_side < ONE_SIDE and evidence.outlined > SEEN_AROUND):
            return []
        T, sizes = here.T_support_model, size_of(shape)
        guesses = [here]
        for axis in range(3):
            way = T[:2, axis]
            if way @ way < 0.5:  # upright
                continue
            for k in range(1, 1 + int(FARTHEST_SLIDE * sizes[axis] / SLIDE)):
                for sign in (-1, 1):
                    there = T.copy()
                    there[:2, 3] += sign * k * SLIDE * way / np.sqrt(way @ way)
                    guesses.append(here._replace(T_support_model=there))
        promise = self._looked(shape, guesses)[:, 0]
        order = np.argsort(-promise[1:], kind="stable")[:SLID] + 1
        return [guesses[k] for k in order if promise[k] > promise[0] - SLID_BEHIND]

    def _fitted(self, solid: Solid, guesses: list[Hypothesis], pixels: int, steps: int, look: int) -> list[Candidate]:
        found: list[Candidate] = []
        for first in range(0, len(guesses), FITS_AT_ONCE):
            self.checkpoint("refine", first / len(guesses))
            found += self._fit(solid, guesses[first : first + FITS_AT_ONCE], pixels, steps, look)
        return found

    def _fit(self, solid: Solid, guesses: list[Hypothesis], pixels: int, steps: int, look: int) -> list[Candidate]:
        view, frames = self.scene.view, self.clues.stacked
        shape = solid.vertices, solid.faces, solid.edges
        supports, T, footings = _columns(guesses)
        loose = np.array([(0.03, 0.03, _play(guess), 0.5 if guess.turns else 1e-5) for guess in guesses])
        scene = view.depth, view.pinhole, *shape, frames, supports
        outline = MOST if steps > ROUGH_STEPS else ROUGH_OUTLINE
        T, information = refine.fit(*scene, T, footings, loose, self.scene.noise, steps, pixels, outline)
        noise = self.scene.noise if steps > ROUGH_STEPS else max(self.scene.noise, ROUGH_NOISE)
        counts = verify.compare(*scene, T, footings, noise, look, TOLERANCE)
        rows = zip(guesses, T, information, counts.tolist(), strict=True)
        return [_candidate(guess._replace(T_support_model=T), Evidence(*row), matrix) for guess, T, matrix, row in rows]

    def _most_promising(self, model: ObjectModel, guesses: list[Hypothesis], fewest: float) -> list[Hypothesis]:
        """A quick look at each hypothesis; the best few of each place."""
        promise, match = self._looked(model.shape, guesses).T
        least = np.array([PROMISING if guess.carried else PROMISING_UNSEEN for guess in guesses])
        ranks = np.where((promise > least) & (match * STILL_GROWS > fewest), promise, -np.inf)
        order = np.argsort(-ranks, kind="stable")[: int((ranks > PROMISING).sum())]
        return _best_of_each_place([(float(ranks[k]), guesses[k]) for k in order], min(size_of(model.shape)))

    def _looked(self, shape: Shape, guesses: list[Hypothesis]) -> NDArray[np.float64]:
        """Promise and matching pixels (N, 2) of hypotheses."""
        view, rough = self.scene.view, solid_of(shape, coarse=True)
        looks = [np.zeros((0, 2))]
        for first in range(0, len(guesses), LOOKS_AT_ONCE):
            self.checkpoint("look", first / len(guesses))
            supports, T, footings = _columns(guesses[first : first + LOOKS_AT_ONCE])
            scene = view.depth, view.pinhole, rough.vertices, rough.faces, rough.edges, self.clues.stacked, supports
            limits = QUICK_PIXELS, ROUGH_OUTLINE, QUICK_TOLERANCE, PROMISING
            looks.append(verify.look(*scene, T, footings, self.scene.noise, *limits))
        return np.concatenate(looks)


def rank_of(candidate: Candidate) -> float:
    """For poses at one place: odds, and how much of what is seen is explained; else a mug would hide its handle."""
    return candidate.logit + EXPLAINED * log(max(candidate.evidence.match, 1.0))


def net(candidate: Candidate) -> float:
    """Pixels that it explains, less those that speak against it."""
    return candidate.evidence.match - 2 * candidate.evidence.through


def is_sure(candidate: Candidate) -> bool:
    """True where it is probable, and the outline seen says so: something else that explains its pixels is not there."""
    evidence = candidate.evidence
    least = candidate.probability, evidence.outlined, evidence.outline
    return all(value > limit for value, limit in zip(least, SURE, strict=True))


def near(a: Hypothesis, b: Hypothesis, metres: float, degrees: float) -> bool:
    """True where two poses are on one surface and within a distance and an angle (above 180: any)."""
    if a.support != b.support:
        return False
    gap = a.T_support_model[:3, 3] - b.T_support_model[:3, 3]
    if gap @ gap > metres * metres:
        return False
    turn = (np.trace(a.T_support_model[:3, :3].T @ b.T_support_model[:3, :3]) - 1) / 2
    return degrees > 180 or bool(turn > np.cos(np.radians(degrees)))


def not_astray(candidate: Candidate, again: Candidate) -> Candidate:
    """What was fitted once more, unless that led away to a worse place."""
    is_near = near(candidate.hypothesis, again.hypothesis, ASTRAY, 180.0)
    return again if is_near or rank_of(again) > rank_of(candidate) else candidate


def _play(guess: Hypothesis) -> float:
    """Standard deviation of its foot's height, metres: known from the surface, measured on a top, or guessed."""
    if guess.base == 0:
        return ON_SURFACE
    return ON_TOP if guess.carried else ON_NOTHING


def _candidate(hypothesis: Hypothesis, evidence: Evidence, information: NDArray[np.float64]) -> Candidate:
    """A hypothesis with what the image says of it; less likely on something that is not seen."""
    logit = logit_of(evidence)
    likely = probability(logit if hypothesis.carried else logit - HANDICAP)
    return Candidate(hypothesis, evidence, information, likely, logit)


def _columns(guesses: list[Hypothesis]) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Surface (N,), pose (N, 4, 4) and footing (N,) of each guess."""
    return (
        np.array([guess.support for guess in guesses]),
        np.array([guess.T_support_model for guess in guesses]),
        np.array([_footing(guess) for guess in guesses]),
    )


def _footing(guess: Hypothesis) -> float:
    """Height of what is seen under it, metres: on that its lower edges have no contrast."""
    return guess.base if guess.carried else 0.0


def _best_of_each_place(guesses: list[tuple[float, Hypothesis]], reach: float) -> list[Hypothesis]:
    """The first few of each place, best first, without near repetitions; at most ROUGHLY_FITTED."""
    chosen = _few_of_each_place(guesses, 0.6 * reach, A_PLACE, BEHIND, 0.004, 5.0)
    return [guesses[k][1] for k in chosen[:ROUGHLY_FITTED]]


def _best_few_of_each_place(candidates: list[Candidate], reach: float) -> list[Hypothesis]:
    """Hypotheses of the best rough fits of each place, best first, without repetitions."""
    ranked = [(rank_of(candidate), candidate.hypothesis) for candidate in _ranked(candidates)]
    chosen = _few_of_each_place(ranked, 0.6 * reach, WELL_FITTED, RANKED_BEHIND, 0.002, 3.0)
    return [ranked[k][1] for k in chosen]


def _few_of_each_place(
    ranked: list[tuple[float, Hypothesis]],
    reach: float,
    here: int,
    behind: float,
    metres: float,
    degrees: float,
) -> list[int]:
    """Numbers of those, best first, that are among the first of their place and repeat none of them."""
    if not ranked:
        return []
    ranks = np.array([rank for rank, _ in ranked])
    poses = np.array([guess.T_support_model[:3] for _, guess in ranked])
    supports = np.array([guess.support for _, guess in ranked])
    chosen: list[int] = _choose(
        ranks, poses, supports, reach, here, behind, metres, np.cos(np.radians(degrees))
    ).tolist()
    return chosen


@njit(cache=True, nogil=True)
def _choose(
    ranks: NDArray[np.float64],
    poses: NDArray[np.float64],
    supports: NDArray[np.int64],
    reach: float,
    here: int,
    behind: float,
    metres: float,
    cosine: float,
) -> NDArray[np.int64]:
    """Numbers (K,) of the poses (N, 3, 4), best first, that are kept."""
    kept = np.empty(len(ranks), np.int64)
    count = 0
    for i in range(len(ranks)):
        there, again, best = 0, False, -np.inf
        for q in range(count):
            k = kept[q]
            square = 0.0
            for a in range(3):
                square += (poses[i, a, 3] - poses[k, a, 3]) ** 2
            if supports[i] != supports[k] or square > reach * reach:
                continue
            best = ranks[k] if there == 0 else best
            there += 1
            if square < metres * metres:
                trace = 0.0
                for a in range(3):
                    for b in range(3):
                        trace += poses[i, a, b] * poses[k, a, b]
                again = again or (trace - 1) / 2 > cosine
        if there < here and not again and not ranks[i] < best - behind:
            kept[count] = i
            count += 1
    return kept[:count]


def _one_a_place(candidates: list[Candidate], solid: Solid) -> list[Candidate]:
    """The most probable candidate of each place; others that share their place with a better one are dropped."""
    kept: list[Candidate] = []
    for candidate in _ranked(candidates):
        T, support = candidate.hypothesis.T_support_model, candidate.hypothesis.support
        if not any(
            other.hypothesis.support == support
            and shared(solid, T, solid, other.hypothesis.T_support_model) > ROOM_SHARED
            for other in kept
        ):
            kept.append(candidate)
    return kept


def _ranked(candidates: list[Candidate]) -> list[Candidate]:
    """Best first."""
    order = sorted(range(len(candidates)), key=lambda k: (-rank_of(candidates[k]), k))
    return [candidates[k] for k in order]


def warm_up() -> None:
    """Compile the kernels (or load them from their cache)."""
    _choose(np.zeros(1), np.zeros((1, 3, 4)), np.zeros(1, np.int64), 0.1, 1, 1.0, 0.1, 0.5)
