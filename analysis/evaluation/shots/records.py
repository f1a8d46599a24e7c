"""Export the bounce shot's figures as JSON and CSV."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from analysis.evaluation.export import csv_text, json_text
from analysis.evaluation.shots.acceptance import JudgedDrop, acceptance_rows
from analysis.evaluation.shots.campaign import TrialResult
from analysis.evaluation.shots.tables import success_rates


def trial_records(results: Sequence[TrialResult]) -> list[dict[str, Any]]:
    """Return one flat record for each trial."""
    return [
        {
            "seed": one.trial.seed,
            "trial": one.trial.number + 1,
            "ball": one.trial.ball.name,
            "attempt": one.trial.attempt,
            "round": one.trial.ball.is_round,
            "restitution_3_m_s": one.trial.ball.restitution,
            "slope": one.trial.ball.slope,
            "first_drop": one.trial.mishap or "on the table",
            "drops": len(one.drops),
            "verdicts": " ".join(verdict for _, verdict in one.drops),
            "papers_restitution": one.papers.restitution,
            "papers_height_m": one.papers.height_m,
            "papers_success": one.papers.success,
            "truth_at_shot": one.truth,
            "restitution": None if one.ours is None else one.ours.restitution,
            "height_m": None if one.ours is None else one.ours.height_m,
            "success": one.success,
            "miss_m": None if one.ours is None else one.ours.miss_m,
            "exact_miss_m": None if one.ours is None else one.ours.exact_miss_m,
            "seconds": round(one.seconds, 2),
        }
        for one in results
    ]


def shot_json(
    results: Sequence[TrialResult], bad: Sequence[JudgedDrop], good: Sequence[JudgedDrop]
) -> str:
    """Serialise success rates (`shares`), `trials`, and the verdicts on `drops`."""
    content = {
        "shares": {
            name: {"count": one.count, "of": one.of}
            for name, one in (success_rates(results) if results else {}).items()
        },
        "trials": trial_records(results),
        "drops": [asdict(row) for row in acceptance_rows(bad, good)],
    }
    return json_text(content)


def shot_csv(results: Sequence[TrialResult]) -> str:
    """Format one row for each trial."""
    records = trial_records(results)
    return csv_text(list(records[0]) if records else ["trial"], records)
