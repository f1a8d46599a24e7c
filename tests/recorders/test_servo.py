"""What a servo has beyond MuJoCo's: named, stepped, seen, and written as what comes nearest."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tunenet_logs.analysis.evaluation.worlds.servos import (
    LIMIT_N_M,
    MODEL,
    NAME,
    Servo,
)
from tunenet_logs.analysis.sysid.source import ModelSource
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.model.parameters import model_parameters
from tunenet_logs.recorders.simulators.model.servo import TERMS, all_terms, nearest
from tunenet_logs.recorders.simulators.mujoco import mujoco

SECONDS = np.arange(0.0, 3.0, 0.01)
COMMANDS = 0.9 * np.sin(3 * SECONDS) * np.minimum(SECONDS, 1.0)
BASE = {
    f"actuator/{NAME}.kp": 2.0,
    f"actuator/{NAME}.forcerange": LIMIT_N_M,
    f"joint/{NAME}.damping": 0.05,
    f"joint/{NAME}.armature": 0.003,
    f"joint/{NAME}.frictionloss": 0.02,
}


def log(**more: Array) -> Episode:
    stamps = (SECONDS * 1e9).astype(np.int64)
    signals = {
        "/joint_states.position": np.zeros_like(SECONDS),
        "/joint_commands.position": COMMANDS,
        **more,
    }
    made = {
        name: Signal(name, stamps, values[:, None], (NAME,), "rad" if "joint" in name else "1")
        for name, values in signals.items()
    }
    return Episode(EpisodeInfo(), made)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> ModelSource:
    path: Path = tmp_path_factory.mktemp("servo") / "servo.xml"
    path.write_text(MODEL)
    return ModelSource(path, ("actuators",))


def rolled(source: ModelSource, episode: Episode, **terms: float) -> Array:
    """Roll out a servo with some terms; the others are not there."""
    values = dict.fromkeys(all_terms(source.model), 0.0) | BASE
    values |= {f"servo/{NAME}.{name}": value for name, value in terms.items()}
    simulator = source.connect(episode).simulator
    starts = {f"initial/{NAME}.{what}": 0.0 for what in ("position", "velocity")}
    known = {one.name for one in simulator.parameters}
    values |= {name: value for name, value in starts.items() if name in known}
    return simulator.rollout(values).signals["/joint_states.position"].values[:, 0]


def test_every_term_of_a_servo_is_named_once_with_what_is_usual(source: ModelSource) -> None:
    tuned = source.tuned
    assert len(tuned) == len(TERMS) == len({one.parameter.name for one in tuned})
    for one in tuned:
        low, high = one.parameter.training_range
        least, most = one.parameter.bounds
        assert least <= low < high <= most
        assert low <= one.parameter.initial <= high
        assert one.parameter.usual is None or one.parameter.usual[1] > 0


@pytest.mark.parametrize(
    "terms",
    [
        {},
        {"load_friction": 0.2},
        {"load_friction": 0.1, "stribeck_load": 0.15, "stribeck_speed": 0.5},
        {"zero": 0.05},
    ],
)
def test_a_servo_moves_as_another_integrator_says(
    source: ModelSource, terms: dict[str, float]
) -> None:
    servo = Servo(kp=2.0, damping=0.05, armature=0.003, frictionloss=0.02, **terms)
    wanted = servo.moved(SECONDS, SECONDS, COMMANDS)
    # Let it settle first: its start is another where gravity pulls at a turned zero.
    off = (rolled(source, log(), **terms) - wanted)[50:]
    assert np.sqrt(np.mean(off**2)) < 0.001
    assert np.ptp(wanted) > 0.5


def test_a_term_changes_what_moves(source: ModelSource) -> None:
    plain = rolled(source, log())
    for terms in (
        {"load_friction": 0.1},
        {"stribeck": 0.05, "stribeck_speed": 1.0},
        {"dead_band": 0.05},
        {"zero": 0.05},
        {"back_emf": 0.05},
    ):
        assert np.abs(rolled(source, log(), **terms) - plain).max() > 0.01, terms


def test_a_servo_without_power_swings_freely(source: ModelSource) -> None:
    power = (SECONDS < 1.3).astype(np.float64)
    held = rolled(source, log())
    free = rolled(source, log(torque_enable=power), back_emf=0.045)
    with_power = SECONDS < 1.29
    assert np.abs(free - held)[~with_power].max() > 0.2
    # The load comes to hang below, whatever is commanded.
    assert np.abs(free[-50:]).max() < 0.05
    assert np.abs(held[-50:]).max() > 0.5


def test_names_that_are_no_part_of_a_servo_are_refused(source: ModelSource) -> None:
    for text in (f"servo/{NAME}.backlash", "servo/elbow.zero", "servo/.zero"):
        with pytest.raises(UsageError, match="names no part of a servo"):
            model_parameters(source.model, [text])
    bare = mujoco().MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='a'/><geom size='.1'/></body></worldbody>"
        "<actuator><motor joint='a'/></actuator></mujoco>"
    )
    with pytest.raises(UsageError, match="no <position> actuator"):
        model_parameters(bare, ["actuators"])


def test_what_mujoco_lacks_is_added_to_what_it_has(source: ModelSource) -> None:
    values = {f"servo/{NAME}.load_friction": 0.2, f"servo/{NAME}.back_emf": 0.03}
    model: Any = source.model
    assert nearest(values, model) == {
        f"joint/{NAME}.frictionloss": pytest.approx(0.2 * LIMIT_N_M / 2),
        f"joint/{NAME}.damping": 0.03,
    }
    assert nearest({}, model) == {}
