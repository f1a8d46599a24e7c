"""Tune synthetic films of dropped balls: rendered clips, and tracks that were never pictures.

Clips go through the whole of `tunenet-tune`, as a stranger's videos: nothing of the rig is given.
The ball is integrated from impact to impact (`worlds.ball`) and drawn by rays (`worlds.clips`):
neither shares code with the tracker or the fit. It differs from what is behind it by 30 of 255 in
one colour on half of its way, by 20 on nearly all of it: or a person could not follow it either.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tunenet_logs.analysis.drop.bounce_model import (
    IDEAL,
    PERSPECTIVE,
    PERSPECTIVE_SD,
    BounceSamples,
)
from tunenet_logs.analysis.drop.detection import FilmDetection
from tunenet_logs.analysis.drop.experiments import DropFromFilm
from tunenet_logs.analysis.evaluation.study import (
    STUDIES,
    Columns,
    Order,
    Part,
    Row,
    decimals,
    figure,
    holds,
    listed,
    percent,
    scored,
    short,
    shown,
    table,
)
from tunenet_logs.analysis.evaluation.worlds import camera
from tunenet_logs.analysis.evaluation.worlds import clips as films
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.analysis.tuning import Stopwatch, tune_detected, tune_log
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.known import BALLS
from tunenet_logs.terminal import Progress

# ---- Clips: rendered, written, read and tuned.


def clip_row(case: tuple[int, int]) -> list[Row]:
    """Tune the clip of a seed and an index."""
    return [{**_tuned(case, _drawn(*case)), "kind": "as drawn"}]


def home_row(case: tuple[int, int]) -> list[Row]:
    """Tune the clip of a seed and an index as people film at home."""
    import cv2

    cv2.setNumThreads(1)  # there is a process for each core
    order, kind = films.draw_home_clip(*case)
    return [{**_tuned(case, order), "kind": kind}]


def _tuned(case: tuple[int, int], order: films.ClipOrder) -> Row:
    with tempfile.TemporaryDirectory() as folder:
        tuning = tune_log(films.write_clip(order, Path(folder)), TuneOptions())
    off_px, found = None, 0.0
    if tuning.detection is not None and order.kept == (1, 1):
        off = track_errors_px(order, tuning.detection.film.track)
        off_px = float(np.sqrt(np.nanmean((off**2).sum(axis=1))))
        found = min(np.isfinite(off[:, 0]).sum() / int(order.length_s * order.rate_hz), 1.0)
    ends = tuning.interval95
    return {
        "seed": case[0],
        "index": case[1],
        "truth": order.ball.restitution,
        "estimate": _value(tuning),
        "interval": None if ends is None else ends[0].tolist(),  # 95 %
        "verdict": tuning.verdict,
        "reason": tuning.reason,
        # rms distance of the tracked centres from the true ones, from the release on
        "off_px": off_px,
        "found": float(found),  # fraction of the frames from the release on that have the ball
        "seconds": tuning.seconds["total"],  # that reading and tuning took
        "length_s": order.held_s + order.length_s,
    }


def transformed_row(case: tuple[int, int]) -> list[Row]:
    """Tune the clip of a seed and an index in all versions."""
    order = _drawn(*case)
    estimates = version_estimates(order)
    known = [one for one in estimates if one is not None]
    row = {
        "seed": case[0],
        "index": case[1],
        "truth": order.ball.restitution,
        "estimates": list(estimates),  # in the order of `VERSIONS`; None where it was rejected
        "spread": max(known) - min(known) if len(known) > 1 else None,
    }
    return [row]


def _drawn(seed: int, index: int) -> films.ClipOrder:
    import cv2

    cv2.setNumThreads(1)  # there is a process for each core
    return films.draw_clip(seed, index)


def version_estimates(order: films.ClipOrder) -> tuple[float | None, ...]:
    """Return the estimate from each of `VERSIONS`."""
    with tempfile.TemporaryDirectory() as folder:
        paths = films.write_versions(order, Path(folder), films.VERSIONS)
        return tuple(_value(tune_log(path, TuneOptions())) for path in paths)


def track_errors_px(order: films.ClipOrder, track: Track) -> Array:
    """Return the errors of tracked centres, shape (T, 2) [px], NaN before the release."""
    seconds = (track.stamps_ns - track.stamps_ns[0]) * 1e-9
    rows = np.round(seconds * order.rate_hz).astype(int)
    off = track.places_px - films.places_px(order)[rows]
    off[seconds < order.held_s] = np.nan
    return off


def _value(tuning: Tuning) -> float | None:
    return None if tuning.estimate is None else float(tuning.estimate[0])


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


@dataclass(frozen=True)
class TrackKind:
    """Tracks of one kind: a line of a table."""

    label: str  # in tables
    tracks: camera.TrackSet  # the rig
    balls: camera.BallRanges  # what is dropped
    noises_px: tuple[float, ...]  # standard deviations of a coordinate, one for each track, in turn
    fault: str = ""  # name of the `TrackFault`, "" for good tracks
    is_named: bool = False  # whether the tuning is told that the ball is a table-tennis ball


@dataclass(frozen=True)
class Section:
    """One table."""

    name: str  # in JSON and CSV
    title: str  # above the table
    kinds: tuple[TrackKind, ...]  # its lines


SETS = tuple(
    Section(
        f"set-{rig.name}",
        title,
        tuple(
            TrackKind(f"{rig.name}, {noise:g} px, {ends}", rig, camera.BallRanges(one), (noise,))
            for one, ends in ((camera.NARROW, "0.3 to 0.7"), (camera.WIDE, "0.1 to 0.95"))
            for noise in camera.NOISES_PX
        ),
    )
    for rig, title in (
        (camera.A, "Set A: the paper's rig; set, noise, restitution"),
        (camera.B, "Set B: falls of 0.2 to 5 m before any camera, 60 Hz"),
        (camera.C, "Set C: as B, 6 to 150 frames a fall, releases unseen, gaps"),
    )
)
SLOPE = Section(
    "slope",
    "Restitution that falls with speed (p .05 to .2), set B, .3 to .9 at the first impact",
    tuple(
        TrackKind(
            *(f"{noise:g} px", replace(camera.B, name="slope")),
            *(camera.BallRanges((0.3, 0.9), slope=(0.05, 0.2)), (noise,)),
        )
        for noise in camera.NOISES_PX
    ),
)
DRAG = Section(
    "drag",
    "Table-tennis ball in air, its mass and size given or not, falls of 0.3 to 2 m, .3 to .95",
    tuple(
        TrackKind(
            f"{given}, {noise:g} px",
            camera.TrackSet("light", (0.3, 2.0), camera.TABLE_TENNIS_RADIUS_M),
            *(camera.BallRanges((0.3, 0.95), drag_1_m=camera.TABLE_TENNIS_DRAG_1_M), (noise,)),
            is_named=given == "given",
        )
        for given, noise in (("given", 0.3), ("given", 1.0), ("not given", 0.3))
    ),
)
BAD, CONVERTED = (
    Section(
        name,
        f"{title}: falls of 0.2 to 5 m, .3 to .9, 0.3 and 1 px in turn",
        tuple(
            TrackKind(one.label, camera.FAULT_SET, camera.FAULT_BALLS, camera.NOISES_PX, one.name)
            for one in kinds
        ),
    )
    for name, title, kinds in (
        ("bad", "Bad tracks", camera.TRACK_FAULTS),
        ("converted", "Films shown at another rate", camera.CONVERSIONS),
    )
)
# In the order in which they are run and printed.
TRACK_SECTIONS = (*SETS, SLOPE, DRAG, BAD, CONVERTED)


# ---- Cramér-Rao bound of any fit of a filmed ball that knows that it keeps its restitution.


def bound_row(
    tracks: camera.TrackSet, noise_px: float, balls: camera.BallRanges, order: Order
) -> Row:
    """Compute the least mean error and median width of scenes that no other section has."""
    sds = np.array(
        [
            least_sd(camera.draw_scene(tracks, balls, noise_px, -seed, number))
            for seed in order.seeds
            for number in range(order.targets_of("video", "bound"))
        ]
    )
    low, high = balls.restitution
    return {
        "tracks": f"{tracks.name}, {noise_px:g} px, {low:g} to {high:g}",
        "mean": float(np.sqrt(2 / np.pi) * sds.mean()),
        "width": 3.92 * float(np.median(sds)),
    }


def least_sd(scene: camera.TrackScene) -> float:
    """Return the standard deviation of the restitution by an efficient estimator."""
    ends_m = camera.upright(np.array([0.0, scene.ball.drop_m]))
    places, depths = scene.view.image_from_world(ends_m), scene.view.depths_m(ends_m)
    fall_s, span_px = scene.ball.fall_s, float(np.linalg.norm(places[1] - places[0]))
    truth = [scene.ball.restitution, fall_s, np.log(fall_s), 0.0, span_px]
    truth += [np.log(depths[0] / depths[1]), 0.0, 0.0, 0.0]
    seconds = scene.seconds[~scene.lost]
    noise_px = float(np.sqrt(scene.noise_px**2 + 1 / 12))  # of a coordinate that is rounded
    samples = BounceSamples(seconds, np.zeros(len(seconds)), noise_px)
    slopes = samples.jacobian(np.array(truth, float), IDEAL)
    information = slopes.T @ slopes / noise_px**2
    information[PERSPECTIVE, PERSPECTIVE] += PERSPECTIVE_SD**-2
    return float(np.sqrt(np.linalg.inv(information)[0, 0]))


# ---- Run, and figures of a kind of track: errors, coverage and verdicts.

WRONG = 0.05  # of restitution: a larger error is one that a user would mind


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Tune tracks kind by kind, then clips; the first part says what is measured."""
    tracks = [one for one in TRACK_SECTIONS if one.name in order.sections]
    if tracks:
        yield Part(
            "",
            "Restitution at the first impact, from tracks of 320 x 240 px; "
            f"{order.seeds_in_words}, {order.targets} tracks each.\n"
            "Fractions in percent. Errors and intervals are of all answers: verdict ok or "
            "suspect.\nA dash: there is none.",
        )
    good: list[Array] = []
    for section in tracks:
        cases = {one.label: order.pieces(10, one, name=one.label) for one in section.kinds}
        done = scored(track_outcomes, cases, order, progress, (section.name, "track"))
        outcomes = {label: np.array(rows) for label, rows in done.items()}
        rows = [{"tracks": label, **figures_of(some)} for label, some in outcomes.items()]
        yield Part(section.name, section_table(section, rows), rows)
        if section in SETS:
            good += outcomes.values()
            if len(good) == sum(len(one.kinds) for one in SETS):
                yield Part("", overall(good))
    fraction = min(order.targets / STUDIES["video"].targets, 1.0)
    for name, full, work, tabulate in (
        ("clips", 100, clip_row, clip_table),
        ("home", 100, home_row, home_table),
        ("transformed", 30, transformed_row, transformed_table),
    ):
        if name in order.sections:
            count = math.ceil(full * fraction)
            clips = [Piece((order.seeds[0], at), 1, f"clip {at}") for at in range(count)]
            rows = scored(work, {name: clips}, order, progress, ("filming", "clip"))[name]
            yield Part(name, tabulate(rows), rows)
    if "bound" in order.sections:
        rows = [
            bound_row(tracks, noise_px, camera.BallRanges(one), order)
            for tracks in camera.TRACK_SETS
            for noise_px in camera.NOISES_PX
            for one in (camera.NARROW, camera.WIDE)
        ]
        yield Part("bound", listed(rows, "Cramér-Rao bound of a fit of ideal balls"), rows)


