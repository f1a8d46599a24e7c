"""Checks of a tuned simulator: residuals, hold-out, identifiability, step size.

An unidentifiable parameter comes with advice on the motion that excites it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from tunenet_logs.analysis.checks import (
    Check,
    CheckSpec,
    Limit,
    at_least,
    at_most,
    log_checks,
    table,
)
from tunenet_logs.analysis.sysid.columns import ComparedColumns, noises_of
from tunenet_logs.analysis.sysid.fit import MISSED, Agreement, HeldOut, SimulatorFit
from tunenet_logs.analysis.sysid.least_squares import ranges_of
from tunenet_logs.analysis.sysid.source import SimulatorDetection
from tunenet_logs.episode import Array, Episode
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.recorders.simulators.model.rollout import STOPPED
from tunenet_logs.terminal import listed

# ---- Motions that excite a parameter that is unidentifiable from a log

_MAX_PARTNERS = 3  # that an advice names
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
    "spread": "turn it fast about several axes",
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
    "effort_gain": "move it with and without a load that is known",
    "effort_offset": "move it to both sides, with the commands recorded",
    "force_offset": "turn it about several axes",
    "torque_offset": "turn it about several axes",
}


def partners_of(found: SimulatorFit, parameter: Parameter) -> list[str]:
    """Return with which others alone the log tells an unidentifiable parameter."""
    row = found.correlation[found.parameters.index(parameter)]
    return [
        one.name
        for number, one in enumerate(found.parameters[: found.tuned])
        if one is not parameter and abs(row[number]) > 0.9 and one in found.unidentifiable
    ]


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

_WRONG_MODEL = (
    "check the model: masses, lengths, gravity, missing joints, and what --map takes for what"
)

SYSID = table(
    CheckSpec(
        "it moves",
        at_least(3, "times its noise", ".3g g", fatal=3),
        seen="{column} varies by {value} times its noise",
        measures="largest motion of a column, in times its noise",
        passes="{limit} or more",
        advice="record while it moves",
    ),
    CheckSpec(
        "simulation is whole",
        Limit("true", 1, fatal=1),
        measures="MuJoCo's own warnings of the tuned rollout (memory full, states beyond all "
        "bounds)",
        passes="none",
        if_not="r",
        advice="give the model a shorter timestep, more <size memory>, or other ranges with --tune",
    ),
    CheckSpec(
        "simulation matches",
        at_most(5, "% of its spread", ".3g", fatal=50),
        seen="{value} % of how much {column} varies is left, rms{where}",
        wanted="wanted: under {limit} %",
        measures="what is left of each column, as a share of how much it varies (rms); after a "
        "small error of the start has grown tenfold, it counts less the more that error has grown",
        passes="at most {limit} %, or 1.3 times the noise if more",
        advice=_WRONG_MODEL,
    ),
    CheckSpec(
        "predicts what it was not fitted to",
        at_most(2, "", ".3g"),
        seen="from {from_s:.2f} s on, {column} is {value}{space}{unit} off, {before:.3g} before "
        "tuning{begins}",
        wanted="wanted: under {limit}",
        measures="error of a fit to the first 60 % of the time on the rest, whose start is fitted; "
        "begun anew before a small error of its start has grown tenfold",
        passes="at most twice the noise, or 3 % of how much the column varies there; a straight "
        "line must miss something by twice that. Where the machine rests, or a log does not show "
        "every joint: twice what the whole fit leaves, or 2 % of how much a column varies beyond; "
        "and of the whole fit beside its noise at most 3 %",
        advice=_WRONG_MODEL,
    ),
    CheckSpec(
        "the logs agree",
        at_most(4, "standard deviations", ".1f"),
        seen="{name} is {alone:.3g} by {log} alone and {others:.3g} by {rest}, {value} standard "
        "deviations apart",
        measures="of several logs, how far a value by one alone is from that by all others",
        passes="at most {limit} standard deviations",
        advice="leave that log out, or find what was different: what it carried, how warm it was",
    ),
    CheckSpec(
        "inside its range",
        at_most(0),
        measures="values that lie beyond their range (`--tune`) with their whole interval",
        passes="none",
        advice="widen the range with --tune, and check the model: something in it may be off",
    ),
    CheckSpec(
        "every parameter is identifiable",
        at_most(0),
        measures="half the 95 % interval over the range (over the value where it is seen only with "
        "others)",
        passes="at most a quarter",
        advice="the motion that the check names, or measure it and leave it out",
        invalidates_interval=False,
    ),
    CheckSpec(
        "the step is short enough",
        at_most(2, "% of its range", ".2g"),
        seen="half the step moves {name} by {shift:.2g}, {value} % of its range",
        wanted="wanted: under {limit} %",
        measures="how far half the model's step moves each value",
        advice="shorten the model's timestep",
        invalidates_interval=False,
    ),
)

_FEW = 4  # names in a sentence


def recording_checks(target: ComparedColumns) -> tuple[Check, ...]:
    """Check that the log itself moves."""
    ratios = [column.spread / max(column.noise, 1e-12) for column in target.columns]
    best = int(np.argmax(ratios))
    return (SYSID["it moves"].measured(ratios[best], column=target.columns[best].label),)


def whole_check(rollout: Episode) -> Check | None:
    """Check that a model's rollout came to its end; None if the simulator does not report it."""
    stopped = rollout.info.notes.get(STOPPED)
    if stopped is None:
        return None
    detail = stopped or "MuJoCo warns of nothing"
    return SYSID["simulation is whole"].measured(not stopped, detail=detail)


