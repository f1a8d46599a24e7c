"""Tune files as laboratories export them, logs in other units than they say, and stored films.

    python -m tests.bench.lab layouts --count 400 --seed 5
    python -m tests.bench.lab units --count 400 --seed 7
    python -m tests.bench.lab films

A drop is stepped by the evaluation's own world: air, a restitution that falls with speed, sideways
drift, .4 to 2 m, 60 to 360 Hz, .2 to 2 mm of noise.

Layouts: up to 30 % of the samples are missing, in a third of the drops in gaps too. The drop is
written in a layout with a unit, an orientation and other choices at random, and as a plain table.
The layout's value has to be the table's within a tenth of the table's 95 % interval; it is wrong if
it is more than three half widths of its own interval from the truth. Of one drop in 20 the layout
holds other bodies too, that stand still or are waved by hand, with the ball and without it.

Units: the drop as poses, whose message names metres, or as a table `t,x,y,z`, which names nothing,
in another unit, clock or orientation. Failures are a value that is neither within its interval nor
within .01 of the truth; `units` that are neither right nor null; a unit that contradicts the log's
word without a verdict `suspect` that names it; and an `ok` whose impact speed is over 5 % off.

Films: one rendered drop stored in 36 ways beside the log of the camera's own JPEGs. All of them
should be "ok" and within that one's interval, but two, which deserve doubt: pictures of 160 x 120
px, and a file in which six of a hundred pictures are there twice.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import av
import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from tests import export_writers as capture
from tests import export_writers_arrays as arrays
from tests import export_writers_video as video
from tests.strangers import write_poses
from tunenet_logs.analysis.evaluation.study import Order, Row, figure, listed, scored
from tunenet_logs.analysis.evaluation.worlds.ball import RealBall, fallen
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.record import to_json
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.session import record_episode
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop
from tunenet_logs.terminal import Progress

# ---- A drop as a laboratory sees it.

_AFTER_S, _MAX_S = 0.6, 7.0  # how long a ball is seen at rest, and how long a recording is at most


@dataclass(frozen=True, eq=False)
class LabDrop:
    """Drop and its truth."""

    restitution: float  # at the first impact
    impact_speed_m_s: float  # of the first impact, downward
    rate_hz: float  # of the samples
    seconds: Array  # of the samples, from 0, shape (T,)
    xyz_m: Array  # seen places, z up, with noise, NaN where the ball was not seen, shape (T, 3)

    @property
    def samples(self) -> tuple[Array, Array]:
        """Times and places of the samples that were seen."""
        seen = np.isfinite(self.xyz_m[:, 2])
        return self.seconds[seen], self.xyz_m[seen]


def random_drop(
    rng: np.random.Generator, *, most_unseen: float = 0.3, with_gaps: bool = False
) -> LabDrop:
    """Draw a ball held, let go, bouncing, and at rest if there is time.

    Up to `most_unseen` of the samples are missing; with gaps, half of them in gaps of 20 to 150 ms.
    """
    restitution, slope = float(rng.uniform(0.4, 0.93)), float(rng.uniform(0.0, 0.12))
    drag_1_m, drop_m = float(rng.uniform(0.0, 0.15)), float(rng.uniform(0.4, 2.0))
    heading, drift_m_s = rng.uniform(0, 2 * np.pi), rng.uniform(0.0, 0.3)
    held_s = float(rng.uniform(0.3, 1.2))
    rate_hz = float(rng.choice([60, 100, 120, 150, 200, 240, 250, 300, 360]))
    path = fallen(RealBall(restitution, slope, drag_1_m, drop_m).values[None], _MAX_S)
    rest_s = min(float(path.rests_s[0]), _MAX_S)
    seconds = np.arange(round((held_s + _MAX_S) * rate_hz)) / rate_hz
    seconds = seconds[seconds <= held_s + rest_s + _AFTER_S]
    since_s = seconds - held_s
    heights_m = path.at(since_s[None])[0]
    fallen_m = np.abs(np.diff(heights_m, prepend=drop_m)).cumsum()  # drag is along the way
    speed_m_s = drift_m_s * np.exp(-drag_1_m * fallen_m) * ((since_s > 0) & (since_s < rest_s))
    went_m = speed_m_s.cumsum() / rate_hz
    places = np.column_stack([went_m * np.cos(heading), went_m * np.sin(heading), heights_m])
    places += rng.uniform([-1, -1, -0.5], [1, 1, 1.0])
    places += rng.normal(0.0, rng.uniform(0.0002, 0.002), places.shape)
    share = float(rng.uniform(0.0, most_unseen))
    missing = rng.random(len(seconds)) < (share / 2 if with_gaps else share)
    while with_gaps and missing.mean() < share:
        begin = int(rng.integers(1, len(seconds) - 1))
        missing[begin : begin + max(1, round(rng.uniform(0.02, 0.15) * rate_hz))] = True
    missing[[0, -1]] = False
    places[missing] = np.nan
    hits_m_s = float(path.impact_speeds_m_s[0, 0])
    return LabDrop(restitution, hits_m_s, rate_hz, seconds, places)


def hand_waved(rng: np.random.Generator, seconds: Array) -> Array:
    """Draw the motion of a hand: smooth, never falling freely [m], shape (T, 3)."""
    places = np.tile(rng.uniform(-1, 1, 3), (len(seconds), 1))
    for hertz in rng.uniform(0.15, 1.1, 4):
        swing, phase = rng.uniform(0.01, 0.12, 3), rng.uniform(0, 2 * np.pi, 3)
        places += swing * np.sin(2 * np.pi * hertz * seconds[:, None] + phase)
    return places + rng.normal(0.0, 0.0005, places.shape)


def write_table(path: Path, heads: str, seconds: Array, places: Array, form: str) -> None:
    """Write a plain table."""
    rows = zip(seconds, places, strict=True)
    lines = [f"{time:.9f}," + ",".join(f"{one:{form}}" for one in place) for time, place in rows]
    path.write_text("\n".join([heads, *lines]) + "\n")


def tuned(source: Path | Episode) -> Tuning:
    """Tune a log; an error that is no one's fault but the tuner's is a finding too."""
    try:
        if isinstance(source, Episode):
            return tune_episode(source, TuneOptions())
        return tune_log(source, TuneOptions())
    except Exception as error:  # noqa: BLE001 - whatever it is, it is counted and named
        words = f"CRASH: {type(error).__name__}: {error}"
        return Tuning(Path("made"), None, "default", "rejected", words)


# ---- Layouts that motion capture, trackers, sensors and programs export.


LAYOUTS = (*capture.WRITERS, *video.WRITERS, *arrays.WRITERS)
OF_BODIES = tuple(
    name
    for name in LAYOUTS
    if name not in arrays.WRITERS and name not in ("tracker.txt", "imagej_results.csv")
)
_COUNTING = ("mtrack2.txt", "manual_tracking.xls", "imagej_results.csv")  # frames, and no rate


def write_layout(
    layout: str,
    rng: np.random.Generator,
    drop: LabDrop,
    folder: Path,
    bodies: Mapping[str, Array] | None = None,
) -> tuple[Path, str, bool]:
    """Write the drop in one of `LAYOUTS`, its unit, orientation and other choices drawn.

    Returns the file, the choices, and whether a reader can know metres and seconds, from names or
    from gravity.
    """
    path, bodies = folder / layout, bodies or {"A": drop.xyz_m}

    def choice(*of: Any) -> str:
        return str(rng.choice(of))

    if layout in capture.WRITERS:  # QTM names no unit
        path = folder / f"{layout}{capture.SUFFIXES[layout]}"
        units = {"nexus": ("mm",), "qualisys": ("mm",), "c3d": ("mm", "m")}
        unit = choice(*units.get(layout, ("m", "mm", "cm")))
        up = choice("z", "y", "x", "-z", "-y")
        more: dict[str, object] = {}
        if layout == "motive":
            unit = choice("m", "cm", "mm", "in", "ft")
            more["version"] = choice("1.21", "1.23", "1.25")
        elif layout == "qualisys":
            more["unseen"] = choice("", "0.000", "NULL")
        elif layout == "trc":
            more["separator"] = choice("\t", ",")
        elif layout == "c3d":
            more["processor"] = choice("intel", "dec", "mips")
            more["is_float"] = bool(rng.random() < 0.7)
            more["analogs"] = int(rng.choice([0, 6]))
        write = capture.WRITERS[layout]
        write(path, drop.seconds, bodies, rate_hz=drop.rate_hz, unit=unit, up=up, **more)
        return path, f"{unit}, {up} up, {more}", True
    if layout in video.WRITERS:  # calibrated or in pixels
        names = {1.0: "m", 100.0: "cm", 1000.0: "mm"}
        is_scaled = bool(rng.random() < 0.6)
        scale = float(rng.choice(list(names)) if is_scaled else rng.uniform(150.0, 3000.0))
        is_y_down = bool(rng.random() < 0.5)
        separator, decimal = (",", ".") if rng.random() < 0.6 else (";", ",")
        origin = (float(rng.uniform(0.0, 500.0)), float(rng.uniform(0.0, 500.0)))
        unit = names.get(scale, "pixel")
        how = (scale, is_y_down, origin, drop.rate_hz, unit, separator, decimal)
        track = video.FilmedTrack(drop.seconds, bodies, *how)
        video.WRITERS[layout](path, track)
        return path, str(how), is_scaled and layout not in _COUNTING
    unit, up = choice("m", "cm", "mm"), choice("z", "-z", "y", "x")
    if layout in ("pasco.csv", "vernier.csv"):
        up = "z"
    xyz = capture.oriented(next(iter(bodies.values())), up)
    arrays.WRITERS[layout](path, drop.seconds, xyz, unit)
    return path, f"{unit}, {up} up", True


_FILE_SEEDS = 23_000_000  # drops are drawn from these and a seed: nothing was chosen on them
# Share of an interval's width that is the same, half widths that are wrong, and the width that is
# taken where a value has no interval.
_SAME, _WRONG, _TYPICAL = 0.1, 3.0, 0.02
_BODIES_EVERY = 20
_ANOTHER = 0.05  # distance from the truth from which on it was not the ball that was looked at


def layout_rows(case: tuple[int, int]) -> list[Row]:
    """Tune one drop of a seed in one layout and as a plain table, and now and then bodies."""
    seed, index = case
    rng = np.random.default_rng([_FILE_SEEDS, seed, index])
    layout, most = LAYOUTS[index % len(LAYOUTS)], float(rng.choice([0.02, 0.3]))
    drop = random_drop(rng, most_unseen=most, with_gaps=bool(rng.random() < 1 / 3))
    with tempfile.TemporaryDirectory() as folder:
        path, how, tells_metres = write_layout(layout, rng, drop, Path(folder))
        write_table(Path(folder) / "plain.csv", "t [s],x [m],y [m],z [m]", *drop.samples, ".9f")
        found, plain = tuned(path), tuned(Path(folder) / "plain.csv")
    value, usual = _value(found), _value(plain)
    apart, off = abs(value - usual) / _width(plain), _half_widths_off(found, drop)
    truth, why = drop.restitution, found.reason or ""
    is_lost = np.isnan(value) and (not np.isnan(usual) or "CRASH" in why)
    is_other = apart > _SAME and tells_metres
    is_less = (found.verdict, plain.verdict) == ("suspect", "ok")
    checks = (
        (found.verdict == "ok" and off > _WRONG, f"WRONG and ok: {value:.4f}, not {truth:.4f}"),
        (is_lost, f"rejected: {why}"),
        (is_other, f"{value:.4f}, not {usual:.4f} as the table: {apart:.2f} widths"),
        (is_less, f"suspect, the table is ok: {why}"),
    )
    kind = layout if tells_metres else f"{layout} (no metres or no rate)"
    row = _row(kind, f"drop {index}: {how}", found, checks, plain=plain.verdict, apart=apart)
    if index % _BODIES_EVERY:
        return [row]
    return [row, *_of_bodies(seed, index // _BODIES_EVERY)]


def _of_bodies(seed: int, index: int) -> list[Row]:
    """Tune bodies of which one is a ball or none is."""
    rng = np.random.default_rng([_FILE_SEEDS, seed, index, 1])
    drop = random_drop(rng)
    layout = OF_BODIES[index % len(OF_BODIES)]
    waved = hand_waved(rng, drop.seconds)
    stands = rng.uniform(-1, 1, 3) + rng.normal(0.0, 0.0005, (len(drop.seconds), 3))
    others = [waved, stands, hand_waved(rng, drop.seconds)]
    rows: list[Row] = []
    for what, places in (("with a ball", [*others[1:], drop.xyz_m]), ("without a ball", others)):
        order = rng.permutation(len(places))
        bodies = {"ABC"[at]: places[number] for at, number in enumerate(order)}
        with tempfile.TemporaryDirectory() as folder:
            path, how, _ = write_layout(layout, rng, drop, Path(folder), bodies)
            found = tuned(path)
        value, truth, why = _value(found), drop.restitution, found.reason or ""
        is_it = _half_widths_off(found, drop) < _WRONG and abs(value - truth) < _ANOTHER
        is_missed = why.startswith("CRASH") or (what == "with a ball" and not is_it)
        is_wrong = what == "without a ball" and found.verdict == "ok"
        checks = (
            (is_missed, f"{value:.4f}, made with {truth:.4f}: {why}"),
            (is_wrong, f"WRONG and ok: {value:.4f}, no ball"),
        )
        where = f"drop {index}, {layout}: {how}"
        rows.append(_row(f"bodies, {what}", where, found, checks, plain="", apart=np.nan))
    return rows


def _row(
    kind: str, where: str, tuning: Tuning, checks: Sequence[tuple[Any, str]], **figures: Any
) -> Row:
    """Return a log's row, with what is wrong in words."""
    failures = [words for is_so, words in checks if is_so]
    return {"kind": kind, "where": where, "verdict": tuning.verdict, "failures": failures} | figures


