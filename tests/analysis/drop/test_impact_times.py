"""A ball that is heard: restitution from impact times alone, and what is no ball."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from tests.export_writers_video import phyphox_xlsx
from tunenet_logs.analysis.cli.tune import main
from tunenet_logs.analysis.drop.experiments import DropFromTimes
from tunenet_logs.analysis.drop.times.model import DropSetup, heard_ball
from tunenet_logs.analysis.evaluation.studies.impact_times import (
    NO_BALLS,
    counted_verdicts,
    figures_of,
    heard_set,
    scored_sets,
)
from tunenet_logs.analysis.experiment import Claim, Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.presentation import row_of, table
from tunenet_logs.analysis.record import record_from, to_json
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import FRAME_NS, Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.ball import Bounce
from tunenet_logs.recorders.simulators.known import ball_named

GRAVITY_M_S2 = 9.80665
HEIGHT_M, RESTITUTION, SLOPE, DRAG_1_M = 1.2, 0.78, 0.04, 0.02  # the ball of these tests


def episode_of(
    times_s: NDArray[Any], name: str = "All/impacts", *, frames: bool = False
) -> Episode:
    stamps_ns = np.round(np.asarray(times_s) * 1e9).astype(np.int64)
    values = np.ones((len(stamps_ns), 1))
    signal = Signal(name, stamps_ns, values, ("impact",), "1", counts_frames=frames)
    return Episode(EpisodeInfo(), {name: signal})


def impacts(count: int, seed: int = 0, jitter_s: float = 0.0005) -> Array:
    """Times of the first impacts of the ball, from the closed form."""
    ball = Bounce(RESTITUTION, SLOPE, DRAG_1_M * HEIGHT_M)
    starts, _ = ball.flights(10.0)
    rng = np.random.default_rng(seed)
    fall_s = np.sqrt(2 * HEIGHT_M / GRAVITY_M_S2)
    return 0.8 + starts[:count] * fall_s + rng.normal(0.0, jitter_s, count)


def at_second() -> float:
    """Restitution at the second impact."""
    ball = Bounce(RESTITUTION, SLOPE, DRAG_1_M * HEIGHT_M)
    _, speeds = ball.flights(10.0)
    second = ball.flight(float(speeds[0]))[1]
    return RESTITUTION * (second / ball.impact_speed) ** -SLOPE


def tuned(
    times_s: NDArray[Any], selection: TuneOptions | None = None, *, frames: bool = False
) -> Tuning:
    options = selection or TuneOptions()
    return tune_episode(episode_of(times_s, frames=frames), options, Path("stopwatch.csv"))


def test_a_clean_sequence_tells_the_restitution_of_the_second_impact():
    tuning = tuned(impacts(9))
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.estimate is not None
    assert tuning.interval95 is not None
    assert tuning.estimate[0] == pytest.approx(at_second(), abs=0.01)
    low, high = tuning.interval95[0]
    assert low < at_second() < high
    assert (tuning.method, tuning.rollouts) == ("fit", 2)
    rebounds = record_of(tuning).rebounds
    assert len(rebounds) == 7  # all but the first and the last
    assert rebounds[0].impact_speed_m_s == pytest.approx(3.7, abs=0.1)


@pytest.mark.parametrize("restitution", [0.6, 0.9])
def test_a_ball_of_one_restitution_is_not_doubted_for_its_slope(restitution: float):
    """The interval of its slope holds 0, at one end: what air may hide lies at the other."""
    starts, _ = Bounce(restitution, 0.0, 0.0).flights(10.0)
    tuning = tuned(0.8 + 0.45 * starts[:7])
    assert tuning.verdict == "ok", tuning.reason


def test_a_known_height_tells_the_first_impact_too():
    tuning = tuned(impacts(9), TuneOptions(height_m=HEIGHT_M))
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.estimate is not None
    assert tuning.interval95 is not None
    low, high = tuning.interval95[0]
    assert low < RESTITUTION < high < low + 0.03
    first = record_of(tuning).rebounds[0]
    assert first.impact_s == pytest.approx(0.0, abs=0.002)
    assert first.impact_speed_m_s == pytest.approx(4.75, abs=0.05)


def test_a_known_ball_makes_it_surer():
    usual, known = (
        tuned(impacts(9), TuneOptions(ball=ball)).interval95
        for ball in (TuneOptions().ball, ball_named("squash"))
    )
    assert usual is not None
    assert known is not None
    assert np.ptp(known[0]) < np.ptp(usual[0])


@pytest.mark.parametrize(
    ("missed", "noises_s"),
    [
        *(([one], []) for one in (2, 3, 5)),
        *(([], [one]) for one in (1.1, 1.9, 2.6)),
        ([3, 6], [1.3, 2.05]),
    ],
)
def test_missed_impacts_and_noises_are_found(missed: list[int], noises_s: list[float]):
    count = 10 if len(missed) == 2 else 9
    times_s = np.sort(np.append(np.delete(impacts(count), missed), noises_s))
    ball = heard_ball(times_s, DropSetup())
    assert ball is not None
    assert (ball.reading.missed, ball.reading.false) == (len(missed), len(noises_s))
    assert ball.numbers.tolist() == [one for one in range(count) if one not in missed]
    assert not set(noises_s) & set(ball.times_s.tolist())
    assert ball.values[0] == pytest.approx(at_second(), abs=0.015)
    if len(missed) == 1:
        assert tuned(times_s).verdict == "ok"


def test_an_unknown_clock_tells_the_restitution_and_no_speed():
    frames = np.round(impacts(9) * 1000) * FRAME_NS * 1e-9  # of a camera with 1000 a second
    tuning = tuned(frames, TuneOptions(height_m=HEIGHT_M), frames=True)
    assert tuning.estimate is not None
    assert tuning.estimate[0] == pytest.approx(at_second(), abs=0.012)
    record = record_of(tuning)
    assert {bounce.impact_speed_m_s for bounce in record.rebounds} == {None}
    assert any("--height not used" in warning for warning in record.warnings)


def _not_balls() -> dict[str, NDArray[Any]]:
    rng = np.random.default_rng(5)
    return {
        "clapping": np.cumsum(0.4 + rng.normal(0, 0.002, 12)),
        "a hand's clapping": np.cumsum(0.4 + rng.normal(0, 0.02, 12)),
        "increasing": np.cumsum(0.2 * 1.12 ** np.arange(12)),
        "linear": np.cumsum(0.6 - 0.3 * np.arange(12) / 12),
        "linear, faster": np.cumsum(np.linspace(0.6, 0.2, 9)),
        "three": np.array([0.0, 0.5, 0.9]),
        "two": np.array([0.0, 0.5]),
        "a metronome": 0.5 * np.arange(40.0),
        "no ball keeps so much": np.cumsum(0.5 * 0.97 ** np.arange(12)),
        **{
            f"random {seed}": np.cumsum(
                np.random.default_rng([seed, 77]).exponential(0.4, 5 + seed)
            )
            for seed in range(5)
        },
    }


SAID = {
    "linear, faster": ("rejected", "a ball rather than a rhythm", "beats that shorten by one"),
    "no ball keeps so much": ("suspect", "flights shorten as a ball's"),
    "two": ("rejected", "2 impact times, too few for two whole flights"),
}


@pytest.mark.parametrize("name", _not_balls())
def test_what_is_no_ball_is_never_ok(name: str):
    tuning = tuned(_not_balls()[name])
    assert tuning.verdict != "ok"
    verdict, *words = SAID.get(name, (tuning.verdict,))
    assert tuning.verdict == verdict
    assert all(word in (tuning.reason or "") for word in words)


@pytest.mark.parametrize(
    ("times_s", "verdict"),
    [
        (np.cumsum([0.0, 0.2040, 0.1715, 0.4236, 0.1193]), "rejected"),
        (np.sort(np.append(impacts(9), 1.9)), "ok"),
    ],
)
def test_a_phone_s_sheet_with_a_false_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], times_s: NDArray[Any], verdict: str
):
    pytest.importorskip("python_calamine")
    phyphox_xlsx(tmp_path / "phone.xlsx", (times_s - times_s[0]).tolist())
    code = main([str(tmp_path / "phone.xlsx"), "--jobs", "1", "--quiet"])
    assert code == int(verdict == "rejected")
    head, line, *_ = capsys.readouterr().out.splitlines()
    assert verdict in line
    assert re.search(r" \d impacts ", line)  # and no height
    assert "drop" in head
    assert "fall" not in head
    assert " m " not in line
    assert (tmp_path / "phone.rrd").stat().st_size > 10_000
    chunks = list(RrdReader(tmp_path / "phone.rrd").stream())
    assert any(chunk.timeline_names for chunk in chunks)


def test_a_hundred_thousand_times_are_bounded():
    times_s = np.append(impacts(10), 20 + 0.01 * np.arange(100_000))
    tuning = tuned(times_s)
    assert tuning.seconds["total"] < 20
    assert any("the first 60 of 100010 times" in warning for warning in tuning.warnings)


def test_the_signal_with_the_most_times_is_used_unless_one_is_named():
    times_s = impacts(9)
    few, many = episode_of(times_s[:4], "Simple/impacts"), episode_of(times_s)
    episode, way = Episode(EpisodeInfo(), {**few.signals, **many.signals}), DropFromTimes()
    assert way.claim(episode, None) == Claim.CERTAIN
    assert way.detect(episode, TuneOptions(), "default").topic == "All/impacts"
    named = way.detect(episode, TuneOptions(topic="Simple/impacts"), "default")
    assert len(named.times_s) == 4
    with pytest.raises(NotFoundError, match="there are: All/impacts, Simple/impacts"):
        way.detect(episode, TuneOptions(topic="Sound"), "default")
    stamps_ns = np.arange(10) * 10_000_000
    positions = Signal("/ball", stamps_ns, np.zeros((10, 3)), ("x", "y", "z"), "m")
    seen = Episode(EpisodeInfo(), {**many.signals, "/ball": positions})
    assert way.claim(seen, None) == Claim.POSSIBLE  # positions come first


def test_record_table_and_review(tmp_path: Path):
    from tunenet_logs.analysis.review.tuning import write_review

    tuning = tuned(np.sort(np.append(np.delete(impacts(9), 4), 1.3)))
    record = record_of(tuning)
    again = record_from(json.loads(to_json(record)))
    assert again.estimates == record.estimates
    curves = again.motion.curves
    assert curves is not None
    seen = curves.observed_m[np.isfinite(curves.observed_m)]
    assert seen.tolist() == [0.0] * 7  # each impact after the first that the rollout shows
    assert "impacts" in table([row_of(tuning, record)])
    write_review(tuning, record, tmp_path / "times.rrd")
    assert (tmp_path / "times.rrd").stat().st_size > 10_000


def test_made_up_balls_share_no_code_and_agree():
    """A Runge-Kutta ball without jitter is the closed form's."""
    rng = np.random.default_rng(2)
    heard = next(one for one in (heard_set(rng, 0) for _ in range(50)) if len(one.times_s) > 8)
    ball = heard_ball(heard.times_s, DropSetup())
    assert ball is not None
    assert abs(ball.values[0] - heard.restitution) < 5 * heard.bound


@pytest.mark.slow
def test_verdicts_on_balls_and_on_what_is_none():
    found = {row["label"]: row for row in counted_verdicts((5, 12, 48))}
    assert sum(found[name]["ok"] for name in NO_BALLS) <= 2
    many = found["balls, 6 or more"]
    assert many["ok"] > 0.65 * many["sets"]


@pytest.mark.slow
def test_errors_and_intervals():
    every = figures_of("all", scored_sets((5, 150, False)))
    assert every["told"] == every["sets"]
    assert every["mae"] < 1.4 * every["bound"]
    assert every["covered"] > 0.92
