"""Logs of positions, good and doubtful, in any unit: what comes of them, and what costs nothing."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from tests.analysis.answers import known, trace_of, value
from tests.analysis.drop.made import GRAVITY, RATE_HZ, TOPIC, seen
from tests.conftest import record
from tests.remedies import has_remedy
from tests.strangers import Stranger, bounce_heights, without_chunks
from tunenet_logs.analysis.drop.free_flight import find_drops
from tunenet_logs.analysis.drop.presets import canonical, canonical_axis
from tunenet_logs.analysis.drop.track import ball_alone, without_jumps
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import to_json
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import FRAME_NS, UNSTATED, Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.recorders.simulators.ball import DropRig

TIMES_S = np.arange(840) / RATE_HZ


def bounced(
    restitution: float = 0.7,
    gap_m: float = 1.0,
    *,
    noise_m: float = 0.0,
    at: dict[int, float] | None = None,
) -> Array:
    """Heights of a ball that is let go after a second; some samples are elsewhere."""
    heights = bounce_heights(restitution, gap_m, TIMES_S - 1)
    heights += np.random.default_rng(3).normal(0, noise_m, len(heights)) if noise_m else 0.0
    for index, stray in (at or {}).items():
        heights[index] = stray
    return heights


def off_the_table() -> Array:
    heights, late_s = bounced(), np.maximum(TIMES_S - 3.0, 0)
    fallen = np.maximum(heights - 4.9 * late_s**2, -0.75)
    return np.where(late_s > 0, fallen, heights)


def caught() -> Array:
    heights, at = bounced(), int((1 + 0.4515 + 0.35) * RATE_HZ)
    heights[at:] = heights[at]
    return heights


def rests_elsewhere(restitution: float, gap_m: float, rest_m: float) -> Array:
    fall_s = np.sqrt(2 * gap_m / 9.81)
    end_s = 1 + fall_s * (1 + 2 * restitution / (1 - restitution)) + 0.05
    heights = np.where(end_s < TIMES_S, rest_m, bounced(restitution, gap_m))
    return heights + np.random.default_rng(0).normal(0, 0.001, 840)


def noisy_in_flight() -> Array:
    noise = np.random.default_rng(0).normal(0, 0.005, 840)
    return bounced(0.5) + np.where(TIMES_S > 1, noise, 0.0)


def small_before_big() -> Array:
    times = np.arange(1800) / RATE_HZ
    small, big = bounce_heights(0.5, 0.4, times - 1), bounce_heights(0.9, 4, times - 8)
    return np.where(times < 5, small, np.where(times < 7, 2 * (times - 5), big))


def carried() -> Array:
    """To its place, and let go."""
    way = 1.6 - 0.6 * (1 - np.cos(np.pi * np.arange(150) / 150)) / 2
    return np.concatenate([way, bounced()])


class Row(NamedTuple):
    """A log's heights, and what must come of it; a word may stand in a warning, too."""

    heights: Array
    verdict: str | None = "ok"  # None: any but rejected
    value: float = 0.7
    within: float = 0.001
    words: tuple[str, ...] = ()
    start_s: float | None = None


ANOTHER_LEVEL = ((0.1, 2, -0.02), (0.15, 1, -0.01), (0.25, 5, -0.06), (0.3, 5, 0.06))
ROWS = {
    "good": Row(bounced()),
    "does not bounce": Row(bounced(0.0), "rejected", words=("does not bounce",)),
    "leaves the table": Row(off_the_table(), None),
    "is caught": Row(caught()),
    "feet": Row(0.3048 * bounced(gap_m=3.0), "suspect", within=0.01, words=("gravity",)),
    "is carried to its place": Row(carried(), None),
    "falls already": Row(bounced()[140:], None),
    "still": Row(np.full(300, 0.5), "rejected", words=("does not fall",)),
    "lowered": Row(np.linspace(1, 0, 300), "rejected", words=("no ",)),
    "waved": Row(0.5 + 0.4 * np.sin(np.arange(600) / 60), "rejected", words=("no ",)),
    "noise": Row(
        np.random.default_rng(0).normal(0, 0.01, 400), "rejected", words=("does not fall",)
    ),
    "few samples": Row(np.zeros(3), "rejected", words=("too few",)),
    "carried down": Row(np.linspace(1, 0.4, 300), "rejected"),
    "swings": Row(np.cos(2 * np.pi * np.arange(300) / 150), "rejected"),
    "falls on": Row(1 - 9.81 * (np.arange(300) / 150) ** 2 / 2, "rejected"),
    "lands like clay": Row(np.maximum(1 - 9.81 * (np.arange(300) / 150) ** 2 / 2, 0), "rejected"),
    "is seen no more": Row(
        np.where(np.arange(300) < 45, 1 - 9.81 * (np.arange(300) / 150) ** 2 / 2, np.nan),
        "rejected",
    ),
    "falls slowly": Row(np.maximum(1 - 0.5 * (np.arange(300) / 150) ** 2, 0), "rejected"),
    "cut before it hits": Row(bounced()[:170], "rejected"),
    "millimetres": Row(
        1000 * bounced(gap_m=1.2), "suspect", words=("the lengths are in mm", "--length-unit mm")
    ),
    "a stray below": Row(bounced(at={100: 0.0})),
    "a stray far away": Row(bounced(at={400: 1e5})),
    "a stray at first": Row(bounced(at={30: -1.0})),
    "noise only while it moves": Row(noisy_in_flight(), None, 0.5, 0.01),
    "a small drop first": Row(small_before_big(), None, 0.5, 0.002, ("2 drops",)),
    "the big one chosen": Row(small_before_big(), None, 0.9, 0.002, start_s=6.5),
    "the top of a bounce is not rest": Row(
        bounce_heights(0.46, 4.5, np.arange(1600) / RATE_HZ - 1)
        + np.random.default_rng(1).normal(0, 0.005, 1600),
        "ok",
        0.46,
        0.005,
    ),
    "dull, noisy": Row(bounced(0.15, 4.0, noise_m=0.003), "ok", 0.15, 0.02),
    "usual, noisy": Row(bounced(0.5, 1.0, noise_m=0.003), "ok", 0.5, 0.02),
    "lively, noisy": Row(bounced(0.9, 0.4, noise_m=0.003), "ok", 0.9, 0.02),
    **{
        f"rests {1000 * rest_m} mm off after {gap_m} m": Row(
            rests_elsewhere(restitution, gap_m, rest_m),
            "suspect",
            restitution,
            0.005,
            ("rests where it hit",),
        )
        for restitution, gap_m, rest_m in ANOTHER_LEVEL
    },
}


