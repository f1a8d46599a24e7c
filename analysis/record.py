"""Record of a tuning: its verdict, values, checks and provenance, written and read as JSON.

A field is declared once: the codec writes and reads dataclasses by their fields and annotations.
`metadata["key"]` is its key in the JSON if that is not its name; None for a field that is not
written, `BESIDE` for one whose own keys stand beside the others. The keys are a contract; new ones
may be added. A file is untrusted: every value is checked.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from functools import cache
from html import escape
from pathlib import Path
from types import NoneType, UnionType
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from tunenet_logs.analysis.checks import Check, CrossCheck, Verdict
from tunenet_logs.episode import Array
from tunenet_logs.errors import LogError
from tunenet_logs.files import parse_json, read_small_file
from tunenet_logs.terminal import short_name

if TYPE_CHECKING:
    import pandas as pd

BESIDE = ""  # key of a field whose own keys stand beside the others


def _key(key: str | None) -> dict[str, str | None]:
    return {"key": key}


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

    def highest_excess_percent(self, limit_percent: float) -> float:
        """Return what a true excess of a limit shows, a standard error above it."""
        square = (limit_percent**2 + self.noise_percent**2) * (
            1 + (2 / max(self.samples, 2)) ** 0.5
        )
        return excess(square**0.5, self.noise_percent)


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
    doubt: str = field(default="", metadata=_key(None))
    remedy: str = field(default="", metadata=_key(None))

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

    curves: Curves | None = field(default=None, metadata=_key(None))  # is written last
    fit: SimulationFit | None = field(default=None, metadata=_key("simulation_fit"))
    equivalents: Equivalents | None = field(default=None, metadata=_key("equivalent"))
    unidentifiable: tuple[str, ...] = ()
    unknown: tuple[str, ...] = field(default=(), metadata=_key(None))  # a parameter that is null
    units: Units | None = None
    sound: SoundShare | None = None


# ---- Record: the result for one log, without samples.

Interval = tuple[float, float]  # lower and upper end


@dataclass(frozen=True)
class TunedModel:
    """A model's file that was tuned.

    Attributes:
        path: As it was named.
        sha256: Of what moves it, in that file and those that it names; comments aside.
    """

    path: str
    sha256: str


@dataclass(frozen=True)
class Posterior:
    """Joint posterior of P tuned values, as a Gaussian about them.

    Attributes:
        sd: Standard deviation of each, in its unit.
        correlation: P rows of P.
        bounds: Lowest and highest value that physics allows of each.
        searched: Range in which each was looked for.
        unidentifiable: Names of those that the log cannot tell.
    """

    sd: tuple[float, ...]
    correlation: tuple[tuple[float, ...], ...]
    bounds: tuple[Interval, ...]
    searched: tuple[Interval, ...]
    unidentifiable: tuple[str, ...]


@dataclass(frozen=True)
class Gap:
    """How far a simulator is from one signal of one motion, as given and tuned.

    Attributes:
        signal: The log's, with the column, such as "joints.position elbow".
        motion: Name of its log or run; "" where there is only one.
        is_held_out: Whether it was not fitted.
        unit: Of the RMS errors.
        rms: As given, and tuned.
        delay_s: How much later than the simulator the log shows it, as given and tuned; None where
            it hardly moves.
        left: Tuned RMS error, in standard deviations of the signal; None where it hardly moves.
    """

    signal: str
    motion: str
    is_held_out: bool
    unit: str
    rms: tuple[float, float]
    delay_s: tuple[float, float] | None
    left: float | None


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
        model: The user's model that was tuned; None without one.
    """

    version: str
    log_sha256: str
    options: Mapping[str, Any]
    tares: tuple[Mapping[str, str], ...] = field(metadata=_key("tare"))
    date: str
    engine: str | None
    model: TunedModel | None = None


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
    """Scalar of an estimate."""

    name: str
    value: float
    interval95: Interval | None  # None if no valid one exists


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

    impact_s: float = field(metadata=_key("time_s"))
    restitution: float
    interval95: Interval | None
    impact_speed_m_s: float | None = field(metadata=_key("impact_speed"))


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
        posterior: Of the values of a simulator of one's own, in the order of the estimates; None
            where they have no intervals.
        gaps: Of each signal that is compared, for a simulator of one's own.
    """

    log: str
    task: str | None
    verdict: Verdict
    reason: str | None
    estimates: tuple[Estimate, ...] = field(default=(), metadata=_key("parameters"))  # by name
    physical: bool = True
    method: str | None = None
    rollouts: int = 0
    iterations: tuple[Mapping[str, float], ...] = ()
    is_fitted: bool = field(default=False, metadata=_key(None))  # in the last iteration
    rebounds: tuple[Rebound, ...] = field(default=(), metadata=_key("bounces"))
    motion: Motion = field(default_factory=Motion, metadata=_key(BESIDE))
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
    posterior: Posterior | None = None
    gaps: tuple[Gap, ...] = ()

    def estimate(self, name: str) -> Estimate | None:
        """Return the quantity of that name, or None."""
        return next((known for known in self.estimates if known.name == name), None)

    def __repr__(self) -> str:
        """Say verdict and values in one line."""
        values = [
            f"{part.name}={part.value:.6g}" for known in self.estimates for part in known.components
        ]
        return f"<{', '.join([f'{self.log}: {self.verdict}', *values])}>"

    def _repr_html_(self) -> str:
        said = f"{self.log}: {self.verdict}" + (f", {self.reason}" if self.reason else "")
        return f"<p>{escape(said)}</p>{self.to_frame().to_html()}"

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


# ---- Codec: dataclasses by their fields.

MAX_RECORD_BYTES = 4_000_000  # of a file that may be one: several times that of the longest curves
_MAX_REASON_CHARACTERS = 200  # of what is wrong with a file, in the message
_HEIGHTS = ("observed_m", "simulated_m")  # of the curves

# What is written beside, or in place of, what the fields say; `...` for nothing.
_WRITTEN: Mapping[type, Callable[[Any], dict[str, Any]]] = {
    Check: lambda check: {} if check.advice and not check.passed else {"advice": ...},
    Rebound: lambda _: {"unit": "m/s"},
    SimulationFit: lambda fit: {"excess_percent": fit.excess_percent},
    Equivalents: lambda both: {"speeds": both.first.speeds_m_s},
    SoundShare: lambda sound: {
        "used": sound.used,
        "reason": sound.reason or None,
        "without": {"restitution": sound.restitution, "interval95": sound.interval95},
        "restitution": ...,
        "interval95": ...,
    },
    # null, one, or a list of several
    Provenance: lambda one: {
        "tare": one.tares if len(one.tares) > 1 else (*one.tares, None)[0],
        **({} if one.model else {"model": ...}),
    },
    Record: lambda record: {
        **({} if record.posterior else {"posterior": ...}),
        **({} if record.gaps else {"gaps": ...}),
    },
}


def _read_sound(known: Mapping[str, Any]) -> dict[str, Any]:
    if known["used"] != (known["offset_s"] is not None) or bool(known["reason"]) == known["used"]:
        raise ValueError("its sound is used and is not")
    return {**known, **known["without"], "reason": known["reason"] or ""}


def _read_tares(known: Mapping[str, Any]) -> dict[str, Any]:
    tare = known.get("tare")
    return {**known, "tare": tare if isinstance(tare, list) else [tare] if tare else []}


# The fields' own keys, of what `_WRITTEN` says otherwise.
_READ: Mapping[type, Callable[[Mapping[str, Any]], Mapping[str, Any]]] = {
    Rebound: lambda known: {"time_s": 0.0, **known},  # a record of before has none
    SoundShare: _read_sound,
    Provenance: _read_tares,
}


def encode(value: Any) -> Any:
    """Return dataclasses as objects, tuples as lists, and all else as it is."""
    if isinstance(value, tuple):
        return [encode(one) for one in value]
    if isinstance(value, Mapping):
        return {name: encode(one) for name, one in value.items()}
    if not is_dataclass(value):
        return value
    found: dict[str, Any] = {}
    for one in fields(value):
        key = one.metadata.get("key", one.name)
        if key == BESIDE:
            found |= encode(getattr(value, one.name))
        elif key is not None:
            found[key] = encode(getattr(value, one.name))
    found |= encode(_WRITTEN.get(type(value), lambda _: {})(value))
    return {key: one for key, one in found.items() if one is not ...}


def decode(kind: Any, value: Any, name: str) -> Any:
    """Return a JSON's value as an annotation says it."""
    origin, kinds = get_origin(kind), get_args(kind)
    found = value
    if origin is UnionType:  # the first of several that it fits
        if value is None and NoneType in kinds:
            return None
        *others, last = [one for one in kinds if one is not NoneType]
        for one in others:
            with suppress(ValueError, TypeError):
                return decode(one, value, name)
        found = decode(last, value, name)
    elif kind is float:
        found = _number(name, value)
    elif isinstance(kind, type) and is_dataclass(kind):
        found = _decoded(kind, value)
    elif origin is tuple and isinstance(value, list):
        of_each = kinds[:1] * len(value) if kinds[1:] == (...,) else kinds
        found = tuple(decode(of, one, name) for of, one in zip(of_each, value, strict=True))
    elif origin is Mapping and isinstance(value, dict):
        found = {one: decode(kinds[1], of, one) for one, of in value.items()}
    elif not (kind is Any or type(value) is kind or (origin is Literal and value in kinds)):
        what = {str: "text", int: "whole number", bool: "truth value"}.get(kind, "such value")
        raise ValueError(f"{short_name(name)} {short_name(value)} is no {what}")
    return found


