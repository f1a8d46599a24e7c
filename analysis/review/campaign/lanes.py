"""Lanes of a campaign: drop, tuning and outcome of each attempt as state timelines."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import rerun as rr
import rerun.blueprint as rrb

from analysis.review.campaign.times import ATTEMPT, FILM, Slot, wall_column
from analysis.review.drawing import FAILURE, MUTED, SUCCESS, Color, mixed
from tunenet_logs.terminal import one_line

# Of balls, in turn: muted, so that the lanes of states stand out.
_BALLS: tuple[Color, ...] = (
    (90, 130, 190),
    (190, 120, 90),
    (100, 170, 120),
    (170, 110, 170),
    (180, 165, 90),
    (90, 170, 175),
)

_AMBER: Color = (225, 165, 50)
_STATES: dict[str, Color] = {
    "drop": (66, 140, 220),
    "doubtful drop": _AMBER,
    "rejected drop": FAILURE,
    "no drop": MUTED,
    "tuned": (40, 165, 200),
    "not tuned": MUTED,
    "shot": (160, 120, 220),
    "given up": _AMBER,
    "success": SUCCESS,
    "failure": FAILURE,
    "not told": MUTED,
}
# What Rerun writes over them, after a slash; it sorts them by the alphabet.
BALL, DROP, RESTITUTION, SHOT = LANES = ("ball", "drop", "restitution", "shot")

# Of its colour that a state has in every second attempt: so that neighbours are told apart.
_SHADE = 0.78


class _LaneChange(NamedTuple):
    """Change of a lane's state.

    Attributes:
        lane: Its name.
        state: In words, as drawn.
        kind: Key of its colour.
        attempt: Its number.
        film_s: Where it begins on `FILM`.
        wall_ns: Where it begins on `WALL`; None if unknown.
    """

    lane: str
    state: str
    kind: str
    attempt: int
    film_s: float
    wall_ns: int | None

    @property
    def value(self) -> str:
        """Label that is unique in each attempt: Rerun merges equal neighbours."""
        return f"attempt {self.attempt}: {self.state}"


def log_lanes(stream: rr.RecordingStream, slots: Sequence[Slot]) -> None:
    """Log the entities of `lane_view`."""
    changes = [change for slot in slots for change in _changes(slot)]
    for lane in LANES:
        own = [change for change in changes if change.lane == lane]
        _send_style(stream, lane, own)
        # Of several changes in an attempt the last counts.
        last = {change.attempt: change.value for change in own}
        ends = {**last, slots[-1].attempt.number + 1: None}
        _send(stream, lane, rr.TimeColumn(ATTEMPT, sequence=list(ends)), list(ends.values()))
        played: dict[float, str | None] = {slot.start_s: None for slot in slots}  # not yet known
        played |= {change.film_s: change.value for change in own}
        played[slots[-1].end_s] = None
        _send(stream, lane, rr.TimeColumn(FILM, duration=list(played)), list(played.values()))
        clock: dict[int, str | None] = {
            slot.begin_ns: None for slot in slots if slot.begin_ns is not None
        }
        clock |= {change.wall_ns: change.value for change in own if change.wall_ns is not None}
        if clock:
            _send(stream, lane, wall_column(list(clock)), list(clock.values()))


def _send_style(stream: rr.RecordingStream, lane: str, changes: Sequence[_LaneChange]) -> None:
    colors = _ball_colors(changes) if lane == BALL else _STATES
    known = {change.value: change for change in changes}
    style = rr.StateConfiguration(
        values=list(known),
        labels=[change.state for change in known.values()],
        colors=[
            mixed(colors[change.kind], 1.0 if change.attempt % 2 else _SHADE)
            for change in known.values()
        ],
    )
    stream.log(lane, style, static=True)


def lane_view(name: str) -> rrb.View:
    """Return the view of all lanes, over the whole active timeline."""
    return rrb.StateTimelineView(contents=[f"+ /{lane}" for lane in LANES], name=name)


def _ball_colors(changes: Sequence[_LaneChange]) -> dict[str, Color]:
    """Assign a colour to each ball, unlike its neighbours'."""
    balls = list(dict.fromkeys(change.kind for change in changes))
    return {ball: mixed(_BALLS[index % len(_BALLS)], 0.75) for index, ball in enumerate(balls)}


def _changes(slot: Slot) -> Iterator[_LaneChange]:
    attempt, outcome = slot.attempt, slot.attempt.outcome
    number, begin_ns, end_ns = attempt.number, slot.begin_ns, slot.end_ns
    ball = one_line(attempt.ball)
    yield _LaneChange(BALL, f"{ball}, {attempt.of_ball}", ball, number, slot.start_s, begin_ns)
    for index, shown in enumerate(slot.drops):
        kind = shown.drop.state
        state = f"{kind} again" if index else kind
        yield _LaneChange(DROP, state, kind, number, shown.start_s, slot.drop_ns(shown))
    if not slot.drops:
        yield _LaneChange(DROP, "no drop", "no drop", number, slot.start_s, begin_ns)
    kind = "tuned" if attempt.value is not None else "not tuned"
    value = kind if attempt.value is None else f"{attempt.value:.3f}"
    yield _LaneChange(RESTITUTION, value, kind, number, slot.tuned_s, slot.drop_ns(slot.used))
    if attempt.was_shot:
        yield _LaneChange(SHOT, "shot", "shot", number, slot.shot_s, None)
    word = "not told" if outcome is None else outcome.word if attempt.was_shot else "given up"
    yield _LaneChange(SHOT, word, word, number, slot.outcome_s, end_ns)


def _send(
    stream: rr.RecordingStream, entity: str, index: rr.TimeColumn, states: Sequence[str | None]
) -> None:
    """Send the state from each time on; None for none."""
    known = [state for state in states if state is not None]
    columns = rr.StateChange.columns(state=known).partition([state is not None for state in states])
    stream.send_columns(entity, indexes=[index], columns=columns)
