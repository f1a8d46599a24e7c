"""Write and read a record as JSON. Its keys are a contract; new ones may be added."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, get_args

import numpy as np

from analysis.checks import Check, CrossCheck, Verdict
from analysis.motion import (
    MAX_SAMPLES,
    Curves,
    Equivalent,
    Equivalents,
    Motion,
    SimulationFit,
    Units,
)
from analysis.record import Estimate, Interval, Provenance, Rebound, Record
from analysis.sound_json import read_sound, sound_fields
from tunenet_logs.arrays import Array
from tunenet_logs.errors import LogError
from tunenet_logs.small_files import parse_json, read_small_file
from tunenet_logs.terminal import short_name

Value = TypeVar("Value")

# Of a time [s] and a height [m]: a tenth of a millimetre, and the time it takes to fall so far.
_TIME_DECIMALS, _HEIGHT_DECIMALS = 5, 4

# Of a file that may be a record: several times one with the longest curves.
MAX_RECORD_BYTES = 4_000_000

_MAX_CHARACTERS = 200  # of what is wrong with a file, as it is told
_FARTHEST = 1e6  # [m] and [s] from zero: no curve of an experiment goes farther


def record_fields(record: Record) -> dict[str, Any]:
    """Return the fields of the record's JSON, without the curves."""
    last = len(record.iterations) - 1
    cross, motion = record.cross_check, record.motion
    return {
        "log": record.log,
        "task": record.task,
        "verdict": record.verdict,
        "reason": record.reason,
        "parameters": _parameters(record) or None,
        "physical": record.physical,
        "method": record.method,
        "rollouts": record.rollouts,
        "iterations": [
            {"k": k, **values, **({"refined": True} if record.is_fitted and k == last else {})}
            for k, values in enumerate(record.iterations)
        ],
        "bounces": [
            {
                "restitution": bounce.restitution,
                "interval95": bounce.interval95,
                "impact_speed": bounce.impact_speed_m_s,
                "unit": "m/s",
                "time_s": bounce.impact_s,
            }
            for bounce in record.rebounds
        ],
        "simulation_fit": motion.fit
        and {**asdict(motion.fit), "excess_percent": motion.fit.excess_percent},
        "equivalent": motion.equivalents
        and {**asdict(motion.equivalents), "speeds": motion.equivalents.first.speeds_m_s},
        "untold": motion.untold,
        "units": motion.units and _units(motion.units),
        "sound": motion.sound and sound_fields(motion.sound),
        "cross_check": cross
        and {name: value for name, value in asdict(cross).items() if name != "advice"},
        "checks": [
            {
                "name": check.name,
                "passed": check.passed,
                "detail": check.detail,
                **({"advice": check.advice} if check.advice and not check.passed else {}),
            }
            for check in record.checks
        ],
        "warnings": record.warnings,
        "simulator": record.simulator,
        "weights": record.weights,
        "ball": record.ball,
        "topic": record.topic,
        "window": record.window,
        "seconds": {name: round(value, 4) for name, value in record.seconds.items()},
        "provenance": record.provenance and _provenance_fields(record.provenance),
    }


def to_json(record: Record) -> str:
    """Format the record as one JSON object."""
    fields = record_fields(record)
    text = json.dumps(fields, indent=1, ensure_ascii=False, allow_nan=False)
    if record.motion.curves is not None:  # on one line: it is for programs
        curves = {
            "start_ns": record.motion.curves.start_ns,
            "seconds": np.round(record.motion.curves.seconds, _TIME_DECIMALS).tolist(),
            "observed_m": _rounded(record.motion.curves.observed_m),
            "simulated_m": _rounded(record.motion.curves.simulated_m),
        }
        line = json.dumps(curves, allow_nan=False)
        text = f'{text.removesuffix("}").rstrip()},\n "curves": {line}\n}}'
    return text + "\n"


def _parameters(record: Record) -> dict[str, Any]:
    """Return the estimates; null if one's units cannot be determined."""
    found: dict[str, Any] = {
        known.name: {"value": known.value, "interval95": known.interval95, "unit": known.unit}
        for known in record.estimates
    }
    unknown = record.motion.unknown if found else ()
    return found | {name: {"value": None, "interval95": None} for name in unknown}


def _units(units: Units) -> dict[str, Any]:
    """Return a log's units, and their sources."""
    return {name: getattr(units, name) for name in ("length_m", "length_by", "rate_hz", "rate_by")}


