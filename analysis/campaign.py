"""Read a campaign: drops, their tunings and what the hardware then did, linked into attempts.

Its files are sorted into logs, tunings and outcomes (`material_of`), linked into attempts
(`attempts_of`) and, with untuned drops tuned and images read, made a `Campaign` (`campaign_of`).
Rates and restitutions summarise it. `read_tunings` reads tunings alone.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import islice
from math import sqrt
from pathlib import Path
from typing import Literal

import numpy as np

from tunenet_logs.analysis.checks import Verdict
from tunenet_logs.analysis.compare import distinct
from tunenet_logs.analysis.parallel import Piece, parallel_map
from tunenet_logs.analysis.planning import (
    MAX_HEIGHT_M,
    MIN_HEIGHT_M,
    ExpectedShot,
    KnownBall,
    ball_of,
    expected_shot,
    told_ball,
)
from tunenet_logs.analysis.record import Curves, Estimate, Record, read_record
from tunenet_logs.episode import Picture
from tunenet_logs.errors import LogError, TuneNetError, UsageError
from tunenet_logs.files import real_path
from tunenet_logs.formats.registry import is_folder
from tunenet_logs.images import decode_image
from tunenet_logs.outcomes import (
    BOUNCE_SHOT,
    Outcome,
    Warn,
    holds_outcomes,
    numbered,
    read_outcomes,
)
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.shot import ShotRig, read_rig
from tunenet_logs.terminal import Progress, listed

# ---- Small film: a drop's images downsampled, and a strobe image of them.

WIDTH_PX = 160  # of the longer side: what a view in a corner of a review shows
RATE_HZ = 30.0  # pictures a second, at most: they play smoothly
_SLACK_S = 0.25 / RATE_HZ  # Stamps jitter: a picture that is early by so little counts as due


@dataclass(frozen=True)
class SmallFilm:
    """Downsampled images as JPEG."""

    start_ns: int  # origin of `seconds`
    seconds: tuple[float, ...]  # stamp of each image [s], increasing
    pictures: tuple[bytes, ...]  # in their order
    strobe: bytes  # the ball at many of those times, in one image
    size_px: tuple[int, int]  # (width, height) of each


def small_film(
    log: Path, start_ns: int | None, window_s: tuple[float, float] | None
) -> SmallFilm | None:
    """Downsample the images of a log; None if it has none that can be read."""
    try:
        episode = read_episode(log)
    except TuneNetError:
        return None
    if not episode.picture_topics:
        return None
    first_s, last_s = window_s or (float("-inf"), float("inf"))
    seconds: list[float] = []
    due_s = before_s = float("-inf")
    small: list[Picture] = []
    with suppress(LogError):  # what was read before the damage is shown
        for frame in episode.frames(episode.picture_topics[0]):
            start_ns = frame.stamp_ns if start_ns is None else start_ns
            at_s = (frame.stamp_ns - start_ns) * 1e-9
            # At most `RATE_HZ`: of two images the nearer one to what is due.
            slack_s, before_s = min(_SLACK_S, (at_s - before_s) / 2), at_s
            if at_s < due_s - slack_s or not first_s <= at_s <= last_s:
                continue
            with suppress(LogError):  # a damaged picture
                is_bare = frame.size is not None
                picture = (
                    frame.decode()
                    if is_bare
                    else decode_image(frame.data, frame.encoding, WIDTH_PX)
                )
                picture = np.ascontiguousarray(reduced(picture, WIDTH_PX)[..., ::-1])  # BGR
                if not small or picture.shape == small[0].shape:
                    due_s = max(due_s, at_s) + 1 / RATE_HZ
                    seconds.append(at_s)
                    small.append(picture)
            if len(small) >= 300:  # ten seconds at that rate: a drop is over by then
                break
    if not small or start_ns is None:
        return None
    height, width = small[0].shape[:2]
    pictures = tuple(_jpeg(one) for one in small)
    return SmallFilm(start_ns, tuple(seconds), pictures, _jpeg(strobe(small)), (width, height))


def reduced(picture: Picture, most_px: int) -> Picture:
    """Downsample an image to at most so many pixels on its longer side, shape (H, W, 3)."""
    import cv2

    height, width = picture.shape[:2]
    scale = min(1.0, most_px / max(width, height))
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), np.uint8)


def strobe(pictures: list[Picture]) -> Picture:
    """Compose a strobe image of moving objects over the static background, shape (H, W, 3).

    Each pixel is taken from the image in which it is furthest from its median.
    """
    # With more than 24, the ball would overlap itself.
    chosen = np.linspace(0, len(pictures) - 1, min(len(pictures), 24)).round().astype(int)
    stack = np.stack([pictures[index] for index in np.unique(chosen)])
    usual = np.median(stack, axis=0).astype(np.int16)
    off = np.abs(stack.astype(np.int16) - usual).sum(axis=3)
    rows, columns = np.indices(usual.shape[:2])
    return stack[off.argmax(axis=0), rows, columns]


def _jpeg(picture: Picture) -> bytes:
    import cv2

    # Of quality 75: small files, in which the ball is still clear.
    return cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, 75])[1].tobytes()


# ---- Tuned drop: one recorded drop, from the record of its tuning.

State = Literal["drop", "doubtful drop", "rejected drop"]
_FIRST_WALL_NS = 10**17  # stamps from 1973 on are a wall clock's; smaller ones count from a start
_STATES: Mapping[Verdict, State] = {
    "ok": "drop",
    "suspect": "doubtful drop",
    "rejected": "rejected drop",
}


@dataclass(frozen=True, eq=False)
class TunedDrop:
    """One recorded drop."""

    log: Path | None  # the recording; None if only its tuning is there
    tuning: Path | None  # the JSON; None if it was tuned here and now
    name: str  # of the log
    ball: str  # as it was named when recording; "" if it was not
    verdict: Verdict
    reason: str  # why the verdict is not "ok"
    value: float | None  # the coefficient of restitution; None for a rejected drop
    interval95: tuple[float, float] | None  # None if no valid one exists
    overlay: Curves | None  # the curves; None if no drop was found
    window_s: tuple[float, float] | None = None  # its first and last sample, since the log's first
    film: SmallFilm | None = None  # its images; None if it has none, or they were not read
    others: tuple[Estimate, ...] = ()  # other scalars: how the restitution falls with speed, drag
    impact_s: float | None = None  # its first impact, since the log's first sample
    known: KnownBall | None = None  # the ball to plan shots with; None for a rejected drop

    @property
    def state(self) -> State:
        """Verdict in the words of a campaign."""
        return _STATES[self.verdict]

    @property
    def wall_ns(self) -> int | None:
        """Time of recording [ns since 1970]; None if its clock is no wall clock."""
        known = self.overlay or self.film
        start_ns = known.start_ns if known is not None else 0
        return start_ns if start_ns > _FIRST_WALL_NS else None


def read_tuned_drop(tuning: Path) -> TunedDrop | None:
    """Read the drop of a tuning's JSON; None if the file is something else."""
    tuning.stat()  # a file that cannot be read is no file of something else
    try:
        record = read_record(tuning)
    except LogError:
        return None
    if record.task not in ("drop", None):
        return None
    name = Path(record.log).name
    log = tuning.parent / name
    is_beside = name not in ("", "..") and log.exists()
    return drop_of(record, log if is_beside else None, tuning)


