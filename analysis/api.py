"""Python interface: every command as a function, and the types that it takes and returns.

```python
import tunenet_logs as tn

tuning = tn.tune("drop.mcap")
print(tuning.verdict, tuning.reason)
print(tuning.to_frame())
tn.review(tuning, "drop.rrd")
```

Nothing here prints or exits. A log that cannot be tuned gives a tuning whose verdict is "rejected",
with the reason. Wrong options raise `UsageError`, unreadable or unwritable files `LogError`; both
are a `TuneNetError`.
"""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, fields, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from tunenet_logs.analysis.checks import Check, CrossCheck
from tunenet_logs.analysis.compare import Comparison
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import AnyPath, TuneOptions, options_of
from tunenet_logs.analysis.record import (
    Curves,
    Equivalent,
    Equivalents,
    Estimate,
    Motion,
    Provenance,
    Rebound,
    Record,
    SimulationFit,
    SoundShare,
    Units,
    read_record,
    to_json,
)
from tunenet_logs.console import made_of, options_in
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Frame, Signal
from tunenet_logs.errors import LogError, NotFoundError, TuneNetError, UsageError, WeightsError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.recorders.simulated import (
    DropOrder,
    FilmOrder,
    PayloadOrder,
    ShotOrder,
    film_drop,
    simulate_drop,
    simulate_payload,
    simulate_shot,
)
from tunenet_logs.recorders.simulators.known import BALLS, Ball, simulated_by
from tunenet_logs.terminal import Listener, Progress, heard_by

if TYPE_CHECKING:
    import pandas as pd  # pyright: ignore[reportMissingTypeStubs] (it ships its own types)

    from tunenet_logs.analysis.campaign import Campaign
    from tunenet_logs.analysis.report.page import Kind
    from tunenet_logs.recorders.simulators.base import Simulator
    from tunenet_logs.writing.owned_path import Knows


# ---- Episodes: read, build, simulate and save them.

_LATEST_S = 9e9  # stamps in ns of 64 bits end at 9.2e9 s


def read_episode(path: AnyPath, **reading: Any) -> Episode:
    """Read any log or video into memory; images are decoded when `Episode.frames` is called.

    Args:
        path: Log, video, table, ROS bag or a bag's folder.
        **reading: What the file does not state itself; see `ReadOptions`.

    Raises:
        LogError: There is no such file, or nothing in it can be read.
        UsageError: An option is invalid.
    """
    from tunenet_logs.reader import read_episode as read

    return read(Path(path), made_of(ReadOptions, reading))


def episode_of_positions(
    seconds: ArrayLike,
    positions: ArrayLike,
    *,
    unit: Literal["m", "px", ""] = "m",
    topic: str = "/ball/pose",
) -> Episode:
    """Build the episode of a drop from arrays, for `tune` and `save_episode`.

    Args:
        seconds: Stamp of each position [s], increasing; shape (T,).
        positions: x, y, z with z up, shape (T, 3); or heights alone, shape (T,).
        unit: Unit of the positions; "" if unknown: gravity then gives the scale.
        topic: Name of the signal.

    Raises:
        UsageError: Shapes disagree, a number is not finite, or the stamps do not increase.
    """
    placed = np.array(positions, float)
    if placed.ndim == 1:
        placed = np.column_stack([np.zeros((len(placed), 2)), placed])
    signal = _signal(topic, seconds, placed, ("x", "y", "z"), unit)
    return Episode(EpisodeInfo(kind="drop", source="Python"), {topic: signal})


