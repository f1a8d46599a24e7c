"""Models of strangers that compile and hurt when they move: each ends in one line."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tunenet_logs as tn
from tests.analysis.sysid.pendulums import pendulum_episode
from tests.conftest import ROOT
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.errors import LogError
from tunenet_logs.recorders.simulators.model.reading import ModelProcess, read_model
from tunenet_logs.recorders.simulators.mujoco import mujoco

LOG = ROOT / "sample_logs" / "models" / "pendulum.mcap"
BOB = """<body name="bob"><joint name="hinge" axis="0 -1 0" damping="0.05"/>
<inertial pos="0 0 -0.4" mass="1" diaginertia=".005 .005 .005"/></body>"""
FLOOR = '<geom type="plane" size="5 5 .1" pos="0 0 -3"/>'
BOX = '<body pos="{x} 0 {z}"><freejoint/><geom type="box" size=".2 .2 .2" mass="1"/></body>'
LANDS = FLOOR + BOX.format(x=0, z=-2.79)  # 1 cm above the floor: the first steps are free of it
HEAP = FLOOR + "".join(BOX.format(x=n / 2, z=-2.7) for n in range(20))
ENDLESS = 'solver="PGS" iterations="2000000000" tolerance="0"'
STIFF = (
    '<body pos="0 0 -2"><joint type="slide" stiffness="1e12"/><geom size=".1" mass=".001"/></body>'
)


def model(folder: Path, world: str = "", option: str = "", memory: str = "") -> Path:
    size = f'<size memory="{memory}"/>' if memory else ""
    path = folder / "stranger.xml"
    path.write_text(
        f'<mujoco>{size}<option timestep="0.004" integrator="implicitfast" {option}/>'
        f"<worldbody>{BOB}{world}</worldbody></mujoco>"
    )
    return path


def tuned(path: Path) -> Tuning:
    return tn.tune(pendulum_episode(), model=path, parameters=["joint/hinge.damping=0:.2"])


def run(path: Path, steps: int, controls: np.ndarray | None = None, **more: Any):
    """One rollout of a model as it is."""
    compiled = read_model(path).compile()
    wishes: dict[str, Any] = {
        "rows": [([], compiled.qpos0, np.zeros(compiled.nv), 0)],
        "controls": [np.zeros((steps, 0)) if controls is None else controls],
        "columns": np.zeros(0, np.intp),
        "steps": steps,
        "step_s": compiled.opt.timestep,
        "is_late": True,
        "wants_qpos": True,
    }
    return ModelProcess(path).run(compiled, **{**wishes, **more})


@pytest.mark.parametrize("memory", ["100K", "120K", "140K"])
def test_a_model_that_leaves_contacts_out_is_refused(tmp_path: Path, memory: str):
    """Where its memory runs full MuJoCo drops contacts, or gives up; with enough it is well."""
    found = tuned(model(tmp_path, HEAP, memory=memory))
    assert found.verdict == "rejected"
    assert "stranger.xml: its working memory is full after 0." in (found.reason or "")
    assert 'give it more, such as <size memory="10M"/>' in (found.reason or "")


def test_a_full_memory_is_told_at_its_step_however_long_pieces_are(tmp_path: Path):
    """A rollout is made in pieces; where MuJoCo gives up in the middle of one is no chance."""
    places = {run(model(tmp_path, HEAP, memory="140K"), steps)[0][0] for steps in (100, 301, 999)}
    assert len(places) == 1


def test_a_model_that_does_not_end_well_is_not_ok(tmp_path: Path):
    found = tuned(model(tmp_path, STIFF))
    assert found.verdict == "rejected"
    (check,) = (one for one in found.checks if one.name == "simulation is whole")
    assert "moves beyond all bounds after 0." in check.detail


def test_pieces_are_one_rollout(tmp_path: Path):
    """With contacts and warm starts, to the bit: as MuJoCo makes it in one go."""
    library, path = mujoco(), model(tmp_path, LANDS)
    (kept,), (why,), arrays = run(path, 700)
    assert (kept, why) == (700, "")
    compiled = read_model(path).compile()
    data, kind = library.MjData(compiled), library.mjtState.mjSTATE_FULLPHYSICS
    library.mj_forward(compiled, data)
    data.qvel[:] -= data.qacc * compiled.opt.timestep / 2
    state = np.zeros(library.mj_stateSize(compiled, kind))
    library.mj_getState(compiled, data, state, kind)
    whole = import_module("mujoco.rollout")
    states, _ = whole.rollout(compiled, library.MjData(compiled), state[None], nstep=700)
    np.testing.assert_array_equal(arrays["qpos"][0, 1:], states[0, :, 1 : 1 + compiled.nq])


def test_what_takes_too_long_is_foreseen(tmp_path: Path):
    """Steps that are done in time, and of which there are too many."""
    slow = 'solver="PGS" iterations="100000" tolerance="0"'
    with pytest.raises(LogError, match=r"one rollout would take MuJoCo \d+ s for 300000 steps"):
        run(model(tmp_path, LANDS, slow), 300_000, judged_s=0.1)


def worked_s(pid: int) -> float:
    """CPU time of a process."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells what the process does")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_step_without_end_hears_signals(tmp_path: Path, number: int):
    words = [
        sys.executable,
        "-c",
        "from tunenet_logs.commands import tune; raise SystemExit(tune())",
    ]
    words += [str(LOG), "--model", str(model(tmp_path, LANDS, ENDLESS))]
    words += ["--tune", "joint/hinge.damping=0:.2", "-o", str(tmp_path / "out")]
    process = subprocess.Popen(words, cwd=ROOT, stderr=subprocess.PIPE, text=True)
    children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
    found: list[int] = []
    while process.poll() is None:  # its own start, the model's compiling, and then the step
        found = [int(one) for one in children.read_text().split()]
        if found and worked_s(found[0]) > 2:
            break
        time.sleep(0.02)
    process.send_signal(number)
    _, said = process.communicate()
    assert process.returncode == 128 + number
    assert said.count("\n") == 1
    assert not Path(f"/proc/{found[0]}").exists()


@pytest.mark.slow
def test_a_step_without_end_is_ended(tmp_path: Path):
    found = tuned(model(tmp_path, LANDS, ENDLESS))
    assert found.verdict == "rejected"
    assert "takes MuJoCo over 5 s at once" in (found.reason or "")