def drop_of(record: Record, log: Path | None, tuning: Path | None) -> TunedDrop:
    """Build the drop of a record, with its log and its JSON if they exist."""
    restitution = record.estimate("restitution")
    value, ends = restitution and restitution.value, restitution and restitution.interval95
    window, scalars = record.window, (one for one in record.estimates if one.name != "restitution")
    known = None
    with suppress(ValueError):  # of a record with values that no ball has, no shot is drawn
        known = ball_of(record) if isinstance(value, float) else None
    return TunedDrop(
        log=log,
        tuning=tuning,
        name=record.log,
        ball=record.ball or "",
        verdict=record.verdict,
        reason=record.reason or "",
        value=value if isinstance(value, float) else None,
        interval95=ends,  # pyright: ignore[reportArgumentType] (one number has one interval)
        overlay=record.motion.curves,
        window_s=(window["start_s"], window["end_s"]) if window else None,
        others=tuple(one for one in scalars if isinstance(one.value, float)),
        impact_s=window.get("impact_s") if window else None,
        known=known,
    )


# ---- Files: sort them into logs of drops, tunings and outcomes.

# Suffixes of logs that are taken for a drop wherever they are found.
_LOGS = frozenset((".mcap", ".bag", ".db3", ".mp4", ".mov", ".mkv", ".avi", ".webm", ".m4v"))
# The same for a file that the user names: a table that merely lies in a folder may be anything.
_NAMED_LOGS = _LOGS | {".csv", ".tsv"}
_TABLES = frozenset((".csv", ".tsv", ".txt"))  # suffixes of what may be a table of outcomes
_RIGS = frozenset((".yaml", ".yml"))  # of a rig, where it is named or has "rig" in its name
# Of one folder: a campaign has hundreds; one with more is a home or a disk, named by mistake.
_MAX_FILES = 20_000
_MAX_ENTRIES = 100_000  # files and folders that are looked at: folders may hold no file


