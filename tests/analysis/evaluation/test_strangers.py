"""Payloads: what was drawn is found by both baselines, the bound and the whole road."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.engines import needs_pybullet
from tunenet_logs.analysis.drop.presets import TRAININGS
from tunenet_logs.analysis.evaluation.studies import payload
from tunenet_logs.analysis.evaluation.studies.network import ROLLOUTS, drawn_payload, drop_rows
from tunenet_logs.analysis.evaluation.study import Order, Row
from tunenet_logs.analysis.evaluation.worlds import arm
from tunenet_logs.analysis.evaluation.worlds.ball import CELLS, draw_drop
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.torque_model import CONVENTIONS
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.recorders.simulators.arm.description import JACO_TOOL_LINK, JACO_URDF
from tunenet_logs.terminal import Progress

SEED = 2000  # below the command's, above those of the fit's development
MODEL = arm.described_arm(JACO_URDF)
FRAME = MODEL.getFrameId(JACO_TOOL_LINK)
EFFORT = "/joint_states.effort"
QUIET = Progress(quiet=True)


def test_clean_logs_are_answered_within_10_g():
    for one in range(6):
        log = arm.stranger_log(JACO_URDF, JACO_TOOL_LINK, SEED + one, arm.CLEAN)
        answer = payload.stranger_answer(log.held.episode, ())
        assert answer is not None
        assert answer.convention == payload.PLAIN
        assert answer.mass_kg == pytest.approx(log.mass_kg, abs=0.01)


@pytest.mark.parametrize("number", [SEED, SEED + 1, SEED + 2])
def test_baselines_recover_a_clean_log_with_a_centred_payload(number: int):
    """Its payload is pulled into the tool frame's origin."""
    log = arm.stranger_log(JACO_URDF, JACO_TOOL_LINK, number, arm.Troubles(noise=0.0005))
    effort = log.held.episode.signals[EFFORT]
    moments_nm = log.held.feels[..., 1:] @ (log.mass_kg * log.centre_m)
    pulled = replace(effort, values=effort.values - moments_nm)
    held = replace(log.held.episode, signals={**log.held.episode.signals, EFFORT: pulled})
    # Its smoothed accelerations are a little small, which costs it up to 20 g.
    assert payload.least_squares(MODEL, FRAME, held) == pytest.approx(log.mass_kg, abs=0.025)
    subtracted = payload.tare_subtracted(MODEL, FRAME, held, log.empty.episode)
    assert subtracted == pytest.approx(log.mass_kg, abs=0.005)


