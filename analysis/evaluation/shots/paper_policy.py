"""Run the paper's policy: its network, its observation, and a shot with any estimate.

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
from analysis.estimators.base import Observation, Problem
from analysis.estimators.tunenet import TuneNet
from analysis.evaluation.drop.networks import Effort
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
from recorders.simulators.closed_form.bounce import Bounce
from recorders.simulators.drop import RESTITUTION, TOPIC
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.terminal import Progress

SAMPLES = 400
ITERATIONS = 5
_PAIRS = 800  # the paper's: frames of a drop, rollouts spent on a target (K), pairs learnt from
RESTITUTIONS = (0.4, 0.95)  # drawn evenly for training: those of the hidden balls are within
# Ends in a ratio of 4 to 5, as the paper's 4 to 5 m.
_DROP_HEIGHTS_M = (DROP_M * 8 / 9, DROP_M * 10 / 9)


@dataclass(frozen=True)
class _TrainingDrop:
    """Drop to learn from; with a seed it is filmed by a camera that the seed draws."""

    drop_height_m: float
    restitution: float
    seed: int | None = None


def train_papers(seed: int, progress: Progress, effort: Effort) -> Model:
    """Train the paper's network for this rig."""
    from analysis.tunenet.training import train

    rng = np.random.default_rng(seed)
    drops: list[_TrainingDrop] = []
    pairs_count = effort.pairs or _PAIRS
    for _ in range(pairs_count):
        height_m = float(rng.uniform(*_DROP_HEIGHTS_M))
        drops.append(_TrainingDrop(height_m, float(rng.uniform(*RESTITUTIONS))))
        value, camera = float(rng.uniform(*RESTITUTIONS)), int(rng.integers(2**62))
        drops.append(_TrainingDrop(height_m, value, camera))
    observations = _observe(drops)
    values = np.array([[drop.restitution] for drop in drops])
    pairs = PairSet(observations, values, *consecutive_pairs(pairs_count))
    recipe = replace(PAPERS_CODE, epochs=effort.epochs or PAPERS_CODE.epochs)
    return train(PaperNetwork(), pairs, recipe, seed, progress)


def papers_restitution(model: Model, rows: Array) -> float:
    """Estimate as the paper's policy: K = 5, clipped to [0, 1]; `rows` by `seen_rows`."""
    target = Observation(rows[:, None], _axis(), "time [s]", ("y [picture heights]",))
    problem = Problem(target, _AirDrop(DROP_M), _heights, np.array([RESTITUTION.initial]))
    trace = TuneNet(model).estimate(problem, ITERATIONS)
    return float(np.clip(trace.estimate[0], 0.0, 1.0))


def seen_rows(track: Track) -> Array:
    """Return the ball's y [picture heights] from the release on, interpolated, shape (400,)."""
    seconds = track.stamps_ns * 1e-9 - HELD_S
    rows = track.places_px[:, 1] / SIZE_PX[1]
    known = np.isfinite(rows)
    if not known.any():
        return np.full(SAMPLES, 0.5)
    return np.interp(_axis(), seconds[known], rows[known])


def _observe(drops: Sequence[_TrainingDrop]) -> Array:
    """Return z of simulations [drop heights], y of filmed ones [picture heights], (N, 400, 1)."""
    curves = []
    for drop in drops:
        episode = _AirDrop(drop.drop_height_m).rollout({RESTITUTION.name: drop.restitution})
        if drop.seed is None:
            curves.append(_heights(episode).values)
            continue
        rng = np.random.default_rng(drop.seed)
        view = random_view(rng)
        rows = view.image_from_world(episode.signals[TOPIC].values)[:, 1]
        rows += rng.normal(0.0, TRACK_NOISE_PX, SAMPLES)
        rows[int(FILMED_S * FRAME_HZ) :] = rows[int(FILMED_S * FRAME_HZ) - 1]
        curves.append(rows[:, None] / SIZE_PX[1])
    return np.array(curves)


class _AirDrop:
    """Drop with air drag, in closed form; see `Simulator`."""

    parameters: tuple[Parameter, ...] = (RESTITUTION,)
    engine = "a bounce in closed form"
    step_hz = FRAME_HZ

    def __init__(self, drop_height_m: float) -> None:
        self._drop_height_m = drop_height_m

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """See `Simulator.rollout`."""
        height_m = self._drop_height_m
        bounce = Bounce(values[RESTITUTION.name], drag=DRAG_1_M * height_m)
        fall_s = math.sqrt(2 * height_m / GRAVITY_M_S2)
        heights_m = RADIUS_M + height_m * bounce.heights(_axis() / fall_s - bounce.fall_time)
        positions_m = np.column_stack([np.zeros((SAMPLES, 2)), heights_m])
        stamps_ns = np.round(_axis() * 1e9).astype(np.int64)
        ball = Signal(TOPIC, stamps_ns, positions_m, ("x", "y", "z"), "m")
        return Episode(EpisodeInfo(kind="drop"), {TOPIC: ball})


def _heights(episode: Episode) -> Observation:
    heights = episode.signals[TOPIC].values[:, 2] / DROP_M
    return Observation(heights[:, None].copy(), _axis(), "time [s]", ("z [drop heights]",))


def _axis() -> Array:
    """Return the times of the observations [s], shape (400,)."""
    return np.arange(SAMPLES) / FRAME_HZ
