"""Time without contacts, there and back."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.drop.motion import on_clock

LASTS_S = 0.004
BEGINS_S = np.array([1.0, 1.5, 1.8])
LOG_S = np.column_stack([BEGINS_S, BEGINS_S + LASTS_S]).ravel()
FREE_S = LOG_S - np.cumsum(np.tile([0.0, LASTS_S - 4e-6], 3))


def test_each_contact_is_left_out():
    seconds = np.array([0.5, 1.2, 1.6, 2.5])
    later_s = seconds - on_clock(seconds, LOG_S, FREE_S)
    assert later_s == pytest.approx(np.arange(4) * LASTS_S, abs=2e-5)


def test_there_and_back():
    seconds = np.linspace(0, 3, 1001)
    there = on_clock(seconds, LOG_S, FREE_S)
    assert np.all(np.diff(there) > 0)
    assert on_clock(there, FREE_S, LOG_S) == pytest.approx(seconds, abs=1e-9)


def test_without_contacts_nothing_changes():
    seconds = np.linspace(0, 3, 7)
    assert on_clock(seconds, np.zeros(0), np.zeros(0)) is seconds
