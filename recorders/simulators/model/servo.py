"""What a servo has, as parameters: one table, and the part that MuJoCo lacks, step by step.

MuJoCo's actuator has a gain, a damping and a limit, its joint an armature, damping and one dry
friction. A servo's gears also rub with the torque that they carry, more at rest (Stribeck), its
motor brakes as long as it has power, its encoder has a zero, its controller a dead band. Friction
is that of Duclusaud and Passault, "Extended Friction Models for the Physics Simulation of Servo
Actuators" (arXiv:2410.08650), M1 to M4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Limits = tuple[float, float]

# ---- One table: name, unit, bounds, prior, where it is set, how it is written

ACTUATORS = "actuators"  # as a text of `--tune`: every term below of every servo


@dataclass(frozen=True)
class ServoTerm:
    """A quantity of a servo."""

    address: str  # {actuator} and {joint} are names in the model
    unit: str  # of its value
    # What servos of others have, mean and standard deviation, in units of `by`; None if nothing is
    # known. From the fits in Rhoban/bam @ 1b5a1ce, bam/params (XL-320, XL-330, MX-64, MX-106,
    # STS3215), torque limit = kt * supply voltage / R, where nothing else is said.
    usual: tuple[float, float] | None
    by: Literal["its torque limit", "1"] = "1"
    is_base: bool = False  # whether every servo has it; others are added by evidence
    # Why a model's file lacks it, and what comes nearest; "" where it is a field of the model's.
    unwritten: str = ""
    slot: int = -1  # its place in a row of `TABLE`; -1 of a field of the model's

    @property
    def field(self) -> str:
        """Last part of its address."""
        return self.address.rpartition(".")[2]


TABLE = "servo terms"  # custom numeric of a compiled model: a row of slots for each actuator

TERMS: tuple[ServoTerm, ...] = (
    ServoTerm("actuator/{actuator}.kp", "1", None, is_base=True),
    ServoTerm(  # kt² / R and viscous friction: .058 to .18
        "joint/{joint}.damping", "N·m·s/rad", (0.1, 0.07), "its torque limit", is_base=True
    ),
    ServoTerm(  # .0016 to .0085
        "joint/{joint}.armature", "kg·m²", (0.004, 0.004), "its torque limit", is_base=True
    ),
    ServoTerm(  # .008 to .07
        "joint/{joint}.frictionloss", "N·m", (0.02, 0.02), "its torque limit", is_base=True
    ),
    ServoTerm("actuator/{actuator}.forcerange", "N·m", (1.0, 0.5), "its torque limit"),
    ServoTerm(  # M3 and M4: .065 to .22, of the sum of both torques
        "servo/{actuator}.load_friction",
        "1",
        (0.12, 0.06),
        unwritten="MuJoCo has no friction by the torque that a joint carries: frictionloss is "
        "raised by it at {typical:.3g} N·m, half the torque limit",
        slot=0,
    ),
    ServoTerm(  # M4: 0 to .22
        "servo/{actuator}.stribeck_load",
        "1",
        (0.08, 0.06),
        unwritten="MuJoCo has no friction that is larger at rest: left out",
        slot=1,
    ),
    ServoTerm(  # M2: up to .12 N·m of 12.5
        "servo/{actuator}.stribeck",
        "N·m",
        (0.01, 0.01),
        "its torque limit",
        unwritten="MuJoCo has no friction that is larger at rest: left out",
        slot=2,
    ),
    ServoTerm(  # M2 and M4: 1.1 to 4.2; half of that where stick and slip are told
        "servo/{actuator}.stribeck_speed",
        "rad/s",
        (0.7, 0.7),
        unwritten="MuJoCo has no friction that is larger at rest: left out",
        slot=3,
    ),
    ServoTerm(  # kt² / R alone, .053 to .16: told where power goes off, and then of every servo
        "servo/{actuator}.back_emf",
        "N·m·s/rad",
        (0.1, 0.06),
        "its torque limit",
        unwritten="MuJoCo's joints damp with and without power: added to the joint's damping",
        slot=4,
    ),
    ServoTerm(  # a few steps of a 12-bit encoder, and gears' play of a degree
        "servo/{actuator}.dead_band",
        "rad",
        (0.0, 0.015),
        unwritten="MuJoCo's servos have no dead band: left out",
        slot=5,
    ),
    ServoTerm(  # q_offset: .02 to .05
        "servo/{actuator}.zero",
        "rad",
        (0.0, 0.03),
        unwritten="add it to what the encoder shows, and to commands",
    ),
    ServoTerm(
        "delay/commands",
        "s",
        (0.0, 0.02),
        unwritten="a model has no delay: wait so long before each command",
    ),
)
SLOTS = 1 + max(one.slot for one in TERMS)
LOAD, STRIBECK_LOAD, STRIBECK, SPEED, BACK_EMF, DEAD_BAND = range(SLOTS)
# Of a servo's damping what stays without power, where a log does not tell: viscous friction over
# that and kt² / R; .01 to .1 in the same fits, but .15 to .3 by free swings of a real XL-330.
UNPOWERED = 0.2
_EXTRA = 8.0  # standard deviations over the usual mean, up to which a value is looked for


def servos(model: Any) -> list[tuple[int, int]]:
    """List a compiled model's servos: indices of position actuators, and of their joints."""
    mujoco: Any = import_module("mujoco")
    kinds, types = mujoco.mjtTrn, mujoco.mjtJoint
    found: list[tuple[int, int]] = []
    for number in range(model.nu):
        joint = int(model.actuator_trnid[number, 0])
        if model.actuator_trntype[number] != kinds.mjTRN_JOINT:
            continue
        is_one = model.jnt_type[joint] in (int(types.mjJNT_HINGE), int(types.mjJNT_SLIDE))
        has_gain = model.actuator_gaintype[number] == int(mujoco.mjtGain.mjGAIN_FIXED)
        if is_one and has_gain and model.actuator_biasprm[number, 1] < 0:
            found.append((number, joint))
    return found


