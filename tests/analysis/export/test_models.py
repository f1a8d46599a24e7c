"""Tunings of models of one's own: the model's file, and values with ranges and a joint sample."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

import tunenet_logs as tn
from tests.analysis.sysid.pendulums import model_source, pendulum_episode
from tests.conftest import ROOT, Command
from tunenet_logs.analysis.evaluation.worlds.servos import NAME, servo_log
from tunenet_logs.analysis.export.model import joint_sample, tuned_simulator
from tunenet_logs.analysis.presentation import page_todo
from tunenet_logs.analysis.record import Estimate, Posterior, read_record, to_json
from tunenet_logs.analysis.sysid.source import ModelSource
from tunenet_logs.episode import Array
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.mujoco import mujoco

WANTED = ("joint/hinge.damping=0:.2",)


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, tn.Tuning]:
    """A folder with a pendulum's model and its tuning."""
    folder = tmp_path_factory.mktemp("pendulum")
    path = model_source(folder).path
    tuning = tn.tune(pendulum_episode(), model=path, parameters=WANTED)
    assert tuning.verdict == "ok", tuning.reason
    (folder / "run.json").write_text(to_json(tuning.record))
    return folder, tuning


def copied(tuned: tuple[Path, tn.Tuning], folder: Path) -> Path:
    """Return the tuning in a copy of the folder, its model beside it."""
    shutil.copytree(tuned[0], folder / "copy")
    path = folder / "copy" / "run.json"
    data = json.loads(path.read_text())
    data["provenance"]["model"]["path"] = "elsewhere/pendulum.xml"
    path.write_text(json.dumps(data))
    return path


def test_the_exported_model_moves_as_the_tuned_one_along_the_log(
    tuned: tuple[Path, tn.Tuning], tmp_path: Path
):
    folder, tuning = tuned
    [path] = tn.export(tuning, "mjcf", tmp_path / "any.xml", model=folder / "pendulum.xml")
    assert tuning.estimate is not None
    before = ModelSource(folder / "pendulum.xml", WANTED).connect(pendulum_episode())
    after = ModelSource(path, ("joint/hinge.armature=0:.2",)).connect(pendulum_episode())
    rest = [one.initial for one in before.simulator.parameters[1:]]
    [first] = before.rollouts(np.array([[*tuning.estimate, *rest]]))
    [second] = after.rollouts(np.array([[0.0, *rest]]))
    assert first.signals.keys() == second.signals.keys()
    for name, signal in first.signals.items():
        assert signal.values.tobytes() == second.signals[name].values.tobytes()


def test_a_command_says_what_is_in_the_file(
    tuned: tuple[Path, tn.Tuning], command: Command, tmp_path: Path
):
    tuning = copied(tuned, tmp_path)
    record = read_record(tuning)
    assert command("tunenet-export", tuning, "--to", "mjcf").returncode == 0
    result = command("tunenet-export", tuning, "--to", "mjcf")  # replaces the first
    assert result.returncode == 0, result.stderr
    path = tuning.with_name("pendulum.tuned.xml")
    assert result.stdout.splitlines()[0] == f"written: {path}"
    assert "move alike to the last bit" in result.stdout
    text = path.read_text()
    [known] = record.estimates
    assert f'damping="{known.value!r}"' in text
    assert "<!-- tunenet-export: joint/hinge.damping = 0.0" in text
    assert "N·m·s/rad (95 %: " in text
    assert "was 0; from episode; ok -->" in text
    assert "--to mjcf" in page_todo(record, tuning).lines[0]


def test_what_is_not_done_is_refused_for_its_reason(
    tuned: tuple[Path, tn.Tuning], command: Command, tmp_path: Path
):
    tuning = copied(tuned, tmp_path)
    model = tuning.with_name("pendulum.xml")

    def said(*words: object) -> str:
        result = command("tunenet-export", tuning, *words)
        assert result.returncode == 2, result.stdout
        [line] = result.stderr.splitlines()
        return line

    assert "is an MJCF" in said("--to", "urdf")
    assert "of a simulator of your own" in said("--to", "mujoco")
    assert "is for a ball" in said("--to", "mjcf", "--mass", 2)
    assert "is the model itself" in said("--to", "mjcf", "-o", model)
    assert "a name that ends .xml" in said("--to", "mjcf", "-o", "a.urdf")
    other = model.with_name("pendulum.tuned.xml")
    other.write_text("mine")
    assert "is no export" in said("--to", "mjcf", "-o", other)
    assert other.read_text() == "mine"
    other.unlink()
    shutil.move(model, tmp_path / "moved.xml")
    assert "is not found from here" in said("--to", "mjcf")
    assert "is not found from here" in command("tunenet-export", tuning, "--to", "yaml").stdout
    text = (tmp_path / "moved.xml").read_text()
    model.write_text(text.replace('mass="1"', 'mass="1.1"'))
    assert "has changed since it was tuned" in said("--to", "mjcf")
    model.write_text(text.replace("<body", "<!-- a remark -->\n<body"))
    assert command("tunenet-export", tuning, "--to", "mjcf").returncode == 0


def test_a_delay_alone_has_no_place_in_a_model(command: Command, tmp_path: Path):
    arm = ROOT / "sample_logs" / "models"
    words = ["--model", arm / "arm.xml", "--tune", "delay/commands=0:0.1", "-o", tmp_path]
    result = command("tunenet-tune", arm / "arm.mcap", *words, "--no-review", "--method", "fit")
    assert result.returncode == 0, result.stderr
    result = command("tunenet-export", tmp_path / "arm.json", "--to", "mjcf")
    assert result.returncode == 2
    assert "not written: delay/commands = " in result.stderr
    assert not list(arm.glob("*.tuned.xml"))


