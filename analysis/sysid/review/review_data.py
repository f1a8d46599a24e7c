"""Data that a simulator's review draws: columns over the log's time."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from analysis.record import Tuning
from analysis.review.drawing import Color, ramp
from analysis.sysid.compared import Column
from analysis.sysid.experiment import SimulatorDetection
from analysis.sysid.fit import HeldOut, SimulatorFit
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import short_name

MAIN = 4  # columns of the first tab: as many have axes with ticks; the others have a tab
_MAX_COLUMNS = 16  # that are drawn, those that vary most: more would be too small to read
# Of one curve: more can neither be told apart nor be loaded soon.
_MAX_HZ, _MAX_SAMPLES = 120.0, 3000

_MAX_LINES = 8  # iterations over the log's time; all of them can be scrubbed
_MAX_NAME = 34  # of a column, in letters: a title's room in a laptop's view
_BOLD, _THIN = 1.6, 0.8  # widths of the result's curve and of the iterations before [points]
_MIN_NOISE = 1e-9  # of a column, as a share of its spread


@dataclass(frozen=True, eq=False)
class Iterate:
    """One iteration, and how it is drawn.

    Attributes:
        name: "k=3", "refined".
        color: Of its line.
        width: Of its line [points].
        values: Of the tuned parameters, shape (P,).
        started: All parameters by name as simulated, those of the initial state, too.
    """

    name: str
    color: Color
    width: float
    values: Array
    started: dict[str, float]


@dataclass(frozen=True, eq=False)
class ShownColumn:
    """One column of the log with those of all iterations.

    Attributes:
        name: Short, without unit.
        unit: Of its values.
        noise: Standard deviation.
        seconds: Since the log's first sample, shape (T,).
        observed: Shape (T,).
        simulated: Of each iteration, shape (T, K); NaN where it shows nothing.
        fitted: Of a fit to the first part of the log, shape (T,); None if there is none.
        given: Of the simulator as given, likewise.
        rms: Residual of each iteration, shape (K,).
        held_out_rms: Hold-out residual of the fit to the first part, and of the simulator as
            given; None if there is none.
    """

    name: str
    unit: str
    noise: float
    seconds: Array
    observed: Array
    simulated: Array
    fitted: Array | None
    given: Array | None
    rms: Array
    held_out_rms: tuple[float, float] | None

    def title(self, what: str = "") -> str:
        """Format the name with its unit: "position elbow [rad]"."""
        unit = "" if self.unit in ("", "1") else f"[{short_name(self.unit, 12)}]"
        return " ".join(filter(None, (self.name, what, unit)))

    def shown(self, *curves: Array) -> tuple[float, float]:
        """Return the range of the observation and of these curves."""
        values = np.concatenate([self.observed, *(curve[np.isfinite(curve)] for curve in curves)])
        low, high = float(values.min()), float(values.max())
        least = max(6 * self.noise, 1e-6 * max(abs(low), abs(high)), 1e-9)
        more = max(0.0, least - (high - low)) / 2
        return low - more, high + more


@dataclass(frozen=True, eq=False)
class SimulatorReviewData:
    """Data of one tuning's review, but for the scene.

    Attributes:
        columns: Those that vary most, relative to their noise, first.
        left_out: How many more there are.
        iterates: The last is the result.
        drawn: Indices of the iterates that are drawn over the log's time.
        parameters: That were tuned, P of them.
        interval95: Of the result, shape (P, 2); None if no valid one exists.
        held_out_s: Start of the hold-out; None if there is none.
        first_s: First stamp [s since the log's first sample].
    """

    columns: tuple[ShownColumn, ...]
    left_out: int
    iterates: tuple[Iterate, ...]
    drawn: tuple[int, ...]
    parameters: tuple[Parameter, ...]
    interval95: Array | None
    held_out_s: float | None
    first_s: float

    @property
    def main(self) -> tuple[ShownColumn, ...]:
        """Columns of the first tab."""
        return self.columns[:MAIN]

    @property
    def others(self) -> tuple[ShownColumn, ...]:
        """Remaining columns."""
        return self.columns[MAIN:]


def simulator_review_data(tuning: Tuning) -> SimulatorReviewData:
    """Collect the data from a tuning that compared a log with a simulator."""
    found: SimulatorDetection = tuning.detection
    target = found.connected.target
    assert tuning.trace is not None
    fit: SimulatorFit | None = tuning.trace.fit.detail if tuning.trace.fit else None
    held = fit.held_out if fit else None
    seen = np.column_stack([np.full(len(target.values), np.nan)] * len(tuning.trace.steps))
    iterates: list[Iterate] = []
    count = len(tuning.trace.steps)
    for k, step in enumerate(tuning.trace.steps):
        assert step.evaluation is not None
        is_last = k == count - 1
        seen[:, k] = target.seen_in(step.evaluation.episode)
        iterates.append(
            Iterate(
                "refined" if is_last and fit is not None else f"k={k}",
                ramp(k, count) if count > 1 else ramp(1, 2),
                _BOLD if is_last else _THIN,
                np.asarray(step.values, dtype=np.float64),
                dict(step.evaluation.episode.info.truth),
            )
        )
    varying = [
        -one.spread / max(one.noise, _MIN_NOISE * one.spread, 1e-300) for one in target.columns
    ]
    order = np.argsort(varying, kind="stable")[:_MAX_COLUMNS]
    names = _names(target.columns)
    columns = [_shown(number, names[number], found, seen, fit, held) for number in order.tolist()]
    lines = np.unique(np.linspace(0, count - 1, min(count, _MAX_LINES)).round().astype(int))
    interval = tuning.interval95
    return SimulatorReviewData(
        tuple(columns),
        len(target.columns) - len(columns),
        tuple(iterates),
        tuple(lines.tolist()),
        tuple(tuning.parameters),
        None if interval is None else np.asarray(interval),
        None if held is None else held.from_s + found.offset_s,
        found.offset_s + float(target.seconds.min()),
    )


def _shown(
    number: int,
    name: str,
    found: SimulatorDetection,
    seen: Array,
    fit: SimulatorFit | None,
    held: HeldOut | None,
) -> ShownColumn:
    target = found.connected.target
    column = target.columns[number]
    every = _every(column.seconds)
    kept = np.flatnonzero(target.which == number)[::every]
    off = seen[target.which == number] - column.values[:, None]
    counts = np.maximum(np.isfinite(off).sum(axis=0), 1)
    return ShownColumn(
        name,
        column.unit,
        column.noise,
        column.seconds[::every] + found.offset_s,
        column.values[::every],
        seen[kept],
        None if held is None else held.simulated[kept],
        None if held is None or fit is None else fit.first[kept],
        np.sqrt(np.nansum(off**2, axis=0) / counts),
        None if held is None else (float(held.rms[number]), float(held.before[number])),
    )


def _every(seconds: Array) -> int:
    """Return the decimation of samples for drawing."""
    gap_s = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1.0
    return max(
        round(1 / (gap_s * _MAX_HZ)) if gap_s > 0 else 1, -(-len(seconds) // _MAX_SAMPLES), 1
    )


def _names(columns: tuple[Column, ...]) -> list[str]:
    """Shorten names to "position elbow"; longer if two are equal."""
    short = [f"{_last(one.signal)} {one.name}" for one in columns]
    counts = Counter(short)
    chosen = [
        name if counts[name] == 1 else one.label for name, one in zip(short, columns, strict=True)
    ]
    return [short_name(name, _MAX_NAME) for name in chosen]


def _last(signal: str) -> str:
    """Return the joint quantity, else the end of a topic: "tool/pose" of /robot/tool/pose."""
    topic, _, quantity = signal.rpartition(".")
    return quantity if topic else "/".join(signal.strip("/").split("/")[-2:])
