"""Convert a record to what is exported: a ball's contact or a payload's inertia, with sources.

Each number comes from the record, from a user's option, or is assumed, and says so. Cards, comments
and the header are common to all engines' files.
"""

from __future__ import annotations

import math
import re
import runpy
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from string import Template
from typing import Any, Literal

import numpy as np

from tunenet_logs import __version__
from tunenet_logs.analysis.checks import Verdict
from tunenet_logs.analysis.presentation import interval_words, number_words
from tunenet_logs.analysis.record import Curves, Equivalents, Estimate, Record
from tunenet_logs.episode import Array
from tunenet_logs.errors import LogError, NotFoundError, UsageError
from tunenet_logs.recorders.simulators.arm.description import (
    PAYLOAD_RADIUS_M,
    Inertial,
    Payload,
    solid_sphere,
)
from tunenet_logs.recorders.simulators.ball import DRAG, RESTITUTION, SLOPE, SpeedLaw
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2
from tunenet_logs.recorders.simulators.known import BALLS
from tunenet_logs.terminal import one_line, short_name

# Who says a number: the tuning, the user, or nobody.
Source = Literal["record", "option", "assumed"]


@dataclass(frozen=True)
class Sourced:
    """A number and its source."""

    value: float  # in the unit that the field's name has
    source: Source  # where it comes from


@dataclass(frozen=True)
class ExportOrigin:
    """Provenance of an exported record. Texts are untrusted, each one line: see `xml_comment`."""

    log: str  # the file's name
    verdict: Verdict
    reason: str | None  # why the verdict is not "ok"; None if it is
    log_sha256: str  # of the log; "" if unknown
    date: str  # when it was tuned, ISO 8601; "" if unknown
    version: str  # of this package, which exports
    tuned_by: str  # version that tuned; "" if unknown


@dataclass(frozen=True, eq=False)
class ObservedDrop:
    """Recorded drop, to compare an engine's own with."""

    curves: Curves  # observed heights
    impact_s: float  # the first impact, on the curves' clock
    last_s: float  # the last impact that was seen


@dataclass(frozen=True, eq=False)
class ExportedBall:
    """Bouncing ball, for an engine with one restitution and no air."""

    origin: ExportOrigin
    restitution: float  # value for the engine, from 0 to 1
    meaning: str  # of that number, in words
    speed_m_s: Sourced  # impact speed that it is meant for
    tuned: Estimate  # restitution at the first impact, as tuned
    law: SpeedLaw  # restitution over speed, as tuned; relative to `first_speed_m_s`
    first_speed_m_s: float | None  # of the recorded first impact; None if unknown
    slope: Estimate | None  # of the law; None if not reported
    drag: Estimate | None  # of the air [1/m]; None if not reported
    equivalents: Equivalents | None  # for simulators without air; None if the record has none
    radius_m: Sourced  # of the ball
    mass_kg: Sourced  # of the ball
    drop_height_m: Sourced  # of its underside over the floor, in a fall without air
    step_s: float | None = None  # the engine's time step; None for its default here
    observed: ObservedDrop | None = None  # from rest; None if its metres are unknown

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
            # At more than 99 % of the fall's energy lost to the air, no height follows.
            lost = min(self.drag_1_m * self.first_speed_m_s**2 / GRAVITY_M_S2, 0.99)
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
    def inertial(self) -> Inertial:
        """Inertia of a solid ball about its centre."""
        return solid_sphere(self.mass_kg.value, self.radius_m.value)


@dataclass(frozen=True, eq=False)
class ExportedPayload:
    """Payload of an arm."""

    origin: ExportOrigin
    mass: Estimate  # as tuned [kg]
    com: Estimate | None  # as tuned, in the tool frame [m]; None if unidentifiable
    radius_m: float  # of the solid ball whose inertia the tuning assumes

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


# ---- Comments in the languages of the exported files.
# Their text may be untrusted (a log's name, a reason): it must not end the comment, begin a new
# line, or move the cursor of a terminal.


def xml_comment(lines: Iterable[str], indent: str = "") -> str:
    """Format lines as one XML comment, printable, without the `--` that would end it."""
    safe = (re.sub("-(?=-)", "- ", one_line(line)) for line in lines)
    body = "".join(f"{indent}  {line}\n" for line in safe)
    return f"{indent}<!--\n{body}{indent}-->"


def hash_comment(lines: Iterable[str], indent: str = "") -> str:
    """Format lines as `#` comments of Python, YAML and USD."""
    return "\n".join(f"{indent}# {one_line(line)}".rstrip() for line in lines)


# ---- Conversion: from a record and the user's options to what is exported.

# Of a ball that nobody describes: a small one, as dense as water, from a table's height.
_RADIUS_M, _DENSITY_KG_M3, _DROP_HEIGHT_M = 0.02, 1000.0, 1.0
_MASS, _COM = "payload_mass", "payload_com"  # the names of a payload's estimates


