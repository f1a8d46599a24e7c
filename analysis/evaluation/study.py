"""What the studies of `tunenet-eval` share: their names and sizes, their runs, their tables.

A study is a module of `studies` with a function `run(order, progress)`, which draws cases from
seeds, scores each in a process of its own (`scored`), and yields a `Part` for each section as it is
done. Names and sizes stand in `STUDIES`, as the modules that have them take a second to load.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass
from dataclasses import fields as fields_of
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from tunenet_logs.errors import UsageError
from tunenet_logs.files import csv_line
from tunenet_logs.terminal import Progress

if TYPE_CHECKING:
    import numpy as np

    from tunenet_logs.analysis.options import TuneOptions
    from tunenet_logs.analysis.parallel import Piece
    from tunenet_logs.writing.owned_path import OutputPlace

Label = TypeVar("Label")
Case = TypeVar("Case")
Score = TypeVar("Score")
Row = dict[str, Any]  # of JSON and CSV: figures by name, None where there is none


@dataclass(frozen=True)
class Study:
    """Name, place and sizes of a study."""

    module: str  # of `studies`; after a dot its function, where that is not `run`
    summary: str  # lines of --help
    sections: Mapping[str, int] = field(default_factory=dict[str, int])  # and their own --targets
    usual: tuple[str, ...] = ()  # sections that run where none is named; () for all
    seeds: int = 3
    targets: int = 100  # test cases for each seed and set: the paper's
    files: tuple[str, ...] = ("json", "csv")  # forms that it can write
    options: tuple[str, ...] = ()  # its own


# Options of `own`: fields of `TuneOptions`, and the log.
OWN = ("log", "model", "parameters", "mapping", "start_s", "end_s", "columns", "fps")
_FILMED = ("set-A", "set-B", "set-C", "slope", "drag", "bad", "clips", "home", "transformed")
STUDIES = {
    "payload": Study(
        "payload",
        "the mass in an arm's gripper from its torques: the paper's masses (table 1), and\n"
        "logs like a real driver's, with a bound; only where they are named, its sections\n"
        '"strangers": arms that share no code with the fit, beside what one would write in\n'
        'an hour, "conventions": what their drivers mean by torque, and "cards": what a card\n'
        "of the arm is worth beside tares",
        # Of logs, two thirds as many as of masses, in all; of strangers, logs a cell in all.
        {"masses": 300, "logs": 300, "strangers": 400, "conventions": 1000, "cards": 36},
        ("masses", "logs"),
        seeds=5,
        targets=300,
        options=("pairs", "epochs"),
    ),
    "drop": Study(
        "drop",
        "restitution of a bouncing ball from its height: every method of the paper,\n"
        "what a user would pick instead, and ours, by rollouts spent (table 2, figure)",
        files=("json", "csv", "png", "rrd"),
        options=("methods", "rollouts", "pairs", "epochs"),
    ),
    "motion": Study(
        "motion",
        "where the ball will be: tuned simulators and one-step predictors (table 3)",
        options=("pairs", "epochs"),
    ),
    "intervals": Study(
        "positions.intervals",
        "how often the 95 % intervals of recorded drops contain the truth; part of drop",
    ),
    "positions": Study(
        "positions",
        "restitution from positions, clean and noisy: the result, the network's steps alone,\n"
        "and the speeds at the impact alone",
        targets=200,
    ),
    "throws": Study(
        "throws",
        "balls thrown down, dribbled, rolled off an edge, bouncing from the start, and tosses\n"
        'that are no bounce; "half" and "twice" have other noise',
        dict.fromkeys(("usual", "half", "twice"), 400),
        ("usual",),
        seeds=1,
        targets=400,
    ),
    "impact-times": Study(
        "impact_times",
        "restitution from impact times alone, beside the Cramér-Rao bound, the drop's height\n"
        "given or not; verdicts on balls, and on rhythms and noises that are no ball's",
        dict.fromkeys(("times", "height", "verdicts"), 300),
        seeds=1,
        targets=300,
    ),
    "video": Study(
        "video",
        "restitution from tracks of filmed drops, good and bad ones: errors, intervals,\n"
        'verdicts; only where they are named "converted": films shown at another rate,\n'
        '"bound": what an efficient fit would reach',
        dict.fromkeys((*_FILMED, "converted"), 200) | {"bound": 400},
        _FILMED,
        targets=200,
    ),
    "real-balls": Study(
        "real_balls",
        "balls in air whose restitution falls with speed, as positions and as films: each\n"
        "parameter, its interval, and whether the tuned simulator moves like the ball",
        dict.fromkeys(("positions", "balls", "films"), 200),
        targets=200,
    ),
    "bounce-shot": Study(
        "bounce_shot",
        "drop, record, tune, plan, shoot, in a hidden world with air, spin, balls out of\n"
        "round and drops that leave the table: the paper's policy and ours",
        dict.fromkeys(("campaigns", "drops"), 60),
        targets=60,
        options=("campaign", "pairs", "epochs"),
    ),
    "engines": Study(
        "engines",
        "drops made by each physics engine and by an exact integrator, tuned in each:\n"
        "effective restitutions and motions beside each other",
        targets=10,
    ),
    "exports": Study(
        "exports",
        "whether balls bounce as they should: by PyBullet's settings, by the file exported for\n"
        "each engine, and what is promised of MuJoCo",
        {"contact": 25, "files": 9, "mujoco": 40},
        seeds=1,
        targets=40,
    ),
    "network": Study(
        "network",
        "what the network's start is worth beside one from mid-range, by rollouts alone",
        {"payloads": 40, "drops": 100},
        options=("epochs",),
    ),
    "sysid": Study(
        "sysid",
        "users' own models: a pendulum, an arm with a payload and late commands, a block that\n"
        "slides, as SciPy integrates them: errors, intervals, two swings in one fit, what a log\n"
        "cannot tell, models of other machines, the network's first step, each method from afar,\n"
        "and mujoco.sysid beside it; servos whose terms each log chooses",
        dict.fromkeys(("tuned", "untold", "wrong", "toolbox", "network", "servos"), 200)
        | {"together": 100, "methods": 20},
        seeds=1,
        targets=200,
    ),
    "own": Study(
        "own",
        "your own model, simulated along your log with its noise and tuned anew: errors,\n"
        "intervals, what the log cannot tell, and how many seconds of it are needed; needs\n"
        "no extra",
        seeds=1,
        targets=20,
        options=OWN,
    ),
    "sound": Study(
        "audio",
        "bounces by ear: sounds that are made by code, alone and beside films, with speech,\n"
        "music and noise behind them; phyphox's way beside it, and sounds that are no bounce",
        dict.fromkeys(
            ("alone", "phyphox", "negatives", "films", "unrelated", "uneven", "uneven-films"), 200
        ),
        seeds=1,
        targets=200,
    ),
}

# Of `studies.drop`: the paper's, a user's, ours, and the ablation, which has no curve.
METHODS = {
    "methods of the paper": (
        *("mean", "entropy-search", "cma-es", "direct", "tunenet-paper", "tunenet-paper-code"),
    ),
    "what a user would pick": ("secant", "brent", "least-squares", "tpe", "npe"),
    "ours": ("network", "ours"),
    "the ablation, which has no curve in the figure": (
        *("concatenation", "difference", "antisymmetric"),
    ),
}


@dataclass(frozen=True)
class Order:
    """What a study is to do."""

    seeds: tuple[int, ...]  # each with its own training and test cases
    targets: int  # test cases for each seed and set
    sections: tuple[str, ...] = ()  # the chosen ones
    jobs: int | None = None  # processes; None for all cores
    is_full: bool = False  # whether nobody said how many targets: sections take their own
    methods: tuple[str, ...] | None = None  # of drop; None for all, and its intervals
    rollouts: int | None = None  # of drop: most that a method may spend; None for the cells' own
    pairs: int | None = None  # of training, in place of the presets', to try things out
    epochs: int | None = None  # likewise
    campaign: Path | None = None  # of the bounce shot: folder for the first seed's logs
    own: tuple[TuneOptions, Path | None] | None = None  # the user's model, and its log
    drawn: tuple[str, ...] = ()  # of drop: "png" and "rrd", where they are to be written

    @property
    def seeds_in_words(self) -> str:
        """Seeds, as "seed 1" or "seeds 1 to 3"."""
        first, *more = self.seeds
        return f"seeds {first} to {more[-1]}" if more else f"seed {first}"

    def targets_of(self, study: str, section: str) -> int:
        """Return the number of targets of a section: its own where nobody said another."""
        return STUDIES[study].sections[section] if self.is_full else self.targets

    def pieces(
        self, size: int, *kind: Any, targets: int | None = None, name: str = ""
    ) -> list[Piece[Any]]:
        """Return the cases of a kind, each with a seed and some of its numbers: see `portions`."""
        from tunenet_logs.analysis.parallel import Piece

        portions = self.portions(size, targets)
        return [Piece((*kind, seed, some), len(some), name) for seed, some in portions]

    def portions(self, size: int, targets: int | None = None) -> list[tuple[int, range]]:
        """Split each seed's numbers: few a portion, so that the processes end together."""
        count = self.targets if targets is None else targets
        return [
            (seed, range(at, min(at + size, count)))
            for seed in self.seeds
            for at in range(0, count, size)
        ]


