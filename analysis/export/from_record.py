"""Convert a record and the user's options to what is exported."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from analysis.export.exported import (
    ExportedBall,
    ExportedPayload,
    ExportOrigin,
    ObservedDrop,
    Sourced,
)
from analysis.record import Estimate, Record
from recorders.simulators.arm.description import PAYLOAD_RADIUS_M, Payload
from recorders.simulators.balls import BALLS
from recorders.simulators.base import GRAVITY_M_S2
from recorders.simulators.drop import DRAG, RESTITUTION, SLOPE
from recorders.simulators.speed_law import SpeedLaw
from tunenet_logs import __version__
from tunenet_logs.errors import LogError, NotFoundError, UsageError
from tunenet_logs.terminal import one_line

# Of a ball that nobody describes: a small one, as heavy as water, from a table's height.
_RADIUS_M, _DENSITY_KG_M3, _DROP_HEIGHT_M = 0.02, 1000.0, 1.0

_ANY_SPEED_M_S = 3.0  # of a law whose impact speed is not known: it is used at no other one
_MASS, _COM = "payload_mass", "payload_com"  # the names of a payload's estimates


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export; None where not given.

    Attributes:
        speed_m_s: Impact speed that the restitution is for.
        radius_m: Of the ball.
        mass_kg: Of the ball.
        step_s: Of the engine.
    """

    speed_m_s: float | None = None
    radius_m: float | None = None
    mass_kg: float | None = None
    step_s: float | None = None


def exported(record: Record, options: ExportOptions) -> ExportedBall | ExportedPayload:
    """Convert a record to what an engine's file is written from.

    Raises:
        NotFoundError: The tuning was rejected.
        LogError: It holds no values, or some that no engine can have.
        UsageError: An option does not apply to it.
    """
    if record.verdict == "rejected":
        raise NotFoundError(
            f"this tuning was rejected ({one_line(record.reason)}); record again and tune that log"
        )
    if not record.physical:
        raise LogError(
            "its value is a number of one engine's settings, not the object's own; tune the log "
            "again with --preset default"
        )
    if record.task == "payload":
        return _payload(record, options)
    if record.estimate(RESTITUTION.name) is None:
        raise LogError("holds neither a restitution nor a payload; tune the log again")
    return _ball(record, options)


def _origin(record: Record) -> ExportOrigin:
    known = record.provenance
    return ExportOrigin(
        log=one_line(record.log or "a log without a name"),
        verdict=record.verdict,
        reason=record.reason and one_line(record.reason),
        log_sha256=one_line(known.log_sha256) if known else "",
        date=one_line(known.date) if known else "",
        version=__version__,
        tuned_by=one_line(known.version) if known else "",
    )


def _ball(record: Record, options: ExportOptions) -> ExportedBall:
    tuned = _known(record, RESTITUTION.name, 0.0, 1.0)
    slope = _optional(record, SLOPE.name, -1.0, 1.0)
    first = next(iter(record.rebounds), None)
    speed_m_s = None if first is None else first.impact_speed_m_s
    if speed_m_s is not None and not 0 < speed_m_s < 1e4:
        raise LogError(f"impact_speed {speed_m_s:g} is none; tune the log again")
    law = SpeedLaw(
        _number(tuned), 0.0 if slope is None else _number(slope), speed_m_s or _ANY_SPEED_M_S
    )
    height_m = _drop_height(record, speed_m_s)
    restitution, meaning, speed = _restitution(record, law, options, speed_m_s, height_m)
    radius_m, mass_kg = _body(record, options)
    is_from_rest = height_m.source == "record" and record.motion.equivalents is not None
    return ExportedBall(
        origin=_origin(record),
        restitution=restitution,
        meaning=meaning,
        speed_m_s=speed,
        tuned=tuned,
        law=law,
        first_speed_m_s=speed_m_s,
        slope=slope,
        drag=_optional(record, DRAG.name, 0.0, 10.0),
        equivalents=record.motion.equivalents,
        radius_m=radius_m,
        mass_kg=mass_kg,
        drop_height_m=height_m,
        step_s=options.step_s,
        observed=_observed(record) if is_from_rest else None,
    )


