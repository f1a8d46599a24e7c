"""Machines that SciPy integrates, found in their logs by their owners' models and by objects."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import tunenet_logs as tn
from tests.analysis.sysid.pendulums import DAMPING, MODEL, START_NS, pendulum_episode, swing
from tests.conftest import ROOT, Command
from tests.same_log import assert_same_log
from tunenet_logs.analysis.evaluation.worlds.machines import (
    MACHINES,
    SEEDS,
    ModelLog,
    write_samples,
)
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.presentation import gaps_table
from tunenet_logs.analysis.sysid.source import listed_parameters
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.recorders.simulators.arm.description import jaco
from tunenet_logs.recorders.simulators.arm.path import circle
from tunenet_logs.recorders.simulators.arm.payload import PayloadSimulator
from tunenet_logs.recorders.simulators.ball import DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.recorders.simulators.model.reading import ModelProcess, read_model
from tunenet_logs.recorders.simulators.mujoco import mujoco

MODELS = ROOT / "sample_logs" / "models"
PENDULUM, ARM, BLOCK = MACHINES


def tuned(log: ModelLog, folder: Path, **more: object) -> Tuning:
    path = folder / "model.xml"
    path.write_text(log.model)
    said = {"model": path, "parameters": log.tune, **more}
    return tn.tune(log.episode, **said)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("name", "off"),
    [("pendulum", (0.0015, 0.006, 0.0002)), ("arm", (0.002, 0.0005)), ("block", (0.004,))],
)
def test_a_sample_is_found_within_its_intervals(
    name: str, off: tuple[float, ...], command: Command, tmp_path: Path
):
    log = next(one for one in MACHINES if one.name == name).log(SEEDS[name], 1.0)
    files = [MODELS / f"{name}.{suffix}" for suffix in ("mcap", "xml", "yaml")]
    words = ["--model", files[1], "--tune", files[2], "-o", tmp_path, "--no-review"]
    result = command("tunenet-tune", files[0], *words)
    assert result.returncode == 0, result.stderr
    record = tn.read_tuning(tmp_path / f"{name}.json")
    assert record.verdict == "ok", record.reason
    for one, allowed in zip(record.estimates, off, strict=True):
        assert isinstance(one.value, float)
        assert abs(one.value - log.truth[one.name]) < allowed
        assert one.interval95 is not None
    assert record.provenance is not None
    assert record.provenance.options["model"] == f"{name}.xml"


def test_the_samples_are_as_they_are_made(tmp_path: Path):
    write_samples(tmp_path)
    for path in tmp_path.iterdir():
        if path.suffix == ".mcap":
            assert_same_log(path, MODELS / path.name)
        else:
            assert path.read_bytes() == (MODELS / path.name).read_bytes(), path.name


def test_efforts_that_jump_with_each_command_trap_no_delay(tmp_path: Path):
    log = ARM.log(
        1_000_001, 2.0
    )  # where a fit to all columns alike, or by slopes alone, ends too late
    tuning = tuned(log, tmp_path)
    assert tuning.trace is not None
    assert tuning.verdict == "ok"
    delay_s = tuning.trace.estimate[log.tune.index("delay/commands=0:0.1")]
    assert abs(delay_s - log.truth["delay/commands"]) < 0.0005


@pytest.mark.parametrize("seed", [1_000_000, 97_000_006])
def test_what_a_log_cannot_tell_is_named(seed: int, tmp_path: Path):
    log = PENDULUM.unidentifiable(seed, 1.0)
    tuning = tuned(log, tmp_path)
    [check] = [one for one in tuning.checks if one.name == "every parameter is identifiable"]
    assert not check.passed
    assert all(address in check.detail for address in log.unidentifiable)
    assert tuning.verdict == "suspect"


@pytest.mark.parametrize(
    "machine",
    [pytest.param(one, marks=[pytest.mark.slow] * (one is not BLOCK)) for one in MACHINES],
    ids=[one.name for one in MACHINES],
)
@pytest.mark.parametrize("most", [1, pytest.param(9, marks=pytest.mark.slow)])
def test_a_model_of_another_machine_is_not_ok(machine: Any, most: int, tmp_path: Path):
    log = machine.log(7, 1.0)
    models: Mapping[str, str] = machine.wrong(log)
    assert models
    for what in list(models)[:most]:
        assert tuned(replace(log, model=models[what]), tmp_path).verdict != "ok", what


def test_a_long_log_of_angles_that_are_cut_to_one_turn_is_tuned(tmp_path: Path):
    seconds = np.arange(0.0, 4.1, 0.0002)  # 20,500 samples; it hangs at 180 degrees
    angles = swing(seconds)[:, :1] + np.pi + 1e-3 * np.random.default_rng(0).normal(size=(20500, 1))
    stamps_ns = START_NS + np.round(1e9 * seconds).astype(np.int64)
    shown = np.mod(angles + np.pi, 2 * np.pi) - np.pi
    states = Signal("/joint_states.position", stamps_ns, shown, ("hinge",), "rad")
    log = Episode(EpisodeInfo(), {states.name: states})
    path = tmp_path / "pendulum.xml"
    path.write_text(MODEL.format(floor="", shapes="").replace("-0.4", "0.4"))
    tuning = tn.tune(log, model=path, parameters=["joint/hinge.damping=0:.2"])
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.interval95 is not None
    low, high = tuning.interval95[0]
    assert low < DAMPING < high < low + 0.005
    assert any("cut to one turn: joined" in words for words in tuning.record.warnings)


def test_a_dry_run_says_what_is_used_and_writes_nothing(command: Command, tmp_path: Path):
    words = ["--model", MODELS / "arm.xml", "--tune", MODELS / "arm.yaml", "--dry-run"]
    result = command("tunenet-tune", MODELS / "arm.mcap", *words, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "/joint_commands.position: commands actuators shoulder, elbow" in result.stdout
    assert "tuned: delay/commands" in result.stdout
    assert not list(tmp_path.iterdir())


SECONDS = np.arange(500) / 100
TRUTH = {"stiffness": 37.0, "damping": 0.3, "initial/cart.position": 1.06}


class Spring:
    """A cart on a spring, seen with its first place measured; too soft a spring breaks at once."""

    engine, step_hz = "by hand", 100.0
    parameters = (
        Parameter("stiffness", "N/m", (0.0, 1e9), (1.0, 100.0), 60.0),
        Parameter("damping", "N·s/m", (0.0, 1e9), (0.0, 2.0), 0.5),
        Parameter("initial/cart.position", "m", (-9.0, 9.0), (0.8, 1.2), 1.0, prior_sd=0.04),
    )

    def rollout(self, values: Mapping[str, float]) -> Episode:
        decay = values["damping"] / 2
        rate = np.sqrt(max(values["stiffness"] - decay**2, 1e-9))
        place = values["initial/cart.position"] * np.exp(-decay * SECONDS) * np.cos(rate * SECONDS)
        if values["stiffness"] < 20:
            place[1:] = np.nan
        stamps = np.round(1e9 * SECONDS).astype(np.int64)
        still = 0.001 * np.sin(SECONDS)
        columns = np.stack([place, still], axis=1)
        return Episode(EpisodeInfo(), {"/cart": Signal("/cart", stamps, columns, ("x", "y"), "m")})


def spring_log() -> Episode:
    """With noise, by which one column tells nothing."""
    clean = Spring().rollout(TRUTH).signals["/cart"]
    noise = 0.005 * np.random.default_rng(3).standard_normal(clean.values.shape)
    signal = replace(clean, stamps_ns=clean.stamps_ns + 10**18, values=clean.values + noise)
    return Episode(EpisodeInfo(), {"/cart": signal})


def noisy(episode: Episode, share: float) -> Episode:
    """With white noise of a share of each signal's spread."""
    rng = np.random.default_rng(3)
    signals: dict[str, Signal] = {}
    for name, one in episode.signals.items():
        noise = share * np.nanstd(one.values, axis=0) * rng.standard_normal(one.values.shape)
        signals[name] = replace(one, values=one.values + noise)
    return Episode(EpisodeInfo(), signals)


