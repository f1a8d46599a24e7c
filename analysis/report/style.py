"""Style of figures: widths of a paper's column, colour-blind safe colours."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import ParamSpec, TypeVar

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font

from tunenet_logs.terminal import short_name

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")

COLUMN_IN = 3.4  # width of a figure: a column of a paper with two [in]
WIDE_IN = 7.0  # width of both columns with what is between them [in]
# What was recorded, the tuned simulator, and a third thing (Okabe and Ito 2008).
OBSERVED, SIMULATED, THIRD = "#1a1a1a", "#d55e00", "#0072b2"

MUTED, BAND = "#767676", "#e6e6e6"

# One log after the other; beyond them, the lines' pattern changes.
SERIES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#1a1a1a")

PATTERNS = ("-", "--", "-.", ":")

_FONT = "DejaVu Sans"  # comes with matplotlib, so figures look the same everywhere
_SETTINGS = {
    "font.family": _FONT,
    "font.size": 8.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#e3e3e3",
    "grid.linewidth": 0.5,
    "axes.axisbelow": True,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "figure.dpi": 100,
    "savefig.dpi": 300,
    "pdf.fonttype": 42,  # TrueType: text that can be searched, and no fonts that journals refuse
    "svg.fonttype": "path",  # looks alike on a machine without the font
    "svg.hashsalt": "tunenet-logs",  # the same figure is the same bytes
    "text.parse_math": False,  # a dollar in a log's name is a dollar
    "text.usetex": False,
    "axes.formatter.use_mathtext": False,
    "axes.unicode_minus": True,
}


@dataclass(frozen=True, eq=False)
class Drawing:
    """Figure with its texts.

    Attributes:
        name: Short, for a file's name.
        title: Above it.
        caption: What it shows; numbers in it are the record's.
        alt: Alternative text.
        figure: Drawn, not saved yet.
        is_photo: Whether it is images rather than lines.
    """

    name: str
    title: str
    caption: str
    alt: str
    figure: Figure
    is_photo: bool = False


def styled(draw: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
    """Decorate a function to draw or save with these settings instead of the user's."""

    @functools.wraps(draw)
    def inside(*arguments: Arguments.args, **named: Arguments.kwargs) -> Result:
        with mpl.rc_context():
            mpl.rcdefaults()
            mpl.rcParams.update(_SETTINGS)  # pyright: ignore[reportArgumentType, reportCallIssue]
            return draw(*arguments, **named)

    return inside


def new_figure(width_in: float, height_in: float) -> Figure:
    """Create an empty figure without pyplot, so that the user's open figures stay."""
    return Figure(figsize=(width_in, height_in), layout="constrained")


def drawable(text: str, most: int = 28) -> str:
    """Replace letters that the font lacks, and shorten."""
    known = get_font(findfont(FontProperties(family=_FONT))).get_charmap()
    return "".join(
        letter if ord(letter) in known else "\u25a1" for letter in short_name(text, most)
    )


def log_style(index: int) -> tuple[str, str]:
    """Return colour and dash pattern of one of several logs' lines."""
    return SERIES[index % len(SERIES)], PATTERNS[index // len(SERIES) % len(PATTERNS)]


def mark_impacts(axes: Axes, seconds: list[float]) -> None:
    """Draw thin lines at these times."""
    for at_s in seconds:
        axes.axvline(at_s, color=MUTED, linewidth=0.5, linestyle=(0, (2, 2)), zorder=0.5)
