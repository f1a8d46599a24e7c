"""Whatever is said of a log changes its record, or a warning says that it did not."""

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.test_sample_logs import FOLDER
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions, options_of
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.console import options_in
from tunenet_logs.reader import read_episode

ARMS = Path(__file__).parents[2] / "recorders" / "simulators" / "arm" / "known"

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
    "--torque-constants": {"torque_constants": "3"},
    "--arm": {"arm": "ur5e"},
    "--urdf": {"urdf": ARMS / "ur5e.urdf", "tool_link": "tool0"},
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


def _track_csv(path: Path, header: str) -> Path:
    """A ball of restitution .8, let go at 1 m, with 1 mm of noise."""
    seconds = np.arange(0, 2.5, 1 / 120)
    heights = np.ones(len(seconds))
    start_s, speed, gravity = 0.3, 0.0, 9.81
    begin_m = 1.0
    while start_s < seconds[-1]:
        since = np.maximum(seconds - start_s, 0)
        flight = begin_m + speed * since - gravity * since**2 / 2
        heights = np.where(seconds >= start_s, np.maximum(flight, 0), heights)
        hits_s = (speed + np.sqrt(speed**2 + 2 * gravity * begin_m)) / gravity
        speed, start_s, begin_m = 0.8 * (gravity * hits_s - speed), start_s + hits_s, 0.0
        if hits_s < 1e-3:
            break
    heights += np.random.default_rng(1).normal(size=len(heights)) * 1e-3
    rows = zip(seconds, heights, strict=True)
    path.write_text(f"{header}\n" + "".join(f"{t:.6f},{z:.6f}\n" for t, z in rows))
    return path


def _times_csv(path: Path) -> Path:
    times_s = 0.5 + np.cumsum([0.0, *(0.72 * 0.8 ** np.arange(7))])
    path.write_text("".join(f"{one:.6f}\n" for one in times_s))
    return path


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, tuple[Path, Mapping[str, Any]]]:
    """By name, with what has to be said of each."""
    folder = tmp_path_factory.mktemp("logs")
    return {
        "positions": (FOLDER / "dull.mcap", {}),
        "film": (FOLDER / "filmed.mcap", {}),
        "payload": (FOLDER / "payload.mcap", {}),
        "table": (_track_csv(folder / "table.csv", "time (s),z (m)"), {}),
        "bare": (_track_csv(folder / "bare.csv", "time (s),z"), {}),
        "times": (_times_csv(folder / "times.csv"), {"columns": "times=1"}),
    }


@cache
def _plain(log: Path, words: tuple[tuple[str, Any], ...]) -> Tuning:
    return tune_log(log, options_of(dict(words)))


def _outcome(tuning: Tuning) -> str:
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
    plain = _plain(log, tuple(words.items()))
    assert plain.verdict == "ok"
    assert not any("not used" in warning for warning in plain.warnings)
    said = {**words, **SAID[option]}
    tuning = tune_log(log, options_of(said))
    unused = [warning for warning in tuning.warnings if "not used" in warning]
    names_it = any(option in warning.split(" not used")[0] for warning in unused)
    changes = _outcome(tuning) != _outcome(plain)
    assert changes or names_it
    if names_it and option != "--initial":  # which a fit's first iterate is made of
        assert not changes


@pytest.mark.parametrize("option", ["--iterations", "--initial"])
def test_a_fit_needs_no_start_and_no_rollouts(option: str) -> None:
    plain = tune_log(FOLDER / "dull.mcap", options_of({"method": "fit"}))
    said: Any = {"method": "fit", **SAID[option]}
    tuning = tune_log(FOLDER / "dull.mcap", options_of(said))
    assert tuning.trace is not None
    assert plain.trace is not None
    assert tuning.trace.estimate == pytest.approx(plain.trace.estimate)
    assert any(warning.startswith(f"{option} not used") for warning in tuning.warnings)


def test_a_log_without_a_drop_says_what_was_not_used(tmp_path: Path) -> None:
    log = tmp_path / "still.csv"
    log.write_text("time (s),z (m)\n" + "".join(f"{k / 100},1\n" for k in range(200)))
    tuning = tune_log(log, options_of({"arm": "ur5e", "roi": (0, 0, 9, 9)}))
    assert tuning.verdict == "rejected"
    assert [warning.split(" not used")[0] for warning in tuning.warnings] == ["--roi", "--arm"]


@pytest.mark.parametrize(
    ("said", "unused"),
    [
        ({"fps": 60.0}, ["--fps"]),
        ({"columns": "t=1,z=2"}, []),  # a table's columns are what was said, whatever they would be
        ({"length_unit": "m", "fps": 60.0, "torque_constants": "3"}, None),
    ],
)
def test_a_table_reads_the_same_without(
    said: dict[str, Any], unused: list[str] | None, tmp_path: Path
) -> None:
    log = _track_csv(tmp_path / "table.csv", "time (s),z (m)")
    reading = options_of(said).reading
    warnings = read_episode(log, reading).warnings
    expected = ["--fps", "--length-unit", "--torque-constants"] if unused is None else unused
    assert [warning.split(" not used")[0] for warning in warnings] == expected


def test_every_option_about_a_log_is_tried() -> None:
    tried = {name for said in SAID.values() for name in said}
    about_a_model = {"model", "parameters", "mapping"}
    about_the_method = {"task", "preset", "method", "weights"}
    need_a_file_or_columns = {"arm_card", "columns"}
    assert (
        set(options_in(TuneOptions)) - tried - about_a_model
        == about_the_method | need_a_file_or_columns
    )
