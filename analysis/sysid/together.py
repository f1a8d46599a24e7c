"""Several logs of one machine as one: parameters shared, each log with its own start.

The logs are laid one after the other on one axis of time, and each signal has its log's name before
its own; a fit to one log is then a fit to all. A column is weighed by what is left of it, so that a
log counts by what it tells.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from tunenet_logs.analysis.sysid.columns import Column, ComparedColumns
from tunenet_logs.analysis.sysid.fit import Begun, later_part
from tunenet_logs.analysis.sysid.horizons import Unseen
from tunenet_logs.analysis.sysid.source import Connected, Rollouts, seen_at, tuned_first
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.simulators.base import Parameter
from tunenet_logs.recorders.simulators.model.rollout import STOPPED
from tunenet_logs.terminal import short_name

_APART_S = 1.0  # between the end of a log and the start of the next


def names_of(logs: Sequence[Path]) -> tuple[str, ...]:
    """Name logs by their stems, and those of one stem by their number, too."""
    stems = [short_name(log.stem, 24).replace(".", "_") for log in logs]
    return tuple(
        stem if stems.count(stem) == 1 else f"{stem} ({number})"
        for number, stem in enumerate(stems, 1)
    )


@dataclass(frozen=True, eq=False)
class Together:
    """One simulator, driven as each of L logs was; see `Simulator`."""

    names: tuple[str, ...]  # of the logs, shape (L,)
    parts: tuple[Connected, ...]  # the simulator in each, shape (L,)

    @property
    def engine(self) -> str:
        """Engine with its version."""
        return self.parts[0].simulator.engine

    @property
    def step_hz(self) -> float:
        """Rate of simulation steps."""
        return self.parts[0].simulator.step_hz

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Tuned parameters, then the start of each log."""
        return self._parameters

    @cached_property
    def _parameters(self) -> tuple[Parameter, ...]:
        shared = [one for one in self.parts[0].simulator.parameters if one.prior_sd is None]
        starts = [
            replace(one, name=f"{name}: {one.name}")
            for name, part in zip(self.names, self.parts, strict=True)
            for one in part.simulator.parameters
            if one.prior_sd is not None
        ]
        return (*shared, *starts)

    @cached_property
    def offsets_ns(self) -> tuple[int, ...]:
        """What is added to the stamps of each log."""
        found, at_s = list[int](), 0.0
        for part in self.parts:
            found.append(self.start_ns + round(at_s * 1e9) - part.target.start_ns)
            at_s += part.target.end_s + _APART_S
        return tuple(found)

    @property
    def start_ns(self) -> int:
        """Stamp that the first log's seconds count from."""
        return self.parts[0].target.start_ns

    @property
    def target(self) -> ComparedColumns:
        """Columns of all logs."""
        # Whole nanoseconds, as a rollout's: a last sample that is an ulp beyond it would be lost.
        columns: list[Column] = []
        for name, part, offset_ns in zip(self.names, self.parts, self.offsets_ns, strict=True):
            late_ns = offset_ns + part.target.start_ns - self.start_ns
            columns += [
                replace(
                    one,
                    signal=f"{name}: {one.signal}",
                    seconds=1e-9 * (np.round(one.seconds * 1e9) + late_ns),
                )
                for one in part.target.columns
            ]
        return ComparedColumns(self.start_ns, tuple(columns))

    def rollout(self, values: Mapping[str, float]) -> Episode:
        """Roll out all logs once; see `Simulator`."""
        row = [one.checked(values.get(one.name, one.initial)) for one in self.parameters]
        return self.rolled([part.rollouts for part in self.parts], np.array([row]))[0]

    def rolled(self, rollouts: Sequence[Rollouts], values: Array) -> list[Episode]:
        """Roll out all logs at values of all parameters, shape (N, P); none twice alike."""
        names = [one.name for one in self.parameters]
        found: list[dict[str, Signal]] = [{} for _ in values]
        notes: list[dict[str, str]] = [{} for _ in values]
        for log, part, roll, offset_ns in zip(
            self.names, self.parts, rollouts, self.offsets_ns, strict=True
        ):
            places = [
                names.index(one.name if one.prior_sd is None else f"{log}: {one.name}")
                for one in tuned_first(part.simulator.parameters)
            ]
            rows, which = np.unique(values[:, places], axis=0, return_inverse=True)
            episodes = roll(rows)
            for number, place in enumerate(which.ravel().tolist()):
                episode = episodes[place]
                own_ns = part.target.start_ns - part.target.clock_of(episode)
                for name, one in episode.signals.items():
                    stamps_ns, shown = one.stamps_ns + own_ns + offset_ns, f"{log}: {name}"
                    found[number][shown] = replace(one, name=shown, stamps_ns=stamps_ns)
                why = episode.info.notes.get(STOPPED)
                if why is not None and not notes[number].get(STOPPED):
                    notes[number][STOPPED] = f"{log}: {why}" if why else ""
        truths = [dict(zip(names, map(float, row), strict=True)) for row in values]
        return [
            Episode(EpisodeInfo(source=self.engine, truth=truth, notes=said), signals)
            for truth, said, signals in zip(truths, notes, found, strict=True)
        ]


def together(names: tuple[str, ...], parts: Sequence[Connected]) -> Connected:
    """Connect one simulator with several logs, by their names."""
    both = Together(names, tuple(parts))
    finer = [part.finer for part in parts if part.finer is not None]

    def said(about: str) -> tuple[str, ...]:
        return tuple(
            f"{name}: {words}"
            for name, part in zip(names, parts, strict=True)
            for words in getattr(part, about)
        )

    counts = [len(part.target.values) for part in parts]
    places = [0, *np.cumsum(counts[:-1]).tolist()]
    unseen = [
        replace(one, name=name, place=place)
        for name, part, place in zip(names, parts, places, strict=True)
        for one in part.unseen
    ]
    return Connected(
        both,
        both.target,
        partial(both.rolled, [part.rollouts for part in parts]),
        partial(both.rolled, finer) if len(finer) == len(parts) else None,
        parts[0].unresolved,
        said("used"),
        said("unused"),
        said("doubts"),
        tuple(unseen) if len(unseen) == len(parts) else (),
        None,
        (names, np.repeat(np.arange(len(parts), dtype=np.intp), counts)),
        np.concatenate([later_part(part.target) for part in parts]),
        joints=parts[0].joints,
    )


def held_out_log(name: str, connected: Connected) -> Unseen:
    """Hold out a whole log, which begins where it does."""
    target = connected.target
    starts = tuple(one for one in connected.simulator.parameters if one.prior_sd is not None)
    whole = Begun(target, starts, lambda rows: seen_at(target, connected.rollouts(rows)))
    begin = connected.unseen[0].begin if connected.unseen else None
    return Unseen(target, begin, 0.0, name, None, whole)
