"""Format tunings for the terminal, and texts shared with the review."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.checks import CrossCheck
from analysis.fitted_table import laid_out
from analysis.record import Estimate, Record, Tuning
from tunenet_logs.addresses import Address
from tunenet_logs.terminal import one_line

_MIN_DECIMALS, _MAX_DECIMALS = 4, 6  # of an interval's ends
# Of them, that is written out: no quantity is so large, but a stranger's file may say so.
_MAX_SIZE = 1e9


@dataclass(frozen=True, eq=False)
class Row:
    """Table row of a tuning: small, so that it travels between processes.

    Attributes:
        is_read: Whether the log could be read at all.
        parameter: Name and unit of what was tuned; "" if unknown.
        extent: See `Detection.extent`; None if nothing was found.
        truth: Ground truth of a simulator, if the log has it; shown, never used.
    """

    log: Path | Address
    record: Record
    is_read: bool
    parameter: str
    extent: tuple[str, str] | None
    preset: str
    truth: float | None


def row_of(tuning: Tuning, record: Record) -> Row:
    """Build the row of a tuning and its record."""
    presets = tuning.experiment.presets if tuning.experiment else {}
    parameter = presets[tuning.preset].parameters[0] if tuning.preset in presets else None
    truth = None
    if tuning.episode is not None and parameter is not None:
        truth = tuning.episode.info.truth.get(parameter.name)
    return Row(
        log=tuning.log,
        record=record,
        is_read=tuning.episode is not None,
        parameter=quantity(parameter.name, parameter.unit) if parameter else "",
        extent=tuning.detection.extent if tuning.detection else None,
        preset=tuning.preset,
        truth=truth,
    )


def table(rows: Sequence[Row], most: int | None = None) -> str:
    """Format a line per log, with indented lines below it; a table for each parameter.

    Args:
        rows: Of the logs.
        most: Width of the terminal, to which it is fitted; None for all of it.
    """
    parameters = list(dict.fromkeys(row.parameter for row in rows if row.parameter)) or [""]
    parts = [
        [row for row in rows if (row.parameter or parameters[0]) == parameter]
        for parameter in parameters
    ]
    tables = [
        laid_out(_columns(parameter, its), [_lines_below(row) for row in its], most)
        for parameter, its in zip(parameters, parts, strict=True)
    ]
    return "\n\n".join(tables)


def _columns(parameter: str, rows: Sequence[Row]) -> dict[str, list[str]]:
    """Return the cells of each column, by its name."""
    records = [row.record for row in rows]
    crosses = [record.cross_check for record in records]
    extents = [row.extent[0] for row in rows if row.extent is not None]
    columns = {
        "log": [one_line(row.log) for row in rows],
        "verdict": [record.verdict for record in records],
        parameter: [_value(record.estimates[:1]) for record in records],
        "95 % interval": [_interval(record) for record in records],
        **_other_parameters(records),
        "cross-check (tolerance)": [_cross(cross) for cross in crosses],
        (extents or [""])[0]: ["-" if row.extent is None else row.extent[1] for row in rows],
        "fits": [_fits(record) for record in records],
        "rollouts": [str(record.rollouts) for record in records],
        "time": [f"{record.seconds.get('total', 0.0):.2f} s" for record in records],
        "truth": ["-" if row.truth is None else f"{row.truth:.4f}" for row in rows],
    }
    for optional in ("truth", "95 % interval", "fits"):
        if set(columns[optional]) == {"-"}:
            del columns[optional]
    return {name: cells for name, cells in columns.items() if name}


def _cross(cross: CrossCheck | None) -> str:
    """Format a second estimate, and its tolerance."""
    if cross is None:
        return "-"
    return f"{cross.value:.4f}" + ("" if cross.tolerance is None else f" ({cross.tolerance:.4f})")


def cross_words(cross: CrossCheck) -> str:
    """Format a second estimate with its noise, its method, and its tolerance."""
    noise = "" if cross.noise95 is None else f" ± {cross.noise95:.4f} by its noise alone"
    allowed = (
        "" if cross.tolerance is None else f"; up to {cross.tolerance:.4f} off counts as agreed"
    )
    return f"{cross.value:.4f}{noise}, by {cross.method}{allowed}"


def _lines_below(row: Row) -> list[str]:
    """List what a table's line has no room for."""
    record = row.record
    lines = [extra_words(known) for known in record.estimates[1:] if isinstance(known.value, tuple)]
    if record.estimates:
        lines += [*filter(None, [equivalent_words(record)]), *record.motion.untold]
        lines += filter(None, [sound_words(record)])
    if record.reason:
        lines.append(one_line(f"{record.verdict}: {record.reason}"))
    if record.estimates and not record.physical:
        lines.append(f"{row.preset}: the engine's number under the paper's settings")
    return lines