BALL = {"restitution": 0.72, "restitution_slope": 0.05, "drag": 0.05}
# What makes a user's object, its truth, noise as a share of what is seen, how far each may be off.
OBJECTS = {
    "a spring": (Spring, TRUTH, 0.0, {"stiffness": 0.1, "damping": 0.01}),
    "our drop": (
        lambda: DropSimulator(DropRig(gap_m=1.0, samples=200)),
        BALL,
        0.005,
        {"restitution": 0.005},
    ),
    "our payload": (
        lambda: PayloadSimulator(jaco(), circle(), (0.01, 0.02, -0.01)),
        {"payload_mass": 0.8},
        0.01,
        {"payload_mass": 0.01},
    ),
}


def test_what_is_left_of_a_column_that_rests_is_not_told():
    record = tn.tune(spring_log(), simulator=Spring()).record
    moves, rests = record.gaps
    assert moves.left == pytest.approx(0.009, abs=0.002)
    assert (rests.delay_s, rests.left) == (None, None)
    assert [row[-1] for row in gaps_table(record).rows] == ["0.93 %", "-"]


@pytest.mark.parametrize("name", OBJECTS)
def test_an_object_of_the_users_is_tuned(name: str):
    make, truth, share, off = OBJECTS[name]
    simulator: Any = make()
    log = noisy(simulator.rollout(truth), share) if share else spring_log()
    tuning = tn.tune(log, simulator=simulator)
    assert tuning.estimate is not None, tuning.reason
    values = tuning.to_frame().value
    for one, most in off.items():
        assert abs(values[one] - truth[one]) < most, one
    if not share:
        assert tuning.verdict == "ok", tuning.reason
        assert list(values.index) == list(off)


