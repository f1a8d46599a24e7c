"""Tune synthetic films of dropped balls: rendered clips, and tracks that were never pictures.

Clips go through the whole of `tunenet-tune`, as a stranger's videos: nothing of the rig is given.
The ball is integrated from impact to impact (`worlds.ball`) and drawn by rays (`worlds.clips`):
neither shares code with the tracker or the fit. It differs from what is behind it by 30 of 255 in
one colour on half of its way, by 20 on nearly all of it: or a person could not follow it either.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.drop.detection import FilmDetection
from tunenet_logs.analysis.drop.experiments import DropFromFilm
from tunenet_logs.analysis.evaluation.study import (
    csv_text,
    json_text,
    seeds_in_words,
    short,
    short_or_dash,
    table_line,
)
from tunenet_logs.analysis.evaluation.worlds.camera import (
    FAULT_BALLS,
    FAULT_SET,
    NARROW,
    NOISES_PX,
    TABLE_TENNIS_DRAG_1_M,
    TABLE_TENNIS_RADIUS_M,
    TRACK_FAULTS,
    TRACK_SETS,
    WIDE,
    B,
    BallRanges,
    TrackSet,
    draw_scene,
    film,
)
from tunenet_logs.analysis.evaluation.worlds.clips import (
    VERSIONS,
    ClipOrder,
    draw_clip,
    places_px,
    write_clip,
    write_versions,
)
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece, parallel_map
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.analysis.tuning import Stopwatch, tune_detected, tune_log
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.known import BALLS
from tunenet_logs.terminal import Progress

Result = TypeVar("Result")

COUNT = 100  # clips of a full run, as filmed
TRANSFORMED = 30  # likewise, in all `VERSIONS`


@dataclass(frozen=True)
class ClipResult:
    """Result for one clip."""

    seed: int
    index: int
    truth: float  # restitution that was drawn
    estimate: float | None  # None where it was rejected
    interval: tuple[float, float] | None  # 95 %; None where there is none
    verdict: str  # "ok", "suspect" or "rejected"
    reason: str | None  # why it is not "ok"
    # rms distance of the tracked centres from the true ones, from the release on; None where there
    # is no track
    off_px: float | None
    found: float  # fraction of the frames from the release on in which the ball was found
    seconds: float  # the time that reading and tuning took
    length_s: float  # of the clip


@dataclass(frozen=True)
class TransformedClip:
    """Results for one clip and its versions, in the order of `VERSIONS`."""

    seed: int
    index: int
    truth: float  # restitution that was drawn
    estimates: tuple[float | None, ...]  # None where a version was rejected

    @property
    def answered(self) -> int:
        """Number of versions that were answered."""
        return sum(estimate is not None for estimate in self.estimates)

    @property
    def spread(self) -> float | None:
        """Largest less smallest estimate; None where fewer than two were answered."""
        known = [estimate for estimate in self.estimates if estimate is not None]
        return max(known) - min(known) if len(known) > 1 else None


def clip_results(
    seed: int, count: int, jobs: int | None, progress: Progress
) -> tuple[ClipResult, ...]:
    """Render, write, read and tune `count` clips, in `jobs` processes (default: all cores)."""
    return tuple(_spread(clip_result, seed, count, jobs, progress))


def transformed_results(
    seed: int, count: int, jobs: int | None, progress: Progress
) -> tuple[TransformedClip, ...]:
    """Tune the first `count` clips of a seed, each in all `VERSIONS`."""
    return tuple(_spread(transformed_result, seed, count, jobs, progress))


def clip_result(seed: int, index: int) -> ClipResult:
    """Tune one clip."""
    order = draw_clip(seed, index)
    with tempfile.TemporaryDirectory() as folder:
        tuning = tune_log(write_clip(order, Path(folder)), TuneOptions())
    ends = tuning.interval95
    off_px, found = _tracked(order, tuning)
    return ClipResult(
        seed=seed,
        index=index,
        truth=order.ball.restitution,
        estimate=_value(tuning),
        interval=None if ends is None else (float(ends[0, 0]), float(ends[0, 1])),
        verdict=tuning.verdict,
        reason=tuning.reason,
        off_px=off_px,
        found=found,
        seconds=tuning.seconds["total"],
        length_s=order.held_s + order.length_s,
    )


def transformed_result(seed: int, index: int) -> TransformedClip:
    """Tune one clip in all versions."""
    order = draw_clip(seed, index)
    return TransformedClip(seed, index, order.ball.restitution, version_estimates(order))


def version_estimates(order: ClipOrder) -> tuple[float | None, ...]:
    """Return the estimate from each of `VERSIONS`."""
    with tempfile.TemporaryDirectory() as folder:
        paths = write_versions(order, Path(folder), VERSIONS)
        return tuple(_value(tune_log(path, TuneOptions())) for path in paths)


def track_errors_px(order: ClipOrder, track: Track) -> Array:
    """Return the errors of tracked centres, shape (T, 2) [px], NaN before the release."""
    seconds = (track.stamps_ns - track.stamps_ns[0]) * 1e-9
    rows = np.round(seconds * order.rate_hz).astype(int)
    off = track.places_px - places_px(order)[rows]
    off[seconds < order.held_s] = np.nan
    return off


def _tracked(order: ClipOrder, tuning: Tuning) -> tuple[float | None, float]:
    if tuning.detection is None:
        return None, 0.0
    off = track_errors_px(order, tuning.detection.film.track)
    seen = np.isfinite(off[:, 0])
    after = int(order.length_s * order.rate_hz)
    return float(np.sqrt(np.nanmean((off**2).sum(axis=1)))), float(min(seen.sum() / after, 1.0))


def _value(tuning: Tuning) -> float | None:
    return None if tuning.estimate is None else float(tuning.estimate[0])


def _spread(
    work: Callable[[int, int], Result],
    seed: int,
    count: int,
    jobs: int | None,
    progress: Progress,
) -> list[Result]:
    """Run `work` on every clip, in their order."""
    pieces = [Piece((seed, index), 1, f"clip {index}") for index in range(count)]
    return parallel_map(partial(_alone, work), pieces, jobs, progress, ("filming", "clip"))


def _alone(work: Callable[[int, int], Result], which: tuple[int, int]) -> Result:
    """Run `work` in one thread: there is a process for each core."""
    import cv2

    cv2.setNumThreads(1)
    return work(*which)


# ---- Tables of clips for a terminal.


_WIDTHS = (10, 10, 9, 10, 10, 10, 10, 12, 12)  # of the columns [characters]


def clip_table(results: Sequence[ClipResult]) -> str:
    """Tabulate how many clips were answered, the errors, and the track's accuracy."""
    errors = np.array(
        [abs(clip.estimate - clip.truth) for clip in results if clip.estimate is not None]
    )
    covered = [
        clip.interval[0] <= clip.truth <= clip.interval[1]
        for clip in results
        if clip.estimate is not None and clip.interval is not None
    ]
    tracked = [clip.off_px for clip in results if clip.off_px is not None]
    head = ["clips", "answered", "ok", "MAE", "median", "95 %", "worst", "held", "track, px"]
    row = [
        str(len(results)),
        str(len(errors)),
        str(sum(clip.verdict == "ok" for clip in results)),
        *_error_cells(errors),
        f"{sum(covered)} of {len(covered)}" if covered else "-",
        f"{np.median(tracked):.2f}" if tracked else "-",
    ]
    return "\n".join(
        [
            "Drawn clips, as a stranger films them",
            table_line(head, _WIDTHS),
            table_line(row, _WIDTHS),
        ]
    )


