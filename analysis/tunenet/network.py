"""Networks h(o_P, o_T) from two observations to a parameter residual: data, training, use.

Each forward pass is written once, with operations that NumPy arrays and torch tensors share: torch
trains it, NumPy applies it, and tuning a log never waits for torch to load.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from tunenet_logs.analysis.parallel import Cluster, on_cluster, streamed
from tunenet_logs.episode import Array
from tunenet_logs.errors import TuneNetError
from tunenet_logs.terminal import Progress

if TYPE_CHECKING:
    import torch


Weights = Mapping[str, Any]  # arrays or tensors by name


class Network(Protocol):
    """Architecture: the shapes of its weights, and h."""

    @property
    def kind(self) -> str:
        """Name in a checkpoint."""
        ...

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """Return the weights' shapes for `inputs` observed values and `outputs` parameters."""
        ...

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """Evaluate h(o_P, o_T), shape (B, outputs), on two batches of shape (B, inputs)."""
        ...


class PaperNetwork:
    """The paper's network: 32 units per observation, concatenated, 32 more, tanh."""

    kind = "paper"
    width = 32

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        return {
            **layer("proposed", inputs, self.width),
            **layer("target", inputs, self.width),
            **layer("joint", 2 * self.width, self.width),
            **layer("out", self.width, outputs),
        }

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        of_proposed = relu(linear(weights, "proposed", proposed))
        of_target = relu(linear(weights, "target", target))
        joint = relu(_joint(weights, of_proposed, of_target))
        return tanh(linear(weights, "out", joint))


class AntisymmetricNetwork:
    """h(o_P, o_T) = (g(o_P, o_T) - g(o_T, o_P)) / 2: exactly 0 where the two are equal.

    The paper's network is biased at its fixed point. This one cannot be, so its iterations end at
    the target. g shares one first layer for both sides and has no tanh.
    """

    kind = "antisymmetric"
    width = 64

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        return {
            **layer("curve", inputs, self.width),
            **layer("joint", 2 * self.width, self.width),
            **layer("out", self.width, outputs),
        }

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        of_proposed = relu(linear(weights, "curve", proposed))
        of_target = relu(linear(weights, "curve", target))
        forth = relu(_joint(weights, of_proposed, of_target))
        back = relu(_joint(weights, of_target, of_proposed))
        return (linear(weights, "out", forth) - linear(weights, "out", back)) / 2


class WideNetwork(AntisymmetricNetwork):
    """Antisymmetric network for several parameters: twice as wide."""

    kind = "wide"
    width = 128


