"""The filmed drop's presets: what a network sees of simulation and video, and its training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from analysis.drop import observations as views
from analysis.drop.film import FilmedDrop, canonical_film, find_filmed_drop
from analysis.drop.presets import (
    OUR_TRAINING,
    PAPER_HEIGHT_M,
    PAPER_RESTITUTION,
    PAPERS_TEXT,
)
from analysis.drop.projected_track import projected_track
from analysis.experiment import Training, presets_of
from analysis.tunenet.checkpoint import Purpose
from analysis.tunenet.network import AntisymmetricNetwork, PaperNetwork
from analysis.tunenet.pairs import PairSet, consecutive_pairs, cross_pairs, observe_all
from recorders.simulators.closed_form.bounce import Bounce
from recorders.simulators.contact import CALIBRATED, PAPER
from recorders.simulators.drop import RESTITUTION, TOPIC, DropRig, DropSimulator
from recorders.simulators.pinhole import PinholeCamera, random_camera
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import NotFoundError
from tunenet_logs.terminal import Progress

PAPER_SIZE_PX = (100, 100)
_PAPER_FOV_DEG = 60.0
_PAPER_NOISE_PX = 0.2
_PAPER_PAIRS = 800
"""The TuneNet paper's pictures and pairs; at 60 degrees hardly any drop leaves the picture."""

_RATES_HZ = (30.0, 60.0, 120.0, 240.0)
_GAP_M = (0.2, 2.5)
_RADIUS_M = 0.03
_SIZES_PX = ((320, 240), (640, 480), (240, 320))
_FOV_DEG = (30.0, 75.0)
_NOISE_PX = (0.03, 0.6)
_LOST_FRACTION = 0.1
_STEEPEST = 0.2
"""Cameras, drops and tracks to train for, wider than what people film: rates, drop heights, ball,
picture sizes, fields of view, noise, most pictures without the ball, steepest slope."""

_SIMULATED, _FILMED, _PAIRS = 1024, 768, 51_200
"""Rollouts of either kind, and pairs that are drawn among them: a film takes longer to make."""


@dataclass(frozen=True)
class FilmPlan:
    """A drop to simulate and look at: as the simulator knows it (no seed), or filmed.

    Attributes:
        seed: draws the camera, the track's noise and the pictures that are lost.
        noise_px: of the track, in place of the drawn one.
        slope: how the filmed ball's restitution falls with speed; see `Bounce`.
    """

    rig: DropRig
    restitution: float
    seed: int | None = None
    noise_px: float | None = None
    slope: float = 0.0


def _observe_plans(plans: Sequence[FilmPlan]) -> Array:
    """Canonical observations, shape (N, L, 1), NaN for a film that shows no drop."""
    curves: list[Array] = []
    simulator = DropSimulator(plans[0].rig, CALIBRATED)
    for plan in plans:
        simulator = simulator.with_rig(plan.rig)
        if plan.seed is None:
            episode = simulator.rollout({RESTITUTION.name: plan.restitution})
            curves.append(views.canonical(views.rollout_drop(episode, plan.rig, CALIBRATED)).values)
            continue
        film = film_of(plan, simulator)
        lost = np.full((len(views.canonical_axis()), 1), np.nan)
        curves.append(lost if film is None else canonical_film(film).values)
    return np.array(curves)


def film_of(plan: FilmPlan, simulator: DropSimulator) -> FilmedDrop | None:
    """The film of a plan with a seed; None where no drop is found in it."""
    rng = np.random.default_rng(plan.seed)
    size, fov = _SIZES_PX[rng.integers(len(_SIZES_PX))], float(rng.uniform(*_FOV_DEG))
    camera = random_camera(rng, plan.rig.gap_m, plan.rig.radius_m, size, max(fov, 50.0))
    noise_px = float(np.exp(rng.uniform(*np.log(_NOISE_PX))))
    if plan.noise_px is not None:
        noise_px = plan.noise_px
    episode = simulator.with_rig(plan.rig).rollout({RESTITUTION.name: plan.restitution})
    if plan.slope:
        episode = _real_ball(episode, plan)
    track = projected_track(episode, camera, noise_px, rng.random() * _LOST_FRACTION, rng)
    try:
        return find_filmed_drop(track, plan.rig.start_ns)
    except NotFoundError:
        return None


def _real_ball(episode: Episode, plan: FilmPlan) -> Episode:
    """The same drop of a ball whose restitution falls with speed, in closed form."""
    signal, rig = episode.signals[TOPIC], plan.rig
    drop = views.rollout_drop(episode, rig, CALIBRATED)
    places = (drop.seconds - drop.impact_s) / drop.fall_time_s
    heights_m = drop.contact_m + rig.gap_m * Bounce(plan.restitution, plan.slope).heights(places)
    positions_m = np.column_stack([signal.values[:, :2], heights_m])
    return replace(episode, signals={TOPIC: replace(signal, values=positions_m)})