def _value(tuning: Tuning) -> float:
    return np.nan if tuning.estimate is None else float(tuning.estimate[0])


def _width(tuning: Tuning) -> float:
    """Return the width of a fit's 95 % interval, reported or not."""
    fit = tuning.trace.fit if tuning.trace else None
    return float(np.ptp(fit.interval95[0])) if fit else _TYPICAL


def _half_widths_off(tuning: Tuning, drop: LabDrop) -> float:
    return abs(_value(tuning) - drop.restitution) / (_width(tuning) / 2)


# ---- Units, clocks and orientations.


_UNIT_SEEDS = 29_000_000  # likewise
# How far a value may be off, and by which fraction a speed, a unit of length and a rate.
_NEAR, _SPEED, _LENGTH, _RATE = 0.01, 0.05, 0.01, 0.02
_FILE_EVERY = 8  # logs of poses of which one goes through a file


class Kind(NamedTuple):
    """Kind of modification of a log."""

    length_m: float | None = 1.0  # metres in one of its units; None for pixels of a drawn scale
    named: tuple[str, ...] = ()  # what the reason of poses has to say, one of these
    clock: float = 1.0  # seconds of the log for each true one
    up: str = "z"  # which axis is up, see `oriented`
    tilt_deg: float = 0.0  # of a table's or camera's frame off the vertical


