"""What a user of tunenet-tune knows of the ball."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.conftest import Command
from tunenet_logs.analysis.cli.tune import build_parser
from tunenet_logs.analysis.options import TuneOptions, options_of
from tunenet_logs.console import given
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.known import BALLS, Ball


def options(*words: str) -> TuneOptions:
    return options_of(given(build_parser().parse_args(["a.mp4", *words]), TuneOptions))


def told(*words: str) -> Ball:
    return options(*words).given_ball


def doubts(*words: str) -> tuple[str, ...]:
    return options(*words).ball_doubts


def test_a_ball_by_name_by_measure_or_both():
    assert told() == Ball()
    assert told("--ball", "golf") == BALLS["golf"]
    assert told("--ball-diameter", "0.05") == Ball(0.05)
    assert told("--ball-diameter", "0.05", "--ball-mass", "0.03") == Ball(0.05, 0.03)
    assert told("--ball", "tennis", "--ball-mass", "0.05") == Ball(0.067, 0.05, 0.55)
    assert told("--ball", "table-tennis", "--ball-diameter", "0.038") == Ball(0.038, 0.0027)
    both = told("--ball", "tennis", "--ball-diameter", "0.3", "--ball-mass", "0.6")
    assert both == Ball(0.3, 0.6, 0.55)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("--ball", "cricket"), "there is: table-tennis, tennis, squash"),
        (("--ball-mass", "0.01"), "add --ball-diameter"),
        (("--ball", "basketball", "--ball-mass", "0.0027"), "lighter than the air"),
        (("--ball-diameter", "0"), "'0' is not a number from 0.001"),
        (("--ball-mass", "-1"), "'-1' is not a number"),
        (("--ball-diameter", "40mm"), "'40mm'"),
    ],
)
def test_what_cannot_be_or_goes_against_itself_is_refused(words: tuple[str, ...], says: str):
    with pytest.raises(UsageError, match=says):
        told(*words)


def test_a_mass_in_grams_is_noticed():
    words = ("--ball-diameter", "0.04", "--ball-mass", "2.7")
    assert told(*words) == Ball(0.04, 2.7)
    assert "--ball-mass is in kg" in doubts(*words)[0]
    assert not doubts("--ball", "golf")


def test_a_size_that_is_not_the_named_balls_is_noticed():
    (doubt,) = doubts("--ball", "golf", "--ball-diameter", "0.1")
    assert "the ball golf has 42.7 mm, 45.9 g; what was measured is used" in doubt
    assert not doubts("--ball", "golf", "--ball-diameter", "0.043")


def test_an_unknown_ball_is_one_line_and_exit_code_2(command: Command, drop_log: Path):
    result = command("tunenet-tune", drop_log, "--ball", "cricket")
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "basketball" in result.stderr
    assert not drop_log.with_suffix(".json").exists()


def test_a_named_ball_fixes_the_drag_of_positions_too(command: Command, drop_log: Path):
    result = command("tunenet-tune", drop_log, "--ball", "golf")
    assert result.returncode == 0, result.stderr
    drag = json.loads(drop_log.with_suffix(".json").read_text())["parameters"]["drag"]["value"]
    golf = BALLS["golf"].drag_1_m
    assert golf is not None
    assert 0.3 * golf < drag < 1.3 * golf  # the samples, which have none, speak too
