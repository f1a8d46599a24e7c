"""Tune logs in other units, clocks and orientations than they say.

    python -m tests.bench.lab_units --logs 1000 --seed 1

Each log is one integrated drop (`tests.bench.lab_drops`), as poses, whose message names metres, or
as a table `t,x,y,z`, which names nothing. Counted are failures of four kinds: a value that is
neither within its interval nor within .01 of the truth; `units` that are neither right nor null; a
unit that contradicts the log's word without a verdict `suspect` that names it; and a verdict `ok`
with the first impact's speed more than 5 % off.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from tests.bench.lab_drops import VERDICTS, LabDrop, random_drop
from tests.export_writers import oriented
from tests.strangers import write_poses
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import to_json
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Array, Episode, EpisodeInfo, Signal

_SEEDS = 29_000_000  # logs are drawn from these and a seed: nothing was chosen on them
# How far a value may be off, and by which fraction a speed, a unit of length and a rate.
_NEAR, _SPEED, _LENGTH, _RATE = 0.01, 0.05, 0.01, 0.02

_FILE_EVERY = 8  # logs of poses of which one goes through a file
Stamps = NDArray[np.int64]  # in ns, shape (T,)


@dataclass(frozen=True)
class Kind:
    """Kind of modification of a log."""

    is_pose: bool  # whether metres are named; else nothing is
    length_m: float | None = 1.0  # metres in one of its units; None for pixels of a drawn scale
    clock: float = 1.0  # seconds of the log for each true one
    up: str = "z"  # which axis is up, see `oriented`
    tilt_deg: float = 0.0  # of a table's or camera's frame off the vertical
    # What a reason has to say, one of these; () where the log is as it says.
    named: tuple[str, ...] = ()


_LENGTHS = {"mm": 0.001, "cm": 0.01, "ft": 0.3048, "in": 0.0254}

# By their line in the table.
KINDS: Mapping[str, Kind] = {
    "poses, m": Kind(True),
    **{
        f"poses, {unit}": Kind(True, size, named=(f"in {unit}",)) for unit, size in _LENGTHS.items()
    },
    "poses, px": Kind(True, None, named=("pixels", "lengths are in")),
    "poses, ms for s": Kind(True, clock=1000.0, named=("stamps are in ms",)),
    "poses, z down": Kind(True, up="-z"),
    "poses, y up": Kind(True, up="y"),
    "poses, 25 degrees": Kind(True, tilt_deg=25.0),
    **{
        f"poses, {times} times slow": Kind(True, clock=float(times), named=("clock",))
        for times in (2, 4, 8)
    },
    "table, m": Kind(False),
    **{f"table, {unit}": Kind(False, size) for unit, size in _LENGTHS.items()},
    "table, px": Kind(False, None),
    "table, ms for s": Kind(False, clock=1000.0),
    "table, z down": Kind(False, up="-z"),
    "table, y up": Kind(False, up="y"),
    "table, 25 degrees": Kind(False, tilt_deg=25.0),
    **{f"table, {times} times slow": Kind(False, clock=float(times)) for times in (2, 4, 8)},
}


@dataclass(frozen=True)
class Answer:
    """Answer to one log."""

    kind: str
    index: int
    verdict: str
    off: float  # of the restitution; NaN where it was rejected
    held: bool | None  # whether its interval holds the truth; None without an interval
    speed_off: float  # of the first impact, as a fraction; NaN where none is reported
    failures: tuple[str, ...]  # in words


def made_log(kind: Kind, rng: np.random.Generator) -> tuple[LabDrop, float, Stamps, Array]:
    """Draw a drop, metres in the log's unit, its stamps [ns] and places in its unit."""
    drop = random_drop(rng, most_unseen=0.02)
    length_m = kind.length_m or 1 / float(np.exp(rng.uniform(np.log(150), np.log(3000))))
    places = oriented(drop.xyz_m, kind.up)
    if kind.tilt_deg:
        places = places @ _tilt(rng, kind.tilt_deg).T
    if kind.length_m is None:
        places = places + rng.uniform(0.0, 1.0, 3)
    stamps_ns = np.round(drop.seconds[drop.seen] * kind.clock * 1e9).astype(np.int64)
    return drop, length_m, stamps_ns, places[drop.seen] / length_m


