"""Tabulate the results of real balls for a terminal."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from analysis.evaluation.real_balls.figures import MOTION, PATH, RealLine, Spread
from analysis.evaluation.real_balls.run import RealOrder
from analysis.evaluation.real_balls.tuned import PARAMETERS
from analysis.evaluation.text import seeds_in_words, short_or_dash, table_line

_FIRST = 17  # width of the labels [characters]
_TITLES = {
    "positions": "the stranger's balls, positions",
    "balls": "balls of the table, positions",
    "films": "films",
}
_QUANTITIES = {
    "restitution": "Restitution at the first impact",
    "restitution_slope": "Slope of the restitution",
    "drag": "Drag, 1/m",
    PATH: "Tuned rollout against the true path, rms in % of the height",
}
_MOTION_HEADS = ("ours", "the paper's", "first rebound", "best airless")

Column = tuple[str, int, Callable[[RealLine], str]]


def _percent(fraction: float | None) -> str:
    return "-" if fraction is None else f"{100 * fraction:.1f}"


def _held(line: RealLine) -> str:
    return "-" if line.covered is None else f"{_percent(line.covered)} ({line.intervals})"


def _ratio(ratio: float | None) -> str:
    return "-" if ratio is None else f"{ratio:.2f}"


_REFERENCE: tuple[Column, ...] = (
    ("fit: mean", 10, lambda line: short_or_dash(line.reference.mean)),
    ("worst", 7, lambda line: short_or_dash(line.reference.worst)),
    ("held", 6, lambda line: _percent(line.reference_covered)),
    ("width", 6, lambda line: _ratio(line.width)),
    ("most", 6, lambda line: _ratio(line.widest)),
)
_ERRORS: tuple[Column, ...] = (
    ("drops", 6, lambda line: str(line.drops)),
    ("ok", 7, lambda line: _percent(line.ok)),
    ("suspect", 8, lambda line: _percent(line.suspect)),
    ("mean", 7, lambda line: short_or_dash(line.ours.mean)),
    ("worst", 7, lambda line: short_or_dash(line.ours.worst)),
    ("held", 12, _held),
)
_PATHS: tuple[Column, ...] = (
    ("answered", 9, lambda line: str(line.answered)),
    ("mean", 7, lambda line: _of_height(line.ours.mean)),
    ("median", 7, lambda line: _of_height(line.ours.median)),
    ("99th", 7, lambda line: _of_height(line.ours.p99)),
    ("worst", 7, lambda line: _of_height(line.ours.worst)),
)
_REFERENCE_PATHS: tuple[Column, ...] = (
    ("fit: median", 12, lambda line: _of_height(line.reference.median)),
    ("99th", 7, lambda line: _of_height(line.reference.p99)),
    ("worst", 7, lambda line: _of_height(line.reference.worst)),
)


def protocol(order: RealOrder) -> str:
    """Describe what is measured, and how."""
    return (
        f"Balls in air whose restitution falls with speed; {seeds_in_words(order.seeds)}, "
        f"{order.targets} drops a cell each,\n{order.table_drops} of each ball of the table from "
        "each height.\n"
        "x .5, 1, 2: what slope and drag of the stranger's balls are multiplied by. fit: least "
        "squares that\nknow the model and the ranges; width, most: median and largest ratio of an "
        "interval to the fit's.\nheld: percent of the 95 % intervals that hold the truth, and how "
        "many are given.\nErrors are of all answers: verdict ok or suspect. A dash: there is none."
    )


def section_blocks(section: str, lines: Sequence[RealLine]) -> Iterator[str]:
    """Yield a table for each quantity of a section."""
    reference = section == "positions"
    for quantity in (*PARAMETERS, PATH):
        if quantity == PATH:
            columns = (*_PATHS, *(_REFERENCE_PATHS if reference else ()))
        else:
            columns = (*_ERRORS, *(_REFERENCE if reference else ()))
        title = f"{_QUANTITIES[quantity]}: {_TITLES[section]}"
        rows = [line for line in lines if line.quantity == quantity]
        yield "\n".join([title, *_table(columns, rows)])
    if section != "positions":
        yield motion_table(section, lines)


def motion_table(section: str, lines: Sequence[RealLine]) -> str:
    """Tabulate the predicted motion by each tuning."""
    names = MOTION if section == "balls" else MOTION[:1]
    heads = _MOTION_HEADS[: len(names)]
    widths = (_FIRST, 10, *[18] * len(names))
    text = [
        f"Motion error up to the last bounce in view: {_TITLES[section]}",
        "(mean, worst in % of the height; ours and best airless tuned on the first 60 % of the",
        "time, the paper's on 7 s at 60 Hz)",
        table_line(["", "answered", *heads], widths),
    ]
    known = [line for line in lines if line.quantity in MOTION]
    for label in dict.fromkeys(line.label for line in known):
        own = {line.quantity: line for line in known if line.label == label}
        first = own["ours"]
        cells = [_pair(own[name].ours) for name in names]
        text.append(table_line([label, f"{first.answered} of {first.drops}", *cells], widths))
    return "\n".join(text)


def _table(columns: Sequence[Column], rows: Sequence[RealLine]) -> list[str]:
    widths = [_FIRST, *(width for _, width, _ in columns)]
    head = table_line(["", *(name for name, _, _ in columns)], widths)
    return [
        head,
        *(table_line([row.label, *(show(row) for _, _, show in columns)], widths) for row in rows),
    ]


def _of_height(fraction: float | None) -> str:
    if fraction is None:
        return "-"
    percent = 100 * fraction
    return f"{percent:.1f}" if percent >= 10 else f"{percent:.3f}"


def _pair(errors: Spread) -> str:
    return f"{_of_height(errors.mean)}, {_of_height(errors.worst)}"
