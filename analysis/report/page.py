"""Render a report of tunings as one self-contained HTML page, and its figures as files for a paper.

A page has the sections of its tunings, a comparison of several, and a campaign's tables. Figures
are embedded within a budget of bytes: under 3 MB, a page goes through any mail.
"""

from __future__ import annotations

import base64
import io
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

from tunenet_logs import __version__
from tunenet_logs.analysis.campaign import (
    Attempt,
    Campaign,
    TuningFile,
    ball_rates,
    campaign_of,
    holds_campaign,
    in_order,
    overall_rates,
    read_tunings,
    restitutions_by_ball,
)
from tunenet_logs.analysis.compare import TEST_WORDS, ComparedGroup, Comparison, PairTest, compare
from tunenet_logs.analysis.presentation import (
    NEXT,
    TuningSection,
    caution_lines,
    interval_words,
    named_lines,
    number_words,
    probability_words,
    quantity,
    section_of,
    summary_lines,
    value_words,
)
from tunenet_logs.analysis.record import Record
from tunenet_logs.analysis.report.figures import (
    WIDE_IN,
    Drawing,
    bounces_drawing,
    comparison_drawings,
    curves_drawing,
    frames_drawing,
    iterations_drawing,
    strobe_drawing,
    styled,
    torques_drawing,
)
from tunenet_logs.analysis.result_files import Logs, check_place, in_words, logs_of, mark, marked
from tunenet_logs.analysis.review.drawing import ReviewedLog, read_back
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import real_path
from tunenet_logs.terminal import Progress, short_name
from tunenet_logs.writing.owned_path import OutputPlace

# ---- Campaign: tables of rates, balls and attempts.

_MAX_ATTEMPTS = 300  # the others are counted

Cells = tuple[str, ...]


@dataclass(frozen=True)
class CampaignSection:
    """Tables of a campaign.

    Attributes:
        rates: Rows of whose, successes, rate and Wilson interval.
        balls: Rows of ball, mean restitution, standard deviation and drops.
        attempts: Rows of number, ball, drops, restitution, interval, outcome and reason.
        notes: What is not in the tables.
    """

    rates: tuple[Cells, ...]
    balls: tuple[Cells, ...]
    attempts: tuple[Cells, ...]
    notes: tuple[str, ...]


def campaign_section(campaign: Campaign) -> CampaignSection:
    """Build the tables of a campaign."""
    attempts = campaign.attempts
    rates = [
        (
            rate.name,
            f"{rate.successes} of {rate.count}",
            f"{100 * rate.fraction:.0f} %",
            "{:.0f} to {:.0f} %".format(*(100 * end for end in rate.interval95)),
        )
        for rate in (*overall_rates(attempts), *ball_rates(attempts))
        if rate.count
    ]
    balls = [
        (
            ball.name,
            f"{ball.mean:.4f}",
            f"{ball.sd:.4f}" if len(ball.values) > 1 else "-",
            str(len(ball.values)),
        )
        for ball in restitutions_by_ball(attempts)
    ]
    notes: list[str] = []
    if campaign.tuned_now:
        notes.append(
            f"{campaign.tuned_now} drops had no tuning beside them: they were tuned for this page, "
            "and have no part of their own. Run tunenet-tune on them first."
        )
    if campaign.unread:
        notes.append(f"{campaign.unread} logs cannot be read.")
    if len(attempts) > _MAX_ATTEMPTS:
        notes.append(f"{len(attempts) - _MAX_ATTEMPTS} more attempts are not listed.")
    rows = tuple(_attempt_row(attempt) for attempt in attempts[:_MAX_ATTEMPTS])
    return CampaignSection(tuple(rates), tuple(balls), rows, tuple(notes))