@dataclass(frozen=True)
class Material:
    """Contents of a campaign's files."""

    outcomes: tuple[Outcome, ...]  # sorted by time
    drops: tuple[TunedDrop, ...]  # tuned, sorted by name
    untuned: tuple[Path, ...]  # logs without a tuning
    roots: tuple[Path, ...]  # folders that outcomes may name files from
    rig: ShotRig | None = None  # that the shots were made with; None where no file tells


def material_of(places: Sequence[Path], warn: Warn) -> Material:
    """Sort the files of folders, and files that were named."""
    named = frozenset(real_path(place) for place in places if place.is_file())
    outcomes: list[Outcome] = []
    drops: list[TunedDrop] = []
    logs: list[Path] = []
    outcome_files: list[Path] = []
    rigs: dict[Path, ShotRig] = {}
    for file in files_of(places, warn):
        suffixes = _NAMED_LOGS if real_path(file) in named else _LOGS
        try:
            if file.suffix.lower() == ".json":
                drops += filter(None, [read_tuned_drop(file)])
            elif found := _outcomes(file, warn):
                outcomes += found
                outcome_files.append(file)
            elif file.suffix.lower() in suffixes:
                logs.append(file)
            elif file.suffix.lower() in _RIGS and (
                real_path(file) in named or "rig" in file.stem.lower()
            ):
                rigs[file] = read_rig(file)
        except UsageError as error:
            if real_path(file) in named:
                raise
            warn(f"{error}; no shot is drawn by it")
        except OSError as error:
            warn(f"{file}: cannot be read ({error.strerror})")
    if not (outcomes or drops or logs):
        words = ", ".join(map(str, places))
        raise LogError(
            f"{words}: holds no drop and no outcome; name a folder with logs that tunenet-record "
            "wrote, and the tunings beside them"
        )
    if len(rigs) > 1:
        first, *others = map(str, rigs)
        warn(f"shots are drawn by {first}, not by {listed(others, 3)}")
    roots = tuple(dict.fromkeys(place if place.is_dir() else place.parent for place in places))
    no_drops = {real_path(file) for file in outcome_files}
    drops = [
        drop
        for drop in _with_logs(drops, [*logs, *outcome_files], warn)
        if drop.log is None or real_path(drop.log) not in no_drops
    ]
    texts = {outcome.tuning for outcome in outcomes if outcome.tuning}
    drops = _one_each(
        drops, frozenset(real_path(root / text) for text in texts for root in roots), warn
    )
    tuned = {real_path(drop.log) for drop in drops if drop.log is not None}
    return Material(
        outcomes=tuple(sorted(numbered(outcomes), key=lambda outcome: outcome.stamp_ns)),
        drops=tuple(sorted(drops, key=lambda drop: natural(drop.name))),
        untuned=tuple(log for log in logs if not tuned & {real_path(log), real_path(log).parent}),
        roots=roots,
        rig=next(iter(rigs.values()), None),
    )


def holds_campaign(places: Sequence[Path]) -> bool:
    """Return whether outcomes are among these files; unreadable ones are skipped.

    The next reader of these files warns of what is odd in them.
    """
    for file in files_of(places, lambda _: None):
        with suppress(LogError, OSError):
            if _outcomes(file, lambda _: None):
                return True
    return False


def natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Return a natural sort key: drop_2 before drop_10."""
    parts = re.findall(r"\d+|\D+", name)
    return tuple((0, int(one), "") if one.isdecimal() else (1, 0, one) for one in parts)


def files_of(places: Iterable[Path], warn: Warn) -> Iterator[Path]:
    """Yield every file of the places once, folders recursively."""
    seen: set[Path] = set()
    for place in places:
        if not place.exists():
            raise LogError(f"{place}: no such file or folder", "check its name")
        found = _inside(place, warn) if place.is_dir() else [place]
        for file in found:
            if (full := real_path(file)) not in seen:
                seen.add(full)
                if _is_regular(file, warn):
                    yield file


def _inside(folder: Path, warn: Warn) -> list[Path]:
    """List the files of a folder and its subfolders, its own first; links are not followed."""
    found: list[Path] = []
    waiting = [folder]
    looked = 0
    while waiting:
        root = waiting.pop()
        try:
            with os.scandir(root) as entries:
                every = list(islice(entries, _MAX_ENTRIES))
        except OSError as error:
            warn(f"{root}: cannot be read ({error.strerror})")
            continue
        looked += len(every)
        folders = [entry.name for entry in every if entry.is_dir(follow_symlinks=False)]
        # Links to folders are left out; circular links are not.
        links = {one.name for one in every if one.is_symlink() and is_folder(Path(one.path))}
        names = {entry.name for entry in every} - links - set(folders)
        found += [Path(root, name) for name in sorted(sorted(names), key=natural)]
        waiting += [Path(root, name) for name in sorted(folders, reverse=True)]
        if len(found) > _MAX_FILES or looked >= _MAX_ENTRIES:
            too_many = len(found) > _MAX_FILES
            most = f"{_MAX_FILES} files" if too_many else f"{_MAX_ENTRIES} files and folders"
            warn(f"{folder}: holds over {most}; those beyond are left out")
            return found[:_MAX_FILES]
    return found


def _is_regular(file: Path, warn: Warn) -> bool:
    """Return whether it is a file or a link to one; warn of pipes and circular links."""
    try:
        if file.is_file():
            return True
    except OSError as error:
        warn(f"{file}: cannot be read ({error.strerror})")
        return False
    if file.suffix.lower() in _NAMED_LOGS | _TABLES | {".json"}:
        warn(f"{file}: is no regular file; it is left out")
    return False


def _outcomes(file: Path, warn: Warn) -> Sequence[Outcome]:
    """Read a file's outcomes; none if it is something else."""
    suffix = file.suffix.lower()
    if suffix not in _TABLES and suffix != ".mcap":
        return ()
    try:
        if not holds_outcomes(file):
            return ()
    except LogError as error:
        warn(str(error))
        return ()
    try:
        return read_outcomes(file, warn)
    except LogError:
        if suffix in _TABLES:
            raise
        return ()


def _with_logs(drops: Iterable[TunedDrop], logs: Iterable[Path], warn: Warn) -> list[TunedDrop]:
    """Match tunings that lie apart from their logs by name; warn and skip if ambiguous."""
    by_name: dict[str, list[Path]] = {}
    for log in logs:
        by_name.setdefault(log.name, []).append(log)
    placed: list[TunedDrop] = []
    for drop in drops:
        same = by_name.get(drop.name, []) if drop.log is None else []
        if len(same) > 1:
            warn(
                f"{drop.tuning}: is left out, as {len(same)} logs are called {drop.name} "
                f"({listed(map(str, same))}); put it beside its own"
            )
        else:
            placed.append(replace(drop, log=same[0]) if same else drop)
    return placed


def _one_each(drops: Sequence[TunedDrop], named: frozenset[Path], warn: Warn) -> list[TunedDrop]:
    """Keep one tuning per log, so that no drop is counted twice.

    One that an outcome names comes first, then one that is named as the log is.
    """

    def rank(drop: TunedDrop) -> tuple[bool, bool, str]:
        tuning, log = drop.tuning or Path(), drop.log or Path()
        return real_path(tuning) not in named, tuning.stem != log.stem, str(tuning)

    by_log: dict[Path, list[TunedDrop]] = {}
    for drop in drops:
        if drop.log is not None:
            by_log.setdefault(real_path(drop.log), []).append(drop)
    kept = [drop for drop in drops if drop.log is None]
    for log, several in by_log.items():
        chosen = min(several, key=rank)
        if len(several) > 1:
            warn(f"{log}: has {len(several)} tunings; {chosen.tuning} counts")
        kept.append(chosen)
    return kept


