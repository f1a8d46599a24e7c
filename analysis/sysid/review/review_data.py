"""What a simulator's review draws, taken from a tuning once: columns over the log's time."""

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

MAIN = 4
"""Columns of the first tab: as many have axes with ticks; the others have a tab."""

_MOST_COLUMNS = 16
"""That are drawn, those that vary most: more would be too small to read."""

_MOST_HZ, _MOST_SAMPLES = 120.0, 3000
"""Of one curve: more can neither be told apart nor be loaded soon."""

_MOST_LINES = 8
"""Iterations over the log's time; all of them can be scrubbed."""

_LONGEST_NAME = 34
"""Of a column, in letters: a title's room in a laptop's view."""

_BOLD, _THIN = 1.6, 0.8
"""Widths of the result's curve and of the iterations before [points]."""

_LEAST_NOISE = 1e-9
"""Of a column, as a share of its spread."""


@dataclass(frozen=True, eq=False)
class Iterate:
    """One iteration, and how it is drawn.

    Attributes:
        name: "k=3", "refined".
        color: of its line.
        width: of its line [points].
        values: of the tuned parameters, shape (P,).
        started: of all parameters, those of the initial state, too, by name; as it was simulated.
    """

    name: str
    color: Color
    width: float
    values: Array
    started: dict[str, float]


@dataclass(frozen=True, eq=False)
class ShownColumn:
    """One column of the log with what all iterations show of it.

    Attributes:
        name: short, with no unit.
        unit: of its values.
        noise: standard deviation.
        seconds: since the log's first sample, shape (T,).
        observed: shape (T,).
        simulated: of each iteration, shape (T, K); NaN where it shows nothing.
        fitted: of a fit to the first part of the log, shape (T,); None where there is none.
        given: of the simulator as it was given, likewise.
        rms: what each iteration leaves, shape (K,).
        held_out_rms: of the fit to the first part in what comes after, and of the simulator as it
            was given; None where there is none.
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
        """With the unit: "position elbow [rad]"."""
        unit = "" if self.unit in ("", "1") else f"[{short_name(self.unit, 12)}]"
        return " ".join(filter(None, (self.name, what, unit)))

    def shown(self, *curves: Array) -> tuple[float, float]:
        """The least and greatest value of what was observed and of these curves."""
        values = np.concatenate([self.observed, *(curve[np.isfinite(curve)] for curve in curves)])
        low, high = float(values.min()), float(values.max())
        least = max(6 * self.noise, 1e-6 * max(abs(low), abs(high)), 1e-9)
        more = max(0.0, least - (high - low)) / 2
        return low - more, high + more


@dataclass(frozen=True, eq=False)
class SimulatorReviewData:
    """All that one tuning's review shows, but for the scene.

    Attributes:
        columns: those that vary most, relative to their noise, first.
        left_out: how many more there are.
        iterates: the last is the result.
        drawn: numbers of the iterates that lie over the log's time.
        parameters: that were tuned, P of them.
        interval95: of the result, shape (P, 2); None where none is honest.
        held_out_s: when the part begins that a second fit predicts; None where there is none.
        first_s: the first moment [s since the log's first sample].
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
        """Those that the first tab has room for."""
        return self.columns[:MAIN]

    @property
    def others(self) -> tuple[ShownColumn, ...]:
        """The rest."""
        return self.columns[MAIN:]


def simulator_review_data(tuning: Tuning) -> SimulatorReviewData:
    """From a tuning that compared a log with a simulator."""
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
        -one.spread / max(one.noise, _LEAST_NOISE * one.spread, 1e-300) for one in target.columns
    ]
    order = np.argsort(varying, kind="stable")[:_MOST_COLUMNS]
    names = _names(target.columns)
    columns = [_shown(number, names[number], found, seen, fit, held) for number in order.tolist()]
    lines = np.unique(np.linspace(0, count - 1, min(count, _MOST_LINES)).round().astype(int))
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
    """Each how many samples one is drawn."""
    gap_s = float(np.median(np.diff(seconds))) if len(seconds) > 1 else 1.0
    return max(
        round(1 / (gap_s * _MOST_HZ)) if gap_s > 0 else 1, -(-len(seconds) // _MOST_SAMPLES), 1
    )


def _names(columns: tuple[Column, ...]) -> list[str]:
    """Short ones: "position elbow" of /joint_states.position elbow; longer where two are equal."""
    short = [f"{_last(one.signal)} {one.name}" for one in columns]
    counts = Counter(short)
    chosen = [
        name if counts[name] == 1 else one.label for name, one in zip(short, columns, strict=True)
    ]
    return [short_name(name, _LONGEST_NAME) for name in chosen]


def _last(signal: str) -> str:
    """The quantity of joints, else the end of a topic's name: "tool/pose" of /robot/tool/pose."""
    topic, _, quantity = signal.rpartition(".")
    return quantity if topic else "/".join(signal.strip("/").split("/")[-2:])
