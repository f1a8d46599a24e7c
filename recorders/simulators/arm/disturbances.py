"""Errors of sensors, model and timing between ideal torques and a driver's messages."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace

import numpy as np

from recorders.simulators.arm.description import Arm
from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError

_MAX = 1e6  # of any size, in its own unit: what is larger is not a disturbance but infinite
_NEVER_NEGATIVE = (
    "torque_noise_nm",
    "lag_s",
    "jitter_s",
    "position_noise_rad",
    "position_step_rad",
    "velocity_noise_rad_s",
)


@dataclass(frozen=True)
class FieldClock:
    """Update rate of each field of a message [Hz]; inf: new in every message."""

    position_hz: float = math.inf
    velocity_hz: float = math.inf
    effort_hz: float = math.inf

    def __post_init__(self) -> None:
        for item in fields(self):
            if not getattr(self, item.name) > 0:
                raise UsageError(f"{item.name} is over 0, not {getattr(self, item.name):g}")


# Measured in a log of 65 messages a second: between new values the old ones are repeated.
KINOVA_CLOCK = FieldClock(position_hz=30.0, velocity_hz=16.0, effort_hz=58.0)


@dataclass(frozen=True)
class Disturbances:
    """Errors between ideal torques and a driver's messages; none by default.

    What is drawn for each joint is a tuple, base to tool; empty for none.

    Attributes:
        torque_noise_nm: standard deviation, white.
        offset_nm: added to each joint's torque.
        viscous_nm_s: viscous friction [N·m s/rad].
        coulomb_nm: Coulomb friction.
        gain_error: 0.03 for a torque read 3 % too large.
        lag_s: delay of the torques.
        link_mass_error: 0.05 for a link 5 % heavier than the description says.
        link_com_error_m: offset of its centre of mass, (x, y, z).
        rate_hz: messages a second; None for one at each of the path's samples.
        jitter_s: standard deviation of a message's time.
        clock: update rates of the fields.
        position_noise_rad: standard deviation, white.
        position_step_rad: quantisation step of positions; 0 for none.
        velocity_noise_rad_s: standard deviation, white.
        noise_seed: of what is drawn anew for each sample.

    Raises:
        UsageError: a value is not finite or out of range.
    """

    torque_noise_nm: float = 0.0
    offset_nm: tuple[float, ...] = ()
    viscous_nm_s: tuple[float, ...] = ()
    coulomb_nm: tuple[float, ...] = ()
    gain_error: tuple[float, ...] = ()
    lag_s: float = 0.0
    link_mass_error: tuple[float, ...] = ()
    link_com_error_m: tuple[tuple[float, float, float], ...] = ()
    rate_hz: float | None = None
    jitter_s: float = 0.0
    clock: FieldClock = field(default_factory=FieldClock)
    position_noise_rad: float = 0.0
    position_step_rad: float = 0.0
    velocity_noise_rad_s: float = 0.0
    noise_seed: int = 0

    def __post_init__(self) -> None:
        for item in fields(self):
            values = np.ravel(getattr(self, item.name))
            if item.name in ("rate_hz", "clock", "noise_seed"):
                continue
            if not np.all(np.abs(values.astype(np.float64)) <= _MAX):
                raise UsageError(f"{item.name} {getattr(self, item.name)} is not finite")
        for name in _NEVER_NEGATIVE:
            if getattr(self, name) < 0:
                raise UsageError(f"{name} {getattr(self, name):g} is below 0")
        if self.rate_hz is not None and not 1 <= self.rate_hz <= 20_000:
            raise UsageError(f"rate_hz {self.rate_hz:g} is not from 1 to 20000")

    @property
    def lead_s(self) -> float:
        """Duration of the path that precedes the first message [s]."""
        clock = self.clock
        slowest_hz = min(clock.position_hz, clock.velocity_hz, clock.effort_hz)
        return self.lag_s + 1 / slowest_hz + 4 * self.jitter_s

    def another_run(self) -> Disturbances:
        """Copy with the noise redrawn, as for another run of the same arm (tare)."""
        return replace(self, noise_seed=self.noise_seed + 1)

    def in_words(self) -> dict[str, str]:
        """Describe the disturbances for a log's notes."""
        words: dict[str, str] = {}
        for item in fields(self):
            value = getattr(self, item.name)
            if value == item.default or item.name in ("clock", "noise_seed") or value == ():
                continue
            words[item.name] = ", ".join(f"{number:.6g}" for number in np.ravel(value).tolist())
        if self.clock != FieldClock():
            clock = self.clock
            rates_hz = (clock.position_hz, clock.velocity_hz, clock.effort_hz)
            words["fields_hz"] = ", ".join(f"{rate_hz:g}" for rate_hz in rates_hz)
        return words