# ---- Attempts: link drops, tunings and outcomes, in the order in which they were made.

_UNNAMED = "unnamed ball"  # of a drop whose recording names no ball, and that no outcome names


@dataclass(frozen=True, eq=False)
class Attempt:
    """One attempt: drops until one was good, then the shot's outcome."""

    number: int  # its position in the campaign, from 1
    ball: str  # name of the ball
    of_ball: int  # its position among those of this ball, from 1
    drops: tuple[TunedDrop, ...]  # in their order; the shot was tuned from the last
    outcome: Outcome | None  # None if none was recorded

    @property
    def used(self) -> TunedDrop | None:
        """Drop that the shot was tuned from, or the last that was tried."""
        return self.drops[-1] if self.drops else None

    @property
    def is_accepted(self) -> bool | None:
        """Whether that drop passed the checks; None if unknown."""
        return None if self.used is None else self.used.verdict != "rejected"

    @property
    def value(self) -> float | None:
        """Coefficient of restitution that the shot was planned with, or would have been."""
        if self.used is not None and self.used.value is not None:
            return self.used.value
        return None if self.outcome is None else self.outcome.tuned_parameter

    @property
    def interval95(self) -> tuple[float, float] | None:
        """95 % interval of the restitution, if its tuning has one."""
        return None if self.used is None else self.used.interval95

    @property
    def was_shot(self) -> bool:
        """Whether the shot was taken: one that was given up has neither height nor miss."""
        outcome = self.outcome
        if outcome is None:
            return False
        is_measured = outcome.shot_height_m is not None or outcome.miss_m is not None
        return outcome.success or is_measured or self.is_accepted is not False

    @property
    def name(self) -> str:
        """Name for titles."""
        return f"{self.number}: {self.ball}, {self.of_ball}"


def attempts_of(material: Material, warn: Warn) -> tuple[Attempt, ...]:
    """Link a campaign's drops and outcomes into attempts, in order.

    A drop belongs to every outcome that names it. One that none names and that came before one
    that is named, of the same ball, was tried for the same attempt. Drops are ordered by wall-clock
    time if all have one, else by name.
    """
    drops = sorted(material.drops, key=lambda drop: natural(drop.name))
    if all(drop.wall_ns is not None for drop in drops):
        drops = sorted(material.drops, key=lambda drop: drop.wall_ns or 0)
    # The last of several outcomes of one attempt counts, in the order of the first ones.
    by_attempt: dict[tuple[str, str, int], Outcome] = {}
    for outcome in material.outcomes:
        key = (outcome.task, outcome.ball, outcome.attempt)
        if key in by_attempt:
            warn(
                f"{outcome.name}: has several outcomes; the one of the latest time counts "
                f"({outcome.word})"
            )
        by_attempt[key] = outcome
    latest = list(by_attempt.values())
    linked = _linked(latest, drops, material.roots)
    made: list[tuple[int, Attempt]] = []
    waiting: list[tuple[int, TunedDrop]] = []
    for index, drop in enumerate(drops):
        for outcome in linked.get(id(drop), ()):
            if drop.ball not in ("", outcome.ball):
                warn(
                    f"{outcome.name}: names {drop.name}, which was recorded as a drop of "
                    f"{drop.ball}; it counts as this attempt's, correct the outcome if it is not"
                )
            tried = [pair for pair in waiting if pair[1].ball in ("", outcome.ball)]
            waiting = [pair for pair in waiting if pair not in tried]
            own = (*(before for _, before in tried), drop)
            made.append((index, Attempt(0, outcome.ball, outcome.attempt, own, outcome)))
        if id(drop) not in linked:
            waiting.append((index, drop))
    made += [
        (index, Attempt(0, drop.ball or _UNNAMED, 0, (drop,), None)) for index, drop in waiting
    ]
    ordered = [attempt for _, attempt in sorted(made, key=lambda pair: pair[0])]
    with_drop = {id(attempt.outcome) for attempt in ordered}
    ordered += [
        Attempt(0, outcome.ball, outcome.attempt, (), outcome)
        for outcome in latest
        if id(outcome) not in with_drop
    ]
    if all(_wall_ns(attempt) is not None for attempt in ordered):
        ordered.sort(key=lambda attempt: _wall_ns(attempt) or 0)
    # Number them in the campaign, and by ball where the outcome does not.
    counts: dict[str, int] = {}
    numbered: list[Attempt] = []
    for number, attempt in enumerate(ordered, 1):
        of_ball = attempt.of_ball or counts.get(attempt.ball, 0) + 1
        counts[attempt.ball] = max(of_ball, counts.get(attempt.ball, 0))
        numbered.append(replace(attempt, number=number, of_ball=of_ball))
    return tuple(numbered)


