"""Sound of a drop over the log's time: its envelope, and its onsets, marked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from analysis.listening.onsets import onsets
from analysis.review.drawing import MUTED, OBSERVED, Color, send_scalars, ticked
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.sound import Sound

_ENVELOPE: Color = (120, 170, 255)

_RATE_HZ = 250.0  # points of an envelope in a second: a knock and its echo are apart
_MAX = 30_000  # points of an envelope: two minutes of sound at that rate
# Below the loudest sample: what is softer is drawn there, so that the axis has its ticks.
_DEEP_DB = 45.0

_LOUD_S = 0.01  # after a knock's onset, in which its mark's level is looked for
_AROUND_S = 0.5  # of sound before and after what is shown: the background that its knocks rise from
_NEAR_S = 0.002  # an onset so near to an impact that was heard is that impact


@dataclass(frozen=True)
class Marks:
    """Marked moments of a sound.

    Attributes:
        entity: last part of their paths.
        name: in words.
        color: of them.
        seconds: on the log's clock, shape (N,).
        size: of a mark, in points of the screen.
    """

    entity: str
    name: str
    color: Color
    seconds: Array
    size: float = 6.0


def sound_of(episode: Episode | None, topic: str | None = None) -> Sound | None:
    """Return the sound to show; None if there is none, it is silent, or pictures have no clock."""
    if episode is None or not episode.sound_topics or episode.frames_untimed:
        return None
    try:
        sound = episode.sounds(topic if topic in episode.sound_topics else None)
    except LogError:
        return None
    return sound if sound is not None and np.any(sound.samples) else None


def log_beside(
    stream: rr.RecordingStream,
    sound: Sound,
    start_ns: int,
    span_s: tuple[float, float],
    last_s: float,
    impacts_s: Array | None = None,
    offset_s: float = 0.0,
    reason: str = "",
) -> rrb.View | None:
    """Send a sound recorded beside pictures or positions, with its knocks at `height` too.

    Args:
        stream: the recording.
        sound: as it was recorded.
        start_ns: stamp where the log's time is 0.
        span_s: first and last moment shown, on the log's time.
        last_s: when what is seen ends, likewise: no other view has anything outside of that.
        impacts_s: impacts that count as heard, on the pictures' clock, shape (N,); None where the
            sound is not used.
        offset_s: by which the sound is late on that clock: it is drawn so much earlier.
        reason: why the sound is not used, in words.

    Returns:
        Its view; None where nothing sounds while the drop is shown.
    """
    begin_s = (sound.start_ns - start_ns) * 1e-9 - offset_s
    around_s = span_s[0] - _AROUND_S - begin_s, span_s[1] + _AROUND_S - begin_s
    piece = _piece(sound, around_s)
    if piece is None:
        return None
    knocks_s = onsets(piece).times_s + (piece.start_ns - start_ns) * 1e-9 - offset_s
    heard_s = np.zeros(0) if impacts_s is None else impacts_s
    known = np.abs(knocks_s[:, None] - heard_s).min(axis=1, initial=np.inf) < _NEAR_S
    marks = (
        Marks("knock", "not used", MUTED, _inside(knocks_s[~known], span_s), 4.0),
        Marks("touch", "impact heard", OBSERVED, _inside(heard_s, span_s), 4.0),  # over "impact"
    )
    said = f"not used: {reason}" if reason else "not used"
    if impacts_s is not None:
        earlier = "earlier" if offset_s >= 0 else "later"
        said = f"drawn {1000 * abs(offset_s):.0f} ms {earlier}, white: heard"
    view = log_sound(stream, sound, begin_s, span_s, marks, said, (span_s[0], last_s))
    if view is not None:
        log_on_table(stream, marks)
    return view


def log_sound(
    stream: rr.RecordingStream,
    sound: Sound,
    begin_s: float,
    span_s: tuple[float, float],
    marks: Sequence[Marks],
    said: str,
    sent_s: tuple[float, float] = (-np.inf, np.inf),
) -> rrb.View | None:
    """Send the envelope and the marks on it.

    Args:
        stream: the recording.
        sound: all of it.
        begin_s: its first sample, on the log's time.
        span_s: first and last moment shown, on the log's time.
        marks: what is marked.
        said: of the marks, in the view's title.
        sent_s: first and last moment that can be scrolled to, on the log's time.

    Returns:
        The view; None where nothing sounds in what is shown.
    """
    seconds, levels_db = envelope(sound, (span_s[0] - begin_s, span_s[1] - begin_s))
    seconds = seconds + begin_s
    sent = (seconds >= sent_s[0]) & (seconds <= sent_s[1])
    seconds, levels_db = seconds[sent], levels_db[sent]
    shown = (seconds >= span_s[0]) & (seconds <= span_s[1])
    if not np.isfinite(levels_db[shown]).any():
        return None
    loudest_db = float(levels_db[shown].max())
    low_db = max(float(levels_db[shown].min()), loudest_db - _DEEP_DB)
    levels_db = np.maximum(levels_db, low_db)
    line = rr.SeriesLines(
        colors=[_ENVELOPE], names=["sound"], widths=[1.0], aggregation_policy="Max"
    )
    stream.log("sound/envelope", line, static=True)
    send_scalars(stream, "sound/envelope", seconds, levels_db)
    for one in marks:
        _log_marks(stream, "sound", one, _at(one.seconds, seconds, levels_db))
    return rrb.TimeSeriesView(
        origin="/sound",
        name=f"sound [dBFS], {said}",
        axis_x=time_axis(*span_s),
        axis_y=rrb.ScalarAxis(range=ticked(low_db, max(loudest_db, low_db + 1.0) + 3.0)),
        plot_legend=rrb.PlotLegend(visible=False),
    )


def log_on_table(stream: rr.RecordingStream, marks: Sequence[Marks]) -> None:
    """Send the same marks among the heights, at 0."""
    for one in marks:
        _log_marks(stream, "height", one, np.zeros(len(one.seconds)))


def time_axis(begin_s: float, end_s: float) -> rrb.TimeAxis:
    """Build the axis of a plot that shows this much of the log's time."""
    ends = (rrb.TimeRangeBoundary.absolute(seconds=at_s) for at_s in (begin_s, end_s))
    return rrb.TimeAxis(view_range=rr.TimeRange(*ends))


