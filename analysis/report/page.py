"""Render a report of tunings as one self-contained HTML page, and its figures as files for a paper.

A page has the blocks of its tunings, a comparison of several, and a campaign's tables. Figures are
embedded within a budget of bytes: under 3 MB, a page goes through any mail.
"""

from __future__ import annotations

import base64
import io
import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

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
    files_of,
    holds_campaign,
    natural,
    overall_rates,
    read_tunings,
    restitutions_by_ball,
)
from tunenet_logs.analysis.compare import Comparison, compare
from tunenet_logs.analysis.presentation import (
    NEXT,
    Block,
    Cells,
    Heading,
    Items,
    TextTable,
    comparison_blocks,
    interval_words,
    number_words,
    page_details,
    page_facts,
    page_todo,
    page_values,
)
from tunenet_logs.analysis.record import Record
from tunenet_logs.analysis.report.figures import (
    WIDE_IN,
    Drawing,
    bounces_drawing,
    campaign_drawings,
    comparison_drawings,
    curves_drawing,
    frames_drawing,
    iterations_drawing,
    signals_drawing,
    strobe_drawing,
    styled,
)
from tunenet_logs.analysis.result_files import Logs, check_place, in_words, logs_of, mark, marked
from tunenet_logs.analysis.review.drawing import ReviewedLog, read_back
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import real_path
from tunenet_logs.terminal import Progress, short_name
from tunenet_logs.writing.owned_path import OutputPlace

# ---- Campaign: tables of rates, balls and attempts.

_MAX_ATTEMPTS = 300  # the others are counted


def campaign_blocks(campaign: Campaign) -> list[Block]:
    """Make the blocks of a campaign."""
    attempts = campaign.attempts
    rates: list[Cells] = []
    for rate in (*overall_rates(attempts), *ball_rates(attempts)):
        if rate.count:
            low, high = rate.interval95
            counted = f"{rate.successes} of {rate.count}", f"{100 * rate.fraction:.0f} %"
            rates.append((rate.name, *counted, f"{100 * low:.0f} to {100 * high:.0f} %"))
    balls: list[Cells] = []
    for ball in restitutions_by_ball(attempts):
        sd = f"{ball.sd:.4f}" if len(ball.values) > 1 else "-"
        balls.append((ball.name, f"{ball.mean:.4f}", sd, str(len(ball.values))))
    blocks: list[Block] = []
    if rates:
        heads = ("attempts", "successes", "rate", "95 % interval (Wilson)")
        blocks += [Heading("Success"), TextTable(heads, rows=rates, title="success rates")]
    if balls:
        heads = ("ball", "mean", "standard deviation", "drops")
        shown = TextTable(heads, balls, title="restitution by ball")
        blocks += [Heading("Restitution by ball"), shown]
    heads = ("attempt", "ball", "drops", "restitution", "95 % interval", "outcome", "why")
    rows = [_attempt_row(attempt) for attempt in attempts[:_MAX_ATTEMPTS]]
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
    return [*blocks, Heading("Attempts"), TextTable(heads, rows, title="attempts"), Items(notes)]


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
        interval_words(ends),
        said,
        (outcome.reason or "") if outcome is not None else "",
    )


# ---- Rendering: a figure to bytes for a page, or to a file for a paper.

Kind = Literal["png", "pdf", "csv"]  # of what is written beside a page


class DataUri(str):
    """Data URI of an image: our own text, of any length."""

    __slots__ = ()


@styled
def embedded(drawing: Drawing) -> DataUri:
    """Render a figure for a page: lines as SVG, images as JPEG."""
    file = io.BytesIO()
    if drawing.is_photo:  # sharp on a phone's screen
        quality = {"quality": 82, "optimize": True}
        drawing.figure.savefig(file, format="jpg", dpi=200, pil_kwargs=quality)
        kind = "jpeg"
    else:
        drawing.figure.savefig(file, format="svg", metadata={"Date": None, "Creator": None})
        kind = "svg+xml"
    text = base64.b64encode(file.getvalue()).decode("ascii")
    return DataUri(f"data:image/{kind};base64,{text}")


@styled
def write_figure(figure: Figure, path: Path, kind: Kind, made: str) -> None:
    """Write a figure for a paper, with the mark `made` by which it is known as ours."""
    metadata = {"Software": made} if kind == "png" else {"Creator": made}
    if kind == "pdf":
        metadata["CreationDate"] = None  # pyright: ignore[reportArgumentType] (leaves it out)
    # 300 dpi for a PNG, and for what is no line in a PDF.
    figure.savefig(path, format=kind, dpi=300, metadata=metadata)


# ---- Figures of a page, within a budget of bytes.


