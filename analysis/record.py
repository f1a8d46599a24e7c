"""A tuning in words and in JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.drop.bounces import bounces_of
from analysis.drop.checks import Check
from analysis.drop.curves import tuned_curves
from analysis.experiment import ExtraEstimate
from analysis.tuning import Tuning
from recorders.simulators.engine import engine_name
from tunenet_logs.wording import one_line


def to_json(tuning: Tuning) -> str:
    """The tuning as one JSON object; its keys are a contract, new ones may be added."""
    told = json.dumps(_as_dict(tuning), indent=1, ensure_ascii=False, allow_nan=False)
    overlay = tuned_curves(tuning)
    if overlay is not None:  # on one line: it is for programs
        curves = json.dumps(overlay.to_json(), allow_nan=False)
        told = f'{told.removesuffix("}").rstrip()},\n "curves": {curves}\n}}'
    return told + "\n"


def _as_dict(tuning: Tuning) -> dict[str, Any]:
    found = tuning.found
    cross = tuning.cross_check
    result: dict[str, Any] = {
        "log": tuning.log.name,
        "task": tuning.task,
        "verdict": tuning.verdict,
        "reason": tuning.reason,
        "parameters": _parameters(tuning),
        "physical": tuning.physical,
        "method": tuning.trace and tuning.method,
        "rollouts": tuning.rollouts,
        "iterations": _iterations(tuning),
        "bounces": _bounces(tuning),
        "cross_check": cross
        and {"method": cross.method, "value": cross.value, "agrees": cross.agrees},
        "checks": [_check(one) for one in tuning.checks],
        "warnings": list(tuning.warnings),
        "simulator": None,
        "weights": None,
        "ball": tuning.episode and tuning.episode.info.notes.get("ball"),
        "topic": None,
        "window": None,
        "seconds": {name: round(value, 4) for name, value in tuning.seconds.items()},
    }
    if found is not None:
        result["topic"] = found.topic
        result["window"] = dict(found.window)
    if found is not None and tuning.digest:
        result["simulator"] = {
            "engine": engine_name(),
            "preset": tuning.preset,
            "step_hz": round(found.step_hz, 3),
        }
        result["weights"] = {"preset": tuning.preset, "sha256": tuning.digest}
    return result


def _iterations(tuning: Tuning) -> list[dict[str, Any]]:
    steps = tuning.trace.steps if tuning.trace else ()
    rows: list[dict[str, Any]] = [
        {"k": k, **_named(tuning, step.values)} for k, step in enumerate(steps)
    ]
    if tuning.refined is not None:
        rows[-1]["refined"] = True
    return rows


def _named(tuning: Tuning, values: NDArray[np.float64]) -> dict[str, float]:
    return {one.name: float(value) for one, value in zip(tuning.parameters, values, strict=True)}


def _parameters(tuning: Tuning) -> dict[str, Any] | None:
    if tuning.estimate is None:
        return None
    told: dict[str, Any] = {
        one.name: {"value": float(value), "interval95": _interval(tuning, index), "unit": one.unit}
        for index, (one, value) in enumerate(zip(tuning.parameters, tuning.estimate, strict=True))
    }
    for one in tuning.further:
        ends = None if tuning.interval95 is None else one.interval95.tolist()
        told[one.name] = {"value": one.values.tolist(), "interval95": ends, "unit": one.unit}
    return told


def _check(check: Check) -> dict[str, Any]:
    result = {"name": check.name, "passed": check.passed, "detail": check.detail}
    return {**result, "advice": check.advice} if check.advice and not check.passed else result


def _interval(tuning: Tuning, index: int) -> list[float] | None:
    return None if tuning.interval95 is None else [float(end) for end in tuning.interval95[index]]


def _bounces(tuning: Tuning) -> list[dict[str, Any]]:
    return [
        {
            "restitution": one.restitution,
            "interval95": None if one.interval95 is None else list(one.interval95),
            "impact_speed": one.impact_speed_m_s,
            "unit": "m/s",
        }
        for one in bounces_of(tuning)
    ]


_FEWEST_DECIMALS, _MOST_DECIMALS = 4, 6


def interval_words(low: float, high: float) -> str:
    """An interval with as many decimals as its width asks for: equal ends would read as certainty.

    The last digits differ by two or more. Where six decimals do not show that, the ends are rounded
    away from each other.
    """
    for decimals in range(_FEWEST_DECIMALS, _MOST_DECIMALS + 1):
        first, last = round(low * 10**decimals), round(high * 10**decimals)
        if last - first >= 2:
            return _ends(first, last, decimals)
    most = 10**_MOST_DECIMALS
    return _ends(math.floor(low * most), math.ceil(high * most), _MOST_DECIMALS)


def _ends(first: int, last: int, decimals: int) -> str:
    unit = 10**decimals
    return f"{first / unit:.{decimals}f} to {last / unit:.{decimals}f}"


@dataclass(frozen=True)
class Row:
    """What a table shows of a tuning: small, so that it travels between processes.

    Attributes:
        read: whether the log could be read at all.
        parameter: name and unit of what was tuned; "" where that is not known.
        extent: see `Found.extent`; None where nothing was found.
        further: what else was found, in words.
        truth: what a simulator was set to, where the log says so; shown, never used.
    """

    log: Path
    read: bool
    verdict: str
    reason: str | None
    parameter: str
    estimate: float | None
    interval95: list[float] | None
    cross_check: float | None
    extent: tuple[str, str] | None
    rollouts: int
    seconds: float
    truth: float | None
    preset: str
    physical: bool
    further: tuple[str, ...]
    warnings: tuple[str, ...]


def row_of(tuning: Tuning) -> Row:
    """The row of a tuning."""
    episode, found = tuning.episode, tuning.found
    first = tuning.parameters[0] if tuning.parameters else None
    truth = None if episode is None or first is None else episode.info.truth.get(first.name)
    return Row(
        log=tuning.log,
        read=episode is not None,
        verdict=tuning.verdict,
        reason=tuning.reason,
        parameter="" if first is None else quantity(first.name, first.unit),
        estimate=None if tuning.estimate is None else float(tuning.estimate[0]),
        interval95=_interval(tuning, 0),
        cross_check=None if tuning.cross_check is None else tuning.cross_check.value,
        extent=None if found is None else found.extent,
        rollouts=tuning.rollouts,
        seconds=tuning.seconds.get("total", 0.0),
        truth=truth,
        preset=tuning.preset,
        physical=tuning.physical,
        further=tuple(further_words(one) for one in tuning.further),
        warnings=tuning.warnings,
    )


def quantity(name: str, unit: str) -> str:
    """A quantity's name with its unit: "restitution", "payload_mass [kg]"."""
    return name if unit == "1" else f"{name} [{unit}]"


