"""Searches by trial as a second opinion of a user's simulator: they look where the user does."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

import tunenet_logs as tn
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.recorders.simulators.base import Parameter

SECONDS = np.arange(500) / 100
TRUTH = {"stiffness": 37.0, "damping": 0.3, "initial/cart.position": 1.06}
SEARCHES = ["cma-es", "tpe", "least-squares"]


class Spring:
    """A cart on a spring, seen with its first place measured; too soft a spring breaks at once."""

    engine, step_hz = "by hand", 100.0
    parameters = (
        Parameter("stiffness", "N/m", (0.0, 1e9), (1.0, 100.0), 60.0),
        Parameter("damping", "N·s/m", (0.0, 1e9), (0.0, 2.0), 0.5),
        Parameter("initial/cart.position", "m", (-9.0, 9.0), (0.8, 1.2), 1.0, prior_sd=0.04),
    )

    def rollout(self, values: Mapping[str, float]) -> Episode:
        decay = values["damping"] / 2
        rate = np.sqrt(max(values["stiffness"] - decay**2, 1e-9))
        place = values["initial/cart.position"] * np.exp(-decay * SECONDS) * np.cos(rate * SECONDS)
        if values["stiffness"] < 20:
            place[1:] = np.nan
        stamps = np.round(1e9 * SECONDS).astype(np.int64)
        still = 0.001 * np.sin(SECONDS)
        columns = np.stack([place, still], axis=1)
        return Episode(EpisodeInfo(), {"/cart": Signal("/cart", stamps, columns, ("x", "y"), "m")})


def log() -> Episode:
    """With noise, by which one column tells nothing."""
    clean = Spring().rollout(TRUTH).signals["/cart"]
    noise = 0.005 * np.random.default_rng(3).standard_normal(clean.values.shape)
    signal = Signal("/cart", clean.stamps_ns, clean.values + noise, clean.columns, "m")
    return Episode(EpisodeInfo(), {"/cart": signal})


@pytest.mark.parametrize("method", SEARCHES)
def test_a_search_finds_what_the_fit_finds(method: str):
    if method != "least-squares":
        pytest.importorskip({"tpe": "optuna", "cma-es": "cma"}[method])
    rollouts, off = (300, (1.5, 0.1)) if method == "tpe" else (400, (0.2, 0.01))
    tuning = tn.tune(log(), simulator=Spring(), method=method, iterations=rollouts)
    frame = tuning.to_frame()
    assert abs(frame.value["stiffness"] - TRUTH["stiffness"]) < off[0]
    assert abs(frame.value["damping"] - TRUTH["damping"]) < off[1]
    assert list(frame.index) == ["stiffness", "damping"]
    assert tuning.rollouts <= rollouts + 1


def test_brent_looks_where_the_user_does():
    class Stiff(Spring):
        parameters = Spring.parameters[:1]

        def rollout(self, values: Mapping[str, float]) -> Episode:
            return super().rollout({**TRUTH, **values})

    tuning = tn.tune(log(), simulator=Stiff(), method="brent", iterations=60)
    assert abs(tuning.to_frame().value["stiffness"] - TRUTH["stiffness"]) < 0.2