@dataclass(frozen=True)
class ExportOptions:
    """Options of an export; None where not given."""

    speed_m_s: float | None = None  # impact speed that the restitution is for
    radius_m: float | None = None  # of the ball
    mass_kg: float | None = None  # of the ball
    step_s: float | None = None  # of the engine


def exported(record: Record, options: ExportOptions) -> ExportedBall | ExportedPayload:
    """Convert a record to what an engine's file is written from."""
    if record.verdict == "rejected":
        raise NotFoundError(
            f"this tuning was rejected ({one_line(record.reason)}); record again and tune that log"
        )
    if not record.physical:
        raise LogError(
            "its value is a number of one engine's settings, not the object's own; tune the log "
            "again with --preset default"
        )
    if record.task == "simulator":
        raise UsageError(
            "it is of a simulator of your own, which is no ball or payload",
            "give --to mjcf or urdf for its model's own file, --to yaml for the values",
        )
    if record.task == "payload":
        for name, value in vars(options).items():
            if value is not None:
                option = name.rpartition("_m_s")[0] or name.partition("_")[0]
                raise UsageError(f"--{option} is for a ball, and this is a payload: leave it out")
        mass, com = record.estimate(_MASS), record.estimate(_COM)
        if mass is None or not isinstance(mass.value, float):
            raise LogError(f"holds no {_MASS}; tune the log again")
        if com is not None and not (isinstance(com.value, tuple) and len(com.value) == 3):
            raise LogError(f"{_COM} is not three numbers; tune the log again")
        payload = ExportedPayload(origin_of(record), mass, com, PAYLOAD_RADIUS_M)
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
    return _ball(record, options)


def origin_of(record: Record) -> ExportOrigin:
    """Return whose values a record has."""
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
    tuned, e = _known(record, RESTITUTION.name, 0.0, 1.0)
    slope, p = _known(record, SLOPE.name, -1.0, 1.0)
    drag, _ = _known(record, DRAG.name, 0.0, 10.0)
    if tuned is None:
        raise LogError("holds neither a restitution nor a payload; tune the log again")
    first = next(iter(record.rebounds), None)
    speed_m_s = None if first is None else first.impact_speed_m_s
    if speed_m_s is not None and not 0 < speed_m_s < 1e4:
        raise LogError(f"impact_speed {speed_m_s:g} is none; tune the log again")
    # A law whose impact speed is not known is used at no other one: any will do.
    law = SpeedLaw(e, p, speed_m_s or 3.0)
    equivalents, curves = record.motion.equivalents, record.motion.curves
    # A fall without air from the drop height lasts as long as the recorded one.
    height_m = Sourced(_DROP_HEIGHT_M, "assumed")
    if speed_m_s is not None:
        starts = equivalents.first.speeds_m_s if equivalents is not None else ()
        height_m = Sourced((starts or (speed_m_s,))[0] ** 2 / (2 * GRAVITY_M_S2), "record")
    restitution, meaning, speed = _restitution(record, law, options, speed_m_s, height_m)
    radius_m, mass_kg = _body(record, options)
    observed = None
    if height_m.source == "record" and equivalents is not None and curves is not None:
        first, last = record.rebounds[0], record.rebounds[-1]
        observed = ObservedDrop(curves, first.impact_s, last.impact_s)
    return ExportedBall(
        origin=origin_of(record),
        restitution=restitution,
        meaning=meaning,
        speed_m_s=speed,
        tuned=tuned,
        law=law,
        first_speed_m_s=speed_m_s,
        slope=slope,
        drag=drag,
        equivalents=equivalents,
        radius_m=radius_m,
        mass_kg=mass_kg,
        drop_height_m=height_m,
        step_s=options.step_s,
        observed=observed,
    )


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


def _known(record: Record, name: str, low: float, high: float) -> tuple[Estimate | None, float]:
    """Return a quantity and its number; None and 0 if it was not tuned."""
    known = record.estimate(name)
    if known is None:
        return None, 0.0
    if not isinstance(known.value, float):
        raise LogError(f"{name} is not one number; tune the log again")
    return known, _checked(known.value, low, high)


def _checked(value: float, low: float, high: float) -> float:
    if not low <= value <= high:
        raise LogError(f"{value:g} is not from {low:g} to {high:g}; tune the log again")
    return value


# ---- Header of every exported file: provenance and meaning of its numbers.


def ball_lines(ball: ExportedBall) -> list[str]:
    """List provenance and meaning of a ball's numbers; not yet escaped for a comment."""
    known, at_m_s = ball.equivalents, ball.first_speed_m_s
    at = ", of unknown speed" if at_m_s is None else f" of {at_m_s:.2f} m/s"
    also = {"  its slope over speed": ball.slope, "  drag of the air": ball.drag}
    without_air = (
        ""
        if known is None
        else (
            f"Without air: {known.first.restitution:.4f} gives the recorded height of "
            f"the first rebound, {known.all.restitution:.4f} is best over all bounces."
        )
    )
    return [
        *origin_lines(ball.origin),
        f"Tuned: {estimate_words('restitution', ball.tuned)} at the first impact{at}.",
        *(estimate_words(name, one) for name, one in also.items() if one),
        f"In this file: restitution {ball.restitution:.4f}, {ball.meaning}.",
        *filter(None, [without_air]),
        f"Radius {sourced_words(ball.radius_m, 'm')}, mass {sourced_words(ball.mass_kg, 'kg')}, "
        f"drop height {sourced_words(ball.drop_height_m, 'm')}.",
        "Friction and spin: not identified by a drop; the engine's defaults stay.",
    ]