def _linked(
    outcomes: Sequence[Outcome], drops: Sequence[TunedDrop], roots: Sequence[Path]
) -> dict[int, list[Outcome]]:
    """Map the id of each drop to the outcomes that name its log or tuning.

    By a path, or by a name that only one drop has: paths may be another machine's.
    """
    by_path = {real_path(path): drop for drop in drops for path in (drop.log, drop.tuning) if path}
    by_name: dict[str, list[TunedDrop]] = {}
    for drop in drops:
        names = {drop.name, *(path.name for path in (drop.log, drop.tuning) if path)}
        for name in names:
            by_name.setdefault(name, []).append(drop)
    linked: dict[int, list[Outcome]] = {}
    for outcome in outcomes:
        for text in (outcome.drop_log, outcome.tuning):
            if not text:
                continue
            there = [by_path[at] for root in roots if (at := real_path(root / text)) in by_path]
            same = by_name.get(Path(text).name, [])
            if there or len(same) == 1:
                linked.setdefault(id((there or same)[0]), []).append(outcome)
                break
    return linked


def _wall_ns(attempt: Attempt) -> int | None:
    """Return the latest time of its drops and outcome [ns since 1970], or None."""
    times = [drop.wall_ns for drop in attempt.drops]
    times += [attempt.outcome.stamp_ns or None] if attempt.outcome else []
    return max((time_ns for time_ns in times if time_ns is not None), default=None)


# ---- Campaign: build its attempts, with images of the drops, from its files.


@dataclass(frozen=True, eq=False)
class Campaign:
    """A campaign to review."""

    name: str  # Of the folder that was named first
    attempts: tuple[Attempt, ...]  # In their order, at least one
    tuned_now: int  # How many drops had no tuning beside them
    unread: int  # How many logs cannot be read; they are no attempts
    places: tuple[str, ...] = ()  # That were named, without links
    rig: ShotRig | None = None  # That the shots were made with; None where no file tells
    # As they were to be expected, by the attempt's number
    shots: Mapping[int, ExpectedShot] = field(default_factory=dict)


def campaign_of(
    places: Sequence[Path], jobs: int | None, progress: Progress, warn: Warn
) -> Campaign:
    """Read the files of a campaign, and tune drops that have no tuning; nothing is written."""
    material = material_of(places, warn)
    work: list[TunedDrop | Path] = [*material.drops, *material.untuned]
    pieces = [Piece(item, 1, item.name) for item in work]
    read = parallel_map(_read, pieces, jobs, progress, ("reading", "drop")) if pieces else []
    unread = [reason for reason in read if isinstance(reason, str)]
    for reason in unread:
        warn(reason)
    drops = sorted(
        (drop for drop in read if isinstance(drop, TunedDrop)), key=lambda drop: natural(drop.name)
    )
    attempts = attempts_of(replace(material, drops=tuple(drops), untuned=()), warn)
    if not attempts:
        named = ", ".join(map(str, places))
        raise LogError(f"{named}: no drop and no outcome of it can be read", "name others")
    name = real_path(places[0]).name or "campaign"
    tuned_now = sum(drop.tuning is None for drop in drops)
    rig = material.rig
    shots = {} if rig is None else expected_shots(attempts, rig, warn)
    named = places_of(places)
    return Campaign(name, attempts, tuned_now, len(unread), named, rig, shots)


_MAX_SHOTS = 300  # that are simulated: each takes a tenth of a second