def _rounded(heights_m: Array) -> list[float | None]:
    """Round heights [m] for JSON; null where there is none."""
    rounded = np.round(heights_m, _HEIGHT_DECIMALS).tolist()
    return [height_m if math.isfinite(height_m) else None for height_m in rounded]


def read_record(path: Path) -> Record:
    """Read the record in a JSON that `to_json` wrote.

    Raises:
        LogError: It cannot be read, is something else, or has an invalid value.
    """
    try:
        fields = parse_json(read_small_file(path, MAX_RECORD_BYTES))
    except OSError as error:
        raise LogError(
            f"{path}: cannot be read ({error.strerror}); give a tuning's .json"
        ) from error
    except ValueError as error:
        why = short_name(error, _MAX_CHARACTERS)
        message = f"{path}: is no JSON of a tuning ({why}); give the .json that tunenet-tune wrote"
        raise LogError(message) from error
    if not isinstance(fields, dict) or not {"verdict", "parameters"} <= fields.keys():
        raise LogError(f"{path}: is no tuning; give the .json that tunenet-tune wrote")
    try:
        return record_from(fields)
    except LookupError as error:
        why = f"{short_name(error)} is missing in it"
        raise LogError(f"{path}: {why}; tune the log again") from error
    except (ValueError, TypeError, AttributeError, ArithmeticError) as error:
        why = short_name(error, _MAX_CHARACTERS)
        raise LogError(f"{path}: {why}; tune the log again") from error


