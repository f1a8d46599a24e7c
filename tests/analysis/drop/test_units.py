"""Units that a log names, does not name, or names wrongly: what gravity tells of them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from tests.strangers import bounce_heights
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import to_json
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import FRAME_NS, UNSTATED, Episode, EpisodeInfo, Signal

E, RATE_HZ, FALL_M = 0.72, 120.0, 1.1
SPEED_M_S = np.sqrt(2 * 9.81 * FALL_M)


def told(
    size: float = 1.0,
    unit: str = UNSTATED,
    *,
    clock: float = 1.0,
    frames: bool = False,
    turn: np.ndarray | None = None,
) -> dict[str, Any]:
    """The JSON of a ball that was held, dropped and came to rest.

    Args:
        size: metres in one unit of the log.
        unit: that the log names.
        clock: the log's seconds in a true one.
        frames: whether the log counts frames.
        turn: of the axes, shape (3, 3).
    """
    times = np.arange(round(4.5 * RATE_HZ)) / RATE_HZ
    heights = bounce_heights(E, FALL_M, times - 0.5)
    xyz = np.column_stack([0.02 * times + 0.3, 0 * times - 0.1, heights + 0.4])
    xyz += np.random.default_rng(5).normal(0, 0.0005, xyz.shape)
    if turn is not None:
        xyz = xyz @ turn.T
    stamps = np.round(times * clock * 1e9).astype(np.int64)
    if frames:
        stamps = np.arange(len(times)) * FRAME_NS
    signal = Signal("/thing", stamps, xyz / size, ("x", "y", "z"), unit, frames)
    episode = Episode(EpisodeInfo(), {signal.name: signal})
    return json.loads(to_json(record_of(tune_episode(episode, TuneOptions()))))


def assert_tuned(answer: dict[str, Any], *, speed: bool = True) -> None:
    """The truth to .003; the first impact's speed to 1 %, or null as the drag is."""
    assert answer["parameters"]["restitution"]["value"] == pytest.approx(E, abs=0.003)
    assert len(answer["bounces"]) > 2
    first = answer["bounces"][0]["impact_speed"]
    if speed:
        assert first == pytest.approx(SPEED_M_S, rel=0.01)
        assert answer["parameters"]["drag"]["value"] is not None
    else:
        assert first is None
        assert answer["parameters"]["drag"] == {"value": None, "interval95": None}


@pytest.mark.parametrize("size", [1.0, 0.01, 0.001, 0.3048, 0.0254])
def test_gravity_tells_the_unit_of_length(size: float):
    answer = told(size)
    assert answer["verdict"] == "ok", answer["reason"]
    units = answer["units"]
    assert units["length_m"] == size
    assert units["length_by"] == "gravity"
    assert units["rate_hz"] == pytest.approx(RATE_HZ, rel=1e-3)
    assert units["rate_by"] == "clock"
    assert_tuned(answer)


@pytest.mark.parametrize("unit", [UNSTATED, "px"])
def test_pixels_tell_a_restitution_and_no_speed(unit: str):
    answer = told(1 / 412.0, unit)
    assert answer["verdict"] == "ok", answer["reason"]
    assert answer["units"]["length_m"] is None
    assert answer["units"]["length_by"] is None
    assert answer["units"]["rate_by"] == "clock"
    assert_tuned(answer, speed=False)


def test_named_metres_are_taken_at_their_word():
    answer = told(1.0, "m")
    assert answer["verdict"] == "ok", answer["reason"]
    assert answer["units"] == {
        "length_m": 1.0,
        "length_by": "named",
        "rate_hz": pytest.approx(RATE_HZ, rel=1e-3),
        "rate_by": "clock",
    }
    assert_tuned(answer)


@pytest.mark.parametrize(("size", "name"), [(0.001, "mm"), (0.0254, "in"), (1 / 412, "pixels")])
def test_metres_that_fall_otherwise_are_doubted(size: float, name: str):
    answer = told(size, "m")
    assert answer["verdict"] == "suspect"
    assert f"in {name}" in answer["reason"]
    assert answer["parameters"]["restitution"]["value"] == pytest.approx(E, abs=0.003)
    assert answer["bounces"][0]["impact_speed"] is None


def test_stamps_in_milliseconds_are_doubted():
    answer = told(1.0, "m", clock=1000.0)
    assert answer["verdict"] == "suspect"
    assert "stamps are in ms" in answer["reason"]
    assert answer["parameters"]["restitution"]["value"] == pytest.approx(E, abs=0.003)


def test_milliseconds_of_an_unnamed_clock_are_told_by_gravity():
    answer = told(1.0, clock=1000.0)
    assert answer["verdict"] == "ok", answer["reason"]
    assert answer["units"]["rate_hz"] == pytest.approx(RATE_HZ, rel=1e-3)
    assert answer["units"]["rate_by"] == "gravity"
    assert_tuned(answer)


def test_a_slow_motion_of_unnamed_units_tells_no_speed():
    answer = told(1.0, clock=8.0)
    assert answer["verdict"] == "ok", answer["reason"]
    assert answer["units"]["length_m"] is None
    assert_tuned(answer, speed=False)


def test_frames_of_metres_tell_their_rate():
    answer = told(1.0, "m", frames=True)
    units = answer["units"]
    assert (units["length_m"], units["length_by"], units["rate_by"]) == (1.0, "named", "gravity")
    assert units["rate_hz"] == pytest.approx(RATE_HZ, rel=0.02)
    assert_tuned(answer)


@pytest.mark.parametrize("unit", [UNSTATED, "px"])
def test_frames_of_no_unit_tell_a_restitution_alone(unit: str):
    answer = told(0.01, unit, frames=True)
    assert list(answer["units"].values()) == [None] * 4
    assert_tuned(answer, speed=False)


@pytest.mark.parametrize(
    ("axes", "up"), [((1, 2, 0), "+y"), ((2, 0, 1), "+x"), ((0, 1, 2), "+z")], ids=["y", "x", "z"]
)
@pytest.mark.parametrize("unit", ["m", UNSTATED])
def test_any_axis_may_be_up(axes: tuple[int, ...], up: str, unit: str):
    answer = told(1.0 if unit else 0.001, unit, turn=np.eye(3)[list(axes)])
    assert answer["verdict"] == "ok", answer["reason"]
    assert_tuned(answer)
    assert any(f"up is {up}" in words for words in answer["warnings"]) is (up != "+z")


@pytest.mark.parametrize("unit", ["m", UNSTATED])
def test_25_degrees_off_the_vertical(unit: str):
    angle = np.radians(25.0)
    turn = np.array(
        [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    )
    answer = told(1.0 if unit else 0.001, unit, turn=turn)
    assert answer["verdict"] == "ok", answer["reason"]
    assert_tuned(answer)
