"""Motion prediction: its figures, one step of the engine, and predictors that learn."""

from __future__ import annotations

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import FILM_TRAININGS, TRAININGS
from tunenet_logs.analysis.estimators.methods import TuneNet
from tunenet_logs.analysis.evaluation.studies.drop_methods import EASY, draw_targets
from tunenet_logs.analysis.evaluation.studies.motion import (
    EngineStep,
    Memoryless,
    MotionError,
    NeuralRecipe,
    OneStepTraining,
    Transitions,
    Tuners,
    VrnnRecipe,
    VrnnSizes,
    first_weights,
    motion_error,
    motion_table,
    one_step_errors,
    predict,
    record_states,
    recurrent_unit,
    remember,
    stand_still,
    train_vrnn,
    training_drops,
    tuning_errors,
)
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)
SHORT = OneStepTraining(
    60, NeuralRecipe(epochs=15, batch=256), VrnnRecipe(VrnnSizes(16, 2, 16), epochs=4, batch=20)
)


@pytest.fixture(scope="module")
def tuners() -> Tuners:
    model = shipped_model(TRAININGS["paper-code"].purpose)
    filmed = shipped_model(FILM_TRAININGS["paper"].purpose)
    return Tuners(model, TuneNet(model), filmed, TuneNet(filmed))


@pytest.fixture(scope="module")
def learned() -> dict[str, MotionError]:
    return one_step_errors(draw_targets(EASY, 20, 0), 0, SHORT, QUIET)


def test_figures_are_means_over_runs_and_steps():
    found = motion_error(np.array([[1.1, 0.5], [2.0, 3.0]]), np.array([[1.0, 0.5], [2.5, 4.0]]))
    assert found.cm == pytest.approx(100 * (0.1 + 0 + 0.5 + 1) / 4)
    assert found.percent == pytest.approx(100 * (0.1 + 0 + 0.2 + 0.25) / 4)


@needs_pybullet
@pytest.mark.slow
def test_zero_and_untuned_rows(tuners: Tuners):
    found = tuning_errors(draw_targets(EASY, 100, 0), tuners, QUIET)
    assert found["zero"].percent == pytest.approx(100)
    assert found["zero"].cm == pytest.approx(97.0, abs=2)  # the paper's
    # Not the paper's 20.57 %, 13.8 cm: those need another guess than U(.3, .7), see below.
    assert found["untuned"].percent == pytest.approx(10.9, abs=1.2)
    assert found["untuned"].cm == pytest.approx(8.9, abs=0.8)
    assert found["tunenet-gt"].percent < 1.08 * 1.6
    assert found["tunenet-gt"].cm < 0.7 * 1.6
    assert found["ours"] == found["tunenet-gt"]  # the same method here
    assert 2 < found["tunenet-obs"].percent < 12  # the paper's: 6.03, of one seed
    # What gives the published row: one restitution for every ball.
    rng = np.random.default_rng(1)
    release_m, truth = rng.uniform(4, 5, 200), rng.uniform(0.3, 0.7, 200)
    fixed, true = (record_states(release_m, one) for one in (np.full(200, 0.665), truth))
    published = motion_error(fixed[:, 1:, 0], true[:, 1:, 0])
    assert published.percent == pytest.approx(20.57, rel=0.08)
    assert published.cm == pytest.approx(13.8, rel=0.08)


@needs_pybullet
def test_one_step_from_any_state_is_that_of_an_uninterrupted_run():
    for restitution in (0.3, 0.5, 0.7):
        run = record_states(np.array([4.3]), np.array([restitution]))[0]
        engine = EngineStep(restitution)
        backwards = np.arange(400)[::-1]  # no state follows the one before it
        np.testing.assert_allclose(engine(run[backwards]), run[backwards + 1], rtol=0, atol=1e-12)
        free = predict(Memoryless(engine), run[None], 0)
        np.testing.assert_allclose(free, run[None, 1:, 0], rtol=0, atol=1e-12)
    assert np.ptp(run[300:, 0]) < 0.05  # the ball came to rest: resting contacts are among them


