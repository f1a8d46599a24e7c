"""What is exported: a ball's contact or a payload's inertia, and where each number comes from."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from analysis.checks import Verdict
from analysis.motion import Curves, Equivalents
from analysis.record import Estimate
from recorders.simulators.arm.rigid_bodies import Inertial, solid_sphere
from recorders.simulators.base import GRAVITY_M_S2
from recorders.simulators.speed_law import SpeedLaw

_MOST_LOST = 0.99
"""Of the fall's energy, to the air: what is closer to the terminal speed tells no height."""

Source = Literal["record", "option", "assumed"]
"""Who says a number: the tuning, the user, or nobody."""


@dataclass(frozen=True)
class Sourced:
    """A number, and who says it.

    Attributes:
        value: in the unit that the field's name has.
        source: who says it.
    """

    value: float
    source: Source


@dataclass(frozen=True)
class ExportOrigin:
    """Where an exported record comes from. Texts are a stranger's, each one line: see `comments`.

    Attributes:
        log: the file's name.
        reason: why the verdict is not "ok"; None if it is.
        log_sha256: of the log; "" where it is not known.
        date: when it was tuned, ISO 8601; "" where it is not known.
        version: of this package, that exports.
        tuned_by: the version that tuned; "" where it is not known.
    """

    log: str
    verdict: Verdict
    reason: str | None
    log_sha256: str
    date: str
    version: str
    tuned_by: str


@dataclass(frozen=True, eq=False)
class ObservedDrop:
    """What was seen, to hold an engine's own drop against.

    Attributes:
        curves: observed heights.
        impact_s: the first impact, on the curves' clock.
        last_s: the last impact that was seen.
    """

    curves: Curves
    impact_s: float
    last_s: float


@dataclass(frozen=True, eq=False)
class ExportedBall:
    """A ball that bounces, for an engine that knows one restitution and no air.

    Attributes:
        restitution: what an engine is told, from 0 to 1.
        meaning: of that number, in words.
        speed_m_s: of the impact that it is meant for.
        tuned: the restitution at the first impact, as it was tuned.
        law: the restitution at every speed, as it was tuned; relative to `first_speed_m_s`.
        first_speed_m_s: of the recorded first impact; None where the log does not tell it.
        slope: of the law; None where it was not told.
        drag: of the air [1/m]; None where it was not told.
        equivalents: for simulators without air; None where the record has none.
        radius_m: of the ball.
        mass_kg: of the ball.
        drop_height_m: of its underside over the floor, in a fall without air.
        step_s: the engine's time step; None for the engine's own default here.
        observed: of a ball dropped from rest; None where that does not tell metres.
        friction: None: a drop does not identify it.
    """

    origin: ExportOrigin
    restitution: float
    meaning: str
    speed_m_s: Sourced
    tuned: Estimate
    law: SpeedLaw
    first_speed_m_s: float | None
    slope: Estimate | None
    drag: Estimate | None
    equivalents: Equivalents | None
    radius_m: Sourced
    mass_kg: Sourced
    drop_height_m: Sourced
    step_s: float | None = None
    observed: ObservedDrop | None = None
    friction: None = None

    @property
    def drag_1_m(self) -> float:
        """Of the air; 0 where it was not told."""
        return self.drag.value if self.drag and isinstance(self.drag.value, float) else 0.0

    def in_air(self) -> ExportedBall:
        """The same ball for an engine that has the air's drag: its own restitution and height."""
        at = "the recorded first impact" if self.speed_m_s.source != "option" else "that speed"
        speed_m_s, height_m = self.speed_m_s, self.drop_height_m
        if speed_m_s.source == "record" and self.first_speed_m_s is not None:
            speed_m_s = Sourced(self.first_speed_m_s, "record")
        if height_m.source == "record" and self.first_speed_m_s is not None and self.drag_1_m:
            lost = min(self.drag_1_m * self.first_speed_m_s**2 / GRAVITY_M_S2, _MOST_LOST)
            left = -math.log1p(-lost)
            height_m = Sourced(left / (2 * self.drag_1_m), "record")
        return replace(
            self,
            restitution=float(self.law.at(np.array(speed_m_s.value))),
            meaning=f"the tuned one at {at}; the air's drag is in this file",
            speed_m_s=speed_m_s,
            drop_height_m=height_m,
        )

    @property
    def moment_kg_m2(self) -> float:
        """Moment of inertia of a solid ball about its centre."""
        return solid_sphere(self.mass_kg.value, self.radius_m.value).inertia_kg_m2[0]


@dataclass(frozen=True, eq=False)
class ExportedPayload:
    """A mass that an arm holds.

    Attributes:
        mass: as it was tuned [kg].
        com: as it was tuned, in the tool frame [m]; None where the log does not tell it.
        radius_m: of the solid ball that the tuning takes the payload for.
    """

    origin: ExportOrigin
    mass: Estimate
    com: Estimate | None
    radius_m: float

    @property
    def mass_kg(self) -> float:
        """The mass."""
        assert isinstance(self.mass.value, float)
        return self.mass.value

    @property
    def com_m(self) -> tuple[float, float, float]:
        """Centre of mass in the tool frame; its origin where the log does not tell it."""
        if self.com is None:
            return (0.0, 0.0, 0.0)
        assert isinstance(self.com.value, tuple)
        x, y, z = self.com.value
        return (x, y, z)

    @property
    def inertial(self) -> Inertial:
        """About the centre of mass, along the tool frame's axes."""
        ball = solid_sphere(self.mass_kg, self.radius_m)
        return Inertial(ball.mass_kg, self.com_m, ball.inertia_kg_m2)