def transformed_table(results: Sequence[TransformedClip]) -> str:
    """Tabulate how much the estimate depends on transforms that leave the ball unchanged."""
    spreads = [clip.spread for clip in results if clip.spread is not None]
    whole = sum(clip.answered == len(VERSIONS) for clip in results)
    head = ["clips", "answered", "", "mean", "median", "95 %", "worst"]
    row = [str(len(results)), str(whole), "", *_error_cells(np.array(spreads))]
    title = f"Spread of the answers for one clip: {', '.join(VERSIONS)}"
    return "\n".join([title, table_line(head, _WIDTHS), table_line(row, _WIDTHS)])


def _error_cells(errors: Array) -> list[str]:
    """Format mean, median, 95th percentile and maximum of errors, shape (N,); dashes for none."""
    if not len(errors):
        return ["-"] * 4
    figures = (errors.mean(), np.median(errors), np.quantile(errors, 0.95), errors.max())
    return [short(float(figure)) for figure in figures]


# ---- Tune from a track that was made, not found in pictures.


def tune_track(track: Track, options: TuneOptions) -> Tuning:
    """Tune from the track of a filmed ball, as `tune_log` does once it has found one."""
    experiment = DropFromFilm()
    detection = FilmDetection(
        physical=experiment.presets[options.preset].physical,
        topic="",
        start_ns=int(track.stamps_ns[0]),
        track=track,
        ball=options.given_ball,
    )
    return tune_detected(experiment, lambda: detection, options, Stopwatch())


