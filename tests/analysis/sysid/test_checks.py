"""What a tuned simulator may leave of a column."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.sysid.checks import match_check
from tunenet_logs.analysis.sysid.fit import Column, ComparedColumns, noise_of

SECONDS = np.arange(0, 4, 0.01)
RNG = np.random.default_rng(3)
# A servo's efforts: a new command with every second sample.
STAIRS = np.repeat(RNG.normal(0, 2.0, len(SECONDS) // 2), 2)
SENSOR = RNG.normal(0, 0.05, len(SECONDS))


def of(values: np.ndarray) -> ComparedColumns:
    column = Column(
        "/effort", "elbow", "N·m", SECONDS, values, noise_of(values), float(np.std(values))
    )
    return ComparedColumns(0, (column,))


def test_efforts_that_jump_are_no_noise_that_hides_a_wrong_model():
    target = of(STAIRS + SENSOR)
    assert target.columns[0].is_jumpy
    assert match_check(target, SENSOR).passed
    assert not match_check(target, SENSOR + np.sin(3 * SECONDS)).passed


@pytest.mark.parametrize("noise", [0.2, 1.0, 5.0])
def test_white_noise_may_be_left(noise: float):
    white = noise * RNG.normal(size=len(SECONDS))
    target = of(np.sin(3 * SECONDS) + white)
    assert match_check(target, white).passed
    assert not match_check(target, white + 2 * np.sin(3 * SECONDS) * max(noise, 0.3)).passed
