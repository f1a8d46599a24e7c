"""Checks of a tuned simulator: residuals, hold-out, identifiability, step size.

An unidentifiable parameter comes with advice on the motion that excites it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tunenet_logs.analysis.checks import Check
from tunenet_logs.analysis.sysid.fit import ComparedColumns, SimulatorFit, noise_of
from tunenet_logs.episode import Array, Episode
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.recorders.simulators.model.rollout import STOPPED
from tunenet_logs.terminal import listed

# ---- Motions that excite a parameter that is unidentifiable from a log

_MAX_PARTNERS = 3

# By the name of the parameter's field.
_MOTIONS: Mapping[str, str] = {
    "damping": "move it at several speeds, the fastest ones too",
    "frictionloss": "move it slowly and reverse often",
    "armature": "change its speed fast, as in short swings",
    "stiffness": "move it far to both sides",
    "springref": "let it come to rest with nothing driving it",
    "mass": "lift it and swing it, with the torques or commands recorded",
    "ipos": "turn it about several axes",
    "inertia": "turn it fast about several axes",
    "friction": "let it slide further, or push it along",
    "solref": "let it hit the ground from several heights",
    "solimp": "let it hit the ground from several heights",
    "kp": "command steps as well as slow motions",
    "kv": "command steps as well as slow motions",
    "gear": "command large and small motions",
    "gravity": "hold it in several positions, with the torques recorded",
    "density": "move it fast",
    "viscosity": "move it at several speeds",
    "delay": "command steps and fast changes",
}


def excitation(name: str, partners: Sequence[str]) -> str:
    """Return what to record to make a parameter identifiable, apart from its partners."""
    field = name.partition("/")[0] if name.startswith("delay/") else name.rpartition(".")[2]
    field = field.partition("[")[0]
    motion = _MOTIONS.get(field, "record a motion that it changes")
    if partners:
        return (
            f"measure one of {listed([name, *partners], _MAX_PARTNERS)} and leave it out of the "
            f"tuning, or record what drives it; {motion}"
        )
    return motion


# ---- The checks

_MOVES = 3.0  # times its noise that a column has to vary by, one at least
# Of a column's spread, that a simulator may leave; of one that jumps more, for a jump that is met a
# little early or late leaves some of itself.
_REJECT_SHARE = 0.5
_GOOD_SHARE, _GOOD_JUMPY_SHARE = 0.05, 0.1

_STILL_SHARE = 1e-2  # least spread of a column, by the largest of the columns of its unit
_NOISES = 1.3  # times the noise that a column may keep where that is more than its share
_HELD_OUT_FACTOR = 2.0
# Of a column's spread: a prediction that is closer than this is good whatever the fit left.
_SLACK_SHARE = 0.02

_EDGE_SHARE = 0.002  # of a range: a value that is closer to its end lies on it
_FEW = 4
_WRONG_MODEL = (
    "check the model: masses, lengths, gravity, missing joints, and what --map takes for what"
)


def recording_checks(target: ComparedColumns) -> tuple[Check, ...]:
    """Check that the log itself moves."""
    ratios = [column.spread / max(column.noise, 1e-12) for column in target.columns]
    best = int(np.argmax(ratios))
    detail = (
        f"{target.columns[best].label} varies by {ratios[best]:.3g} times its noise (wanted: "
        f"{_MOVES:g} or more)"
    )
    advice = "record while it moves"
    return (Check("it moves", ratios[best] >= _MOVES, detail, fatal=True, advice=advice),)


def whole_check(rollout: Episode) -> Check | None:
    """Check that a model's rollout came to its end; None if the simulator does not report it."""
    stopped = rollout.info.notes.get(STOPPED)
    if stopped is None:
        return None
    return Check(
        "simulation is whole",
        not stopped,
        stopped or "MuJoCo warns of nothing",
        fatal=True,
        advice="give the model a shorter timestep, more <size memory>, or other ranges with --tune",
    )


def match_check(target: ComparedColumns, residuals: Array) -> Check:
    """Check that each column's residual is its noise, or little of its motion."""
    left = target.rms(residuals)
    spreads = np.array([_spread(target, column.unit, column.spread) for column in target.columns])
    noises = _noises(target, residuals)
    jumpy = np.array([column.is_jumpy for column in target.columns])
    good = np.where(jumpy, _GOOD_JUMPY_SHARE, _GOOD_SHARE)
    limits = np.maximum(_NOISES * noises / spreads, good)
    over = left / spreads / limits
    place = int(np.argmax(over))
    worst = target.columns[place]
    share = left[place] / spreads[place]
    detail = (
        f"{100 * share:.3g} % of how much {worst.label} varies is left, rms (wanted: under "
        f"{100 * limits[place]:.3g} %)"
    )
    return Check(
        "simulation matches",
        over[place] < 1,
        detail,
        fatal=share > _REJECT_SHARE,
        advice=_WRONG_MODEL,
    )