def _observed(record: Record) -> ObservedDrop | None:
    if record.motion.curves is None:
        return None
    first, last = record.rebounds[0], record.rebounds[-1]
    return ObservedDrop(record.motion.curves, first.impact_s, last.impact_s)


def _drop_height(record: Record, speed_m_s: float | None) -> Sourced:
    """Return the height from which a fall without air lasts as long as the recorded one."""
    if speed_m_s is None:
        return Sourced(_DROP_HEIGHT_M, "assumed")
    if record.motion.equivalents is not None and record.motion.equivalents.first.speeds_m_s:
        speed_m_s = record.motion.equivalents.first.speeds_m_s[0]
    return Sourced(speed_m_s**2 / (2 * GRAVITY_M_S2), "record")


def _restitution(
    record: Record,
    law: SpeedLaw,
    options: ExportOptions,
    speed_m_s: float | None,
    height_m: Sourced,
) -> tuple[float, str, Sourced]:
    """Choose the engine's restitution, its meaning, and its impact speed."""
    if options.speed_m_s is not None:
        if speed_m_s is None:
            raise UsageError(
                "the tuning knows no impact speed, so no law over speed: leave --speed out"
            )
        told = float(law.at(np.array(options.speed_m_s)))
        words = f"by the tuned law at an impact of {options.speed_m_s:g} m/s"
        return told, words, Sourced(options.speed_m_s, "option")
    speed = Sourced(math.sqrt(2 * GRAVITY_M_S2 * height_m.value), height_m.source)
    if record.motion.equivalents is None:
        return law.restitution, "as tuned at the first impact", speed
    words = "with which the first rebound is as high as the recorded one, without air"
    return _checked(record.motion.equivalents.first.restitution, 0.0, 1.0), words, speed


def _body(record: Record, options: ExportOptions) -> tuple[Sourced, Sourced]:
    """Choose radius and mass: the user's, those of the ball named in the log, or usual ones."""
    named = BALLS.get(record.ball or "")
    if options.radius_m is not None:
        radius = Sourced(options.radius_m, "option")
    elif named is not None and named.diameter_m is not None:
        radius = Sourced(named.diameter_m / 2, "record")
    else:
        radius = Sourced(_RADIUS_M, "assumed")
    if options.mass_kg is not None:
        return radius, Sourced(options.mass_kg, "option")
    if named is not None and named.mass_kg is not None:
        return radius, Sourced(named.mass_kg, "record")
    volume_m3 = 4 / 3 * math.pi * radius.value**3
    return radius, Sourced(float(f"{_DENSITY_KG_M3 * volume_m3:.3g}"), "assumed")


def _payload(record: Record, options: ExportOptions) -> ExportedPayload:
    for name, value in vars(options).items():
        if value is not None:
            option = name.rpartition("_m_s")[0] or name.partition("_")[0]
            raise UsageError(f"--{option} is for a ball, and this is a payload: leave it out")
    mass, com = record.estimate(_MASS), record.estimate(_COM)
    if mass is None or not isinstance(mass.value, float):
        raise LogError(f"holds no {_MASS}; tune the log again")
    if com is not None and not (isinstance(com.value, tuple) and len(com.value) == 3):
        raise LogError(f"{_COM} is not three numbers; tune the log again")
    payload = ExportedPayload(_origin(record), mass, com, PAYLOAD_RADIUS_M)
    try:
        Payload(payload.mass_kg, payload.com_m)
    except UsageError as error:
        raise LogError(f"{error}; tune the log again") from error
    if payload.mass_kg <= 0:
        raise LogError(
            "its payload weighs nothing: there is nothing to mount",
            "tune a log in which it holds something",
        )
    return payload


def _known(record: Record, name: str, low: float, high: float) -> Estimate:
    known = record.estimate(name)
    if known is None or not isinstance(known.value, float):
        raise LogError(f"{name} is not one number; tune the log again")
    _checked(known.value, low, high)
    return known


def _optional(record: Record, name: str, low: float, high: float) -> Estimate | None:
    return None if record.estimate(name) is None else _known(record, name, low, high)


def _checked(value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise LogError(f"{value:g} is not from {low:g} to {high:g}; tune the log again")
    return value


def _number(known: Estimate) -> float:
    assert isinstance(known.value, float)
    return known.value
