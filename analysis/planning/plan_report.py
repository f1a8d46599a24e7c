"""Report a plan as a table, in words and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from analysis.planning.known_ball import KnownBall, SlopeSource
from analysis.planning.plan import BestShot, Plan
from analysis.planning.replay import Replay
from analysis.result_files import mark

_SLOPE_SOURCES: Mapping[SlopeSource, str] = {
    "tuned": "tuned",
    "bounces": "fitted to the tuning's bounces",
    "told": "as told",
    "assumed": "not known, taken as none",
}

# Of the heights that do not score, every tenth is in the table: all would fill a screen.
_EVERY = 10


def plan_json(plan: Plan, replay: Replay | None) -> str:
    """Format the plan as one JSON object; its keys are a contract, new ones may be added."""
    best = plan.best
    shots = [
        {
            "height": height,
            "miss": _or_none(miss),
            "clearance": clearance if clearance > -1 else None,
            "passes": clearance > 0,
            "scores": through,
            "touches_rim": touched,
        }
        for height, miss, clearance, through, touched in zip(
            plan.heights_m.tolist(),
            plan.miss_m.tolist(),
            plan.clearance_m.tolist(),
            plan.flights.is_through.tolist(),
            plan.flights.has_touched.tolist(),
            strict=True,
        )
    ]
    content: dict[str, Any] = {
        "made": mark("plan", plan.ball.logs),
        "task": "bounce-shot",
        "unit": "m",
        "ball": {
            "restitution": plan.ball.law.restitution,
            "slope": plan.ball.law.slope,
            "at_speed": plan.ball.law.at_m_s,
            "bounces": plan.ball.bounces,
            "slope_sd": plan.ball.slope_sd,
            "slope_from": plan.ball.slope_source,
            "drag": plan.rig.ball.air_drag_1_m,
            "drag_sd": plan.ball.drag_sd_1_m,
            "drag_from": drag_source(plan.ball),
        },
        "best": None if best is None else _best(best),
        "replay": replay
        and {
            "engine": replay.engine,
            "through": replay.is_through,
            "miss": _or_none(replay.miss_m),
        },
        "warnings": list(plan.warnings),
        "shots": shots,
        "rig": asdict(plan.rig),
        "seconds": {"plan": round(plan.seconds, 4)},
    }
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _best(best: BestShot) -> dict[str, Any]:
    return {
        "height": best.height_m,
        "miss": best.miss_m,
        "clearance": best.clearance_m,
        "impact_speed": best.impact_m_s,
        "restitution": best.restitution,
        "restitution_sd": best.restitution_sd,
        "tolerance": {
            "restitution": list(best.restitutions),
            "height": list(best.heights_m),
            "drag": best.drags_1_m and list(best.drags_1_m),
        },
        "margin_sd": best.margin,
    }


def plan_table(plan: Plan, replay: Replay | None) -> str:
    """Format the heights that pass and every tenth of the others, then the best in words."""
    head = f"{'height':>10}  {'miss':>8}  {'to the rim':>10}  outcome"
    lines = [head]
    for index, height in enumerate(plan.heights_m.tolist()):
        passes = plan.clearance_m[index] > 0
        if passes or index % _EVERY == 0 or index == len(plan.heights_m) - 1:
            room = f"{1000 * plan.clearance_m[index]:.1f} mm" if passes else "-"
            mark = "  <- best" if plan.best is not None and index == plan.best.index else ""
            lines.append(
                f"{height:8.4f} m  {_miss(float(plan.miss_m[index])):>8}  {room:>10}  "
                f"{outcome_words(plan, index)}{mark}"
            )
    again = [replay.words] if replay else []
    return "\n".join([*lines, "", *best_lines(plan), *again, *ball_lines(plan)])


def best_lines(plan: Plan) -> list[str]:
    """Describe the best shot, with its tolerances in restitution, height and drag."""
    best = plan.best
    if best is None:
        return ["no height scores"]
    drags = ""
    if best.drags_1_m is not None:
        drags = f", or a drag from {best.drags_1_m[0]:.3f} to {best.drags_1_m[1]:.3f} /m"
    below, above = (1000 * abs(end - best.height_m) for end in best.heights_m)
    return [
        f"best: let go {best.height_m:.4f} m above the touch; passes {1000 * best.miss_m:.1f} mm "
        f"from the centre, {1000 * best.clearance_m:.1f} mm from the rim",
        f"restitution {best.restitution:.4f} ± {best.restitution_sd:.4f} at its impact of "
        f"{best.impact_m_s:.2f} m/s along the plane's normal",
        f"still passes with a restitution from {best.restitutions[0]:.4f} to "
        f"{best.restitutions[1]:.4f}, or {below:.0f} mm lower to {above:.0f} mm higher{drags}",
    ]


def ball_lines(plan: Plan) -> list[str]:
    """Describe the ball's slope and drag, with their sources."""
    ball, law = plan.ball, plan.ball.law
    slope_sd = f" ± {ball.slope_sd:.3f}" if ball.slope_sd else ""
    drag_sd = f" ± {ball.drag_sd_1_m:.4f}" if ball.drag_sd_1_m else ""
    at = (
        ""
        if ball.slope_source in ("assumed", "told") and not law.slope
        else (f" of {law.restitution:.4f} at {law.at_m_s:.2f} m/s")
    )
    return [
        f"slope {law.slope:.3f}{slope_sd}{at} ({_SLOPE_SOURCES[ball.slope_source]})",
        f"drag {plan.rig.ball.air_drag_1_m:.4f}{drag_sd} /m ({drag_words(plan)})",
    ]


def drag_words(plan: Plan) -> str:
    """Describe where the drag of a plan comes from."""
    ball = plan.rig.ball
    if drag_source(plan.ball) != "rig":
        return drag_source(plan.ball)
    if ball.drag_1_m is not None:
        return "the rig's"
    return "no air" if ball.mass_kg is None else f"the rig's ball: {ball.body.words}"


def drag_source(ball: KnownBall) -> str:
    """Return where the drag comes from: the tuning, the user, the rig's ball."""
    if ball.drag_1_m is None:
        return "rig"
    return "told" if ball.slope_source == "told" else "tuned"


def outcome_words(plan: Plan, index: int) -> str:
    """Describe the simulated outcome of one height."""
    if plan.clearance_m[index] > 0:
        return "passes"
    if plan.flights.has_touched[index]:
        return "off the rim, in" if plan.flights.is_through[index] else "off the rim"
    return "misses"


def _miss(miss_m: float) -> str:
    return "-" if math.isnan(miss_m) else f"{1000 * miss_m:.0f} mm"


def _or_none(value: float) -> float | None:
    return None if math.isnan(value) else value
