"""Machines that SciPy integrates, found in their logs by their owners' models and by objects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tunenet_logs as tn
from tests.analysis.sysid.pendulums import DAMPING, MODEL, START_NS, swing
from tests.conftest import ROOT, Command
from tests.same_log import assert_same_log
from tunenet_logs.analysis.evaluation.worlds.machines import MACHINES, ModelLog
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import jaco
from tunenet_logs.recorders.simulators.arm.path import circle
from tunenet_logs.recorders.simulators.arm.payload import PayloadSimulator
from tunenet_logs.recorders.simulators.ball import DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import Parameter

MODELS = ROOT / "sample_logs" / "models"
PENDULUM, ARM, BLOCK = MACHINES


def tuned(log: ModelLog, folder: Path, **more: object) -> Tuning:
    path = folder / "model.xml"
    path.write_text(log.model)
    said = {"model": path, "parameters": log.tune, **more}
    return tn.tune(log.episode, **said)  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("name", "off"),
    [
        ("pendulum", (0.0015, 0.006, 0.0002)),
        ("arm", (0.002, 0.0005)),
        ("block", (0.004,)),
    ],
)
def test_a_sample_is_found_within_its_intervals(
    name: str, off: tuple[float, ...], command: Command, tmp_path: Path
):
    from tunenet_logs.analysis.evaluation.worlds.machines import SEEDS

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
    from tunenet_logs.analysis.evaluation.worlds.machines import write_samples

    write_samples(tmp_path)
    for path in tmp_path.iterdir():
        if path.suffix == ".mcap":
            assert_same_log(path, MODELS / path.name)
        else:
            assert path.read_bytes() == (MODELS / path.name).read_bytes(), path.name


@pytest.mark.parametrize("seed", [1_000_001, 1_000_003])
def test_efforts_that_jump_with_each_command_trap_no_delay(seed: int, tmp_path: Path):
    log = ARM.log(seed, 2.0)  # where a fit to all columns alike, or by slopes alone, ends too late
    tuning = tuned(log, tmp_path)
    assert tuning.trace is not None
    assert tuning.verdict == "ok"
    delay_s = tuning.trace.estimate[log.tune.index("delay/commands=0:0.1")]
    assert abs(delay_s - log.truth["delay/commands"]) < 0.0005


def test_what_a_log_cannot_tell_is_named(tmp_path: Path):
    log = PENDULUM.unidentifiable(1_000_000, 1.0)
    tuning = tuned(log, tmp_path)
    [check] = [one for one in tuning.checks if one.name == "every parameter is identifiable"]
    assert not check.passed
    assert all(address in check.detail for address in log.unidentifiable)
    assert tuning.verdict == "suspect"


@pytest.mark.parametrize(
    "machine",
    [
        pytest.param(PENDULUM, marks=pytest.mark.slow, id="pendulum"),
        pytest.param(BLOCK, id="block"),
    ],
)
def test_a_model_of_another_machine_is_not_ok(machine: object, tmp_path: Path):
    assert machine in MACHINES
    log = machine.log(7, 1.0)  # pyright: ignore[reportAttributeAccessIssue]
    models: Mapping[str, str] = machine.wrong(log)  # pyright: ignore[reportAttributeAccessIssue]
    assert models
    for what, text in models.items():
        assert tuned(replace(log, model=text), tmp_path).verdict != "ok", what


class Spring:
    """A cart on a spring, in a closed form: an object as a user would write it."""

    engine, step_hz = "by hand", 100.0
    parameters = (
        Parameter("stiffness", "N/m", (0.0, 1e4), (1.0, 100.0), 10.0),
        Parameter("damping", "N·s/m", (0.0, 1e3), (0.0, 2.0), 0.5),
    )

    def rollout(self, values: Mapping[str, float]) -> Episode:
        seconds = np.arange(500) / 100
        decay = values["damping"] / 2
        rate = np.sqrt(max(values["stiffness"] - decay**2, 1e-9))
        place = np.exp(-decay * seconds) * np.cos(rate * seconds)
        stamps = np.round(1e9 * seconds).astype(np.int64)
        return Episode(
            EpisodeInfo(), {"/cart": Signal("/cart", stamps, place[:, None], ("x",), "m")}
        )


def noisy(episode: Episode, share: float, start_ns: int = 0) -> Episode:
    """With white noise of a share of each signal's spread, by a clock that begins elsewhere."""
    rng = np.random.default_rng(3)
    signals: dict[str, Signal] = {}
    for name, one in episode.signals.items():
        noise = share * np.nanstd(one.values, axis=0) * rng.standard_normal(one.values.shape)
        signals[name] = replace(one, stamps_ns=one.stamps_ns + start_ns, values=one.values + noise)
    return Episode(EpisodeInfo(), signals)