_LENGTHS = {unit: Kind(capture.UNITS_M[unit], (f"in {unit}",)) for unit in ("mm", "cm", "ft", "in")}
KINDS: Mapping[str, Kind] = {
    "m": Kind(),
    **_LENGTHS,
    "px": Kind(None, ("pixels", "lengths are in")),
    "ms for s": Kind(named=("stamps are in ms",), clock=1000.0),
    "z down": Kind(up="-z"),
    "y up": Kind(up="y"),
    "25 degrees": Kind(tilt_deg=25.0),
    **{f"{slower} times slow": Kind(named=("clock",), clock=slower) for slower in (2, 4, 8)},
}
NAMES = [(what, name) for what in ("poses", "table") for name in KINDS]


def unit_rows(case: tuple[int, int]) -> list[Row]:
    """Tune one log of a seed."""
    seed, index = case
    what, name = NAMES[index % len(NAMES)]
    kind, rng = KINDS[name], np.random.default_rng([_UNIT_SEEDS, seed, index])
    drop = random_drop(rng, most_unseen=0.02)
    length_m = kind.length_m or 1 / float(np.exp(rng.uniform(np.log(150), np.log(3000))))
    seconds, places = drop.samples
    places = capture.oriented(places, kind.up)
    if kind.tilt_deg:  # about a random horizontal axis
        heading, tilt = rng.uniform(0, 2 * np.pi), np.radians(kind.tilt_deg)
        axis = tilt * np.array([np.cos(heading), np.sin(heading), 0.0])
        places = Rotation.from_rotvec(axis).apply(places)
    if kind.length_m is None:
        places = places + rng.uniform(0.0, 1.0, 3)
    stamps_ns, places = np.round(seconds * kind.clock * 1e9).astype(np.int64), places / length_m
    with tempfile.TemporaryDirectory() as folder:
        source: Path | Episode = Path(folder) / ("log.csv" if what == "table" else "log.mcap")
        if what == "table":
            write_table(source, "t,x,y,z", stamps_ns / 1e9, places, ".9g")
        elif index // len(NAMES) % _FILE_EVERY == 0:
            write_poses(source, stamps_ns + 1_700_000_000_000_000_000, places)
        else:
            signal = Signal("/ball/pose", stamps_ns, places, ("x", "y", "z"), "m")
            source = Episode(EpisodeInfo(), {signal.name: signal})
        tuning = tuned(source)
    where, truth, why = f"log {index}", drop.restitution, tuning.reason or ""
    figures: Row = dict.fromkeys(("off", "held", "speed_off"), np.nan)
    if tuning.estimate is None:
        return [_row(f"{what}, {name}", where, tuning, [(True, f"rejected: {why}")], **figures)]
    told = json.loads(to_json(record_of(tuning)))
    value, ends = (told["parameters"]["restitution"][one] for one in ("value", "interval95"))
    figures["off"] = abs(value - truth)
    figures["held"] = np.nan if ends is None else float(ends[0] <= truth <= ends[1])
    speeds = [one["impact_speed"] for one in told["bounces"][:1]]
    if speeds not in ([], [None]):
        figures["speed_off"] = speeds[0] / drop.impact_speed_m_s - 1
    is_ok, fast = tuning.verdict == "ok", figures["speed_off"]
    wanted = kind.named if what == "poses" else ()
    is_named = tuning.verdict == "suspect" and any(word in why for word in wanted)
    units = told["units"] if is_ok and told["units"] else {"length_m": None, "rate_hz": None}
    told_m, told_hz = units["length_m"], units["rate_hz"]
    true_hz = drop.rate_hz / (1 if kind.clock >= 1000 else kind.clock)
    is_other_m = told_m is not None and abs(told_m / length_m - 1) > _LENGTH
    is_other_hz = told_hz is not None and all(
        abs(told_hz / one - 1) >= _RATE for one in (drop.rate_hz, true_hz)
    )
    is_off = figures["off"] > _NEAR and figures["held"] != 1
    checks = (
        (is_off, f"value {value:.4f}, made with {truth:.4f} ({tuning.verdict})"),
        (is_ok and abs(fast) > _SPEED, f"WRONG SPEED and ok: {fast:+.0%}"),
        (wanted and not is_named, f"{tuning.verdict}, and no word of {wanted[:1]}: {why[:150]}"),
        (is_other_m, f"WRONG UNIT and ok: {told_m} m, not {length_m:g}"),
        (is_other_hz, f"WRONG RATE and ok: {told_hz} Hz, not {drop.rate_hz:g}"),
    )
    return [_row(f"{what}, {name}", where, tuning, checks, **figures)]