def record_in(data: bytes) -> Record:
    """Parse a record from a file's bytes.

    Raises:
        ValueError: They are no tuning.
    """
    try:
        fields = parse_json(data)
        if not isinstance(fields, dict):
            raise TypeError("is no object")
        return record_from(fields)
    except (LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise ValueError(str(error)) from error


def _provenance_fields(provenance: Provenance) -> dict[str, Any]:
    """Return its JSON fields; `tare` is null, one, or a list of several."""
    fields = asdict(provenance)
    tares = fields.pop("tares")
    fields["tare"] = list(tares) if len(tares) > 1 else next(iter(tares), None)
    return fields


def _provenance(fields: Mapping[str, Any]) -> Provenance:
    """Parse what `_provenance_fields` wrote."""
    known = dict(fields)
    tare = known.pop("tare", None)
    tares = tare if isinstance(tare, list) else [tare] if tare else []
    return Provenance(**known, tares=tuple(map(dict, tares)))


def record_from(fields: Mapping[str, Any]) -> Record:
    """Parse a record from a JSON's object; missing keys have their defaults.

    Raises:
        ValueError, TypeError, LookupError, AttributeError: A value is invalid.
    """
    if fields["verdict"] not in get_args(Verdict):
        raise ValueError(f"verdict {short_name(fields['verdict'])} is none")
    cross, provenance = fields.get("cross_check"), fields.get("provenance")
    iterations = [dict(step) for step in fields.get("iterations") or ()]
    return Record(
        log=str(fields.get("log", "")),
        task=_optional(str, fields.get("task")),
        verdict=fields["verdict"],
        reason=_optional(str, fields.get("reason")),
        estimates=tuple(
            _estimate(str(name), known)
            for name, known in (fields["parameters"] or {}).items()
            if known["value"] is not None
        ),
        physical=bool(fields.get("physical", True)),
        method=_optional(str, fields.get("method")),
        rollouts=int(fields.get("rollouts", 0)),
        iterations=tuple(
            {name: _number(name, value) for name, value in step.items() if name not in _OF_STEPS}
            for step in iterations
        ),
        is_fitted=bool(iterations and iterations[-1].get("refined")),
        rebounds=tuple(_rebound(bounce) for bounce in fields.get("bounces") or ()),
        cross_check=cross
        and CrossCheck(
            str(cross["method"]),
            _number("value", cross["value"]),
            cross["agrees"],
            tolerance=_optional(partial(_number, "tolerance"), cross.get("tolerance")),
            noise95=_optional(partial(_number, "noise95"), cross.get("noise95")),
        ),
        checks=tuple(
            Check(
                str(check["name"]),
                check["passed"],
                str(check["detail"]),
                advice=str(check.get("advice", "")),
            )
            for check in fields.get("checks") or ()
        ),
        warnings=tuple(map(str, fields.get("warnings") or ())),
        simulator=_optional(dict, fields.get("simulator")),
        weights=_optional(dict, fields.get("weights")),
        ball=_optional(str, fields.get("ball")),
        topic=_optional(str, fields.get("topic")),
        window=_numbers(fields.get("window")) or None,
        seconds=_numbers(fields.get("seconds")),
        provenance=provenance and _provenance(provenance),
        motion=Motion(
            _optional(_curves, fields.get("curves")),
            _optional(_simulation_fit, fields.get("simulation_fit")),
            _optional(_equivalents, fields.get("equivalent")),
            tuple(map(str, fields.get("untold") or ())),
            tuple(
                str(name)
                for name, known in (fields["parameters"] or {}).items()
                if known["value"] is None
            ),
            _optional(_read_units, fields.get("units")),
            _optional(read_sound, fields.get("sound")),
        ),
    )


_OF_STEPS = ("k", "refined")  # what an iteration has beside its parameters


def _interval(ends: Any) -> Interval:
    low, high = ends
    return _number("interval95", low), _number("interval95", high)


def _optional(make: Callable[[Any], Value], given: Any) -> Value | None:
    return None if given is None else make(given)


def _number(name: str, value: Any) -> float:
    """Return a finite number; anything else is a ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{short_name(name)} {short_name(value)} is no finite number")
    return float(value)


def _numbers(given: Mapping[str, Any] | None) -> dict[str, float]:
    return {str(name): _number(str(name), value) for name, value in (given or {}).items()}


def _estimate(name: str, fields: Mapping[str, Any]) -> Estimate:
    value, ends = fields["value"], fields["interval95"]
    if isinstance(value, list):
        values = tuple(_number(name, part) for part in value)
        return Estimate(name, str(fields["unit"]), values, ends and tuple(map(_interval, ends)))
    unit = str(fields.get("unit", "1"))
    return Estimate(name, unit, _number(name, value), _optional(_interval, ends))


def _rebound(fields: Mapping[str, Any]) -> Rebound:
    speed_m_s = fields["impact_speed"]
    return Rebound(
        _number("time_s", fields.get("time_s", 0.0)),
        _number("restitution", fields["restitution"]),
        _optional(_interval, fields["interval95"]),
        None if speed_m_s is None else _number("impact_speed", speed_m_s),
    )


def _simulation_fit(fields: Mapping[str, Any]) -> SimulationFit:
    held_out = _optional(lambda value: _number("held_out", value), fields["held_out_percent"])
    rms, worst, noise_percent, noise = (
        _number(name, fields[name])
        for name in ("rms_percent", "worst_percent", "noise_percent", "noise")
    )
    return SimulationFit(
        rms,
        worst,
        noise_percent,
        held_out,
        int(fields["samples"]),
        int(fields["left_out"]),
        noise,
        str(fields["unit"]),
    )


def _equivalents(fields: Mapping[str, Any]) -> Equivalents:
    return Equivalents(*(_equivalent(fields[name]) for name in ("first", "all")))


def _equivalent(fields: Mapping[str, Any]) -> Equivalent:
    return Equivalent(
        _number("restitution", fields["restitution"]),
        _number("rms_percent", fields["rms_percent"]),
        tuple(_number("speed", speed) for speed in fields["speeds_m_s"]),
    )


def _read_units(fields: Mapping[str, Any]) -> Units:
    length_m, rate_hz = (
        _optional(lambda value, name=name: _number(name, value), fields[name])
        for name in ("length_m", "rate_hz")
    )
    length_by, rate_by = (_optional(str, fields[name]) for name in ("length_by", "rate_by"))
    return Units(length_m, length_by, rate_hz, rate_by)


def _curves(fields: Mapping[str, Any]) -> Curves:
    """Parse the curves that `to_json` wrote."""
    names = ("seconds", "observed_m", "simulated_m")
    seconds, observed_m, simulated_m = (np.array(fields[name], np.float64) for name in names)
    shapes = {seconds.shape, observed_m.shape, simulated_m.shape}
    if shapes != {(len(seconds),)} or not 2 <= len(seconds) <= MAX_SAMPLES:
        raise ValueError("its curves have different lengths")
    far = [np.nanmax(np.abs(curve)) for curve in (seconds, observed_m, simulated_m)]
    if not all(reach < _FARTHEST for reach in far) or np.any(np.diff(seconds) <= 0):
        raise ValueError("its curves make no sense")
    return Curves(int(fields["start_ns"]), seconds, observed_m, simulated_m)
