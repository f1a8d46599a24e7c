"""Convert a record to what is exported: a ball's contact or a payload's inertia, with sources.

Each number comes from the record, from a user's option, or is assumed, and says so. Cards, comments
and the header are common to all engines' files.
"""

from __future__ import annotations

import math
import re
import runpy
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, assert_never

import numpy as np

from tunenet_logs import __version__
from tunenet_logs.analysis.checks import Verdict
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

_MAX_LOST = 0.99  # of the fall's energy, to the air: nearer to terminal speed, no height follows

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
    """Provenance of an exported record. Texts are untrusted, each one line: see `xml_comment`.

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


# ---- Card: a tuning as plain data, for engines without a file format here.


def ball_card(ball: ExportedBall, notes: list[str]) -> dict[str, Any]:
    """Build the card of a ball; `notes` are the remarks that other files have as comments."""
    known = ball.equivalents
    return {
        "kind": "ball",
        "verdict": ball.origin.verdict,
        "reason": ball.origin.reason,
        "restitution": {
            "value": ball.restitution,
            "unit": "1",
            "at_speed": asdict(ball.speed_m_s) | {"unit": "m/s"},
            "meaning": ball.meaning,
        },
        "tuned": {
            known.name: _estimate(known) for known in (ball.tuned, ball.slope, ball.drag) if known
        },
        "law": {
            "restitution": ball.law.restitution,
            "slope": ball.law.slope,
            "at_speed_m_s": ball.first_speed_m_s,
            "formula": "restitution * (speed / at_speed)**-slope",
        },
        "equivalent": known
        and {
            name: {"restitution": one.restitution, "rms_percent": one.rms_percent}
            for name, one in (("first", known.first), ("all", known.all))
        },
        "ball": {
            "radius": asdict(ball.radius_m) | {"unit": "m"},
            "mass": asdict(ball.mass_kg) | {"unit": "kg"},
            "drop_height": asdict(ball.drop_height_m) | {"unit": "m"},
            "friction": ball.friction,
        },
        "provenance": _provenance(ball.origin),
        "notes": notes,
    }


def payload_card(payload: ExportedPayload, notes: list[str]) -> dict[str, Any]:
    """Build the card of a payload; `notes` as in `ball_card`."""
    xx, xy, xz, yy, yz, zz = payload.inertial.inertia_kg_m2
    return {
        "kind": "payload",
        "verdict": payload.origin.verdict,
        "reason": payload.origin.reason,
        "tuned": {known.name: _estimate(known) for known in (payload.mass, payload.com) if known},
        "payload": {
            "mass_kg": payload.mass_kg,
            "com_m": list(payload.com_m),
            "frame": "the arm's tool frame",
            "inertia_kg_m2": {"ixx": xx, "ixy": xy, "ixz": xz, "iyy": yy, "iyz": yz, "izz": zz},
            "inertia_of": f"a solid ball of {payload.radius_m:g} m radius, assumed",
        },
        "provenance": _provenance(payload.origin),
        "notes": notes,
    }


def _estimate(known: Estimate) -> dict[str, Any]:
    return {
        "value": _plain(known.value),
        "interval95": _plain(known.interval95),
        "unit": one_line(known.unit),
    }


def _plain(value: Any) -> Any:
    """Convert tuples to lists, which every format has."""
    return [_plain(one) for one in value] if isinstance(value, tuple) else value


def _provenance(origin: ExportOrigin) -> dict[str, str]:
    return {
        "log": origin.log,
        "log_sha256": origin.log_sha256,
        "date": origin.date,
        "tuned_by": origin.tuned_by,
        "exported_by": origin.version,
    }


# ---- Comments in the languages of the exported files.
# Their text may be untrusted (a log's name, a reason): it must not end the comment, begin a new
# line, or move the cursor of a terminal.


def xml_comment(lines: Iterable[str], indent: str = "") -> str:
    """Format lines as one XML comment, printable, without the `--` that would end it."""
    body = "".join(f"{indent}  {_without_double_dashes(one_line(line))}\n" for line in lines)
    return f"{indent}<!--\n{body}{indent}-->"


def hash_comment(lines: Iterable[str], indent: str = "") -> str:
    """Format lines as `#` comments of Python, YAML and USD."""
    return "\n".join(f"{indent}# {one_line(line)}".rstrip() for line in lines)


def _without_double_dashes(line: str) -> str:
    return re.sub("-(?=-)", "- ", line)


# ---- Conversion: from a record and the user's options to what is exported.

# Of a ball that nobody describes: a small one, as dense as water, from a table's height.
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


# ---- Header of every exported file: provenance and meaning of its numbers.


_MAX_REASON_CHARACTERS = 200  # of a verdict's reason


def ball_lines(ball: ExportedBall) -> list[str]:
    """List provenance and meaning of a ball's numbers; not yet escaped for a comment."""
    equivalents = ball.equivalents
    return [
        *origin_lines(ball.origin),
        f"Tuned: {estimate_words('restitution', ball.tuned)} at the first impact"
        f"{_at_words(ball.first_speed_m_s)}.",
        *(estimate_words("  its slope over speed", one) for one in (ball.slope,) if one),
        *(estimate_words("  drag of the air", one) for one in (ball.drag,) if one),
        f"In this file: restitution {ball.restitution:.4f}, {ball.meaning}.",
        *(
            (
                f"Without air: {equivalents.first.restitution:.4f} gives the recorded height of "
                f"the first rebound, {equivalents.all.restitution:.4f} is best over all bounces.",
            )
            if equivalents
            else ()
        ),
        f"Radius {sourced_words(ball.radius_m, 'm')}, mass {sourced_words(ball.mass_kg, 'kg')}, "
        f"drop height {sourced_words(ball.drop_height_m, 'm')}.",
        "Friction and spin: not identified by a drop; the engine's defaults stay.",
    ]