@dataclass(frozen=True)
class Part:
    """Results of a section: what is printed, and what is written to files."""

    section: str  # "" where a study has one table alone
    text: str
    rows: Sequence[Row] = ()  # flat but for lists, which CSV leaves out
    # of JSON alone: further lists by name
    more: Mapping[str, Sequence[Row]] = field(default_factory=dict[str, Sequence[Row]])
    # writers of the study's other files, by their forms
    writers: Mapping[str, Callable[[Path, str], None]] = field(
        default_factory=dict[str, Callable[[Path, str], None]]
    )


Run = Callable[[Order, Progress], Iterator[Part]]  # of a study's module


def scored(
    score: Callable[[Case], Iterable[Score]],
    cases: Mapping[Label, Sequence[Piece[Case]]],
    order: Order,
    progress: Progress,
    what: tuple[str, str],
) -> dict[Label, list[Score]]:
    """Score all cases in processes; return the scores of each label, in the order of its cases.

    Args:
        score: function of a module, from a case to its scores.
        cases: cases by label, of a table's line as a rule.
        order: whose jobs are used; they change nothing but the time.
        progress: gets a bar of the verb and the unit `what`.
        what: the verb and the unit.
    """
    from tunenet_logs.analysis.parallel import parallel_map

    pieces = list(chain.from_iterable(cases.values()))
    done = iter(parallel_map(score, pieces, order.jobs, progress, what))
    return {label: [one for _ in some for one in next(done)] for label, some in cases.items()}