def expected_shots(
    attempts: Sequence[Attempt], rig: ShotRig, warn: Warn
) -> dict[int, ExpectedShot]:
    """Simulate the bounce shots whose height and ball are known, by the attempt's number."""
    found: dict[int, ExpectedShot] = {}
    for attempt in attempts:
        outcome = attempt.outcome
        if outcome is None or outcome.task != BOUNCE_SHOT or outcome.shot_height_m is None:
            continue
        ball = attempt.used.known if attempt.used is not None else None
        told = outcome.tuned_parameter
        if ball is None and told is not None and 0 <= told <= 1:
            ball = told_ball(told)
        if ball is None or not MIN_HEIGHT_M <= outcome.shot_height_m <= MAX_HEIGHT_M:
            continue
        if len(found) == _MAX_SHOTS:
            warn(f"the shots after attempt {max(found)} are not simulated: over {_MAX_SHOTS}")
            break
        found[attempt.number] = expected_shot(rig, ball, outcome.shot_height_m)
    return found


def places_of(places: Sequence[Path]) -> tuple[str, ...]:
    """Return the identity of a campaign: its files and folders, without links."""
    return tuple(str(real_path(place)) for place in places)


def _read(item: TunedDrop | Path) -> TunedDrop | str | None:
    """Read a drop with its images, or tune its log now; else why it cannot be, or None."""
    if isinstance(item, TunedDrop):
        drop = item
    else:
        from tunenet_logs.analysis.experiment import record_of
        from tunenet_logs.analysis.options import TuneOptions
        from tunenet_logs.analysis.tuning import tune_log

        tuning = tune_log(item, TuneOptions())
        if tuning.episode is None:
            return f"{item}: {tuning.reason}"
        if tuning.task not in ("drop", None):
            return None
        drop = drop_of(record_of(tuning), item, None)
    if drop.log is None:
        return drop
    start_ns, window_s = None, drop.window_s
    if (known := drop.overlay) is not None:  # with what led to them, and what followed
        start_ns, window_s = known.start_ns, (known.seconds[0] - 0.3, known.seconds[-1] + 0.3)
    return replace(drop, film=small_film(drop.log, start_ns, window_s))


# ---- Rates: successes beside the paper's, and restitutions by ball.

_Z95 = 1.959963984540054  # standard deviations: 95 % of a normal distribution are within


@dataclass(frozen=True)
class Rate:
    """Success rate of some attempts."""

    name: str  # of these attempts
    successes: int  # number that succeeded
    count: int  # number with an outcome
    published: float | None = None  # the paper's fraction; None if it has none

    @property
    def fraction(self) -> float:
        """Fraction of successes; NaN without attempts."""
        return self.successes / self.count if self.count else float("nan")

    @property
    def interval95(self) -> tuple[float, float]:
        """Wilson score interval; (0, 1) without attempts."""
        return wilson95(self.successes, self.count)


@dataclass(frozen=True)
class BallRestitutions:
    """Coefficients of restitution tuned for one ball."""

    name: str  # of the ball
    values: tuple[float, ...]  # one per drop, in their order
    attempts: tuple[int, ...]  # numbers of the first attempts with those
    intervals95: tuple[tuple[float, float] | None, ...]  # None where one has none

    @property
    def mean(self) -> float:
        """Mean of the values."""
        return float(np.mean(self.values))

    @property
    def sd(self) -> float:
        """Standard deviation of the values; NaN for a single one."""
        return float(np.std(self.values, ddof=1)) if len(self.values) > 1 else float("nan")


def wilson95(successes: int, count: int) -> tuple[float, float]:
    """Return the 95 % Wilson score interval (1927) of a proportion; (0, 1) without a trial.

    Unlike the normal approximation it stays within 0 and 1, and is valid for few trials.
    """
    if not count:
        return 0.0, 1.0
    fraction, square = successes / count, _Z95**2 / count
    middle = (fraction + square / 2) / (1 + square)
    half = _Z95 / (1 + square) * sqrt(fraction * (1 - fraction) / count + square / (4 * count))
    return max(0.0, middle - half), min(1.0, middle + half)


def overall_rates(attempts: Sequence[Attempt]) -> tuple[Rate, ...]:
    """Rate bounce shots (all, drop accepted, drop rejected), and the other tasks.

    The paper counts by whether a drop left the table (Allevato et al. 2019, experiment 3): 87 % on
    it, 18 % off it. The checks reject such a drop, or one that looks like it. The paper
    has no figure for other tasks.
    """
    kinds: tuple[tuple[str, float, Callable[[Attempt], bool]], ...] = (
        ("all", 0.62, lambda _: True),
        ("drop accepted", 0.87, lambda one: one.is_accepted is True),
        ("drop rejected", 0.18, lambda one: one.is_accepted is False),
    )
    tasks = _tasks_of(attempts)
    shots = [attempt for attempt in attempts if _task(attempt) == BOUNCE_SHOT]
    published = [_rate(name, filter(belongs, shots), rate) for name, rate, belongs in kinds]
    others = [
        _rate(f"task {task}", (attempt for attempt in attempts if _task(attempt) == task), None)
        for task in tasks
        if task != BOUNCE_SHOT
    ]
    return (*(published if shots or not others else ()), *others)