@pytest.mark.parametrize("method", ["cma-es", "tpe", "least-squares"])
def test_a_search_finds_what_the_fit_finds(method: str):
    if method != "least-squares":
        pytest.importorskip({"tpe": "optuna", "cma-es": "cma"}[method])
    rollouts, off = (300, (1.5, 0.1)) if method == "tpe" else (400, (0.2, 0.01))
    tuning = tn.tune(spring_log(), simulator=Spring(), method=method, iterations=rollouts)
    values = tuning.to_frame().value
    assert abs(values["stiffness"] - TRUTH["stiffness"]) < off[0]
    assert abs(values["damping"] - TRUTH["damping"]) < off[1]
    assert tuning.rollouts <= rollouts + 1
    assert tuning.verdict == "suspect"
    assert "other values may match as well" in str(tuning.reason)


def test_a_simulator_that_shows_nothing_of_the_log_says_so():
    log = Episode(
        EpisodeInfo(), {"/else": Signal("/else", np.arange(9), np.ones((9, 1)), ("x",), "m")}
    )
    tuning = tn.tune(log, simulator=Spring())
    assert tuning.verdict == "rejected"
    assert "share no signal" in str(tuning.reason)


def test_options_that_do_not_go_together_say_so():
    log = Spring().rollout(TRUTH)
    with pytest.raises(UsageError, match="--model"):
        tn.tune(log, parameters=["joint/a.damping"])
    with pytest.raises(UsageError, match="nothing is to be tuned"):
        tn.tune(log, model=MODELS / "block.xml")
    with pytest.raises(UsageError, match="leave them out"):
        tn.tune(log, simulator=Spring(), task="drop")


def read(tmp_path: Path, text: str | bytes) -> tuple[str, ...]:
    path = tmp_path / "tuned.yaml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return listed_parameters([str(path)])


def test_files_stand_in_their_place(tmp_path: Path):
    path = tmp_path / "tuned.yml"
    path.write_text("joint/elbow.damping: [0, 5]\nbody/tool.mass:\n'a b.c[0]': [-1.5, 1e-3]\n")
    found = listed_parameters(["delay/commands", str(path), "option.density=0:2"])
    assert found == (
        "delay/commands",
        "joint/elbow.damping=0.0:5.0",
        "body/tool.mass",
        "a b.c[0]=-1.5:0.001",
        "option.density=0:2",
    )


MERGED = "a: &a {x: 1}\n" + "".join(
    f"{new}: &{new}\n  <<: [{', '.join([f'*{old}'] * 9)}]\n"
    for old, new in zip("abcdefghij", "bcdefghijk", strict=True)
)