# ---- Figures of many scores.


def figure(
    values: Iterable[float] | np.ndarray, of: Callable[[np.ndarray], Any] | None = None
) -> float | None:
    """Return a figure of those values that are finite, the mean if none is named; None of none."""
    import numpy as np

    known = np.asarray(values, float)
    known = known[np.isfinite(known)]
    return float((of or np.mean)(known)) if len(known) else None


def holds(low: np.ndarray, high: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return 1 where an interval holds the truth, 0 where not, NaN where there is no interval."""
    import numpy as np

    inside = (low <= truth) & (truth <= high)
    return np.where(np.isfinite(low) & np.isfinite(truth), inside, np.nan)


# ---- Tables for a terminal.

NEGLIGIBLE = 1e-9  # an error below this is rounding of float64, and is written as none
# An error keeps two digits: in four decimals from the first on, below it in five, and below the
# second in scientific notation (0.000949 is .00095, 0.0000949 is 9.5e-5).
_FOUR_DIGITS_FROM = 0.00095
_SCIENTIFIC_BELOW = 0.000095


def short(error: float | None) -> str:
    """Format an error in at most 6 characters: four decimals, or two digits if it is less."""
    if error is None:
        return "-"
    if error < NEGLIGIBLE:
        return "<1e-9"
    if error < _SCIENTIFIC_BELOW:
        return f"{error:.1e}".replace("e-0", "e-")
    return f"{error:.{4 if error >= _FOUR_DIGITS_FROM else 5}f}".removeprefix("0")


def decimals(value: float | None, digits: int = 1) -> str:
    """Format with so many decimals; a dash for None."""
    return "-" if value is None else f"{value:.{digits}f}"


def percent(fraction: float | None, digits: int = 1) -> str:
    """Format a fraction in percent; a dash for None."""
    return decimals(None if fraction is None else 100 * fraction, digits)


def table(lines: Iterable[Sequence[str]], title: str = "") -> str:
    """Left-align columns, two spaces apart, below a title; a cell may reach over empty ones."""
    rows = [list(cells) for cells in lines]
    starts = [0]
    for at in range(max(map(len, rows), default=0)):
        # what nothing stands beside needs no room
        cells = [row[at] for row in rows if any(row[at + 1 : at + 2])]
        starts.append(starts[-1] + max(map(len, cells), default=0) + 2)
    text = [title] if title else []
    for row in rows:
        line = ""
        for start, cell in zip(starts, row, strict=False):
            if cell:
                line = (
                    f"{line}  {cell}" if len(line) > max(start - 2, 0) else f"{line:{start}}{cell}"
                )
        text.append(line)
    return "\n".join(text)


Columns = Sequence[tuple[str, Callable[[Any], str]]]  # heads, and what stands below for a row


def shown(columns: Columns, rows: Iterable[Any]) -> list[list[str]]:
    """Return the lines of a `table`: the heads, and below them each row."""
    heads = [head for head, _ in columns]
    return [heads, *([show(row) for _, show in columns] for row in rows)]


def listed(rows: Sequence[Row], title: str = "") -> str:
    """Tabulate rows as they are: their names above them, numbers in four digits."""
    names = list(rows[0]) if rows else []
    lines = [[str(_cell(row[name])) for name in names] for row in rows]
    return table([[name.replace("_", " ") for name in names], *lines], title)


def _cell(value: Any) -> Any:
    return "-" if value is None else f"{value:.4g}" if isinstance(value, float) else value


# ---- Files: whole or not there, marked with the study that they are of.

_KIND = "figures"
_MADE_BY = "tunenet_eval"  # the first column of every table: the study


def figure_place(study: str, form: str, path: Path, *, overwrite: bool) -> OutputPlace:
    """Return where a file goes; see `OutputPlace`. `form` is one of `Study.files`."""
    from tunenet_logs.analysis.result_files import marked, recording
    from tunenet_logs.analysis.result_files import table as csv_table
    from tunenet_logs.writing.owned_path import OutputPlace

    logs = {study: study}
    knows = {
        "json": lambda: marked("json", _KIND, logs),
        "png": lambda: marked("png", _KIND, logs),
        "rrd": lambda: recording("eval drop", ""),
        "csv": lambda: csv_table([_MADE_BY], lambda row: row[_MADE_BY].replace(study, "") or None),
    }[form]()
    return OutputPlace(
        path, "file of figures", knows, study, f"give --{form} another file", overwrite
    )


def write_figures(
    study: str, order: Order, parts: Sequence[Part], form: str, place: OutputPlace
) -> None:
    """Write the results of a study in one of its forms; JSON may go to standard output."""
    from tunenet_logs.analysis.result_files import mark, write_json

    marked_by = mark(_KIND, {study: study})
    if form == "json":
        content: dict[str, Any] = {
            "made": marked_by,
            "experiment": study,
            "seeds": list(order.seeds),
            "targets": order.targets,
            "rows": [_record(part, row) for part in parts for row in part.rows],
        }
        for part in parts:
            content |= {name: list(map(_plain, rows)) for name, rows in part.more.items()}
        text = json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False)
        write_json(place, text + "\n")
        return
    with place.replacing() as partial:
        if form == "csv":
            partial.write_text(csv_text(study, parts), "utf-8")
        else:
            next(part.writers[form] for part in parts if form in part.writers)(partial, marked_by)


def csv_text(study: str, parts: Sequence[Part]) -> str:
    """Format one line a row, the study first; lists are left out, None is an empty field."""
    rows = [_record(part, row) for part in parts for row in part.rows]
    names = dict.fromkeys(
        name for row in rows for name, value in row.items() if not isinstance(value, (list, dict))
    )
    lines = ([study, *(row.get(name) for name in names)] for row in rows)
    return csv_line([_MADE_BY, *names]) + "".join(map(csv_line, lines))


def _record(part: Part, row: Row) -> Row:
    return {**({"section": part.section} if part.section else {}), **_plain(row)}


def _plain(value: Any) -> Any:
    """Return what JSON has for a value: null for NaN, lists and dictionaries for the rest."""
    if is_dataclass(value):
        value = {each.name: getattr(value, each.name) for each in fields_of(value)}
    if isinstance(value, Mapping):
        return {str(name): _plain(each) for name, each in value.items()}
    if hasattr(value, "tolist"):  # of NumPy
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def chosen_names(listed: str | None, option: str, available: Iterable[str]) -> tuple[str, ...]:
    """Return the names that an option lists, in the order of all; all where it is not given.

    Raises:
        UsageError: it lists none, or one that there is not.
    """
    known = tuple(available)
    if listed is None:
        return known
    names = tuple(filter(None, (name.strip() for name in listed.split(","))))
    if not names:
        raise UsageError(f"--{option} names none; there is: {', '.join(known)}")
    for name in names:
        if name not in known:
            raise UsageError(f"--{option}: no {name!r}; there is: {', '.join(known)}")
    return names
