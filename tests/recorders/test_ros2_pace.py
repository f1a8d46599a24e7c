"""Rate and gaps of stamps, and the names of topics."""

from __future__ import annotations

import numpy as np
import pytest

from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.ros2 import checked_topic, dds_topic, ros_topic, ros_type
from tunenet_logs.recorders.ros2.recording import Pace


def pace_of(stamps_s: np.ndarray) -> Pace:
    pace = Pace()
    for one in stamps_s:
        pace.add(round(one * 1e9))
    return pace


@pytest.mark.parametrize("rate_hz", [10.0, 65.0, 1000.0])
@pytest.mark.parametrize("lost", [(40, 60), (3, 8)])
def test_a_gap_is_found_whenever_it_is(rate_hz: float, lost: tuple[int, int]):
    rng = np.random.default_rng(1)
    stamps_s = (np.arange(500) + rng.uniform(-0.2, 0.2, 500)) / rate_hz
    late = stamps_s + np.where(np.arange(500) > 300, 1.0, 0.0)
    pace = pace_of(np.delete(late, slice(*lost)))
    gap_s = (lost[1] - lost[0] + 1) / rate_hz
    is_long = gap_s > 0.01
    assert pace.gaps == 1 + is_long
    assert pace.longest_gap_s == pytest.approx(max(1 + 1 / rate_hz, gap_s), abs=0.5 / rate_hz)
    assert pace.rate_hz == pytest.approx(rate_hz, rel=0.05)
    assert pace.samples == 500 - (lost[1] - lost[0])


def test_nothing_is_said_of_a_few_samples_and_of_stamps_that_stand_still():
    assert pace_of(np.arange(3.0)).in_words() == "0.0 Hz, no gap"
    assert pace_of(np.zeros(1000)).in_words() == "0.0 Hz, no gap"
    assert Pace().in_words() == "0.0 Hz, no gap"


def test_stale_repeats_are_no_gap():
    pace = pace_of(np.repeat(np.arange(100) / 50.0, 3))
    assert pace.in_words() == "50.0 Hz, no gap"
    assert pace.samples == 300


def test_names_of_topics_and_types():
    assert checked_topic(" arm/joint_states ") == "/arm/joint_states"
    assert ros_topic(dds_topic("/arm/joint_states")) == "/arm/joint_states"
    assert ros_topic("rq/arm/setRequest") is None
    assert ros_type("sensor_msgs::msg::dds_::JointState_") == "sensor_msgs/msg/JointState"
    assert ros_type("Shape") == "Shape"
    for text in ("", "/", "a b", "/a//b", "/1a", "a/", "~a", "a" * 300, "/a\nb"):
        with pytest.raises(UsageError, match="topic"):
            checked_topic(text)
