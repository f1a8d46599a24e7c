"""Presets of the filmed drop: what a network sees of simulation and video, and its training."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.drop import observations as views
from analysis.drop.presets import PAPER_HEIGHT_M, PAPER_RESTITUTION, PAPERS_TEXT
from analysis.drop.presets import TRAININGS as DROP_TRAININGS
from analysis.experiment import Training, presets_of
from analysis.tunenet.checkpoint import Purpose
from analysis.tunenet.network import PaperNetwork
from analysis.tunenet.pairs import PairSet, Workers, consecutive_pairs, observe_all
from recorders.simulators.contact import PAPER
from recorders.simulators.drop import REAL_BALL, RESTITUTION, TOPIC, DropRig, DropSimulator
from recorders.simulators.pinhole import PinholeCamera
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

PAPER_SIZE_PX = (100, 100)
_PAPER_FOV_DEG = 60.0
_PAPER_NOISE_PX = 0.2
# The TuneNet paper's pictures and pairs; at 60 degrees hardly any drop leaves the picture.
_PAPER_PAIRS = 800

# A drop to simulate: rig, restitution, and the seed of the camera that films it, or None.
Plan = tuple[DropRig, float, int | None]


def _observe_paper_plans(plans: Sequence[Plan]) -> Array:
    """Simulate z, or the image's y of a filmed drop; shape (N, 400, 1)."""
    curves: list[Array] = []
    simulator = DropSimulator(plans[0][0], PAPER)
    for rig, restitution, seed in plans:
        simulator = simulator.with_rig(rig)
        episode = simulator.rollout({RESTITUTION.name: restitution})
        if seed is None:
            curves.append(views.paper_unit_heights(episode).values)
            continue
        rows = paper_rows(episode.signals[TOPIC].values, np.random.default_rng(seed))
        curves.append(filled(rows)[:, None])
    return np.array(curves)


def paper_rows(positions_m: Array, rng: np.random.Generator) -> Array:
    """Project a ball into one of the paper's cameras: y, 0 at the top, 1 at the bottom.

    Args:
        positions_m: of the ball, shape (T, 3).
        rng: draws the camera and the noise of the track.

    Returns:
        Shape (T,), NaN where the ball is out of the picture.
    """
    camera = _paper_camera(rng)
    places = camera.image_from_world(positions_m)
    places = places + rng.normal(0.0, 1.0, places.shape) * _PAPER_NOISE_PX
    inside = np.all((places > 0) & (places < np.array(camera.size_px) - 1), axis=1)
    return np.where(inside, places[:, 1], np.nan) / camera.size_px[1]


def filled(rows: Array) -> Array:
    """Fill missing rows by linear interpolation, for a network that needs every one."""
    known, numbers = np.isfinite(rows), np.arange(len(rows))
    return np.interp(numbers, numbers[known], rows[known])


def _paper_camera(rng: np.random.Generator) -> PinholeCamera:
    """Draw a camera as the paper does; at 60 degrees hardly any drop leaves the picture."""
    distance, angle = rng.uniform(5.0, 10.0), rng.uniform(0.0, 2 * np.pi)
    place = (distance * np.cos(angle), distance * np.sin(angle), rng.uniform(5.0, 8.0))
    return PinholeCamera(place, (0.0, 0.0, 2.0), PAPER_SIZE_PX, _PAPER_FOV_DEG)


def _paper_pairs(count: int | None, seed: int, workers: Workers, progress: Progress) -> PairSet:
    """Simulate both rollouts of a pair from one height; the second one is filmed."""
    count = count or _PAPER_PAIRS
    rng = np.random.default_rng(seed)
    plans: list[Plan] = []
    for _ in range(count):
        height, radius = float(rng.uniform(*PAPER_HEIGHT_M)), views.PAPER_RADIUS_M
        rig = DropRig(height - radius, radius, views.PAPER_RATE_HZ)
        plans.append((rig, float(rng.uniform(*PAPER_RESTITUTION)), None))
        value, camera = float(rng.uniform(*PAPER_RESTITUTION)), int(rng.integers(2**62))
        plans.append((rig, value, camera))
    observations = observe_all(_observe_paper_plans, plans, workers, progress)
    values = np.array([[restitution] for _, restitution, _ in plans])
    return PairSet(observations, values, *consecutive_pairs(count))


TRAININGS = {
    "default": DROP_TRAININGS["default"],  # the canonical observation knows no camera
    "paper": Training(
        Purpose(
            task="drop-video",
            preset="paper",
            observation="z [5 m] of the simulation, y of the picture from 0 to 1, 400 samples at "
            "60 Hz from the release",
            inputs=views.PAPER_SAMPLES,
            outputs=1,
            rates_hz=(views.PAPER_RATE_HZ,),
        ),
        PaperNetwork(),
        PAPERS_TEXT,
        _paper_pairs,
    ),
}

PRESETS = presets_of(TRAININGS, REAL_BALL, (RESTITUTION,))