def track_outcomes(case: tuple[TrackKind, int, range]) -> list[list[float]]:
    """Tune tracks of a kind and a seed; return the rows of `figures_of`, shape (N, 6).

    NaN stands for the truth of a track without a bounce, and for a value or an interval that the
    tuning does not give.
    """
    kind, seed, numbers = case
    options = TuneOptions(ball=BALLS["table-tennis"]) if kind.is_named else TuneOptions()
    faults = (*camera.TRACK_FAULTS, *camera.CONVERSIONS)
    fault = next((one for one in faults if one.name == kind.fault), None)
    outcomes: list[list[float]] = []
    for number in numbers:
        noise_px = kind.noises_px[number % len(kind.noises_px)]
        scene = camera.draw_scene(kind.tracks, kind.balls, noise_px, seed, number)
        truth = scene.ball.restitution if fault is None or fault.bounces else np.nan
        tuning = tune_track(camera.film(scene) if fault is None else fault.track(scene), options)
        value, low, high = np.nan, np.nan, np.nan
        if tuning.estimate is not None:
            value = tuning.estimate[0]
            if tuning.trace is not None and tuning.trace.fit is not None:
                low, high = tuning.trace.fit.interval95[0]
        is_shown = tuning.interval95 is not None
        outcomes.append([truth, value, low, high, is_shown, VERDICTS.index(tuning.verdict)])
    return outcomes