def match_check(
    target: ComparedColumns, residuals: Array, found: SimulatorFit | None = None
) -> Check:
    """Check that each column's residual is its noise, or little of its motion."""
    counts = None if found is None else found.predictable
    spec, left = SYSID["simulation matches"], target.rms(residuals, counts)
    spreads, noises, good = [], noises_of(target, residuals), []
    for column in target.columns:
        most = max(one.spread for one in target.columns if one.unit == column.unit)
        # By the largest of its unit; axes of a turn by the turn, of which one may show little.
        turned = (
            one.spread
            for one in target.columns
            if one.signal == column.signal and " axis " in one.name and " axis " in column.name
        )
        spreads.append(max(column.spread, 1e-2 * most, 1e-12, *turned))
        # A jump met a little early or late leaves some.
        good.append(0.1 if column.is_jumpy else spec.limit.value / 100)
    limits = np.maximum(1.3 * noises / np.array(spreads), np.array(good))
    place = int(np.argmax(left / np.array(spreads) / limits))
    share = left[place] / spreads[place]
    where = "" if counts is None or np.all(counts > 0.5) else " (less counts where it is chaotic)"
    return spec.measured(
        100 * share,
        100 * limits[place],
        invalidates_interval=found is None or not found.is_tried,
        column=target.columns[place].label,
        where=where,
    )


def _held_out_check(found: SimulatorFit, held_out: HeldOut) -> Check:
    """Check that a fit predicts what it has not seen."""
    spec, columns = SYSID["predicts what it was not fitted to"], held_out.columns
    rms, from_s = held_out.rms, held_out.from_s
    if held_out.horizon_s is None:
        noise, spread = np.array([(one.noise, one.spread) for one in columns]).T
        left = found.target.rms(found.solution.residuals)
        floor = np.maximum(left, noise)
        # As close is good whatever the fit left.
        limits = np.maximum(spec.limit.value * floor, floor + 0.02 * spread)
        # As nothing was predicted, the fit itself must be as close. Noise is known by samples
        # alone: 995 of 1,000 columns leave less.
        counts = np.bincount(found.target.which, minlength=len(columns))
        own = np.hypot((1 + 3 / np.sqrt(counts)) * noise, MISSED * spread)
        jumps = np.array([one.is_jumpy for one in columns])
        is_whole = (left / np.maximum(own, 1e-12) > rms / np.maximum(limits, 1e-12)) & ~jumps
        rms, limits = np.where(is_whole, left, rms), np.where(is_whole, own, limits)
        limits, from_s = np.maximum(limits, 1e-12), np.where(is_whole, 0.0, from_s)
    else:
        limits = held_out.limits
    place = int(np.argmax(rms / limits))
    column = columns[place]
    begins = f", begun anew every {held_out.horizon_s:.2g} s" if held_out.count > 1 else ""
    if not held_out.is_told:
        begins += ", in which a straight line does as well"
    hidden = {one.name for one in found.unidentifiable}
    untold = [one for one in held_out.untold if one not in hidden]
    advice = None
    if untold:
        begins += f", by what comes before, which does not tell {listed(untold, _FEW)}"
        advice = "record twice as long, so that each part shows all of the motion"
    return spec.measured(
        rms[place],
        limits[place],
        passed=None if held_out.is_told else False,
        invalidates_interval=not found.is_tried,
        unit="" if column.unit == "1" else column.unit,
        space="" if column.unit == "1" else " ",
        from_s=from_s[place],
        column=column.label,
        before=held_out.before[place],
        begins=begins,
        advice=advice,
    )


