"""Simulate a ball over a plane in MuJoCo, with restitution by contact stiffness and damping.

A contact's reference acceleration is -b v, with b the damping and v the speed of the surfaces
towards each other. With no stiffness, an impedance near 1 and b = (1 + e) / h, one step of length
h turns v into -e v: the restitution that is set is the one that is got. What moves across the
surface is damped likewise; there, friction in the cone takes at most its coefficient times the
normal impulse.
"""

from __future__ import annotations

import numpy as np

from recorders.simulators.contact import CALIBRATED, IMPACT_S, OVERLAP_M, ContactSettings
from recorders.simulators.installed import named_version
from recorders.simulators.mujoco.library import mujoco
from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError

# `solimp` of a contact that is as hard as MuJoCo makes one, at every depth.
IMPEDANCE = (0.9999, 0.9999, 0.001, 0.5, 2.0)

_MODEL = """
<mujoco>
  <option gravity="0 0 {gravity!r}" cone="elliptic"/>
  <worldbody>
    <geom name="plane" type="plane" size="0 0 1"/>
    <body>
      <freejoint/>
      <geom name="ball" type="sphere" size="{radius!r}" mass="1"/>
    </body>
  </worldbody>
  <contact>
    <pair geom1="plane" geom2="ball" condim="3" friction="0 0 0 0 0" solimp="{impedance}"/>
  </contact>
</mujoco>
"""


class MujocoBallWorld:
    """A MuJoCo model of a plane and a ball; see `recorders.simulators.base.BallWorld`.

    Raises:
        UsageError: contacts that only another engine can reproduce.
    """

    def __init__(self, radius_m: float, contact: ContactSettings) -> None:
        if contact.name != CALIBRATED.name:
            raise UsageError(
                f"the preset {contact.name} is PyBullet's own behaviour, not MuJoCo's; take "
                "--engine pybullet, or --preset default"
            )
        self.engine = named_version("mujoco")
        self.radius_m = radius_m
        self.contact = contact
        self._model = mujoco().MjModel.from_xml_string(
            _MODEL.format(
                gravity=-contact.gravity_m_s2,
                radius=radius_m,
                impedance=" ".join(map(repr, IMPEDANCE)),
            )
        )
        self._data = mujoco().MjData(self._model)
        self._reset, self._step = mujoco().mj_resetData, mujoco().mj_step
        self._derive = mujoco().mj_setConst
        self._position, self._velocity = self._data.qpos, self._data.qvel
        self._damping = self._model.pair_solref
        self._restitution = 0.0

    def place(self, gap_m: float, restitution: float) -> None:
        """See `BallWorld`; the solver begins anew, too."""
        self._reset(self._model, self._data)
        self._position[2] = self.radius_m + gap_m
        self._restitution = restitution

    def set_restitution(self, restitution: float) -> None:
        """See `BallWorld`."""
        self._restitution = restitution

    def set_speed(self, speed_m_s: float) -> None:
        """See `BallWorld`."""
        self._velocity[:] = 0.0, 0.0, speed_m_s, 0.0, 0.0, 0.0

    def step(self, period_s: float) -> tuple[float, float]:
        """See `BallWorld`."""
        self._take(period_s)
        self._step(self._model, self._data)
        return float(self._position[2]), float(self._velocity[2])

    def steps(self, period_s: float, count: int) -> list[float]:
        """See `BallWorld`."""
        self._take(period_s)
        step, model, data, position = self._step, self._model, self._data, self._position
        heights_m: list[float] = []
        for _ in range(count):
            step(model, data)
            heights_m.append(position[2])
        return [float(height_m) for height_m in heights_m]

    def impact(
        self,
        velocity_m_s: Array,
        spin_rad_s: Array,
        restitution: float,
        friction: float,
        inertia_share: float,
    ) -> tuple[Array, Array]:
        """See `BallWorld`.

        MuJoCo solves the push and the friction as one convex problem, in which slip that is left
        lifts the ball. So slip is damped by what Coulomb's law takes of it, and none is left over.
        """
        self.place(-OVERLAP_M, restitution)
        moment = inertia_share * self.radius_m**2
        if self._model.body_inertia[1, 0] != moment:
            self._model.body_inertia[1] = moment
            self._derive(self._model, self._data)
            self.place(-OVERLAP_M, restitution)
        self._model.pair_friction[0, :2] = friction
        slip_m_s = velocity_m_s + np.cross(spin_rad_s, [0.0, 0.0, -self.radius_m])
        taken = friction * (1 + restitution) * max(-float(velocity_m_s[2]), 0.0)
        share = taken * (1 + 1 / inertia_share) / max(float(np.hypot(*slip_m_s[:2])), 1e-12)
        self._model.pair_solreffriction[0] = 0.0, -min(share, 1.0) / IMPACT_S
        self._velocity[:3], self._velocity[3:] = velocity_m_s, spin_rad_s
        self.step(IMPACT_S)
        return self._velocity[:3].copy(), self._velocity[3:].copy()

    def _take(self, period_s: float) -> None:
        self._model.opt.timestep = period_s
        self._damping[0] = 0.0, -(1 + self._restitution) / period_s