# ---- One drop, filmed and stored in many ways.

Pictures = Sequence[NDArray[np.uint8]]  # RGB, each of shape (H, W, 3)
TICKS_HZ = 90_000  # of containers that can count so finely
RATE_HZ = 60  # of all ways that say nothing else: every fourth picture of the drop


def write_video(
    path: Path,
    pictures: Iterable[NDArray[np.uint8]],
    codec: str,
    rate_hz: int,
    *,
    pixels: str = "yuv420p",
    container: str | None = None,
    ticks: Sequence[int] | None = None,
    rotated_deg: int = 0,
    options: Mapping[str, str] | None = None,
) -> None:
    """Write a video file; codec, pixels, container and options are as FFmpeg calls them.

    `ticks` are the pictures' stamps [1/90000 s], even ones if None; `rotated_deg` is by how much a
    player is to turn what is stored.
    """
    av.logging.set_level(None)  # pyright: ignore[reportPrivateImportUsage]
    base = Fraction(1, rate_hz) if ticks is None else Fraction(1, TICKS_HZ)
    with av.open(str(path), "w", format=container) as file:
        stream: Any = file.add_stream(codec, rate=rate_hz, options=dict(options or {}))
        stream.pix_fmt, stream.codec_context.time_base = pixels, base
        if rotated_deg:
            stream.set_display_rotation(rotated_deg)
        for number, picture in enumerate(pictures):
            if number == 0:
                stream.height, stream.width = picture.shape[:2]
            frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="rgb24")
            frame.pts = number if ticks is None else ticks[number]
            frame.time_base = base
            file.mux(stream.encode(frame))
        file.mux(stream.encode())


