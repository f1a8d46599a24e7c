"""Simulate the payload task: an arm moves along a path with an unknown mass."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np

from recorders.simulators.arm.description import Arm, Payload
from recorders.simulators.arm.dynamics import UPRIGHT_GRAVITY_M_S2, joint_efforts_nm
from recorders.simulators.arm.path import JointPath
from recorders.simulators.arm.rollout import CALIBRATED, RolloutSettings, roll_out
from recorders.simulators.base import Parameter
from recorders.simulators.engines import engine
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import UsageError

TOPIC = "/joint_states"
PAYLOAD_MASS = Parameter(
    name="payload_mass", unit="kg", bounds=(0.0, 20.0), training_range=(0.0, 1.0), initial=0.5
)


class PayloadSimulator:
    """Torques along a path by inverse dynamics.

    They are linear in the mass, to which its inertia is proportional, so two runs of the engine
    serve all masses.
    """

    parameters = (PAYLOAD_MASS,)

    def __init__(
        self,
        arm: Arm,
        path: JointPath,
        com_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        gravity_m_s2: tuple[float, float, float] = UPRIGHT_GRAVITY_M_S2,
    ) -> None:
        self.arm = arm
        self.path = path.checked(arm)
        self.com_m = com_m
        self.gravity_m_s2 = gravity_m_s2
        self.engine = engine().name
        self.step_hz = 1 / float(np.median(np.diff(path.seconds)))

    @cached_property
    def empty_efforts_nm(self) -> Array:
        """Torques without a payload [N·m], shape (T, J)."""
        return joint_efforts_nm(self.arm, self.path, None, self.gravity_m_s2)

    @cached_property
    def efforts_nm_per_kg(self) -> Array:
        """Torques added by each kilogram [N·m/kg], shape (T, J)."""
        one = Payload(1.0, self.com_m)
        loaded = joint_efforts_nm(self.arm, self.path, one, self.gravity_m_s2)
        return loaded - self.empty_efforts_nm

    def efforts_nm(self, mass_kg: float) -> Array:
        """Compute the torques with a payload [N·m], shape (T, J).

        Raises:
            UsageError: a mass that no arm holds.
        """
        return self.empty_efforts_nm + PAYLOAD_MASS.checked(mass_kg) * self.efforts_nm_per_kg

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Move with `values["payload_mass"]`; see `Simulator.rollout`."""
        payload = _payload(values, self.com_m)
        info = payload_info(payload, f"{self.engine}, inverse dynamics", "default")
        return Episode(info, joint_signals(self.arm, self.path, self.efforts_nm(payload.mass_kg)))


class PayloadRollout:
    """Motor torques of a rollout in the engine, as the paper's authors made them.

    Args:
        path: at `settings.times()`.
        com_m: the payload's centre of mass in the tool frame.
        settings: of engine and motors.
        keep_every: decimation of the steps: 4 makes 60 Hz of 240.
    """

    parameters = (PAYLOAD_MASS,)

    def __init__(
        self,
        arm: Arm,
        path: JointPath,
        com_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
        settings: RolloutSettings = CALIBRATED,
        keep_every: int = 4,
    ) -> None:
        self.arm = arm
        self.path = path
        self.com_m = com_m
        self.settings = settings
        self.keep_every = keep_every
        self.engine = engine().name
        self.step_hz = settings.step_hz

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Move with `values["payload_mass"]`; see `Simulator.rollout`."""
        payload = _payload(values, self.com_m)
        recorded = roll_out(self.arm, self.path, payload, self.settings)
        kept = slice(None, None, self.keep_every)
        path = recorded.path.part(kept)
        info = payload_info(payload, f"{self.engine}, rollout", self.settings.name)
        return Episode(info, joint_signals(self.arm, path, recorded.effort_nm[kept]))


def joint_signals(arm: Arm, path: JointPath, effort_nm: Array) -> dict[str, Signal]:
    """Make a path's position, velocity and effort signals, named as in `/joint_states`."""
    stamps_ns = np.round((path.seconds - path.seconds[0]) * 1e9).astype(np.int64)
    return {
        f"{TOPIC}.{part}": Signal(f"{TOPIC}.{part}", stamps_ns, values, arm.joint_names, unit)
        for part, values, unit in (
            ("position", path.position_rad, "rad"),
            ("velocity", path.velocity_rad_s, "rad/s"),
            ("effort", effort_nm, "N·m"),
        )
    }


def payload_info(
    payload: Payload, source: str, preset: str, notes: Mapping[str, str] | None = None
) -> EpisodeInfo:
    """Make the log info of a simulated payload."""
    truth = {PAYLOAD_MASS.name: payload.mass_kg}
    truth |= {
        f"payload_com_{axis}": value for axis, value in zip("xyz", payload.com_m, strict=True)
    }
    return EpisodeInfo(kind="payload", source=source, preset=preset, truth=truth, notes=notes or {})


def _payload(values: Mapping[str, float], com_m: tuple[float, float, float]) -> Payload:
    if set(values) != {PAYLOAD_MASS.name}:
        raise UsageError(f"an arm takes the value {PAYLOAD_MASS.name}, not {sorted(values)}")
    return Payload(PAYLOAD_MASS.checked(values[PAYLOAD_MASS.name]), com_m)
