"""Least squares over rollouts: values, intervals that cover, noise, where a log's motion begins."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation
from scipy.stats import t

from tests.analysis.sysid.pendulums import SECONDS, Shape, line, parameter, run_of, target_of
from tunenet_logs.analysis.sysid.columns import compared
from tunenet_logs.analysis.sysid.least_squares import RolloutLeastSquares, Solution, covariance
from tunenet_logs.analysis.sysid.source import Samples, beginning, initial_turn
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.simulators.model.rollout import SensedSignal

NOISE = 0.01


def solved(shape: Shape, truth: list[float], *, low: float = -5.0) -> Solution:
    rng = np.random.default_rng(1)
    seen = shape(np.array(truth)) + NOISE * rng.normal(size=len(SECONDS))
    parameters = tuple(parameter(f"p{number}", low) for number in range(len(truth)))
    start = np.array([one.initial for one in parameters])
    return RolloutLeastSquares(run_of(shape), target_of(seen), parameters).solve(start)


def test_what_lies_beyond_a_bound_ends_on_it():
    solution = solved(line, [-7.0, 2.0])
    assert solution.values[0] == -5.0
    assert solution.values[1] == pytest.approx(2.0, abs=0.8)


@pytest.mark.parametrize("truth", [[1.0], [1.0, 0.0]])
def test_a_parameter_without_effect_stays_and_is_unsure(truth: list[float]):
    def shape(values: Array) -> Array:
        first = values[0] if len(values) > 1 else 0.0
        return first + np.sin(SECONDS)

    solution = solved(shape, truth)
    assert abs(solution.values[-1]) < 0.1
    seen = target_of(np.sin(SECONDS))
    parameters = tuple(parameter(f"p{number}") for number in range(len(truth)))
    found, _ = covariance(solution, seen, parameters)
    assert np.sqrt(found[-1, -1]) > 10.0  # the whole range


def decay(values: Array) -> Array:
    return np.exp(-0.1 * values[0] ** 2 * SECONDS) * np.cos((1 + 0.1 * values[1]) * SECONDS)


def rough(values: Array) -> Array:
    return line(values) + 0.003 * np.sin(1e5 * values[0] + 50 * SECONDS)


@pytest.mark.parametrize(
    ("shape", "truth", "low"),
    [(line, [1.0, -2.0], -5.0), (rough, [1.0, -2.0], -5.0), (decay, [1.5, 0.7], 0.1)],
)
def test_known_values_come_back(shape: Shape, truth: list[float], low: float):
    assert solved(shape, truth, low=low).values == pytest.approx(truth, abs=0.02)


LOGS = 400


@pytest.mark.parametrize(("memory", "least"), [(0.0, 0.90), (0.6, 0.90), (0.85, 0.90)])
def test_95_percent_intervals_cover(memory: float, least: float):
    """Where few independent moments are left, sums over lags come out a little small."""
    rng = np.random.default_rng(3)
    truth = np.array([1.0, -2.0])
    slopes = np.column_stack([line(row) for row in np.eye(2)])
    parameters = (parameter("a"), parameter("b"))
    inside = np.zeros(2)
    for _ in range(LOGS):
        drawn = rng.normal(size=len(SECONDS) + 200)
        noise = 0.05 * np.asarray(lfilter([1.0], [1.0, -memory], drawn))[200:]
        target = target_of(line(truth) + noise)
        values = np.linalg.lstsq(slopes, target.values, rcond=None)[0].astype(np.float64)
        residuals = line(values) - target.values
        everything = np.ones(len(SECONDS), bool)
        noise_left, no_bends = target.rms(residuals), np.zeros((2, len(SECONDS)))
        solution = Solution(values, residuals, slopes, noise_left, (), everything, no_bends)
        found, independent = covariance(solution, target, parameters)
        half = t.ppf(0.975, max(independent - 2, 1)) * np.sqrt(np.diag(found))
        inside += np.abs(values - truth) < half
    assert (inside / LOGS >= least).all(), inside / LOGS
    assert (inside / LOGS <= 0.985).all(), inside / LOGS


@pytest.mark.parametrize("count", [19_999, 20_000, 20_001, 50_000])
def test_long_columns_are_thinned_with_their_stamps(count: int):
    stamps_ns = 1_000_000 * np.arange(count)
    values = np.stack([np.sin(1e-9 * stamps_ns), np.full(count, np.nan)], axis=1)
    values[7, 0] = np.nan
    log = Episode(EpisodeInfo(), {"/x": Signal("/x", stamps_ns, values, ("x", "y"), "m")})
    target = compared(log, log)
    assert len(target.columns) == 1
    assert 15_000 < len(target.values) <= 20_000
    np.testing.assert_allclose(target.values, np.sin(target.seconds), atol=1e-12)
    np.testing.assert_allclose(target.seen_in(log), target.values, atol=1e-12)


START_NS = 1_700_000_000_000_000_000


def sampled(curve: Array, noise: float, hz: float, rng: np.random.Generator) -> Samples:
    stamps_ns = START_NS + np.round(np.arange(len(curve)) * 1e9 / hz).astype(np.int64)
    return stamps_ns, curve + noise * rng.standard_normal(len(curve))


@pytest.mark.parametrize("share", [5e-5, 5e-4, 5e-3])
@pytest.mark.parametrize("has_speeds", [False, True])
def test_the_start_is_within_what_it_is_said_to_be(share: float, has_speeds: bool):
    rng = np.random.default_rng(0)
    off: list[float] = []
    for swings_hz, hz in product([0.2, 1.0, 4.0], [100.0, 200.0, 1000.0]):
        seconds, rate = np.arange(0.0, 3 / swings_hz, 1 / hz), 2 * np.pi * swings_hz
        for phase in rng.uniform(0.0, 2 * np.pi, 20):
            turn = rate * seconds + phase
            place = np.sin(turn) + 0.2 * np.sin(2.3 * turn)
            slope = rate * (np.cos(turn) + 0.46 * np.cos(2.3 * turn))
            speeds = sampled(slope, share * rate, hz, rng) if has_speeds else None
            found = beginning(sampled(place, share, hz, rng), speeds, START_NS)
            assert found is not None
            values, sds, _ = found
            off += [abs(values[0] - place[0]) / sds[0], abs(values[1] - slope[0]) / sds[1]]
    assert np.mean(np.array(off) < 3) >= 0.99
    assert np.max(off) < 6  # a hundred and more, of one parabola for all


@pytest.mark.parametrize("spin_rad_s", [0.5, 5.0, 38.0])
@pytest.mark.parametrize("hz", [50.0, 150.0, 1000.0])
def test_a_spin_is_within_what_it_is_said_to_be(spin_rad_s: float, hz: float):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        spin = rng.normal(size=3)
        spin *= spin_rad_s / np.linalg.norm(spin)
        seconds = np.arange(0.0, 1.0, 1 / hz)
        turns = Rotation.from_rotvec(rng.normal(size=3)) * Rotation.from_rotvec(
            seconds[:, None] * spin
        )
        seen = turns * Rotation.from_rotvec(0.003 * rng.normal(size=(len(seconds), 3)))
        axes = seen.as_matrix()[:, :, [0, 2]].transpose(0, 2, 1).reshape(-1, 6)
        stamps_ns = START_NS + np.round(1e9 * seconds).astype(np.int64)
        signal = Signal("/body.orientation", stamps_ns, axes, tuple("abcdef"), "1")
        found = initial_turn(SensedSignal(signal, signal.columns, ()), START_NS)
        assert found is not None
        assert (np.abs(found.spin - spin) < 3 * found.spin_sd).all()
        off_rad = (turns[0].inv() * Rotation.from_quat(np.roll(found.quaternion, -1))).magnitude()
        assert off_rad / 2 < 3 * found.quaternion_sd
