"""Contact settings of PyBullet: the calibrated ones, and the paper's.

Bullet loses or adds energy at an impact in four ways. A contact is made up to
`contactBreakingThreshold` ahead of the surfaces' meeting, and eats the rebound. Error reduction
(`erp`) pushes out what has sunk in, which adds energy. `contactSlop` (1e-5 m by default) is added
to the distance and, divided by a short step, takes slop / dt off the rebound speed. And default
damping is a drag. The calibrated settings switch all four off, and the step that meets the surface
is cut to end there (`meet_impacts`), so that the restitution that is set is the one that is got.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ContactSettings:
    """How the engine is set up.

    Attributes:
        name: the preset these belong to.
        gravity_m_s2: downward acceleration.
        breaking_threshold_m: distance at which contacts are made; 0.02 is the engine's default.
        engine: other arguments of `setPhysicsEngineParameter`; empty for the engine's defaults.
        body: arguments of `changeDynamics` for both bodies; empty for the engine's defaults.
        meet_impacts: cut the step that reaches the surface so that it ends there, and integrate
            flight exactly; else plain fixed steps.
        resting_speed_m_s: rebounds slower than this are at rest (with `meet_impacts`).
    """

    name: str
    gravity_m_s2: float
    breaking_threshold_m: float
    engine: tuple[tuple[str, float], ...]
    body: tuple[tuple[str, float], ...]
    meet_impacts: bool
    resting_speed_m_s: float = 0.0


CALIBRATED = ContactSettings(
    name="default",
    gravity_m_s2=9.80665,
    breaking_threshold_m=1e-4,
    engine=(
        ("contactSlop", 0.0),
        ("erp", 0.0),
        ("contactERP", 0.0),
        ("restitutionVelocityThreshold", 0.0),
    ),
    body=(
        ("contactProcessingThreshold", 0.0),
        ("linearDamping", 0.0),
        ("angularDamping", 0.0),
    ),
    meet_impacts=True,
    resting_speed_m_s=0.01,
)
"""Restitution set = restitution got."""

PAPER = ContactSettings(
    name="paper",
    gravity_m_s2=9.8,
    breaking_threshold_m=0.02,
    engine=(),
    body=(),
    meet_impacts=False,
)
"""PyBullet's defaults, stepped once a sample: the paper's simulator (at 60 Hz)."""

PRESETS = {settings.name: settings for settings in (CALIBRATED, PAPER)}
