"""Simulate a block that slides over the floor until friction has stopped it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from analysis.evaluation.sysid.model_log import (
    GRAVITY_M_S2,
    STATES_HZ,
    ModelLog,
    Sensed,
    recorded,
    sample_times,
)
from analysis.evaluation.sysid.pendulum import EARTH
from tunenet_logs.arrays import Array

FRICTION, MASS = "geom/block.friction[0]", "body/block.mass"
POSE = "/block/pose"

MAX_FRICTION = 1.2  # that is looked for
_TUNE = (f"{FRICTION}=0.02:{MAX_FRICTION}",)
_NOISE_M = 1e-3
_MASS_KG = 1.5
_HALF_HEIGHT_M = 0.03
_REST_S = 1.0

# Of two geoms that touch, MuJoCo takes the larger friction. Its contacts push a sliding block off
# the floor, by friction times speed times damping over stiffness, and let it creep before it stops,
# by more the less they damp: this floor is stiff, damps little, and lets it creep by 0.15 mm at a
# friction of 0.65. A long step and a high impratio make it hop.
BLOCK = """\
<mujoco model="block on a floor">
  <option timestep="0.00025" cone="elliptic" impratio="0.1" gravity="{gravity}"/>
  <default>
    <geom solref="-60000 -150" solimp="0.999 0.999 0.0001 0.5 2"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1" friction="0.01 0.005 0.0001"/>
    <body name="block" pos="0 0 0.03">
      <freejoint name="block"/>
      <geom name="block" type="box" size="0.2 0.2 0.03" mass="{mass}" friction="1 0.005 0.0001"/>
    </body>
  </worldbody>
</mujoco>
"""


@dataclass(frozen=True, eq=False)
class SlidingBlock:
    """Block that slides without turning.

    Attributes:
        friction: Coulomb's coefficient.
        start_m: where it is at 0 s, x and y, shape (2,).
        velocity_m_s: then, shape (2,).
    """

    friction: float
    start_m: Array
    velocity_m_s: Array

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> SlidingBlock:
        """Draw a block."""
        friction = float(np.exp(rng.uniform(np.log(0.1), np.log(0.7))))
        along, aside = rng.uniform(0.5, 2.5), rng.uniform(-0.1, 0.1)
        return cls(friction, rng.uniform(-0.5, 0.5, 2), along * np.array([1.0, aside]))

    @property
    def stops_s(self) -> float:
        """Time at which it has come to rest [s]."""
        return float(np.linalg.norm(self.velocity_m_s)) / (self.friction * GRAVITY_M_S2)

    def at(self, seconds: Array) -> Array:
        """Return positions of its centre in closed form, shape (T, 3) [m]."""
        slid_s = np.minimum(seconds, self.stops_s)[:, None]
        flat_m = self.start_m + self.velocity_m_s * (slid_s - slid_s**2 / (2 * self.stops_s))
        return np.column_stack([flat_m, np.full(len(seconds), _HALF_HEIGHT_M)])


def block_log(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate a slide and a second of rest, of which friction is tuned."""
    rng = np.random.default_rng((seed, 4))
    block = SlidingBlock.drawn(rng)
    seconds = sample_times(block.stops_s + _REST_S, STATES_HZ, rng)
    sensed = {POSE: Sensed(seconds, block.at(seconds), ("x", "y", "z"), "m", _NOISE_M)}
    episode, clean, sizes = recorded(sensed, noise, rng)
    truth = {FRICTION: block.friction}
    return ModelLog(episode, truth, block_model(), _TUNE, (), clean, sizes)


def block_of_unknown_mass(seed: int, noise: float = 1.0) -> ModelLog:
    """Simulate the same with the mass tuned as well, which is unidentifiable."""
    log = block_log(seed, noise)
    truth = {**log.truth, MASS: _MASS_KG}
    tune = (*_TUNE, f"{MASS}=0.2:5")
    model = block_model(mass_kg=1.0)
    return ModelLog(log.episode, truth, model, tune, (MASS,), log.clean, log.noise)


def block_model(*, gravity: str = EARTH, mass_kg: float = _MASS_KG) -> str:
    """Return the MJCF text of an owner's model; gravity of three numbers [m/s²]."""
    return BLOCK.format(gravity=gravity, mass=mass_kg)
