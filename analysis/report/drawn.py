"""Draw the figures of one tuning for its page, within a budget of bytes."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from analysis.record import Record
from analysis.report.drop_figures import bounces_drawing, curves_drawing, iterations_drawing
from analysis.report.embedded import DataUri, embedded
from analysis.report.film_figures import frames_drawing, strobe_drawing
from analysis.report.style import WIDE_IN, Drawing
from analysis.report.torque_figures import torques_drawing
from analysis.review.read_back import ReviewedLog, read_back
from tunenet_logs.errors import LogError


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
