"""The paper's policy: its network, its observation, and a shot whatever came out.

The paper's network knows falls of 4 to 5 m of balls of 1 m before its own cameras, so it is trained
anew for this rig, by its authors' code: 800 pairs, both sides of a pair falling from one height
(drawn within 11 %), the second one filmed by a camera as they stand here; y of the picture and z of
the simulation from 0 to 1; 400 samples at 60 Hz from the release. Its restitutions are .4 to .95 in
place of .3 to .7, which would leave out half of these balls. It is helped where that does no harm:
its simulator has the ball's air (the paper's has Bullet's damping), its tracker finds the ball
wherever it is in the picture, and the release is known.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.drop.presets import PAPERS_CODE
from analysis.estimators.base import Problem
from analysis.estimators.observation import Observation
from analysis.estimators.tunenet import TuneNet
from analysis.evaluation.drop_networks import Effort
from analysis.evaluation.shots.ground_truth_drop import DROP_M, FILMED_S, HELD_S
from analysis.evaluation.shots.ground_truth_film import (
    FRAME_HZ,
    SIZE_PX,
    TRACK_NOISE_PX,
    random_view,
)
from analysis.evaluation.shots.ground_truth_sim import DRAG_1_M, GRAVITY_M_S2, RADIUS_M
from analysis.tracking.track import Track
from analysis.tunenet.network import Model, PaperNetwork
from analysis.tunenet.pairs import PairSet, consecutive_pairs
from recorders.simulators.base import Parameter
from recorders.simulators.bounce import Bounce
from recorders.simulators.drop import RESTITUTION, TOPIC
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.progress import Progress

SAMPLES = 400
ITERATIONS = 5
RESTITUTIONS = (0.4, 0.95)
_PAIRS = 800
_HEIGHTS_M = (DROP_M * 8 / 9, DROP_M * 10 / 9)
"""As wide as the paper's 4 to 5 m."""


@dataclass(frozen=True)
class _Plan:
    """A drop to simulate; with a seed it is filmed."""

    gap_m: float
    restitution: float
    seed: int | None = None


def train_papers(seed: int, progress: Progress, effort: Effort) -> Model:
    """The paper's network for this rig."""
    from analysis.tunenet.training import train

    rng = np.random.default_rng(seed)
    plans: list[_Plan] = []
    pairs_count = effort.pairs or _PAIRS
    for _ in range(pairs_count):
        gap_m = float(rng.uniform(*_HEIGHTS_M))
        plans.append(_Plan(gap_m, float(rng.uniform(*RESTITUTIONS))))
        value, camera = float(rng.uniform(*RESTITUTIONS)), int(rng.integers(2**62))
        plans.append(_Plan(gap_m, value, camera))
    observations = _observe(plans)
    values = np.array([[plan.restitution] for plan in plans])
    pairs = PairSet(observations, values, *consecutive_pairs(pairs_count))
    recipe = replace(PAPERS_CODE, epochs=effort.epochs or PAPERS_CODE.epochs)
    return train(PaperNetwork(), pairs, recipe, seed, progress)


def papers_restitution(model: Model, rows: Array) -> float:
    """What the paper's policy shoots with: K = 5 from 0, within [0, 1].

    Args:
        model: its network.
        rows: y of the picture, shape (400,).
    """
    target = Observation(rows[:, None], _axis(), "time [s]", ("y [picture heights]",))
    problem = Problem(target, _AirDrop(DROP_M), _heights, np.array([RESTITUTION.initial]))
    trace = TuneNet(model).estimate(problem, ITERATIONS)
    return float(np.clip(trace.estimate[0], 0.0, 1.0))


def seen_rows(track: Track) -> Array:
    """The ball's y in the picture from its release on, 0 to 1; as last seen where it is not.

    Returns:
        Shape (400,).
    """
    seconds = track.stamps_ns * 1e-9 - HELD_S
    rows = track.places_px[:, 1] / SIZE_PX[1]
    known = np.isfinite(rows)
    if not known.any():
        return np.full(SAMPLES, 0.5)
    return np.interp(_axis(), seconds[known], rows[known])


def _observe(plans: Sequence[_Plan]) -> Array:
    """Z of a simulation, or y of a filmed one, shape (N, 400, 1)."""
    curves = []
    for plan in plans:
        episode = _AirDrop(plan.gap_m).rollout({RESTITUTION.name: plan.restitution})
        if plan.seed is None:
            curves.append(_heights(episode).values)
            continue
        rng = np.random.default_rng(plan.seed)
        view = random_view(rng)
        rows = view.image_from_world(episode.signals[TOPIC].values)[:, 1]
        rows += rng.normal(0.0, TRACK_NOISE_PX, SAMPLES)
        rows[int(FILMED_S * FRAME_HZ) :] = rows[int(FILMED_S * FRAME_HZ) - 1]
        curves.append(rows[:, None] / SIZE_PX[1])
    return np.array(curves)


class _AirDrop:
    """A drop with the air's drag, in closed form; see `Simulator`."""

    parameters: tuple[Parameter, ...] = (RESTITUTION,)

    def __init__(self, gap_m: float) -> None:
        self._gap_m = gap_m

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """See `Simulator.rollout`."""
        bounce = Bounce(values[RESTITUTION.name], drag=DRAG_1_M * self._gap_m)
        fall_s = math.sqrt(2 * self._gap_m / GRAVITY_M_S2)
        heights = RADIUS_M + self._gap_m * bounce.heights(_axis() / fall_s - bounce.fall_time)
        places = np.column_stack([np.zeros((SAMPLES, 2)), heights])
        stamps_ns = np.round(_axis() * 1e9).astype(np.int64)
        ball = Signal(TOPIC, stamps_ns, places, ("x", "y", "z"), "m")
        return Episode(EpisodeInfo(kind="drop"), {TOPIC: ball})


def _heights(episode: Episode) -> Observation:
    heights = episode.signals[TOPIC].values[:, 2] / DROP_M
    return Observation(heights[:, None].copy(), _axis(), "time [s]", ("z [drop heights]",))


def _axis() -> Array:
    return np.arange(SAMPLES) / FRAME_HZ