def ball_rates(attempts: Sequence[Attempt]) -> tuple[Rate, ...]:
    """Rate attempts by ball, in order, and by task if it is no bounce shot."""
    rates: list[Rate] = []
    for ball in _balls_of(attempts):
        for task in _tasks_of(attempts):
            own = [one for one in attempts if one.ball == ball and _task(one) == task]
            name = ball if task == BOUNCE_SHOT else f"{ball}, {task}"
            rates += [_rate(name, own, None)] if own else []
    return tuple(rates)


def _task(attempt: Attempt) -> str | None:
    return None if attempt.outcome is None else attempt.outcome.task


def _tasks_of(attempts: Iterable[Attempt]) -> tuple[str, ...]:
    """List the tasks that were tried, in order of appearance."""
    tasks = (attempt.outcome.task for attempt in attempts if attempt.outcome is not None)
    return tuple(dict.fromkeys(tasks))


def restitutions_by_ball(attempts: Sequence[Attempt]) -> tuple[BallRestitutions, ...]:
    """Collect the restitutions of each ball that has one, in order of appearance.

    A drop that several shots were planned with is one value.
    """
    first: dict[int, Attempt] = {}
    for attempt in attempts:
        first.setdefault(id(attempt.used or attempt), attempt)
    found: list[BallRestitutions] = []
    for ball in _balls_of(attempts):
        tuned = [
            (attempt.value, attempt.number, attempt.interval95)
            for attempt in first.values()
            if attempt.ball == ball and attempt.value is not None
        ]
        if tuned:
            found.append(BallRestitutions(ball, *zip(*tuned, strict=True)))
    return tuple(found)


def _balls_of(attempts: Iterable[Attempt]) -> tuple[str, ...]:
    """List the names of the balls, in order of appearance."""
    return tuple(dict.fromkeys(attempt.ball for attempt in attempts))


def _rate(name: str, attempts: Iterable[Attempt], published: float | None) -> Rate:
    ended = [attempt.outcome for attempt in attempts if attempt.outcome is not None]
    return Rate(name, sum(outcome.success for outcome in ended), len(ended), published)


# ---- Tunings that a user names: JSONs of `tunenet-tune`, and folders with them.


@dataclass(frozen=True, eq=False)
class TuningFile:
    """JSON of a tuning, and its record."""

    path: Path
    record: Record
    label: str  # the log's name; with folders in front if several logs have it


def read_tunings(places: Sequence[Path], warn: Warn) -> tuple[TuningFile, ...]:
    """Read tunings in the order that they are named; those of a folder, recursively, by name."""
    named = {real_path(place) for place in places if place.is_file()}
    found: list[tuple[Path, Record]] = []
    for path in files_of(places, warn):
        is_named = real_path(path) in named
        if not is_named and path.suffix.lower() != ".json":
            continue
        try:
            found.append((path, read_record(path)))
        except LogError:
            if is_named:
                raise
    if not found:
        words = ", ".join(map(str, places))
        raise LogError(f"{words}: holds no tuning; give the .json that tunenet-tune wrote")
    # Label logs; equal names get as many folders of their JSON as distinguish them.
    names = [record.log or path.stem for path, record in found]
    counts = Counter(names)
    labels = list(names)
    for depth in range(4):  # folders before a name, to tell it from an equal one
        again = Counter(labels)
        for index, (path, _) in enumerate(found):
            if counts[names[index]] > 1 and again[labels[index]] > 1:
                folders = real_path(path).parent.parts[-1 - depth :]
                labels[index] = f"{names[index]} ({'/'.join([*folders, path.stem])})"
    labels = distinct(labels)
    return tuple(
        TuningFile(path, record, label) for (path, record), label in zip(found, labels, strict=True)
    )
