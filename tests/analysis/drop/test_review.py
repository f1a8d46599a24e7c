"""The review is whole, opens with its own blueprint, and holds what it should on both timelines."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer
from rerun.chunk import RrdReader

from tests.conftest import BIN, record
from tests.engines import needs_pybullet
from tests.strangers import Stranger, write_poses
from tunenet_logs.analysis.drop.review.views import film_positions, review_data, values_words
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.review.tuning import write_review
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.reader import read_episode
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


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> Tuning:
    path = tmp_path_factory.mktemp("drop") / "drop.mcap"
    return tune_log(record(path, restitution=0.7, height_m=1.0), TuneOptions())


@pytest.fixture(scope="module")
def filmed(filmed_log: Path) -> Tuning:
    return tune_log(filmed_log, TuneOptions())


def test_every_iteration_lies_on_the_logs_time(tuned: Tuning, tmp_path: Path):
    write_review(tuned, record_of(tuned), tmp_path / "a.rrd")
    verified(tmp_path / "a.rrd")
    entities = contents(tmp_path / "a.rrd")
    for k in range(6):
        for place in (f"/height/k{k}", f"/residual/k{k}", f"/scene/k{k}"):
            assert entities[place] == {"static", "log_time_s"}, place
    for place in ("/height/observed", "/scene/observed"):
        assert entities[place] == {"static", "log_time_s"}
    assert entities["/result"] == {"static"}


def test_iterations_can_be_scrubbed_over_a_fixed_observed_curve(tuned: Tuning, tmp_path: Path):
    write_review(tuned, record_of(tuned), tmp_path / "a.rrd")
    entities = contents(tmp_path / "a.rrd")
    assert entities["/sheets/heights/observed"] == {"static"}
    assert entities["/sheets/heights/simulated"] >= {"iteration"}
    assert entities["/sheets/convergence/values"] == {"static"}
    assert entities["/step"] >= {"iteration"}


@needs_pybullet
@pytest.mark.parametrize("preset", ["paper", "paper-code"])
def test_the_papers_presets_have_a_review_too(tmp_path: Path, preset: Any):
    path = record(tmp_path / "a.mcap", preset="paper", restitution=0.5, height_m=4.0)
    write_review(
        tuning := tune_log(path, TuneOptions(preset=preset)), record_of(tuning), tmp_path / "a.rrd"
    )
    verified(tmp_path / "a.rrd")


def test_a_rejected_log_shows_what_was_recorded(tmp_path: Path):
    path = record(tmp_path / "a.mcap", restitution=0.0, height_m=1.0)
    write_review(tuning := tune_log(path, TuneOptions()), record_of(tuning), tmp_path / "a.rrd")
    verified(tmp_path / "a.rrd")
    assert "/recorded/ball/pose/z" in contents(tmp_path / "a.rrd")


def test_names_of_a_stranger_do_no_harm(tmp_path: Path):
    stamps, positions = Stranger(0.0).samples()
    topic = "/../we ird/тема//[x]{y}/\x07"
    write_poses(tmp_path / "a.mcap", stamps, positions, topic=topic)
    write_review(
        tuning := tune_log(tmp_path / "a.mcap", TuneOptions()),
        record_of(tuning),
        tmp_path / "a.rrd",
    )
    verified(tmp_path / "a.rrd")


def test_names_of_a_stranger_are_parts_of_a_path(tmp_path: Path, capfd: pytest.CaptureFixture):
    stamps, positions = Stranger(0.0).samples()
    stamps, positions = stamps[:60], positions[:60]  # nothing falls yet
    write_poses(tmp_path / "a.mcap", stamps, positions, topic="/bäll pose/\x1b[31mx//y")
    write_review(
        tuning := tune_log(tmp_path / "a.mcap", TuneOptions()),
        record_of(tuning),
        tmp_path / "a.rrd",
    )
    assert capfd.readouterr() == ("", "")
    assert r"/recorded/bäll\ pose/\u{001B}\[31mx/y/z" in contents(tmp_path / "a.rrd")


def test_of_thousands_of_signals_the_first_are_drawn(tmp_path: Path):
    write_channels(tmp_path / "a.mcap", 400)
    tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert len(tuning.episode.signals) == 400  # type: ignore[union-attr]
    write_review(tuning, record_of(tuning), tmp_path / "a.rrd")
    verified(tmp_path / "a.rrd")
    recorded = [one for one in contents(tmp_path / "a.rrd") if one.startswith("/recorded/")]
    assert len(recorded) == 150
    assert "1050 more curves are not drawn" in text(tmp_path / "a.rrd", "/result")


def write_channels(path: Path, count: int) -> None:
    point = {"x": 0.0, "y": 0.0, "z": 1.0}
    data = json.dumps({"timestamp": {"sec": 1, "nsec": 0}, "pose": {"position": point}}).encode()
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.PoseInFrame", "jsonschema", b"{}")
        for number in range(count):
            channel = writer.register_channel(f"/ch{number}", "json", schema)
            writer.add_message(channel, 1, data, 1)
        writer.finish()


def test_a_place_that_cannot_be_written_raises(tuned: Tuning):
    with pytest.raises(OSError, match="proc"):
        write_review(tuned, record_of(tuned), Path("/proc/nowhere/a.rrd"))


def test_the_simulated_curve_of_the_result_lies_on_the_observed_one(tuned: Tuning):
    data = review_data(tuned)
    off = data.residuals[-1].heights_m
    assert np.abs(off).max() < 1e-3


@needs_pybullet
def test_the_papers_rollouts_lie_over_the_observed_curve_too(tmp_path: Path):
    path = record(tmp_path / "a.mcap", preset="paper", restitution=0.55, height_m=4.0)
    data = review_data(tune_log(path, TuneOptions(preset="paper-code")))
    off = data.residuals[-1].heights_m
    falling = data.observed.seconds < data.impacts_s[0]
    assert np.abs(off[falling]).max() < 0.05
    assert np.sqrt(np.mean(off**2)) < 0.1


def test_a_film_lies_under_its_balls_on_the_logs_time(filmed: Tuning, tmp_path: Path):
    write_review(filmed, record_of(filmed), tmp_path / "a.rrd")
    verified(tmp_path / "a.rrd")
    entities = contents(tmp_path / "a.rrd")
    for place in ("picture", "observed", "trail", *(f"k{k}" for k in range(6))):
        assert entities[f"/film/{place}"] == {"static", "log_time_s"}, place
    pictures = [frame.data for frame in filmed.episode.frames()]  # type: ignore[union-attr]
    assert (tmp_path / "a.rrd").stat().st_size > 0.9 * sum(map(len, pictures))


def test_the_simulated_balls_are_projected_onto_the_observed_one(filmed: Tuning):
    film, data = filmed.detection.film, review_data(filmed)
    observed = film.track.places_px[film.used]
    late = film.drop.seconds > data.impacts_s[0] + 0.1

    def rms_px(k: int) -> float:
        curve = data.simulated[k]
        heights = np.interp(film.drop.seconds, curve.seconds, curve.heights_m) / data.drop_height_m
        off = film_positions(film, film.drop.seconds, heights) - observed
        return float(np.sqrt(np.mean(off[late] ** 2)))

    assert rms_px(-1) < 0.5
    assert rms_px(0) > 5


def test_the_verdict_lies_over_all_on_any_timeline(tuned: Tuning, tmp_path: Path):
    write_review(tuned, record_of(tuned), tmp_path / "a.rrd")
    assert contents(tmp_path / "a.rrd")["/verdict"] == {"static"}
    assert text(tmp_path / "a.rrd", "/result").startswith("# ok")


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


def test_a_legend_has_the_whole_vector():
    values = {"restitution": 0.7523, "restitution_slope": -0.0001, "drag": 0.11}
    assert values_words(values) == "e=.752 p=.000 k=.110/m"
    assert values_words({"restitution": 0.7523}) == "e=0.7523"


def test_the_residual_has_its_limit_in_the_chart(tuned: Tuning, tmp_path: Path):
    write_review(tuned, record_of(tuned), tmp_path / "a.rrd")
    limits = [
        chunk.to_record_batch().column("Scalars:scalars").to_pylist()
        for chunk in RrdReader(tmp_path / "a.rrd").stream()
        if str(chunk.entity_path) == "/residual/limit" and not chunk.is_static
    ]
    assert limits == [[[pytest.approx(5.0, abs=0.1), pytest.approx(-5.0, abs=0.1)]] * 2]


def test_a_film_without_a_drop_shows_what_was_tracked(filmed_log: Path, tmp_path: Path):
    frames = list(read_episode(filmed_log).frames())
    with EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo(), live=False) as writer:
        for frame in frames[:52]:  # it falls, and has hardly hit
            writer.write_frame("/camera", frame)
    tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert tuning.verdict == "rejected"
    assert tuning.detection is None
    assert tuning.refused is not None
    write_review(tuning, record_of(tuning), tmp_path / "a.rrd")
    verified(tmp_path / "a.rrd")
    entities = contents(tmp_path / "a.rrd")
    for place in ("/film/observed", "/height/observed"):
        assert entities[place] == {"static", "log_time_s"}, place
    assert entities["/film/picture"] >= {"log_time_s"}
    assert entities["/film/track"] == {"static"}


def test_a_rejected_film_shows_its_pictures(filmed_log: Path, tmp_path: Path):
    frames = list(read_episode(filmed_log).frames())
    with EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo(), live=False) as writer:
        for frame in frames[:15]:
            writer.write_frame("/camera", frame)
    tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert tuning.verdict == "rejected"
    write_review(tuning, record_of(tuning), tmp_path / "a.rrd")
    verified(tmp_path / "a.rrd")
    assert contents(tmp_path / "a.rrd")["/film/picture"] == {"log_time_s"}