def write_trimmed(path: Path, pictures: Pictures, hidden_s: float) -> None:
    """Write a video whose start an edit list hides, as phones trim.

    The file begins at the last picture that needs no other before the cut.
    """
    write_video(path.with_name("whole.mp4"), pictures, "libx264", RATE_HZ, options={"g": "30"})
    with (
        av.open(str(path.with_name("whole.mp4"))) as whole,
        av.open(str(path), "w", options={"avoid_negative_ts": "disabled"}) as cut,
    ):
        stream = cut.add_stream_from_template(whole.streams.video[0])
        packets: list[Any] = [one for one in whole.demux(video=0) if one.size]
        shift = round(hidden_s / packets[0].time_base)
        keys = [at for at, one in enumerate(packets) if one.is_keyframe and one.pts <= shift]
        for packet in packets[keys[-1] :]:
            packet.pts, packet.dts = packet.pts - shift, packet.dts - shift
            packet.stream = stream
            cut.mux(packet)


def write_ended(path: Path, pictures: Pictures, length_s: float) -> None:
    """Write the packets of a video's first seconds, in the order in which they are stored."""
    write_video(path.with_name("whole.mp4"), pictures, "libx264", RATE_HZ)
    with av.open(str(path.with_name("whole.mp4"))) as whole, av.open(str(path), "w") as cut:
        stream = cut.add_stream_from_template(whole.streams.video[0])
        packets: Iterator[Any] = whole.demux(video=0)
        for packet in packets:
            if packet.size and packet.dts * packet.time_base <= length_s:
                packet.stream = stream
                cut.mux(packet)


