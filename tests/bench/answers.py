"""Compare the answers of `tunenet-tune` to a fixed set of logs between versions.

    python -m tests.bench.answers --write DIR     tune the set, keep its logs and answers in DIR
    python -m tests.bench.answers --compare DIR   tune the same logs again: what has changed?

The set: the samples, the recordings of others where they are there, 60 made logs of positions,
20 rendered films, 20 payloads with a tare, the sample campaign. Only the commands and their JSON
are used, so that nothing here depends on how the inside is cut.

A value has moved if it differs by more than a tenth of the half width of its interval before (where
it had none, of the median half width of its group). `--compare` ends with 1 if anything changed.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import redirect_stdout
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from tests import strangers
from tests.bench import BIN, REAL, SAMPLES, kept_or_compared
from tunenet_logs.analysis.evaluation.study import listed
from tunenet_logs.analysis.evaluation.worlds.ball import RealBall, drop_ball
from tunenet_logs.episode import Array
from tunenet_logs.recorders.cli import main as record

# ---- Comparison of two sets of answers to the same logs.

MOVED = 0.1  # share of the half width of an interval by which a value may differ
_EXACT = 1e-9  # largest difference of values in a group without any interval


@dataclass(frozen=True)
class Answer:
    """Answer to one log."""

    group: str  # the line of the table that it counts in
    sha256: str  # of the log
    truth: float | None  # of the first parameter; None where nobody knows
    verdict: str
    reason: str
    # By parameter, a number or a list of them; none for a rejected log.
    values: Mapping[str, float | list[float]]
    intervals: Mapping[str, list | None]  # 95 %, likewise; None where none was given
    failed: Sequence[str]  # names of the checks that it did not pass

    def half_widths(self, name: str) -> list[float]:
        """Return half the width of a parameter's interval, for each of its numbers; [] without."""
        ends = self.intervals[name]
        return [] if ends is None else (np.ptp(np.reshape(ends, (-1, 2)), axis=1) / 2).tolist()

    @property
    def error(self) -> float:
        """Absolute error of the first parameter; NaN where that is unknown."""
        if self.truth is None or not self.values:
            return np.nan
        return abs(float(np.ravel(next(iter(self.values.values())))[0]) - self.truth)

    @property
    def covers(self) -> float:
        """Whether its interval holds the truth, 1 or 0; NaN where either is missing."""
        ends = next(iter(self.intervals.values()), None)
        if self.truth is None or ends is None:
            return np.nan
        low, high = np.reshape(ends, (-1, 2))[0]
        return float(low <= self.truth <= high)


Named = Mapping[str, Answer]


def compared(before: Named, after: Named) -> tuple[str, bool]:
    """Tabulate the pairs and the changes, log by log; return whether there are none."""
    rows, changes = [], []
    for group in dict.fromkeys(one.group for one in before.values()):
        first = {log: one for log, one in before.items() if one.group == group}
        found = list(_changes(first, after))
        changes += [f"{log}: {text}" for log, text in found]
        errors, covers = (
            np.array([[getattr(one[log], what) for log in first] for one in (first, after)])
            for what in ("error", "covers")
        )
        known = errors[:, np.isfinite(errors).all(axis=0)]
        rows.append({
            "logs": group,
            "of": len(first),
            "changed": len({log for log, _ in found}),
            "error before": _mean(known[0]),
            "error after": _mean(known[1]),
            "difference": _mean(known[1] - known[0]),
            "interval holds before": _mean(covers[0], 100.0),
            "holds after": _mean(covers[1], 100.0),
        })  # fmt: skip
    return "\n".join([listed(rows), "", *(changes or ["no change"])]), not changes


