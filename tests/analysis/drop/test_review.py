"""A review of a drop: whole, with its own blueprint, and with each bounce as the JSON has it."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from tests.conftest import BIN, record
from tests.engines import needs_pybullet
from tests.strangers import Stranger, write_poses
from tunenet_logs.analysis.drop.review.views import (
    film_positions,
    log_bounces,
    model_path,
    review_data,
    values_words,
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
from tunenet_logs.writing.writer import EpisodeWriter


def verified(path: Path) -> None:
    words = [BIN / "rerun", "rrd", "verify", path]
    result = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert result.returncode == 0, result.stderr


def contents(path: Path) -> dict[str, set[str]]:
    """Timelines of each entity; "static" where it has no time."""
    found: dict[str, set[str]] = {}
    for chunk in RrdReader(path).stream():
        times = set(chunk.timeline_names) if not chunk.is_static else {"static"}
        found.setdefault(str(chunk.entity_path), set()).update(times)
    return found


def text(path: Path, entity: str) -> str:
    """Of a text document that is static."""
    for chunk in RrdReader(path).stream():
        if str(chunk.entity_path) == entity:
            ((words,),) = chunk.to_record_batch().column("TextDocument:text").to_pylist()
            return words
    return ""


def drawn(path: Path, entity: str) -> list[str]:
    """The labels of an entity, over all its times."""
    labels: list[str] = []
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        if str(chunk.entity_path) == entity and "Points2D:labels" in batch.schema.names:
            for row in batch.column("Points2D:labels").to_pylist():
                labels += row or []
    return labels


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


@pytest.fixture(scope="module")
def review(tuned: Tuning, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return reviewed(tuned, tmp_path_factory.mktemp("review"))


def test_every_iteration_lies_on_the_logs_time_and_can_be_scrubbed(review: Path):
    entities = contents(review)
    places = [f"/{view}/k{k}" for k in range(6) for view in ("height", "residual", "scene")]
    for place in (*places, "/height/observed", "/scene/observed"):
        assert entities[place] == {"static", "log_time_s"}, place
    for place in ("/result", "/verdict", "/sheets/heights/observed", "/sheets/convergence/values"):
        assert entities[place] == {"static"}, place
    for place in ("/sheets/heights/simulated", "/step"):
        assert entities[place] >= {"iteration"}, place
    assert text(review, "/result").startswith("# ok")
    limits = [
        chunk.to_record_batch().column("Scalars:scalars").to_pylist()
        for chunk in RrdReader(review).stream()
        if str(chunk.entity_path) == "/residual/limit" and not chunk.is_static
    ]
    assert limits == [[[pytest.approx(5.0, abs=0.1), pytest.approx(-5.0, abs=0.1)]] * 2]


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


def test_a_rejected_log_shows_what_was_recorded(tmp_path: Path):
    tuning = tune_episode(simulate_drop(DropOrder(restitution=0.0, height_m=1.0)), TuneOptions())
    assert "/recorded/ball/pose/z" in contents(reviewed(tuning, tmp_path))


@pytest.mark.parametrize(
    ("topic", "shown"),
    [
        ("/../we ird/тема//[x]{y}/\x07", ""),
        ("/bäll pose/\x1b[31mx//y", r"/recorded/bäll\ pose/\u{001B}\[31mx/y/z"),
    ],
)
def test_names_of_a_stranger_are_parts_of_a_path(
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
    assert "1050 more curves are not drawn" in text(path, "/result")


def test_a_place_that_cannot_be_written_raises(tuned: Tuning):
    with pytest.raises(OSError, match="proc"):
        write_review(tuned, record_of(tuned), Path("/proc/nowhere/a.rrd"))


def test_the_simulated_curve_of_the_result_lies_on_the_observed_one(tuned: Tuning):
    off = review_data(tuned).residuals[-1].heights_m
    assert np.abs(off).max() < 1e-3


def test_a_film_lies_under_its_balls_on_the_logs_time(filmed: Tuning, tmp_path: Path):
    path = reviewed(filmed, tmp_path)
    entities = contents(path)
    for place in ("picture", "observed", "trail", *(f"k{k}" for k in range(6))):
        assert entities[f"/film/{place}"] == {"static", "log_time_s"}, place
    pictures = [frame.data for frame in filmed.episode.frames()]  # type: ignore[union-attr]
    assert path.stat().st_size > 0.9 * sum(map(len, pictures))
    assert not [one for one in entities if one.startswith("/sheets/bounces")]  # none was refined


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


def test_the_result_between_the_samples_is_the_rollouts_ball():
    truth = {"restitution": 0.8, "restitution_slope": 0.08, "drag": 0.1}
    rig = DropRig(gap_m=1.5, rate_hz=120.0, samples=400, hold_s=0.2)
    data = review_data(tune_episode(DropSimulator(rig, CALIBRATED).rollout(truth), TuneOptions()))
    curve, ball = data.simulated[-1], data.ball
    assert ball is not None
    off = ball.heights(curve.seconds) - curve.heights_m / data.drop_height_m
    assert np.abs(off).max() < 2e-4
    assert len(data.impacts_s) > 4
    seen = np.interp(data.impacts_s, data.observed.seconds, data.observed.heights_m)
    assert np.abs(seen).max() < 0.04  # no ideal ball's: after five bounces that is elsewhere


@pytest.mark.parametrize("count", [15, 52], ids=["before it falls", "when it has hardly hit"])
def test_a_film_without_a_drop_shows_what_was_tracked(filmed_log: Path, tmp_path: Path, count: int):
    frames = list(read_episode(filmed_log).frames())
    with EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo(), live=False) as writer:
        for frame in frames[:count]:
            writer.write_frame("/camera", frame)
    tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert tuning.verdict == "rejected"
    entities = contents(reviewed(tuning, tmp_path))
    assert entities["/film/picture"] >= {"log_time_s"}
    if count == 52:
        assert tuning.refused is not None
        for place in ("/film/observed", "/height/observed"):
            assert entities[place] == {"static", "log_time_s"}, place
        assert entities["/film/track"] == {"static"}


RESTITUTIONS = (0.700, 0.712, 0.731)
SPEEDS = (4.43, 3.10, 2.21)


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


def test_the_bounces_have_a_chart_and_the_latest_is_named_over_the_video(
    filmed: Tuning, tmp_path: Path
):
    path = reviewed(with_rebounds(filmed), tmp_path)
    entities = contents(path)
    for name in (
        "sheets/bounces/values",
        "sheets/bounces/intervals",
        "sheets/convergence/interval",
    ):
        assert entities[f"/{name}"] == {"static"}, name
    # The third figure would overlap.
    assert drawn(path, "/sheets/bounces/figures") == ["0.700", "0.712"]
    assert entities["/film/path"] == entities["/film/impacts"] == {"static"}
    assert entities["/film/impact"] == {"static", "log_time_s"}
    names = drawn(path, "/film/impact")
    assert names[:4] == ["bounce 1: 0.700", "bounce 2: 0.712", "bounce 3: 0.731", "bounce 4"]


def test_the_chart_shows_no_more_than_is_known(filmed: Tuning, tmp_path: Path):
    nowhere = rr.RecordingStream("tunenet test of bounces")
    named = log_bounces(nowhere, review_data(with_rebounds(filmed))).name
    assert named == "restitution by impact speed [m/s], bars: 95 %"
    tuning = doubted(with_rebounds(filmed, (None, None, None)))
    assert log_bounces(nowhere, review_data(tuning)).name == "restitution by bounce"
    path = reviewed(tuning, tmp_path)
    assert "/sheets/convergence/interval" not in contents(path)
    assert drawn(path, "/sheets/bounces/labels")[-3:] == ["1", "2", "3"]


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


def test_a_legend_has_the_whole_vector():
    values = {"restitution": 0.7523, "restitution_slope": -0.0001, "drag": 0.11}
    assert values_words(values) == "e=.752 p=.000 k=.110/m"
    assert values_words({"restitution": 0.7523}) == "e=0.7523"