def envelope(sound: Sound, span_s: tuple[float, float]) -> tuple[Array, Array]:
    """Compute the envelope: the largest sample about each of at most `_MAX` moments.

    Args:
        sound: all of it. Of a long one, two minutes about the span are given, or the span.
        span_s: first and last moment asked for, on the sound's clock.

    Returns:
        Times on the sound's clock [s], and levels [dB of full scale], -inf of silence; shape (E,).
    """
    more_s = max(_MAX / _RATE_HZ - (span_s[1] - span_s[0]), 0.0) / 2
    ends = ((span_s[0] - more_s) * sound.rate_hz, (span_s[1] + more_s) * sound.rate_hz)
    first, last = (round(min(max(at, 0.0), float(len(sound.samples)))) for at in ends)
    wide = max(round(sound.rate_hz / _RATE_HZ), -(-(last - first) // _MAX), 1)
    count = (last - first) // wide
    pieces = sound.samples[first : first + count * wide].reshape(count, wide)
    most = np.maximum(pieces.max(axis=1), -pieces.min(axis=1))
    most = np.nan_to_num(most, posinf=0.0, neginf=0.0)
    with np.errstate(divide="ignore"):
        levels_db: Array = 20 * np.log10(most.astype(np.float64))
    middles = first + (np.arange(count, dtype=np.float64) + 0.5) * wide
    return middles / sound.rate_hz, levels_db


def _piece(sound: Sound, span_s: tuple[float, float]) -> Sound | None:
    """Cut what sounds then, on the sound's clock; None where that is nothing."""
    last = len(sound.samples)
    begin, end = (round(min(max(at * sound.rate_hz, 0.0), float(last))) for at in span_s)
    samples = sound.samples[begin:end]
    if not np.any(samples):
        return None
    later_ns = round(1e9 * begin / sound.rate_hz)
    return replace(sound, start_ns=sound.start_ns + later_ns, samples=samples)


def _inside(seconds: Array, span_s: tuple[float, float]) -> Array:
    return seconds[(seconds >= span_s[0]) & (seconds <= span_s[1])]


def _at(moments_s: Array, seconds: Array, levels_db: Array) -> Array:
    """Return the largest level soon after each of these moments, shape (N,)."""
    first = np.clip(np.searchsorted(seconds, moments_s) - 1, 0, len(seconds) - 1)
    last = np.searchsorted(seconds, moments_s + _LOUD_S)
    pairs = zip(first.tolist(), last.tolist(), strict=True)
    return np.array([levels_db[begin : max(end, begin + 1)].max() for begin, end in pairs])


def _log_marks(stream: rr.RecordingStream, place: str, marks: Marks, values: Array) -> None:
    """Send diamonds; nothing where there are none."""
    if not len(marks.seconds):
        return
    style = rr.SeriesPoints(
        colors=[marks.color], names=[marks.name], markers=["diamond"], marker_sizes=[marks.size]
    )
    stream.log(f"{place}/{marks.entity}", style, static=True)
    send_scalars(stream, f"{place}/{marks.entity}", marks.seconds, values)
