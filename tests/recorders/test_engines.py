"""The border to the physics engines: another one is a module and one line."""

from __future__ import annotations

import math

import numpy as np
import pytest

from recorders.simulators.arm.description import jaco
from recorders.simulators.arm.path import circle
from recorders.simulators.arm.payload import PayloadSimulator
from recorders.simulators.base import ENGINES, Engine, engine
from recorders.simulators.bounce_shot import BounceShot
from recorders.simulators.contact import CALIBRATED, PAPER
from recorders.simulators.drop import TOPIC, DropRig, DropSimulator
from recorders.simulators.pybullet import engine as bullet
from recorders.simulators.shot.rig import ShotRig

RIG = DropRig(gap_m=1.0, rate_hz=240.0, samples=300)


@pytest.mark.parametrize("restitution", [0.3, 0.6, 0.9, 1.0])
def test_a_drop_runs_in_another_engine(monkeypatch: pytest.MonkeyPatch, restitution: float):
    monkeypatch.setitem(ENGINES, "toy", "tests.recorders.toy_engine")
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
    assert simulator.engine == episode.info.source == "toy 1.0"


def test_every_engine_offers_what_the_protocol_names():
    offered: Engine = bullet  # pyright compares the signatures
    assert engine() is offered
    for known in ENGINES:
        assert engine(known).name.startswith(known)


def test_simulators_say_their_engine_and_their_steps():
    drop, paper = DropSimulator(RIG), DropSimulator(DropRig(), PAPER)
    assert (drop.engine, drop.step_hz) == (engine().name, 240.0)
    assert paper.step_hz == 60.0
    shot = BounceShot(ShotRig(), height_m=0.5, rate_hz=240.0)
    assert shot.step_hz == 720.0
    assert shot.rollout({"restitution": 0.7}).info.source == shot.engine
    arm = PayloadSimulator(jaco(), circle(60.0))
    assert arm.step_hz == pytest.approx(60.0)
    assert arm.rollout({"payload_mass": 0.5}).info.source == f"{arm.engine}, inverse dynamics"