@pytest.mark.parametrize(
    "text",
    [
        "a: &a [0, 1]\nb: [*a, *a]\n",
        "? &a [x, x]\n: [0, 1]\n? [*a, *a]\n: [0, 1]\n",
        MERGED,
        "a: &a [*a, 1]\n",
        "? [[x]]\n: 1\n",
        "x: [0, 1" + "0" * 4000 + "]\n",
        'x: ["0", "5"]\n',
        "x: [false, true]\n",
        "x: [0, 1, 2]\n",
        "x: 5\n",
        "x: " + "[" * 30_000,
        "joint: {elbow: {damping: [0, 5]}}\n",
        "- joint/elbow.damping\n",
        "x: [0, 1]\nx: [0, 2]\n",
        "x: [0, 1]\n---\ny: [0, 1]\n",
        "!!python/object/apply:os.system ['ls']\n",
        "",
        "# nothing\n",
        "{a: [0, 1]\n",
        "x\0: 1\n",
        b"\xff\xfe\xff",
        "x: [0, 1]\n" * 1_000_000,
        "\n".join(f"a{number}: [0, 1]" for number in range(201)),
    ],
)
def test_what_is_no_list_of_addresses_is_one_line(tmp_path: Path, text: str | bytes):
    with pytest.raises(UsageError) as caught:
        read(tmp_path, text)
    line = str(caught.value)
    assert "tuned.yaml" in line
    assert line.isprintable()
    assert len(line) < 500 + len(str(tmp_path))
    assert "joint/elbow.damping: [0, 5]" in (caught.value.remedy or "")


@pytest.mark.parametrize("name", ["gone.yaml", "folder.yaml"])
def test_what_is_no_file_is_one_line(tmp_path: Path, name: str):
    (tmp_path / "folder.yaml").mkdir()
    with pytest.raises(UsageError, match="cannot be read"):
        listed_parameters([str(tmp_path / name)])


# ---- Models of strangers that compile and hurt when they move: each ends in one line.

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


def stranger(folder: Path, world: str = "", option: str = "", memory: str = "") -> Path:
    size = f'<size memory="{memory}"/>' if memory else ""
    path = folder / "stranger.xml"
    path.write_text(
        f'<mujoco>{size}<option timestep="0.004" integrator="implicitfast" {option}/>'
        f"<worldbody>{BOB}{world}</worldbody></mujoco>"
    )
    return path


def tuned_stranger(folder: Path, *parts: str, **more: str) -> Tuning:
    path = stranger(folder, *parts, **more)
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
    found = tuned_stranger(tmp_path, HEAP, memory=memory)
    assert found.verdict == "rejected"
    assert "stranger.xml: its working memory is full after 0." in (found.reason or "")
    assert 'give it more, such as <size memory="10M"/>' in (found.reason or "")


def test_a_full_memory_is_told_at_its_step_however_long_pieces_are(tmp_path: Path):
    """A rollout is made in pieces; where MuJoCo gives up in the middle of one is no chance."""
    places = {
        run(stranger(tmp_path, HEAP, memory="140K"), steps)[0][0] for steps in (100, 301, 999)
    }
    assert len(places) == 1


def test_a_model_that_does_not_end_well_is_not_ok(tmp_path: Path):
    found = tuned_stranger(tmp_path, STIFF)
    assert found.verdict == "rejected"
    (check,) = (one for one in found.checks if one.name == "simulation is whole")
    assert "moves beyond all bounds after 0." in check.detail


def test_pieces_are_one_rollout(tmp_path: Path):
    """With contacts and warm starts, to the bit: as MuJoCo makes it in one go."""
    library, path = mujoco(), stranger(tmp_path, LANDS)
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
        run(stranger(tmp_path, LANDS, slow), 300_000, judged_s=0.1)


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
    words += [str(MODELS / "pendulum.mcap"), "--model", str(stranger(tmp_path, LANDS, ENDLESS))]
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
    found = tuned_stranger(tmp_path, LANDS, ENDLESS)
    assert found.verdict == "rejected"
    assert "takes MuJoCo over 5 s at once" in (found.reason or "")
