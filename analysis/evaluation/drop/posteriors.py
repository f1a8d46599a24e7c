"""Train neural posteriors for the second experiment, and measure their coverage."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from analysis.drop.presets import PAPER_HEIGHT_M, observe_paper_drops
from analysis.evaluation.drop.batches import TargetBatch, problems_in
from analysis.evaluation.drop.intervals import fraction_error
from analysis.evaluation.drop.networks import Effort
from analysis.evaluation.drop.results import Cell, Credible
from analysis.evaluation.methods.neural_posterior import NeuralPosterior
from analysis.evaluation.methods.sbi_network import SbiPosterior, train_posterior
from analysis.processes import Piece, parallel_map
from recorders.simulators.drop import RESTITUTION
from tunenet_logs.arrays import Array
from tunenet_logs.terminal import Progress

Posteriors = Mapping[tuple[int, float], SbiPosterior]  # by seed and noise of the target [m]
SIMULATIONS = 1600  # drops: as many as the paper's 800 pairs take


@dataclass(frozen=True, eq=False)
class _Training:
    """Training data of one network.

    Attributes:
        observations: z of the drops [m], as they are observed, shape (N, L).
        restitutions: shape (N,).
        epochs: most passes; None for the library's rule.
    """

    observations: Array
    restitutions: Array
    seed: int
    epochs: int | None


def train_posteriors(
    seeds: Collection[int],
    noises_m: Collection[float],
    jobs: int | None,
    progress: Progress,
    effort: Effort | None = None,
) -> Posteriors:
    """Train a network for each seed and noise: a sensor's noise is known to its user.

    Those of one seed learn from the same drops. The networks are the same for any `jobs`.
    """
    effort = effort or Effort()
    count = 2 * effort.pairs if effort.pairs else SIMULATIONS
    keys: list[tuple[int, float]] = []
    trainings: list[_Training] = []
    for seed in seeds:
        heights_m, restitutions = _simulated(count, seed, jobs, progress)
        for noise_m in noises_m:
            keys.append((seed, noise_m))
            rng = np.random.default_rng([seed, *b"noise of a posterior"])
            observed = heights_m + rng.normal(0.0, noise_m, heights_m.shape)
            trainings.append(_Training(observed, restitutions, seed, effort.epochs))
    pieces = [Piece(training, 1, f"seed {training.seed}") for training in trainings]
    found = parallel_map(_trained, pieces, jobs, progress, ("training posteriors", "network"))
    return dict(zip(keys, found, strict=True))


def _simulated(count: int, seed: int, jobs: int | None, progress: Progress) -> tuple[Array, Array]:
    """Simulate heights over time [m], shape (N, L), and draw restitutions, shape (N,)."""
    rng = np.random.default_rng([seed, *b"posterior"])
    releases_m = rng.uniform(*PAPER_HEIGHT_M, count)
    restitutions = rng.uniform(*RESTITUTION.training_range, count)
    return observe_paper_drops(releases_m, restitutions, jobs, progress)[:, :, 0], restitutions


def _trained(training: _Training) -> SbiPosterior:
    return train_posterior(
        training.observations,
        training.restitutions,
        RESTITUTION.training_range,
        training.seed,
        training.epochs,
    )


def credible_coverage(
    work: Sequence[tuple[Cell, Sequence[TargetBatch]]], jobs: int | None, progress: Progress
) -> tuple[Credible, ...]:
    """Measure the empirical coverage of posteriors' credible intervals, one row a cell."""
    if not work:
        return ()
    pieces = [
        Piece(batch, len(batch.targets), batch.method.name)
        for _, batches in work
        for batch in batches
    ]
    found = iter(parallel_map(ends_of, pieces, jobs, progress, ("credible intervals", "target")))
    rows = []
    for cell, batches in work:
        ends = np.concatenate([next(found) for _ in batches])
        truths = np.array([target.truth for batch in batches for target in batch.targets])
        covered = (ends[:, 0] <= truths) & (truths <= ends[:, 1])
        width = float(np.median(ends[:, 1] - ends[:, 0]))
        error = fraction_error(covered)
        assert error is not None  # there is a target
        name = batches[0].method.name
        rows.append(Credible(cell, name, len(covered), float(covered.mean()), error, width))
    return tuple(rows)


def ends_of(batch: TargetBatch) -> Array:
    """Return the 95 % credible intervals of a posterior's targets, shape (targets, 2)."""
    estimator = batch.method.estimator
    assert isinstance(estimator, NeuralPosterior)
    problems = problems_in(batch.contact)
    return np.array(
        [estimator.density(problems.pose(target).target).interval() for target in batch.targets]
    )