_hints = cache(get_type_hints)


def _decoded(kind: type, value: Any) -> Any:
    """Return a dataclass from an object; keys that are missing or null have their defaults."""
    if not isinstance(value, dict):
        raise TypeError(f"{short_name(value)} is no object")
    value = _READ.get(kind, lambda known: known)(value)
    given: dict[str, Any] = {}
    for one in fields(kind):
        key, hint = one.metadata.get("key", one.name), _hints(kind)[one.name]
        if key is None:
            continue
        found = value if key == BESIDE else value.get(key)
        has_default = one.default is not MISSING or one.default_factory is not MISSING
        if found is None and has_default:
            continue
        if key not in value and key != BESIDE and NoneType not in get_args(hint):
            raise KeyError(key)
        given[one.name] = decode(hint, found, key)
    return kind(**given)


def _number(name: str, value: Any) -> float:
    """Return a finite number; anything else is a ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{short_name(name)} {short_name(value)} is no finite number")
    return float(value)


# ---- Record: as JSON.


def record_fields(record: Record) -> dict[str, Any]:
    """Return the fields of the record's JSON, without the curves."""
    last = len(record.iterations) - 1
    found = encode(record)
    parameters: dict[str, Any] = {
        one.pop("name"): one | {"unit": one.pop("unit")} for one in found["parameters"]
    }
    for name in record.motion.unknown if parameters else ():  # its units cannot be determined
        parameters[name] = {"value": None, "interval95": None}
    found["parameters"] = parameters or None
    found["iterations"] = [
        {"k": k, **values, **({"refined": True} if record.is_fitted and k == last else {})}
        for k, values in enumerate(record.iterations)
    ]
    found["seconds"] = {name: round(value, 4) for name, value in record.seconds.items()}
    return found