# ---- Tables on tracks: which tracks are drawn, and what each is tuned to.


VERDICTS = ("ok", "suspect", "rejected")
# Of a row of outcomes: `shown` is 1 where the tuning tells its interval.
OUTCOME_COLUMNS = ("truth", "value", "low", "high", "shown", "verdict")

TABLE_TENNIS = "table-tennis"  # its name among `tunenet_logs.recorders.simulators.known.BALLS`
_SLOPES = BallRanges((0.3, 0.9), slope=(0.05, 0.2))
_LIGHT = BallRanges((0.3, 0.95), drag_1_m=TABLE_TENNIS_DRAG_1_M)
_LIGHT_SET = TrackSet("light", (0.3, 2.0), TABLE_TENNIS_RADIUS_M)


@dataclass(frozen=True)
class TrackKind:
    """Tracks of one kind: a line of a table."""

    label: str  # in tables
    tracks: TrackSet  # the rig
    balls: BallRanges  # what is dropped
    noises_px: tuple[float, ...]  # standard deviations of a coordinate, one for each track, in turn
    fault: str = ""  # name of the `TrackFault`, "" for good tracks
    given_ball: str = ""  # name of the ball that the tuning is given, "" for none


@dataclass(frozen=True)
class Section:
    """One table."""

    name: str  # in JSON and CSV
    title: str  # above the table
    kinds: tuple[TrackKind, ...]  # its lines


@dataclass(frozen=True)
class Portion:
    """Some of a seed's tracks of a kind: what one process does in one go."""

    kind: TrackKind
    seed: int
    numbers: range


def outcomes_of(portion: Portion) -> Array:
    """Tune each track: see `OUTCOME_COLUMNS`, shape (N, 6).

    NaN stands for the truth of a track without a bounce, and for a value or an interval that the
    tuning does not give.
    """
    return np.array([_outcome(portion.kind, portion.seed, at) for at in portion.numbers])


def _outcome(kind: TrackKind, seed: int, number: int) -> list[float]:
    noise_px = kind.noises_px[number % len(kind.noises_px)]
    scene = draw_scene(kind.tracks, kind.balls, noise_px, seed, number)
    truth, track = scene.ball.restitution, None
    if kind.fault:
        fault = next(one for one in TRACK_FAULTS if one.name == kind.fault)
        truth, track = truth if fault.bounces else np.nan, fault.track(scene)
    selection = TuneOptions(ball=BALLS[kind.given_ball]) if kind.given_ball else TuneOptions()
    options = selection
    tuning = tune_track(film(scene) if track is None else track, options)
    value, low, high = np.nan, np.nan, np.nan
    if tuning.estimate is not None:
        value = tuning.estimate[0]
        if tuning.trace is not None and tuning.trace.fit is not None:
            low, high = tuning.trace.fit.interval95[0]
    shown = tuning.interval95 is not None
    return [truth, value, low, high, shown, VERDICTS.index(tuning.verdict)]