def test_values_for_randomising_a_simulator(
    tuned: tuple[Path, tn.Tuning], command: Command, tmp_path: Path
):
    tuning = copied(tuned, tmp_path)
    result = command("tunenet-export", tuning, "--to", "yaml")
    assert result.returncode == 0, result.stderr
    data = YAML(typ="safe").load(tuning.with_name("run.card.yaml").read_text())
    arrays = np.load(tuning.with_name("run.card.npz"))
    [known] = read_record(tuning).estimates
    name, ends = known.name, known.components[0].interval95
    assert ends is not None
    low, high = ends
    assert data["values"][name]["value"] == known.value
    assert data["randomisation"]["ranges"] == {name: [low, high]}
    assert arrays["names"].tolist() == [name]
    sample = arrays["sample"][:, 0]
    assert data["randomisation"]["sample"] == arrays["sample"][:100].tolist()
    assert abs(np.mean((sample > low) & (sample < high)) - 0.95) < 0.03
    # MuJoCo's own array has each row's value in its place.
    assert np.array_equal(arrays["mujoco.dof_damping"], arrays["sample"])
    assert arrays.files[0] == "origin"
    assert command("tunenet-export", tuning, "--to", "yaml").returncode == 0  # known as ours


def test_a_joint_sample_has_the_posteriors_correlations_and_bounds(tuned: tuple[Path, tn.Tuning]):
    record = tuned[1].record
    assert record.posterior is not None
    [one] = record.estimates
    both = (one, Estimate("other", "kg", 0.001, (0.0, 0.02)))
    searched = ((0.0, 0.2), (0.0, 0.005))
    wide = Posterior(
        (0.01, 0.01), ((1.0, 0.9), (0.9, 1.0)), ((-1.0, 1.0), (0.0, 1.0)), searched, ("other",)
    )

    def rows(posterior: Posterior) -> Array:
        changed = replace(record, estimates=both, posterior=posterior, provenance=None)
        found = joint_sample(tuned_simulator(changed, "run.json"), 20_000)
        assert found.shape == (20_000, 2)
        return found

    assert np.all((rows(wide)[:, 1] >= 0) & (rows(wide)[:, 1] <= 0.005))  # as was searched
    free = rows(replace(wide, bounds=((-1.0, 1.0), (-1.0, 1.0)), unidentifiable=()))
    assert np.allclose(free.std(axis=0), 0.01, rtol=0.03)
    assert abs(np.corrcoef(free[:, 0], free[:, 1])[0, 1] - 0.9) < 0.01


def test_without_intervals_there_is_no_sample(
    tuned: tuple[Path, tn.Tuning], command: Command, tmp_path: Path
):
    tuning = copied(tuned, tmp_path)
    data = json.loads(tuning.read_text())
    data |= {"verdict": "suspect", "reason": "the model is another"}
    data["parameters"]["joint/hinge.damping"]["interval95"] = None
    del data["posterior"]
    tuning.write_text(json.dumps(data))
    result = command("tunenet-export", tuning, "--to", "yaml")
    assert result.returncode == 0, result.stderr
    assert "no ranges and no sample: the model is another" in result.stdout
    assert not tuning.with_name("run.card.npz").exists()
    found = YAML(typ="safe").load(tuning.with_name("run.card.yaml").read_text())
    assert found["randomisation"] is None
    with pytest.raises(UsageError, match="no intervals"):
        joint_sample(tuned_simulator(read_record(tuning), "run.json"))
    result = command("tunenet-export", tuning, "--to", "mjcf")
    assert "(no reliable interval)" in tuning.with_name("pendulum.tuned.xml").read_text()
    assert "the tuning is suspect: the model is another" in result.stderr


def test_a_servos_terms_are_written_as_the_nearest_that_a_model_has(tmp_path: Path):
    """What MuJoCo lacks is named, and friction by load is in the dry friction in its place."""
    log = next(one for one in map(servo_log, range(20)) if one.truth[f"servo/{NAME}.load_friction"])
    model = tmp_path / "servo.xml"
    model.write_text(log.model)
    terms = [f"actuator/{NAME}.kp", f"actuator/{NAME}.forcerange", "delay/commands"]
    terms += [f"joint/{NAME}.{field}" for field in ("damping", "frictionloss")]
    tuning = tn.tune(log.episode, model=model, parameters=[*terms, f"servo/{NAME}.load_friction"])
    assert tuning.estimate is not None
    names = [one.name for one in tuning.parameters]
    values = dict(zip(names, map(float, tuning.estimate), strict=True))
    [path] = tn.export(tuning, "mjcf", tmp_path / "any.xml", model=model)
    written = mujoco().MjModel.from_xml_path(str(path))
    assert written.actuator_gainprm[0, 0] == values[f"actuator/{NAME}.kp"]
    assert written.actuator_biasprm[0, 1] == -values[f"actuator/{NAME}.kp"]
    limit = values[f"actuator/{NAME}.forcerange"]
    np.testing.assert_allclose(written.actuator_forcerange[0], [-limit, limit])
    assert written.dof_damping[0] == values[f"joint/{NAME}.damping"]
    rubs = values[f"joint/{NAME}.frictionloss"]
    rubs += values[f"servo/{NAME}.load_friction"] * limit / 2
    assert written.dof_frictionloss[0] == pytest.approx(rubs)
    text = path.read_text()
    for name in (f"servo/{NAME}.load_friction", "delay/commands"):
        assert f"not written: {name} = " in text
