"""Several logs of one machine in one fit: tighter, one contradiction named, one held out."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tunenet_logs as tn
from tests.analysis.review.stored import reviewed
from tests.analysis.sysid.pendulums import DAMPING, pendulum_episode
from tests.analysis.sysid.test_own_simulator import MODELS, TRUTH, Spring
from tests.conftest import Command
from tunenet_logs.analysis.evaluation.worlds.machines import MACHINES
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.sysid.source import ModelSource
from tunenet_logs.analysis.sysid.together import names_of, together
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.errors import UsageError

TUNED = ("stiffness", "damping")


def run(seed: int, noise: float = 0.005, late_s: int = 0, **truth: float) -> Episode:
    """A run of the spring: its start, its noise and its clock are its own."""
    rng = np.random.default_rng(seed)
    start = 1.0 + 0.04 * rng.standard_normal()
    clean = Spring().rollout({**TRUTH, "initial/cart.position": start, **truth}).signals["/cart"]
    values = clean.values + noise * rng.standard_normal(clean.values.shape)
    stamps_ns = clean.stamps_ns + 10**18 + late_s * 10**9
    return Episode(EpisodeInfo(), {"/cart": replace(clean, stamps_ns=stamps_ns, values=values)})


def tuned(*runs: Episode, hold_out: Episode | None = None) -> Tuning:
    return tn.tune(runs[0], simulator=Spring(), together=runs[1:] or None, hold_out=hold_out)


def off(tuning: Tuning) -> Mapping[str, tuple[float, float]]:
    """Error and width of the interval of each value."""
    frame = tuning.to_frame()
    return {
        name: (frame.value[name] - TRUTH[name], frame.high[name] - frame.low[name])
        for name in TUNED
    }


PAIRS = 20


def test_two_runs_tell_more_than_one():
    """Intervals are at most .75 as wide as of one, and hold the truth as often as they say."""
    widths: dict[str, list[float]] = {name: [] for name in TUNED}
    inside: list[bool] = []
    for pair in range(PAIRS):
        first, second = run(2 * pair + 100), run(2 * pair + 101, late_s=60)
        alone, both = off(tuned(first)), off(tuned(first, second))
        for name in TUNED:
            widths[name].append(both[name][1] / alone[name][1])
            inside.append(abs(both[name][0]) < both[name][1] / 2)
    assert all(np.median(one) < 0.75 for one in widths.values()), widths
    assert np.mean(inside) >= 0.9


def test_each_counts_by_what_it_tells():
    """A run with twenty times the noise beside a good one changes next to nothing."""
    good, bad = run(1), run(2, noise=0.1)
    alone, both = tuned(good), tuned(good, bad)
    assert both.verdict == "ok", both.reason
    for name in TUNED:
        error, width = off(both)[name]
        assert abs(error) < width
        assert width < 1.2 * off(alone)[name][1]


def test_the_last_sample_of_a_run_is_compared(tmp_path: Path):
    """An ulp beyond the rollout's, this one was lost, and its whole run counted for little."""
    log, again = MACHINES[0].log(506, 1.0), MACHINES[0].again(506, 1.0)
    path = tmp_path / "pendulum.xml"
    path.write_text(log.model)
    parts = [ModelSource(path, log.tune).connect(one.episode) for one in (log, again)]
    both = together(("a", "b"), parts)
    assert np.isfinite(both.target.seen_in(both.simulator.rollout({}))).all()


def check(tuning: Tuning, name: str) -> tuple[bool, str]:
    [found] = [one for one in tuning.checks if one.name == name]
    return found.passed, found.detail


def test_one_that_contradicts_the_others_is_named():
    runs = [run(1), run(2), run(3, stiffness=38.0), run(4)]
    tuning = tuned(*runs)
    assert tuning.verdict != "ok"
    passed, detail = check(tuning, "the logs agree")
    assert not passed
    assert "by log (3) alone" in detail
    assert "the logs agree" in str(tuning.reason)
    assert check(tuned(*runs[:2], runs[3]), "the logs agree")[0]


def test_a_run_that_is_held_out_judges():
    runs = [run(1), run(2)]
    held = tuned(*runs, hold_out=run(3))
    assert held.verdict == "ok", held.reason
    assert "held out: /cart" in check(held, "predicts what it was not fitted to")[1]
    other = tuned(*runs, hold_out=run(3, stiffness=30.0))
    assert other.verdict == "suspect"
    assert not check(other, "predicts what it was not fitted to")[0]
    np.testing.assert_array_equal(other.estimate, held.estimate)  # it is judged by, not fitted to
    cart = run(3).signals["/cart"]
    still = Episode(EpisodeInfo(), {"/cart": replace(cart, values=0.001 + 0 * cart.values)})
    assert tuned(*runs, hold_out=still).verdict != "ok"


