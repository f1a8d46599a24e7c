"""Contact settings of an engine: calibrated, and the paper's.

An engine can lose or add energy at an impact in four ways. A contact that is made ahead of the
surfaces' meeting eats the rebound. Error reduction pushes out what has sunk in, which adds energy.
A slop that is added to the distance and divided by a short step takes slop / dt off the rebound
speed. And damping is a drag. The calibrated settings switch all four off, and the step that meets
the surface is cut to end there (`meet_impacts`), so that the restitution that is set is the one
that is got.
"""

from __future__ import annotations

from dataclasses import dataclass

from recorders.simulators.base import GRAVITY_M_S2

# Length of a step that solves an impact: gravity changes the speed in it by 1e-5 m/s.
IMPACT_S = 1e-6

# How far a ball is let into a plane for an impact: engines act only on what touches.
OVERLAP_M = 1e-9


@dataclass(frozen=True)
class ContactSettings:
    """How the engine solves contacts; None is the engine's default.

    Attributes:
        name: the preset these belong to.
        gravity_m_s2: downward acceleration.
        meet_impacts: cut the step that reaches the surface so that it ends there, and integrate
            flight exactly; else plain fixed steps.
        resting_speed_m_s: rebounds slower than this are at rest (with `meet_impacts`).
        contact_distance_m: between surfaces, at which a contact is made.
        solver_distance_m: between surfaces, from which the solver works on a contact.
        contact_slop_m: overlap that the solver leaves.
        error_reduction: fraction of an overlap that one step takes away.
        inelastic_below_m_s: the engine takes the restitution of slower impacts to be 0.
        linear_damping: fraction of its speed that a body loses in a second.
        angular_damping: the same of its spin.
    """

    name: str
    gravity_m_s2: float
    meet_impacts: bool
    resting_speed_m_s: float = 0.0
    contact_distance_m: float | None = None
    solver_distance_m: float | None = None
    contact_slop_m: float | None = None
    error_reduction: float | None = None
    inelastic_below_m_s: float | None = None
    linear_damping: float | None = None
    angular_damping: float | None = None


# Restitution set = restitution got.
CALIBRATED = ContactSettings(
    name="default",
    gravity_m_s2=GRAVITY_M_S2,
    meet_impacts=True,
    resting_speed_m_s=0.01,
    contact_distance_m=1e-4,
    solver_distance_m=0.0,
    contact_slop_m=0.0,
    error_reduction=0.0,
    inelastic_below_m_s=0.0,
    linear_damping=0.0,
    angular_damping=0.0,
)

# The engine's defaults, stepped once a sample: the paper's simulator (PyBullet at 60 Hz).
PAPER = ContactSettings(name="paper", gravity_m_s2=9.8, meet_impacts=False)

PRESETS = {settings.name: settings for settings in (CALIBRATED, PAPER)}