def torque_limit(model: Any, actuator: int) -> float:
    """Return a servo's torque limit [N·m]; without one, what its gain makes of half a radian."""
    if model.actuator_forcelimited[actuator]:
        return float(np.abs(model.actuator_forcerange[actuator]).max())
    return 0.5 * abs(float(model.actuator_gainprm[actuator, 0]))


def all_terms(model: Any) -> dict[str, tuple[ServoTerm, int]]:
    """Return every term of every servo by its address, with the actuator's index."""
    found: dict[str, tuple[ServoTerm, int]] = {}
    for actuator, joint in servos(model):
        names = {"actuator": model.actuator(actuator).name, "joint": model.joint(joint).name}
        if all(names.values()):
            for term in TERMS:
                found.setdefault(term.address.format(**names), (term, actuator))
    return found


def moved_joints(model: Any) -> dict[str, str]:
    """Return the joint that each servo's term moves most, and its start; {} if a joint has none."""
    joints = {actuator: model.joint(joint).name for actuator, joint in servos(model)}
    if len(set(joints.values())) < model.nv:  # what swings freely is moved by all others
        return {}
    terms = {
        address: joints[actuator]
        for address, (term, actuator) in all_terms(model).items()
        if "{" in term.address
    }
    parts = ("position", "velocity")
    return terms | {f"initial/{one}.{part}": one for one in joints.values() for part in parts}


NO_LIMIT = 1e6  # torque limit of a servo that has none [N·m]


def neutral(model: Any, term: ServoTerm, actuator: int, given: float) -> float:
    """Return the value at which a servo is as the model has it; `given` is the model's own."""
    if term.field == "forcerange" and not model.actuator_forcelimited[actuator]:
        return NO_LIMIT
    return given


def expected(model: Any, term: ServoTerm, actuator: int) -> tuple[float, float] | None:
    """Return mean and standard deviation of what servos of this size have; None if unknown."""
    if term.usual is None:
        return None
    by = torque_limit(model, actuator) if term.by == "its torque limit" else 1.0
    return term.usual[0] * by, term.usual[1] * by


def search_range(term: ServoTerm, usual: tuple[float, float] | None, given: float) -> Limits:
    """Return where a term's value is looked for, which holds the model's own."""
    if usual is None:
        return given / 10, given * 10
    mean, sd = usual
    lows = {"zero": -_EXTRA * sd, "forcerange": 0.02 * mean}
    low = lows.get(term.field, 0.0)
    return min(low, given), max(mean + _EXTRA * sd, 2 * given)


def put_table(spec: Any) -> None:
    """Give a spec the numeric that holds the terms of its actuators."""
    size = max(SLOTS * len(list(spec.actuators)), 1)
    spec.add_numeric(name=TABLE, size=size, data=[0.0] * size)


def table_of(model: Any) -> NDArray[np.float64] | None:
    """Return a compiled model's terms, a view of shape (nu, SLOTS); None if it has none."""
    mujoco: Any = import_module("mujoco")
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_NUMERIC, TABLE)
    if number < 0 or not model.nu:
        return None
    first = int(model.numeric_adr[number])
    return model.numeric_data[first : first + SLOTS * model.nu].reshape(-1, SLOTS)


