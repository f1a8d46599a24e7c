"""Presets of the drop: which simulator, observation, network and training go together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from analysis.drop import observations as views
from analysis.experiment import Training, presets_of
from analysis.tunenet.checkpoint import Purpose
from analysis.tunenet.network import PaperNetwork, WideNetwork
from analysis.tunenet.pairs import (
    PairSet,
    Workers,
    consecutive_pairs,
    mixed_pairs,
    observe_all,
)
from analysis.tunenet.training import Recipe
from recorders.simulators.base import BallWorld
from recorders.simulators.contact import CALIBRATED, PAPER, ContactSettings
from recorders.simulators.drop import DRAG, REAL_BALL, RESTITUTION, SLOPE, DropRig, DropSimulator
from recorders.simulators.engines import engine
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

# A rollout to make: rig, settings, values.
Plan = tuple[DropRig, ContactSettings, Mapping[str, float]]

PAPER_HEIGHT_M = (4.0, 5.0)  # of the ball's centre, in the paper's training data
PAPER_RESTITUTION = (0.3, 0.7)
_PAPER_PAIRS = 800  # the paper's range of restitutions, and its number of pairs
_GAP_M = (0.3, 5.0)
# Drops to train for. The observation leaves both out: they only vary how it is sampled.
_RATES_HZ = (60.0, 120.0, 240.0)

# Drag times drop height, of balls to train for: more than a table-tennis ball's from 3 m.
_MAX_DRAG = 0.5

# Rollouts, and pairs that are drawn among them: a pair costs nothing more.
_ROLLOUTS, _PAIRS = 4096, 204_800


@lru_cache(maxsize=1)
def _world(radius_m: float, contact: ContactSettings) -> BallWorld:
    """Return one world a process: making it takes as long as a dozen rollouts."""
    return engine().ball_world(radius_m, contact)


def _observe_plans(plans: Sequence[Plan]) -> Array:
    """Simulate and observe plans, shape (N, L, 1); runs in the worker processes."""
    curves: list[Array] = []
    rig, contact, _ = plans[0]
    simulator = DropSimulator(rig, contact, _world(rig.radius_m, contact))
    for rig, contact, values in plans:
        simulator = simulator.with_rig(rig)
        episode = simulator.rollout(values)
        if contact == PAPER:
            curves.append(views.paper_rollout(episode).values)
        else:
            curves.append(views.canonical(views.rollout_drop(episode, rig, contact)).values)
    return np.array(curves)


def observe_paper_drops(
    releases_m: Array, restitutions: Array, workers: Workers, progress: Progress
) -> Array:
    """Simulate the paper's drops as its network sees them, shape (N, 400, 1).

    `releases_m` are heights of the ball's centre, shape (N,).
    """
    radius = views.PAPER_RADIUS_M
    plans = [
        (
            DropRig(float(height) - radius, radius, views.PAPER_RATE_HZ),
            PAPER,
            {RESTITUTION.name: float(value)},
        )
        for height, value in zip(releases_m, restitutions, strict=True)
    ]
    return observe_all(_observe_plans, plans, workers, progress)


def _paper_pairs(count: int | None, seed: int, workers: Workers, progress: Progress) -> PairSet:
    """Simulate both rollouts of a pair from one height, U(4, 5) m; restitutions U(.3, .7)."""
    count = count or _PAPER_PAIRS
    rng = np.random.default_rng(seed)
    heights = np.repeat(rng.uniform(*PAPER_HEIGHT_M, count), 2)
    values = rng.uniform(*PAPER_RESTITUTION, 2 * count)
    observations = observe_paper_drops(heights, values, workers, progress)
    return PairSet(observations, values[:, None], *consecutive_pairs(count))


def _canonical_pairs(count: int | None, seed: int, workers: Workers, progress: Progress) -> PairSet:
    """Simulate real balls, evenly over their ranges; any rig will do, so heights and rates vary."""
    count = count or _PAIRS
    rollouts = min(_ROLLOUTS, 2 * count)
    rng = np.random.default_rng(seed)
    ranges = np.array([one.training_range for one in (RESTITUTION, SLOPE)] + [(0.0, _MAX_DRAG)])
    shares = (np.arange(rollouts) + rng.random((3, rollouts))) / rollouts
    shares = np.array([rng.permutation(share) for share in shares])
    values = (ranges[:, :1] + np.ptp(ranges, axis=1)[:, None] * shares).T
    gaps = rng.uniform(*_GAP_M, rollouts)
    rates = rng.choice(_RATES_HZ, rollouts)
    plans: list[Plan] = []
    for gap, rate, (restitution, slope, drag) in zip(gaps, rates, values.tolist(), strict=True):
        fall_s = np.sqrt(2 * gap / CALIBRATED.gravity_m_s2)
        samples = int(np.ceil((views.CANONICAL_SPAN + 1 + drag) * fall_s * rate)) + 3
        rig = DropRig(float(gap), rate_hz=float(rate), samples=samples, hold_s=rng.random() / rate)
        ball = {RESTITUTION.name: restitution, SLOPE.name: slope, DRAG.name: drag / float(gap)}
        plans.append((rig, CALIBRATED, ball))
    observations = observe_all(_observe_plans, plans, workers, progress)
    return PairSet(observations, values, *mixed_pairs(values, count, rng))


def _paper_training(name: str, recipe: Recipe) -> Training:
    purpose = Purpose(
        task="drop",
        preset=name,
        observation="z, 400 samples at 60 Hz from the release",
        inputs=views.PAPER_SAMPLES,
        outputs=1,
        rates_hz=(views.PAPER_RATE_HZ,),
    )
    return Training(purpose, PaperNetwork(), recipe, _paper_pairs)


OUR_TRAINING = Recipe(
    optimizer="adamw",
    learning_rate=3e-3,
    weight_decay=0.01,
    loss="relative",
    scaling="standard",
    epochs=20,
    batch=256,
    cut_share=0.2,
)

_OURS = Training(
    Purpose(
        task="drop",
        preset="default",
        observation="height [drop heights] about the first impact, 32 places a fall time, from 28 "
        "places before it to 4 fall times after; restitution, slope, drag times drop height",
        inputs=len(views.canonical_axis()),
        outputs=3,
        rates_hz=_RATES_HZ,
    ),
    WideNetwork(),
    replace(OUR_TRAINING, noise=0.004, epochs=30, scaling="ranges", cut_share=0.3),
    _canonical_pairs,
)

PAPERS_TEXT = Recipe(
    optimizer="sgd",
    learning_rate=1e-2,
    decay=0.99,
    decay_epochs=5,
    weight_decay=1e-2,
    loss="norm",
    scaling="unit",
    epochs=200,
    batch=50,
)

PAPERS_CODE = Recipe(
    optimizer="sgd",
    learning_rate=1e-1,
    decay=0.99,
    decay_epochs=1,
    weight_decay=1e-2,
    loss="squared",
    scaling="raw",
    epochs=200,
    batch=50,
)

TRAININGS = {
    "default": _OURS,
    "paper": _paper_training("paper", PAPERS_TEXT),
    "paper-code": _paper_training("paper-code", PAPERS_CODE),
}

PRESETS = presets_of(TRAININGS, REAL_BALL, (RESTITUTION,))
