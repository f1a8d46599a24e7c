"""Time without contacts, there and back."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.analysis.drop.motion import ContactClock

LASTS_S = 0.004


@pytest.fixture
def clock() -> ContactClock:
    begins_s = np.array([1.0, 1.5, 1.8])
    log_s = np.column_stack([begins_s, begins_s + LASTS_S]).ravel()
    passed_s = np.cumsum(np.tile([0.0, LASTS_S - 4e-6], 3))
    return ContactClock(log_s, log_s - passed_s)


def test_each_contact_is_left_out(clock: ContactClock):
    seconds = np.array([0.5, 1.2, 1.6, 2.5])
    later_s = seconds - clock.to_free(seconds)
    assert later_s == pytest.approx(np.arange(4) * LASTS_S, abs=2e-5)


def test_there_and_back(clock: ContactClock):
    seconds = np.linspace(0, 3, 1001)
    there = clock.to_free(seconds)
    assert np.all(np.diff(there) > 0)
    assert clock.to_log(there) == pytest.approx(seconds, abs=1e-9)


def test_without_contacts_nothing_changes():
    clock, seconds = ContactClock(np.zeros(0), np.zeros(0)), np.linspace(0, 3, 7)
    assert clock.to_free(seconds) is seconds
    assert clock.to_log(seconds) is seconds
