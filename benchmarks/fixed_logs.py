"""Fixed set of logs that `benchmarks.answers` tunes, with their sources and truths.

The made ones are written once and kept, so that a later run tunes the same bytes whatever has
become of the code that made them. Balls among positions come from generators that share no code
with the fit; films and payloads are recorded by `tunenet-record`.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from analysis.evaluation.video.bouncing_ball import DroppedBall, drop_ball
from recorders.cli import main as record
from tests import strangers

ROOT = Path(__file__).resolve().parents[1]
REAL = ROOT.parent / "shared" / "real"
SAMPLES = ROOT / "sample_logs"
TARES = {"payload": SAMPLES / "payload_empty.mcap"}

IDEAL, NOT_IDEAL, FILMS, PAYLOADS = 40, 20, 20, 20
SEED = 17_000
_NO_LOGS = {".md", ".txt.gz", ".urdf", ".yaml", ""}
_BALL_START_NS = 1_700_000_000_000_000_000


@dataclass(frozen=True)
class FixedLog:
    """Log of the set.

    Attributes:
        name: its key, the same in every run.
        group: the line of the table that it counts in.
        truth: the first parameter as the log was made with; None where nobody knows.
        tare: the empty run that goes with it.
    """

    name: str
    group: str
    path: Path
    truth: float | None = None
    tare: Path | None = None


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
    ball = DroppedBall(
        float(rng.uniform(0.3, 2.0)),
        truth,
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