def agreement_check(found: SimulatorFit, agreement: Agreement) -> Check:
    """Check that no log contradicts the others."""
    log, place = np.unravel_index(int(np.argmax(agreement.apart)), agreement.apart.shape)
    names = agreement.names
    return SYSID["the logs agree"].measured(
        agreement.apart[log, place],
        name=found.parameters[place].name,
        log=names[log],
        rest="the others" if len(names) > 2 else names[1 - log],
        alone=agreement.alone[log, place],
        others=agreement.others[log, place],
    )


def other_checks(detection: SimulatorDetection, found: SimulatorFit | None) -> tuple[Check, ...]:
    """Check the other logs: their files, that one held out moves, and whether one contradicts."""
    checks: list[Check] = []
    for name, log in detection.others.items():
        checks += [replace(one, name=f"{name}: {one.name}") for one in log_checks(log, ())[:1]]
    if (held_out := detection.connected.held_out) is not None:
        moves = recording_checks(held_out.target)
        checks += [replace(one, name=f"{held_out.name}: {one.name}") for one in moves]
    if found is not None and found.agreement is not None:
        checks.append(agreement_check(found, found.agreement))
    return tuple(checks)


def untold_check(count: int) -> Check:
    """Doubt so many values of a method that gives no intervals: far ones may match as well."""
    return SYSID["every parameter is identifiable"].measured(
        count,
        detail="the method gives no intervals, and other values may match as well",
        advice="take --method fit, which begins where it is told (--initial)",
    )


def fit_checks(found: SimulatorFit) -> tuple[Check, ...]:
    """Check an exact fit: hold-out, bounds, identifiability, step size."""
    checks: list[Check] = []
    if found.held_out is not None:
        checks.append(_held_out_check(found, found.held_out))
    # Values on the ends of their ranges.
    tuned = found.parameters[: found.tuned]
    edged: list[str] = []
    ends = zip(tuned, found.solution.values.tolist(), found.half95.tolist(), strict=False)
    for one, value, half in ends:
        (low, high), (least, most) = one.training_range, one.bounds
        slack = 0.002 * (high - low)
        # Physical bounds aside.
        is_low = value + half <= low + slack and low > least
        if is_low or (value - half >= high - slack and high <= most):
            edged.append(one.name)
    detail = f"beyond: {listed(edged, _FEW)}" if edged else "every value may lie in its range"
    inside = SYSID["inside its range"]
    checks.append(
        inside.measured(len(edged), detail=detail, invalidates_interval=not found.is_tried)
    )
    # Parameters that the motion does not tell, with those that each is confounded with.
    hidden, words, advice = found.unidentifiable, list[str](), ""
    for parameter in hidden:
        partners = partners_of(found, parameter)
        along = f" (only together with {listed(partners, _FEW)})" if partners else ""
        words.append(f"{parameter.name}{along}")
        advice = advice or excitation(parameter.name, partners)
    detail = (
        f"not identifiable: {'; '.join(words)}" if words else "each within a quarter of its range"
    )
    told = SYSID["every parameter is identifiable"]
    checks.append(told.measured(len(hidden), detail=detail, advice=advice))
    if found.step_shift is not None:
        ratios = found.step_shift[: found.tuned] / ranges_of(tuned)
        place = int(np.argmax(ratios))
        shift, name = found.step_shift[place], found.parameters[place].name
        step = SYSID["the step is short enough"]
        checks.append(step.measured(100 * ratios[place], name=name, shift=shift))
    return tuple(checks)