def further_words(one: ExtraEstimate) -> str:
    """What else was found, each number with half its interval."""
    half = np.ptp(one.interval95, axis=1) / 2
    numbers = zip(one.values, half, strict=True)
    told = ", ".join(f"{value:.4f} ± {off:.4f}" for value, off in numbers)
    return f"{quantity(one.name, one.unit)} {told}"


def table(rows: Sequence[Row]) -> str:
    """One line a log, and lines below for what is more to say; a table for each parameter."""
    kinds = list(dict.fromkeys(row.parameter for row in rows if row.parameter)) or [""]
    parts = [[row for row in rows if (row.parameter or kinds[0]) == kind] for kind in kinds]
    return "\n\n".join(_table(kind, part) for kind, part in zip(kinds, parts, strict=True))


def _table(parameter: str, rows: Sequence[Row]) -> str:
    extents = [row.extent[0] for row in rows if row.extent is not None]
    columns = {
        "log": [one_line(row.log) for row in rows],
        "verdict": [row.verdict for row in rows],
        parameter: [_figure(row.estimate) for row in rows],
        "95 % interval": [
            "-" if row.interval95 is None else interval_words(*row.interval95) for row in rows
        ],
        "cross-check": [_figure(row.cross_check) for row in rows],
        (extents or [""])[0]: ["-" if row.extent is None else row.extent[1] for row in rows],
        "rollouts": [str(row.rollouts) for row in rows],
        "time": [_figure(row.seconds, ".2f", " s") for row in rows],
        "truth": [_figure(row.truth) for row in rows],
    }
    empty = {"truth"} if all(row.truth is None for row in rows) else set[str]()
    if all(row.interval95 is None for row in rows):
        empty.add("95 % interval")
    shown = {name: cells for name, cells in columns.items() if name and name not in empty}
    widths = [max(len(name), *map(len, cells)) for name, cells in shown.items()]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in zip(*([name, *cells] for name, cells in shown.items()), strict=True)
    ]
    out = [lines[0]]
    for row, line in zip(rows, lines[1:], strict=True):
        out += [line, *_below(row)]
    return "\n".join(out)


def _below(row: Row) -> list[str]:
    """What there is more to say of a log."""
    lines = [f"  {one}" for one in row.further]
    if row.reason:
        lines.append(one_line(f"  {row.verdict}: {row.reason}"))
    if row.estimate is not None and not row.physical:
        lines.append(f"  {row.preset}: the engine's number under the paper's settings")
    return lines


def _figure(value: float | None, form: str = ".4f", unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}}{unit}"