def _canonical_pairs(count: int | None, seed: int, jobs: int | None, progress: Progress) -> PairSet:
    """Simulated curves against filmed ones; restitutions evenly over their range in both.

    Half of the filmed balls are real ones: what is to be found is their first impact's restitution.
    """
    count = count or _PAIRS
    rng = np.random.default_rng([seed, 1])
    plans: list[FilmPlan] = []
    for rows, filmed in ((min(_SIMULATED, count), False), (min(_FILMED, count), True)):
        low, high = RESTITUTION.training_range
        for index in range(rows):
            value = low + (high - low) * (index + rng.random()) / rows
            plan = FilmPlan(any_rig(rng), float(value))
            if filmed:
                slope = max(0.0, float(rng.uniform(-_STEEPEST, _STEEPEST)))  # half have none
                plan = replace(plan, seed=int(rng.integers(2**62)), slope=slope)
            plans.append(plan)
    order = rng.permutation(len(plans))  # filmed ones take longer: spread them over the processes
    observations = np.empty((len(plans), len(views.canonical_axis()), 1))
    observations[order] = observe_all(_observe_plans, [plans[one] for one in order], jobs, progress)
    values = np.array([plan.restitution for plan in plans])
    filmed = np.array([plan.seed is not None for plan in plans])
    shown = np.isfinite(observations).any(axis=(1, 2))
    simulated, films = np.flatnonzero(~filmed), np.flatnonzero(filmed & shown)
    return PairSet(
        observations, values[:, None], *cross_pairs(values, simulated, films, count, rng)
    )


def any_rig(rng: np.random.Generator) -> DropRig:
    """Of any height and rate, held or not, seen for four to eight fall times."""
    gap, rate = float(rng.uniform(*_GAP_M)), float(rng.choice(_RATES_HZ))
    fall_s = float(np.sqrt(2 * gap / CALIBRATED.gravity_m_s2))
    hold_s = float(rng.uniform(0.0, 0.5))
    span = float(rng.uniform(views.CANONICAL_SPAN, 2 * views.CANONICAL_SPAN))
    samples = int(np.ceil((hold_s + (span + 1) * fall_s) * rate)) + 3
    return DropRig(gap, _RADIUS_M, rate, samples, hold_s)


def _observe_paper_plans(plans: Sequence[FilmPlan]) -> Array:
    """Z of a simulation, or the image's y of a filmed one; shape (N, 400, 1)."""
    curves: list[Array] = []
    simulator = DropSimulator(plans[0].rig, PAPER)
    for plan in plans:
        simulator = simulator.with_rig(plan.rig)
        episode = simulator.rollout({RESTITUTION.name: plan.restitution})
        if plan.seed is None:
            curves.append(views.paper_unit_heights(episode).values)
            continue
        rows = paper_rows(episode.signals[TOPIC].values, np.random.default_rng(plan.seed))
        curves.append(filled(rows)[:, None])
    return np.array(curves)


def paper_rows(positions_m: Array, rng: np.random.Generator) -> Array:
    """Where a ball is in the picture of one of the paper's cameras, 0 at the top, 1 at the bottom.

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
    """Rows with those between joined by lines, for a network that must be told every one."""
    known, numbers = np.isfinite(rows), np.arange(len(rows))
    return np.interp(numbers, numbers[known], rows[known])


def _paper_camera(rng: np.random.Generator) -> PinholeCamera:
    """As the paper draws it; at 60 degrees hardly any drop leaves the picture."""
    distance, angle = rng.uniform(5.0, 10.0), rng.uniform(0.0, 2 * np.pi)
    place = (distance * np.cos(angle), distance * np.sin(angle), rng.uniform(5.0, 8.0))
    return PinholeCamera(place, (0.0, 0.0, 2.0), PAPER_SIZE_PX, _PAPER_FOV_DEG)


def _paper_pairs(count: int | None, seed: int, jobs: int | None, progress: Progress) -> PairSet:
    """Both rollouts of a pair from one height; the second one is filmed."""
    count = count or _PAPER_PAIRS
    rng = np.random.default_rng(seed)
    plans: list[FilmPlan] = []
    for _ in range(count):
        height, radius = float(rng.uniform(*PAPER_HEIGHT_M)), views.PAPER_RADIUS_M
        rig = DropRig(height - radius, radius, views.PAPER_RATE_HZ)
        plans.append(FilmPlan(rig, float(rng.uniform(*PAPER_RESTITUTION))))
        value, camera = float(rng.uniform(*PAPER_RESTITUTION)), int(rng.integers(2**62))
        plans.append(FilmPlan(rig, value, camera))
    observations = observe_all(_observe_paper_plans, plans, jobs, progress)
    values = np.array([[plan.restitution] for plan in plans])
    return PairSet(observations, values, *consecutive_pairs(count))


TRAININGS = {
    "default": Training(
        Purpose(
            task="drop-video",
            preset="default",
            observation="flights after impact by a fitted projection, 32 places a fall time, "
            "4 fall times",
            inputs=len(views.canonical_axis()),
            outputs=1,
            rates_hz=_RATES_HZ,
        ),
        AntisymmetricNetwork(),
        OUR_TRAINING,
        _canonical_pairs,
    ),
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

PRESETS = presets_of(TRAININGS)