def _tilt(rng: np.random.Generator, degrees: float) -> Array:
    """Return a rotation about a random horizontal axis, shape (3, 3)."""
    heading, angle = rng.uniform(0, 2 * np.pi), np.radians(degrees)
    x, y = np.cos(heading), np.sin(heading)
    cross = np.array([[0, 0, y], [0, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def told_of(
    kind: Kind, stamps_ns: Stamps, places: Array, folder: Path, *, is_file: bool
) -> dict[str, Any]:
    """Return the JSON of a tuning."""
    if kind.is_pose and not is_file:
        signal = Signal("/ball/pose", stamps_ns, places, ("x", "y", "z"), "m")
        episode = Episode(EpisodeInfo(), {signal.name: signal})
        return json.loads(to_json(record_of(tune_episode(episode, TuneOptions()))))
    path = folder / ("log.mcap" if kind.is_pose else "log.csv")
    if kind.is_pose:
        write_poses(path, stamps_ns + 1_700_000_000_000_000_000, places)
    else:
        rows = ["t,x,y,z"]
        for stamp, place in zip(stamps_ns, places, strict=True):
            rows.append(f"{stamp / 1e9:.9f}," + ",".join(f"{one:.9g}" for one in place))
        path.write_text("\n".join(rows) + "\n")
    return json.loads(to_json(record_of(tune_log(path, TuneOptions()))))


def answer_to(name: str, seed: int, index: int, folder: Path) -> Answer:
    """Tune one log of a kind of `KINDS`."""
    kind, rng = KINDS[name], np.random.default_rng([_SEEDS, seed, index])
    drop, length_m, stamps_ns, places = made_log(kind, rng)
    is_file = index // len(KINDS) % _FILE_EVERY == 0
    try:
        told = told_of(kind, stamps_ns, places, folder, is_file=is_file)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is counted and named
        words = f"CRASH: {type(error).__name__}: {error}"
        return Answer(name, index, "rejected", np.nan, None, np.nan, (words,))
    verdict, reason = told["verdict"], told["reason"] or ""
    found = (told["parameters"] or {}).get("restitution")
    if found is None:
        said = (f"rejected: {reason}",)
        return Answer(name, index, verdict, np.nan, None, np.nan, said)
    value, ends = found["value"], found["interval95"]
    held = None if ends is None else bool(ends[0] <= drop.restitution <= ends[1])
    off = abs(value - drop.restitution)
    speeds = [one["impact_speed"] for one in told["bounces"][:1]]
    speed_off = np.nan if speeds in ([], [None]) else speeds[0] / drop.impact_speed_m_s - 1
    failures: list[str] = []
    if off > _NEAR and not held:
        failures.append(f"value {value:.4f}, made with {drop.restitution:.4f} ({verdict})")
    if verdict == "ok" and abs(speed_off) > _SPEED:
        failures.append(f"WRONG SPEED and ok: {100 * speed_off:+.0f} %")
    if kind.named and (verdict != "suspect" or not any(word in reason for word in kind.named)):
        failures.append(f"{verdict}, and no word of {kind.named[0]!r}: {reason[:150]}")
    true_rate_hz = drop.rate_hz if kind.clock >= 1000 else drop.rate_hz / kind.clock
    failures += _wrong_units(told["units"], length_m, (drop.rate_hz, true_rate_hz), verdict)
    return Answer(name, index, verdict, off, held, speed_off, tuple(failures))


def _wrong_units(
    units: Mapping[str, Any] | None, length_m: float, rates_hz: Sequence[float], verdict: str
) -> list[str]:
    """List what `units` says that is not so; nothing counts that a verdict doubts."""
    if units is None or verdict != "ok":
        return []
    wrong = []
    told_m, told_hz = units["length_m"], units["rate_hz"]
    if told_m is not None and abs(told_m / length_m - 1) > _LENGTH:
        wrong.append(f"WRONG UNIT and ok: {told_m:g} m ({units['length_by']}), not {length_m:g}")
    if told_hz is not None and not any(abs(told_hz / one - 1) < _RATE for one in rates_hz):
        wrong.append(f"WRONG RATE and ok: {told_hz:g} Hz ({units['rate_by']}), not {rates_hz[0]:g}")
    return wrong


def table_of(answers: Sequence[Answer]) -> str:
    """Tabulate a line for each kind."""
    lines = [
        f"{'log':24} {'logs':>4} {'ok':>4} {'susp.':>5} {'rej.':>4} {'MAE':>7} {'worst':>7} "
        f"{'held %':>6} {'speed told':>10} {'wrong speed, ok':>15} {'wrong unit, ok':>14} "
        f"{'failures':>8}"
    ]
    for name in [*KINDS, "all"]:
        those = [one for one in answers if name in ("all", one.kind)]
        if not those:
            continue
        counts = [sum(one.verdict == word for one in those) for word in VERDICTS]
        off = np.array([one.off for one in those if not np.isnan(one.off)] or [np.nan])
        held = [one.held for one in those if one.held is not None]
        speeds = sum(not np.isnan(one.speed_off) for one in those)
        wrong = [
            sum(any(word in words for words in one.failures) for one in those)
            for word in ("WRONG SPEED", "WRONG UNIT", "")
        ]
        share = 100 * np.mean(held) if held else np.nan
        lines.append(
            f"{name:24} {len(those):4} {counts[0]:4} {counts[1]:5} {counts[2]:4} "
            f"{off.mean():7.4f} {off.max():7.4f} {share:6.1f} {speeds:10} {wrong[0]:15} "
            f"{wrong[1]:14} {wrong[2]:8}"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--logs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=int, metavar="LOG", help="this one")
    arguments = parser.parse_args()
    names = list(KINDS)
    logs = range(arguments.logs) if arguments.only is None else [arguments.only]
    with tempfile.TemporaryDirectory() as folder:
        answers = [
            answer_to(names[index % len(names)], arguments.seed, index, Path(folder))
            for index in tqdm(logs, unit="log", disable=None)
        ]
    print(table_of(answers))
    for one in answers:
        for words in one.failures:
            print(f"{one.kind}, --seed {arguments.seed} --only {one.index}: {words}")


if __name__ == "__main__":
    main()