def _attempt_row(attempt: Attempt) -> Cells:
    outcome = attempt.outcome
    said = "not recorded"
    if outcome is not None:
        said = "success" if outcome.success else "failure"
        said += "" if attempt.was_shot else ", not shot"
    used = attempt.used
    doubts = "" if used is None or used.verdict == "ok" else f" ({used.verdict})"
    drops = ", ".join(
        drop.name if drop.verdict == "ok" else f"{drop.name} ({drop.verdict})"
        for drop in attempt.drops
    )
    value, ends = attempt.value, attempt.interval95
    return (
        str(attempt.number),
        attempt.ball,
        drops or "-",
        "-" if value is None else f"{value:.4f}{doubts}",
        "-" if ends is None else interval_words(*ends),
        said,
        (outcome.reason or "") if outcome is not None else "",
    )


# ---- Rendering: a figure to bytes for a page, or to a file for a paper.

Kind = Literal["png", "pdf"]

_PAGE_DPI = 200  # of pictures in a page: sharp on a phone's screen
_PAPER_DPI = 300  # of a PNG, and of what is no line in a PDF
_JPEG_QUALITY = 82  # 0 to 100


class DataUri(str):
    """Data URI of an image: our own text, of any length."""

    __slots__ = ()


@styled
def embedded(drawing: Drawing) -> DataUri:
    """Render a figure for a page: lines as SVG, images as JPEG."""
    file = io.BytesIO()
    if drawing.is_photo:
        drawing.figure.savefig(
            file,
            format="jpg",
            dpi=_PAGE_DPI,
            pil_kwargs={"quality": _JPEG_QUALITY, "optimize": True},
        )
        kind = "jpeg"
    else:
        drawing.figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
        kind = "svg+xml"
    text = base64.b64encode(file.getvalue()).decode("ascii")
    return DataUri(f"data:image/{kind};base64,{text}")


@styled
def write_figure(figure: Figure, path: Path, kind: Kind, made: str) -> None:
    """Write a figure for a paper, with the mark `made` by which it is known as ours.

    Raises:
        OSError: It cannot be written.
    """
    metadata = {"Software": made} if kind == "png" else {"Creator": made}
    if kind == "pdf":
        metadata["CreationDate"] = None  # pyright: ignore[reportArgumentType] (leaves it out)
    figure.savefig(path, format=kind, dpi=_PAPER_DPI, metadata=metadata)


# ---- Tuning: its figures, within a budget of bytes.


@dataclass(frozen=True)
class DrawnFigure:
    """Figure within a page.

    Attributes:
        shape: "broad" for one of the page's whole width, "tall" for one beside two others, else "".
    """

    title: str
    caption: str
    alt: str
    source: DataUri
    is_photo: bool
    shape: str


@dataclass(eq=False)
class Room:
    """Budget of bytes for figures."""

    left: int
    refused: list[str] = field(default_factory=list)

    def take(self, drawings: Sequence[Drawing]) -> tuple[DrawnFigure, ...]:
        """Embed the figures that fit the budget, in order."""
        taken: list[DrawnFigure] = []
        for drawing in drawings:
            source = embedded(drawing)
            if len(source) > self.left:
                self.refused.append(drawing.title)
                continue
            self.left -= len(source)
            words = drawing.title, drawing.caption, drawing.alt
            taken.append(DrawnFigure(*words, source, drawing.is_photo, _shape(drawing)))
        return tuple(taken)


def _shape(drawing: Drawing) -> str:
    width_in, height_in = drawing.figure.get_size_inches()
    if width_in > 0.9 * WIDE_IN:
        return "broad"
    return "tall" if drawing.is_photo and height_in > 1.2 * width_in else ""


def reviewed(record: Record, tuning: Path) -> tuple[ReviewedLog, str]:
    """Read back the review beside a tuning; return why if it cannot be read."""
    sha256 = record.provenance.log_sha256 if record.provenance else ""
    try:
        return read_back(tuning.with_suffix(".rrd"), sha256), ""
    except LogError as error:
        return ReviewedLog(), str(error)