@pytest.mark.parametrize("name", ROWS)
def test_what_is_made_of_a_log(name: str):
    row = ROWS[name]
    tuning = tune_episode(seen(row.heights), TuneOptions(start_s=row.start_s))
    assert tuning.verdict in ((row.verdict,) if row.verdict else ("ok", "suspect")), tuning.reason
    if tuning.verdict == "rejected":
        assert tuning.estimate is None
        assert has_remedy(known(tuning.reason))
    else:
        assert value(tuning) == pytest.approx(row.value, abs=row.within)
    said = " ".join([tuning.reason or "", *tuning.warnings])
    assert all(word in said for word in row.words), said


def test_samples_lost_with_their_stamps_cost_nothing():
    stamps, positions = Stranger(0.7, noise_m=0.0).samples()
    keep = np.random.default_rng(0).random(len(stamps)) > 0.1
    tuning = tune_episode(seen(positions[keep], stamps[keep]), TuneOptions())
    assert value(tuning) == pytest.approx(0.7, abs=0.001)


@pytest.mark.parametrize("jump_s", [3600, 86_400])
def test_a_clock_that_jumps_is_not_simulated_across(jump_s: int):
    good = seen(bounced()).signals[TOPIC]
    stamps = good.stamps_ns.copy()
    stamps[600:] += jump_s * 10**9
    tuning = tune_episode(seen(good.values, stamps), TuneOptions())
    assert value(tuning) == pytest.approx(0.7, abs=0.001)
    if jump_s == 86_400:
        assert any("after sample 600 of 840" in words for words in tuning.warnings)
        assert len(known(tuning.episode).signals[TOPIC].stamps_ns) == 600
    look = known(trace_of(tuning).steps[0].evaluation)
    assert len(look.episode.signals[TOPIC].stamps_ns) < 10_000
    with pytest.raises(UsageError, match="not within an hour"):
        DropRig(samples=2, times_s=(0.0, 86_400.0))


def test_a_log_without_the_ball_says_what_it_holds():
    tuning = tune_episode(seen(bounced()), TuneOptions(topic="/nope"))
    assert tuning.verdict == "rejected"
    assert TOPIC in (tuning.reason or "")
    tuning = tune_episode(Episode(EpisodeInfo(), {}), TuneOptions())
    assert tuning.verdict == "rejected"
    assert "a ball's position or with pictures" in (tuning.reason or "")


def test_a_cut_log_is_tuned_as_far_as_it_goes(drop_log: Path):
    drop_log.write_bytes(drop_log.read_bytes()[:-3000])
    tuning = tune_log(drop_log, TuneOptions())
    assert any("end of the file" in warning for warning in tuning.warnings)
    assert tuning.estimate is None or value(tuning) == pytest.approx(0.7, abs=0.001)


