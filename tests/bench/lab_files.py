"""Tune files as laboratories export them, each beside the same drop as a plain table.

    python -m tests.bench.lab_files --drops 400 --seed 1

A drop is integrated (`tests.bench.lab_drops`: air, a restitution that falls with speed, sideways
drift, .4 to 2 m, 60 to 360 Hz, .2 to 2 mm of noise, up to 30 % of the samples missing, in a third
of the drops in gaps too). It is written in a layout with a unit, an orientation and other choices
at random, and as `t [s],x [m],y [m],z [m]`. Both are tuned. The value of the layout has to be that
of the table within a tenth of the table's 95 % interval; it is wrong if it is more than three half
widths of its own interval from the truth. Of one drop in 20 the layout holds other bodies too, that
stand still or are waved by hand, once with the ball and once without it.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from tests.bench.lab_drops import VERDICTS, LabDrop, hand_waved, random_drop, still
from tests.bench.lab_layouts import LAYOUTS, OF_BODIES, Written, write_layout, write_plain
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log

_SEEDS = 23_000_000  # drops are drawn from these and a seed: nothing was chosen on them
# Share of an interval's width that is the same, half widths that are wrong, and the width that is
# taken where a value has no interval.
_SAME, _WRONG, _TYPICAL = 0.1, 3.0, 0.02

_BODIES_EVERY = 20

_ANOTHER = 0.05  # distance from the truth from which on it was not the ball that was looked at


@dataclass(frozen=True)
class Outcome:
    """Result for one file."""

    layout: str  # and, of several bodies, what they were
    how: str  # what was drawn, in words, with the drop's number
    verdict: str  # of the file, and of the table beside it
    plain: str
    apart: float  # distance of the values in widths of the table's interval; NaN without both
    off: float  # distance from the truth in half widths; NaN without a value
    failures: tuple[str, ...]  # in words


def tuned(path: Path) -> Tuning:
    """Tune a file; an error that is no one's fault but the tuner's is a finding too."""
    try:
        return tune_log(path, TuneOptions())
    except Exception as error:  # noqa: BLE001 - whatever it is, it is counted and named
        words = f"CRASH: {type(error).__name__}: {error}"
        return Tuning(path, None, "default", "rejected", words)


def outcome_of(seed: int, index: int, folder: Path) -> Outcome:
    """Tune one drop in one layout and as a plain table."""
    rng = np.random.default_rng([_SEEDS, seed, index])
    layout = list(LAYOUTS)[index % len(LAYOUTS)]
    most = float(rng.choice([0.02, 0.3]))
    drop = random_drop(rng, most_unseen=most, with_gaps=bool(rng.random() < 1 / 3))
    written = write_layout(layout, rng, drop, folder)
    write_plain(folder / "plain.csv", drop)
    found, plain = tuned(written.path), tuned(folder / "plain.csv")
    return _compared(layout, f"drop {index}: {written.how}", written, found, plain, drop)


def _compared(
    layout: str, how: str, written: Written, found: Tuning, plain: Tuning, drop: LabDrop
) -> Outcome:
    value, usual = _value(found), _value(plain)
    width = _width(plain)
    apart, off = abs(value - usual) / width, abs(value - drop.restitution) / (_width(found) / 2)
    failures: list[str] = []
    if found.verdict == "ok" and off > _WRONG:
        failures.append(f"WRONG and ok: {value:.4f}, made with {drop.restitution:.4f}")
    if np.isnan(value) and (not np.isnan(usual) or "CRASH" in (found.reason or "")):
        failures.append(f"rejected: {found.reason}")
    if apart > _SAME and written.tells_metres:
        failures.append(f"{value:.4f}, not {usual:.4f} as the table: {apart:.2f} widths")
    if found.verdict == "suspect" and plain.verdict == "ok":
        failures.append(f"suspect, the table is ok: {found.reason}")
    kind = layout if written.tells_metres else f"{layout} (no metres or no rate)"
    return Outcome(kind, how, found.verdict, plain.verdict, apart, off, tuple(failures))


def bodies_of(seed: int, index: int, folder: Path) -> list[Outcome]:
    """Tune bodies of which one is a ball or none is."""
    rng = np.random.default_rng([_SEEDS, seed, index, 1])
    drop = random_drop(rng)
    layout = OF_BODIES[index % len(OF_BODIES)]
    others = [
        hand_waved(rng, drop.seconds),
        still(rng, drop.seconds),
        hand_waved(rng, drop.seconds),
    ]
    outcomes = []
    for what, places in (("with a ball", [*others[1:], drop.xyz_m]), ("without a ball", others)):
        order = rng.permutation(len(places))
        bodies = {"ABC"[at]: places[number] for at, number in enumerate(order)}
        written = write_layout(layout, rng, drop, folder, bodies)
        found = tuned(written.path)
        value, failures = _value(found), []
        off = abs(value - drop.restitution) / (_width(found) / 2)
        if (found.reason or "").startswith("CRASH"):
            failures.append(f"{what}, {found.reason}")
        elif what == "without a ball" and found.verdict == "ok":
            failures.append(f"WRONG and ok: {value:.4f} of {found.detection.topic}, no ball")
        elif what == "with a ball" and not (
            off < _WRONG and abs(value - drop.restitution) < _ANOTHER
        ):
            failures.append(f"{value:.4f}, made with {drop.restitution:.4f}: {found.reason}")
        how = f"drop {index}, {layout}: {written.how}"
        outcomes.append(
            Outcome(f"bodies, {what}", how, found.verdict, "", np.nan, off, tuple(failures))
        )
    return outcomes


def _value(tuning: Tuning) -> float:
    return np.nan if tuning.estimate is None else float(tuning.estimate[0])


def _width(tuning: Tuning) -> float:
    """Return the width of a fit's 95 % interval, reported or not."""
    fit = tuning.trace.fit if tuning.trace else None
    return float(np.ptp(fit.interval95[0])) if fit else _TYPICAL


