"""Every rollout is counted, by the simulator, and nothing leaves the bounds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import numpy as np
import pytest

from tunenet_logs.analysis.estimators.base import Observation, Problem
from tunenet_logs.analysis.estimators.methods import TuneNet
from tunenet_logs.analysis.tunenet.network import Model
from tunenet_logs.episode import Episode, EpisodeInfo
from tunenet_logs.errors import UsageError
from tunenet_logs.recorders.simulators.ball import RESTITUTION
from tunenet_logs.recorders.simulators.base import Parameter


class Line:
    """A simulator whose observation is its parameter."""

    parameters = (RESTITUTION,)
    engine = "none"
    step_hz = 1.0

    def rollout(self, values: Mapping[str, float]) -> Episode:
        return Episode(EpisodeInfo(truth=values), {})


def observe(episode: Episode) -> Observation:
    value = np.array([[episode.info.truth["restitution"]]])
    return Observation(value, np.zeros(1), "nothing", ("value",))


def problem(target: float, initial: float = 0.0) -> Problem:
    wanted = Observation(np.array([[target]]), np.zeros(1), "nothing", ("value",))
    return Problem(wanted, Line(), observe, np.array([initial]))


def network(gain: float) -> Model:
    """The residual, times a gain: what a trained network is, near enough."""
    return cast("Model", lambda proposed, target: gain * (target - proposed)[:, :, 0])


def test_each_iteration_is_one_rollout_of_the_simulator():
    asked = problem(0.8)
    trace = TuneNet(network(0.5)).estimate(asked, 4)
    assert [step.rollouts for step in trace.steps] == [0, 1, 2, 3, 4]
    assert asked.rollouts == 4
    assert [float(step.values[0]) for step in trace.steps] == pytest.approx(
        [0, 0.4, 0.6, 0.7, 0.75]
    )
    assert trace.estimate[0] == pytest.approx(0.75)


def test_iterates_are_clamped_to_what_physics_allows():
    trace = TuneNet(network(5.0)).estimate(problem(0.9), 3)
    assert all(0 <= step.values[0] <= 1 for step in trace.steps)
    assert trace.steps[1].values[0] == 1


@pytest.mark.parametrize("initial", [-0.1, 1.5, np.nan])
def test_a_bad_first_guess_never_reaches_the_simulator(initial: float):
    with pytest.raises(UsageError, match="restitution"):
        problem(0.5, initial)


def test_parameters_check_their_values():
    mass: Any = Parameter("payload_mass", "kg", (0.0, 5.0), (0.0, 2.0), 1.0)
    assert mass.checked(2) == 2.0
    with pytest.raises(UsageError, match="payload_mass"):
        mass.checked(-1)