@dataclass(frozen=True)
class EmbeddedFigures:
    """Figures that are embedded: drawings, their data, and the shape of each on a page.

    A shape is "broad" for the page's whole width, "tall" for one beside two others, else "".
    """

    kind: ClassVar = "figures"
    drawn: Sequence[tuple[Drawing, DataUri, str]]


def figures_within(drawings: Sequence[Drawing], left: int) -> tuple[EmbeddedFigures, list[str]]:
    """Embed the figures that fit into so many bytes, in order; return the titles of the others."""
    taken: list[tuple[Drawing, DataUri, str]] = []
    refused: list[str] = []
    for drawing in drawings:
        source = embedded(drawing)
        if len(source) > left:
            refused.append(drawing.title)
            continue
        left -= len(source)
        width_in, height_in = drawing.figure.get_size_inches()
        shape = "tall" if drawing.is_photo and height_in > 1.2 * width_in else ""
        taken.append((drawing, source, "broad" if width_in > 0.9 * WIDE_IN else shape))
    return EmbeddedFigures(taken), refused


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
    makers: list[Callable[[], Drawing | None]] = [
        lambda: curves_drawing(record),
        lambda: film and strobe_drawing(film),
        lambda: signals_drawing(seen.signals, len(record.gaps) - len(seen.signals)),
        lambda: bounces_drawing(record),
        lambda: film and frames_drawing(film, record),
        lambda: iterations_drawing(record),
    ]
    drawn: list[Drawing] = []
    for make in makers:
        # Invalid values may be too large for any chart.
        with (
            suppress(ArithmeticError, ValueError, MemoryError),
            warnings.catch_warnings(action="ignore"),
        ):
            if (drawing := make()) is not None:  # laid out once, not at each saving
                drawing.figure.draw_without_rendering()
                drawing.figure.set_layout_engine("none")
                drawn.append(drawing)
    return drawn