def test_samples_that_may_have_been_changed_make_a_tuning_suspect(tmp_path: Path):
    """A flipped bit in a log without chunks: only the checksum of all data tells."""
    source = record(tmp_path / "a.mcap", restitution=0.7, height_m=1.0)
    plain = tmp_path / "plain.mcap"
    without_chunks(source, plain)
    assert tune_log(plain, TuneOptions()).verdict == "ok"
    data = bytearray(plain.read_bytes())
    data[data.index(b"world", len(data) // 3)] ^= 1  # in a frame's name: no sample changes
    plain.write_bytes(bytes(data))
    tuning = tune_log(plain, TuneOptions())
    assert tuning.verdict == "suspect"
    assert "checksum" in (tuning.reason or "")


def test_of_several_bodies_the_one_that_bounces_as_a_ball_does():
    stamps, ball = Stranger(restitution=0.7).samples()
    tapped = ball.copy()
    tapped[:, 2] = 0.3 * np.abs(np.sin(np.pi * (stamps - stamps[0]) * 2e-9)) ** 0.8
    one = seen(tapped, stamps).signals[TOPIC]
    signals = {"A": replace(one, name="A"), "B": replace(one, name="B", values=ball)}
    alone = tune_episode(Episode(EpisodeInfo(), {"A": signals["A"]}), TuneOptions())
    assert alone.verdict != "ok"
    tuning = tune_episode(Episode(EpisodeInfo(), signals), TuneOptions())
    assert (tuning.verdict, tuning.detection.topic) == ("ok", "B")
    assert value(tuning) == pytest.approx(0.7, abs=0.003)


@pytest.mark.parametrize("restitution", [0.1, 0.4, 0.95])
@pytest.mark.parametrize(
    ("gap", "gravity"),
    [*((gap, GRAVITY) for gap in (0.3, 1.0, 5.0)), *((gap, 1.62) for gap in (0.5, 2.2))],
)
@pytest.mark.parametrize("rate", [60.0, 133.0, 1000.0])
def test_impact_and_height_are_found_to_a_fraction_of_a_sample_and_drop_out(
    restitution: float, gap: float, rate: float, gravity: float
):
    fall = np.sqrt(2 * gap / gravity)
    times = np.arange(int(10 * fall * rate)) / rate
    heights = bounce_heights(restitution, gap, times - 0.5, gravity)
    (drop,) = find_drops(times, heights + 0.37)
    assert drop.impact_s == pytest.approx(0.5 + fall, abs=1e-4)
    assert drop.contact_m == pytest.approx(0.37, abs=2e-4)
    assert drop.drop_height_m == pytest.approx(gap, rel=1e-3)
    assert drop.gravity_m_s2 == pytest.approx(gravity, rel=1e-6 if gravity > 9 else 1e-5)
    assert drop.release_s == pytest.approx(0.5, abs=2e-3)
    if gap > 0.3:  # of which 60 Hz see few samples
        exact = bounce_heights(restitution, 1.0, canonical_axis() + 1, gravity=2.0)
        assert np.abs(canonical(drop).values[:, 0] - exact).max() < 2e-3


def test_random_walks_never_break_it():
    rng = np.random.default_rng(1)
    for _ in range(200):
        count = int(rng.integers(10, 400))
        heights = np.cumsum(rng.normal(0, rng.uniform(0.001, 0.3), count))
        times = np.cumsum(rng.uniform(0.001, 0.03, count))
        with suppress(NotFoundError):
            find_drops(times, heights)


# ---- Units that a log names, does not name, or names wrongly; tracks of pixels that jump or repeat


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
    known = answer["parameters"]
    assert known["restitution"]["value"] == pytest.approx(E, abs=0.003)
    assert len(answer["bounces"]) > 2
    first = answer["bounces"][0]["impact_speed"]
    assert first == (pytest.approx(SPEED_M_S, rel=0.01) if speed else None)
    assert (known["drag"]["value"] is not None) == speed
    assert speed or known["drag"] == {"value": None, "interval95": None}


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
    ("log", "said"),
    [
        ({"size": 0.001}, "in mm"),
        ({"size": 0.0254}, "in in"),
        ({"size": 1 / 412}, "in pixels"),
        ({"clock": 1000.0}, "stamps are in ms"),
    ],
)
def test_metres_that_fall_otherwise_are_doubted(log: dict[str, float], said: str):
    answer = told(unit="m", **log)  # type: ignore[arg-type]
    assert answer["verdict"] == "suspect"
    assert said in answer["reason"]
    assert answer["parameters"]["restitution"]["value"] == pytest.approx(E, abs=0.003)
    assert "size" not in log or answer["bounces"][0]["impact_speed"] is None


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


def filmed() -> Signal:
    """A bouncing ball, a row a picture, in whole pixels, y down; held for ten pictures."""
    t = np.arange(100.0) - 10.3
    heights = bounce_heights(RESTITUTION, HEIGHT_PX, t, 2 * HEIGHT_PX / FALL**2)
    x = np.where(t < 0, 80.0, 80.0 + t)
    places = np.stack([x, 900 - heights, np.zeros_like(x)], axis=1).round()
    stamps = np.arange(100, dtype=np.int64) * 40_000_000
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


def write(path: Path, signal: Signal) -> Path:
    rows = np.column_stack([signal.stamps_ns * 1e-9, signal.values[:, :2]]).tolist()
    path.write_text("t,x,y\n" + "".join(f"{at:.6f},{x:.0f},{y:.0f}\n" for at, x, y in rows))
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
    assert without_jumps(often) is None
    for kept in (
        replace(filmed(), values=np.full((100, 3), 7.0)),
        replace(with_repeats(filmed(), 5), unit="m"),
    ):
        assert ball_alone(kept) is None