def _good(tracks: TrackSet) -> tuple[TrackKind, ...]:
    return tuple(
        TrackKind(
            f"{tracks.name}, {noise:g} px, {low:g} to {high:g}",
            tracks,
            BallRanges((low, high)),
            (noise,),
        )
        for low, high in (NARROW, WIDE)
        for noise in NOISES_PX
    )


def _light(given_ball: str, noise_px: float) -> TrackKind:
    return TrackKind(
        f"{'given' if given_ball else 'not given'}, {noise_px:g} px",
        _LIGHT_SET,
        _LIGHT,
        (noise_px,),
        given_ball=given_ball,
    )


SETS = tuple(
    Section(f"set-{tracks.name}", title, _good(tracks))
    for tracks, title in zip(
        TRACK_SETS,
        (
            "Set A: the paper's rig; set, noise, restitution",
            "Set B: falls of 0.2 to 5 m before any camera, 60 Hz",
            "Set C: as B, 6 to 150 frames a fall, releases unseen, gaps",
        ),
        strict=True,
    )
)
SLOPE = Section(
    "slope",
    "Restitution that falls with speed (p .05 to .2), set B, .3 to .9 at the first impact",
    tuple(
        TrackKind(f"{noise:g} px", replace(B, name="slope"), _SLOPES, (noise,))
        for noise in NOISES_PX
    ),
)
DRAG = Section(
    "drag",
    "Table-tennis ball in air, its mass and size given or not, falls of 0.3 to 2 m, .3 to .95",
    (*(_light(TABLE_TENNIS, noise) for noise in NOISES_PX), _light("", NOISES_PX[0])),
)
BAD = Section(
    "bad",
    "Bad tracks: falls of 0.2 to 5 m, .3 to .9, 0.3 and 1 px in turn",
    tuple(
        TrackKind(fault.label, FAULT_SET, FAULT_BALLS, NOISES_PX, fault=fault.name)
        for fault in TRACK_FAULTS
    ),
)
TRACK_SECTIONS = (*SETS, SLOPE, DRAG, BAD)  # in the order in which they are run and printed


# ---- Errors, coverage and verdicts on tracks.


WRONG = 0.05  # of restitution: a larger error is one that a user would mind
_PORTION = 10  # tracks in a portion: few, so that the processes end together


@dataclass(frozen=True)
class VideoFigures:
    """Figures of tracks of one kind; of errors and intervals, None where there is none."""

    targets: int  # how many there were
    answered: float  # fraction that got a value: verdict `ok` or `suspect`
    ok: float  # fraction with that verdict; `suspect` and `rejected` likewise
    suspect: float
    rejected: float
    # fraction of all that are `ok` and off by more than `WRONG`, or have no bounce at all
    wrong: float
    mae: float | None  # mean absolute error of the answered
    median: float | None  # of their absolute errors
    p95: float | None  # 95th percentile of these
    bias: float | None  # mean error, positive where the value is too high
    # fraction of the answered with an interval whose interval contains the truth, be it shown or
    # not
    covered: float | None
    shown: float | None  # fraction of the answered whose interval the tuning shows
    shown_covered: float | None  # fraction of those whose interval contains the truth
    width: float | None  # median of all intervals' widths


@dataclass(frozen=True)
class VideoRow:
    """Line of a table."""

    section: str  # name of the `Section`
    label: str  # of the `TrackKind`
    outcomes: Array  # see `OUTCOME_COLUMNS`, shape (N, 6)

    @property
    def figures(self) -> VideoFigures:
        """Figures by `figures_of`."""
        return figures_of(self.outcomes)


@dataclass(frozen=True)
class VideoOrder:
    """Settings of the experiment."""

    seeds: tuple[int, ...]  # each draws its own tracks
    targets: int  # tracks of each kind for each seed
    jobs: int | None = None  # processes; None for all cores


