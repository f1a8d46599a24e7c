"""Torques as the payload's networks see them."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.payload.detection import (
    CIRCLE_S,
    circle_phase_s,
    paper_torques,
    payload_readings,
)
from tunenet_logs.recorders.simulators.arm.description import jaco
from tunenet_logs.recorders.simulators.arm.path import JointPath, circle_at


def test_readings_add_up_to_the_mass():
    rng = np.random.default_rng(5)
    per_kg = rng.normal(size=(50, 9))
    empty = rng.normal(size=(50, 9))
    seen = payload_readings(empty + 0.7 * per_kg + rng.normal(size=9), empty, per_kg)
    assert seen.values.shape == (7, 1)
    felt = np.sort(((per_kg - per_kg.mean(axis=0)) ** 2).sum(axis=0))[::-1]
    assert seen.values[:, 0] == pytest.approx(0.7 * felt[:7] / felt.sum())


def test_the_circle_is_known_wherever_it_begins():
    seconds = np.arange(0.0, 4.5, 1 / 58)
    for phase_s in (0.0, 1.3, 5.0):
        there = circle_at(seconds + phase_s)
        path = JointPath(
            seconds, there.position_rad, there.velocity_rad_s, there.acceleration_rad_s2
        )
        found_s, off_rad = circle_phase_s(path)
        assert abs((found_s - phase_s + 1) % CIRCLE_S - 1) < 1e-3
        assert off_rad < 1e-3
    torques = np.sin(1.2 * (seconds + 1.3))[:, None] * np.ones(7)
    seen = paper_torques(seconds, torques, 1.3)
    known = np.isfinite(seen.values[:, 0])
    assert 0.8 < known.mean() < 0.9
    assert seen.values[known, 0] == pytest.approx(np.sin(1.2 * seen.axis[known]), abs=0.02)


def test_the_jaco_is_the_arm_that_is_built_in():
    assert len(jaco().joints) == 7