def _noises(target: ComparedColumns, residuals: Array) -> Array:
    """Return the noise of each column; of one that jumps, of its residual.

    A servo's efforts jump with each command: by themselves they look like noise, of a size at which
    any simulator would match.
    """
    found: list[float] = []
    for number, column in enumerate(target.columns):
        left = residuals[target.which == number]
        noise = noise_of(left[np.isfinite(left)]) if column.is_jumpy else column.noise
        found.append(min(noise, column.noise))
    return np.array(found)


def _spread(target: ComparedColumns, unit: str, spread: float) -> float:
    """Return a column's spread, at least a share of that of columns of its unit."""
    most = max(column.spread for column in target.columns if column.unit == unit)
    return max(spread, _STILL_SHARE * most, 1e-12)


def fit_checks(found: SimulatorFit) -> tuple[Check, ...]:
    """Check an exact fit: hold-out, bounds, identifiability, step size."""
    checks = [_range_check(found), _told_check(found)]
    if found.held_out is not None:
        checks.insert(0, _held_out_check(found))
    if found.step_shift is not None:
        checks.append(_step_check(found))
    return tuple(checks)


def _held_out_check(found: SimulatorFit) -> Check:
    """Check that a fit to the beginning predicts the end, and better than the given model."""
    held_out = found.held_out
    assert held_out is not None
    target = found.target
    inside = target.rms(found.solution.residuals)
    over: list[float] = []
    for number, column in enumerate(target.columns):
        floor = max(inside[number], column.noise)
        allowed = max(_HELD_OUT_FACTOR * floor, floor + _SLACK_SHARE * column.spread)
        over.append(held_out.rms[number] / max(allowed, 1e-12))
    place = int(np.argmax(over))
    column = target.columns[place]
    unit = "" if column.unit == "1" else f" {column.unit}"
    detail = (
        f"from {held_out.from_s:.2f} s on, {column.label} is {held_out.rms[place]:.3g}{unit} off, "
        f"{held_out.before[place]:.3g} before tuning (wanted: under "
        f"{held_out.rms[place] / max(over[place], 1e-12):.3g})"
    )
    return Check("predicts what it was not fitted to", over[place] < 1, detail, advice=_WRONG_MODEL)


def _range_check(found: SimulatorFit) -> Check:
    values = found.solution.values
    edged = [
        one.name
        for one, value in zip(_tuned(found), values, strict=False)
        if _is_at_an_end(one, float(value))
    ]
    detail = f"on the end: {listed(edged, _FEW)}" if edged else "no value lies on its range's end"
    advice = "widen the range with --tune, and check the model: something in it may be off"
    return Check("inside its range", not edged, detail, advice=advice)


def _is_at_an_end(parameter: Parameter, value: float) -> bool:
    """Return whether a value is on or beyond its range's end, physical bounds aside."""
    (low, high), (least, most) = parameter.training_range, parameter.bounds
    slack = _EDGE_SHARE * (high - low)
    is_low = value <= low + slack and low > least
    return is_low or (value >= high - slack and high <= most)


def _told_check(found: SimulatorFit) -> Check:
    unidentifiable = found.unidentifiable
    if not unidentifiable:
        return Check("every parameter is identifiable", True, "each within a quarter of its range")
    words: list[str] = []
    for parameter in unidentifiable:
        partners = _partners(found, parameter)
        along = f" (only together with {listed(partners, _FEW)})" if partners else ""
        words.append(f"{parameter.name}{along}")
    detail = f"not identifiable: {'; '.join(words)}"
    advice = excitation(unidentifiable[0].name, _partners(found, unidentifiable[0]))
    return Check(
        "every parameter is identifiable", False, detail, advice=advice, invalidates_interval=False
    )


def _partners(found: SimulatorFit, parameter: Parameter) -> list[str]:
    """List other unidentifiable parameters that are confounded with this one."""
    place = found.parameters.index(parameter)
    row = found.correlation[place]
    return [
        one.name
        for number, one in enumerate(_tuned(found))
        if number != place and abs(row[number]) > 0.9 and one in found.unidentifiable
    ]


def _step_check(found: SimulatorFit) -> Check:
    shift = found.step_shift
    assert shift is not None
    ratios = shift[: found.tuned] / np.maximum(found.half95[: found.tuned], 1e-300)
    place = int(np.argmax(ratios))
    name = found.parameters[place].name
    detail = (
        f"half the step moves {name} by {shift[place]:.2g}, {100 * ratios[place]:.0f} % of its "
        "interval's half (wanted: under 60 %)"
    )
    return Check(
        "the step is short enough",
        ratios[place] < 0.6,
        detail,
        advice="shorten the model's timestep",
        invalidates_interval=False,
    )


def _tuned(found: SimulatorFit) -> tuple[Parameter, ...]:
    return found.parameters[: found.tuned]