def _changes(before: Named, after: Named) -> Iterator[tuple[str, str]]:
    """List what differs in one group: verdicts, failed checks, values."""
    widths: dict[str, list[float]] = defaultdict(list)
    for one in before.values():
        for name in one.values:
            widths[name] += one.half_widths(name)
    usual = {name: float(np.median(of)) for name, of in widths.items() if of}
    for log, old in before.items():
        new = after[log]
        if old.verdict != new.verdict:
            yield log, f"{old.verdict} is {new.verdict} now: {new.reason or old.reason}"
        else:
            if list(old.failed) != list(new.failed):
                yield log, f"failed {list(old.failed)}, now {list(new.failed)}"
            if old.values.keys() != new.values.keys():
                yield log, f"told {sorted(old.values)}, now {sorted(new.values)}"
        for name in old.values.keys() & new.values.keys():
            first, second = (np.ravel(one.values[name]) for one in (old, new))
            limit = np.array(old.half_widths(name) or usual.get(name, _EXACT / MOVED))
            if len(first) != len(second) or (np.abs(second - first) > MOVED * limit).any():
                told = [", ".join(f"{value:.6g}" for value in one) for one in (first, second)]
                yield log, f"{name} {told[0]} is {told[1]} now"


def _mean(values: Array, scale: float = 1.0) -> str:
    """Format the mean of what is known with its standard error; in percent for a scale of 100."""
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return "-"
    mean, error = values.mean() * scale, values.std(ddof=1) / np.sqrt(len(values)) * scale
    return f"{mean:.1f} ± {error:.1f} %" if scale != 1 else f"{mean:.5f} ± {error:.5f}"


# ---- The fixed set of logs, with their sources and truths.
# The made ones are written once and kept, so that a later run tunes the same bytes whatever has
# become of the code that made them. Balls among positions come from generators that share no code
# with the fit; films and payloads are recorded by `tunenet-record`.

TARES = {"payload": SAMPLES / "payload_empty.mcap"}

IDEAL, NOT_IDEAL, FILMS, PAYLOADS = 40, 20, 20, 20
SEED = 17_000
_NO_LOGS = {".md", ".txt.gz", ".urdf", ".yaml", ""}
_BALL_START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class FixedLog:
    """Log of the set."""

    name: str  # its key, the same in every run
    group: str  # the line of the table that it counts in
    path: Path
    # The first parameter as the log was made with; None where nobody knows.
    truth: float | None = None
    tare: Path | None = None  # the empty run that goes with it


def given_logs() -> list[FixedLog]:
    """List the samples, and the recordings that others made where they are there."""
    truths = {"bouncy": 0.85, "dull": 0.35, "noisy": 0.62, "filmed": 0.74, "payload": 0.8}
    samples = [
        FixedLog(
            f"samples/{path.name}", "samples", path, truths.get(path.stem), TARES.get(path.stem)
        )
        for path in sorted(SAMPLES.glob("*.mcap"))
    ]
    return samples + [
        FixedLog(f"real/{path.relative_to(REAL)}", "real", path) for path in _recordings(REAL)
    ]