def episode_of_joints(
    seconds: ArrayLike,
    names: Sequence[str],
    position_rad: ArrayLike,
    effort_nm: ArrayLike,
    velocity_rad_s: ArrayLike | None = None,
    *,
    topic: str = "/joint_states",
) -> Episode:
    """Build the episode of an arm's run from arrays, for `tune` and `save_episode`.

    Args:
        seconds: Stamp of each joint state [s], increasing; shape (T,).
        names: Names of the J joints, as in the arm's URDF.
        position_rad: Joint positions, shape (T, J).
        effort_nm: Joint torques, shape (T, J).
        velocity_rad_s: Joint velocities, shape (T, J); None if not measured.
        topic: Name of the signals.

    Raises:
        UsageError: Shapes disagree, a number is not finite, or the stamps do not increase.
    """
    parts = [("position", position_rad, "rad"), ("effort", effort_nm, "N·m")]
    if velocity_rad_s is not None:
        parts.append(("velocity", velocity_rad_s, "rad/s"))
    signals = {
        f"{topic}.{part}": _signal(
            f"{topic}.{part}", seconds, np.array(values, float), tuple(names), unit
        )
        for part, values, unit in parts
    }
    return Episode(EpisodeInfo(kind="payload", source="Python"), signals)


def _signal(
    name: str, seconds: ArrayLike, values: Array, columns: tuple[str, ...], unit: str
) -> Signal:
    stamps_s = np.array(seconds, float)
    if not (np.isfinite(stamps_s).all() and np.isfinite(values).all()):
        raise UsageError(f"{name}: a number is missing or not finite; leave such samples out")
    if not (np.abs(stamps_s) < _LATEST_S).all():
        raise UsageError(f"{name}: times are in seconds, below {_LATEST_S:g}")
    try:
        return Signal(name, np.round(stamps_s * 1e9).astype(np.int64), values, columns, unit)
    except ValueError as error:
        raise UsageError(str(error)) from error


def simulate(
    order: DropOrder | PayloadOrder | ShotOrder,
    *,
    film: FilmOrder | None = None,
    engine: str | None = None,
) -> Episode:
    """Simulate an episode, as `tunenet-record --simulate` does. Equal orders give equal bits.

    Args:
        order: A drop, an arm's run with a payload, or a bounce shot.
        film: How a camera films a drop; the episode then has images instead of positions.
        engine: See `tune`.

    Raises:
        UsageError: A value is out of range, or something else than a drop is to be filmed.
    """
    with simulated_by(engine):
        if isinstance(order, DropOrder):
            return simulate_drop(order) if film is None else film_drop(order, film)
        if film is not None:
            raise UsageError("only a drop can be filmed; leave film out")
        if isinstance(order, PayloadOrder):
            return simulate_payload(order)
        return simulate_shot(order)


def save_episode(episode: Episode, path: AnyPath, *, overwrite: bool = False) -> Path:
    """Write an episode as an MCAP log that `tune` and other MCAP tools read.

    Args:
        episode: Positions, joint states and images.
        path: The log, `NAME.mcap`.
        overwrite: Whether an existing file may be replaced.

    Raises:
        LogError: The file exists, or cannot be written.
    """
    from tunenet_logs.recorders.session import record_episode

    record_episode(episode, Path(path), overwrite=overwrite, progress=Progress(quiet=True))
    return Path(path)


# ---- Results: save, read, compare, review, report and export them.

_ELSEWHERE, _ASKED_BY = "choose another place", "overwrite=True"


def read_tuning(path: AnyPath) -> Record:
    """Read a tuning's record from the JSON that `tunenet-tune` or `save_tuning` wrote.

    Raises:
        LogError: The file cannot be read, or is no tuning.
    """
    return read_record(Path(path))


def save_tuning(tuning: Tuning | Record, path: AnyPath, *, overwrite: bool = False) -> Path:
    """Write a tuning as JSON, atomically; docs/tuning.md describes the keys.

    Args:
        tuning: A tuning, or its record.
        path: The JSON.
        overwrite: Whether the tuning of another log may be replaced.

    Raises:
        LogError: A file there may not be replaced, or it cannot be written.
    """
    from tunenet_logs.analysis.result_files import tuning_of

    record = tuning.record if isinstance(tuning, Tuning) else tuning
    knows = tuning_of(*_log_of(record))
    with _written(Path(path), "tuning", knows, record.log, overwrite=overwrite) as unfinished:
        unfinished.write_text(to_json(record), "utf-8", errors="backslashreplace")
    return Path(path)