def drawings_of(record: Record, seen: ReviewedLog) -> list[Drawing]:
    """Draw all figures of a tuning and its review, the most important first."""
    film = seen.film
    makers: list[Callable[[], Drawing | None]] = [lambda: curves_drawing(record)]
    if film is not None:
        makers.append(lambda: strobe_drawing(film))
    makers += [lambda: torques_drawing(seen.torques), lambda: bounces_drawing(record)]
    if film is not None:
        makers.append(lambda: frames_drawing(film, record))
    makers.append(lambda: iterations_drawing(record))
    return list(_drawn(makers))


def _drawn(makers: Sequence[Callable[[], Drawing | None]]) -> Iterator[Drawing]:
    """Yield what can be drawn: invalid values may be too large for any chart."""
    for make in makers:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                drawing = make()
                if drawing is not None:  # laid out once, not at each saving
                    drawing.figure.draw_without_rendering()
                    drawing.figure.set_layout_engine("none")
        except (ArithmeticError, ValueError, MemoryError):
            continue
        if drawing is not None:
            yield drawing


def missing_words(record: Record, seen: ReviewedLog, why: str, refused: Sequence[str]) -> list[str]:
    """Describe which figures are missing, and why."""
    words: list[str] = []
    is_film = record.motion.fit is not None and record.motion.fit.unit == "px"
    if seen.film is None and is_film:
        words.append(f"No pictures of the film: {why or 'its review has none'}.")
    if not seen.torques and record.task == "payload" and record.estimates:
        words.append(
            f"No torques: the JSON holds none, and {why or 'its review has none'}. Tune the log "
            "again without --no-review, and keep both files together."
        )
    elif why and not is_film:
        words.append(f"If there is a film, it is not shown: {why}.")
    if refused:
        words.append(
            f"Left out, so that this page stays small: {', '.join(refused)}. A report of this "
            "tuning alone has room for more."
        )
    return words


# ---- Comparison: its figures and tables.

_MAX_TESTS = 300  # of one group, those that differ first; the CSV has all


@dataclass(frozen=True)
class ComparedTable:
    """Table of a group of comparable logs.

    Attributes:
        heads: Of the rows, one per log.
        lines: Summary of each parameter's tests, in a sentence.
        tests: Rows, one per pair and parameter.
        more: Tests that are not shown.
    """

    title: str
    heads: Cells
    rows: tuple[Cells, ...]
    lines: tuple[str, ...]
    tests: tuple[Cells, ...]
    more: int


@dataclass(frozen=True)
class ComparedSection:
    """Figures and tables of a comparison.

    Attributes:
        test_words: Description of the test; "" if nothing was tested.
        without: Rows of number, log, verdict and reason.
    """

    drawn: tuple[DrawnFigure, ...]
    groups: tuple[ComparedTable, ...]
    test_words: str
    without: tuple[Cells, ...]


def compared_section(comparison: Comparison, drawn: Sequence[DrawnFigure]) -> ComparedSection:
    """Build the tables of a comparison beside its figures."""
    numbers = {label: str(number) for number, label in enumerate(comparison.labels, 1)}
    groups = tuple(_compared_table(group, numbers) for group in comparison.groups)
    without = tuple(
        (numbers[label], label, record.verdict, record.reason or "no reason is given")
        for label, record in comparison.without_values
    )
    has_tests = any(group.tests for group in groups)
    return ComparedSection(tuple(drawn), groups, TEST_WORDS if has_tests else "", without)


