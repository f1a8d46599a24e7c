"""Choose which terms of its servos a log tells: forward selection by evidence and by hold-out.

Every servo has a gain, damping, armature and dry friction. Another term (see
`recorders.simulators.model.servo`) is added where a fit gains more than the Bayesian information
criterion asks for it (Schwarz 1978), which counts samples that hang together once, and a fit to
what is not held out predicts the rest better too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.sysid.fit import TOLD, later_part
from tunenet_logs.analysis.sysid.least_squares import (
    RolloutLeastSquares,
    Run,
    Solution,
    correlation_length,
    covariance,
    reach_of,
)
from tunenet_logs.analysis.sysid.source import Connected, ModelSource, seen_at, tuned_first
from tunenet_logs.episode import Array, Episode
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.recorders.simulators.model.servo import ServoTerm, all_terms, neutral
from tunenet_logs.terminal import listed

# Fields that are added together: one tells nothing without the other.
_GROUPS: tuple[tuple[str, ...], ...] = (
    ("forcerange",),
    ("load_friction",),
    ("stribeck_load", "stribeck_speed"),
    ("stribeck", "stribeck_speed"),
    ("dead_band",),
    ("zero",),
    ("commands",),  # the delay
)
_NEEDS = {"stribeck_load": "load_friction"}  # what has to be there before
_BRAKE = ("back_emf",)
_TRIED = 3  # groups that are fitted in a round at most, the most promising first
_SMALL_START = 0.3  # sd of what is usual, from which a term begins that is 0 as a rule
_SURE = 2.0  # standard deviations from where it is not there, beyond which a term stays


@dataclass(frozen=True, eq=False)
class Choice:
    """Which terms of its servos a log tells."""

    selection: _Selection  # with the fits that it compares
    values: Mapping[str, float]  # where to begin, by the addresses to tune, no servo's too
    words: tuple[str, ...]  # what was added or left out, and why
    rollouts: int  # that it took

    def omitted(self, parameters: Sequence[Parameter]) -> tuple[Run, ...]:
        """Return what rolls out with each term that is left out, of the size that is usual.

        At values of these parameters. A log that cannot tell a term may have it: what it would do
        to the others widens their intervals.
        """
        selection = self.selection
        names = [one.name for one in selection.parameters]
        places = [names.index(one.name) for one in parameters]
        groups: dict[tuple[int, tuple[str, ...]], list[int]] = {}
        for group in _GROUPS:
            for place in selection.places(group):
                name = names[place]
                if name not in self.values:
                    key = selection.terms[name][1], group
                    groups.setdefault(key, []).append(place)

        def run(group: list[int], values: Array) -> Array:
            rows = np.repeat(selection.base[None], len(values), axis=0)
            rows[:, places] = values
            rows[:, group] = [selection.size(place) for place in group]
            return selection.seen(rows)

        return tuple(partial(run, group) for group in groups.values())


@dataclass(frozen=True, eq=False)
class _Fit:
    """Fit of some parameters to all, and how it misses what another did not see."""

    free: tuple[int, ...]  # places of its parameters among all
    solution: Solution
    values: Array  # of all parameters, shape (P,)
    missed: Array  # RMS of each column where it is held out, of a fit to the rest, shape (C,)


@dataclass(frozen=True, eq=False)
class _Selection:
    """Forward selection on one connected log, or several."""

    connected: Connected
    terms: Mapping[str, tuple[ServoTerm, int]]  # by address, with the actuator
    base: Array  # values of all parameters at which no term is there, shape (P,)
    parameters: tuple[Parameter, ...]

    @cached_property
    def later(self) -> NDArray[np.bool_]:
        """What is held out, shape (M,)."""
        target, later = self.connected.target, self.connected.later
        return later_part(target) if later is None or not later.any() else later

    def places(self, fields: Sequence[str]) -> tuple[int, ...]:
        """Return the places of these fields' parameters."""
        return tuple(
            place
            for place, one in enumerate(self.parameters)
            if one.name in self.terms and _field(one.name) in fields
        )

    def start(self, place: int) -> float:
        """Return where a term begins that is added."""
        one = self.parameters[place]
        assert one.usual is not None
        mean, sd = one.usual
        start = mean if mean > 0 else _SMALL_START * sd
        return start if abs(start - self.base[place]) > 0.1 * sd else start - 0.5 * sd

    def size(self, place: int) -> float:
        """Return a term's value where it is there, as large as others' are."""
        one = self.parameters[place]
        assert one.usual is not None
        mean, sd = one.usual
        if abs(mean - self.base[place]) < 0.1 * sd:  # the model has it: another as far off as usual
            return mean - sd if mean > sd else mean + sd
        return float(np.hypot(mean, sd))

    def seen(self, rows: Array) -> Array:
        """Roll out rows of all parameters, shape (N, P) -> (N, M)."""
        return seen_at(self.connected.target, self.connected.rollouts(rows))

    def fit(self, free: tuple[int, ...], values: Array) -> _Fit:
        """Fit these parameters, the others as in `values`, shape (P,)."""
        own = list(free)

        def run(rows: Array) -> Array:
            whole = np.repeat(values[None], len(rows), axis=0)
            whole[:, own] = rows
            return self.seen(whole)

        parameters = tuple(self.parameters[place] for place in own)
        connected = self.connected
        reach = reach_of(parameters, connected.target, connected.logs, connected.joints)
        steps = RolloutLeastSquares(
            run, connected.target, parameters, reach=reach, is_approximate=True
        )
        solution = steps.solve(values[own])
        found = values.copy()
        found[own] = solution.values
        _, unseen = replace(steps, fitted=~self.later).one_step(solution)
        return _Fit(free, solution, found, self.connected.target.rms(unseen, self.later))

    def gain(self, before: _Fit, after: _Fit) -> float:
        """Return what the criterion gains, above 0 where the added parameters are worth it."""
        target = self.connected.target
        floor = np.array([max(one.noise, 1e-3 * one.spread, 1e-12) for one in target.columns])
        total, least = 0.0, np.inf
        for column in range(len(target.columns)):
            mine = target.which == column
            first, second = before.solution.residuals[mine], after.solution.residuals[mine]
            # By what is left with the terms: an offset's lack hangs together all along.
            count = max(len(second) / correlation_length(second), 3.0)
            left = [np.hypot(np.sqrt(np.mean(one**2)), floor[column]) for one in (first, second)]
            total += 2 * count * float(np.log(left[0] / left[1]))
            least = min(least, count)
        return total - (len(after.free) - len(before.free)) * float(np.log(max(least, 3.0)))

    def promised(self, now: _Fit, groups: Sequence[tuple[int, ...]]) -> list[float]:
        """Return by how much each group may lower the cost, by a rollout with each (a score test).

        Alone, or beside all others, of which the lack of one may hide another. Samples that hang
        together after it count once.
        """
        from scipy.optimize import lsq_linear

        rows = np.repeat(now.values[None], len(groups), axis=0)
        for row, group in zip(rows, groups, strict=True):
            row[list(group)] = [self.start(place) for place in group]
        target, solution = self.connected.target, now.solution
        weights = solution.chosen / target.per_value(solution.noise)
        changes = self.seen(rows) - (target.values + solution.residuals)
        changes = (np.where(np.isfinite(changes), changes, 0.0) * weights).T
        slopes = solution.slopes * weights[:, None]
        changes -= slopes @ np.linalg.lstsq(slopes, changes, rcond=1e-8)[0]
        before = solution.residuals * weights
        low = np.zeros(len(groups))  # of each size; a term that may be negative is either
        for number, group in enumerate(groups):
            if any(self.parameters[place].bounds[0] < self.base[place] for place in group):
                low[number] = -np.inf

        def left(which: list[int]) -> Array:
            if not which:
                return before
            ends = low[which], np.inf
            sizes = lsq_linear(changes[:, which], -before, ends, method="bvls").x
            return before + changes[:, which] @ sizes

        def gained(without: list[int], added: list[int]) -> float:
            after = left(added)
            mine = (after[target.which == column] for column in range(len(target.columns)))
            together = max(correlation_length(one) for one in mine)
            return float(np.sum(left(without) ** 2) - np.sum(after**2)) / together

        every = list(range(len(groups)))
        return [
            max(gained([], [one]), gained(every[:one] + every[one + 1 :], every)) for one in every
        ]


