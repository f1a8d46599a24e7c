"""Render a self-contained HTML page."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from analysis.comparison import Comparison, compare
from analysis.comparison_text import number_words
from analysis.record import Record
from analysis.report.compared_figures import comparison_drawings
from analysis.report.compared_section import ComparedSection, compared_section
from analysis.report.drawn import DrawnFigure, Room, drawings_of, missing_words, reviewed
from analysis.report.embedded import DataUri
from analysis.report.meanings import NEXT
from analysis.report.reported import Reported
from analysis.report.section import TuningSection, section_of
from analysis.result_files import logs_of, mark
from analysis.terminal_table import interval_words
from analysis.tuning_files import TuningFile
from tunenet_logs import __version__
from tunenet_logs.terminal import short_name

PAGE, COMPARISON = "page", "comparison"  # kinds of pages, as their marks have them
_MAX_BYTES = 2_800_000  # of the figures and words of a page: under 3 MB, it goes through any mail
_WORDS_BYTES = 12_000  # that the words of one tuning usually take
_COMPARED_BYTES = 900_000  # of the figures of a comparison
_MAX_DETAILED = 24  # tunings with a part of their own on a page; the overview has all
_MAX_CHARACTERS = 1500  # of one text of somebody else's


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
        loader=PackageLoader("analysis.report"),
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
        return short_name(value, _MAX_CHARACTERS)
    return value