def _compared_table(group: ComparedGroup, numbers: Mapping[str, str]) -> ComparedTable:
    rows: dict[str, list[str]] = {label: [numbers[label], label] for label in group.labels}
    heads = ["", "log"]
    lines: list[str] = []
    tests: list[tuple[str, PairTest]] = []
    for one in group.quantities:
        heads.append(quantity(one.name, one.unit))
        cells = {value.label: value_words(value) for value in one.values}
        has_speed = any(value.speed_m_s is not None for value in one.values)
        speeds = {value.label: value.speed_m_s for value in one.values}
        for label, row in rows.items():
            row.append(cells.get(label, "-"))
            if has_speed:
                speed = speeds.get(label)
                row.append("?" if speed is None else f"{speed:.2f}")
        if has_speed:
            heads.append("at [m/s]")
        lines.append("; ".join([*summary_lines(one, numbers), *named_lines(one, numbers)]))
        lines += [f"{one.name}, {caution}" for caution in caution_lines(one, numbers)]
        tests += [(one.name, test) for test in one.tests]
    tests.sort(key=lambda pair: not pair[1].differs)
    shown = tuple(_test_row(name, test, numbers) for name, test in tests[:_MAX_TESTS])
    more = max(0, len(tests) - _MAX_TESTS)
    cells_of_logs = tuple(tuple(row) for row in rows.values())
    return ComparedTable(group.title, tuple(heads), cells_of_logs, tuple(lines), shown, more)


def _test_row(name: str, test: PairTest, numbers: Mapping[str, str]) -> Cells:
    chance = "-" if test.corrected is None else probability_words(test.corrected)
    said = "differs" if test.differs else "not distinguishable"
    return (
        name,
        f"{numbers[test.first]} - {numbers[test.second]}",
        number_words(test.difference),
        interval_words(*test.interval95),
        "-" if test.speed_m_s is None else f"{test.speed_m_s:.2f}",
        chance,
        "not compared" if test.corrected is None else said,
        test.caution,
    )


# ---- Contents of a report: tunings, and a campaign if outcomes are among the files.


@dataclass(frozen=True, eq=False)
class Reported:
    """Contents of a report.

    Attributes:
        title: Of the page; None for that of its tunings.
        tunings: In their order.
        campaigns: None, or the one whose outcomes are among the files.
    """

    title: str | None
    tunings: Sequence[TuningFile]
    campaigns: Sequence[CampaignSection] = ()


def read_reported(
    places: Sequence[Path], jobs: int | None, progress: Progress, warn: Callable[[str], None]
) -> Reported:
    """Read tunings, folders of them, or a campaign.

    Args:
        places: Files and folders.
        jobs: Processes for a campaign's drops; None for all cores.
        progress: Shows the drop under way.
        warn: Called with what cannot be read.

    Raises:
        UsageError: Nothing in them can be reported.
    """
    title = real_path(places[0]).name if places[0].is_dir() else None
    if not holds_campaign(places):
        return Reported(title, read_tunings(places, warn))
    campaign = campaign_of(places, jobs, progress, warn)
    drops = [drop for attempt in campaign.attempts for drop in attempt.drops]
    known = dict.fromkeys(drop.tuning for drop in drops if drop.tuning is not None)
    tunings = in_order(read_tunings(list(known), warn)) if known else ()
    return Reported(title, tunings, [campaign_section(campaign)])


# ---- Page: render its parts by a template.

PAGE, COMPARISON = "page", "comparison"  # kinds of pages, as their marks have them
_MAX_BYTES = 2_800_000  # of the figures and words of a page
_WORDS_BYTES = 12_000  # of the words of one tuning, usually
_COMPARED_BYTES = 900_000  # of the figures of a comparison
_MAX_DETAILED = 24  # tunings with a part of their own on a page; the overview has all
_MAX_TEXT_CHARACTERS = 1500  # of one text: it may be a stranger's


@dataclass(frozen=True)
class OverviewRow:
    """One tuning's row of the overview.

    Attributes:
        anchor: Where its part begins; "" if it has none.
        words: Its values; the reason if it has none.
    """

    number: int
    label: str
    verdict: str
    words: str
    anchor: str


@dataclass(frozen=True)
class PagePart:
    """One tuning's part of a page."""

    section: TuningSection
    drawn: tuple[DrawnFigure, ...]
    missing: tuple[str, ...]


