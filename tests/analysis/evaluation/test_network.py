"""The start's worth: what the tables are made of, on a few logs and targets."""

from __future__ import annotations

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.evaluation.studies.network import (
    ROLLOUTS,
    drawn_payload,
    drop_rows,
    payload_errors,
    payload_rows,
)
from tunenet_logs.analysis.evaluation.study import Order
from tunenet_logs.analysis.evaluation.worlds.ball import CELLS, draw_drop
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.terminal import Progress


def test_a_log_is_the_same_each_time():
    (first, mass_kg, _), (again, same_kg, _), (_, other_kg, _) = (
        drawn_payload(1, index) for index in (0, 0, 1)
    )
    assert mass_kg == same_kg != other_kg
    for name, signal in first.signals.items():
        np.testing.assert_array_equal(signal.values, again.signals[name].values)


def test_where_there_is_an_exact_fit_the_start_changes_nothing():
    payload, mass_kg, tare = drawn_payload(1, 0)
    drop = draw_drop(CELLS[0], 1, 0)
    for episode, truth, tares in (
        (payload, mass_kg, (tare,)),
        (drop.episode(), drop.ball.restitution, ()),
    ):
        both = [
            tune_episode(episode, TuneOptions(method=method, tares=tares))
            for method in ("tunenet+refine", "fit")
        ]
        values = [one.estimate[0] for one in both if one.estimate is not None]
        assert values == pytest.approx([truth] * 2, abs=0.03)
        assert values[0] == pytest.approx(values[1], abs=1e-9)
        assert [one.rollouts for one in both] == [7, 2]


@needs_pybullet
def test_every_method_is_charged_for_its_rollouts():
    model = shipped_model(TRAININGS["paper-code"].purpose)
    rows = drop_rows({1: model}, Order((1,), 3, jobs=1), Progress(quiet=True))
    easy = {(one["method"], one["rollouts"]): one["mae"] for one in rows[: 6 * len(ROLLOUTS)]}
    assert len(easy) == len(rows) / 4
    assert easy["network, then lines", 5] < easy["network", 5] < easy["Brent", 3]


def test_a_payload_by_rollouts_alone():
    errors = payload_errors((1, range(1)))
    assert np.array(errors).shape == (1, 4, ROLLOUTS[-1] + 1)
    assert np.all(errors[0][:3, ROLLOUTS[0]] < 0.3)
    assert payload_rows(errors)[0]["method"] == "network"