def write_files(path: Path, pictures: Pictures, suffix: str, *, sixteen: bool = False) -> None:
    """Write numbered pictures without leading zeros, in a folder or a zip.

    `sixteen` is grey of 12 bits in 16.
    """
    zipped = path.suffix == ".zip"
    if not zipped:
        path.mkdir()
    for number, picture in enumerate(pictures):
        stored: Any = picture[:, :, ::-1]
        if sixteen:
            stored = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint16) << 4
        data = cv2.imencode(suffix, stored)[1].tobytes()
        if zipped:
            with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
                archive.writestr(f"drop/img{number}{suffix}", data)
        else:
            (path / f"img{number}{suffix}").write_bytes(data)


def write_animation(path: Path, pictures: Pictures, rate_hz: int, tick_ms: int = 1) -> None:
    """Write a WebP or GIF of several pictures, times rounded to `tick_ms`."""
    animation: Any = cv2.Animation()
    ticks = np.round(np.arange(len(pictures) + 1) * 1000 / rate_hz / tick_ms).astype(int) * tick_ms
    animation.durations = np.diff(ticks).tolist()
    animation.frames = [picture[:, :, ::-1] for picture in pictures]
    if not cv2.imwriteanimation(str(path), animation, [cv2.IMWRITE_WEBP_QUALITY, 90]):
        raise RuntimeError(f"{path} cannot be written")


FILMED_HZ = 240
ORDER = DropOrder(restitution=0.7, height_m=1.0, seconds=1.7, hold_s=0.3, rate_hz=FILMED_HZ, seed=5)
FILM = FilmOrder(size_px=(640, 480), exposure_s=0.002)
DOUBTFUL = ("160 x 120", "six of a hundred twice")  # ways that need not be "ok"


class Way(NamedTuple):
    """Way to store a drop."""

    name: str  # of the file; its suffix is part of what is tried
    store: Callable[[Path], None]  # writes it
    rate_hz: float | None = None  # what a user says of it, as `--fps`; None for nothing


def at_rate(episode: Episode, rate_hz: float) -> Episode:
    """Subsample the episode as a slower camera would have filmed it."""
    frames = list(episode.frames())[:: round(FILMED_HZ / rate_hz)]
    stamps_ns = np.array([one.stamp_ns for one in frames], np.int64)
    channel = replace(episode.channels[0], log_ns=stamps_ns)
    return replace(episode, channels=(channel,), open_frames=lambda _topic: iter(frames))


