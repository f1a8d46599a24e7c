"""Train TuneNet for one simulator and one log, and cache it."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from analysis.estimators.base import Observation
from analysis.sysid.compared import ComparedColumns
from analysis.sysid.source import Rollouts
from analysis.tunenet.checkpoint import Purpose, load_model, save_model
from analysis.tunenet.network import Model, WideNetwork
from analysis.tunenet.pairs import PairSet
from analysis.tunenet.training import Recipe, train
from recorders.simulators.base import Parameter
from tunenet_logs.arrays import Array
from tunenet_logs.errors import TuneNetError
from tunenet_logs.progress import told
from tunenet_logs.terminal import Progress

ROLLOUTS = 2000  # that a network is trained with
_PAIRS_EACH = 40
_GRID = 100  # moments at which it looks
# That an observation reaches from the log's mean; what is further off looks the same.
MAX_SPREADS = 20.0

_BATCH = 50
_RECIPE = Recipe(
    optimizer="adamw",
    learning_rate=2e-3,
    weight_decay=0.1,
    epochs=30,
    batch=512,
    scaling="ranges",
    loss="squared",
)


def observation(target: ComparedColumns, values: Array) -> Observation:
    """Observe all columns on one grid, normalised by the log's mean and spread.

    Args:
        target: Columns to compare with.
        values: Observed or simulated, shape (M,).
    """
    grid_s = np.linspace(0.0, target.end_s, _GRID)
    seen: list[Array] = []
    for number, column in enumerate(target.columns):
        mine = values[target.which == number]
        good = np.isfinite(mine)
        shown = np.full(_GRID, np.nan)
        if good.sum() > 1:
            shown = np.interp(grid_s, column.seconds[good], mine[good])
        centre = float(np.mean(column.values))
        scaled = (shown - centre) / max(column.spread, 1e-12)
        seen.append(np.clip(scaled, -MAX_SPREADS, MAX_SPREADS))
    names = tuple(f"{column.label} [spreads]" for column in target.columns)
    return Observation(np.column_stack(seen), grid_s, "time [s]", names)


def trained_network(
    rollouts: Rollouts,
    target: ComparedColumns,
    parameters: tuple[Parameter, ...],
    tuned: int,
    digest: str,
    count: int = ROLLOUTS,
) -> Model:
    """Train the network for one simulator and one log, or load it from the cache.

    Args:
        rollouts: Of the simulator, at values of all parameters.
        target: Columns to compare with.
        parameters: All, the tuned ones first.
        tuned: How many of them are tuned.
        digest: Of the model and what is tuned; "" for an object, whose network is not cached.
        count: Rollouts to train with.
    """
    shape = f"{_GRID} moments of {', '.join(column.label for column in target.columns)}"
    inputs = _GRID * len(target.columns)
    purpose = Purpose("simulator", "default", shape, inputs, tuned, (1.0,))
    kept = _kept(target, parameters, digest, count) if digest else None
    if kept is not None and kept.is_file():
        with suppress(TuneNetError):
            return load_model(kept, purpose)
    pairs = _pairs(rollouts, target, parameters, tuned, count)
    model = train(WideNetwork(), pairs, _RECIPE, 0, Progress(quiet=True))
    if kept is not None:
        with suppress(TuneNetError, OSError):
            kept.parent.mkdir(parents=True, exist_ok=True)
            save_model(kept, model, purpose, {"rollouts": str(count)})
    return model


def _kept(
    target: ComparedColumns, parameters: tuple[Parameter, ...], digest: str, count: int
) -> Path | None:
    """Return the cache file, keyed by model, parameters, and log."""
    root = os.environ.get("XDG_CACHE_HOME")
    folder = Path(root) if root else Path.home() / ".cache"
    state = hashlib.sha256(digest.encode())
    state.update(f"{count} {_GRID}".encode())
    for parameter in parameters:
        state.update(f"{parameter.name} {parameter.training_range} {parameter.initial}".encode())
    state.update(target.seconds.tobytes() + target.values.tobytes())
    return folder / "tunenet-logs" / f"{state.hexdigest()[:32]}.safetensors"


def _pairs(
    rollouts: Rollouts,
    target: ComparedColumns,
    parameters: tuple[Parameter, ...],
    tuned: int,
    count: int,
) -> PairSet:
    """Roll out over the ranges from the log's initial state (Halton), and draw pairs."""
    low, high = np.array([one.training_range for one in parameters[:tuned]]).T
    values = qmc.scale(qmc.Halton(tuned, rng=0).random(count), low, high)
    rest = np.array([one.initial for one in parameters[tuned:]])
    rows = np.column_stack([values, np.repeat(rest[None], count, axis=0)])
    seen: list[Array] = []
    for first in told(range(0, count, _BATCH), "simulating to train", -(-count // _BATCH)):
        episodes = rollouts(rows[first : first + _BATCH])
        seen += [observation(target, target.seen_in(one)).values for one in episodes]
    rng = np.random.default_rng(0)
    proposed = rng.integers(count, size=_PAIRS_EACH * count)
    other = rng.integers(count, size=_PAIRS_EACH * count)
    return PairSet(np.stack(seen), values, proposed, other)
