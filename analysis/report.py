"""A tuning in words and in JSON."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.tuning import Tuning
from recorders.simulators.engine import engine_name


def to_json(tuning: Tuning) -> str:
    """The tuning as one JSON object; its keys are a contract, new ones may be added."""
    return json.dumps(_as_dict(tuning), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _as_dict(tuning: Tuning) -> dict[str, Any]:
    found, trace = tuning.found, tuning.trace
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
        "iterations": [
            {"k": k, **_named(tuning, step.values)}
            for k, step in enumerate(trace.steps if trace else ())
        ],
        "bounces": _bounces(tuning),
        "cross_check": cross
        and {"method": cross.method, "value": cross.value, "agrees": cross.agrees},
        "checks": [
            {"name": one.name, "passed": one.passed, "detail": one.detail} for one in tuning.checks
        ],
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


def _named(tuning: Tuning, values: NDArray[np.float64]) -> dict[str, float]:
    return {one.name: float(value) for one, value in zip(tuning.parameters, values, strict=True)}


def _parameters(tuning: Tuning) -> dict[str, Any] | None:
    if tuning.estimate is None:
        return None
    return {
        one.name: {"value": float(value), "interval95": None, "unit": one.unit}
        for one, value in zip(tuning.parameters, tuning.estimate, strict=True)
    }


def _bounces(tuning: Tuning) -> list[dict[str, Any]]:
    if tuning.estimate is None or not tuning.physical:
        return []
    return [
        {
            "restitution": float(tuning.estimate[0]),
            "interval95": None,
            "impact_speed": tuning.found.drop.impact_speed_m_s,
            "unit": "m/s",
        }
    ]


def table(tunings: Sequence[Tuning]) -> str:
    """One line a log, and a line below for each that is not plainly ok."""
    rows = [("log", "verdict", "restitution", "cross-check", "drop", "rollouts", "time", "truth")]
    rows += [_row(tuning) for tuning in tunings]
    if all(row[-1] == "-" for row in rows[1:]):
        rows = [row[:-1] for row in rows]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
        for row in rows
    ]
    out = [lines[0]]
    for tuning, line in zip(tunings, lines[1:], strict=True):
        out.append(line)
        if tuning.reason:
            out.append(f"  {tuning.verdict}: {tuning.reason}")
        if tuning.estimate is not None and not tuning.physical:
            out.append(f"  {tuning.preset}: the engine's number at 60 Hz, not the ball's own")
    return "\n".join(out)


def _row(tuning: Tuning) -> tuple[str, ...]:
    estimate, cross = tuning.estimate, tuning.cross_check
    info = tuning.episode.info if tuning.episode else None
    truth = info.truth.get("restitution") if info else None
    return (
        str(tuning.log),
        tuning.verdict,
        "-" if estimate is None else f"{estimate[0]:.4f}",
        "-" if cross is None else f"{cross.value:.4f}",
        "-" if tuning.found is None else f"{tuning.found.drop.drop_height_m:.3f} m",
        str(tuning.rollouts),
        f"{tuning.seconds.get('total', 0.0):.2f} s",
        "-" if truth is None else f"{truth:.4f}",
    )
