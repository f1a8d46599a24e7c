"""Tabulate tunings of users' models for a terminal."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from analysis.evaluation.sysid.outcomes import FoundValue, SysidOutcome
from analysis.evaluation.sysid.run import SysidOrder
from analysis.evaluation.sysid.targets import MACHINES
from analysis.evaluation.text import seeds_in_words, table_line

_WIDTHS = (10, 7, 26, 6, 10, 9, 10, 9, 10, 0)

_HEADS = {
    "tuned": "Tuned by the default method: logs of machines that SciPy integrates.",
    "toolbox": "The same logs by mujoco.sysid, the state at the start tuned along.",
    "untold": "One more parameter is tuned, which such a log cannot tell.",
    "wrong": "Models of other machines: none should come out ok.",
    "network": "One step of a network trained on the spot, from 20 random starts a log.",
}


def sysid_table(section: str, outcomes: Sequence[SysidOutcome], order: SysidOrder) -> str:
    """Tabulate one section."""
    what = f"{seeds_in_words(order.seeds)}, {order.logs} logs a machine"
    head = f"{section}: {_HEADS[section]} {what}."
    makers = {"wrong": _wrong, "untold": _untold, "network": _network}
    return "\n".join([head, *makers.get(section, _errors)(outcomes)])


def groups(
    outcomes: Sequence[SysidOutcome],
) -> Iterable[tuple[str, float, str, list[SysidOutcome], list[FoundValue]]]:
    """Yield machine, noise, address, the logs, and each log's estimate of the parameter."""
    keys = dict.fromkeys(
        (one.trial.machine, one.trial.noise, found.address)
        for one in outcomes
        for found in one.found
    )
    for machine, noise, address in keys:
        logs = [one for one in outcomes if (one.trial.machine, one.trial.noise) == (machine, noise)]
        found = [each for one in logs for each in one.found if each.address == address]
        yield MACHINES[machine].name, noise, address, logs, found


def errors_of(found: Sequence[FoundValue]) -> np.ndarray:
    """Return absolute errors, shape (N,)."""
    return np.array([abs(one.value - one.truth) for one in found])


def _errors(outcomes: Sequence[SysidOutcome]) -> list[str]:
    names = ("machine", "noise", "parameter", "logs", "median", "of truth", "worst", "covered")
    lines = [table_line((*names, "rollouts", "s"), _WIDTHS)]
    for machine, noise, address, logs, found in groups(outcomes):
        errors = errors_of(found)
        shares = errors / np.abs([one.truth for one in found])
        covered = 100 * np.mean([one.is_covered for one in found])
        cells = [machine, f"{noise:g}", address, str(len(found)), f"{np.median(errors):.2g}"]
        cells += [f"{100 * np.median(shares):.2f} %", f"{errors.max():.2g}", f"{covered:.1f} %"]
        cells += [f"{np.median([one.rollouts for one in logs]):.0f}"]
        lines.append(
            table_line((*cells, f"{np.median([one.seconds for one in logs]):.1f}"), _WIDTHS)
        )
    return lines


def _untold(outcomes: Sequence[SysidOutcome]) -> list[str]:
    lines = [
        table_line(("machine", "", "parameter", "logs", "cannot be told", "", "said so"), _WIDTHS)
    ]
    for machine, _, address, _, found in groups(outcomes):
        said = 100 * np.mean([not one.is_told for one in found])
        cannot = "no" if found[0].can_be_told else "yes"
        cells = (machine, "", address, str(len(found)), cannot, "", f"{said:.1f} %")
        lines.append(table_line(cells, _WIDTHS))
    return lines


def _wrong(outcomes: Sequence[SysidOutcome]) -> list[str]:
    widths = (10, 34, 7, 5, 9, 0)
    lines = [table_line(("machine", "model", "tries", "ok", "suspect", "rejected"), widths)]
    for machine, what in dict.fromkeys((one.trial.machine, one.what) for one in outcomes):
        mine = [one for one in outcomes if (one.trial.machine, one.what) == (machine, what)]
        counts = [
            sum(one.verdict == name for one in mine) for name in ("ok", "suspect", "rejected")
        ]
        cells = (MACHINES[machine].name, what, str(len(mine)), *map(str, counts))
        lines.append(table_line(cells, widths))
    return lines


def _network(outcomes: Sequence[SysidOutcome]) -> list[str]:
    lines = [
        table_line(("machine", "", "parameter", "logs", "median", "", "of the range"), _WIDTHS)
    ]
    for machine, _, address, logs, found in groups(outcomes):
        errors = errors_of(found)
        share = 100 * np.median(errors) / found[0].range
        cells = (machine, "", address, str(len(logs)), f"{np.median(errors):.2g}", "")
        lines.append(table_line((*cells, f"{share:.2f} %"), _WIDTHS))
    return lines