def nearest(values: Mapping[str, float], model: Any) -> dict[str, float]:
    """Return what is added to a model's own fields in place of terms that it lacks, by address."""
    added: dict[str, float] = {}
    for address, (term, actuator) in all_terms(model).items():
        value = values.get(address, 0.0)
        joint = model.joint(int(model.actuator_trnid[actuator, 0])).name
        if term.slot == BACK_EMF and value:
            added[f"joint/{joint}.damping"] = value
        elif term.slot == LOAD and value:
            added[f"joint/{joint}.frictionloss"] = value * typical_torque(values, model, actuator)
    return added


def unwritten(address: str, values: Mapping[str, float], model: Any) -> str:
    """Say why a model's file lacks a term, and what comes nearest; "" of a model's own field."""
    for term in TERMS:
        if term.address == address:  # of the whole model, as a delay is
            return term.unwritten
    if not address.startswith("servo/"):
        return ""
    term, actuator = all_terms(model)[address]
    return term.unwritten.format(typical=typical_torque(values, model, actuator))


def typical_torque(values: Mapping[str, float], model: Any, actuator: int) -> float:
    """Return half a servo's torque limit, the tuned one where there is one [N·m]."""
    name = f"actuator/{model.actuator(actuator).name}.forcerange"
    return 0.5 * values.get(name, torque_limit(model, actuator))


# ---- Stepping: what MuJoCo lacks, by its own fields, set anew before each step


class ServoSteps:
    """Steps a model with the terms of its servos, and with power that goes on and off.

    Friction by load takes the torques of the step before; as in Rhoban/bam, the gears carry the
    difference of the motor's and of what gravity and motion put on the joint.
    """

    def __init__(self, model: Any, data: Any) -> None:
        self._step = import_module("mujoco").mj_step
        self._model, self._data = model, data
        # Views, which stay valid: to ask for one costs as much as a step.
        self._qpos, self._qvel, self._ctrl = data.qpos, data.qvel, data.ctrl
        self._made, self._bias = data.qfrc_actuator, data.qfrc_bias
        self._frictions, self._dampings = model.dof_frictionloss, model.dof_damping
        table = table_of(model)
        rows = np.zeros((model.nu, SLOTS)) if table is None else table
        self._servos: list[tuple[Any, ...]] = []
        for actuator, joint in servos(model):
            dof, place = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
            gear = float(model.actuator_gear[actuator, 0])
            load, stribeck_load, stribeck, slow, brake, dead_band = rows[actuator].tolist()
            friction, rest = float(model.dof_frictionloss[dof]), float(model.dof_damping[dof])
            motor = brake  # of the gears' load; where a log does not tell it, all of the damping
            if not brake and table is not None:
                motor, brake, rest = rest, (1.0 - UNPOWERED) * rest, UNPOWERED * rest
            rubs = load, stribeck_load, stribeck, max(slow, 1e-3)
            self._servos.append(
                (actuator, dof, place, gear, friction, *rubs, rest, brake, motor, dead_band)
            )
        self._gains = model.actuator_gainprm.copy(), model.actuator_biasprm.copy()
        self._powered = np.ones(model.nu, np.bool_)

    def power(self, is_on: NDArray[np.bool_]) -> None:
        """Switch actuators, shape (nu,): without power one has neither force nor brake."""
        if np.array_equal(is_on, self._powered):
            return
        self._powered = is_on.copy()
        gains, biases = self._gains
        self._model.actuator_gainprm[:] = np.where(is_on[:, None], gains, 0.0)
        self._model.actuator_biasprm[:] = np.where(is_on[:, None], biases, 0.0)

    def step(self) -> None:
        """Step once, with the controls and efforts that are in the data."""
        for servo in self._servos:
            actuator, dof, place, gear, friction, load, stribeck_load, stribeck, slow, *rest = servo
            damping, brake, motor, dead_band = rest
            if brake:
                brake, motor = (brake, motor) if self._powered[actuator] else (0.0, 0.0)
                self._dampings[dof] = damping + brake
            if load or stribeck_load or stribeck:
                speed = self._qvel.item(dof)
                carried = abs(self._made.item(dof) - motor * speed + self._bias.item(dof))
                at_rest = math.exp(-min(abs(speed) / slow, 700.0))
                rubs = load + stribeck_load * at_rest
                self._frictions[dof] = friction + stribeck * at_rest + rubs * carried
            if dead_band:
                length = gear * float(self._qpos[place])
                off = float(self._ctrl[actuator]) - length
                inside = min(abs(off), dead_band)
                self._ctrl[actuator] = length + off - math.copysign(inside, off)
        self._step(self._model, self._data)


def needs_steps(model: Any, switches: Sequence[int]) -> bool:
    """Return whether a rollout has to be stepped here: for terms, or power that goes off."""
    table = table_of(model)
    return bool(len(switches)) or (table is not None and bool(table.any()))