def review(tuning: Tuning, path: AnyPath, *, overwrite: bool = False) -> Path:
    """Write the review of a tuning, for `rerun PATH` or Rerun's viewer in a notebook.

    Args:
        tuning: Tuning of a log that could be read.
        path: The recording, `NAME.rrd`.
        overwrite: Whether the review of another log may be replaced.

    Raises:
        UsageError: The name does not end in .rrd.
        LogError: The log cannot be read, a file there may not be replaced, or it cannot be written.
    """
    from tunenet_logs.analysis.result_files import review_of
    from tunenet_logs.analysis.review.tuning import write_review

    place = _rrd(path)
    if tuning.episode is None:
        raise LogError(f"{tuning.log}: could not be read, so there is nothing to review")
    log, sha256 = _log_of(tuning.record)
    knows = review_of(sha256)
    with _written(place, "review", knows, log.name, overwrite=overwrite) as unfinished:
        write_review(tuning, tuning.record, unfinished)
    return place


def review_campaign(
    places: AnyPath | Iterable[AnyPath],
    path: AnyPath,
    *,
    jobs: int | None = None,
    overwrite: bool = False,
) -> Campaign:
    """Write the review of a campaign, as `tunenet-review` does, and return the campaign.

    Args:
        places: Folders, logs, tunings, outcomes, tables of outcomes.
        path: The recording, `NAME.rrd`.
        jobs: Processes for drops without a tuning; None for all cores.
        overwrite: Whether the review of another campaign may be replaced.

    Raises:
        UsageError: No file of a campaign is there.
        LogError: A file there may not be replaced, or it cannot be written.
    """
    from tunenet_logs.analysis.campaign import campaign_of
    from tunenet_logs.analysis.result_files import recording, subject_of
    from tunenet_logs.analysis.review.campaign import write_campaign

    place = _rrd(path)
    campaign = campaign_of(_paths(places), jobs, Progress(quiet=True), _warn)
    knows = recording("campaign", subject_of(campaign.places))
    with _written(place, "review", knows, campaign.name, overwrite=overwrite) as unfinished:
        write_campaign(campaign, unfinished)
    return campaign


def compare(
    tunings: Iterable[Tuning | Record | AnyPath], names: Sequence[str] | None = None
) -> Comparison:
    """Compare the tunings of several logs, and test which values differ significantly.

    Args:
        tunings: Tunings, their records, or their JSON files.
        names: Label of each log; None for the logs' own names.

    Returns:
        The comparison; `to_frame` makes a table of it.

    Raises:
        UsageError: There are too many tunings, or not one name each.
        LogError: A JSON cannot be read, or is no tuning.
    """
    from tunenet_logs.analysis.compare import compare as compared

    records = [
        one
        if isinstance(one, Record)
        else one.record
        if isinstance(one, Tuning)
        else read_tuning(one)
        for one in tunings
    ]
    return compared(records, names)


