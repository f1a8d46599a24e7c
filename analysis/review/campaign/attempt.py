"""The attempt under the cursor: its drop's curves, its images, and facts."""

from __future__ import annotations

from collections.abc import Sequence

import rerun as rr
import rerun.blueprint as rrb

from analysis.campaign.attempts import Attempt
from analysis.campaign.tuned_drop import TunedDrop
from analysis.record import Estimate
from analysis.review.campaign.film import log_films
from analysis.review.campaign.overlay import log_overlays
from analysis.review.campaign.times import Slot, beginnings
from tunenet_logs.terminal import one_line


def log_attempts(stream: rr.RecordingStream, slots: Sequence[Slot]) -> None:
    """Log the entities of `overlay_view`, `film_view` and `attempt_view`."""
    log_overlays(stream, slots)
    log_films(stream, slots)
    style = rr.TextDocument.from_fields(media_type="text/markdown")
    stream.log("attempt", style, static=True)
    for _, index, begun in beginnings(slots):
        words = [attempt_words(slot.attempt) for slot, _ in begun]
        stream.send_columns("attempt", indexes=[index], columns=rr.TextDocument.columns(text=words))


def attempt_view() -> rrb.View:
    """Return the view of the attempt's facts."""
    return rrb.TextDocumentView(origin="/attempt", name="the attempt")


def attempt_words(attempt: Attempt) -> str:
    """Describe an attempt in Markdown."""
    outcome, used = attempt.outcome, attempt.used
    end = "no outcome recorded" if outcome is None else outcome.word
    if outcome is not None and not attempt.was_shot:
        end += ", given up without a shot"
    lines = [
        f"# {attempt.number}: {one_line(attempt.ball)}, attempt {attempt.of_ball}",
        f"**{end}**",
    ]
    if outcome is not None:
        lines.append(_shot_words(attempt))
    if attempt.value is not None:
        ends = attempt.interval95
        sure = f" (95 %: {ends[0]:.4f} to {ends[1]:.4f})" if ends is not None else ""
        lines.append(f"restitution **{attempt.value:.4f}**{sure}")
        lines += [_other_words(known) for known in (used.others if used is not None else ())]
    lines += [_drop_words(drop) for drop in attempt.drops]
    if used is not None and used.tuning is not None:
        review = used.tuning.with_suffix(".rrd")
        lines += [f"review of the drop: `rerun {one_line(review.name)}`"] if review.exists() else []
    return "\n\n".join(line for line in lines if line)


def _other_words(known: Estimate) -> str:
    """Format another quantity that was tuned with the restitution."""
    assert isinstance(known.value, float)
    unit = "" if known.unit == "1" else f" {one_line(known.unit)}"
    words = f"{one_line(known.name).replace('_', ' ')} {known.value:.3f}{unit}"
    if known.interval95 is None:
        return words
    low, high = known.interval95
    return f"{words} (95 %: {low:.3f} to {high:.3f})"


def _shot_words(attempt: Attempt) -> str:
    outcome = attempt.outcome
    assert outcome is not None
    facts: list[str] = []
    if outcome.shot_height_m is not None:
        facts.append(f"shot from {outcome.shot_height_m:.3f} m")
    if outcome.miss_m is not None:
        side = "short of" if outcome.miss_m < 0 else "beyond"
        facts.append(f"came down {1000 * abs(outcome.miss_m):.0f} mm from the centre, {side} it")
    facts += [one_line(text) for text in (outcome.reason, outcome.note) if text]
    return "; ".join(facts)


def _drop_words(drop: TunedDrop) -> str:
    reason = f": {one_line(drop.reason)}" if drop.reason else ""
    return f"- {drop.state} {one_line(drop.name)}{reason}"
