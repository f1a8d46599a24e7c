"""Where a log's motion begins, and how sure that is."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tunenet_logs.analysis.sysid.source import Samples, beginning, initial_turn
from tunenet_logs.episode import Array, Signal
from tunenet_logs.recorders.simulators.model.rollout import SensedSignal

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


def test_a_curve_that_a_parabola_meets_is_read_off_the_whole_window():
    seconds = np.arange(0.0, 1.0, 0.005)
    rng = np.random.default_rng(0)
    found = beginning(sampled(2 + 3 * seconds - seconds**2, 1e-3, 200.0, rng), None, START_NS)
    assert found is not None
    (place, speed), (place_sd, speed_sd), _ = found
    assert abs(place - 2) < 3 * place_sd < 0.006
    assert abs(speed - 3) < 3 * speed_sd < 0.25  # three times what 24 samples leave of a slope


@pytest.mark.parametrize("lag_s", [0.0, 0.01, 0.05])
def test_speeds_that_positions_contradict_are_not_taken_for_sure(lag_s: float):
    rng = np.random.default_rng(0)
    seconds = np.arange(0.0, 3.0, 0.001)
    speeds = sampled(np.cos(3 * (seconds - lag_s) + 1), 1e-4, 1000.0, rng)  # as filters do
    found = beginning(sampled(np.sin(3 * seconds + 1) / 3, 1e-5, 1000.0, rng), speeds, START_NS)
    assert found is not None
    values, sds, _ = found
    assert abs(values[1] - np.cos(1)) < 3 * sds[1] < 0.003 + 9 * lag_s


def test_speeds_alone_tell_no_position():
    speeds = sampled(np.linspace(1, 2, 100), 1e-3, 100.0, np.random.default_rng(0))
    few = (speeds[0][:3], np.full(3, 7.0))
    for positions in (None, few):
        found = beginning(positions, speeds, START_NS)
        assert found is not None
        (_, speed), (_, sd), knows_position = found
        assert not knows_position
        assert abs(speed - 1) < 3 * sd < 0.02


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