def track_sections(
    order: VideoOrder, progress: Progress, sections: tuple[Section, ...] = TRACK_SECTIONS
) -> Iterator[tuple[Section, tuple[VideoRow, ...]]]:
    """Yield each section with its rows, as soon as it is done; the same for any number of jobs."""
    for section in sections:
        yield section, _rows(section, order, progress)


def figures_of(outcomes: Array) -> VideoFigures:
    """Compute the figures of outcomes: see `OUTCOME_COLUMNS`, shape (N, 6)."""
    truth, value, low, high, is_shown, verdict = outcomes.T
    answered = np.isfinite(value)
    errors = (value - truth)[answered & np.isfinite(truth)]
    off = np.where(np.isfinite(truth), np.abs(value - truth), np.inf)
    ok, suspect, rejected = (verdict == VERDICTS.index(name) for name in VERDICTS)
    known = np.isfinite(low) & np.isfinite(truth)
    covered, shown = (low <= truth) & (truth <= high), known & (is_shown > 0)
    return VideoFigures(
        targets=len(outcomes),
        answered=float(answered.mean()),
        ok=float(ok.mean()),
        suspect=float(suspect.mean()),
        rejected=float(rejected.mean()),
        wrong=float(np.mean(ok & (off > WRONG))),
        mae=_or_none(np.abs(errors), np.mean),
        median=_or_none(np.abs(errors), np.median),
        p95=_or_none(np.abs(errors), lambda errors: np.percentile(errors, 95)),
        bias=_or_none(errors, np.mean),
        covered=_or_none(covered[known], np.mean),
        shown=_or_none(shown[answered], np.mean),
        shown_covered=_or_none(covered[shown], np.mean),
        width=_or_none((high - low)[known], np.median),
    )


def _or_none(values: NDArray[Any], figure: Callable[[NDArray[Any]], Any]) -> float | None:
    return float(figure(values)) if len(values) else None


def _rows(section: Section, order: VideoOrder, progress: Progress) -> tuple[VideoRow, ...]:
    pieces: list[Piece[Portion]] = []
    rows: list[tuple[str, slice]] = []
    for kind in section.kinds:
        start = len(pieces)
        for seed in order.seeds:
            for at in range(0, order.targets, _PORTION):
                numbers = range(at, min(at + _PORTION, order.targets))
                pieces.append(Piece(Portion(kind, seed, numbers), len(numbers), kind.label))
        rows.append((kind.label, slice(start, len(pieces))))
    done = parallel_map(outcomes_of, pieces, order.jobs, progress, (section.name, "track"))
    return tuple(VideoRow(section.name, label, np.concatenate(done[own])) for label, own in rows)


# ---- JSON and CSV: one record a line of the tables on tracks.


COLUMNS = ("section", "tracks", *(field.name for field in fields(VideoFigures)))  # of the CSV


def video_records(rows: Sequence[VideoRow]) -> list[dict[str, Any]]:
    """Return one record for each line; see `COLUMNS`."""
    return [{"section": row.section, "tracks": row.label, **asdict(row.figures)} for row in rows]


def video_json(
    rows: Sequence[VideoRow],
    order: VideoOrder,
    clips: Sequence[ClipResult] = (),
    transformed: Sequence[TransformedClip] = (),
) -> str:
    """Serialise every figure, and the result of each clip; null where there is none."""
    head = {"experiment": "video", "seeds": list(order.seeds), "targets": order.targets}
    tables = {
        "rows": video_records(rows),
        "clips": [asdict(clip) for clip in clips],
        "transformed": [{**asdict(clip), "spread": clip.spread} for clip in transformed],
    }
    return json_text({**head, **tables})


def video_csv(rows: Sequence[VideoRow]) -> str:
    """Format `video_records` as a table; an empty field where there is no figure."""
    return csv_text(COLUMNS, video_records(rows))


# ---- Tables on tracks for a terminal.


