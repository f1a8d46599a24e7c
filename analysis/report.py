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

from analysis.bounces import bounces_of
from analysis.observe.quality import Check
from analysis.tuning import Tuning
from recorders.simulators.engine import engine_name
from tunenet_logs.wording import one_line


def to_json(tuning: Tuning) -> str:
    """The tuning as one JSON object; its keys are a contract, new ones may be added."""
    return json.dumps(_as_dict(tuning), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


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
        "method": tuning.method,
        "rollouts": tuning.rollouts,
        "iterations": _iterations(tuning),
        "bounces": _bounces(tuning),
        "cross_check": cross
        and {"method": cross.method, "value": cross.value, "agrees": cross.agrees},
        "checks": [_check(one) for one in tuning.checks],
        "warnings": list(tuning.warnings),
        "simulator": None,
        "weights": None,
        "topic": None,
        "window": None,
        "seconds": {name: round(value, 4) for name, value in tuning.seconds.items()},
    }
    if found is not None:
        drop = found.drop
        result["topic"] = found.topic
        result["window"] = {
            "start_s": drop.seconds[0],
            "impact_s": drop.impact_s,
            "end_s": drop.seconds[-1],
        }
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
    return {
        one.name: {"value": float(value), "interval95": _interval(tuning, index), "unit": one.unit}
        for index, (one, value) in enumerate(zip(tuning.parameters, tuning.estimate, strict=True))
    }


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


_HEADER = (
    "log",
    "verdict",
    "restitution",
    "95 % interval",
    "cross-check",
    "drop",
    "rollouts",
    "time",
    "truth",
)


@dataclass(frozen=True)
class Row:
    """What a table shows of a tuning: small, so that it travels between processes.

    Attributes:
        read: whether the log could be read at all.
        truth: what a simulator was set to, where the log says so; shown, never used.
    """

    log: Path
    read: bool
    verdict: str
    reason: str | None
    estimate: float | None
    interval95: list[float] | None
    cross_check: float | None
    drop_height_m: float | None
    rollouts: int
    seconds: float
    truth: float | None
    preset: str
    physical: bool
    warnings: tuple[str, ...]


def row_of(tuning: Tuning) -> Row:
    """The row of a tuning."""
    episode, found = tuning.episode, tuning.found
    return Row(
        log=tuning.log,
        read=episode is not None,
        verdict=tuning.verdict,
        reason=tuning.reason,
        estimate=None if tuning.estimate is None else float(tuning.estimate[0]),
        interval95=_interval(tuning, 0),
        cross_check=None if tuning.cross_check is None else tuning.cross_check.value,
        drop_height_m=None if found is None else found.drop.drop_height_m,
        rollouts=tuning.rollouts,
        seconds=tuning.seconds.get("total", 0.0),
        truth=None if episode is None else episode.info.truth.get("restitution"),
        preset=tuning.preset,
        physical=tuning.physical,
        warnings=tuning.warnings,
    )


def table(rows: Sequence[Row]) -> str:
    """One line a log, and a line below for each that is not plainly ok."""
    cells = [_HEADER, *(_cells(row) for row in rows)]
    empty = {_HEADER.index("truth")} if all(row.truth is None for row in rows) else set[int]()
    if all(row.interval95 is None for row in rows):
        empty.add(_HEADER.index("95 % interval"))
    cells = [tuple(cell for index, cell in enumerate(line) if index not in empty) for line in cells]
    widths = [max(len(line[column]) for line in cells) for column in range(len(cells[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in cells
    ]
    out = [lines[0]]
    for row, line in zip(rows, lines[1:], strict=True):
        out.append(line)
        if row.reason:
            out.append(one_line(f"  {row.verdict}: {row.reason}"))
        if row.estimate is not None and not row.physical:
            out.append(f"  {row.preset}: the engine's number at 60 Hz, not the ball's own")
    return "\n".join(out)


def _cells(row: Row) -> tuple[str, ...]:
    def figure(value: float | None, form: str = ".4f", unit: str = "") -> str:
        return "-" if value is None else f"{value:{form}}{unit}"

    return (
        one_line(row.log),
        row.verdict,
        figure(row.estimate),
        "-" if row.interval95 is None else interval_words(*row.interval95),
        figure(row.cross_check),
        figure(row.drop_height_m, ".3f", " m"),
        str(row.rollouts),
        figure(row.seconds, ".2f", " s"),
        figure(row.truth),
    )
