"""Exported quantities: a ball's contact or a payload's inertia, each number with its source."""

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

# Of the fall's energy, to the air: what is closer to the terminal speed tells no height.
_MAX_LOST = 0.99

# Who says a number: the tuning, the user, or nobody.
Source = Literal["record", "option", "assumed"]


@dataclass(frozen=True)
class Sourced:
    """A number and its source.

    Attributes:
        value: In the unit that the field's name has.
        source: Where it comes from.
    """

    value: float
    source: Source


@dataclass(frozen=True)
class ExportOrigin:
    """Provenance of an exported record. Texts are untrusted, each one line: see `comments`.

    Attributes:
        log: The file's name.
        reason: Why the verdict is not "ok"; None if it is.
        log_sha256: Of the log; "" if unknown.
        date: When it was tuned, ISO 8601; "" if unknown.
        version: Of this package, which exports.
        tuned_by: Version that tuned; "" if unknown.
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
    """Recorded drop, to compare an engine's own with.

    Attributes:
        curves: Observed heights.
        impact_s: The first impact, on the curves' clock.
        last_s: The last impact that was seen.
    """

    curves: Curves
    impact_s: float
    last_s: float


@dataclass(frozen=True, eq=False)
class ExportedBall:
    """Bouncing ball, for an engine with one restitution and no air.

    Attributes:
        restitution: Value for the engine, from 0 to 1.
        meaning: Of that number, in words.
        speed_m_s: Impact speed that it is meant for.
        tuned: Restitution at the first impact, as tuned.
        law: Restitution over speed, as tuned; relative to `first_speed_m_s`.
        first_speed_m_s: Of the recorded first impact; None if unknown.
        slope: Of the law; None if not reported.
        drag: Of the air [1/m]; None if not reported.
        equivalents: For simulators without air; None if the record has none.
        radius_m: Of the ball.
        mass_kg: Of the ball.
        drop_height_m: Of its underside over the floor, in a fall without air.
        step_s: The engine's time step; None for its default here.
        observed: Of a ball dropped from rest; None if its metres are unknown.
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
        """Drag of the air [1/m]; 0 if not reported."""
        return self.drag.value if self.drag and isinstance(self.drag.value, float) else 0.0

    def in_air(self) -> ExportedBall:
        """Convert for an engine that simulates drag: the tuned restitution and height."""
        at = "the recorded first impact" if self.speed_m_s.source != "option" else "that speed"
        speed_m_s, height_m = self.speed_m_s, self.drop_height_m
        if speed_m_s.source == "record" and self.first_speed_m_s is not None:
            speed_m_s = Sourced(self.first_speed_m_s, "record")
        if height_m.source == "record" and self.first_speed_m_s is not None and self.drag_1_m:
            lost = min(self.drag_1_m * self.first_speed_m_s**2 / GRAVITY_M_S2, _MAX_LOST)
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
    """Payload of an arm.

    Attributes:
        mass: As tuned [kg].
        com: As tuned, in the tool frame [m]; None if unidentifiable.
        radius_m: Of the solid ball whose inertia the tuning assumes.
    """

    origin: ExportOrigin
    mass: Estimate
    com: Estimate | None
    radius_m: float

    @property
    def mass_kg(self) -> float:
        """Mass [kg]."""
        assert isinstance(self.mass.value, float)
        return self.mass.value

    @property
    def com_m(self) -> tuple[float, float, float]:
        """Centre of mass in the tool frame [m]; its origin if unidentifiable."""
        if self.com is None:
            return (0.0, 0.0, 0.0)
        assert isinstance(self.com.value, tuple)
        x, y, z = self.com.value
        return (x, y, z)

    @property
    def inertial(self) -> Inertial:
        """Inertia about the centre of mass, along the tool frame's axes."""
        ball = solid_sphere(self.mass_kg, self.radius_m)
        return Inertial(ball.mass_kg, self.com_m, ball.inertia_kg_m2)