def table_of(outcomes: Sequence[Outcome]) -> str:
    """Tabulate a line for each layout."""
    lines = [
        f"{'layout':42} {'files':>5} {'ok':>4} {'susp.':>5} {'rej.':>4} {'table ok':>8} "
        f"{'apart: median':>13} {'worst':>7} {'wrong and ok':>12}"
    ]
    for layout in [*dict.fromkeys(sorted(one.layout for one in outcomes)), "all"]:
        those = [one for one in outcomes if layout in ("all", one.layout)]
        counts = [sum(one.verdict == word for one in those) for word in VERDICTS]
        apart = [one.apart for one in those if not np.isnan(one.apart)] or [np.nan]
        wrong = sum("WRONG" in words for one in those for words in one.failures)
        plain = sum(one.plain == "ok" for one in those)
        lines.append(
            f"{layout:42} {len(those):5} {counts[0]:4} {counts[1]:5} {counts[2]:4} {plain:8} "
            f"{np.median(apart):13.4f} {max(apart):7.3f} {wrong:12}"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drops", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, metavar="DROP", help="this one, and keep its files")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        if arguments.only is not None:
            folder = Path(tempfile.mkdtemp(prefix="lab_files_"))
            print(folder, outcome_of(arguments.seed, arguments.only, folder))
            return
        outcomes: list[Outcome] = []
        for index in tqdm(range(arguments.drops), unit="drop", disable=None):
            outcomes.append(outcome_of(arguments.seed, index, Path(name)))
            if index % _BODIES_EVERY == 0:
                at = index // _BODIES_EVERY
                outcomes += bodies_of(arguments.seed, at, Path(name))
    print(table_of(outcomes))
    for one in outcomes:
        for words in one.failures:
            print(f"{one.layout}; {one.how}\n    {words}")


if __name__ == "__main__":
    main()
