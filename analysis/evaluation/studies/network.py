"""Measure what the network's start is worth where rollouts alone lead to an answer.

Beside it stands a start from the middle of the range: on the paper's drops at 60 Hz, with a network
trained anew for each seed, and on payloads, with the one that the package ships. "Lines" are
straight lines through two rollouts, then a local search.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from tunenet_logs.analysis.estimators.methods import Brent, RolloutLine, TuneNet, TuneNetThenLine
from tunenet_logs.analysis.evaluation.studies.drop_methods import (
    EASY,
    HARD,
    Method,
    TargetBatch,
    draw_targets,
    errors_of,
    train_on_papers,
)
from tunenet_logs.analysis.evaluation.study import (
    Order,
    Part,
    Row,
    figure,
    scored,
    short,
    table,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.parallel import Piece
from tunenet_logs.analysis.payload.detection import TRAININGS
from tunenet_logs.analysis.payload.experiment import PayloadExperiment
from tunenet_logs.analysis.tunenet.network import Model
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.episode import Array, Episode
from tunenet_logs.recorders.simulators.arm.description import Payload, jaco
from tunenet_logs.recorders.simulators.arm.path import circle, random_path
from tunenet_logs.recorders.simulators.arm.payload import (
    PAYLOAD_MASS,
    drawn,
    driver_episode,
    through_kinovas_driver,
)
from tunenet_logs.recorders.simulators.ball import RESTITUTION
from tunenet_logs.recorders.simulators.base import PAPER
from tunenet_logs.terminal import Progress

# ---- Payloads as a real arm's driver reports them, torques by inverse dynamics.

_SEEDS = 19_000_000  # logs are drawn from these and a seed: nothing was chosen on them
_MASS_KG = (0.05, 1.5)  # from what a driver's torques just show to what a Jaco lifts


def drawn_payload(seed: int, index: int) -> tuple[Episode, float, Episode]:
    """Draw a log, its mass [kg], and an empty run that goes with it."""
    rng = np.random.default_rng([_SEEDS, seed, index, *b"payloads with a tare"])
    arm, seed, mass_kg = jaco(), int(rng.integers(2**31)), float(rng.uniform(*_MASS_KG))
    when = (500.0, 5.2)  # samples a second of the motion, and its duration
    moved = circle(*when) if rng.random() < 0.5 else random_path(arm, seed, *when)
    disturbances = through_kinovas_driver(drawn(seed, arm), 65.0)
    tare = driver_episode(arm, moved, None, disturbances.another_run())
    return driver_episode(arm, moved, Payload(mass_kg), disturbances), mass_kg, tare


# ---- Methods on drops and payloads.

ROLLOUTS = (3, 5, 10)  # after which answers are compared: `tunenet-tune` lets a method spend 5
NOISES_M = (0.0, 0.01)  # of every height of a target: none, and what a good tracker leaves


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


def drop_rows(networks: Mapping[int, Model], order: Order, progress: Progress) -> list[Row]:
    """Try every method on the targets of each seed, by its own network."""
    count = order.targets_of("network", "drops")
    middle = sum(RESTITUTION.training_range) / 2
    cases: dict[tuple[str, str], list[Piece[TargetBatch]]] = {}
    for which, noise_m in ((which, noise_m) for which in (EASY, HARD) for noise_m in NOISES_M):
        for seed, numbers in order.portions(10, count):
            targets = draw_targets(which, count, seed, noise_m)[numbers.start : numbers.stop]
            for label, (method, start) in methods_with(networks[seed], middle).items():
                own = targets if start is None else [replace(one, initial=start) for one in targets]
                batch = TargetBatch(method, tuple(own), PAPER, ROLLOUTS[-1])
                cell = (label, f"{which.name}, {100 * noise_m:g} cm")
                cases.setdefault(cell, []).append(Piece(batch, len(own), label))
    done = scored(drop_errors, cases, order, progress, ("estimating", "target"))
    return [
        # nobody would call a larger error of a restitution tuned: what cross-checks object to
        {"method": label, "rollouts": spent, "targets": cell, **_figures(errors, spent, 0.02)}
        for (label, cell), errors in done.items()
        for spent in ROLLOUTS
    ]


def drop_errors(batch: TargetBatch) -> list[Array]:
    """Return absolute errors of each target, shape (1 + rollouts,) each."""
    return list(errors_of(batch))


def payload_errors(case: tuple[int, range]) -> list[Array]:
    """Return absolute errors [kg] of each log of a seed, shape (methods, 1 + rollouts) each."""
    seed, numbers = case
    experiment, network = PayloadExperiment(), shipped_model(TRAININGS["default"].purpose)
    found: list[Array] = []
    for index in numbers:
        episode, truth, tare = drawn_payload(seed, index)
        detection = experiment.detect(episode, TuneOptions(tares=(tare,)), "default")
        middle = np.array([sum(PAYLOAD_MASS.training_range) / 2])
        traces = [
            method.estimator.estimate(experiment.problem(detection, middle), ROLLOUTS[-1])
            for method, _ in methods_with(network, None).values()
        ]
        spent = range(ROLLOUTS[-1] + 1)
        found.append(np.array([[abs(one.after(n)[0] - truth) for n in spent] for one in traces]))
    return found


def payload_rows(errors: Sequence[Array]) -> list[Row]:
    """Compute the figures of `payload_errors`."""
    labels = methods_with(shipped_model(TRAININGS["default"].purpose), None)
    return [
        {
            "method": label,
            "rollouts": spent,
            # two to three times the mean error of a tuning without a tare
            **_figures([one[at] for one in errors], spent, 0.1),
        }
        for at, label in enumerate(labels)
        for spent in ROLLOUTS
    ]


def _figures(errors: Sequence[Array], spent: int, failure: float) -> Row:
    after = np.array(errors)[:, spent]
    return {
        "mae": figure(after),
        "median": figure(after, np.median),
        "failed": figure(after > failure),
    }


def pivoted(rows: Sequence[Row], beside: str, title: str) -> str:
    """Tabulate mean; median; share of failures, one thing beside the other."""
    names = [name for name in ("method", "rollouts") if name != beside]
    lines: dict[tuple[str, ...], list[str]] = {}
    for row in rows:
        cell = f"{short(row['mae'])}; {short(row['median'])}; {100 * row['failed']:.3g} %"
        lines.setdefault(tuple(str(row[name]) for name in names), []).append(cell)
    heads = [*names, *dict.fromkeys(str(row[beside]) for row in rows)]
    return table([heads, *([*key, *cells] for key, cells in lines.items())], title)


# ---- Run.


def trained(case: tuple[int, int | None]) -> list[Model]:
    """Train our network for the paper's simulator, for a seed and a number of epochs."""
    return [train_on_papers(case[0], 1, Progress(quiet=True), case[1])]


def run(order: Order, progress: Progress) -> Iterator[Part]:
    """Try the methods on payloads and on drops."""
    if "payloads" in order.sections:
        cases = {"": order.pieces(10, targets=order.targets_of("network", "payloads"))}
        errors = scored(payload_errors, cases, order, progress, ("payloads", "log"))
        rows = payload_rows(errors[""])
        title = "Payloads [kg], after so many rollouts: mean; median; share over .1"
        yield Part("payloads", pivoted(rows, "rollouts", title), rows)
    if "drops" in order.sections:
        seeds = [Piece((seed, order.epochs)) for seed in order.seeds]
        models = scored(trained, {"": seeds}, order, progress, ("training", "network"))[""]
        rows = drop_rows(dict(zip(order.seeds, models, strict=True)), order, progress)
        title = "Drops: mean; median; share over .02"
        yield Part("drops", pivoted(rows, "targets", title), rows)
