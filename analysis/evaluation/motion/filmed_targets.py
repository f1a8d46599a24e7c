"""Film the test cases of the paper's second experiment with its cameras: TuneNet Obs.

Two views of one film: the paper's network has the picture's y beside the simulation's z; ours has
the same y beside what the simulation would look like to the camera that suits it most. Neither is
given the camera. Both simulate the drop from its own height, as the paper does.
"""

from __future__ import annotations

from functools import partial

import numpy as np

from analysis.drop import observations as views
from analysis.drop.film_presets import filled, paper_rows
from analysis.drop.presets import PAPER_HEIGHT_M
from analysis.drop.projection import best_map
from analysis.estimators.base import Observation, Problem
from analysis.evaluation.drop.targets import DropTarget
from analysis.statistics import noise_of
from recorders.simulators.contact import PAPER
from recorders.simulators.drop import RESTITUTION, TOPIC, DropRig, DropSimulator
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode


class FilmedProblems:
    """Problems of filmed test cases, all in one world of the engine."""

    def __init__(self) -> None:
        self._world = DropSimulator(_rig(PAPER_HEIGHT_M[0]), PAPER)

    def rows(self, target: DropTarget) -> Array:
        """Return the ball's image rows; see `paper_rows`. The target's seed draws the camera."""
        episode = self._simulator(target).rollout({RESTITUTION.name: target.truth})
        return paper_rows(episode.signals[TOPIC].values, np.random.default_rng([target.seed, 1]))

    def pose_papers(self, target: DropTarget) -> Problem:
        """Pose a test case as the paper's network sees it."""
        seen = _observation(filled(self.rows(target)), "y [picture heights]")
        return Problem(seen, self._simulator(target), views.paper_unit_heights, _guess(target))

    def pose_ours(self, target: DropTarget) -> Problem:
        """Pose a test case as ours sees it: rows in their own range, simulations as best seen."""
        simulator = self._simulator(target)
        seen = places_in_view(self.rows(target))
        observe = partial(_as_seen, seen=seen, rig=simulator.rig)
        return Problem(_observation(seen, _PLACES), simulator, observe, _guess(target))

    def _simulator(self, target: DropTarget) -> DropSimulator:
        return self._world.with_rig(_rig(target.release_m))


_PLACES = "place in the picture [range of the ball's]"


def places_in_view(rows: Array) -> Array:
    """Normalise rows upward: 0 at the ball's lowest, 1 at its highest; shape (T,)."""
    lowest, highest = np.nanmax(rows), np.nanmin(rows)
    return (lowest - rows) / (lowest - highest)


def as_seen(heights: Array, seen: Array) -> Array:
    """Map a simulation [drop heights] to the best-fitting camera's image, both shape (T,)."""
    known = seen[np.isfinite(seen)]
    return best_map(heights, seen, noise_of(known)).positions(heights)


def _as_seen(episode: Episode, seen: Array, rig: DropRig) -> Observation:
    heights_m = episode.signals[TOPIC].values[:, 2]
    return _observation(as_seen((heights_m - rig.radius_m) / rig.gap_m, seen), _PLACES)


def _observation(values: Array, name: str) -> Observation:
    return Observation(values[:, None].copy(), views.paper_axis(), "time [s]", (name,))


def _guess(target: DropTarget) -> Array:
    return np.array([target.initial])


def _rig(release_m: float) -> DropRig:
    radius = views.PAPER_RADIUS_M
    return DropRig(release_m - radius, radius, views.PAPER_RATE_HZ, views.PAPER_SAMPLES)
