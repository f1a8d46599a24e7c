"""Save, read, compare, review, report and export results."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterable, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

from analysis.record import Record, Tuning
from analysis.tune_options import AnyPath
from tunenet_logs.errors import LogError, UsageError

if TYPE_CHECKING:
    from analysis.campaign.build import Campaign
    from analysis.comparison import Comparison
    from analysis.report.embedded import Kind
    from tunenet_logs.output.owned_file import Knows

_ELSEWHERE, _ASKED_BY = "choose another place", "overwrite=True"


def read_tuning(path: AnyPath) -> Record:
    """Read a tuning's record from the JSON that `tunenet-tune` or `save_tuning` wrote.

    Raises:
        LogError: The file cannot be read, or is no tuning.
    """
    from analysis.record_json import read_record

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
    from analysis.record_json import to_json
    from analysis.result_files import tuning_of

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
    from analysis.result_files import review_of
    from analysis.review.tuning_review import write_review

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
    from analysis.campaign.build import campaign_of
    from analysis.result_files import recording, subject_of
    from analysis.review.campaign import write_campaign
    from tunenet_logs.terminal import Progress

    place = _rrd(path)
    named = [places] if isinstance(places, str | PathLike) else list(places)
    campaign = campaign_of(list(map(Path, named)), jobs, Progress(quiet=True), _warn)
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
    from analysis.comparison import compare as compared

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
        kind: Format of the figures, "pdf" or "png".
        jobs: Processes for a campaign's drops; None for all cores.
        overwrite: Whether results of other logs may be replaced.

    Returns:
        The files that were written.

    Raises:
        UsageError: There is nothing to report, or a file in a place may not be replaced.
        LogError: A tuning cannot be read.
    """
    from analysis.campaign.files import files_of
    from analysis.optional_dependencies import needed
    from analysis.report.page import PAGE, report_page
    from analysis.report.paper import FigureOrder, write_figures
    from analysis.report.reported import read_reported
    from analysis.result_files import check_place, in_words, logs_of, marked
    from tunenet_logs.output.owned_file import OutputPlace
    from tunenet_logs.terminal import Progress

    needed("matplotlib", "report")
    needed("jinja2", "report")
    named = [places] if isinstance(places, str | PathLike) else list(places)
    inputs = list(files_of(list(map(Path, named)), _warn))
    if page is not None:
        knows = marked("html", PAGE, {})
        anybody = OutputPlace(Path(page), "page", knows, elsewhere=_ELSEWHERE, overwrite=True)
        check_place(anybody, "page", (".html",), inputs)
    reported = read_reported(list(map(Path, named)), jobs, Progress(quiet=True), _warn)
    written: list[Path] = []
    if page is not None:
        logs = logs_of(one.record for one in reported.tunings)
        knows, of = marked("html", PAGE, logs), in_words(logs)
        with _written(Path(page), "page", knows, of, overwrite=overwrite) as unfinished:
            unfinished.write_text(report_page(reported), "utf-8")
        written.append(Path(page))
    if figures is not None:
        order = FigureOrder(Path(figures), kind, inputs, overwrite=overwrite)
        written += write_figures(order, reported.tunings)
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
    from analysis.payload.card_saving import save_arm_card as save
    from analysis.result_files import writable

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
    overwrite: bool = False,
) -> tuple[Path, ...]:
    """Write the tuned ball or payload as a model file of an engine; see docs/engines.md.

    Args:
        tuning: A tuning, or its record.
        to: "pybullet", "mujoco", "sdf", "urdf", "drake", "newton", "isaac", "yaml" or "json".
        path: The file, with the engine's suffix.
        speed_m_s: Impact speed at which the coefficient of restitution is to be exact.
        radius_m: Radius of the ball.
        mass_kg: Mass of the ball.
        step_s: The engine's time step.
        overwrite: Whether exports of other logs may be replaced.

    Returns:
        The files that were written: some engines need two.

    Raises:
        UsageError: There is no such engine, or an option does not apply to it.
        LogError: The tuning holds no value that can be exported, or a file cannot be written.
        NotFoundError: The tuning was rejected.
    """
    from analysis.export.files import engine_format, export_texts, exported_for
    from analysis.export.from_record import ExportOptions
    from analysis.result_files import exported_file
    from tunenet_logs.output.owned_file import OutputPlace

    record = tuning.record if isinstance(tuning, Tuning) else tuning
    said = ExportOptions(speed_m_s, radius_m, mass_kg, step_s)
    engine = engine_format(to)
    texts = export_texts(engine, exported_for(engine, record, said), Path(path))
    knows = exported_file(record)
    for place in texts:
        taken = OutputPlace(place, "export", knows, record.log, _ELSEWHERE, overwrite, _ASKED_BY)
        if why := taken.why_not():
            raise LogError(why)
    for place, text in texts.items():
        with _written(place, "export", knows, record.log, overwrite=overwrite) as unfinished:
            unfinished.write_text(text, "utf-8")
    return tuple(texts)


@contextmanager
def _written(path: Path, what: str, knows: Knows, of: str, *, overwrite: bool) -> Generator[Path]:
    """Open a file that replaces its place atomically on exit; see `OutputPlace`."""
    from analysis.result_files import writable
    from tunenet_logs.output.owned_file import OutputPlace

    place = OutputPlace(path, what, knows, of, _ELSEWHERE, overwrite, _ASKED_BY)
    with writable(path, _ELSEWHERE), place.replacing() as unfinished:
        yield unfinished


def _log_of(record: Record) -> tuple[Path, str]:
    """Return the name and SHA-256 of a record's log."""
    return Path(record.log), record.provenance.log_sha256 if record.provenance else ""


def _rrd(path: AnyPath) -> Path:
    place = Path(path)
    if place.suffix != ".rrd":
        raise UsageError(f"{place}: what is written is a recording; name it {place.stem}.rrd")
    return place


def _warn(text: str) -> None:
    warnings.warn(text, stacklevel=4)
