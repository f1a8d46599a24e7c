"""What a network should see of a film: the fitted ball's flights, or the track's own samples.

`python -m benchmarks.film_inputs --seeds 1` trains the antisymmetric network on both, on the same
films, and tells the error of each after K = 5 on the same held-out ones, beside that of the fit.

"Flights" is what the preset `default` has: `canonical_film`. "Samples" is a residual input: the
target is the track in fall times and drop heights by its projection, from its fall on; the other
side is the simulated curve by the projective map that suits this track most, so that the difference
of the two is what no camera explains. Equal curves differ by nothing in either.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial

import numpy as np

from analysis.drop.film import FilmedDrop, canonical_film
from analysis.drop.film_presets import FilmPlan, any_rig, film_of
from analysis.drop.observations import CANONICAL_PER_FALL, canonical_axis
from analysis.drop.presets import OUR_TRAINING
from analysis.drop.projection import best_map
from analysis.tunenet.network import AntisymmetricNetwork, Model
from analysis.tunenet.pairs import PairSet, cross_pairs, observe_all
from analysis.tunenet.training import train
from recorders.simulators.closed_form.bounce import Bounce
from recorders.simulators.contact import CALIBRATED
from recorders.simulators.drop import DropSimulator
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

FILMS, SIMULATED, PAIRS, HELD_OUT = 1000, 1024, 40_000, 200
NOISES_PX = (0.3, 1.0)
RANGES = ((0.3, 0.7), (0.1, 0.95), (0.05, 0.15), (0.9, 0.97))
STEPS = 5
_FALL_SHARE = 0.75
FLIGHTS = canonical_axis()
SAMPLES = np.arange(-round(_FALL_SHARE * CANONICAL_PER_FALL), len(FLIGHTS) + 1) / CANONICAL_PER_FALL
_FIELDS = (len(FLIGHTS), len(SAMPLES), 1, 1)


def main(argv: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="benchmarks.film_inputs", description=__doc__)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--films", type=int, default=FILMS, help="to train on")
    parser.add_argument("--targets", type=int, default=HELD_OUT, help="for each noise and seed")
    parser.add_argument("--jobs", type=int)
    options = parser.parse_args(argv)
    progress = Progress(quiet=False)
    errors: dict[tuple[float, str], list[Array]] = {}
    truths: dict[float, list[Array]] = {noise: [] for noise in NOISES_PX}
    for seed in options.seeds:
        looks = [seed, 1], None, (0.0, 1.0)
        networks = networks_of(seen(options.films, *looks, options.jobs, progress), seed, progress)
        for place, noise_px in enumerate(NOISES_PX):
            looks = [seed, 2 + place], noise_px, (0.05, 0.97)
            truth, *views = seen(options.targets, *looks, options.jobs, progress)
            truths[noise_px].append(truth)
            for name, found in answers(networks, *views).items():
                errors.setdefault((noise_px, name), []).append(np.abs(found - truth))
    print("| noise, px | seen | " + " | ".join(f"{a:g} to {b:g}" for a, b in RANGES) + " |")
    print("| --- | --- |" + " --- |" * len(RANGES))
    for (noise_px, name), off in errors.items():
        truth, all_off = np.concatenate(truths[noise_px]), np.concatenate(off)
        means = [all_off[(truth >= a) & (truth <= b)].mean() for a, b in RANGES]
        print(f"| {noise_px:g} | {name} | " + " | ".join(f"{one:.4f}" for one in means) + " |")


def seen(
    count: int,
    seed: list[int],
    noise_px: float | None,
    span: tuple[float, float],
    jobs: int | None,
    progress: Progress,
) -> tuple[Array, Array, Array, Array, Array]:
    """Films in which a drop is found: truths, both targets, noise [drop heights], fitted values."""
    rng = np.random.default_rng(seed)
    values = span[0] + (span[1] - span[0]) * (np.arange(count) + rng.random(count)) / count
    plans = [
        FilmPlan(any_rig(rng), float(value), int(rng.integers(2**62)), noise_px) for value in values
    ]
    rows = observe_all(_look, plans, jobs, progress)
    shown = np.isfinite(rows[:, -1])
    flights, samples, noise, fitted = np.split(rows[shown], np.cumsum(_FIELDS)[:-1], axis=1)
    return values[shown], flights, samples, noise[:, 0], fitted[:, 0]


def _look(plans: Sequence[FilmPlan]) -> Array:
    simulator = DropSimulator(plans[0].rig, CALIBRATED)
    rows = np.full((len(plans), sum(_FIELDS)), np.nan)
    for row, plan in zip(rows, plans, strict=True):
        film = film_of(plan, simulator)
        if film is not None:
            noise = film.drop.noise_m / film.drop.drop_height_m
            fitted = film.projection.bounce.restitution
            row[:] = [*canonical_film(film).values[:, 0], *samples_of(film), noise, fitted]
    return rows


def samples_of(film: FilmedDrop) -> Array:
    """The track on the grid: the means of its samples, joined along the fitted flights."""
    places = film.projection.fall_times(film.drop.seconds)
    ball = film.projection.bounce
    off = film.drop.heights_m / film.drop.drop_height_m - ball.heights(places)
    cell = np.round((places - SAMPLES[0]) * CANONICAL_PER_FALL).astype(int)
    inside = (cell >= 0) & (cell < len(SAMPLES))
    count = np.bincount(cell[inside], minlength=len(SAMPLES))
    sums = np.bincount(cell[inside], off[inside], len(SAMPLES))
    known, grid = np.flatnonzero(count), np.arange(len(SAMPLES))
    mean = np.interp(grid, known, sums[known] / count[known], left=np.nan, right=np.nan)
    return ball.heights(SAMPLES) + mean


def best_seen(restitution: float, target: Array, noise: float) -> Array:
    """The simulated curve as the camera that suits this track most would show it."""
    heights = Bounce(restitution).heights(SAMPLES)
    return best_map(heights, target, noise).positions(heights)


def networks_of(
    views: tuple[Array, Array, Array, Array, Array], seed: int, progress: Progress
) -> tuple[Model, Model]:
    """Trained on pairs of a simulation and a film, the same ones for both: flights, samples."""
    truth, flights, samples, noise, _ = views
    rng = np.random.default_rng([seed, 0])
    simulated = (np.arange(SIMULATED) + rng.random(SIMULATED)) / SIMULATED
    values = np.concatenate([simulated, truth])
    first, films = np.arange(SIMULATED), np.arange(SIMULATED, len(values))
    proposed, target = cross_pairs(values, first, films, PAIRS, rng)
    make = partial(train, AntisymmetricNetwork(), recipe=OUR_TRAINING, seed=seed, progress=progress)
    curves = np.concatenate([[Bounce(float(one)).heights(FLIGHTS) for one in simulated], flights])
    of_flights = make(pairs=PairSet(curves[:, :, None], values[:, None], proposed, target))
    mapped = [
        best_seen(float(values[one]), samples[other], float(noise[other]))
        for one, other in zip(proposed, target - SIMULATED, strict=True)
    ]
    curves = np.concatenate([mapped, samples])
    values = np.concatenate([values[proposed], truth])
    pairs = PairSet(
        curves[:, :, None], values[:, None], np.arange(PAIRS), target - SIMULATED + PAIRS
    )
    return of_flights, make(pairs=pairs)


def answers(
    networks: tuple[Model, Model], flights: Array, samples: Array, noise: Array, fitted: Array
) -> dict[str, Array]:
    """Of each network after K steps from 0, and of the fit."""
    of_flights, of_samples = np.zeros(len(flights)), np.zeros(len(flights))
    for _ in range(STEPS):
        curves = np.array([Bounce(float(one)).heights(FLIGHTS) for one in of_flights])
        step = networks[0](curves[:, :, None], flights[:, :, None])[:, 0]
        of_flights = np.clip(of_flights + step, 0, 1)
        curves = np.array(
            [
                best_seen(float(one), track, float(sd))
                for one, track, sd in zip(of_samples, samples, noise, strict=True)
            ]
        )
        step = networks[1](curves[:, :, None], samples[:, :, None])[:, 0]
        of_samples = np.clip(of_samples + step, 0, 1)
    return {"flights": of_flights, "samples": of_samples, "(the fit itself)": fitted}


if __name__ == "__main__":
    main()
