"""A payload's review holds the torques, the arm and the terms that were found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.analysis.payload.test_payload import TWO_JOINTS, record
from tests.analysis.review.stored import Stored, reviewed
from tests.conftest import real
from tests.engines import needs_pybullet
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.review import payload_review_data
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.recorders.simulated import PayloadOrder, simulate_payload
from tunenet_logs.recorders.simulators.arm.path import link_poses

SLIDER = TWO_JOINTS.replace('name="elbow" type="revolute"', 'name="elbow" type="prismatic"')
ONE_JOINT = TWO_JOINTS.replace('name="elbow" type="revolute"', 'name="elbow" type="fixed"')


@pytest.fixture(scope="module")
def tuned() -> Tuning:
    """A Jaco as its driver publishes it."""
    return tune_episode(simulate_payload(PayloadOrder(mass_kg=0.7, is_driver=True)), TuneOptions())


@pytest.fixture(scope="module")
def review(tuned: Tuning, tmp_path_factory: pytest.TempPathFactory) -> Stored:
    return reviewed(tuned, tmp_path_factory.mktemp("review"))


def test_the_torques_lie_on_the_logs_time(tuned: Tuning, review: Stored):
    found = tuned.detection
    for joint in range(7):
        torque, residual = f"/torque/joint_{joint + 1}", f"/residual/joint_{joint + 1}"
        times, observed = review.series(f"{torque}/observed")
        assert times == pytest.approx(found.path.seconds, abs=1e-8)
        assert observed[:, 0] == pytest.approx(found.effort_nm[:, joint])
        _, simulated = review.series(f"{torque}/iterations")
        assert simulated.shape == (len(times), 7)
        assert review.series(f"{residual}/iterations")[1] == pytest.approx(simulated - observed)
        _, left = review.series(f"{residual}/fit")
        assert left[:, 0] == pytest.approx(-found.fit.residual_nm[:, joint])
    assert tuned.estimate is not None
    rollout = found.simulator.rollout({"payload_mass": float(tuned.estimate[0])})
    expected = rollout.signals["/joint_states.effort"].values
    _, simulated = review.series("/torque/joint_7/iterations")
    assert simulated[:, -1] == pytest.approx(expected[:, 6])


def test_the_arm_is_where_it_was_measured(tuned: Tuning, review: Stored):
    found = tuned.detection
    times, tool_m = review.series("/scene/arm/tool", "Transform3D:translation")
    assert np.diff(times).max() < 2 / 30
    at = np.column_stack(
        [np.interp(times, found.path.seconds, q) for q in found.path.position_rad.T]
    )
    assert tool_m[:, 0] == pytest.approx(link_poses(found.arm, at).position_m[:, -1], abs=1e-5)
    assert "/scene/arm/tool/payload" in review.entities


def test_joints_that_feel_the_payload_most_come_first_and_a_rejected_mass_is_not_shown(
    tuned: Tuning,
):
    data = payload_review_data(tuned)
    assert [joint + 1 for joint in data.order] == [2, 4, 5, 6, 3, 1, 7]
    assert data.has_estimate
    assert not payload_review_data(replace(tuned, verdict="rejected")).has_estimate


def test_every_kind_of_term_has_a_chart(tmp_path: Path):
    held = simulate_payload(PayloadOrder(mass_kg=0.7, is_driver=True))
    empty = record(tmp_path / "empty.mcap", is_empty=True, is_driver=True)
    review = reviewed(tune_episode(held, TuneOptions(tares=(empty,))), tmp_path)
    charts = [one for one in review.entities if one.startswith("/sheets/terms_")]
    assert sum(one.endswith("/values") for one in charts) == 7


@needs_pybullet
def test_without_a_fit_there_is_none_to_show(tmp_path: Path):
    episode = simulate_payload(PayloadOrder(mass_kg=0.7, preset="paper"))
    review = reviewed(tune_episode(episode, TuneOptions(preset="paper-code")), tmp_path)
    assert "/torque/joint_2/iterations" in review.entities
    assert not [one for one in review.entities if "fit" in one or "terms" in one]


@pytest.mark.parametrize(
    ("urdf", "joints"), [(TWO_JOINTS, 2), (SLIDER, 2), (ONE_JOINT, 1)], ids=["two", "slider", "one"]
)
def test_any_arm_has_a_review(tmp_path: Path, urdf: str, joints: int):
    path = tmp_path / "a.urdf"
    path.write_text(urdf)
    arm = {"urdf": path, "tool_link": "hand"}
    order = PayloadOrder(mass_kg=1.2, path="random", torque_noise_nm=0.05, seed=4, **arm)
    entities = reviewed(
        tune_episode(simulate_payload(order), TuneOptions(**arm)), tmp_path
    ).entities
    assert f"/torque/joint_{joints}/fit" in entities
    assert f"/torque/joint_{joints + 1}/fit" not in entities
    assert ("/scene/slides" in entities) == (urdf is SLIDER)


def test_a_fast_log_is_thinned(tmp_path: Path):
    episode = simulate_payload(PayloadOrder(mass_kg=0.7, rate_hz=1000.0, torque_noise_nm=0.2))
    review = reviewed(tune_episode(episode, TuneOptions()), tmp_path)
    times, _ = review.series("/torque/joint_2/observed")
    assert 400 < len(times) <= 700
    assert (tmp_path / "a.rrd").stat().st_size < 3e6


@pytest.mark.parametrize(
    ("bag", "shown"),
    [
        ("jaco_names_recorded_by_rosbag", "/torque/joint_2/observed"),
        ("jaco2_no_effort", "/recorded/joint_states.position/jaco_joint_1"),
    ],
)
def test_a_rejected_log_shows_what_was_recorded(tmp_path: Path, bag: str, shown: str):
    tuning = tune_log(real(f"ros1/{bag}.bag"), TuneOptions(task="payload"))
    assert tuning.verdict == "rejected"
    review = reviewed(tuning, tmp_path)
    assert shown in {one.replace("\\", "") for one in review.entities}
    assert b"rejected" in (tmp_path / "a.rrd").read_bytes()
