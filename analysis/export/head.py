"""Header of every exported file: provenance and meaning of its numbers."""

from __future__ import annotations

from typing import assert_never

from analysis.export.exported import ExportedBall, ExportedPayload, ExportOrigin, Sourced
from analysis.record import Estimate
from tunenet_logs.terminal import short_name

_MAX_REASON = 200  # characters of a verdict's reason


def ball_lines(ball: ExportedBall) -> list[str]:
    """List provenance and meaning of a ball's numbers; not yet escaped for a comment."""
    equivalents = ball.equivalents
    return [
        *origin_lines(ball.origin),
        f"Tuned: {estimate_words('restitution', ball.tuned)} at the first impact"
        f"{_at_words(ball.first_speed_m_s)}.",
        *(estimate_words("  its slope over speed", one) for one in (ball.slope,) if one),
        *(estimate_words("  drag of the air", one) for one in (ball.drag,) if one),
        f"In this file: restitution {ball.restitution:.4f}, {ball.meaning}.",
        *(
            (
                f"Without air: {equivalents.first.restitution:.4f} gives the recorded height of "
                f"the first rebound, {equivalents.all.restitution:.4f} is best over all bounces.",
            )
            if equivalents
            else ()
        ),
        f"Radius {sourced_words(ball.radius_m, 'm')}, mass {sourced_words(ball.mass_kg, 'kg')}, "
        f"drop height {sourced_words(ball.drop_height_m, 'm')}.",
        "Friction and spin: not identified by a drop; the engine's defaults stay.",
    ]


def one_restitution_lines(ball: ExportedBall) -> list[str]:
    """List what an engine with one restitution and no air cannot express."""
    lines = ["Not expressed here: a restitution that depends on speed, and the air's drag."]
    if ball.law.slope and ball.first_speed_m_s is not None:
        speeds = (ball.speed_m_s.value * factor for factor in (0.5, 1.0, 2.0))
        told = ", ".join(f"{_at(ball, speed):.3f} at {speed:.2f} m/s" for speed in speeds)
        lines.append(f"The tuned law says {told}: for another one, export again for that speed.")
    return lines


def payload_lines(payload: ExportedPayload) -> list[str]:
    """List provenance and meaning of a payload's numbers; not yet escaped for a comment."""
    centre = (
        "Its centre of mass was not told apart from its mass: the tool frame's origin stands here."
        if payload.com is None
        else f"Tuned: {estimate_words('centre of mass', payload.com)}, in the tool frame."
    )
    return [
        *origin_lines(payload.origin),
        f"Tuned: {estimate_words('mass', payload.mass)}.",
        centre,
        f"Its own inertia is not identified: that of a solid ball of {payload.radius_m:g} m "
        "radius, as the tuning assumed.",
        "Mount it with its origin on the tool frame of the arm that was tuned, axes along it.",
    ]


def origin_lines(origin: ExportOrigin) -> list[str]:
    """List log, verdict and versions."""
    tuned = f", tuned {short_name(origin.date)} by {short_name(origin.tuned_by)}"
    lines = [
        f"Exported by tunenet-export {origin.version} from the tuning of {short_name(origin.log)}"
        f"{tuned if origin.date else ''}.",
        *((f"SHA-256 of the log: {short_name(origin.log_sha256, 64)}",) * bool(origin.log_sha256)),
        f"Verdict: {origin.verdict}.",
    ]
    if origin.verdict == "suspect":
        reason = short_name(origin.reason or "no reason is given", _MAX_REASON)
        lines.append(f"WARNING: this tuning is suspect: {reason}")
    return lines


def estimate_words(name: str, estimate: Estimate) -> str:
    """Format a quantity with its interval: `restitution 0.8001 (95 %: 0.7997 to 0.8005)`."""
    unit = "" if estimate.unit == "1" else f" {short_name(estimate.unit)}"
    if isinstance(estimate.value, tuple):
        value = ", ".join(f"{part:.4f}" for part in estimate.value)
    else:
        value = f"{estimate.value:.4f}"
    return f"{name} {value}{unit} ({_interval_words(estimate)})"


def _interval_words(estimate: Estimate) -> str:
    if estimate.interval95 is None:
        return "no honest interval"
    ends = estimate.interval95
    pairs = ends if isinstance(ends[0], tuple) else (ends,)
    return "95 %: " + "; ".join(f"{pair[0]:.4f} to {pair[1]:.4f}" for pair in pairs)  # pyright: ignore[reportIndexIssue] (pairs by now)


def sourced_words(known: Sourced, unit: str) -> str:
    """Format a number with its source."""
    match known.source:
        case "record":
            told = "of the tuning"
        case "option":
            told = "as asked for"
        case "assumed":
            told = "assumed"
        case _:
            assert_never(known.source)
    return f"{known.value:.4g} {unit} ({told})"


def _at_words(speed_m_s: float | None) -> str:
    return ", of unknown speed" if speed_m_s is None else f" of {speed_m_s:.2f} m/s"


def _at(ball: ExportedBall, speed_m_s: float) -> float:
    import numpy as np

    return float(ball.law.at(np.array(speed_m_s)))