def one_restitution_lines(ball: ExportedBall) -> list[str]:
    """List what an engine with one restitution and no air cannot express."""
    lines = ["Not expressed here: a restitution that depends on speed, and the air's drag."]
    if ball.law.slope and ball.first_speed_m_s is not None:
        speeds = (ball.speed_m_s.value * factor for factor in (0.5, 1.0, 2.0))
        told = ", ".join(
            f"{float(ball.law.at(np.array(speed))):.3f} at {speed:.2f} m/s" for speed in speeds
        )
        lines.append(f"The tuned law says {told}: for another one, export again for that speed.")
    return lines


def payload_lines(payload: ExportedPayload) -> list[str]:
    """List provenance and meaning of a payload's numbers; not yet escaped for a comment."""
    centre = (
        "Its centre of mass cannot be separated from its mass: the tool frame's origin is here."
        if payload.com is None
        else f"Tuned: {estimate_words('centre of mass', payload.com)}, in the tool frame."
    )
    return [
        *origin_lines(payload.origin),
        f"Tuned: {estimate_words('mass', payload.mass)}.",
        centre,
        f"Its own inertia is not identified: that of a solid ball of {payload.radius_m:g} m "
        "radius, as the tuning assumed.",
        "Mount it with its origin on the tool frame of the arm that was tuned, axes along it.",
    ]


def origin_lines(origin: ExportOrigin) -> list[str]:
    """List log, verdict and versions."""
    tuned = f", tuned {short_name(origin.date)} by {short_name(origin.tuned_by)}"
    lines = [
        f"Exported by tunenet-export {origin.version} from the tuning of {short_name(origin.log)}"
        f"{tuned if origin.date else ''}.",
        *((f"SHA-256 of the log: {short_name(origin.log_sha256, 64)}",) * bool(origin.log_sha256)),
        f"Verdict: {origin.verdict}.",
    ]
    if origin.verdict == "suspect":
        reason = short_name(origin.reason or "no reason is given", 200)
        lines.append(f"WARNING: this tuning is suspect: {reason}")
    return lines


def estimate_words(name: str, estimate: Estimate) -> str:
    """Format a quantity with its interval: `restitution 0.8001 (95 %: 0.7997 to 0.8005)`."""
    unit = "" if estimate.unit == "1" else f" {short_name(estimate.unit)}"
    parts = estimate.components
    value = ", ".join(number_words(part.value, part.interval95) for part in parts)
    pairs = [part.interval95 for part in parts if part.interval95 is not None]
    said = "95 %: " + "; ".join(map(interval_words, pairs))
    return f"{name} {value}{unit} ({said if pairs else 'no reliable interval'})"


def sourced_words(known: Sourced, unit: str) -> str:
    """Format a number with its source."""
    told = {"record": "of the tuning", "option": "as asked for", "assumed": "assumed"}
    return f"{known.value:.4g} {unit} ({told[known.source]})"


# ---- Texts: a template filled with what every engine's file says; a Python file, run.


def filled(
    template: str,
    comment: Callable[[Iterable[str]], str],
    item: ExportedBall | ExportedPayload,
    remarks: Iterable[str] = (),
    number: Callable[[float], str] = repr,
    **more: float | str,
) -> str:
    """Fill a file's template; `more` are an engine's own numbers, `step` its default time step."""
    (x, y, z), (xx, xy, xz, yy, yz, zz) = item.inertial.com_m, item.inertial.inertia_kg_m2
    values: dict[str, Any] = {"x": x, "y": y, "z": z, "mass": item.inertial.mass_kg}
    values |= {"xx": xx, "xy": xy, "xz": xz, "yy": yy, "yz": yz, "zz": zz}
    if isinstance(item, ExportedBall):
        lines = [*ball_lines(item), *remarks]
        radius_m, height_m = item.radius_m.value, item.drop_height_m.value
        values |= {"radius": radius_m, "height": height_m, "centre": radius_m + height_m}
        values |= {"restitution": item.restitution, "gravity": GRAVITY_M_S2, **more}
        values |= {} if item.step_s is None else {"step": item.step_s}
    else:
        lines = payload_lines(item)
    shown = {name: one if isinstance(one, str) else number(one) for name, one in values.items()}
    text = (Path(__file__).parent / "templates" / f"{template}.tmpl").read_text("utf-8")
    return Template(text).substitute(shown, head=comment(lines))


def dropped_by(path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
    """Run the function `drop` of a Python file, as a user would; see `CanDrop`."""
    times_s, heights_m = runpy.run_path(str(path))["drop"](height_m, seconds)
    return np.asarray(times_s, np.float64), np.asarray(heights_m, np.float64)