def test_an_object_of_the_users_is_tuned():
    log = noisy(Spring().rollout({"stiffness": 37.0, "damping": 0.3}), 0.02, 10**18)
    tuning = tn.tune(log, simulator=Spring())
    assert tuning.verdict == "ok", tuning.reason
    frame = tuning.to_frame()
    assert abs(frame.value["stiffness"] - 37) < 0.1
    assert abs(frame.value["damping"] - 0.3) < 0.01


def test_our_drop_is_such_an_object():
    simulator = DropSimulator(DropRig(gap_m=1.0, samples=200))
    truth = {"restitution": 0.72, "restitution_slope": 0.05, "drag": 0.05}
    log = simulator.rollout(truth)
    tuning = tn.tune(noisy(log, 0.005), simulator=simulator)
    assert tuning.estimate is not None, tuning.reason
    assert abs(tuning.estimate[0] - 0.72) < 0.005


def test_our_payload_is_such_an_object():
    simulator = PayloadSimulator(jaco(), circle(), (0.01, 0.02, -0.01))
    log = simulator.rollout({"payload_mass": 0.8})
    tuning = tn.tune(noisy(log, 0.01), simulator=simulator)
    assert tuning.estimate is not None, tuning.reason
    assert abs(tuning.estimate[0] - 0.8) < 0.01


def test_a_long_log_of_angles_that_are_cut_to_one_turn_is_tuned(tmp_path: Path):
    seconds = np.arange(0.0, 4.1, 0.0002)  # 20,500 samples; it hangs at 180 degrees
    angles = swing(seconds)[:, :1] + np.pi + 1e-3 * np.random.default_rng(0).normal(size=(20500, 1))
    stamps_ns = START_NS + np.round(1e9 * seconds).astype(np.int64)
    shown = np.mod(angles + np.pi, 2 * np.pi) - np.pi
    log = Episode(
        EpisodeInfo(),
        {
            "/joint_states.position": Signal(
                "/joint_states.position", stamps_ns, shown, ("hinge",), "rad"
            )
        },
    )
    path = tmp_path / "pendulum.xml"
    path.write_text(MODEL.format(floor="", shapes="").replace("-0.4", "0.4"))
    tuning = tn.tune(log, model=path, parameters=["joint/hinge.damping=0:.2"])
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.interval95 is not None
    low, high = tuning.interval95[0]
    assert low < DAMPING < high < low + 0.005
    assert any("cut to one turn: joined" in words for words in tuning.record.warnings)


def test_a_simulator_that_shows_nothing_of_the_log_says_so():
    log = Episode(
        EpisodeInfo(), {"/else": Signal("/else", np.arange(9), np.ones((9, 1)), ("x",), "m")}
    )
    tuning = tn.tune(log, simulator=Spring())
    assert tuning.verdict == "rejected"
    assert "share no signal" in str(tuning.reason)


def test_options_that_do_not_go_together_say_so():
    log = Spring().rollout({"stiffness": 37.0, "damping": 0.3})
    with pytest.raises(UsageError, match="--model"):
        tn.tune(log, parameters=["joint/a.damping"])
    with pytest.raises(UsageError, match="nothing is to be tuned"):
        tn.tune(log, model=MODELS / "block.xml")
    with pytest.raises(UsageError, match="leave them out"):
        tn.tune(log, simulator=Spring(), task="drop")


def test_a_dry_run_says_what_is_used_and_writes_nothing(command: Command, tmp_path: Path):
    words = ["--model", MODELS / "arm.xml", "--tune", MODELS / "arm.yaml", "--dry-run"]
    result = command("tunenet-tune", MODELS / "arm.mcap", *words, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "/joint_commands.position: commands actuators shoulder, elbow" in result.stdout
    assert "tuned: delay/commands" in result.stdout
    assert not list(tmp_path.iterdir())
