"""Record of a tuning: its verdict, values, checks and provenance, written and read as JSON.

The keys of the JSON are a contract; new ones may be added. A file is untrusted: values are checked.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args

import numpy as np

from tunenet_logs.analysis.checks import Check, CrossCheck, Verdict
from tunenet_logs.episode import Array
from tunenet_logs.errors import LogError
from tunenet_logs.files import parse_json, read_small_file
from tunenet_logs.terminal import short_name

if TYPE_CHECKING:
    import pandas as pd


# ---- Motion: the tuned simulator's beside the observed one, and the units of a log.

MAX_SAMPLES = 20_000  # of one curve: a minute of what the fastest motion capture sees


@dataclass(frozen=True, eq=False)
class Curves:
    """Observed height and the tuned simulator's, at the observation's own stamps.

    Attributes:
        start_ns: Stamp that the seconds count from [ns].
        seconds: Shape (T,), increasing.
        observed_m: Heights above the table [m], shape (T,).
        simulated_m: Those of the tuned simulator [m], shape (T,); NaN where not simulated.
    """

    start_ns: int
    seconds: Array
    observed_m: Array
    simulated_m: Array

    def to_frame(self) -> pd.DataFrame:
        """Return a table with index `seconds`, columns `observed_m` and `simulated_m`."""
        import pandas as pd

        curves = {"observed_m": self.observed_m, "simulated_m": self.simulated_m}
        return pd.DataFrame(curves, index=pd.Index(self.seconds, name="seconds"))


@dataclass(frozen=True)
class SimulationFit:
    """Residual of the tuned rollout, from the release to the last bounce.

    Attributes:
        rms_percent: Root mean square of the residual [% of the drop height].
        worst_percent: Largest absolute residual.
        noise_percent: RMS that the observation's noise alone would give.
        held_out_percent: Like `excess_percent`, for the last 40 % of the time, by a fit to the
            first 60 % (hold-out); None if that shows too little.
        samples: Number compared.
        left_out: Samples that are something else than the ball.
        noise: Standard deviation of a sample, in `unit`.
        unit: "m", "px" of a video, "1" for drop heights if metres cannot be determined.
    """

    rms_percent: float
    worst_percent: float
    noise_percent: float
    held_out_percent: float | None
    samples: int
    left_out: int
    noise: float
    unit: str

    @property
    def excess_percent(self) -> float:
        """RMS residual without the noise."""
        return excess(self.rms_percent, self.noise_percent)


def excess(rms: float, noise: float) -> float:
    """Subtract the noise in quadrature from a root mean square."""
    return max(rms**2 - noise**2, 0.0) ** 0.5


@dataclass(frozen=True)
class Equivalent:
    """The ball in a simulator without air, dropped from the same height at the same moment.

    Attributes:
        restitution: Its coefficient, the same at every impact.
        rms_percent: RMS difference from the observation [% of the drop height].
        speeds_m_s: Of its impacts, as far as bounces are in view.
    """

    restitution: float
    rms_percent: float
    speeds_m_s: tuple[float, ...]


@dataclass(frozen=True)
class Equivalents:
    """Restitutions for simulators without air.

    Attributes:
        first: With the height of the first rebound.
        all: With the least error over all bounces in view.
    """

    first: Equivalent
    all: Equivalent


@dataclass(frozen=True)
class Units:
    """Units of a log's positions and stamps.

    Attributes:
        length_m: Metres in the log's unit of length; None if it cannot be determined.
        length_by: "named", "gravity", or None if it cannot be determined.
        rate_hz: Samples per second; None if it cannot be determined.
        rate_by: "clock", "gravity", or None.
        doubt: How gravity contradicts what the log says, and what would fit; "" if it does not.
        remedy: What to do about the doubt.
    """

    length_m: float | None
    length_by: str | None
    rate_hz: float | None
    rate_by: str | None
    doubt: str = ""
    remedy: str = ""

    @property
    def tell_speed(self) -> bool:
        """Whether metres and seconds are known, and so speeds and a drag per metre."""
        return self.length_m is not None and self.rate_hz is not None and not self.doubt


@dataclass(frozen=True)
class SoundShare:
    """Contribution of sound to a ball's images or positions.

    Attributes:
        impacts: Of the ball up to the last that is seen or heard; 0 if its sound was not
            compared with what is seen.
        heard: Number of these in the fit; 0 if the sound is not used.
        offset_s: Delay of the sound relative to what is seen [s]; None if it is not used.
        reason: Why it is not used; "" if it is.
        restitution: Estimate without it.
        interval95: Of that.
    """

    impacts: int
    heard: int
    offset_s: float | None
    reason: str
    restitution: float
    interval95: tuple[float, float]

    @property
    def used(self) -> bool:
        """Whether the values are by sound, too."""
        return not self.reason


@dataclass(frozen=True, eq=False)
class Motion:
    """The tuned simulator's motion beside the observed one.

    Attributes:
        curves: Both.
        fit: Residual between them.
        equivalents: For simulators without air.
        unidentifiable: What the log cannot determine of the parameters, in words.
        unknown: Names of parameters whose units cannot be determined.
        units: Of the log; None for an experiment whose logs always name them.
        sound: Contribution of sound; None if there is no sound.
    """

    curves: Curves | None = None
    fit: SimulationFit | None = None
    equivalents: Equivalents | None = None
    unidentifiable: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()
    units: Units | None = None
    sound: SoundShare | None = None


# ---- Record: the result for one log, without samples.


@dataclass(frozen=True)
class Provenance:
    """Provenance of a record.

    Attributes:
        version: Of this package.
        log_sha256: Of the log; of a folder, of the names and contents of its files.
        options: Those that differ from the defaults, by name.
        tares: Name and SHA-256 of each empty run.
        date: When it was tuned, ISO 8601 in UTC.
        engine: Simulator with its version; None if nothing was simulated.
    """

    version: str
    log_sha256: str
    options: Mapping[str, Any]
    tares: tuple[Mapping[str, str], ...]
    date: str
    engine: str | None


Interval = tuple[float, float]  # lower and upper end


@dataclass(frozen=True)
class Estimate:
    """Estimated quantity.

    Attributes:
        name: The field's standard term, e.g. "restitution".
        unit: "1" if it has none.
        value: One number, or one for each component.
        interval95: Lower and upper end of each number; None if no valid one exists.
    """

    name: str
    unit: str
    value: float | tuple[float, ...]
    interval95: Interval | tuple[Interval, ...] | None

    @property
    def components(self) -> tuple[Component, ...]:
        """Its scalars: `payload_com_x`, or `NAME_1` if they are no axes."""
        names = [self.name]
        values = self.value if isinstance(self.value, tuple) else (self.value,)
        if isinstance(self.value, tuple):
            axes = _AXES if len(values) == len(_AXES) else range(1, len(values) + 1)
            names = [f"{self.name}_{axis}" for axis in axes]
        intervals: list[Interval | None] = [None] * len(values)
        if self.interval95 is not None:
            ends = np.reshape(self.interval95, (-1, 2)).tolist()
            intervals = [(low, high) for low, high in ends]
        return tuple(map(Component, names, values, intervals))


@dataclass(frozen=True)
class Component:
    """Scalar of an estimate.

    Attributes:
        interval95: None if no valid one exists.
    """

    name: str
    value: float
    interval95: Interval | None


_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Rebound:
    """One impact of a ball, with its coefficient of restitution.

    Attributes:
        impact_s: Time of impact, on the log's clock [s].
        restitution: At this impact.
        interval95: Of the restitution; None if no valid one exists.
        impact_speed_m_s: None if the scale cannot be determined.
    """

    impact_s: float
    restitution: float
    interval95: Interval | None
    impact_speed_m_s: float | None


@dataclass(frozen=True, eq=False)
class Record:
    """Result of one tuning, without samples.

    Attributes:
        log: The file's name.
        task: Kind of experiment; None if the log could not be read.
        reason: Why the verdict is not "ok", with a remedy; None if it is.
        estimates: The task's parameters first; none for a rejected log.
        physical: Whether the values are the object's own, or numbers of one engine's settings.
        method: Estimation method; None if nothing was estimated.
        rollouts: All simulator runs.
        iterations: The task's parameters by name, for each iterate.
        is_fitted: Whether the last iterate is an exact fit's.
        simulator: "engine", "preset" and "step_hz"; None if nothing was simulated.
        weights: "preset" and "sha256" of the network that was used; None without one.
        ball: As it was named when recording.
        topic: Where the experiment was found.
        window: Times of its events by name [s since the log's first sample].
        seconds: Wall time by stage.
    """

    log: str
    task: str | None
    verdict: Verdict
    reason: str | None
    estimates: tuple[Estimate, ...] = ()
    physical: bool = True
    method: str | None = None
    rollouts: int = 0
    iterations: tuple[Mapping[str, float], ...] = ()
    is_fitted: bool = False
    rebounds: tuple[Rebound, ...] = ()
    cross_check: CrossCheck | None = None
    checks: tuple[Check, ...] = ()
    warnings: tuple[str, ...] = ()
    simulator: Mapping[str, Any] | None = None
    weights: Mapping[str, str] | None = None
    ball: str | None = None
    topic: str | None = None
    window: Mapping[str, float] | None = None
    seconds: Mapping[str, float] = field(default_factory=dict)
    provenance: Provenance | None = None
    motion: Motion = field(default_factory=Motion)

    def estimate(self, name: str) -> Estimate | None:
        """Return the quantity of that name, or None."""
        return next((known for known in self.estimates if known.name == name), None)

    def to_frame(self) -> pd.DataFrame:
        """Return the values as a table, one row per scalar, such as `payload_com_x`.

        Index `parameter`; columns `value`, `low`, `high` (ends of the 95 % interval; NaN without a
        valid one) and `unit`. No rows for a rejected log.
        """
        import pandas as pd

        rows = [
            (part.name, part.value, *(part.interval95 or (np.nan, np.nan)), known.unit)
            for known in self.estimates
            for part in known.components
        ]
        columns = ["parameter", "value", "low", "high", "unit"]
        return pd.DataFrame(rows, columns=columns).set_index("parameter")


# ---- Sound: its contribution as JSON.


def sound_fields(sound: SoundShare) -> dict[str, Any]:
    """Return the key `sound` of a record."""
    return {
        "impacts": sound.impacts,
        "heard": sound.heard,
        "offset_s": sound.offset_s,
        "used": sound.used,
        "reason": sound.reason or None,
        "without": {"restitution": sound.restitution, "interval95": sound.interval95},
    }


def read_sound(fields: Mapping[str, Any]) -> SoundShare:
    """Parse what `sound_fields` wrote.

    Raises:
        ValueError, TypeError, LookupError: A value is invalid.
    """
    offset_s, without = fields["offset_s"], fields["without"]
    low, high = without["interval95"]
    numbers = [float(without["restitution"]), float(low), float(high)]
    numbers += [] if offset_s is None else [float(offset_s)]
    if not all(map(math.isfinite, numbers)):
        raise ValueError("a number of its sound is not finite")
    reason = str(fields["reason"] or "")
    if bool(fields["used"]) != (offset_s is not None) or bool(reason) == bool(fields["used"]):
        raise ValueError("its sound is used and is not")
    return SoundShare(
        int(fields["impacts"]),
        int(fields["heard"]),
        None if offset_s is None else numbers[3],
        reason,
        numbers[0],
        (numbers[1], numbers[2]),
    )


# ---- JSON: format a record, and parse one.

Value = TypeVar("Value")

# Of a time [s] and a height [m]: a tenth of a millimetre, and the time it takes to fall so far.
_TIME_DECIMALS, _HEIGHT_DECIMALS = 5, 4

# Of a file that may be a record: several times one with the longest curves.
MAX_RECORD_BYTES = 4_000_000

_MAX_REASON_CHARACTERS = 200  # of what is wrong with a file, in the message
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
        "parameters": _parameter_fields(record) or None,
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
        "unidentifiable": motion.unidentifiable,
        "units": motion.units and _unit_fields(motion.units),
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


def _parameter_fields(record: Record) -> dict[str, Any]:
    """Return the estimates; null if one's units cannot be determined."""
    found: dict[str, Any] = {
        known.name: {"value": known.value, "interval95": known.interval95, "unit": known.unit}
        for known in record.estimates
    }
    unknown = record.motion.unknown if found else ()
    return found | {name: {"value": None, "interval95": None} for name in unknown}


def _unit_fields(units: Units) -> dict[str, Any]:
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
        why = short_name(error, _MAX_REASON_CHARACTERS)
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
        why = short_name(error, _MAX_REASON_CHARACTERS)
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
            tuple(map(str, fields.get("unidentifiable") or ())),
            tuple(
                str(name)
                for name, known in (fields["parameters"] or {}).items()
                if known["value"] is None
            ),
            _optional(_units, fields.get("units")),
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


def _units(fields: Mapping[str, Any]) -> Units:
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
