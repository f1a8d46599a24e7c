"""The rig of a bounce shot: ball, inclined plane, hoop, and the robot's reach.

The origin is where the ball touches the plane. x points horizontally towards the hoop, down the
plane, y to the left, z up.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields, replace

import numpy as np

from recorders.simulators.balls import Ball
from recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.arrays import Array
from tunenet_logs.errors import UsageError

Range = tuple[float, float]

NULLABLE = ("ball.mass_kg", "ball.drag_1_m")  # what need not be known
_LIMITS: dict[str, dict[str, Range]] = {
    "ball": {
        "radius_m": (0.002, 0.5),
        "mass_kg": (1e-4, 50.0),
        "drag_coefficient": (0.01, 3.0),
        "inertia_share": (0.2, 0.7),
        "drag_1_m": (0.0, 10.0),
    },
    "plane": {
        "incline_deg": (0.0, 80.0),
        "downhill_m": (0.001, 10.0),
        "friction": (0.0, 5.0),
    },
    "hoop": {
        "forward_m": (0.01, 10.0),
        "up_m": (-10.0, 10.0),
        "free_radius_m": (0.002, 5.0),
        "rim_m": (0.0005, 0.5),
        "restitution": (0.0, 1.0),
        "friction": (0.0, 5.0),
    },
    "release": {
        "lowest_m": (0.005, 50.0),
        "highest_m": (0.005, 50.0),
        "height_sd_m": (0.0, 0.5),
    },
}


@dataclass(frozen=True)
class ShotBall:
    """The ball.

    Attributes:
        mass_kg: for the air's drag; None to leave the air out, unless `drag_1_m` is known.
        drag_coefficient: Cd; .47 is a smooth sphere's at these speeds.
        inertia_share: moment of inertia over m r^2: 2/5 if it is solid, 2/3 if it is a thin shell.
        drag_1_m: deceleration by the air over speed squared, where it was measured; None to have it
            from size, mass and coefficient.
    """

    radius_m: float = 0.03
    mass_kg: float | None = 0.040
    drag_coefficient: float = 0.47
    inertia_share: float = 0.4
    drag_1_m: float | None = None

    @property
    def air_drag_1_m(self) -> float:
        """Quadratic drag [1/m], measured or computed; 0 without a mass."""
        return self.body.drag_1_m or 0.0 if self.drag_1_m is None else self.drag_1_m

    @property
    def body(self) -> Ball:
        """The ball's size, mass and drag coefficient."""
        return Ball(2 * self.radius_m, self.mass_kg, self.drag_coefficient)


@dataclass(frozen=True)
class Plane:
    """The inclined plane.

    Attributes:
        incline_deg: from the horizontal, down towards the hoop.
        downhill_m: how far it goes on from the impact point, along its slope.
        friction: Coulomb's coefficient between ball and plane.
    """

    incline_deg: float = 25.0
    downhill_m: float = 0.15
    friction: float = 0.25

    @property
    def normal(self) -> Array:
        """Unit vector out of the plane, shape (3,)."""
        tilt = math.radians(self.incline_deg)
        return np.array([math.sin(tilt), 0.0, math.cos(tilt)])

    @property
    def downhill(self) -> Array:
        """Unit vector down the plane, shape (3,)."""
        tilt = math.radians(self.incline_deg)
        return np.array([math.cos(tilt), 0.0, -math.sin(tilt)])


@dataclass(frozen=True)
class Hoop:
    """A horizontal hoop, its rim a torus.

    Attributes:
        forward_m: its centre from the impact point, horizontally.
        up_m: likewise, vertically; negative where it is below.
        free_radius_m: of the opening.
        rim_m: thickness of the rim.
        restitution: of the ball on the rim.
        friction: likewise.
    """

    forward_m: float = 0.45
    up_m: float = -0.10
    free_radius_m: float = 0.066
    rim_m: float = 0.005
    restitution: float = 0.6
    friction: float = 0.25

    @property
    def center_m(self) -> Array:
        """Centre of the hoop, shape (3,)."""
        return np.array([self.forward_m, 0.0, self.up_m])

    @property
    def ring_radius_m(self) -> float:
        """Radius to the rim's centre line."""
        return self.free_radius_m + self.rim_m / 2


@dataclass(frozen=True)
class Release:
    """Heights from which the ball can be released.

    A height is how far the ball falls until it touches the plane: 0 where the gripper holds it
    against the impact point.

    Attributes:
        lowest_m: smallest height.
        highest_m: largest height.
        height_sd_m: standard deviation of the robot's heights.
    """

    lowest_m: float = 0.25
    highest_m: float = 0.85
    height_sd_m: float = 0.002


@dataclass(frozen=True)
class ShotRig:
    """The complete rig.

    Raises:
        UsageError: a value is not finite, out of range, or contradicts another; names it as the
            rig's file does ("hoop.forward_m").
    """

    ball: ShotBall = field(default_factory=ShotBall)
    plane: Plane = field(default_factory=Plane)
    hoop: Hoop = field(default_factory=Hoop)
    release: Release = field(default_factory=Release)
    gravity_m_s2: float = GRAVITY_M_S2

    def __post_init__(self) -> None:
        if not 0.1 <= self.gravity_m_s2 <= 100:
            raise UsageError(f"gravity_m_s2 {self.gravity_m_s2:g} is not from 0.1 to 100")
        for part, limits in _LIMITS.items():
            one = getattr(self, part)
            for item in fields(one):
                _check(f"{part}.{item.name}", getattr(one, item.name), limits[item.name])
        if self.release.lowest_m >= self.release.highest_m:
            raise UsageError(
                f"release.lowest_m {self.release.lowest_m:g} is not below release.highest_m "
                f"{self.release.highest_m:g}"
            )
        if self.hoop.free_radius_m <= self.ball.radius_m:
            raise UsageError(
                f"hoop.free_radius_m {self.hoop.free_radius_m:g} lets no ball of ball.radius_m "
                f"{self.ball.radius_m:g} through; make the hoop wider"
            )
        _check_apart(self)
        try:
            _ = self.ball.body
        except UsageError as error:
            raise UsageError(f"ball.mass_kg: {error}") from error

    def with_drag(self, drag_1_m: float) -> ShotRig:
        """Copy the rig with another air drag on its ball [1/m]."""
        return replace(self, ball=replace(self.ball, drag_1_m=drag_1_m))

    @property
    def touch_m(self) -> Array:
        """The ball's centre where it first touches the plane, shape (3,)."""
        return self.ball.radius_m * self.plane.normal


def _check(name: str, value: float | None, limits: Range) -> None:
    if value is None and name in NULLABLE:
        return
    low, high = limits
    if value is None or not (math.isfinite(value) and low <= value <= high):
        told = "missing" if value is None else f"{value:g}"
        raise UsageError(f"{name} {told} is not a number from {low:g} to {high:.6g}")


def _check_apart(rig: ShotRig) -> None:
    """Check that the hoop is clear of the ball's fall, from the highest release."""
    hoop, ball = rig.hoop, rig.ball
    across = abs(hoop.forward_m - float(rig.touch_m[0]))
    highest_m = float(rig.touch_m[2]) + rig.release.highest_m
    near_m = math.hypot(max(across - hoop.ring_radius_m, 0.0), max(hoop.up_m - highest_m, 0.0))
    if near_m <= ball.radius_m + hoop.rim_m:
        raise UsageError(
            f"hoop.forward_m {hoop.forward_m:g}: the hoop hangs in the ball's way to the plane; "
            "move it away"
        )