def figures_of(outcomes: Array) -> Row:
    """Compute the figures of rows (truth, value, interval, whether it is told, verdict), (N, 6)."""
    truth, value, low, high, is_shown, verdict = outcomes.T
    errors, answered = value - truth, np.isfinite(value)
    off = np.where(np.isfinite(truth), np.abs(errors), np.inf)
    covered = holds(low, high, truth)
    ok, suspect, rejected = (verdict == VERDICTS.index(name) for name in VERDICTS)
    return {
        "targets": len(outcomes),
        "answered": float(answered.mean()),
        "ok": float(ok.mean()),
        "suspect": float(suspect.mean()),
        "rejected": float(rejected.mean()),
        # fraction of all that are ok and off by more than `WRONG`, or have no bounce at all
        "wrong": float(np.mean(ok & (off > WRONG))),
        "mae": figure(np.abs(errors)),
        "median": figure(np.abs(errors), np.median),
        "p95": figure(np.abs(errors), lambda known: np.percentile(known, 95)),
        "bias": figure(errors),  # positive where the values are too high
        "covered": figure(covered),  # of the intervals, be they shown or not
        # of the answered, whose interval the tuning shows; of these, which hold the truth
        "shown": figure((np.isfinite(covered) & (is_shown > 0))[answered]),
        "shown_covered": figure(covered[is_shown > 0]),
        "width": figure((high - low)[np.isfinite(covered)], np.median),
    }