def report_page(reported: Reported) -> str:
    """Render the page of one tuning, of several, or of a campaign."""
    tunings = reported.tunings
    detailed = tunings[:_MAX_DETAILED]
    compared, left = None, _MAX_BYTES
    if len(tunings) > 1:
        compared = _compared(
            compare([one.record for one in tunings], [one.label for one in tunings])
        )
        left -= sum(len(one.source) for one in compared.drawn)
    left -= _WORDS_BYTES * len(detailed)
    parts = [_part(one, number, left // len(detailed)) for number, one in enumerate(detailed, 1)]
    is_one = len(tunings) == 1 and not reported.campaigns
    logs = logs_of(one.record for one in tunings)
    facts = parts[0].section.facts if is_one else _counts(tunings)
    return _rendered(
        mark=Markup(mark(PAGE, logs)),  # noqa: S704 (letters, digits and signs that HTML lets be)
        title=tunings[0].label if is_one else reported.title or facts[0],
        facts=facts,
        overview=() if is_one else _overview(tunings, len(detailed)),
        campaigns=reported.campaigns,
        compared=compared,
        sections=parts,
    )


def _counts(tunings: Sequence[TuningFile]) -> tuple[str, ...]:
    """Count the tunings by verdict."""
    counts = Counter(one.record.verdict for one in tunings)
    return f"{len(tunings)} tunings", *(f"{counts[one]} {one}" for one in NEXT if counts[one])


def comparison_page(comparison: Comparison) -> str:
    """Render the page of a comparison."""
    records = zip(comparison.labels, comparison.records, strict=True)
    return _rendered(
        mark=Markup(mark(COMPARISON, logs_of(comparison.records))),  # noqa: S704 (as above)
        title=f"{len(comparison.labels)} tunings compared",
        facts=(),
        overview=[
            _overview_row(number, label, record, "")
            for number, (label, record) in enumerate(records, 1)
        ],
        campaigns=(),
        compared=_compared(comparison),
        sections=(),
    )


def _compared(comparison: Comparison) -> ComparedSection:
    room = Room(_COMPARED_BYTES)
    return compared_section(comparison, room.take(comparison_drawings(comparison)))


def _part(tuning: TuningFile, number: int, room_bytes: int) -> PagePart:
    seen, why = reviewed(tuning.record, tuning.path)
    room = Room(room_bytes)
    drawn = room.take(drawings_of(tuning.record, seen))
    missing = missing_words(tuning.record, seen, why, room.refused)
    section = section_of(tuning.record, tuning.label, tuning.path, number)
    return PagePart(section, drawn, tuple(missing))


def _overview(tunings: Sequence[TuningFile], detailed: int) -> list[OverviewRow]:
    return [
        _overview_row(number, one.label, one.record, f"log-{number}" if number <= detailed else "")
        for number, one in enumerate(tunings, 1)
    ]


def _overview_row(number: int, label: str, record: Record, anchor: str) -> OverviewRow:
    words: list[str] = []
    for known in record.estimates[:4]:
        if isinstance(known.value, tuple):
            continue
        ends: Any = known.interval95
        unit = "" if known.unit == "1" else f" {known.unit}"
        interval = "no interval" if ends is None else interval_words(*ends)
        words.append(f"{known.name} {number_words(known.value)}{unit} ({interval})")
    said = "; ".join(words) or record.reason or "no values"
    return OverviewRow(number, label, record.verdict, said, anchor)


def _rendered(**content: object) -> str:
    """Render the page; every text in it is escaped, on one line and of bounded length."""
    environment = Environment(
        loader=PackageLoader("tunenet_logs.analysis.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = environment.get_template("page.html")
    return page.render(**content, version=__version__)


def _shown(value: Any) -> Any:
    """Bound a text's length; numbers and our own markup stay as they are."""
    if isinstance(value, str) and not isinstance(value, DataUri | Markup):
        return short_name(value, _MAX_TEXT_CHARACTERS)
    return value


# ---- Paper: figures as files, one or a folder of all.

_FIGURE = "figure"  # kind of a figure, as its mark has it
_MAX_TUNINGS = 100  # whose figures are written to one folder at a time


@dataclass(frozen=True)
class FigureOrder:
    """Figures to write.

    Attributes:
        place: A file with the kind's suffix for the main figure, else a folder for all.
        inputs: Files that are read, which nothing replaces.
        overwrite: Whether figures of other logs may be replaced.
    """

    place: Path
    kind: Kind
    inputs: Sequence[Path]
    overwrite: bool


def write_figures(order: FigureOrder, tunings: Sequence[TuningFile]) -> list[Path]:
    """Write the figures of tunings, and return the files in order.

    Raises:
        UsageError: There is nothing to draw, or it cannot be written.
        OSError: It cannot be written.
    """
    suffix, option = f".{order.kind}", f"--{order.kind}"
    if len(tunings) > _MAX_TUNINGS:
        raise UsageError(f"{len(tunings)} tunings: draw at most {_MAX_TUNINGS} at a time")
    logs = logs_of(one.record for one in tunings)

    def checked(path: Path) -> OutputPlace:
        place = figure_place(path, order.kind, logs, overwrite=order.overwrite)
        check_place(place, option, (suffix,), order.inputs)
        return place

    is_folder = order.place.is_dir() and not order.place.is_symlink()
    if order.place.suffix.lower() == suffix and not is_folder:
        files = [(checked(order.place), _main(order, tunings))]
    else:
        drawn = _all(tunings)
        if order.place.suffix and not order.place.is_dir():
            raise UsageError(f"{order.place}: give {option} a folder, or a name that ends {suffix}")
        if not drawn:
            raise UsageError(f"{order.place}: these tunings have nothing to draw")
        order.place.mkdir(exist_ok=True)
        files = [(checked(order.place / f"{name}{suffix}"), one) for name, one in drawn.items()]
    for place, drawing in files:
        with place.replacing() as partial:
            write_figure(drawing.figure, partial, order.kind, mark(_FIGURE, logs))
    return [place.path for place, _ in files]


def figure_place(path: Path, kind: Kind, logs: Logs, *, overwrite: bool) -> OutputPlace:
    """Return the output place of a figure of some logs."""
    knows = marked(kind, _FIGURE, logs)
    elsewhere = f"give --{kind} another file"
    return OutputPlace(path, "figure", knows, in_words(logs), elsewhere, overwrite=overwrite)


def _main(order: FigureOrder, tunings: Sequence[TuningFile]) -> Drawing:
    drawings = _compared_drawings(tunings) if len(tunings) > 1 else _own(tunings[0])
    if not drawings:
        raise UsageError(f"{order.place}: these tunings have nothing to draw")
    return drawings[0]


def _all(tunings: Sequence[TuningFile]) -> dict[str, Drawing]:
    """Map the name of each figure's file, without the suffix, to the figure."""
    found: dict[str, Drawing] = {}
    for tuning in tunings:
        for drawing in _own(tuning):
            found[_free(found, f"{tuning.path.stem}_{drawing.name}")] = drawing
    if len(tunings) > 1:
        for drawing in _compared_drawings(tunings):
            found[_free(found, f"comparison_{drawing.name}")] = drawing
    return found


def _free(taken: dict[str, Drawing], name: str) -> str:
    """Number a name that is taken: two tunings may have the same."""
    number, free = 1, name
    while free in taken:
        number += 1
        free = f"{name}_{number}"
    return free


def _own(tuning: TuningFile) -> list[Drawing]:
    seen, _ = reviewed(tuning.record, tuning.path)
    return drawings_of(tuning.record, seen)


def _compared_drawings(tunings: Sequence[TuningFile]) -> list[Drawing]:
    records = [tuning.record for tuning in tunings]
    return comparison_drawings(compare(records, [tuning.label for tuning in tunings]))