def test_a_prediction_sees_what_it_is_said_to_see():
    truth = np.cumsum(np.ones((1, 6, 2)), axis=1)  # 1, 2, ... 6
    still = Memoryless(stand_still)
    assert predict(still, truth, 5).tolist() == [[1, 2, 3, 4, 5]]
    assert predict(still, truth, 2).tolist() == [[1, 2, 3, 3, 3]]
    assert predict(still, truth, 0).tolist() == [[1, 1, 1, 1, 1]]


@needs_pybullet
@pytest.mark.slow
def test_short_training_beats_standing_still(learned: dict[str, MotionError]):
    assert learned["still-ahead"].cm == pytest.approx(1.82, abs=0.15)
    assert learned["neural-ahead"].cm < 0.5 * learned["still-ahead"].cm
    assert learned["hybrid-ahead"].cm < 0.1 * learned["still-ahead"].cm
    assert learned["neural-rollout"].cm < 97  # it does not run away


@needs_pybullet
@pytest.mark.slow
def test_the_hybrid_remembers_the_impacts_that_it_saw():
    drops = training_drops(200, 0, QUIET)
    drops = Transitions(drops.states[:, :151], drops.simulated[:, :150])
    hybrid = train_vrnn(drops, VrnnRecipe(epochs=20, batch=20), 0, QUIET)
    restitution = np.array([0.3, 0.35, 0.65, 0.7])
    truth = record_states(np.linspace(4.1, 4.9, 4), restitution)
    memory = hybrid.start(4)
    for step in range(100):
        _, pending = hybrid.forecast(memory, truth[:, step])
        memory = hybrid.learn(pending, truth[:, step + 1])
    # One and the same impact for all: what differs is what was seen before.
    speeds = hybrid.forecast(memory, np.tile([0.47, -4.0], (4, 1)))[0][:, 1]
    dull, bouncy = speeds[:2].max(), speeds[2:].min()
    assert bouncy > dull + 0.4


@pytest.mark.slow
def test_the_memory_is_that_of_torch():
    import torch

    sizes = VrnnSizes(8, 2, 5)
    weights = first_weights(sizes.layers(), np.random.default_rng(0))
    unit = recurrent_unit(weights, sizes)
    inputs = np.random.default_rng(1).normal(size=(7, 3, 6))
    with torch.no_grad():
        wanted, _ = unit(torch.tensor(inputs, dtype=torch.float32))
    memory = np.zeros((3, 5))
    for step in range(7):
        memory = remember(weights, memory, inputs[step, :, :2], inputs[step, :, 2:])
        np.testing.assert_allclose(memory, wanted[step].numpy(), atol=1e-6)


@needs_pybullet
@pytest.mark.slow
def test_a_hybrid_that_sees_nothing_cannot_use_the_truth():
    drops = training_drops(4, 0, QUIET)
    hybrid = train_vrnn(drops, VrnnRecipe(VrnnSizes(8, 2, 8), epochs=1, batch=4), 0, QUIET)
    other = drops.states.copy()
    other[:, 1:] += 1.0
    assert np.array_equal(predict(hybrid, drops.states, 0), predict(hybrid, other, 0))
    assert not np.array_equal(predict(hybrid, drops.states, 9), predict(hybrid, other, 9))


@needs_pybullet
@pytest.mark.slow
def test_the_same_seed_gives_the_same_figures(tuners: Tuners):
    tiny = OneStepTraining(
        10, NeuralRecipe(8, 2), VrnnRecipe(VrnnSizes(8, 2, 8), epochs=1, batch=5)
    )
    first, again, other = (
        motion_table([seed], 3, lambda _: tuners, QUIET, tiny) for seed in (4, 4, 5)
    )
    assert first == again
    assert all(one.ours != two.ours for one, two in zip(first, other, strict=True) if one.ours)
    assert all(row.ours for row in first)