def report(
    places: AnyPath | Iterable[AnyPath],
    page: AnyPath | None = None,
    *,
    figures: AnyPath | None = None,
    kind: Kind = "pdf",
    jobs: int | None = None,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write a report page of tunings, their figures, or both, as `tunenet-report` does.

    Args:
        places: JSONs of tunings, folders of them, or a campaign's folder.
        page: The page, `NAME.html`; None for none.
        figures: A file for the main figure, or a folder for all; None for none.
        kind: Format of the figures, "pdf" or "png"; "csv" for the curves themselves.
        jobs: Processes for a campaign's drops; None for all cores.
        overwrite: Whether results of other logs may be replaced.

    Returns:
        The files that were written.

    Raises:
        UsageError: There is nothing to report, or a file in a place may not be replaced.
        LogError: A tuning cannot be read.
    """
    from tunenet_logs.analysis.registry import needed

    needed("matplotlib", "report")
    needed("jinja2", "report")
    from tunenet_logs.analysis.report.page import write_report

    written = write_report(
        _paths(places),
        None if page is None else Path(page),
        {kind: None if figures is None else Path(figures)},
        Progress(quiet=True),
        _warn,
        jobs=jobs,
        overwrite=overwrite,
        asked_by=_ASKED_BY,
        option="page",
        elsewhere=_ELSEWHERE,
    )
    return tuple(written)


def save_arm_card(tuning: Tuning, path: AnyPath, *, overwrite: bool = False) -> Path:
    """Write what a payload's log identifies of the arm itself, for `tune(..., arm_card=PATH)`.

    Args:
        tuning: Tuning of a payload.
        path: The card, a JSON.
        overwrite: Whether the card of other runs may be replaced.

    Raises:
        LogError: Nothing was identified, a file there may not be replaced, or it cannot be written.
    """
    from tunenet_logs.analysis.payload.experiment import save_arm_card as save
    from tunenet_logs.analysis.result_files import writable

    with writable(Path(path), _ELSEWHERE):
        save(tuning, Path(path), overwrite=overwrite)
    return Path(path)


def export(
    tuning: Tuning | Record,
    to: str,
    path: AnyPath,
    *,
    speed_m_s: float | None = None,
    radius_m: float | None = None,
    mass_kg: float | None = None,
    step_s: float | None = None,
    model: AnyPath | None = None,
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write the tuned ball or payload as a model file of an engine, or a model's own file.

    See docs/engines.md, and docs/your-simulator.md of a tuned model.

    Args:
        tuning: A tuning, or its record.
        to: "pybullet", "mujoco", "sdf", "urdf", "drake", "newton", "isaac", "yaml" or "json"; of a
            tuned model "mjcf", "urdf", "yaml" or "json".
        path: The file, with the engine's suffix; of a model that names other files in its folder.
        speed_m_s: Impact speed at which the coefficient of restitution is to be exact.
        radius_m: Radius of the ball.
        mass_kg: Mass of the ball.
        step_s: The engine's time step.
        model: Where the tuned model lies; None for where it was.
        overwrite: Whether exports of other logs may be replaced.

    Returns:
        The files that were written: some engines need two, a model those of its includes that
        change.

    Raises:
        UsageError: There is no such engine, or an option does not apply to it.
        LogError: The tuning holds no value that can be exported, or a file cannot be written.
        NotFoundError: The tuning was rejected.
    """
    from tunenet_logs.analysis.export.exported import ExportOptions
    from tunenet_logs.analysis.export.files import engine_format, export_texts, exported_for
    from tunenet_logs.analysis.export.model import TASK, check_export, model_export, tuned_simulator
    from tunenet_logs.analysis.export.registry import MODEL_FORMATS
    from tunenet_logs.analysis.result_files import exported_file
    from tunenet_logs.writing.owned_path import OutputPlace

    record = tuning.record if isinstance(tuning, Tuning) else tuning
    said = ExportOptions(speed_m_s, radius_m, mass_kg, step_s)
    item = made = None
    if record.task == TASK and to in MODEL_FORMATS:
        if said != ExportOptions():
            raise UsageError("speed_m_s, radius_m, mass_kg and step_s are for a ball")
        item = tuned_simulator(record, record.log, None if model is None else Path(model))
        made = model_export(item, to, Path(path), None)
        texts = made.texts
    else:
        engine = engine_format(to)
        files = export_texts(engine, exported_for(engine, record, said), Path(path))
        texts = {place: text.encode() for place, text in files.items()}
    knows = exported_file(record)
    for place in texts:
        taken = OutputPlace(place, "export", knows, record.log, _ELSEWHERE, overwrite, _ASKED_BY)
        if why := taken.why_not():
            raise LogError(why)
    for place, text in texts.items():
        with _written(place, "export", knows, record.log, overwrite=overwrite) as unfinished:
            unfinished.write_bytes(text)
    if item is not None and made is not None and made.written is not None:
        check_export(made, item)
    return tuple(texts)


@contextmanager
def _written(path: Path, what: str, knows: Knows, of: str, *, overwrite: bool) -> Generator[Path]:
    """Open a file that replaces its place atomically on exit; see `OutputPlace`."""
    from tunenet_logs.analysis.result_files import writable
    from tunenet_logs.writing.owned_path import OutputPlace

    place = OutputPlace(path, what, knows, of, _ELSEWHERE, overwrite, _ASKED_BY)
    with writable(path, _ELSEWHERE), place.replacing() as unfinished:
        yield unfinished


def _log_of(record: Record) -> tuple[Path, str]:
    """Return the name and SHA-256 of a record's log."""
    return Path(record.log), record.provenance.log_sha256 if record.provenance else ""


def _paths(places: AnyPath | Iterable[AnyPath]) -> list[Path]:
    return [Path(places)] if isinstance(places, str | PathLike) else list(map(Path, places))


def _rrd(path: AnyPath) -> Path:
    place = Path(path)
    if place.suffix != ".rrd":
        raise UsageError(f"{place}: what is written is a recording; name it {place.stem}.rrd")
    return place


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=4)