def _recordings(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder, a bag's own folder as one."""
    for path in sorted(folder.iterdir()) if folder.is_dir() else ():
        if path.is_dir() and not (path / "metadata.yaml").exists():
            yield from _recordings(path) if path.name != "licences" else ()
        elif path.is_dir() or (path.suffix not in _NO_LOGS and path.stem != "README"):
            yield path


def make_logs(folder: Path) -> list[FixedLog]:
    """Write the made logs to `folder`."""
    folder.mkdir(parents=True)
    makers = ((IDEAL, _ideal), (NOT_IDEAL, _not_ideal), (FILMS, _film), (PAYLOADS, _payload))
    return [make(folder, index) for count, make in makers for index in range(count)]


_FORMATS: tuple[tuple[str, Callable[..., object]], ...] = (
    ("mcap", strangers.write_poses),
    ("mcap", strangers.write_ros1),
    ("mcap", strangers.write_protobuf),
    ("mcap", strangers.write_json),
    ("csv", strangers.write_table),
    ("bag", strangers.write_poses_bag),
)


def _ideal(folder: Path, index: int) -> FixedLog:
    """Write an ideal ball as another laboratory records it, each format in turn."""
    rng = np.random.default_rng([SEED, 1, index])
    truth = float(rng.uniform(0.2, 0.92))
    ball = strangers.Stranger(
        truth,
        gap_m=float(rng.uniform(0.3, 2.0)),
        rate_hz=float(rng.choice([60, 120, 240])),
        hold_s=float(rng.uniform(0.2, 1.0)),
        noise_m=float(rng.choice([0.0, 0.001, 0.005])),
        seed=index,
    )
    suffix, write = _FORMATS[index % len(_FORMATS)]
    path = folder / f"ideal_{index:02}.{suffix}"
    write(path, *ball.samples())
    return FixedLog(path.name, "positions, ideal balls", path, truth)


def _not_ideal(folder: Path, index: int) -> FixedLog:
    """Write a ball in air whose restitution falls with speed, 1 mm of noise."""
    rng = np.random.default_rng([SEED, 2, index])
    truth = float(rng.uniform(0.3, 0.92))
    ball = RealBall(
        drop_m=float(rng.uniform(0.3, 2.0)),
        restitution=truth,
        slope=float(rng.uniform(0.0, 0.12)),
        drag_1_m=float(np.exp(rng.uniform(np.log(0.003), np.log(0.18)))),
    )
    seconds = np.arange(480) / 120.0 - 0.4
    heights_m = drop_ball(ball, seconds).heights_m
    positions_m = np.column_stack([np.zeros((len(seconds), 2)), heights_m])
    positions_m += rng.normal(0.0, 0.001, positions_m.shape)
    path = folder / f"not_ideal_{index:02}.mcap"
    stamps_ns = _BALL_START_NS + np.round(seconds * 1e9).astype(np.int64)
    strangers.write_poses(path, stamps_ns, positions_m)
    return FixedLog(path.name, "positions, air and slope", path, truth)


def _film(folder: Path, index: int) -> FixedLog:
    """Write a rendered film by the paper's random camera."""
    rng = np.random.default_rng([SEED, 3, index])
    truth = round(float(rng.uniform(0.2, 0.92)), 4)
    path = folder / f"film_{index:02}.mcap"
    _recorded(
        path,
        *("--simulate", "drop", "--render", "--restitution", truth, "--seed", SEED + index),
        *("--rate", rng.choice([60, 90]), "--seconds", 2.2, "--hold", 0.3),
        *("--blur", rng.choice([0, 2, 6]), "--lost", rng.choice([0, 0, 0.03])),
    )
    return FixedLog(path.name, "films", path, truth)


def _payload(folder: Path, index: int) -> FixedLog:
    """Write a payload as a real arm's driver reports it, and a run with an empty gripper."""
    rng = np.random.default_rng([SEED, 4, index])
    truth = round(float(rng.uniform(0.05, 1.5)), 4)
    path, tare = (folder / f"{kind}_{index:02}.mcap" for kind in ("payload", "tare"))
    run = ("--simulate", "payload", "--driver", "--seconds", 5, "--seed", SEED + index)
    run = (*run, "--path", ("circle", "random")[index % 2])
    _recorded(path, *run, "--mass", truth)
    _recorded(tare, *run, "--empty")
    return FixedLog(path.name, "payloads with a tare", path, truth, tare)


def _recorded(path: Path, *words: object) -> None:
    with redirect_stdout(io.StringIO()):
        code = record([*map(str, words), "-o", str(path), "--quiet"])
    if code != 0:
        raise RuntimeError(f"tunenet-record ended with {code} for {path.name}")


# ---- Tuning them, by the commands.

LOGS, ANSWERS = "logs", "answers.json"
_MAX_S = 900


def tuned(log: FixedLog) -> Answer:
    """Tune one log in a process of its own."""
    tare = [] if log.tare is None else ["--tare", log.tare]
    with tempfile.TemporaryDirectory() as folder:
        done = _run("tunenet-tune", log.path, *tare, "-o", folder, "--jobs", "1")
        reports = list(Path(folder).glob("*.json"))
        told: dict[str, Any] = json.loads(reports[0].read_text()) if reports else {}
    reason = told.get("reason") or ("" if told else done.stderr.strip().splitlines()[-1])
    parameters = told.get("parameters") or {}
    return Answer(
        group=log.group,
        sha256=_digest(log.path),
        truth=log.truth,
        verdict=told.get("verdict", f"exit code {done.returncode}"),
        reason=reason.replace(str(log.path), log.name),
        values={name: one["value"] for name, one in parameters.items()},
        intervals={name: one["interval95"] for name, one in parameters.items()},
        failed=sorted(one["name"] for one in told.get("checks", ()) if not one["passed"]),
    )


def _run(name: str, *words: object) -> subprocess.CompletedProcess[str]:
    command = [str(BIN / name), *map(str, words), "--quiet"]
    return subprocess.run(command, check=False, capture_output=True, text=True, timeout=_MAX_S)


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file, or of all files of a folder."""
    files = sorted(path.rglob("*")) if path.is_dir() else [path]
    return hashlib.sha256(b"".join(one.read_bytes() for one in files if one.is_file())).hexdigest()


def campaign_words() -> str:
    """Return what `tunenet-review` prints of the sample campaign, without paths."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "campaign"
        shutil.copytree(SAMPLES / "campaign", folder)
        done = _run("tunenet-review", folder, "-o", folder / "all.rrd")
        return (done.stdout + done.stderr).replace(str(folder), "campaign")


def answers_to(logs: Sequence[FixedLog], jobs: int) -> tuple[dict[str, Answer], str]:
    """Tune every log, `jobs` at a time; return the answers by name, and the campaign's words."""
    with ThreadPoolExecutor(jobs) as pool:
        campaign = pool.submit(campaign_words)
        found = list(tqdm(pool.map(tuned, logs), "tuning", len(logs), unit="log", disable=None))
        return {log.name: one for log, one in zip(logs, found, strict=True)}, campaign.result()


def write(folder: Path, jobs: int) -> None:
    """Make the logs, tune the whole set and keep both."""
    made = make_logs(folder / LOGS)
    answers, campaign = answers_to([*given_logs(), *made], jobs)
    told = {
        "logs": {name: asdict(one) for name, one in answers.items()},
        "campaign": campaign,
        "tares": {log.name: log.tare.name for log in made if log.tare is not None},
    }
    (folder / ANSWERS).write_text(json.dumps(told, indent=1, ensure_ascii=False) + "\n")
    print(f"{len(answers)} answers in {folder / ANSWERS}")


def compare(folder: Path, jobs: int) -> bool:
    """Tune the kept logs again and print the changes; return whether there are none."""
    told = json.loads((folder / ANSWERS).read_text())
    before = {name: Answer(**one) for name, one in told["logs"].items()}
    given = {log.name: log for log in given_logs()}
    logs = []
    for name, answer in before.items():
        path, tare = folder / LOGS / name, told["tares"].get(name)
        if path.exists():
            tare = None if tare is None else folder / LOGS / tare
            logs.append(FixedLog(name, answer.group, path, answer.truth, tare))
        elif name in given and _digest(given[name].path) == answer.sha256:
            logs.append(given[name])
        else:
            print(f"{name}: not there any more, or another file; left out")
    after, campaign = answers_to(logs, jobs)
    text, same = compared({name: before[name] for name in after}, after)
    print(text)
    if told["campaign"] != campaign:
        print(f"\ncampaign, before:\n{told['campaign']}\ncampaign, after:\n{campaign}")
    return same and told["campaign"] == campaign


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)))
    return kept_or_compared(
        parser,
        lambda folder, asked: write(folder, asked.jobs),
        lambda folder, asked: compare(folder, asked.jobs),
    )


if __name__ == "__main__":
    sys.exit(main())