def _field(address: str) -> str:
    return "commands" if address.startswith("delay/") else address.rpartition(".")[2]


def choose(connected: Connected, source: ModelSource) -> Choice:
    """Choose the terms of a source's servos that a connected log tells."""
    terms, model = all_terms(source.model), source.model
    given = {one.parameter.name: one for one in source.tuned}
    parameters = tuned_first(connected.simulator.parameters)
    base = np.array([one.initial for one in parameters])
    for place, one in enumerate(parameters):
        if one.name in terms and not terms[one.name][0].is_base:
            term, actuator = terms[one.name]
            base[place] = neutral(model, term, actuator, given[one.name].given)
    spent = list[int]()

    def counted(rows: Array) -> list[Episode]:
        spent.append(len(rows))
        return connected.rollouts(rows)

    selection = _Selection(replace(connected, rollouts=counted), terms, base, parameters)
    free = tuple(
        place
        for place, one in enumerate(parameters)
        if one.name not in terms or terms[one.name][0].is_base
    )
    groups = list(_GROUPS)
    start = base.copy()
    if _is_switched(connected):  # a motor without power does not brake
        brakes = selection.places(_BRAKE)
        start[list(brakes)] = [selection.start(place) for place in brakes]
        free = tuple(sorted((*free, *brakes)))
    now = selection.fit(free, start)
    words, rest = list[str](), list(groups)
    while rest:
        new = {group: _new(selection, now, group) for group in rest}
        promised = dict(zip(rest, selection.promised(now, list(new.values())), strict=True))
        best: tuple[float, tuple[str, ...], _Fit] | None = None
        ready = [
            one
            for one in rest
            if promised[one] > len(one) and (_NEEDS.get(one[0], ""),) not in rest
        ]
        for group in sorted(ready, key=lambda one: -promised[one])[:_TRIED]:
            if best is not None and best[0] > promised[group]:
                break
            start = now.values.copy()
            start[list(new[group])] = [selection.start(place) for place in new[group]]
            tried = selection.fit(tuple(sorted((*now.free, *new[group]))), start)
            gain = selection.gain(now, tried)
            is_better = float(np.sum(np.log(tried.missed / np.maximum(now.missed, 1e-12)))) < 0
            if gain > 0 and is_better and (best is None or gain > best[0]):
                best = gain, group, tried
        if best is None:
            break
        gain, group, now = best
        rest.remove(group)
        what = " and ".join(group).replace("commands", "delay")
        words.append(f"{what}: added, {gain:.{int(gain < 10)}f} over what evidence asks for")
    kept, dropped = _told(selection, now, terms)
    found = {one.name: float(now.values[place]) for place, one in enumerate(parameters)}
    names = {one.name for place, one in enumerate(parameters) if place in kept}
    tuned = {name: found[name] for name in given if name in names}
    added = {_field(name) for name in tuned}
    left = [parameters[place].name for place in dropped]
    left += [one for group in rest for one in group if one not in added]
    if left:
        what = listed(dict.fromkeys(left), 12).replace("commands", "delay")
        words.append(f"cannot be told by this log, and left out: {what}")
    return Choice(selection, tuned, tuple(words), sum(spent))


def _is_switched(connected: Connected) -> bool:
    return any("power of actuators" in one for one in connected.used)


def _new(selection: _Selection, now: _Fit, group: tuple[str, ...]) -> tuple[int, ...]:
    return tuple(place for place in selection.places(group) if place not in now.free)


def _told(
    selection: _Selection, fit: _Fit, terms: Mapping[str, tuple[ServoTerm, int]]
) -> tuple[set[int], list[int]]:
    """Return the places of what stays, and of added terms that some of several servos lack."""
    own = tuple(selection.parameters[place] for place in fit.free)
    cov, _ = covariance(fit.solution, selection.connected.target, own)
    kept, dropped = set(fit.free), list[int]()
    if len({actuator for _, actuator in terms.values()}) == 1:
        return kept, dropped
    for place, one, sd in zip(fit.free, own, np.sqrt(np.diag(cov)), strict=True):
        is_added = one.name in terms and not terms[one.name][0].is_base
        is_small = abs(fit.values[place] - selection.base[place]) < _SURE * sd
        if is_added and one.usual is not None and is_small and sd > TOLD * one.usual[1]:
            kept.remove(place)
            dropped.append(place)
    return kept, dropped
