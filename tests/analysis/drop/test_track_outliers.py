"""Tracks of pixels with jumps to other things, and of films that hold pictures twice."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.analysis.drop import motion as problem
from tunenet_logs.analysis.drop.track import ball_alone, without_jumps, without_repeats
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import Signal

# Of a drop that is filmed from the side; FALL in pictures.
HEIGHT_PX, RESTITUTION, FALL = 600.0, 0.8, 11.0


def filmed(pictures: int = 100, hold: int = 10) -> Signal:
    """A bouncing ball, a row a picture, in whole pixels, y down."""
    t = np.arange(pictures, dtype=float) - hold - 0.3
    heights = np.where(t < 0, HEIGHT_PX, HEIGHT_PX * (1 - (t / FALL) ** 2))
    start, bounce = FALL, 1
    while start < t[-1]:
        lasts = 2 * FALL * RESTITUTION**bounce
        here = (t >= start) & (t < start + lasts)
        at = t[here] - start
        heights[here] = HEIGHT_PX / FALL**2 * at * (lasts - at)
        start, bounce = start + lasts, bounce + 1
        if lasts < 1:
            heights[t >= start] = 0.0
            break
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
    picture = stamps * (every - 1) // every
    values = signal.values[picture]
    return replace(signal, stamps_ns=stamps.astype(np.int64) * 40_000_000, values=values)


def write(path: Path, signal: Signal, names: str = "t,x,y", digits: int = 0) -> Path:
    rows = [
        f"{at * 1e-9:.6f},{x:.{digits}f},{y:.{digits}f}\n"
        for at, (x, y, _) in zip(signal.stamps_ns.tolist(), signal.values.tolist(), strict=True)
    ]
    path.write_text(names + "\n" + "".join(rows))
    return path


RUNS = (range(30, 31), range(40, 44), range(47, 48))


def test_jumps_away_and_back_are_left_out():
    kept = without_jumps(with_jumps(filmed(), *RUNS))
    assert kept is not None
    left = set(range(100)) - set((kept.stamps_ns // 40_000_000).tolist())
    assert left == {at for run in RUNS for at in run}


@pytest.mark.parametrize("pictures", [5, 14, 60, 100])
def test_nothing_of_a_clean_drop_is_left_out(pictures: int):
    assert ball_alone(filmed(pictures)) is None


def test_what_is_elsewhere_too_often_is_kept():
    runs = [range(at, at + 3) for at in range(20, 90, 7)]
    assert without_jumps(with_jumps(filmed(), *runs)) is None


def test_nothing_is_left_out_of_samples_at_rest():
    still = filmed()
    assert ball_alone(replace(still, values=np.full((100, 3), 7.0))) is None
    assert without_repeats(filmed(12)) is None


@pytest.mark.parametrize("every", [3, 5, 6, 10])
def test_regular_repeats_are_left_out_and_the_others_stand_evenly(every: int):
    seen = with_repeats(filmed(), every)
    kept = without_repeats(seen)
    assert kept is not None
    steps = np.diff(kept.stamps_ns)[:-2]
    assert np.ptp(steps) < 1000
    assert steps[0] == pytest.approx(40_000_000 * every / (every - 1), rel=1e-6)
    assert len(kept.values) <= 101


def test_single_repeats_are_left_out_and_no_stamp_is_moved():
    whole = filmed()
    values = whole.values.copy()
    values[[26, 50]] = values[[25, 49]]
    kept = without_repeats(replace(whole, values=values))
    assert kept is not None
    assert sorted(set(whole.stamps_ns) - set(kept.stamps_ns)) == [1_040_000_000, 2_000_000_000]


def test_stamps_that_are_no_films_are_not_moved():
    """With a gap of years, or two stamps in one place, the repeats are left out alone."""
    seen = with_repeats(filmed(), 5)
    for at, by_ns in ((-1, 10**18), (60, -39_999_000)):
        stamps = seen.stamps_ns.copy()
        stamps[at] += by_ns
        kept = without_repeats(replace(seen, stamps_ns=stamps))
        assert kept is not None
        assert set(kept.stamps_ns.tolist()) <= set(stamps.tolist())


def test_named_metres_keep_their_repeats():
    seen = with_repeats(filmed(), 5)
    assert ball_alone(replace(seen, unit="m", values=seen.values * 1e-3)) is None


def test_a_track_with_jumps_is_tuned_like_the_clean_one(tmp_path: Path):
    clean = tune_log(write(tmp_path / "clean.csv", filmed()), TuneOptions())
    jumping = with_jumps(filmed(), *RUNS)
    dirty = tune_log(write(tmp_path / "jumps.csv", jumping), TuneOptions())
    twice = tune_log(write(tmp_path / "twice.csv", with_repeats(jumping, 5)), TuneOptions())
    for tuning in (clean, dirty, twice):
        estimate = record_of(tuning).estimates[0].value
        assert estimate == pytest.approx(RESTITUTION, abs=0.01)
    assert "6 samples of track jump away and back: they were left out" in dirty.warnings
    assert any("there twice in track" in words for words in twice.warnings)
    assert dirty.detection.outliers == 6


def test_a_fall_of_miles_is_told_in_metres_only_where_there_are_any(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pixels = filmed()
    stamps = np.arange(100, dtype=np.int64) * 31_795_000  # 0.6 m in 11 of them
    metres = replace(pixels, stamps_ns=stamps, values=(900 - pixels.values) * 1e-3)
    told = write(tmp_path / "m.csv", metres, "t_s,x_m,y_m", 3)
    unidentifiable = write(tmp_path / "px.csv", pixels)
    monkeypatch.setattr(problem, "_HIGHEST_SIMULATED_M", 0.0)
    monkeypatch.setattr(problem, "HIGHEST_M", 0.0)
    reason = record_of(tune_log(unidentifiable, TuneOptions())).reason
    assert reason is not None
    assert reason.startswith("no fall of a ball is seen in it")
    reason = record_of(tune_log(told, TuneOptions())).reason
    assert reason is not None
    assert "are the lengths in mm or cm?" in reason