def to_json(record: Record) -> str:
    """Format the record as one JSON object."""
    text = json.dumps(record_fields(record), indent=1, ensure_ascii=False, allow_nan=False)
    if (curves := record.motion.curves) is not None:  # on one line: it is for programs
        # To 0.1 mm, and the time to fall so far; null where there is no height.
        columns = {"seconds": np.round(curves.seconds, 5)}
        columns |= {name: np.round(getattr(curves, name), 4) for name in _HEIGHTS}
        known: dict[str, Any] = {"start_ns": curves.start_ns}
        for name, column in columns.items():
            known[name] = [one if math.isfinite(one) else None for one in column.tolist()]
        line = json.dumps(known, allow_nan=False)
        text = f'{text.removesuffix("}").rstrip()},\n "curves": {line}\n}}'
    return text + "\n"


def read_record(path: Path) -> Record:
    """Read the record in a JSON that `to_json` wrote."""
    try:
        known = parse_json(read_small_file(path, MAX_RECORD_BYTES))
    except OSError as error:
        what = f"{path}: cannot be read ({error.strerror})"
        raise LogError(what, "give a tuning's .json") from error
    except ValueError as error:
        what = f"{path}: is no JSON of a tuning ({short_name(error, _MAX_REASON_CHARACTERS)})"
        raise LogError(what, "give the .json that tunenet-tune wrote") from error
    if not isinstance(known, dict) or not {"verdict", "parameters"} <= known.keys():
        raise LogError(f"{path}: is no tuning", "give the .json that tunenet-tune wrote")
    try:
        return record_from(known)
    except (LookupError, ValueError, TypeError, AttributeError, ArithmeticError) as error:
        is_missing = isinstance(error, LookupError)
        why = f"{short_name(error)} is missing in it" if is_missing else ""
        why = why or short_name(error, _MAX_REASON_CHARACTERS)
        raise LogError(f"{path}: {why}", "tune the log again") from error