def missing_words(record: Record, seen: ReviewedLog, why: str, refused: Sequence[str]) -> list[str]:
    """Describe which figures are missing, and why."""
    words: list[str] = []
    is_film = record.motion.fit is not None and record.motion.fit.unit == "px"
    if seen.film is None and is_film:
        words.append(f"No pictures of the film: {why or 'its review has none'}.")
    what = {"payload": "torques", "simulator": "curves of signals"}.get(record.task or "")
    if what and not seen.signals and record.estimates:
        words.append(
            f"No {what}: the JSON holds none, and {why or 'its review has none'}. Tune the log "
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


# ---- Report: tunings, and a campaign if outcomes are among the files, written as asked for.


@dataclass(frozen=True, eq=False)
class Reported:
    """Contents of a report."""

    title: str | None  # of the page; None for that of its tunings
    tunings: Sequence[TuningFile]  # in their order
    campaign: Campaign | None = None  # whose outcomes are among the files


def write_report(
    places: Sequence[Path],
    page: Path | None,
    figures: Mapping[Kind, Path | None],
    progress: Progress,
    warn: Callable[[str], None],
    *,
    jobs: int | None,
    overwrite: bool,
    asked_by: str = "--overwrite",
    option: str = "-o",
    elsewhere: str = "give -o another file",
) -> list[Path]:
    """Read tunings, folders of them, or a campaign; write a page, figures, or both.

    No file is written before its place is checked, the page's even before the reading.
    """
    inputs = list(files_of(places, warn))

    def page_place(path: Path, logs: Logs, *, overwrite: bool) -> OutputPlace:
        knows = marked("html", PAGE, logs)
        return OutputPlace(path, "page", knows, in_words(logs), elsewhere, overwrite, asked_by)

    if page:  # a campaign takes a while, and then says of which logs it is
        check_place(page_place(page, {}, overwrite=True), option, (".html",), inputs)
    title = real_path(places[0]).name if places[0].is_dir() else None
    if not holds_campaign(places):
        reported = Reported(title, read_tunings(places, warn))
    else:
        campaign = campaign_of(places, jobs, progress, warn)
        drops = [drop for attempt in campaign.attempts for drop in attempt.drops]
        known = dict.fromkeys(drop.tuning for drop in drops if drop.tuning is not None)
        tunings = read_tunings(list(known), warn) if known else ()
        tunings = sorted(tunings, key=lambda one: natural(one.label))
        reported = Reported(title, tunings, campaign)
    logs = logs_of(one.record for one in reported.tunings)
    place = page and page_place(page, logs, overwrite=overwrite)
    if place:
        place.check()
    written: list[Path] = []
    for kind, figure in figures.items():
        if figure is not None:
            taken = marked(kind, _FIGURE, logs), in_words(logs), f"give --{kind} another file"

            def figure_place(path: Path, taken: Any = taken, kind: Kind = kind) -> OutputPlace:
                knows, whose, elsewhere = taken
                place = OutputPlace(path, "figure", knows, whose, elsewhere, overwrite, asked_by)
                check_place(place, f"--{kind}", (f".{kind}",), inputs)
                return place

            if figure.suffix.lower() == f".{kind}" and not figure.is_dir():
                figure_place(figure)  # before anything is drawn
            drawn = _drawn(figure, kind, reported)
            files = [(figure_place(path), drawing) for path, drawing in drawn.items()]
            for file, drawing in files:
                with file.replacing() as partial:
                    if isinstance(drawing, str):
                        partial.write_text(f"# {mark(_FIGURE, logs)}\n{drawing}", "utf-8")
                    else:
                        write_figure(drawing.figure, partial, kind, mark(_FIGURE, logs))
            written += drawn
    if place:
        with place.replacing() as partial:
            partial.write_text(report_page(reported), "utf-8")
        written.insert(0, place.path)
    return written


def curves_csv(record: Record, seen: ReviewedLog) -> str:
    """Format observed and simulated curves by time; "" without any.

    Of a ball its heights [m]; of an arm the torques of its joints [N·m], and of a simulator its
    signals, as its review has them: at all their stamps, empty where one has nothing.
    """
    import pandas as pd

    frames: list[pd.DataFrame] = []
    if record.motion.curves is not None:
        frames.append(record.motion.curves.to_frame())
    for one in seen.signals:
        unit = one.unit.replace("·", "").replace("/", "_per_").lower()
        columns = {
            "_".join(filter(None, [*one.name.split(), name, unit])): values
            for name, values in {"observed": one.observed, **one.curves}.items()
        }
        frames.append(pd.DataFrame(columns, index=pd.Index(one.seconds, name="seconds")))
    return pd.concat(frames, axis=1).to_csv(float_format="%.9g") if frames else ""


# ---- Page: render its blocks by a template.

PAGE, COMPARISON = "page", "comparison"  # kinds of pages, as their marks have them
_MAX_BYTES = 2_800_000  # of the figures and words of a page


@dataclass(frozen=True)
class PagePart:
    """One tuning's part of a page; `todo` stands in a box with the verdict."""

    label: str
    verdict: str
    lead: str
    facts: Sequence[str]
    todo: Items
    blocks: Sequence[Block | EmbeddedFigures]


def report_page(reported: Reported) -> str:
    """Render the page of one tuning, of several, or of a campaign."""
    tunings = reported.tunings
    detailed = tunings[:24]  # tunings with a part of their own on a page; the overview has all
    compared: list[Block | EmbeddedFigures] = []
    left = _MAX_BYTES - 12_000 * len(detailed)  # of the words of one tuning, usually
    campaign: list[Block | EmbeddedFigures] = []
    if reported.campaign is not None:
        figures, _ = figures_within(campaign_drawings(reported.campaign), 300_000)
        left -= sum(len(source) for _, source, _ in figures.drawn)
        campaign = [Heading("Campaign", 2), figures, *campaign_blocks(reported.campaign)]
    if len(tunings) > 1:
        labels = [one.label for one in tunings]
        compared, taken = _compared(compare([one.record for one in tunings], labels))
        left -= taken
    parts = [_part(one, left // len(detailed)) for one in detailed]
    is_one = len(tunings) == 1 and not reported.campaign
    counts = Counter(one.record.verdict for one in tunings)
    counted = f"{len(tunings)} tunings", *(f"{counts[one]} {one}" for one in NEXT if counts[one])
    facts = parts[0].facts if is_one else counted
    overview = _overview([(one.label, one.record) for one in tunings], len(detailed))
    return _rendered(
        mark=mark(PAGE, logs_of(one.record for one in tunings)),
        title=tunings[0].label if is_one else reported.title or facts[0],
        facts=facts,
        blocks=[*campaign, *([] if is_one else overview), *compared],
        tunings=parts,
        is_one=is_one,
    )


def comparison_page(comparison: Comparison) -> str:
    """Render the page of a comparison."""
    pairs = list(zip(comparison.labels, comparison.records, strict=True))
    blocks, _ = _compared(comparison)
    return _rendered(
        mark=mark(COMPARISON, logs_of(comparison.records)),
        title=f"{len(comparison.labels)} tunings compared",
        facts=(),
        blocks=[*_overview(pairs, 0), *blocks],
        tunings=(),
        is_one=False,
    )


def _compared(comparison: Comparison) -> tuple[list[Block | EmbeddedFigures], int]:
    """Make the blocks of a comparison; return the bytes of its figures, too."""
    # Bytes for the figures of a comparison.
    figures, _ = figures_within(comparison_drawings(comparison), 900_000)
    size = sum(len(source) for _, source, _ in figures.drawn)
    return [Heading("Comparison", 2), figures, *comparison_blocks(comparison)], size


def _part(tuning: TuningFile, room_bytes: int) -> PagePart:
    record = tuning.record
    seen, why = reviewed(record, tuning.path)
    figures, refused = figures_within(drawings_of(record, seen), room_bytes)
    missing = Items(missing_words(record, seen, why, refused))
    blocks = [*page_values(record), figures, missing, *page_details(record, tuning.path)]
    lead, todo = NEXT[record.verdict], page_todo(record, tuning.path)
    return PagePart(tuning.label, record.verdict, lead, page_facts(record), todo, blocks)


def _overview(tunings: Sequence[tuple[str, Record]], detailed: int) -> list[Block]:
    """Make a row per tuning: its values, or the reason if it has none; nothing without any."""
    rows: list[Cells] = []
    for number, (label, record) in enumerate(tunings, 1):
        words: list[str] = []
        for known in record.estimates[:4]:
            if isinstance(known.value, tuple):
                continue
            (part,) = known.components
            unit = "" if known.unit == "1" else f" {known.unit}"
            interval = interval_words(part.interval95, "no interval")
            value = number_words(part.value, part.interval95)
            words.append(f"{known.name} {value}{unit} ({interval})")
        said = "; ".join(words) or record.reason or "no values"
        rows.append((str(number), label, record.verdict, said))
    heads = ("", "log", "verdict", "values with 95 % intervals")
    anchors = [f"log-{at}" if at <= detailed else "" for at in range(1, len(rows) + 1)]
    shown = TextTable(heads, rows, title="overview", anchors=anchors)
    return [Heading("Overview", 2), shown] if rows else []


def _rendered(mark: str, **content: object) -> str:
    """Render the page; every text in it is escaped, on one line and of bounded length."""

    def shown(value: Any) -> Any:
        """Bound a text's length; numbers and our own markup stay as they are."""
        if isinstance(value, str) and not isinstance(value, DataUri | Markup):
            return short_name(value, 1500)  # of one text: it may be a stranger's
        return value

    environment = Environment(
        loader=PackageLoader("tunenet_logs.analysis.report"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=shown,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    safe = Markup(mark)  # noqa: S704 (letters, digits and signs that HTML lets be)
    return environment.get_template("page.html").render(**content, mark=safe, version=__version__)


# ---- Paper: figures as files, one or a folder of all.

_FIGURE = "figure"  # kind of a figure, as its mark has it
_MAX_TUNINGS = 100  # whose figures are written to one folder at a time


def _drawn(place: Path, kind: Kind, reported: Reported) -> dict[Path, Drawing | str]:
    """Draw the main figure for a file with the kind's suffix, else all of them for a folder.

    Of "csv": the curves of a tuning, as text.
    """
    tunings = reported.tunings
    if len(tunings) > _MAX_TUNINGS:
        raise UsageError(f"{len(tunings)} tunings: draw at most {_MAX_TUNINGS} at a time")
    is_folder = place.is_dir() and not place.is_symlink()
    is_file = place.suffix.lower() == f".{kind}" and not is_folder
    # Draw all figures of tunings and of their comparison, by the names of their files.
    compared_only = is_file and len(tunings) > 1
    found: list[tuple[str, Drawing | str]] = []
    if reported.campaign is not None and kind != "csv":
        found += [("campaign", one) for one in campaign_drawings(reported.campaign)]
    for tuning in () if compared_only and kind != "csv" else tunings:
        seen, _ = reviewed(tuning.record, tuning.path)
        if kind == "csv":
            found += [(tuning.path.stem, one) for one in [curves_csv(tuning.record, seen)] if one]
        else:
            found += [(tuning.path.stem, one) for one in drawings_of(tuning.record, seen)]
    if kind == "csv" and is_file and len(found) > 1:
        raise UsageError(f"{place}: several tunings have curves; give --csv a folder")
    if len(tunings) > 1 and kind != "csv":
        records = [tuning.record for tuning in tunings]
        comparison = compare(records, [tuning.label for tuning in tunings])
        found += [("comparison", one) for one in comparison_drawings(comparison)]
    drawn: dict[str, Drawing | str] = {}
    for stem, drawing in found:
        name = free = f"{stem}_{'curves' if isinstance(drawing, str) else drawing.name}"
        number = 1
        while free in drawn:  # two tunings may have the same
            number += 1
            free = f"{name}_{number}"
        drawn[free] = drawing
    if not is_file and place.suffix and not place.is_dir():
        raise UsageError(f"{place}: give --{kind} a folder, or a name that ends .{kind}")
    if not drawn:
        raise UsageError(f"{place}: these tunings have nothing to draw")
    if is_file:
        return {place: next(iter(drawn.values()))}
    place.mkdir(exist_ok=True)
    return {place / f"{name}.{kind}": drawing for name, drawing in drawn.items()}
