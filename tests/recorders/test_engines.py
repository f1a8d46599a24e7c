"""The border to the physics engines: another one is a module and one line."""

from __future__ import annotations

import math
import os

import numpy as np
import pytest

from tests.engines import HAS_PYBULLET, needs_pybullet
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.arm.description import jaco
from tunenet_logs.recorders.simulators.arm.path import circle
from tunenet_logs.recorders.simulators.arm.payload import PayloadSimulator
from tunenet_logs.recorders.simulators.ball import TOPIC, DropRig, DropSimulator
from tunenet_logs.recorders.simulators.base import CALIBRATED, Engine
from tunenet_logs.recorders.simulators.known import ENGINE_VARIABLE, ENGINES, engine, simulated_by
from tunenet_logs.recorders.simulators.shot import BounceShot, ShotRig

RIG = DropRig(gap_m=1.0, rate_hz=240.0, samples=300)


@pytest.mark.parametrize("restitution", [0.3, 0.6, 0.9, 1.0])
def test_a_drop_runs_in_another_engine(monkeypatch: pytest.MonkeyPatch, restitution: float):
    monkeypatch.setitem(ENGINES, "toy", "tunenet_logs.analysis.evaluation.studies.engines")
    simulator = DropSimulator(RIG, CALIBRATED, engine("toy").ball_world(RIG.radius_m, CALIBRATED))
    episode = simulator.rollout({"restitution": restitution})
    heights_m = episode.signals[TOPIC].values[:, 2] - RIG.radius_m
    fall_s = math.sqrt(2 * RIG.gap_m / CALIBRATED.gravity_m_s2)
    seconds = np.arange(RIG.samples) / RIG.rate_hz - fall_s
    inside = (seconds > 0.2 * restitution * fall_s) & (seconds < 1.8 * restitution * fall_s)
    # A flight between two impacts is z = v t - g t^2 / 2: each sample gives its v.
    t = seconds[inside]
    speeds = heights_m[inside] / t + CALIBRATED.gravity_m_s2 * t / 2
    found = speeds / (CALIBRATED.gravity_m_s2 * fall_s)
    assert found == pytest.approx(np.full(len(t), restitution), abs=1e-3)
    assert simulator.engine == episode.info.source == "exact 1.0"


@needs_pybullet
def test_every_engine_offers_what_the_protocol_names():
    from tunenet_logs.recorders.simulators import mujoco
    from tunenet_logs.recorders.simulators import pybullet as bullet

    offered: tuple[Engine, Engine] = (bullet, mujoco)  # pyright compares the signatures
    assert [one.name.split()[0] for one in offered] == list(ENGINES)


def test_the_first_that_is_installed_is_the_default():
    assert engine() is engine("pybullet" if HAS_PYBULLET else "mujoco")


def test_one_is_chosen_for_a_block_and_the_processes_in_it():
    before = engine().name
    with simulated_by("mujoco"):
        assert engine().name.startswith("mujoco ")
        with simulated_by(None):
            assert os.environ[ENGINE_VARIABLE] == "mujoco"
    assert engine().name == before
    assert ENGINE_VARIABLE not in os.environ


@pytest.mark.parametrize("name", ["gazebo", "", "MuJoCo"])
def test_an_engine_that_is_none_is_named(monkeypatch: pytest.MonkeyPatch, name: str):
    monkeypatch.setenv(ENGINE_VARIABLE, name or "no")
    with pytest.raises(UsageError, match=r"no engine is named '.*'; there is: pybullet, mujoco"):
        engine()


def test_an_engine_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(ENGINES, "absent", "tests.recorders.absent_engine")
    with pytest.raises(UsageError, match="absent is not installed; pip install absent"):
        engine("absent")


def test_simulators_say_their_engine_and_their_steps(each_engine: str):
    drop = DropSimulator(RIG)
    assert (drop.engine, drop.step_hz) == (engine().name, 240.0)
    shot = BounceShot(ShotRig(), height_m=0.5, rate_hz=240.0)
    assert shot.step_hz == 720.0
    assert shot.rollout({"restitution": 0.7}).info.source == f"{shot.engine}, bounce shot"
    arm = PayloadSimulator(jaco(), circle(60.0))
    assert arm.step_hz == pytest.approx(60.0)
    assert arm.rollout({"payload_mass": 0.5}).info.source == f"{arm.engine}, inverse dynamics"
    assert {drop.engine, shot.engine, arm.engine} == {engine(each_engine).name}
    assert drop.engine.startswith(f"{each_engine} ")