def one_restitution_lines(ball: ExportedBall) -> list[str]:
    """List what an engine with one restitution and no air cannot express."""
    lines = ["Not expressed here: a restitution that depends on speed, and the air's drag."]
    if ball.law.slope and ball.first_speed_m_s is not None:
        speeds = (ball.speed_m_s.value * factor for factor in (0.5, 1.0, 2.0))
        told = ", ".join(f"{_at(ball, speed):.3f} at {speed:.2f} m/s" for speed in speeds)
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
        reason = short_name(origin.reason or "no reason is given", _MAX_REASON_CHARACTERS)
        lines.append(f"WARNING: this tuning is suspect: {reason}")
    return lines


def estimate_words(name: str, estimate: Estimate) -> str:
    """Format a quantity with its interval: `restitution 0.8001 (95 %: 0.7997 to 0.8005)`."""
    unit = "" if estimate.unit == "1" else f" {short_name(estimate.unit)}"
    if isinstance(estimate.value, tuple):
        value = ", ".join(f"{part:.4f}" for part in estimate.value)
    else:
        value = f"{estimate.value:.4f}"
    return f"{name} {value}{unit} ({_interval_words(estimate)})"


def _interval_words(estimate: Estimate) -> str:
    if estimate.interval95 is None:
        return "no reliable interval"
    ends = estimate.interval95
    pairs = ends if isinstance(ends[0], tuple) else (ends,)
    return "95 %: " + "; ".join(f"{pair[0]:.4f} to {pair[1]:.4f}" for pair in pairs)  # pyright: ignore[reportIndexIssue] (pairs by now)


def sourced_words(known: Sourced, unit: str) -> str:
    """Format a number with its source."""
    match known.source:
        case "record":
            told = "of the tuning"
        case "option":
            told = "as asked for"
        case "assumed":
            told = "assumed"
        case _:
            assert_never(known.source)
    return f"{known.value:.4g} {unit} ({told})"


def _at_words(speed_m_s: float | None) -> str:
    return ", of unknown speed" if speed_m_s is None else f" of {speed_m_s:.2f} m/s"


def _at(ball: ExportedBall, speed_m_s: float) -> float:
    return float(ball.law.at(np.array(speed_m_s)))


# ---- Python files: run one, as a user would.


def dropped_by(path: Path, height_m: float, seconds: float) -> tuple[Array, Array]:
    """Run the function `drop` of a Python file; see `CanDrop`."""
    times_s, heights_m = runpy.run_path(str(path))["drop"](height_m, seconds)
    return np.asarray(times_s, np.float64), np.asarray(heights_m, np.float64)