def test_the_bound_is_a_bound_on_noise_alone():
    """The best linear estimate from noise attains it, one of half of the samples does not."""
    log = arm.stranger_log(JACO_URDF, JACO_TOOL_LINK, SEED, arm.LIGHT)
    held, rng = log.held, np.random.default_rng(1)
    samples, joints, _ = held.feels.shape
    offsets = np.broadcast_to(np.eye(joints), (samples, joints, joints))
    slopes = np.concatenate([held.feels, offsets], -1) / held.noise_nm[:, None]
    slopes = slopes.reshape(-1, 4 + joints)
    known = np.diag(np.sqrt(len(log.empty.seconds)) / held.noise_nm)
    tare = np.hstack([np.zeros((joints, 4)), known])

    def scatter(rows: np.ndarray) -> float:
        """Standard deviation of the mass from noise of 1 in each row."""
        by_noise = np.linalg.pinv(rows)[0]
        return float(np.std([by_noise @ rng.standard_normal(len(rows)) for _ in range(2000)]))

    for empty, more in ((None, np.zeros((0, 4 + joints))), (log.empty, tare)):
        bound = payload.bound_kg(held, empty)
        assert scatter(np.vstack([slopes, more])) == pytest.approx(bound, rel=0.06)
        assert scatter(np.vstack([slopes[: len(slopes) // 2], more])) > 1.06 * bound
    assert 0 < payload.bound_kg(held, log.empty) < payload.bound_kg(held, None)


def test_what_another_driver_means():
    """Its sign is turned, the arm's own weight at the said positions taken out, and no more."""
    log = arm.stranger_log(JACO_URDF, JACO_TOOL_LINK, SEED, arm.LIGHT)
    plain_nm, turned_nm, bare_nm, both_nm = (
        payload.as_meant(MODEL, log.held, convention).signals[EFFORT].values
        for convention in CONVENTIONS
    )
    assert CONVENTIONS[0] == payload.PLAIN
    assert np.array_equal(plain_nm, log.held.episode.signals[EFFORT].values)
    assert np.array_equal(turned_nm, -plain_nm)
    assert np.allclose(both_nm, -bare_nm)
    weight_nm = plain_nm - bare_nm
    assert np.abs(weight_nm[:, 0]).max() < 1e-9  # the first axis is upright
    assert np.abs(weight_nm[:, 1]).max() > 1


# ---- The other sections: the paper's masses, and logs like a real driver's.


def rows_of(section: str, targets: int) -> list[Row]:
    order = Order((1, 2), targets, (section,), 2, pairs=600, epochs=10)
    (part,) = payload.run(order, QUIET)
    return list(part.rows)


@pytest.mark.slow
def test_baselines_are_the_papers_and_what_is_linear_is_found_exactly():
    """Also from a training of seconds, and a kilogram beyond it."""
    errors: dict[tuple[str, str], list[float]] = {}
    for row in rows_of("masses", 60):
        errors.setdefault((row["method"], row["set"]), []).append(row["mae_kg"])
    mean = {key: float(np.mean(some)) for key, some in errors.items()}
    assert mean["one", "test"] == pytest.approx(0.504, abs=0.06)
    assert mean["mean", "test"] == pytest.approx(0.255, abs=0.04)
    assert mean["mean", "validation"] == pytest.approx(0.25, abs=0.04)
    for which in ("validation", "test"):
        assert mean["secant", which] < 1e-9
        assert mean["default", which] < 1e-4
        assert mean["default-1", which] > mean["default", which]


@pytest.mark.slow
def test_logs_go_the_whole_way():
    few = {row["case"]: row for row in rows_of("logs", 3)}
    assert len(few) == len(payload.CASES)
    assert all(row["logs"] == 2 for row in few.values())
    clean = few["noise of 0.05 N·m alone, circle"]
    assert clean["answered"] == 1
    assert clean["mae"] < 0.005
    tared, alone = few["driver, circle, tare"], few["driver, circle"]
    assert tared["width"] < 0.5 * alone["width"]


# ---- What the network's start is worth.


def test_where_there_is_an_exact_fit_the_start_changes_nothing():
    held, mass_kg, tare = drawn_payload(1, 0)
    drop = draw_drop(CELLS[0], 1, 0)
    for episode, truth, tares in (
        (held, mass_kg, (tare,)),
        (drop.episode(), drop.ball.restitution, ()),
    ):
        both = [
            tune_episode(episode, TuneOptions(method=method, tares=tares))
            for method in ("tunenet+refine", "fit")
        ]
        values = [one.estimate[0] for one in both if one.estimate is not None]
        assert values == pytest.approx([truth] * 2, abs=0.03)
        assert values[0] == pytest.approx(values[1], abs=1e-9)
        assert [one.rollouts for one in both] == [7, 2]


@needs_pybullet
def test_every_method_is_charged_for_its_rollouts():
    model = shipped_model(TRAININGS["paper-code"].purpose)
    rows = drop_rows({1: model}, Order((1,), 3, jobs=1), QUIET)
    easy = {(one["method"], one["rollouts"]): one["mae"] for one in rows[: 6 * len(ROLLOUTS)]}
    assert len(easy) == len(rows) / 4
    assert easy["network, then lines", 5] < easy["network", 5] < easy["Brent", 3]
