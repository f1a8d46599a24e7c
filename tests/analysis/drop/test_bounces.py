"""Each bounce as it is reported: in the JSON, in words and in the review."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from tests.analysis.drop.test_review import contents, verified
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
from tunenet_logs.analysis.tuning import tune_log

RESTITUTIONS = (0.700, 0.712, 0.731)
SPEEDS = (4.43, 3.10, 2.21)


@pytest.fixture(scope="module")
def filmed(filmed_log: Path) -> Tuning:
    return tune_log(filmed_log, TuneOptions(method="tunenet"))


def drawn(path: Path, entity: str) -> list[str]:
    """The labels of an entity, over all its times."""
    labels: list[str] = []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if str(chunk.entity_path) == entity and "Points2D:labels" in batch.schema.names:
            for row in batch.column("Points2D:labels").to_pylist():
                labels += row or []
    return labels


def with_rebounds(tuning: Tuning, speeds: tuple[float | None, ...] = SPEEDS) -> Tuning:
    """A tuning whose refinement tells three bounces apart."""
    drop = tuning.detection.drop
    assert tuning.trace is not None
    values = tuning.trace.estimate
    ends = values[:, None] + np.array([-0.004, 0.004])
    flights = 2 * drop.fall_time_s * np.cumsum([0.0, 0.7, 0.7**2])
    rebounds = tuple(
        Rebound(float(at), one, (one - 0.01, one + 0.01), speed)
        for at, one, speed in zip(drop.impact_s + flights, RESTITUTIONS, speeds, strict=True)
    )
    fit = FitResult(values, ends, detail=rebounds)
    steps = (*tuning.trace.steps, tuning.trace.steps[-1])
    return replace(tuning, trace=replace(tuning.trace, steps=steps, fit=fit))


def words_of(tuning: Tuning) -> str:
    return result_words(record_of(tuning), tuning.preset, "drop")


def doubted(tuning: Tuning) -> Tuning:
    """The same with a check that failed: no interval is honest then."""
    first = replace(tuning.checks[0], passed=False)
    return replace(tuning, checks=(first, *tuning.checks[1:]), verdict="suspect", reason="a: b")


def test_the_json_has_every_bounce(filmed: Tuning):
    bounces = json.loads(to_json(record_of(with_rebounds(filmed))))["bounces"]
    assert [one["restitution"] for one in bounces] == list(RESTITUTIONS)
    assert [one["impact_speed"] for one in bounces] == list(SPEEDS)
    assert bounces[1]["interval95"] == pytest.approx([0.702, 0.722])
    assert {one["unit"] for one in bounces} == {"m/s"}


def test_no_bounce_has_an_interval_where_the_tuning_has_none(filmed: Tuning):
    tuning = doubted(with_rebounds(filmed, (None, None, None)))
    assert tuning.interval95 is None
    for one in json.loads(to_json(record_of(tuning)))["bounces"]:
        assert one["interval95"] is None
        assert one["impact_speed"] is None


def test_without_a_refinement_there_is_the_first(filmed: Tuning):
    (only,) = record_of(filmed).rebounds
    assert filmed.estimate is not None
    assert only.restitution == filmed.estimate[0]
    assert only.interval95 is None
    assert only.impact_speed_m_s == pytest.approx(np.sqrt(2 * 9.81), rel=0.03)
    assert record_of(replace(filmed, verdict="rejected")).rebounds == ()


def test_the_words_name_bounces_interval_and_cross_check(filmed: Tuning):
    words = words_of(with_rebounds(filmed))
    assert " | 0.7120 | 0.7020 to 0.7220 | 3.100 |" in words
    assert "| parameter | value | 95 % interval |" in words
    assert "A second estimate agrees: 0.7" in words
    unsure = words_of(doubted(with_rebounds(filmed, (None, None, None))))
    assert " | 0.7120 | - | not known |" in unsure
    assert "| parameter | value | 95 % interval (suspect) |" in unsure
    assert "| restitution | 0.7" in unsure
    assert " to " not in unsure.partition("| parameter |")[2].partition("second estimate")[0]


def test_the_chart_of_the_bounces_stays_on_any_timeline(filmed: Tuning, tmp_path: Path):
    write_review(with_rebounds(filmed), record_of(with_rebounds(filmed)), tmp_path / "a.rrd")
    verified(tmp_path / "a.rrd")
    entities = contents(tmp_path / "a.rrd")
    for name in ("bounces/values", "bounces/intervals", "convergence/interval"):
        assert entities[f"/sheets/{name}"] == {"static"}, name
    assert drawn(tmp_path / "a.rrd", "/sheets/bounces/figures") == [
        "0.700",
        "0.712",
    ]  # the third would overlap


def test_the_chart_shows_no_more_than_is_known(filmed: Tuning, tmp_path: Path):
    nowhere = rr.RecordingStream("tunenet test of bounces")
    named = log_bounces(nowhere, review_data(with_rebounds(filmed))).name
    assert named == "restitution by impact speed [m/s], bars: 95 %"
    tuning = doubted(with_rebounds(filmed, (None, None, None)))
    assert log_bounces(nowhere, review_data(tuning)).name == "restitution by bounce"
    write_review(tuning, record_of(tuning), tmp_path / "b.rrd")
    verified(tmp_path / "b.rrd")
    assert "/sheets/convergence/interval" not in contents(tmp_path / "b.rrd")
    assert drawn(tmp_path / "b.rrd", "/sheets/bounces/labels")[-3:] == ["1", "2", "3"]


def test_a_review_without_bounces_has_no_such_view(filmed: Tuning, tmp_path: Path):
    write_review(filmed, record_of(filmed), tmp_path / "a.rrd")
    assert not [one for one in contents(tmp_path / "a.rrd") if one.startswith("/sheets/bounces")]


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


def test_the_latest_bounce_is_named_over_the_video(filmed: Tuning, tmp_path: Path):
    write_review(with_rebounds(filmed), record_of(with_rebounds(filmed)), tmp_path / "a.rrd")
    entities = contents(tmp_path / "a.rrd")
    assert entities["/film/path"] == {"static"}
    assert entities["/film/impacts"] == {"static"}
    assert entities["/film/impact"] == {"static", "log_time_s"}
    names = drawn(tmp_path / "a.rrd", "/film/impact")
    assert names[:4] == ["bounce 1: 0.700", "bounce 2: 0.712", "bounce 3: 0.731", "bounce 4"]


def test_a_rejected_drop_is_shown_with_what_to_do_and_no_value(filmed: Tuning, tmp_path: Path):
    failed = ("first flight seen", "stays on the table")
    checks = tuple(
        replace(one, passed=False, fatal=True) if one.name in failed else one
        for one in filmed.checks
    )
    tuning = replace(filmed, checks=checks, verdict="rejected", reason="first flight seen: 0.1")
    write_review(tuning, record_of(tuning), tmp_path / "a.rrd")
    verified(tmp_path / "a.rrd")
    assert "/sheets/convergence/interval" not in contents(tmp_path / "a.rrd")
    words = words_of(tuning)
    first, second, *_ = words.split("- failed: ")[1:]
    assert words.startswith("# rejected")
    assert "| restitution" not in words.partition("| k |")[0]
    assert first.startswith("first flight seen: ")
    assert "at the next drop: record until the ball lies still" in first
    assert "at the next drop: drop onto the middle of a large" in second
