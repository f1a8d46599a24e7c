"""What a user says of a log or its ball counts, or a warning says that it did not."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.conftest import ROOT, Command
from tests.strangers import bounce_heights
from tunenet_logs.analysis.cli.tune import build_parser
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions, options_of
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.console import given, options_in
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.known import BALLS, Ball

FOLDER = ROOT / "sample_logs"
KNOWN_ARMS = ROOT / "recorders" / "simulators" / "arm" / "known"

# One value of each option, which no log below says itself.
SAID: Mapping[str, Mapping[str, Any]] = {
    "--ball": {"ball": "golf"},
    "--ball-diameter": {"ball_diameter_m": 0.2},
    "--ball-mass": {"ball_diameter_m": 0.1, "ball_mass_kg": 0.02},
    "--height": {"height_m": 1.3},
    "--roi": {"roi": (0, 0, 9, 9)},
    "--hsv": {"hsv": ((0, 0, 0), (9, 9, 9))},
    "--ball-at": {"ball_at": (5.0, 5.0, 0.0)},
    "--fps": {"fps": 50.0},
    "--length-unit": {"length_unit": "mm"},
    "--angle-unit": {"angle_unit": "deg"},
    "--torque-constants": {"torque_constants": "3"},
    "--arm": {"arm": "ur5e"},
    "--urdf": {"urdf": KNOWN_ARMS / "ur5e.urdf", "tool_link": "tool0"},
    "--gravity": {"gravity": "compensated"},
    "--effort-sign": {"effort_sign": "load"},
    "--effort-unit": {"effort_unit": "A", "torque_constants": "3"},
    "--tare": {"tares": [FOLDER / "payload.mcap"]},
    "--topic": {"topic": "/nowhere"},
    "--start": {"start_s": 0.9},
    "--end": {"end_s": 0.9},
    "--iterations": {"iterations": 2},
    "--initial": {"initial": 0.3},
}


# Of no log: what is simulated, how it is fitted, and what needs a file or columns.
OTHERS = {"model", "parameters", "mapping", "task", "preset", "method", "weights"}
OTHERS |= {"arm_card", "columns", "together", "hold_out"}


def test_every_option_about_a_log_is_tried():
    tried = {name for said in SAID.values() for name in said}
    assert set(options_in(TuneOptions)) - tried == OTHERS


def track_csv(path: Path, header: str) -> Path:
    """A ball of restitution .8, let go at 1 m, with 1 mm of noise."""
    seconds = np.arange(0, 2.5, 1 / 120)
    heights = bounce_heights(0.8, 1.0, seconds - 0.3)
    heights += np.random.default_rng(1).normal(size=len(heights)) * 1e-3
    rows = zip(seconds, heights, strict=True)
    path.write_text(f"{header}\n" + "".join(f"{t:.6f},{z:.6f}\n" for t, z in rows))
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, tuple[Path, Mapping[str, Any]]]:
    """By name, with what has to be said of each."""
    folder = tmp_path_factory.mktemp("logs")
    times_s = 0.5 + np.cumsum([0.0, *(0.72 * 0.8 ** np.arange(7))])
    (folder / "times.csv").write_text("".join(f"{one:.6f}\n" for one in times_s))
    return {
        "positions": (FOLDER / "dull.mcap", {}),
        "film": (FOLDER / "filmed.mcap", {}),
        "payload": (FOLDER / "payload.mcap", {}),
        "table": (track_csv(folder / "table.csv", "time (s),z (m)"), {}),
        "bare": (track_csv(folder / "bare.csv", "time (s),z"), {}),
        "times": (folder / "times.csv", {"columns": "times=1"}),
    }


@cache
def plain_of(log: Path, words: tuple[tuple[str, Any], ...]) -> Tuning:
    return tune_log(log, options_of(dict(words)))


def outcome_of(tuning: Tuning) -> str:
    """All that a user may see of what came out, without its times and warnings."""
    steps = [step.values.tolist() for step in tuning.trace.steps] if tuning.trace else []
    checks = [(check.name, check.passed, check.detail) for check in tuning.checks]
    return repr((tuning.verdict, tuning.reason, steps, checks, tuning.cross_check))


@pytest.mark.parametrize("option", SAID)
@pytest.mark.parametrize("name", ["positions", "film", "payload", "table", "bare", "times"])
def test_an_option_changes_the_record_or_a_warning_names_it(
    name: str, option: str, logs: Mapping[str, tuple[Path, Mapping[str, Any]]]
) -> None:
    log, words = logs[name]
    plain = plain_of(log, tuple(words.items()))
    assert plain.verdict == "ok"
    assert not any("not used" in warning for warning in plain.warnings)
    said = {**words, **SAID[option]}
    tuning = tune_log(log, options_of(said))
    names_it = any(option in names for names in unused(tuning.warnings))
    changes = outcome_of(tuning) != outcome_of(plain)
    assert changes or names_it
    if names_it and option != "--initial":  # which a fit's first iterate is made of
        assert not changes


def test_a_named_ball_fixes_the_drag_of_positions_too(command: Command, drop_log: Path):
    result = command("tunenet-tune", drop_log, "--ball", "golf")
    assert result.returncode == 0, result.stderr
    drag = json.loads(drop_log.with_suffix(".json").read_text())["parameters"]["drag"]["value"]
    golf = BALLS["golf"].drag_1_m
    assert golf is not None
    assert 0.3 * golf < drag < 1.3 * golf  # the samples, which have none, speak too


def unused(warnings: Iterable[str]) -> list[str]:
    return [line.split(" not used")[0] for line in warnings if " not used" in line]


def test_what_a_method_a_task_and_a_table_do_not_use_is_said(tmp_path: Path):
    plain = tune_log(FOLDER / "dull.mcap", options_of({"method": "fit"}))
    for option in ("--iterations", "--initial"):
        tuning = tune_log(FOLDER / "dull.mcap", options_of({"method": "fit", **SAID[option]}))
        assert tuning.estimate == pytest.approx(plain.estimate)
        assert unused(tuning.warnings) == [option]
    still = tmp_path / "still.csv"
    still.write_text("time (s),z (m)\n" + "".join(f"{k / 100},1\n" for k in range(200)))
    tuning = tune_log(still, options_of({"arm": "ur5e", "roi": (0, 0, 9, 9)}))
    assert tuning.verdict == "rejected"
    assert unused(tuning.warnings) == ["--roi", "--arm"]
    table = track_csv(tmp_path / "table.csv", "time (s),z (m)")
    every = {"length_unit": "m", "fps": 60.0, "torque_constants": "3"}
    for said, names in (
        ({"fps": 60.0}, ["--fps"]),
        ({"columns": "t=1,z=2"}, []),  # what was said, whatever they would be
        (every, ["--fps", "--length-unit", "--torque-constants"]),
    ):
        assert unused(read_episode(table, options_of(said).reading).warnings) == names


@pytest.mark.parametrize(
    ("words", "ball", "doubt"),
    [
        ("", Ball(), None),
        ("--ball golf", BALLS["golf"], None),
        ("--ball-diameter 0.05", Ball(0.05), None),
        ("--ball-diameter 0.05 --ball-mass 0.03", Ball(0.05, 0.03), None),
        ("--ball tennis --ball-mass 0.05", Ball(0.067, 0.05, 0.55), None),
        ("--ball table-tennis --ball-diameter 0.038", Ball(0.038, 0.0027), None),
        ("--ball golf --ball-diameter 0.043", None, None),
        (
            "--ball tennis --ball-diameter 0.3 --ball-mass 0.6",
            Ball(0.3, 0.6, 0.55),
            "the ball tennis has 67 mm",
        ),
        ("--ball-diameter 0.04 --ball-mass 2.7", Ball(0.04, 2.7), "--ball-mass is in kg"),
        (
            "--ball golf --ball-diameter 0.1",
            None,
            "the ball golf has 42.7 mm, 45.9 g; what was measured is used",
        ),
    ],
)
def test_a_ball_by_name_by_measure_or_both(words: str, ball: Ball | None, doubt: str | None):
    options = options_of(given(build_parser().parse_args(["a.mp4", *words.split()]), TuneOptions))
    assert ball is None or options.given_ball == ball
    doubts = options.ball_doubts
    assert doubt in doubts[0] if doubt else not doubts
