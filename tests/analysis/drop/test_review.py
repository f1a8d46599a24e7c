"""A review of a drop: whole, with its own blueprint, and with each bounce as the JSON has it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from tests.analysis.answers import known, trace_of, value
from tests.analysis.films import film_of
from tests.analysis.review.stored import Stored, verified
from tests.conftest import record
from tests.engines import needs_pybullet
from tests.strangers import Stranger, write_poses
from tunenet_logs.analysis.drop.review.views import (
    film_positions,
    log_bounces,
    model_path,
    review_data,
)
from tunenet_logs.analysis.estimators.base import FitResult
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.presentation import result_words
from tunenet_logs.analysis.record import Rebound, to_json
from tunenet_logs.analysis.review.tuning import write_review
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import DropOrder, simulate_drop
from tunenet_logs.recorders.simulators.ball import DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import CALIBRATED

TIMED = {"static", "log_time_s"}  # with what never changes: colours, sizes


def contents(path: Path) -> dict[str, set[str]]:
    """Timelines of each entity; "static" where it has no time."""
    found: dict[str, set[str]] = {}
    for chunk in RrdReader(path).stream():
        times = set(chunk.timeline_names) if not chunk.is_static else {"static"}
        found.setdefault(str(chunk.entity_path), set()).update(times)
    return found


def said(path: Path, entity: str, component: str) -> list[Any]:
    """All that a component of an entity ever holds."""
    found = Stored(path).entities[entity][component]
    cells = [*found.static, *(cell for _, timed in found.timed.values() for cell in timed)]
    return [one for cell in cells if cell.is_valid for one in cell.as_py()]


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> Tuning:
    path = tmp_path_factory.mktemp("drop") / "drop.mcap"
    return tune_log(record(path, restitution=0.7, height_m=1.0), TuneOptions())


@pytest.fixture(scope="module")
def filmed(filmed_log: Path) -> Tuning:
    return tune_log(filmed_log, TuneOptions(method="tunenet"))


def reviewed(tuning: Tuning, folder: Path) -> Path:
    """A review that Rerun itself finds whole."""
    path = folder / "a.rrd"
    write_review(tuning, record_of(tuning), path)
    verified(path)
    return path


def test_iterations_can_be_scrubbed_and_lie_on_the_logs_time(tuned: Tuning, tmp_path: Path):
    review = reviewed(tuned, tmp_path)
    entities = contents(review)
    assert all(entities[f"/{view}/k{k}"] == TIMED for k in range(6) for view in ("height", "scene"))
    assert entities["/sheets/heights/simulated"] >= {"iteration"}
    assert said(review, "/result", "TextDocument:text")[0].startswith("# ok")
    limits = said(review, "/residual/limit", "Scalars:scalars")
    assert limits == pytest.approx([5.0, -5.0] * 2, abs=0.1)


@needs_pybullet
@pytest.mark.parametrize("preset", ["paper", "paper-code"])
def test_the_papers_presets_have_a_review_too(tmp_path: Path, preset: Any):
    order = DropOrder(preset="paper", restitution=0.55, height_m=4.0)
    tuning = tune_episode(simulate_drop(order), TuneOptions(preset=preset))
    reviewed(tuning, tmp_path)
    if preset == "paper-code":  # its rollouts lie over the observed curve
        data = review_data(tuning)
        off = data.residuals[-1].heights_m
        falling = data.observed.seconds < data.impacts_s[0]
        assert np.abs(off[falling]).max() < 0.05
        assert np.sqrt(np.mean(off**2)) < 0.1


@pytest.mark.parametrize(
    ("topic", "shown"),
    [
        ("/ball/pose", "/recorded/ball/pose/z"),
        ("/../we ird/тема//[x]{y}/\x07", ""),
        ("/bäll pose/\x1b[31mx//y", r"/recorded/bäll\ pose/\u{001B}\[31mx/y/z"),
    ],
)
def test_a_rejected_log_shows_what_was_recorded_whatever_it_is_called(
    tmp_path: Path, capfd: pytest.CaptureFixture, topic: str, shown: str
):
    stamps, positions = Stranger(0.0).samples()
    stamps, positions = stamps[:60], positions[:60]  # nothing falls yet
    write_poses(tmp_path / "a.mcap", stamps, positions, topic=topic)
    path = reviewed(tune_log(tmp_path / "a.mcap", TuneOptions()), tmp_path)
    assert capfd.readouterr() == ("", "")
    assert not shown or shown in contents(path)


def test_of_thousands_of_signals_the_first_are_drawn(tmp_path: Path):
    point = np.array([[0.0, 0.0, 1.0]])
    many = {
        f"/ch{number}": Signal(f"/ch{number}", np.array([1]), point, ("x", "y", "z"), "m")
        for number in range(400)
    }
    path = reviewed(tune_episode(Episode(EpisodeInfo(), many), TuneOptions()), tmp_path)
    assert len([one for one in contents(path) if one.startswith("/recorded/")]) == 150
    assert "1050 more curves are not drawn" in said(path, "/result", "TextDocument:text")[0]


def test_the_simulated_curve_of_the_result_lies_on_the_observed_one(tuned: Tuning):
    assert np.abs(review_data(tuned).residuals[-1].heights_m).max() < 1e-3


def test_the_result_between_the_samples_is_the_rollouts_ball():
    truth = {"restitution": 0.8, "restitution_slope": 0.08, "drag": 0.1}
    rig = DropRig(gap_m=1.5, rate_hz=120.0, samples=400, hold_s=0.2)
    data = review_data(tune_episode(DropSimulator(rig, CALIBRATED).rollout(truth), TuneOptions()))
    curve, ball = data.simulated[-1], known(data.ball)
    off = ball.heights(curve.seconds) - curve.heights_m / data.drop_height_m
    assert np.abs(off).max() < 2e-4
    assert len(data.impacts_s) > 4
    seen = np.interp(data.impacts_s, data.observed.seconds, data.observed.heights_m)
    assert np.abs(seen).max() < 0.04  # no ideal ball's: after five bounces that is elsewhere


# ---- A film


def test_a_film_lies_under_its_balls_on_the_logs_time(filmed: Tuning, tmp_path: Path):
    path = reviewed(filmed, tmp_path)
    entities = contents(path)
    assert all(entities[f"/film/{place}"] == TIMED for place in ("picture", "observed", "k5"))
    pictures = [frame.data for frame in known(filmed.episode).frames()]
    assert path.stat().st_size > 0.9 * sum(map(len, pictures))


def test_the_simulated_balls_are_projected_onto_the_observed_one(filmed_log: Path):
    tuning = tune_log(filmed_log, TuneOptions())
    film, data = tuning.detection.film, review_data(tuning)
    observed = film.track.places_px[film.used]
    late = film.drop.seconds > data.impacts_s[0] + 0.1

    def rms_px(k: int) -> float:
        curve = data.simulated[k]
        heights = np.interp(film.drop.seconds, curve.seconds, curve.heights_m) / data.drop_height_m
        off = film_positions(film, film.drop.seconds, heights) - observed
        return float(np.sqrt(np.mean(off[late] ** 2)))

    assert rms_px(-1) < 0.5
    assert rms_px(0) > 5


def test_a_film_that_hardly_hit_shows_what_was_tracked(filmed_log: Path, tmp_path: Path):
    frames = list(read_episode(filmed_log).frames())
    tuning = tune_episode(film_of(frames[:52]), TuneOptions())
    assert tuning.verdict == "rejected"
    entities = contents(reviewed(tuning, tmp_path))
    assert entities["/film/picture"] >= {"log_time_s"}
    assert entities["/film/observed"] == entities["/height/observed"] == TIMED


def test_the_results_path_goes_where_the_ball_was_seen(filmed: Tuning):
    data, film = review_data(filmed), filmed.detection.film
    path = model_path(film, data) - 0.5
    seen = film.track.places_px[film.used]
    away = np.linalg.norm(seen[:, None] - path[None], axis=2).min(axis=1)
    assert np.quantile(away, 0.95) < 1.5
    contact = film_positions(film, data.impacts_s, np.zeros(len(data.impacts_s)), data.impacts_s)
    lowest = float((seen @ film.down_px).max())
    assert np.abs(contact @ film.down_px - lowest).max() < 2
    assert np.linalg.norm(contact[0] - path, axis=1).min() < 0.1


def test_impacts_are_marked_where_the_ball_hits(filmed: Tuning):
    fall_s = np.sqrt(2 / 9.80665)
    truth = 0.3 + fall_s + 2 * fall_s * np.cumsum([0.0, 0.7, 0.7**2])
    found = review_data(filmed).impacts_s
    assert found[:3] - found[0] == pytest.approx(truth - truth[0], abs=0.01)
    assert found[0] == pytest.approx(truth[0], abs=0.02)
    assert len(found) < 10  # those after are too low to be told apart


# ---- Each bounce


RESTITUTIONS, SPEEDS = (0.700, 0.712, 0.731), (4.43, 3.10, 2.21)


def with_rebounds(tuning: Tuning, *, is_doubted: bool = False) -> Tuning:
    """A tuning whose refinement tells three bounces apart; with a check that failed, no speed."""
    drop = tuning.detection.drop
    trace = trace_of(tuning)
    values = trace.estimate
    ends = values[:, None] + np.array([-0.004, 0.004])
    flights = 2 * drop.fall_time_s * np.cumsum([0.0, 0.7, 0.7**2])
    speeds = (None, None, None) if is_doubted else SPEEDS
    rebounds = tuple(
        Rebound(float(at), one, (one - 0.01, one + 0.01), speed)
        for at, one, speed in zip(drop.impact_s + flights, RESTITUTIONS, speeds, strict=True)
    )
    fit = FitResult(values, ends, detail=rebounds)
    told = replace(tuning, trace=replace(trace, steps=(*trace.steps, trace.steps[-1]), fit=fit))
    if not is_doubted:
        return told
    first = replace(tuning.checks[0], passed=False)
    return replace(told, checks=(first, *tuning.checks[1:]), verdict="suspect", reason="a: b")


def words_of(tuning: Tuning) -> str:
    return result_words(record_of(tuning), tuning.preset, "drop")


def test_json_and_words_have_every_bounce(filmed: Tuning):
    known = with_rebounds(filmed)
    bounces = json.loads(to_json(record_of(known)))["bounces"]
    assert [one["restitution"] for one in bounces] == list(RESTITUTIONS)
    assert [one["impact_speed"] for one in bounces] == list(SPEEDS)
    assert bounces[1]["interval95"] == pytest.approx([0.702, 0.722])
    assert {one["unit"] for one in bounces} == {"m/s"}
    words = words_of(known)
    assert " | 0.7120 | 0.7020 to 0.7220 | 3.100 |" in words
    assert "| parameter | value | 95 % interval |" in words
    assert "A second estimate is within what such logs allow: 0.7" in words


def test_of_a_doubted_drop_no_interval_is_told(filmed: Tuning):
    tuning = with_rebounds(filmed, is_doubted=True)
    assert tuning.interval95 is None
    for one in json.loads(to_json(record_of(tuning)))["bounces"]:
        assert one["interval95"] is one["impact_speed"] is None
    words = words_of(tuning)
    assert " | 0.7120 | - | not known |" in words
    assert "| parameter | value | 95 % interval (suspect) |" in words
    assert "| restitution | 0.7" in words
    assert " to " not in words.partition("| parameter |")[2].partition("second estimate")[0]


def test_without_a_refinement_there_is_the_first(filmed: Tuning):
    (only,) = record_of(filmed).rebounds
    assert only.restitution == value(filmed)
    assert only.interval95 is None
    assert only.impact_speed_m_s == pytest.approx(np.sqrt(2 * 9.81), rel=0.03)
    assert record_of(replace(filmed, verdict="rejected")).rebounds == ()


def test_the_bounces_have_a_chart_that_shows_no_more_than_is_known(filmed: Tuning, tmp_path: Path):
    path = reviewed(with_rebounds(filmed), tmp_path)
    # The third figure would overlap.
    assert said(path, "/sheets/bounces/figures", "Points2D:labels") == ["0.700", "0.712"]
    names = ["bounce 1: 0.700", "bounce 2: 0.712", "bounce 3: 0.731", "bounce 4"]
    assert said(path, "/film/impact", "Points2D:labels")[:4] == names
    nowhere = rr.RecordingStream("tunenet test of bounces")
    named = log_bounces(nowhere, review_data(with_rebounds(filmed))).name
    assert named == "restitution by impact speed [m/s], bars: 95 %"
    doubted = with_rebounds(filmed, is_doubted=True)
    assert log_bounces(nowhere, review_data(doubted)).name == "restitution by bounce"
    path = reviewed(doubted, tmp_path)
    assert "/sheets/convergence/interval" not in contents(path)
    assert said(path, "/sheets/bounces/labels", "Points2D:labels")[-3:] == ["1", "2", "3"]


def test_a_rejected_drop_is_shown_with_what_to_do_and_no_value(filmed: Tuning, tmp_path: Path):
    failed = ("first flight seen", "stays on the table")
    checks = tuple(
        replace(one, passed=False, fatal=True) if one.name in failed else one
        for one in filmed.checks
    )
    tuning = replace(filmed, checks=checks, verdict="rejected", reason="first flight seen: 0.1")
    assert "/sheets/convergence/interval" not in contents(reviewed(tuning, tmp_path))
    words = words_of(tuning)
    first, second, *_ = words.split("- failed: ")[1:]
    assert words.startswith("# rejected")
    assert "| restitution" not in words.partition("| k |")[0]
    assert first.startswith("first flight seen: ")
    assert "at the next drop: record until the ball lies still" in first
    assert "at the next drop: drop onto the middle of a large" in second