def test_one_run_may_be_judged_by_another():
    tuning = tn.tune(run(1), simulator=Spring(), hold_out=run(2))
    assert tuning.verdict == "ok", tuning.reason
    assert "held out: " in check(tuning, "predicts what it was not fitted to")[1]


def test_a_review_has_all_runs(tmp_path: Path):
    tuning = tuned(run(1), run(2))
    review = reviewed(tuning, tmp_path)
    assert {"episode: /cart x", "log: /cart x"} <= {
        view.name.partition(" [")[0] for view in review.views
    }
    held = tuned(run(1), run(2), hold_out=run(3))
    assert reviewed(held, tmp_path).views


# ---- The command

MODEL = """<mujoco><option timestep="0.004" integrator="implicitfast"/><worldbody>
<body><joint name="hinge" type="hinge" axis="0 -1 0"/>
<inertial pos="0 0 -0.4" mass="1" diaginertia=".005 .005 .005"/></body></worldbody></mujoco>"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three logs of a pendulum, and its model."""
    for number, name in enumerate("abc"):
        log = pendulum_episode()
        rng = np.random.default_rng(number)
        signals = {
            key: replace(one, values=one.values + 0.01 * rng.standard_normal(one.values.shape))
            for key, one in log.signals.items()
        }
        tn.save_episode(replace(log, signals=signals), tmp_path / f"{name}.mcap")
    (tmp_path / "pendulum.xml").write_text(MODEL)
    return tmp_path


OF_MODEL = ("--model", "pendulum.xml", "--tune", "joint/hinge.damping=0:.2")


def test_the_command_writes_one_result(command: Command, folder: Path):
    words = ["a.mcap", "b.mcap", *OF_MODEL, "--together", "--hold-out", "c.mcap", "-o", "out"]
    result = command("tunenet-tune", *words, cwd=folder)
    assert result.returncode == 0, result.stderr
    assert {path.name for path in (folder / "out").glob("*.json")} == {"a.json"}
    told = json.loads((folder / "out" / "a.json").read_text())
    assert (told["log"], told["verdict"]) == ("a.mcap", "ok")
    [(low, high)] = [one["interval95"] for one in told["parameters"].values()]
    assert low < DAMPING < high
    options = told["provenance"]["options"]
    assert [one["log"] for one in options["together"]] == ["b.mcap"]
    assert options["hold_out"]["log"] == "c.mcap"
    assert all(len(one["sha256"]) == 64 for one in (*options["together"], options["hold_out"]))
    assert (folder / "out" / "a.rrd").stat().st_size > 10_000
    assert tn.read_tuning(folder / "out" / "a.json").verdict == "ok"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["a.mcap", "b.mcap", "--together"], "name it with --model"),
        (["a.mcap", *OF_MODEL, "--together"], "two logs or runs"),
        (["a.mcap", *OF_MODEL, "--hold-out", "gone.mcap"], "gone.mcap"),
        (["a.mcap", "b.mcap", *OF_MODEL, "--together", "--hold-out", "b.mcap"], "named twice"),
        (["a.mcap", *OF_MODEL, "--hold-out", "a.mcap"], "named twice"),
        (["a.mcap", *OF_MODEL, "--hold-out", "episode:7"], "holds one run alone"),
        (["a.mcap", "--hold-out", "b.mcap"], "name it with --model"),
        (["a.mcap", "b.mcap", *OF_MODEL, "--together", "-o", "out", "--resume"], "--resume"),
        (["a.mcap", "pendulum.xml", *OF_MODEL, "--together"], "pendulum.xml"),
    ],
)
def test_what_does_not_go_together_is_one_line(
    words: list[str], said: str, command: Command, folder: Path
):
    result = command("tunenet-tune", *words, "--no-review", cwd=folder)
    assert result.returncode in (1, 2)
    assert said in result.stderr + result.stdout
    assert "Traceback" not in result.stderr


def test_logs_of_one_name_are_told_apart():
    assert names_of([Path("a/run.mcap"), Path("b/run.mcap"), Path("c.1.mcap")]) == (
        "run (1)",
        "run (2)",
        "c_1",
    )


def test_a_drop_has_no_runs_together():
    log = MODELS.parent / "dull.mcap"
    with pytest.raises(UsageError, match="--model"):
        tn.tune(log, hold_out=log)
