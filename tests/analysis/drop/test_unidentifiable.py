"""What a log does not tell of slope and drag is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.analysis.drop.bounce_posterior import BallPosterior, unidentifiable
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import read_record, to_json
from tunenet_logs.analysis.tuning import tune_log


@pytest.fixture
def posterior(drop_log: Path) -> BallPosterior:
    found = tune_log(drop_log, TuneOptions()).detection.posterior
    assert found is not None
    return found


def test_a_log_of_many_bounces_leaves_nothing_open(posterior: BallPosterior):
    assert unidentifiable(posterior) == ()
    assert unidentifiable(replace(posterior, correlation=-0.99)) == ()  # both are told all the same


def test_what_its_prior_says_is_named(posterior: BallPosterior):
    ends = np.array([[0.5, 0.53], [-0.02, 0.15], [0.03, 0.06]])
    (words,) = unidentifiable(
        replace(posterior, told=np.array([0.0, 0.9]), correlation=0.0, interval95=ends)
    )
    assert words.startswith("this log cannot determine the slope: ")
    assert words.endswith("from -0.020 to 0.150")


def test_what_trades_places_cannot_be_told_apart(posterior: BallPosterior):
    samples = posterior.fit.samples
    view = posterior.fit.projection()
    third_s = view.impact_s + view.fall_time_s * float(view.impacts(1e3)[2])
    fit = replace(posterior.fit, samples=samples.only(samples.seconds < third_s - 0.01))
    short = replace(posterior, told=np.array([0.2, 0.3]), correlation=-0.97, fit=fit)
    assert unidentifiable(short) == ("drag and slope cannot be separated in this log: two flights",)


def test_the_json_keeps_it(drop_log: Path, tmp_path: Path):
    record = record_of(tune_log(drop_log, TuneOptions()))
    said = replace(record, motion=replace(record.motion, unidentifiable=("drag and slope: no",)))
    (tmp_path / "a.json").write_text(to_json(said))
    assert read_record(tmp_path / "a.json").motion.unidentifiable == ("drag and slope: no",)