Column = tuple[str, int, Callable[[VideoFigures], str]]


def video_blocks(
    order: VideoOrder, sections: Iterable[tuple[Section, Sequence[VideoRow]]]
) -> Iterator[str]:
    """Yield the protocol, each section's table as soon as it is there, and overall figures."""
    yield _protocol(order)
    good: dict[str, Sequence[VideoRow]] = {}
    for section, rows in sections:
        yield section_table(section, rows)
        if section in SETS:
            good[section.name] = rows
            if len(good) == len(SETS):
                yield overall([row for one in good.values() for row in one])


def section_table(section: Section, rows: Sequence[VideoRow]) -> str:
    """Tabulate one line for each kind of track."""
    columns = _columns(section)
    lines = [section.title, _line(section, "", [name for name, _, _ in columns])]
    for row in rows:
        figures = row.figures
        lines.append(_line(section, row.label, [show(figures) for _, _, show in columns]))
    return "\n".join(lines)


def overall(rows: Sequence[VideoRow]) -> str:
    """Describe coverage and width over all good tracks, and the worst line's coverage."""
    figures = figures_of(np.concatenate([row.outcomes for row in rows]))
    text = f"A, B and C: {figures.targets} tracks, {_percent(figures.rejected)} % rejected."
    cells = [one.covered for one in (row.figures for row in rows) if one.covered is not None]
    if cells:
        text += (
            f"\n95 % intervals: {_percent(figures.covered)} % contain the truth, in the worst line "
            f"{_percent(min(cells))} %; median width {short_or_dash(figures.width)}."
            f"\n{_percent(figures.shown)} % of the answers show theirs; of these "
            f"{_percent(figures.shown_covered)} % do."
        )
    return text


def _protocol(order: VideoOrder) -> str:
    return (
        "Restitution at the first impact, from tracks of 320 x 240 px; "
        f"{seeds_in_words(order.seeds)}, {order.targets} tracks each.\n"
        "Fractions in percent. Errors and intervals are of all answers: verdict ok or suspect.\n"
        "A dash: there is none."
    )


def _percent(fraction: float | None) -> str:
    return "-" if fraction is None else f"{100 * fraction:.1f}"


def _signed(error: float | None) -> str:
    return "-" if error is None else ("-" if error < 0 else "+") + short(abs(error))


_TARGETS: Column = ("tracks", 7, lambda one: str(one.targets))
_REJECTED: Column = ("rejected", 10, lambda one: _percent(one.rejected))
_SUSPECT: Column = ("suspect", 9, lambda one: _percent(one.suspect))
_VERDICTS: tuple[Column, ...] = (
    _TARGETS,
    ("answered", 10, lambda one: _percent(one.answered)),
    _REJECTED,
    _SUSPECT,
)
_BIAS: Column = ("bias", 8, lambda one: _signed(one.bias))
_ERRORS: tuple[Column, ...] = (
    ("mean", 7, lambda one: short_or_dash(one.mae)),
    ("median", 7, lambda one: short_or_dash(one.median)),
    ("95th", 7, lambda one: short_or_dash(one.p95)),
    ("held", 6, lambda one: _percent(one.covered)),
    ("width", 5, lambda one: short_or_dash(one.width)),
)
_BAD: tuple[Column, ...] = (
    _TARGETS,
    ("ok", 7, lambda one: _percent(one.ok)),
    (f"ok, off by > {WRONG:g}", 19, lambda one: _percent(one.wrong)),
    _REJECTED,
    _SUSPECT,
)


def _columns(section: Section) -> tuple[Column, ...]:
    if section is BAD:
        return _BAD
    bias = (_BIAS,) if section is DRAG else ()
    return (*_VERDICTS, *bias, *_ERRORS)


def _line(section: Section, label: str, cells: Sequence[str]) -> str:
    first = max(len(kind.label) for kind in section.kinds) + 2
    widths = [width for _, width, _ in _columns(section)]
    return table_line([label, *cells], [first, *widths])
