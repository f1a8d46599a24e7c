"""Export answers to sounds as JSON and CSV."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from analysis.evaluation.export import csv_text, json_text
from analysis.evaluation.sound.alone import AloneOutcome, NegativeOutcome
from analysis.evaluation.sound.answers import SoundAnswer
from analysis.evaluation.sound.beside import BesideOutcome
from analysis.evaluation.sound.run import SoundOrder, SoundOutcome

# Of the CSV: one row for each answer.
COLUMNS = (
    *("section", "seed", "number", "what", "background", "snr_db", "with", "truth"),
    *("verdict", "value", "low", "high", "slope", "seconds", "jitter_s", "bound", "reason"),
)

Found = Sequence[tuple[str, SoundOutcome]]  # outcomes with the names of their sections


def sound_json(found: Found, order: SoundOrder) -> str:
    """Serialise every answer."""
    head = {"experiment": "sound", "seeds": list(order.seeds), "count": order.count}
    return json_text({**head, "rows": list(_rows(found))})


def sound_csv(found: Found) -> str:
    """Format every answer as a table."""
    return csv_text(COLUMNS, [_flat(row) for row in _rows(found)])


def _flat(row: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in row.items() if name in COLUMNS}


def _rows(found: Found) -> Iterator[dict[str, Any]]:
    for section, one in found:
        if isinstance(one, AloneOutcome):
            yield from _alone(section, one)
        elif isinstance(one, NegativeOutcome):
            head = {"section": section, "seed": one.seed, "number": one.number, "what": one.kind}
            yield {**head, "with": "sound alone", **_answer(one.answer)}
        else:
            yield from _beside(section, one)


def _alone(section: str, one: AloneOutcome) -> Iterator[dict[str, Any]]:
    head = {
        "section": section,
        "seed": one.trial.seed,
        "number": one.trial.number,
        "what": f"{one.ball} on {one.table}",
        "background": one.background,
        "snr_db": one.trial.snr_db,
        "truth": one.truth,
        "impacts": one.impacts,
        "jitter_s": _finite(one.jitter_s),
    }
    for which, answer, bound in zip(
        ("ball not named", "ball named"), (one.unnamed, one.named), one.bounds, strict=True
    ):
        yield {**head, "with": which, "bound": _finite(bound), **_answer(answer)}
    yield {
        **head,
        "with": "phyphox",
        "value": _finite(one.phyphox),
        "hears_five": one.phyphox_hears,
    }


def _beside(section: str, one: BesideOutcome) -> Iterator[dict[str, Any]]:
    head = {
        "section": section,
        "seed": one.trial.seed,
        "number": one.trial.number,
        "what": one.trial.kind,
        "background": one.background,
        "truth": one.truth,
    }
    yield {**head, "with": "no sound", **_answer(one.deaf)}
    yield {**head, "with": "its sound", **_answer(one.heard)}
    for what, answer, alone in zip(one.trial.unrelated, one.unrelated, one.alone, strict=True):
        yield {**head, "with": what, **_answer(answer)}
        yield {**head, "what": "sound alone", "with": what, "truth": None, "verdict": alone}


def _answer(answer: SoundAnswer) -> dict[str, Any]:
    return {
        "verdict": answer.verdict,
        "reason": answer.reason,
        "value": _finite(answer.value),
        "low": _finite(answer.low),
        "high": _finite(answer.high),
        "slope": _finite(answer.slope),
        "seconds": round(answer.seconds, 3),
        "rebounds": [list(one) for one in answer.rebounds],
    }


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
