"""A film of which nobody says how fast it was taken tells a restitution, no height and no speed."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.films import short_film
from tests.conftest import Made
from tunenet_logs.analysis.cli.tune import main
from tunenet_logs.analysis.drop.film import find_filmed_drop
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.track import track_ball
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.reader import read_episode


def folder_of(made: Made, folder: Path) -> Path:
    """The pictures of a film, numbered."""
    folder.mkdir()
    for number, frame in enumerate(read_episode(short_film(made)).frames()):
        (folder / f"{number:04d}.jpg").write_bytes(frame.data)
    return folder


def test_its_record_has_no_metre(made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    log = folder_of(made, tmp_path / "film")
    assert main([str(log), "-o", str(tmp_path / "out")]) == 0
    said = capsys.readouterr()
    assert "height unknown" in said.out
    assert " m " not in said.out
    assert "--fps" in said.err
    record = json.loads((tmp_path / "out" / "film.json").read_text())
    assert record["units"]["rate_hz"] is None
    assert record["units"]["length_m"] is None
    assert record["bounces"]
    assert {one["impact_speed"] for one in record["bounces"]} == {None}


def test_a_rate_that_is_said_is_its_clock(made: Made, tmp_path: Path):
    log = folder_of(made, tmp_path / "film")
    without = tune_log(log, TuneOptions())
    timed = tune_log(log, TuneOptions(fps=60))
    assert without.estimate is not None
    assert timed.estimate is not None
    assert without.estimate[0] == pytest.approx(timed.estimate[0], abs=2e-3)
    assert not without.detection.tells_speed
    assert timed.detection.tells_speed
    assert not any(check.name == "frame rate" for check in without.checks)
    assert timed.detection.extent[1].endswith(" m")


@pytest.mark.parametrize("factor", [0.05, 10, 40])
def test_any_nominal_clock_gives_the_same_restitution(made: Made, factor: float):
    episode = read_episode(short_film(made))
    track = track_ball(Pictures(episode, episode.picture_topics[0]))
    since = track.stamps_ns - track.stamps_ns[0]
    told = find_filmed_drop(replace(track, stamps_ns=since), 0)
    stretched = replace(track, stamps_ns=np.round(since * factor).astype(np.int64))
    other = find_filmed_drop(stretched, 0)
    assert other.posterior.values[0] == pytest.approx(told.posterior.values[0], abs=5e-4)