class HomogeneousNetwork:
    """Antisymmetric network without biases: h(a o_P, a o_T) = a h(o_P, o_T) for any a > 0.

    For observations that are linear in the parameter, as torques are in a mass: what it has learnt
    of small values holds for large ones.
    """

    kind = "homogeneous"
    width = 64

    def shapes(self, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
        """See `Network.shapes`."""
        layers = AntisymmetricNetwork().shapes(inputs, outputs)
        return {name: shape for name, shape in layers.items() if name.endswith(".weight")}

    def residual(self, weights: Weights, proposed: Any, target: Any) -> Any:
        """See `Network.residual`."""
        unbiased = {**weights, **{f"{name}.bias": 0.0 for name in ("curve", "joint", "out")}}
        return AntisymmetricNetwork().residual(unbiased, proposed, target)


NETWORKS: dict[str, Network] = {
    network.kind: network
    for network in (PaperNetwork(), AntisymmetricNetwork(), WideNetwork(), HomogeneousNetwork())
}


@dataclass(frozen=True, eq=False)
class Scaling:
    """Normalisation of a network's inputs and outputs.

    Inputs are (values - offset) * gain; residuals are outputs * gain + offset. A value that either
    observation lacks is 0 in both.
    """

    input_offset: Array
    input_gain: Array
    output_offset: Array
    output_gain: Array

    def inputs(self, proposed: Array, target: Array) -> tuple[Array, Array]:
        """Normalise two batches of observations, shape (B, L, C), to inputs, (B, L * C)."""
        flat_p = proposed.reshape(len(proposed), -1)
        flat_t = target.reshape(len(target), -1)
        seen = np.isfinite(flat_p) & np.isfinite(flat_t)
        scaled_p = np.where(seen, (flat_p - self.input_offset) * self.input_gain, 0.0)
        scaled_t = np.where(seen, (flat_t - self.input_offset) * self.input_gain, 0.0)
        return scaled_p, scaled_t


@dataclass(frozen=True, eq=False)
class Model:
    """Trained network, which estimates the residual of the P parameters from two observations."""

    network: Network
    weights: Mapping[str, Array]
    scaling: Scaling
    digest: str = ""  # SHA-256 of everything in it, hexadecimal

    def __call__(self, proposed: Array, target: Array) -> Array:
        """Estimate zeta_T - zeta_P, shape (B, P), from observations of shape (B, L, C)."""
        inputs = self.scaling.inputs(proposed, target)
        outputs = self.network.residual(self.weights, *inputs)
        return outputs * self.scaling.output_gain + self.scaling.output_offset


def initial_weights(
    network: Network, inputs: int, outputs: int, rng: np.random.Generator
) -> dict[str, Array]:
    """Draw weights uniformly within 1 / sqrt(fan-in), as torch.nn.Linear does."""
    shapes = network.shapes(inputs, outputs)
    weights: dict[str, Array] = {}
    for name, shape in shapes.items():
        fan_in = shapes[f"{name.split('.')[0]}.weight"][0]
        weights[name] = rng.uniform(-1.0, 1.0, shape) / np.sqrt(fan_in)
    return weights


def layer(name: str, inputs: int, outputs: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of a linear layer's weights."""
    return {f"{name}.weight": (inputs, outputs), f"{name}.bias": (outputs,)}


def linear(weights: Weights, name: str, values: Any) -> Any:
    """Apply a linear layer to a batch of shape (B, inputs)."""
    return values @ weights[f"{name}.weight"] + weights[f"{name}.bias"]


def _joint(weights: Weights, first: Any, second: Any) -> Any:
    """Apply the layer "joint" to two concatenated inputs."""
    matrix = weights["joint.weight"]
    half = matrix.shape[0] // 2
    return first @ matrix[:half] + second @ matrix[half:] + weights["joint.bias"]


def relu(values: Any) -> Any:
    """Return max(values, 0) of an array or a tensor."""
    return values.clip(min=0)


def tanh(values: Any) -> Any:
    """Return tanh of an array or a tensor."""
    return np.tanh(values) if isinstance(values, np.ndarray) else values.tanh()


# ---- Training data: observations simulated in parallel, and their pairs.

Item = TypeVar("Item")
# Who makes rollouts: a cluster, or so many processes of this machine; None for all its cores.
Workers: TypeAlias = Cluster | int | None
# Items of a chunk at most, and chunks wanted: workers then end together, and giving costs little.
_MAX_AT_A_TIME, _CHUNKS = 50, 128


@dataclass(frozen=True, eq=False)
class PairSet:
    """Pairs of rollouts whose parameters are known."""

    observations: Array  # shape (N, L, C)
    values: Array  # parameters of each, shape (N, P)
    proposed: NDArray[np.intp]  # index of o_P of each pair, shape (M,)
    target: NDArray[np.intp]  # index of o_T of each pair, shape (M,)

    @property
    def residuals(self) -> Array:
        """Parameter residuals zeta_T - zeta_P, shape (M, P)."""
        return self.values[self.target] - self.values[self.proposed]


def observe_all(
    observe: Callable[[Sequence[Item]], Array],
    items: Sequence[Item],
    workers: Workers,
    progress: Progress,
) -> Array:
    """Map `observe` over all items in chunks, and concatenate in order, shape (N, L, C).

    Chunks do not depend on the number of workers, so the same items give the same bits.
    """
    size = max(1, min(_MAX_AT_A_TIME, len(items) // _CHUNKS + 1))
    chunks = [items[at : at + size] for at in range(0, len(items), size)]
    if isinstance(workers, Cluster):
        done = on_cluster(workers, observe, chunks, _gone)
    else:
        done = streamed(observe, chunks, workers, may_stay=True, lost=_gone)
    all_of_them: Array | None = None
    with progress.bar(len(items), "simulating", "rollout") as bar:
        for at, part in done:
            each = len(part) // len(chunks[at])
            if all_of_them is None:
                all_of_them = np.empty((each * len(items), *part.shape[1:]), part.dtype)
            first = each * size * at
            all_of_them[first : first + len(part)] = part
            bar.update(len(chunks[at]))
    assert all_of_them is not None, "nothing to observe"
    return all_of_them


def _gone(chunk: Sequence[object]) -> Array:
    raise TuneNetError(
        f"a process that simulated {len(chunk)} rollouts died each time that they were tried; "
        "memory may be short: choose fewer --jobs"
    )


def consecutive_pairs(count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Pair rollouts (0, 1), (2, 3), ...: each in one pair, as in the paper."""
    return np.arange(0, 2 * count, 2), np.arange(1, 2 * count, 2)


def mixed_pairs(
    values: Array, count: int, rng: np.random.Generator
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Draw pairs: half of any two rollouts, half close together, as the last iterations are."""
    order = np.argsort(values[:, 0])
    proposed = rng.integers(len(values), size=count)
    anywhere = rng.integers(len(values), size=count)
    reach = 0.1 * len(values) * rng.random(count) * rng.standard_normal(count)
    near = np.clip(proposed + reach.astype(int), 0, len(values) - 1)
    target = np.where(rng.random(count) < 0.5, near, anywhere)
    return order[proposed], order[target]


# ---- Training on pairs (eq. 4 of the paper), by the paper's recipes or ours.


@dataclass(frozen=True)
class Recipe:
    """Hyperparameters of a training."""

    optimizer: str  # "sgd" (no momentum) or "adamw" (one-cycle learning rate)
    learning_rate: float  # at first ("sgd") or at most ("adamw")
    weight_decay: float  # L2 constant
    # "squared", "norm" (unsquared, the paper's eq. 4), or "relative": squared, over (|residual| +
    # 0.1)^2, so that small residuals count as they do in the last steps.
    loss: str
    # "raw", "unit" (inputs and outputs to [0, 1]), "standard" (of inputs), or "ranges" (also each
    # output by its parameter's range); "unit-inputs" and "z-score" scale each channel of the
    # inputs alone
    scaling: str
    epochs: int
    batch: int
    decay: float = 1.0  # factor of the rate every `decay_epochs` ("sgd")
    decay_epochs: int = 1
    noise: float = 0.0  # up to this standard deviation is added to o_T, in the observation's unit
    cut_share: float = 0.0  # of pairs that begin late and end early, as short recordings do


def train(network: Network, pairs: PairSet, recipe: Recipe, seed: int, progress: Progress) -> Model:
    """Train a network with torch, on its default device.

    The same seed on the same machine gives the same weights.
    """
    import torch
    from torch.optim.lr_scheduler import OneCycleLR, StepLR

    torch.set_num_threads(1)  # for networks this small, a second thread mostly waits for the first
    rng = np.random.default_rng(seed)
    scaling = _scaling(pairs, recipe.scaling)
    bank = (pairs.observations.reshape(len(pairs.values), -1) - scaling.input_offset) * (
        scaling.input_gain
    )
    shown = torch.from_numpy(np.isfinite(bank))
    complete = bool(shown.all())
    noise = float(np.mean(recipe.noise * scaling.input_gain))
    wanted = (pairs.residuals - scaling.output_offset) / scaling.output_gain
    outputs = wanted.shape[1]
    weights = {
        name: torch.tensor(value, dtype=torch.float32, requires_grad=True)
        for name, value in initial_weights(network, bank.shape[1], outputs, rng).items()
    }
    inputs = torch.tensor(np.nan_to_num(bank), dtype=torch.float32)
    residuals = torch.tensor(wanted, dtype=torch.float32)
    proposed, target = torch.from_numpy(pairs.proposed), torch.from_numpy(pairs.target)
    batches = int(np.ceil(len(proposed) / recipe.batch))
    rate = recipe.learning_rate
    settings: dict[str, Any] = {"lr": rate, "weight_decay": recipe.weight_decay}
    if recipe.optimizer == "sgd":
        optimizer = torch.optim.SGD(list(weights.values()), **settings)
        schedule = StepLR(optimizer, step_size=recipe.decay_epochs, gamma=recipe.decay)
    else:
        optimizer = torch.optim.AdamW(list(weights.values()), **settings)
        schedule = OneCycleLR(optimizer, max_lr=rate, total_steps=recipe.epochs * batches)
    generator = torch.Generator().manual_seed(seed)
    with progress.bar(recipe.epochs, "training", "epoch") as bar:
        for _ in range(recipe.epochs):
            order = torch.randperm(len(proposed), generator=generator)
            for chosen in order.split(recipe.batch):
                first, second = proposed[chosen], target[chosen]
                o_p, o_t = inputs.index_select(0, first), inputs.index_select(0, second)
                if not complete:
                    both = shown[first] & shown[second]  # as `Scaling.inputs` has it
                    o_p, o_t = o_p * both, o_t * both
                o_p, o_t = _augment(o_p, o_t, noise, recipe.cut_share, generator)
                found = network.residual(weights, o_p, o_t)
                off = found - residuals[chosen]
                if recipe.loss == "relative":
                    off = off / (residuals[chosen].abs() + 0.1)
                loss = off.norm(dim=1).mean() if recipe.loss == "norm" else (off**2).mean()
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                if recipe.optimizer == "adamw":
                    schedule.step()
            if recipe.optimizer == "sgd":
                schedule.step()
            bar.update(1)
    trained = {name: value.detach().numpy().astype(np.float64) for name, value in weights.items()}
    return Model(network, trained, scaling)


def one_step_error(model: Model, pairs: PairSet) -> float:
    """Return the mean absolute error of zeta_P + h(o_P, o_T) (K = 1 in the paper's table)."""
    found = model(pairs.observations[pairs.proposed], pairs.observations[pairs.target])
    return float(np.mean(np.abs(found - pairs.residuals)))


def _scaling(pairs: PairSet, how: str) -> Scaling:
    seen, none, one = pairs.observations, np.zeros(1), np.ones(1)
    flat = seen.reshape(len(pairs.values), -1)
    if how == "raw":
        return Scaling(none, one, none, one)
    if how in ("unit-inputs", "z-score"):  # offset and gain of each input, one pair per channel
        offset, spread = np.nanmean(seen, axis=(0, 1)), np.nanstd(seen, axis=(0, 1))
        if how == "unit-inputs":
            offset = np.nanmin(seen, axis=(0, 1))
            spread = np.nanmax(seen, axis=(0, 1)) - offset
        length = seen.shape[1]
        gain = 1 / np.maximum(spread, 1e-12)
        return Scaling(np.tile(offset, length), np.tile(gain, length), none, one)
    if how == "unit":
        low, high = np.array([np.nanmin(flat)]), np.array([np.nanmax(flat)])
        least, most = pairs.residuals.min(axis=0), pairs.residuals.max(axis=0)
        return Scaling(low, 1 / (high - low), least, most - least)
    spread = np.nanstd(flat, axis=0).mean()
    ranges = np.ptp(pairs.values, axis=0) if how == "ranges" else one
    return Scaling(np.nanmean(flat, axis=0), np.array([1 / spread]), none, ranges)


def _augment(
    proposed: torch.Tensor,
    target: torch.Tensor,
    noise: float,
    cut_share: float,
    generator: torch.Generator,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Augment with noise on the target, and with late begins and early ends (0 in both)."""
    import torch

    count, length = target.shape
    if noise:
        sd = noise * torch.rand(count, 1, generator=generator) ** 2
        target = target + sd * torch.randn(count, length, generator=generator)
    if cut_share:
        cut = torch.rand(count, 1, generator=generator) < cut_share
        end = 0.25 + 0.75 * torch.rand(count, 1, generator=generator)
        # Share of an observation that a short recording may lack at its beginning: the fall
        begin = 0.18 * torch.rand(count, 1, generator=generator)
        places = torch.arange(length)
        seen = ~cut | ((places < end * length) & (places >= begin * length))
        proposed, target = proposed * seen, target * seen
    return proposed, target
