"""`--engine`: which engine simulates is chosen, printed and recorded, in worker processes too."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.conftest import Command
from tests.engines import needs_pybullet
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.known import ENGINE_VARIABLE, ENGINES, engine

CHOICES = [pytest.param("pybullet", marks=needs_pybullet), "mujoco"]


@pytest.mark.parametrize("name", CHOICES)
def test_what_simulates_is_printed_and_recorded(command: Command, tmp_path: Path, name: str):
    version = engine(name).name
    log = tmp_path / "a.mcap"
    what = ("--simulate", "drop", "--restitution", 0.7, "--height", 1)
    made = command("tunenet-record", *what, "--engine", name, "-o", log)
    assert made.returncode == 0, made.stderr
    assert f"by {version}; " in made.stdout
    assert read_episode(log).info.source == version
    tuned = command("tunenet-tune", log, "--engine", name, "--quiet")
    assert tuned.returncode == 0, tuned.stderr
    assert f"\nsimulated by {version}\n" in tuned.stdout
    report = json.loads(log.with_suffix(".json").read_text())
    assert report["simulator"]["engine"] == report["provenance"]["engine"] == version
    assert report["parameters"]["restitution"]["value"] == pytest.approx(0.7, abs=1e-4)
    plan = command("tunenet-plan", log.with_suffix(".json"), "--engine", name)
    assert f"in {version} it " in plan.stdout


@pytest.mark.parametrize("kind", ["payload", "bounce-shot"])
def test_an_arm_and_a_shot_too(command: Command, tmp_path: Path, kind: str):
    log = tmp_path / "a.mcap"
    made = command("tunenet-record", "--simulate", kind, "--engine", "mujoco", "-o", log)
    assert made.returncode == 0, made.stderr
    assert read_episode(log).info.source.startswith("mujoco ")


def test_workers_take_the_engine_of_the_command(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The paper's simulator is PyBullet's: a worker that refuses it is one of MuJoCo."""
    monkeypatch.delenv(ENGINE_VARIABLE, raising=False)
    weights = tmp_path / "a.safetensors"
    words = ("drop", "--preset", "paper", "--pairs", 10, "--epochs", 1, "-o", weights)
    refused = command("tunenet-train", *words, "--jobs", 2, "--engine", "mujoco", "--quiet")
    assert refused.returncode == 2
    assert refused.stderr == (
        "tunenet-train: the preset paper is PyBullet's own behaviour, not MuJoCo's; take "
        "--engine pybullet, or --preset default\n"
    )
    assert not weights.exists()


def test_what_simulates_nothing_takes_no_engine(command: Command, tmp_path: Path):
    camera = ("--camera", "film.mp4", "--engine", "mujoco", "-o", tmp_path / "a.mcap")
    refused = command("tunenet-record", *camera)
    assert refused.returncode == 2
    assert "--engine does not go with --camera; leave it out" in refused.stderr
    unknown = command("tunenet-tune", "a.mcap", "--engine", "gazebo")
    assert unknown.returncode == 2
    assert all(name in unknown.stderr for name in ENGINES)
