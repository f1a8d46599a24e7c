"""Measure what the network's start is worth beside one from the middle of the range.

    python -m tests.bench.network_worth                   all tables, tens of minutes
    python -m tests.bench.network_worth --seeds 1 --logs 5 --films 2 --targets 10

Table 1, logs that have an exact fit: `tunenet+refine` (the network's steps, then the fit) beside
`fit` (the fit alone, from mid-range). A failure: the values differ by more than a tenth of the
interval's half width, or one method alone answers.

Tables 2 and 3, rollouts alone, as where no exact fit exists: the paper's drops at 60 Hz, with a
network trained anew for each seed; and the payloads of table 1, with the network that the package
ships. "Lines" are straight lines through two rollouts, then a local search.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np

from tests.bench.made_logs import FILMS, MAKERS, PAYLOADS, made_log
from tests.bench.network_worth_tables import Pair, head, log_table, row, summary
from tunenet_logs.analysis.estimators.methods import Brent, RolloutLine, TuneNet, TuneNetThenLine
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    EASY,
    HARD,
    DropTarget,
    Method,
    TargetBatch,
    draw_targets,
    estimate_batches,
    train_on_papers,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece, parallel_map
from tunenet_logs.analysis.payload.detection import TRAININGS
from tunenet_logs.analysis.payload.experiment import PayloadExperiment
from tunenet_logs.analysis.tunenet.network import Model
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.arm.payload import PAYLOAD_MASS
from tunenet_logs.recorders.simulators.ball import RESTITUTION
from tunenet_logs.recorders.simulators.base import PAPER
from tunenet_logs.terminal import Progress

# After which answers are compared: 5 is what `tunenet-tune` lets a method spend.
ROLLOUTS = (3, 5, 10)

NOISES_M = (0.0, 0.01)  # of every height of a target: none, and what a good tracker leaves
FAILURE = 0.02  # error of a restitution that nobody would call tuned: what cross-checks object to
# Of a payload: between two and three times the mean error of a tuning without a tare.
FAILURE_KG = 0.1

LOG_METHODS = ("tunenet+refine", "fit")
_BATCH = 10  # logs and targets in a piece of work: few, so that the processes end together
LogWork = tuple[str, int, int]  # kind, seed, index


def tuned_pair(work: LogWork) -> Pair:
    """Tune one log by both methods, which take turns to be the first."""
    kind, seed, index = work
    values, rollouts, seconds = np.full((3, len(LOG_METHODS)), np.nan)
    half_width = np.nan
    with tempfile.TemporaryDirectory() as folder:
        log = made_log(kind, seed, index, Path(folder))
        for at in (0, 1) if index % 2 else (1, 0):
            options = TuneOptions(method=LOG_METHODS[at], tares=log.tares)
            tuning = tune_episode(log.episode, options)
            if tuning.estimate is not None and tuning.trace is not None:
                values[at] = tuning.estimate[0]
                rollouts[at], seconds[at] = tuning.rollouts, tuning.seconds["tune"]
                if tuning.trace.fit is not None and (at == 0 or np.isnan(half_width)):
                    half_width = float(np.ptp(tuning.trace.fit.interval95[0])) / 2
    return Pair(kind, log.truth, tuple(values), half_width, tuple(rollouts), tuple(seconds))


def tuned_pairs(work: Sequence[LogWork]) -> list[Pair]:
    """Run `tuned_pair` on each, in one thread: there is a process for each core."""
    import cv2

    cv2.setNumThreads(1)
    return [tuned_pair(one) for one in work]


def methods_with(network: Model, middle: float | None) -> dict[str, tuple[Method, float | None]]:
    """Return methods by their line in a table, each with its start; None for the own guess."""
    estimators = {
        "network": (TuneNet(network), None),
        "network, then lines": (TuneNetThenLine(network), None),
        "lines from the same guess": (RolloutLine(), None),
        "network, then lines, from mid-range": (TuneNetThenLine(network), middle),
        "lines from mid-range": (RolloutLine(), middle),
        "Brent": (Brent(), None),
    }
    return {
        label: (Method(label, label, "ours", estimator, ROLLOUTS[-1]), start)
        for label, (estimator, start) in estimators.items()
        if middle is not None or "mid-range" not in label
    }


def _middle(bounds: tuple[float, float]) -> float:
    return sum(bounds) / 2


def rollout_table(
    networks: dict[int, Model], count: int, jobs: int | None, progress: Progress
) -> str:
    """Tabulate every method on `count` targets of each seed, by its own network (table 2)."""
    cells = [(which, noise_m) for which in (EASY, HARD) for noise_m in NOISES_M]
    batches: list[TargetBatch] = []
    keys: list[tuple[str, int]] = []
    for at, (which, noise_m) in enumerate(cells):
        for seed, network in networks.items():
            targets = draw_targets(which, count, seed, noise_m)
            methods = methods_with(network, _middle(RESTITUTION.training_range))
            for label, (method, start) in methods.items():
                for first in range(0, count, _BATCH):
                    portion = tuple(_from(one, start) for one in targets[first : first + _BATCH])
                    batches.append(TargetBatch(method, portion, PAPER, ROLLOUTS[-1]))
                    keys.append((label, at))
    done = estimate_batches(batches, jobs, progress)
    errors = {
        key: np.concatenate([one for own, one in zip(keys, done, strict=True) if own == key])
        for key in dict.fromkeys(keys)
    }
    heads = [f"{which.name}, {100 * noise_m:g} cm" for which, noise_m in cells]
    lines = head("method", "rollouts", *heads)
    for label in dict.fromkeys(label for label, _ in keys):
        for spent in ROLLOUTS:
            found = [errors[label, at][:, spent] for at in range(len(cells))]
            lines += row(label, str(spent), *(summary(one, FAILURE) for one in found))
    return "\n".join(lines)


def _from(target: DropTarget, start: float | None) -> DropTarget:
    return target if start is None else replace(target, initial=start)


def payload_errors(work: Sequence[LogWork]) -> Array:
    """Return absolute errors [kg], shape (logs, methods, 1 + rollouts)."""
    experiment, methods = PayloadExperiment(), methods_with(_payload_network(), None)
    errors = np.empty((len(work), len(methods), ROLLOUTS[-1] + 1))
    for rows, (kind, seed, index) in zip(errors, work, strict=True):
        with tempfile.TemporaryDirectory() as folder:
            log = made_log(kind, seed, index, Path(folder))
        found = experiment.detect(log.episode, TuneOptions(tares=log.tares), "default")
        for own, (method, _) in zip(rows, methods.values(), strict=True):
            problem = experiment.problem(found, np.array([_middle(PAYLOAD_MASS.training_range)]))
            trace = method.estimator.estimate(problem, ROLLOUTS[-1])
            own[:] = [abs(trace.after(spent)[0] - log.truth) for spent in range(len(own))]
    return errors


def _payload_network() -> Model:
    return shipped_model(TRAININGS["default"].purpose)


def payload_table(errors: Array) -> str:
    """Tabulate `payload_errors` (table 3)."""
    lines = head("method", *(f"{spent} rollouts" for spent in ROLLOUTS))
    labels = methods_with(_payload_network(), None)
    for label, rows in zip(labels, errors.swapaxes(0, 1), strict=True):
        lines += row(label, *(summary(rows[:, spent], FAILURE_KG) for spent in ROLLOUTS))
    return "\n".join(lines)


def trained(seed: int) -> Model:
    """Train our network for the paper's simulator."""
    return train_on_papers(seed, 1, Progress(quiet=True))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, nargs="+", default=[31, 32, 33])
    parser.add_argument("--logs", type=int, default=40, help="of each kind and seed")
    parser.add_argument("--films", type=int, default=8, help="of each seed: they take longest")
    parser.add_argument("--targets", type=int, default=100, help="of each seed")
    parser.add_argument("--jobs", type=int, help="processes (default: all cores)")
    arguments = parser.parse_args()
    progress, jobs = Progress(), arguments.jobs
    kinds = {kind: arguments.films if kind == FILMS else arguments.logs for kind in MAKERS}
    work = [
        Piece([(kind, seed, index) for index in range(first, min(first + _BATCH, count))], _BATCH)
        for kind, count in kinds.items()
        for seed in arguments.seeds
        for first in range(0, count, _BATCH)
    ]
    pairs = parallel_map(tuned_pairs, work, jobs, progress, ("tuning", "log"))
    print(f"Logs: {' / '.join(LOG_METHODS)}\n\n{log_table(list(chain(*pairs)))}\n", flush=True)
    payloads = [piece for piece in work if piece.item[0][0] == PAYLOADS]
    errors = parallel_map(payload_errors, payloads, jobs, progress, ("payloads", "log"))
    print(f"Rollouts alone, payloads [kg]\n\n{payload_table(np.concatenate(errors))}\n", flush=True)
    seeds = [Piece(seed) for seed in arguments.seeds]
    models = parallel_map(trained, seeds, jobs, progress, ("training", "network"))
    networks = dict(zip(arguments.seeds, models, strict=True))
    table = rollout_table(networks, arguments.targets, jobs, progress)
    print(f"Rollouts alone, drops\n\n{table}")


if __name__ == "__main__":
    main()