def ways(episode: Episode) -> dict[str, Way]:
    """Return all ways but the log, by name."""

    def filmed(rate_hz: int) -> Pictures:
        return [frame.decode() for frame in at_rate(episode, rate_hz).frames()]

    usual = filmed(RATE_HZ)
    count = len(usual)

    def video(
        suffix: str,
        codec: str = "libx264",
        pixels: str = "yuv420p",
        pictures: Pictures = usual,
        rate_hz: int = RATE_HZ,
        said_hz: float | None = None,
        **more: Any,
    ) -> Way:
        write = partial(write_video, pictures=pictures, codec=codec, rate_hz=rate_hz)
        return Way(f"a.{suffix}", partial(write, pixels=pixels, **more), said_hz)

    def at(rate_hz: int, plays_hz: int, said_hz: float | None = None) -> Way:
        def store(path: Path) -> None:  # 240 pictures a second are many: decoded when needed
            write_video(path, filmed(rate_hz), "libx264", plays_hz)

        return Way("a.mp4", store, said_hz)

    def files(name: str, suffix: str, said_hz: float | None = RATE_HZ, **more: Any) -> Way:
        return Way(name, partial(write_files, pictures=usual, suffix=suffix, **more), said_hz)

    quiet = {"x265-params": "log-level=none"}
    fast = {"b": "3M", "deadline": "realtime"}
    kept = np.sort(np.random.default_rng(1).choice(count, round(0.8 * count), replace=False))
    raised = np.floor(np.arange(round(count * 1.06)) / 1.06).astype(int)
    small = [
        np.asarray(cv2.resize(one, (160, 120), interpolation=cv2.INTER_AREA), np.uint8)
        for one in usual
    ]
    turned = [np.asarray(np.rot90(one)) for one in usual]
    animated = partial(write_animation, pictures=usual, rate_hz=RATE_HZ)
    return {
        "H.264, mp4": video("mp4"),
        "H.264 without B-frames, mov": video("mov", options={"bf": "0"}),
        "H.264, transport stream": video("ts"),
        "H.264, strongly compressed, 3gp": video("3gp", options={"crf": "32"}),
        "H.264 4:2:2, 10 bits, mkv": video("mkv", pixels="yuv422p10le"),
        "H.264 grey, mp4": video("mp4", pixels="gray"),
        "H.265, mp4": video("mp4", "libx265", options=quiet),
        "VP8, webm": video("webm", "libvpx", options=fast),
        "VP9, webm": video("webm", "libvpx-vp9", options=fast),
        "AV1, mp4": video("mp4", "libsvtav1", options={"preset": "8"}),
        "MPEG-4, avi": video("avi", "mpeg4", options={"b": "4M"}),
        "Motion JPEG, avi": video("avi", "mjpeg", "yuvj420p", options={"qmin": "2", "qmax": "4"}),
        "ProRes, mov": video("mov", "prores_ks", "yuv422p10le"),
        "FFV1, mkv": video("mkv", "ffv1", "yuv444p"),
        "HuffYUV, avi": video("avi", "huffyuv", "rgb24"),
        "uncompressed, avi": video("avi", "rawvideo", "bgr24"),
        "uncompressed, y4m": video("y4m", "wrapped_avframe"),
        # streams that no container holds
        "H.264, bare": video("h264", container="h264", said_hz=RATE_HZ),
        "H.265, bare": video("h265", "libx265", container="hevc", options=quiet, said_hz=RATE_HZ),
        "Motion JPEG, bare": video(
            "mjpeg", "mjpeg", "yuvj420p", container="mjpeg", said_hz=RATE_HZ
        ),
        "24 pictures a second": at(24, 24),
        "30 pictures a second": at(30, 30),
        "240 pictures a second": at(240, 240),
        "slow motion, 240 played at 30": at(240, 30, 240),
        "uneven, a fifth left out": video(
            "mp4",
            pictures=[usual[number] for number in kept],
            ticks=[int(number) * TICKS_HZ // RATE_HZ for number in kept],
        ),
        DOUBTFUL[1]: video("mp4", pictures=[usual[number] for number in raised], rate_hz=64),
        DOUBTFUL[0]: video("mp4", pictures=small),
        # what phones do to a film
        "turned by a tag": video("mov", pictures=turned, rotated_deg=-90),
        "start hidden by an edit list": Way(
            "a.mp4", partial(write_trimmed, pictures=usual, hidden_s=0.2)
        ),
        "cut at the end": Way("a.mp4", partial(write_ended, pictures=usual, length_s=1.5)),
        "folder of PNG": files("a", ".png"),
        "folder of JPEG, no rate said": files("a", ".jpg", None),
        "folder of TIFF, 12 bits in 16": files("a", ".tiff", sixteen=True),
        "zip of PNG": files("a.zip", ".png"),
        "animated WebP": Way("a.webp", animated),
        "GIF": Way("a.gif", partial(animated, tick_ms=10)),
    }


def film_rows(only: str) -> tuple[list[Row], str]:
    """Tune to the drop stored in all ways whose names hold a word; return rows and a title."""
    episode = film_drop(ORDER, FILM)  # at 240 pictures a second, kept in memory
    frames = list(episode.frames())
    episode = replace(episode, open_frames=lambda _topic: iter(frames))
    quiet, every = Progress(quiet=True), ways(episode)
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "a.mcap"
        record_episode(at_rate(episode, RATE_HZ), log, overwrite=False, progress=quiet)
        reference = tune_log(log, TuneOptions())
    assert reference.interval95 is not None, reference.reason
    low, high = reference.interval95[0]
    tunings = {"log of JPEGs": reference}
    asked = {name: way for name, way in every.items() if only in name}
    with Progress().bar(len(asked), "tuning", "way") as bar:
        for name, way in asked.items():
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / way.name
                way.store(path)
                tunings[name] = tune_log(path, TuneOptions(fps=way.rate_hz))
            bar.update(1)
    rows: list[Row] = []
    for name, tuning in tunings.items():
        value, is_good = _value(tuning), tuning.verdict == "ok" or name in DOUBTFUL
        rows.append({
            "way": name,
            "verdict": tuning.verdict,
            "value": value,
            "off": value - _value(reference),
            "promised": bool(low <= value <= high and is_good),
            "reason": tuning.reason or "",
        })  # fmt: skip
    right = sum(row["promised"] for row in rows)
    said = f"the log says {low:.4f} to {high:.4f}; {right} of {len(rows)} as promised"
    return rows, f"truth {ORDER.restitution}; {said}"


# ---- Tables.


def line_of(kind: str, rows: Sequence[Row]) -> Row:
    """Count the verdicts of a kind, and compute its figures."""

    def said(word: str) -> int:
        return sum(any(word in words for words in one["failures"]) for one in rows)

    line = {"kind": kind, "logs": len(rows)}
    line |= {
        verdict: sum(one["verdict"] == verdict for one in rows)
        for verdict in ("ok", "suspect", "rejected")
    }
    if "plain" in rows[0]:
        apart = [one["apart"] for one in rows]
        line["table_ok"] = sum(one["plain"] == "ok" for one in rows)
        line |= {"apart": figure(apart, np.median), "worst": figure(apart, np.max)}
        return {**line, "wrong_and_ok": said("WRONG")}
    off, speeds = ([one[name] for one in rows] for name in ("off", "speed_off"))
    line |= {"mean": figure(off), "worst": figure(off, np.max)}
    line |= {"held": figure([one["held"] for one in rows])}
    line |= {"speed_told": int(np.isfinite(speeds).sum()), "wrong_speed": said("WRONG SPEED")}
    return {**line, "wrong_unit": said("WRONG UNIT"), "failures": said("")}


def main() -> None:
    studies = {"layouts": layout_rows, "units": unit_rows}
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("what", choices=[*studies, "films"])
    parser.add_argument("--count", type=int, default=400, help="drops or logs")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="", help="this drop or log, or films whose name holds it")
    arguments = parser.parse_args()
    if arguments.what == "films":
        print(listed(*film_rows(arguments.only)))
        return
    numbers = [int(arguments.only)] if arguments.only else range(arguments.count)
    cases = {"": [Piece((arguments.seed, number)) for number in numbers]}
    order, what = Order((arguments.seed,), arguments.count), ("tuning", "log")
    rows = scored(studies[arguments.what], cases, order, Progress(), what)[""]
    kinds: dict[str, list[Row]] = {}
    for row in sorted(rows, key=lambda row: row["kind"]):
        kinds.setdefault(row["kind"], []).append(row)
    print(listed([line_of(*one) for one in (*kinds.items(), ("all", rows))]))
    for row in rows:
        for words in row["failures"]:
            print(f"{row['kind']}; {row['where']}\n    {words}")


if __name__ == "__main__":
    main()