@dataclass(frozen=True)
class DisturbanceScales:
    """Standard deviations of the disturbances, 0 for none; by default a real arm's.

    Attributes:
        friction_nm: of viscous friction [N·m s/rad] and of Coulomb friction [N·m].
        most_lag_s: lags are drawn uniformly from 0 to this.
        friction_opposes: friction is drawn against the motion; else of either sign.
    """

    torque_noise_nm: float = 0.2
    offset_nm: float = 0.3
    friction_nm: float = 0.5
    gain_error: float = 0.03
    most_lag_s: float = 0.03
    link_mass_error: float = 0.05
    link_com_error_m: float = 0.003
    friction_opposes: bool = True


REAL_ARM = DisturbanceScales()
NO_ERRORS = DisturbanceScales(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def drawn(seed: int, arm: Arm, sizes: DisturbanceScales = REAL_ARM) -> Disturbances:
    """Draw one arm's disturbances from a seed: of torques, and of the arm's description.

    The same seed draws the same for every combination of sizes, scaled.
    """
    rng = np.random.default_rng([seed, 0xD217])
    count = len(arm.joints)
    offset, viscous, coulomb, gain, mass = rng.normal(0.0, 1.0, (5, count))
    com, lag_fraction = rng.normal(0.0, 1.0, (count, 3)), rng.uniform()
    if sizes.friction_opposes:
        viscous, coulomb = np.abs(viscous), np.abs(coulomb)

    def scaled(values: Array, size: float) -> tuple[float, ...]:
        return tuple((size * values).tolist()) if size else ()

    com_m = tuple((x, y, z) for x, y, z in (sizes.link_com_error_m * com).tolist())
    return Disturbances(
        torque_noise_nm=sizes.torque_noise_nm,
        offset_nm=scaled(offset, sizes.offset_nm),
        viscous_nm_s=scaled(viscous, sizes.friction_nm),
        coulomb_nm=scaled(coulomb, sizes.friction_nm),
        gain_error=scaled(gain, sizes.gain_error),
        lag_s=float(sizes.most_lag_s * lag_fraction),
        link_mass_error=scaled(np.clip(mass, -4, 4), sizes.link_mass_error),
        link_com_error_m=com_m if sizes.link_com_error_m else (),
        noise_seed=2 * seed,
    )


def through_kinovas_driver(disturbances: Disturbances, rate_hz: float = 65.0) -> Disturbances:
    """Add a Kinova driver's jitter, stale fields and quantised positions.

    At 20 messages a second and fewer every field is new in each.
    """
    return replace(
        disturbances,
        rate_hz=rate_hz,
        jitter_s=min(0.0015, 0.1 / rate_hz),
        clock=KINOVA_CLOCK if rate_hz > 20 else FieldClock(),
        position_noise_rad=2e-4,
        position_step_rad=1e-4,
        velocity_noise_rad_s=0.01,
    )


def real_driver(seed: int, arm: Arm, rate_hz: float = 65.0) -> Disturbances:
    """Draw all disturbances of a real driver."""
    return through_kinovas_driver(drawn(seed, arm), rate_hz)
