"""Tabulate answers to sounds for a terminal."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from typing import cast

import numpy as np

from analysis.evaluation.sound.alone import SNRS_DB, AloneOutcome, NegativeOutcome
from analysis.evaluation.sound.answers import SoundAnswer
from analysis.evaluation.sound.beside import BesideOutcome
from analysis.evaluation.sound.bound import MEAN_OF_SD
from analysis.evaluation.sound.run import GOOD_DB, SoundOrder, SoundOutcome
from analysis.evaluation.text import seeds_in_words, table_line

_VERDICTS = ("ok", "suspect", "rejected")


def sound_table(section: str, outcomes: Sequence[SoundOutcome], order: SoundOrder) -> str:
    """Tabulate one section, its head first."""
    makers: dict[str, Callable[[Sequence[SoundOutcome]], list[str]]] = {
        "alone": lambda found: _alone(cast("Sequence[AloneOutcome]", found)),
        "phyphox": lambda found: _phyphox(cast("Sequence[AloneOutcome]", found)),
        "negatives": lambda found: _negatives(cast("Sequence[NegativeOutcome]", found)),
        "uneven": lambda found: _alone(cast("Sequence[AloneOutcome]", found)),
        "uneven-films": lambda found: _films(cast("Sequence[BesideOutcome]", found)),
        "films": lambda found: _films(cast("Sequence[BesideOutcome]", found)),
        "unrelated": lambda found: _unrelated(cast("Sequence[BesideOutcome]", found)),
    }
    what = f"{seeds_in_words(order.seeds)}, {order.count} of each"
    return "\n".join([f"{section}: {_HEADS[section]} {what}.", *makers[section](outcomes)])


_HEADS = {
    "alone": "Bounces by their sound alone: restitution at the second impact. Answered: with an "
    "interval, or ok. Errors, coverage and width (median) are of those. Bound: mean error that "
    "onsets with this jitter allow.",
    "phyphox": "The same clips by phyphox's way, its threshold at its best for each. Hears 3, 5: a "
    "threshold hears the first 3, 5 impacts first. Errors where both answer, at the second impact.",
    "negatives": "Sounds that are no bounce of one ball: verdicts.",
    "films": "Films at 30 fps, sound at 20 dB: restitution at the first impact, without and with "
    "their sound.",
    "uneven": "Each impact returns .3 % more or less than the ball's law says (one standard "
    "deviation): the law's restitution at the second impact, by sound alone.",
    "uneven-films": "Films of such balls: the law's restitution at the first impact.",
    "unrelated": "Tracks at 30 Hz with a sound that is not theirs: how far the value moves, in "
    "widths of its interval. Alone: ok by that sound alone.",
}


def _levels(outcomes: Sequence[AloneOutcome]) -> list[tuple[str, list[AloneOutcome]]]:
    """Return the names of ratios, and the clips of each."""
    good = [one for one in outcomes if one.trial.snr_db >= GOOD_DB]
    each = [
        (f"{snr:g} dB", [one for one in outcomes if one.trial.snr_db == snr]) for snr in SNRS_DB
    ]
    levels = [(f"{GOOD_DB:g} dB or more", good), *each]
    return [(name, found) for name, found in levels if found]


def _alone(outcomes: Sequence[AloneOutcome]) -> list[str]:
    widths = (11, 15, 7, 10, 9, 9, 9, 8, 9, 9, 9, 0)
    head = ("ball", "ratio", "clips", "answered", "ok", "MAE", "median", "worst", "bound")
    lines = [table_line((*head, "jitter", "covered", "width"), widths)]
    for at, which in enumerate(("not named", "named")):
        for level, found in _levels(outcomes):
            answers = [(one, one.named if at else one.unnamed) for one in found]
            told = [(one, answer) for one, answer in answers if answer.is_answered]
            cells = [which, level, str(len(found)), _percent(len(told), len(found))]
            cells.append(_percent(sum(a.verdict == "ok" for _, a in answers), len(found)))
            if told:
                errors = np.array([abs(answer.value - one.truth) for one, answer in told])
                jitters = np.array([one.jitter_s for one, _ in told])
                bounds = np.mean([one.bounds[at] for one, _ in told]) * MEAN_OF_SD
                cells += [f"{v:.5f}" for v in (np.mean(errors), np.median(errors))]
                cells += [f"{np.max(errors):.3f}", f"{bounds:.5f}", _milliseconds(jitters)]
                cells += _covered([(answer, one.truth) for one, answer in told])
            lines.append(table_line(cells, widths))
    return lines


def _phyphox(outcomes: Sequence[AloneOutcome]) -> list[str]:
    widths = (15, 7, 9, 9, 11, 9, 6, 10, 11, 10, 12, 11, 0)
    head = ("ratio", "clips", "hears 3", "hears 5", "not named", "named", "both", "MAE phy.")
    more = ("not named", "named", "median p.", "not named", "named")
    lines = [table_line((*head, *more), widths)]
    for level, found in _levels(outcomes):
        count = len(found)
        both = [
            one
            for one in found
            if np.isfinite(one.phyphox) and one.named.is_answered and one.unnamed.is_answered
        ]
        cells = [level, str(count), _percent(sum(np.isfinite(one.phyphox) for one in found), count)]
        cells.append(_percent(sum(one.phyphox_hears for one in found), count))
        cells.append(_percent(sum(one.unnamed.is_answered for one in found), count))
        cells.append(_percent(sum(one.named.is_answered for one in found), count))
        cells.append(str(len(both)))
        if both:
            errors = np.array(
                [
                    [abs(v - one.truth) for v in (one.phyphox, one.unnamed.value, one.named.value)]
                    for one in both
                ]
            )
            cells += [f"{value:.5f}" for value in np.mean(errors, axis=0)]
            cells += [f"{value:.5f}" for value in np.median(errors, axis=0)]
        lines.append(table_line(cells, widths))
    return lines


def _negatives(outcomes: Sequence[NegativeOutcome]) -> list[str]:
    widths = (14, 7, 7, 9, 0)
    lines = [table_line(("what", "sounds", *_VERDICTS), widths)]
    kinds = dict.fromkeys(one.kind for one in outcomes)
    for kind in ("all", *kinds):
        verdicts = Counter(one.answer.verdict for one in outcomes if kind in ("all", one.kind))
        counts = [str(verdicts[name]) for name in _VERDICTS]
        lines.append(table_line((kind, str(verdicts.total()), *counts), widths))
    return lines


def _films(outcomes: Sequence[BesideOutcome]) -> list[str]:
    widths = (12, 7, 10, 9, 9, 9, 9, 9, 9, 0)
    head = ("sound", "films", "answered", "ok", "MAE", "median", "worst", "covered", "width")
    lines = [table_line((*head, "seconds"), widths)]
    both = [one for one in outcomes if _is_both(one)]
    for which, answers in (
        ("without", [(one.deaf, one) for one in outcomes]),
        ("with", [(one.heard, one) for one in outcomes]),
    ):
        told = [(answer, one.truth) for answer, one in answers if _is_both(one)]
        count = len(answers)
        cells = [which, str(count)]
        cells.append(_percent(sum(answer.is_answered for answer, _ in answers), count))
        cells.append(_percent(sum(answer.verdict == "ok" for answer, _ in answers), count))
        if told:
            errors = np.array([abs(answer.value - truth) for answer, truth in told])
            cells += [f"{v:.5f}" for v in (np.mean(errors), np.median(errors), np.max(errors))]
            cells += _covered(told)
        cells.append(f"{np.median([answer.seconds for answer, _ in answers]):.2f}")
        lines.append(table_line(cells, widths))
    if both:
        lines.append(_ratios(both))
    if any(one.trial.unrelated for one in outcomes):
        lines += _unrelated(outcomes)
    return lines


def _is_both(one: BesideOutcome) -> bool:
    return one.deaf.is_answered and one.heard.is_answered


def _ratios(both: Sequence[BesideOutcome]) -> str:
    errors = np.array([[abs(a.value - one.truth) for a in (one.deaf, one.heard)] for one in both])
    widths = np.array([[one.deaf.width, one.heard.width] for one in both])
    sure = np.isfinite(widths).all(axis=1)
    narrower = np.median(widths[sure, 1] / widths[sure, 0]) if sure.any() else np.nan
    longer = np.median([one.heard.seconds / one.deaf.seconds for one in both])
    ratio = np.mean(errors[:, 1]) / np.mean(errors[:, 0])
    return (
        f"with over without, {len(both)} answered both ways: width (median) {narrower:.2f}, "
        f"MAE {ratio:.2f}, time (median) {longer:.2f}"
    )


def _unrelated(outcomes: Sequence[BesideOutcome]) -> list[str]:
    widths = (17, 7, 9, 9, 11, 15, 0)
    head = ("unrelated sound", "logs", "median", "worst", "within .1", "verdict moved", "alone ok")
    lines = [table_line(head, widths)]
    rows = [
        (what, one.deaf, answer, alone)
        for one in outcomes
        for what, answer, alone in zip(one.trial.unrelated, one.unrelated, one.alone, strict=True)
    ]
    for kind in ("all", *dict.fromkeys(what for what, *_ in rows)):
        mine = [row for row in rows if kind in ("all", row[0])]
        moved = [_moved(deaf, answer) for _, deaf, answer, _ in mine]
        far = np.array([value for value in moved if np.isfinite(value)])
        cells = [kind, str(len(mine))]
        cells += [f"{np.median(far):.3f}", f"{np.max(far):.3f}"] if len(far) else ["", ""]
        cells.append(_percent(int(np.sum(far <= 0.1)), len(far)))
        cells.append(str(sum(deaf.verdict != answer.verdict for _, deaf, answer, _ in mine)))
        cells.append(_percent(sum(alone == "ok" for *_, alone in mine), len(mine)))
        lines.append(table_line(cells, widths))
    return lines


def _moved(deaf: SoundAnswer, heard: SoundAnswer) -> float:
    """Return how far a value moves, in widths of the interval without sound; NaN without one."""
    if not np.isfinite(deaf.width):
        return np.nan
    return abs(heard.value - deaf.value) / deaf.width if np.isfinite(heard.value) else np.inf


def _covered(told: Sequence[tuple[SoundAnswer, float]]) -> list[str]:
    """Return coverage and median width of those that have an interval."""
    sure = [(answer, truth) for answer, truth in told if np.isfinite(answer.width)]
    covered = sum(answer.covers(truth) for answer, truth in sure)
    widths = [answer.width for answer, _ in sure]
    return [_percent(covered, len(sure)), f"{np.median(widths):.4f}" if widths else ""]


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else ""


def _milliseconds(values_s: np.ndarray) -> str:
    known = values_s[np.isfinite(values_s)]
    return f"{1000 * np.median(known):.2f} ms" if len(known) else ""