def record_in(data: bytes) -> Record:
    """Parse a record from a file's bytes."""
    try:
        return record_from(parse_json(data))
    except (LookupError, TypeError, AttributeError, ArithmeticError) as error:
        raise ValueError(str(error)) from error


def record_from(known: Mapping[str, Any]) -> Record:
    """Parse a record from a JSON's object; missing keys have their defaults."""
    ours = {"log": "", **known, "parameters": None, "iterations": None}
    record: Record = decode(Record, ours, "a tuning")
    parameters = known["parameters"] or {}
    estimates = tuple(
        decode(Estimate, {"unit": "1", **one, "name": name}, name)
        for name, one in parameters.items()
        if one["value"] is not None
    )
    for one in estimates:
        if one.interval95 is not None and np.shape(one.interval95) != (*np.shape(one.value), 2):
            raise ValueError(f"the interval of {short_name(one.name)} is none of its value")
    unknown = tuple(name for name, one in parameters.items() if one["value"] is None)
    steps = [dict(step) for step in known.get("iterations") or ()]
    of_steps = ("k", "refined")  # what an iteration has beside its parameters
    iterations = tuple(
        {name: _number(name, value) for name, value in step.items() if name not in of_steps}
        for step in steps
    )
    is_fitted = bool(steps and steps[-1].get("refined"))
    found = known.get("curves")
    curves = None if found is None else _curves(found)
    motion = replace(record.motion, unknown=unknown, curves=curves)
    ours = {"estimates": estimates, "iterations": iterations, "is_fitted": is_fitted}
    return replace(record, **ours, motion=motion)


def _curves(known: Mapping[str, Any]) -> Curves:
    """Parse the curves that `to_json` wrote."""
    curves = [np.array(known[name], np.float64) for name in ("seconds", *_HEIGHTS)]
    count = len(curves[0])
    if {curve.shape for curve in curves} != {(count,)} or not 2 <= count <= MAX_SAMPLES:
        raise ValueError("its curves have different lengths")
    # No curve of an experiment goes farther than 1e6 m or s.
    is_near = all(np.nanmax(np.abs(curve)) < 1e6 for curve in curves)
    if not is_near or np.any(np.diff(curves[0]) <= 0):
        raise ValueError("its curves make no sense")
    return Curves(int(known["start_ns"]), *curves)