# ---- Tables for a terminal.


def clip_table(rows: Sequence[Row]) -> str:
    """Tabulate how many clips were answered, the errors, and the track's accuracy."""
    answered = [row for row in rows if row["estimate"] is not None]
    covered = [
        row["interval"][0] <= row["truth"] <= row["interval"][1]
        for row in answered
        if row["interval"] is not None
    ]
    tracked = [row["off_px"] for row in rows if row["off_px"] is not None]
    cells = [
        str(len(rows)),
        str(len(answered)),
        str(sum(row["verdict"] == "ok" for row in rows)),
        *_error_cells([abs(row["estimate"] - row["truth"]) for row in answered]),
        f"{sum(covered)} of {len(covered)}" if covered else "-",
        decimals(figure(tracked, np.median), 2),
    ]
    head = ["clips", "answered", "ok", "MAE", "median", "95 %", "worst", "held", "track, px"]
    return table([head, cells], "Drawn clips, as a stranger films them")


def home_table(rows: Sequence[Row]) -> str:
    """Tabulate clips as people film at home, by what is special of them."""
    kinds = [*dict.fromkeys(row["kind"] for row in rows), "all"]
    lines = [["", "clips", "answered", "ok", "wrong", "mean", "worst", "held"]]
    for kind in kinds:
        own = [row for row in rows if kind in (row["kind"], "all")]
        told = [row for row in own if row["estimate"] is not None]
        errors = [abs(row["estimate"] - row["truth"]) for row in told]
        wrong = [
            row["verdict"] == "ok" and error > _LITTLE and not _holds(row)
            for row, error in zip(told, errors, strict=True)
        ]
        shown_rows = [row for row in told if row["interval"] is not None]
        lines.append(
            [
                *(kind, str(len(own)), str(len(told))),
                *(str(sum(row["verdict"] == "ok" for row in own)), str(sum(wrong))),
                *(short(figure(errors)), short(figure(errors, np.max))),
                f"{sum(map(_holds, shown_rows))} of {len(shown_rows)}",
            ]
        )
    return table(
        lines,
        f"Clips as people film at home; wrong: ok, outside the interval, over {_LITTLE:g} off",
    )


