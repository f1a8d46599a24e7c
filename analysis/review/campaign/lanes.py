"""The lanes of a campaign: what was dropped, tuned and shot at each attempt, and how it ended."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import rerun as rr
import rerun.blueprint as rrb

from analysis.review.campaign.times import ATTEMPT, FILM, Slot, wall_column
from analysis.review.drawing import FAILURE, MUTED, SUCCESS, Color, mixed
from tunenet_logs.terminal import one_line

_BALLS: tuple[Color, ...] = (
    (90, 130, 190),
    (190, 120, 90),
    (100, 170, 120),
    (170, 110, 170),
    (180, 165, 90),
    (90, 170, 175),
)
"""Of balls, in turn: muted, so that the lanes of states stand out."""

_AMBER: Color = (225, 165, 50)
_STATES: dict[str, Color] = {
    "drop": (66, 140, 220),
    "drop again": (120, 120, 220),
    "doubtful drop": _AMBER,
    "rejected drop": FAILURE,
    "no drop": MUTED,
    "tuned": (40, 165, 200),
    "not tuned": MUTED,
    "shot": (160, 120, 220),
    "given up": _AMBER,
    "not shot": MUTED,
    "success": SUCCESS,
    "failure": FAILURE,
    "not told": MUTED,
}
LANES = ("1_ball", "2_drop", "3_tuning", "4_shot", "5_outcome")
"""Their names are what is written over them."""


class _LaneChange(NamedTuple):
    """From when on a lane is in a state."""

    lane: str
    state: str
    attempt: int
    film_s: float
    wall_ns: int | None


def log_lanes(stream: rr.RecordingStream, slots: Sequence[Slot]) -> None:
    """Send the entities of `lane_view`."""
    changes = [change for slot in slots for change in _changes(slot)]
    for lane in LANES:
        own = [change for change in changes if change.lane == lane]
        colors = _ball_colors(own) if lane == LANES[0] else _STATES
        style = rr.StateConfiguration(
            values=list(colors), labels=list(colors), colors=list(colors.values())
        )
        stream.log(lane, style, static=True)
        # Of an attempt's several drops the last counts.
        last = {change.attempt: change.state for change in own}
        ends = {**last, slots[-1].attempt.number + 1: None}
        _send(stream, lane, rr.TimeColumn(ATTEMPT, sequence=list(ends)), list(ends.values()))
        played: dict[float, str | None] = {slot.start_s: None for slot in slots}  # not yet known
        played |= {change.film_s: change.state for change in own}
        played[slots[-1].end_s] = None
        _send(stream, lane, rr.TimeColumn(FILM, duration=list(played)), list(played.values()))
        clock: dict[int, str | None] = {
            slot.begin_ns: None for slot in slots if slot.begin_ns is not None
        }
        clock |= {change.wall_ns: change.state for change in own if change.wall_ns is not None}
        if clock:
            _send(stream, lane, wall_column(list(clock)), list(clock.values()))


def lane_view(name: str) -> rrb.View:
    """All lanes, over the whole of the active timeline."""
    return rrb.StateTimelineView(contents=[f"+ /{lane}" for lane in LANES], name=name)


def _ball_colors(changes: Sequence[_LaneChange]) -> dict[str, Color]:
    """One for each ball, none beside one like it."""
    balls = list(dict.fromkeys(change.state for change in changes))
    return {ball: mixed(_BALLS[index % len(_BALLS)], 0.75) for index, ball in enumerate(balls)}


def _changes(slot: Slot) -> Iterator[_LaneChange]:
    number, outcome = slot.attempt.number, slot.attempt.outcome
    begin_ns, end_ns = slot.begin_ns, slot.end_ns
    yield _LaneChange(LANES[0], one_line(slot.attempt.ball), number, slot.start_s, begin_ns)
    for index, shown in enumerate(slot.drops):
        state = shown.drop.state
        if index and state == "drop":
            state = "drop again"
        yield _LaneChange(LANES[1], state, number, shown.start_s, slot.drop_ns(shown))
    if not slot.drops:
        yield _LaneChange(LANES[1], "no drop", number, slot.start_s, begin_ns)
    tuned = "tuned" if slot.attempt.value is not None else "not tuned"
    yield _LaneChange(LANES[2], tuned, number, slot.tuned_s, slot.drop_ns(slot.used))
    shot = "not shot" if outcome is None else "shot" if slot.attempt.was_shot else "given up"
    yield _LaneChange(LANES[3], shot, number, slot.shot_s, end_ns)
    word = "not told" if outcome is None else outcome.word
    yield _LaneChange(LANES[4], word, number, slot.outcome_s, end_ns)


def _send(
    stream: rr.RecordingStream, entity: str, index: rr.TimeColumn, states: Sequence[str | None]
) -> None:
    """A state from each time on; None for none."""
    known = [state for state in states if state is not None]
    columns = rr.StateChange.columns(state=known).partition([state is not None for state in states])
    stream.send_columns(entity, indexes=[index], columns=columns)
