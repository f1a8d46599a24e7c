"""The start's worth: what the tables are made of, on a few logs and targets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.bench.made_logs import PAYLOADS, made_log
from tests.bench.network_worth import (
    ROLLOUTS,
    payload_errors,
    payload_table,
    rollout_table,
    tuned_pairs,
)
from tests.bench.network_worth_tables import Pair, log_table
from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.terminal import Progress

BALL = Pair("balls", 0.7, (0.702, 0.7021), 0.004, (7, 2), (0.2, 0.1))
NONE = float("nan")


def cells(table: str, line: int) -> list[str]:
    """Of a line below the head."""
    return [cell.strip() for cell in table.splitlines()[2 + line].strip("|").split("|")]


def test_both_methods_tune_the_same_logs():
    pairs = tuned_pairs([("positions, ideal balls", 1, 0), (PAYLOADS, 1, 0)])
    for pair in pairs:
        assert pair.values == pytest.approx([pair.truth] * 2, abs=0.03)
        assert pair.half_width > 0
        assert pair.rollouts == (7, 2)
        assert not pair.failed


def test_a_log_is_the_same_each_time(tmp_path):
    kind = "positions, air and slope"
    first, again, other = (made_log(kind, 1, index, tmp_path) for index in (0, 0, 1))
    assert first.truth == again.truth != other.truth
    for name, signal in first.episode.signals.items():
        np.testing.assert_array_equal(signal.values, again.episode.signals[name].values)


@pytest.mark.parametrize(
    ("values", "failures", "answered"),
    [
        ((0.702, 0.7023), "0", "2 / 2"),
        ((0.702, 0.7025), "1 (1 / 0)", "2 / 2"),
        ((0.71, 0.7025), "1 (0 / 1)", "2 / 2"),
        ((NONE, 0.7025), "1 (0 / 1)", "1 / 2"),
        ((0.702, NONE), "1 (1 / 0)", "2 / 1"),
        ((NONE, NONE), "0", "1 / 1"),
    ],
)
def test_a_failure_is_what_a_user_would_notice(values, failures, answered):
    line = cells(log_table([BALL, replace(BALL, values=values)]), 0)
    assert line[0] == "2 balls"
    assert line[1] == answered
    assert line[3] == failures


@needs_pybullet
def test_every_method_is_charged_for_its_rollouts():
    model = shipped_model(TRAININGS["paper-code"].purpose)
    table = rollout_table({1: model}, 3, 1, Progress(quiet=True))
    lines = [cells(table, line) for line in range(len(table.splitlines()) - 2)]
    assert [line[1] for line in lines[: len(ROLLOUTS)]] == [str(spent) for spent in ROLLOUTS]
    assert len(lines) == 6 * len(ROLLOUTS)
    means = {tuple(line[:2]): float(line[2].partition(";")[0].strip("<")) for line in lines}
    assert means["network, then lines", "5"] < means["network", "5"] < means["Brent", "3"]


def test_a_payload_by_rollouts_alone():
    errors = payload_errors([(PAYLOADS, 1, 0)])
    assert errors.shape == (1, 4, ROLLOUTS[-1] + 1)
    assert np.all(errors[0, :3, ROLLOUTS[0]] < 0.3)
    assert cells(payload_table(errors), 0)[0] == "network"
