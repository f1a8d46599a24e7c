"""`tunenet-eval own`: a user's model tested on itself, with truths that are known."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.sysid.pendulums import model_source, pendulum_episode
from tunenet_logs.analysis.api import save_episode
from tunenet_logs.analysis.evaluation.cli import main
from tunenet_logs.analysis.evaluation.studies.own import default_motion, simulated_log, told_after
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.sysid.fit import SimulatorFit
from tunenet_logs.analysis.sysid.source import ModelSource, tuned_first
from tunenet_logs.analysis.tuning import tune_episode

DAMPING, MASS = "joint/hinge.damping", "body/bob.mass"
BOX = """
<mujoco>
  <option timestep="0.002"/>
  <worldbody>
    <geom type="plane" size="5 5 .1"/>
    <body name="box" pos="0 0 .3" euler="20 30 40">
      <freejoint/><geom name="box" type="box" size=".1 .05 .03" mass=".5"/>
    </body>
  </worldbody>
</mujoco>
"""
ARM = """
<mujoco>
  <option timestep="0.002" integrator="implicitfast"/>
  <worldbody>
    <body name="link">
      <joint name="turn" axis="0 1 0" damping=".2" armature=".01"/>
      <inertial pos="0 0 -.2" mass="1" diaginertia=".01 .01 .001"/>
    </body>
  </worldbody>
  <actuator><position name="turn" joint="turn" kp="30" kv="1"/></actuator>
</mujoco>
"""


def own_rows(folder: Path, *words: object) -> tuple[list[dict[str, object]], str]:
    """Run the command; return its rows, and the table in its own words."""
    file = folder / "own.json"
    told = [*map(str, words), "--jobs", "1", "--quiet", "--json", str(file)]
    assert main(["own", *told]) == 0
    return json.loads(file.read_text())["rows"], str(file)


@pytest.fixture
def pendulum(tmp_path: Path) -> tuple[Path, Path]:
    """A model and a log of it that SciPy made."""
    log = tmp_path / "run.mcap"
    save_episode(pendulum_episode(), log)
    return model_source(tmp_path).path, log


def test_it_finds_what_it_put_in_along_a_log_and_names_what_that_cannot_tell(
    pendulum: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    model, log = pendulum
    rows, _ = own_rows(tmp_path, log, "--model", model, "--tune", f"{DAMPING}=0:.2", "--targets", 4)
    assert [row["address"] for row in rows] == 4 * [DAMPING]
    for row in rows:
        assert row["verdict"] == "ok"
        assert row["is_told"]
        assert row["truth"] == pytest.approx(0.06, abs=0.003)  # what SciPy's pendulum has
        assert row["value"] == pytest.approx(row["truth"], abs=0.002)
        assert row["high"] - row["low"] < 0.004  # type: ignore[operator]
    printed = capsys.readouterr().out
    assert "verdicts: ok 4" in printed
    assert "4 of 4" in printed
    words = ["--tune", f"{DAMPING}=0:.2", "--tune", f"{MASS}=.2:3", "--targets", "2"]
    rows, _ = own_rows(tmp_path, "--model", model, *words, log)
    assert {str(row["address"]) for row in rows if not row["is_told"]} == {DAMPING, MASS}
    printed = capsys.readouterr().out
    assert f"{MASS}: " in printed
    assert "logs cannot tell it" in printed


def test_a_model_without_a_log_is_moved_and_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    model = tmp_path / "arm.xml"
    model.write_text(ARM)
    words = ["--tune", "body/link.mass=.3:3", "--tune", "actuator/turn.kp=10:90"]
    rows, _ = own_rows(tmp_path, "--model", model, *words, "--targets", 3)
    assert len(rows) == 6
    for row in rows:
        assert row["value"] == pytest.approx(row["truth"], rel=0.03)
        assert row["is_told"]
    truths = [float(str(row["truth"])) for row in rows[::2]]
    assert max(truths) > 1.3 * min(truths)  # from all over the range
    assert "a motion made for it" in capsys.readouterr().out


def test_a_free_body_is_thrown_and_its_orientation_read_again(tmp_path: Path):
    path = tmp_path / "box.xml"
    path.write_text(BOX)
    source = ModelSource(path, ("geom/box.friction[0]=.1:1",))
    motion = default_motion(source.model, path)
    connected = source.connect(motion)
    assert len(connected.target.columns) == 9  # of position, and of two axes
    parameters = tuned_first(connected.simulator.parameters)
    truth = np.array([one.initial for one in parameters])
    none = {one.signal.name: np.zeros(6) for one in connected.simulator.sensed}  # type: ignore[attr-defined]
    none["/box"] = np.zeros(3)
    episode = simulated_log(connected, truth, none, np.random.default_rng(0))
    again = source.connect(episode)
    (seen,) = again.rollouts(
        np.array([[one.initial for one in tuned_first(again.simulator.parameters)]])
    )
    before = again.target.seconds < 0.15  # it has not hit the ground yet
    off = again.target.seen_in(seen) - again.target.values
    assert np.abs(off[before]).max() < 1e-3
    assert np.ptp(again.target.values[again.target.which == 0]) > 0.1  # it flies


def test_as_many_seconds_as_it_says_tell_a_value_to_a_tenth(tmp_path: Path):
    options = TuneOptions(source=model_source(tmp_path))

    def fitted(end_s: float | None) -> SimulatorFit:
        tuning = tune_episode(pendulum_episode(), TuneOptions(source=options.source, end_s=end_s))
        assert tuning.trace is not None
        assert tuning.trace.fit is not None
        return tuning.trace.fit.detail

    (needed_s,) = told_after(fitted(None))
    assert 0.2 < needed_s < 3.5
    cut = fitted(float(needed_s))
    assert cut.half95[0] == pytest.approx(0.1 * 0.06, rel=0.5)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("own", "name it with --model"),
        ("own --model none.xml --tune joint/a.damping", "none.xml"),
        ("drop run.mcap", "a LOG is for own, not drop"),
        ("drop --tune a", "--tune is for own, not drop"),
    ],
)
def test_what_is_wrong_is_told_before_any_work(
    words: str, says: str, capsys: pytest.CaptureFixture[str]
):
    assert main(words.split()) == 2
    told = capsys.readouterr().err
    assert says in told
    assert told.count("\n") == 1