_SHORT = {"restitution_slope": "slope"}  # what a table calls a parameter whose name is long


def _other_parameters(records: Sequence[Record]) -> dict[str, list[str]]:
    """Build a column for each further scalar parameter, with half its interval."""
    others = [known for record in records for known in record.estimates[1:]]
    names = dict.fromkeys(
        (known.name, known.unit) for known in others if isinstance(known.value, float)
    )
    return {
        quantity(_SHORT.get(name, name), unit): [_other(record, name) for record in records]
        for name, unit in names
    }


def _other(record: Record, name: str) -> str:
    known = record.estimate(name)
    return "-" if known is None else _numbers(known)


def _value(known: Sequence[Estimate]) -> str:
    return f"{known[0].value:.4f}" if known else "-"


def _fits(record: Record) -> str:
    """Format the RMS residual beyond the noise."""
    fit = record.motion.fit
    return "-" if fit is None or not record.estimates else f"{fit.excess_percent:.2f} %"


def _interval(record: Record) -> str:
    """Format the first parameter's interval; a suspect's is marked."""
    known = record.estimates[0] if record.estimates else None
    if known is None or known.interval95 is None:
        return "-"
    low, high = known.interval95
    assert isinstance(low, float)
    assert isinstance(high, float)
    return interval_words(low, high) + interval_mark(record)


def interval_mark(record: Record) -> str:
    """Return a mark for the interval of a verdict that is not ok."""
    return "" if record.verdict == "ok" else f" ({record.verdict})"


def interval_words(low: float, high: float) -> str:
    """Format an interval with enough decimals: equal ends would read as certainty.

    The last digits differ by two or more. If six decimals do not show that, the ends are rounded
    away from each other.
    """
    if max(abs(low), abs(high)) > _MAX_SIZE:
        return f"{low:.4g} to {high:.4g}"
    decimals = _MIN_DECIMALS
    while decimals < _MAX_DECIMALS and round(high * 10**decimals) - round(low * 10**decimals) < 2:
        decimals += 1
    unit = 10**decimals
    first, last = round(low * unit), round(high * unit)
    if last - first < 2:
        first, last = math.floor(low * unit), math.ceil(high * unit)
    return f"{first / unit:.{decimals}f} to {last / unit:.{decimals}f}"


def quantity(name: str, unit: str) -> str:
    """Format a quantity's name with its unit: "restitution", "payload_mass [kg]"."""
    return name if unit == "1" else f"{name} [{unit}]"


def extra_words(known: Estimate) -> str:
    """Format a quantity of several numbers, each with half its interval if it has one."""
    return f"{quantity(known.name, known.unit)} {_numbers(known)}"


def _numbers(known: Estimate) -> str:
    values = np.atleast_1d(known.value)
    halves = [""] * len(values)
    if known.interval95 is not None:
        widths = np.ptp(np.reshape(known.interval95, (-1, 2)), axis=1)
        halves = [f" ± {width / 2:.4f}" for width in widths]
    return ", ".join(f"{value:.4f}{half}" for value, half in zip(values, halves, strict=True))


_SAME = 0.001  # of a restitution: with a ball that differs by less, a simulator needs no air


def equivalent_words(record: Record) -> str:
    """Describe the ball for a simulator without air; "" if it is the same there."""
    known = record.motion.equivalents
    if known is None or not record.estimates:
        return ""
    value = float(np.atleast_1d(record.estimates[0].value)[0])
    if max(abs(one.restitution - value) for one in (known.first, known.all)) < _SAME:
        return ""
    return (
        f"without air: {known.first.restitution:.3f} for the first rebound "
        f"({known.first.rms_percent:.1f} % rms), {known.all.restitution:.3f} for all "
        f"({known.all.rms_percent:.1f} %)"
    )


def sound_words(record: Record) -> str:
    """Describe the contribution of sound, or why it is not used; "" if there is none."""
    sound = record.motion.sound
    if sound is None:
        return ""
    if sound.offset_s is None:
        return f"sound: not used: {sound.reason}"
    side = "after" if sound.offset_s >= 0 else "before"
    ends = record.estimates[0].interval95 if record.estimates else None
    now = "" if ends is None else f", {interval_words(*map(float, np.ravel(ends)))} with it"
    return (
        f"sound: {sound.heard} of {sound.impacts} impacts heard, {1000 * abs(sound.offset_s):.1f} "
        f"ms {side} the pictures; interval {interval_words(*sound.interval95)} without it{now}"
    )


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a Markdown table of text cells."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)
