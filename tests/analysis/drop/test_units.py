"""Units that a log names, does not name, or names wrongly; tracks of pixels that jump or repeat."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.strangers import bounce_heights
from tunenet_logs.analysis.drop import motion as problem
from tunenet_logs.analysis.drop.track import ball_alone, without_jumps
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import to_json
from tunenet_logs.analysis.tuning import tune_episode, tune_log
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


class Units(NamedTuple):
    """What a log is in, and what its record says of that; what is None is not told."""

    log: dict[str, Any]
    length_m: float | None
    length_by: str | None
    rate_by: str | None
    speed: bool = True


UNITS = {
    **{
        f"{size} m": Units({"size": size}, size, "gravity", "clock")
        for size in (1.0, 0.01, 0.001, 0.3048, 0.0254)
    },
    "metres": Units({"unit": "m"}, 1.0, "named", "clock"),
    "some pixels": Units({"size": 1 / 412}, None, None, "clock", False),
    "pixels": Units({"size": 1 / 412, "unit": "px"}, None, None, "clock", False),
    "milliseconds": Units({"clock": 1000.0}, 1.0, "gravity", "gravity"),
    "slow motion": Units({"clock": 8.0}, None, None, "clock", False),
    "frames in metres": Units({"unit": "m", "frames": True}, 1.0, "named", "gravity"),
    "frames": Units({"size": 0.01, "frames": True}, None, None, None, False),
    "frames in pixels": Units(
        {"size": 0.01, "unit": "px", "frames": True}, None, None, None, False
    ),
}


@pytest.mark.parametrize("name", UNITS)
def test_gravity_tells_what_nobody_named(name: str):
    log, length_m, length_by, rate_by, speed = UNITS[name]
    answer = told(**log)
    if not log.get("frames"):
        assert answer["verdict"] == "ok", answer["reason"]
    units = answer["units"]
    assert (units["length_m"], units["length_by"]) == (length_m, length_by)
    if name != "slow motion":
        assert units["rate_by"] == rate_by
        expected = pytest.approx(RATE_HZ, rel=0.02 if log.get("frames") else 1e-3)
        assert units["rate_hz"] == (expected if rate_by else None)
    assert_tuned(answer, speed=speed)


@pytest.mark.parametrize(
    ("size", "clock", "said"),
    [
        (0.001, 1.0, "in mm"),
        (0.0254, 1.0, "in in"),
        (1 / 412, 1.0, "in pixels"),
        (1.0, 1000.0, "stamps are in ms"),
    ],
)
def test_metres_that_fall_otherwise_are_doubted(size: float, clock: float, said: str):
    answer = told(size, "m", clock=clock)
    assert answer["verdict"] == "suspect"
    assert said in answer["reason"]
    assert answer["parameters"]["restitution"]["value"] == pytest.approx(E, abs=0.003)
    if size != 1:
        assert answer["bounces"][0]["impact_speed"] is None


TILT = np.radians(25.0)
TURNS = {
    "+y": np.eye(3)[[1, 2, 0]],
    "+x": np.eye(3)[[2, 0, 1]],
    "+z": np.eye(3),
    "25 degrees off": np.array(
        [[np.cos(TILT), 0, np.sin(TILT)], [0, 1, 0], [-np.sin(TILT), 0, np.cos(TILT)]]
    ),
}


@pytest.mark.parametrize("up", TURNS)
@pytest.mark.parametrize("unit", ["m", UNSTATED])
def test_any_direction_may_be_up(up: str, unit: str):
    answer = told(1.0 if unit else 0.001, unit, turn=TURNS[up])
    assert answer["verdict"] == "ok", answer["reason"]
    assert_tuned(answer)
    if up in ("+x", "+y", "+z"):
        assert any(f"up is {up}" in words for words in answer["warnings"]) is (up != "+z")


# Of a drop that is filmed from the side; FALL in pictures.
HEIGHT_PX, RESTITUTION, FALL = 600.0, 0.8, 11.0
RUNS = (range(30, 31), range(40, 44), range(47, 48))


def filmed(pictures: int = 100, hold: int = 10) -> Signal:
    """A bouncing ball, a row a picture, in whole pixels, y down."""
    t = np.arange(pictures, dtype=float) - hold - 0.3
    heights = bounce_heights(RESTITUTION, HEIGHT_PX, t, 2 * HEIGHT_PX / FALL**2)
    x = np.where(t < 0, 80.0, 80.0 + t)
    places = np.stack([x, 900 - heights, np.zeros_like(x)], axis=1).round()
    stamps = np.arange(pictures, dtype=np.int64) * 40_000_000
    return Signal("track", stamps, places, ("x", "y", "z"), unit="")


def with_jumps(signal: Signal, *runs: range) -> Signal:
    values = signal.values.copy()
    for run in runs:
        values[run.start : run.stop] = [445.0, 25.0, 0.0]
    return replace(signal, values=values)


def with_repeats(signal: Signal, every: int) -> Signal:
    """The pictures in `every` stamps one fewer, the first of them twice."""
    stamps = np.arange(len(signal.values) * every // (every - 1))
    values = signal.values[stamps * (every - 1) // every]
    return replace(signal, stamps_ns=stamps.astype(np.int64) * 40_000_000, values=values)


def write(path: Path, signal: Signal, names: str = "t,x,y", digits: int = 0) -> Path:
    rows = [
        f"{at * 1e-9:.6f},{x:.{digits}f},{y:.{digits}f}\n"
        for at, (x, y, _) in zip(signal.stamps_ns.tolist(), signal.values.tolist(), strict=True)
    ]
    path.write_text(names + "\n" + "".join(rows))
    return path


@pytest.mark.parametrize("every", [0, 5, 10])
@pytest.mark.parametrize("runs", [(), RUNS])
def test_a_track_with_jumps_and_repeats_is_tuned_like_the_clean_one(
    tmp_path: Path, runs: tuple[range, ...], every: int
):
    seen = with_jumps(filmed(), *runs)
    seen = with_repeats(seen, every) if every else seen
    tuning = tune_log(write(tmp_path / "a.csv", seen), TuneOptions())
    estimate = record_of(tuning).estimates[0].value
    assert estimate == pytest.approx(RESTITUTION, abs=0.01)
    jumps = "6 samples of track jump away and back: they were left out"
    assert any("there twice in track" in words for words in tuning.warnings) == bool(every)
    if not every:
        assert (jumps in tuning.warnings) == bool(runs)
        assert tuning.detection.outliers == 6 * bool(runs)


def test_what_is_elsewhere_too_often_and_what_is_named_in_metres_is_kept():
    often = with_jumps(filmed(), *(range(at, at + 3) for at in range(20, 90, 7)))
    seen = with_repeats(filmed(), 5)
    still = replace(filmed(), values=np.full((100, 3), 7.0))
    assert without_jumps(often) is None
    for kept in (still, replace(seen, unit="m", values=seen.values * 1e-3)):
        assert ball_alone(kept) is None


def test_a_fall_of_miles_is_told_in_metres_only_where_there_are_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pixels = filmed()
    stamps = np.arange(100, dtype=np.int64) * 31_795_000  # 0.6 m in 11 of them
    metres = replace(pixels, stamps_ns=stamps, values=(900 - pixels.values) * 1e-3)
    logs = {
        "are the lengths in mm or cm?": write(tmp_path / "m.csv", metres, "t_s,x_m,y_m", 3),
        "no fall of a ball is seen in it": write(tmp_path / "px.csv", pixels),
    }
    monkeypatch.setattr(problem, "_HIGHEST_SIMULATED_M", 0.0)
    monkeypatch.setattr(problem, "HIGHEST_M", 0.0)
    for said, log in logs.items():
        assert said in (record_of(tune_log(log, TuneOptions())).reason or "")