# ---- Tuning: of one log, or many.

Reviewed = Literal["all", "none", "ok", "suspect", "rejected"]
"""Which logs get a review: all, none, or those of one verdict."""

_P = ParamSpec("_P")
_R = TypeVar("_R")


def _with_options(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Name each field of `TuneOptions` in a function's signature, for notebooks and `help`."""
    own = inspect.signature(function)
    kept = [one for one in own.parameters.values() if one.kind is not one.VAR_KEYWORD]
    known = [one for one in fields(TuneOptions) if one.name in options_in(TuneOptions)]
    named = [
        inspect.Parameter(
            one.name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None if one.default is MISSING else one.default,
            annotation=one.type,
        )
        for one in known
    ]
    vars(function)["__signature__"] = own.replace(parameters=[*kept, *named])
    return function


@_with_options
def tune(
    source: AnyPath | Episode,
    *,
    simulator: Simulator | None = None,
    name: str = "episode",
    engine: str | None = None,
    progress: Listener | None = None,
    **options: Any,
) -> Tuning:
    """Tune from one log, as `tunenet-tune` does; nothing is written.

    Args:
        source: A log's path, its address (`s3://...`), or an episode in memory.
        simulator: The user's own, with `parameters` and `rollout(values) -> Episode`, whose signals
            are named as the log's; None for the experiments, or the option `model`.
        name: Name of an episode in memory in the result.
        engine: "pybullet" or "mujoco"; None for the first that is installed. It is chosen for the
            whole process while this runs.
        progress: Called with the present stage in words, and its fraction done, from 0 to 1.
        **options: Those of the command; see `TuneOptions`.

    Returns:
        The tuning. It holds the episode's samples; its `record` does not: keep that of many logs. A
        log that cannot be read or tuned has the verdict "rejected".

    Raises:
        UsageError: An option is invalid, or fits no log.
        WeightsError: The weights are damaged, or of another network.
    """
    from tunenet_logs.analysis.result_files import known_sha256
    from tunenet_logs.analysis.tuning import provenance_of, tune_episode, tune_log

    sha256 = ""
    with simulated_by(engine), heard_by(progress):
        if isinstance(source, Episode):
            chosen = _with(simulator, options_of(options))
            tuning = tune_episode(source, chosen, Path(name))
        else:
            with _here(source) as path:
                chosen = _with(simulator, options_of(options, [path]))
                tuning, sha256 = tune_log(path, chosen), known_sha256(path)
    for doubt in chosen.ball_doubts:
        warnings.warn(doubt, stacklevel=2)
    return replace(tuning, provenance=provenance_of(tuning, sha256, chosen))


def _with(simulator: Simulator | None, options: TuneOptions) -> TuneOptions:
    """Add the user's own simulator to the options, if there is one."""
    if simulator is None:
        return options
    from tunenet_logs.analysis.sysid.source import GivenSimulator

    if options.source is not None or options.task is not None:
        raise UsageError("simulator does not go with model or task; leave them out")
    return replace(options, source=GivenSimulator(simulator))


@contextmanager
def _here(source: AnyPath) -> Generator[Path]:
    """Open the log as a local file; one at an address is copied and removed on exit."""
    from tunenet_logs.analysis.batch.logs import fetched, is_remote, log_address

    if not is_remote(str(source)):
        yield Path(source)
        return
    with fetched(log_address(str(source))) as path:
        yield path


@_with_options
def tune_all(
    logs: AnyPath | Iterable[AnyPath],
    folder: AnyPath,
    *,
    resume: bool = False,
    reviewed: Reviewed = "all",
    overwrite: bool = False,
    jobs: int | None = None,
    ray: str | None = None,
    engine: str | None = None,
    progress: Listener | None = None,
    **options: Any,
) -> pd.DataFrame:
    """Tune many logs on all cores, as `tunenet-tune LOGS -o FOLDER` does.

    Args:
        logs: Files, folders (searched recursively), patterns such as "runs/**/*.mcap", addresses.
        folder: Folder of the results: a JSON and a review of each log, and the ledger.
        resume: Whether to skip logs that the ledger has, unchanged, under the same options.
        reviewed: Which logs get a review: "all", "none", or those of one verdict.
        overwrite: Whether results of other logs may be replaced.
        jobs: Number of processes; None for all cores.
        ray: A Ray cluster's HOST:PORT, "auto" or "local"; None for processes of this machine.
        engine: See `tune`.
        progress: See `tune`; the fraction is that of the logs.
        **options: Options of every log; see `TuneOptions`.

    Returns:
        The ledger, a row per log, with columns `log`, `verdict`, `reason`, each parameter with its
        interval, and more; see docs/scale.md.

    Raises:
        UsageError: An option is invalid, or a place holds no log.
        LogError: The results cannot be written.
    """
    from tunenet_logs.analysis.batch.ledger import read_ledger
    from tunenet_logs.analysis.batch.logs import find_logs
    from tunenet_logs.analysis.batch.run import Order, Writing, closing, run_batch

    named = [logs] if isinstance(logs, str | PathLike) else list(logs)
    found = find_logs([str(one) if "://" in str(one) else Path(one) for one in named])
    chosen = options_of(options, [one.log for one in found.logs if isinstance(one.log, Path)])
    verdicts = {"all": Writing().reviewed, "none": frozenset[str]()}
    order = Order(
        found.logs,
        chosen,
        Writing(overwrite, verdicts.get(reviewed, frozenset([reviewed]))),
        Path(folder),
        keeps_ledger=True,
        resumes=resume,
        jobs=jobs,
        ray=ray,
    )
    with simulated_by(engine):
        batch = run_batch(order, Progress(quiet=True, listener=progress), after=closing)
    assert batch.ledger is not None
    return read_ledger(batch.ledger)


__all__ = [
    "BALLS",
    "Ball",
    "Check",
    "Comparison",
    "CrossCheck",
    "Curves",
    "DropOrder",
    "Episode",
    "EpisodeInfo",
    "Equivalent",
    "Equivalents",
    "Estimate",
    "FilmOrder",
    "Frame",
    "LogError",
    "Motion",
    "NotFoundError",
    "PayloadOrder",
    "Provenance",
    "ReadOptions",
    "Rebound",
    "Record",
    "Reviewed",
    "ShotOrder",
    "Signal",
    "SimulationFit",
    "SoundShare",
    "TuneNetError",
    "TuneOptions",
    "Tuning",
    "Units",
    "UsageError",
    "WeightsError",
    "compare",
    "episode_of_joints",
    "episode_of_positions",
    "export",
    "read_episode",
    "read_tuning",
    "report",
    "review",
    "review_campaign",
    "save_arm_card",
    "save_episode",
    "save_tuning",
    "simulate",
    "tune",
    "tune_all",
]