_LITTLE = 0.01  # of restitution: an `ok` is wrong that is farther off, and outside its interval


def _holds(row: Row) -> bool:
    low, high = row["interval"] or (0.0, 1.0)
    return bool(low <= row["truth"] <= high)


def transformed_table(rows: Sequence[Row]) -> str:
    """Tabulate how much the estimate depends on transforms that leave the ball unchanged."""
    whole = sum(None not in row["estimates"] for row in rows)
    spreads = [row["spread"] for row in rows if row["spread"] is not None]
    cells = [str(len(rows)), str(whole), "", *_error_cells(spreads)]
    return table(
        [["clips", "answered", "", "mean", "median", "95 %", "worst"], cells],
        f"Spread of the answers for one clip: {', '.join(films.VERSIONS)}",
    )


def _error_cells(errors: Sequence[float]) -> list[str]:
    """Format mean, median, 95th percentile and maximum of errors; dashes for none."""
    p95 = figure(errors, lambda known: np.quantile(known, 0.95))
    return [
        short(one)
        for one in (figure(errors), figure(errors, np.median), p95, figure(errors, np.max))
    ]


def section_table(section: Section, rows: Sequence[Row]) -> str:
    """Tabulate one line for each kind of track."""
    columns = (
        _BAD if section is BAD else (*_VERDICTS, *((_BIAS,) if section is DRAG else ()), *_ERRORS)
    )
    return table(shown(columns, rows), section.title)


def overall(outcomes: Sequence[Array]) -> str:
    """Describe coverage and width over all good tracks, and the worst line's coverage."""
    figures = figures_of(np.concatenate(outcomes))
    text = f"A, B and C: {figures['targets']} tracks, {percent(figures['rejected'])} % rejected."
    covered = [one["covered"] for one in map(figures_of, outcomes) if one["covered"] is not None]
    if covered:
        text += (
            f"\n95 % intervals: {percent(figures['covered'])} % contain the truth, in the worst "
            f"line {percent(min(covered))} %; median width {short(figures['width'])}."
            f"\n{percent(figures['shown'])} % of the answers show theirs; of these "
            f"{percent(figures['shown_covered'])} % do."
        )
    return text


def _signed(error: float | None) -> str:
    return "-" if error is None else ("-" if error < 0 else "+") + short(abs(error))


_LABEL = ("", lambda row: row["tracks"])
_TARGETS = ("tracks", lambda row: str(row["targets"]))
_REJECTED = ("rejected", lambda row: percent(row["rejected"]))
_SUSPECT = ("suspect", lambda row: percent(row["suspect"]))
_VERDICTS: Columns = (
    _LABEL,
    _TARGETS,
    ("answered", lambda row: percent(row["answered"])),
    _REJECTED,
    _SUSPECT,
)
_BIAS = ("bias", lambda row: _signed(row["bias"]))
_ERRORS: Columns = (
    ("mean", lambda row: short(row["mae"])),
    ("median", lambda row: short(row["median"])),
    ("95th", lambda row: short(row["p95"])),
    ("held", lambda row: percent(row["covered"])),
    ("width", lambda row: short(row["width"])),
)
_BAD: Columns = (
    _LABEL,
    _TARGETS,
    ("ok", lambda row: percent(row["ok"])),
    (f"ok, off by > {WRONG:g}", lambda row: percent(row["wrong"])),
    _REJECTED,
    _SUSPECT,
)
