"""A payload's review holds the torques, the arm and the terms that were found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from tests.analysis.drop.test_review import contents, verified
from tests.analysis.payload.test_payload import TWO_JOINTS, record
from tests.conftest import real
from tests.engines import needs_pybullet
from tunenet_logs.analysis.experiment import Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload.review import payload_radius_m, payload_review_data
from tunenet_logs.analysis.review.tuning import write_review
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulated import PayloadOrder, simulate_payload
from tunenet_logs.recorders.simulators.arm.path import link_poses

SLIDER = TWO_JOINTS.replace('name="elbow" type="revolute"', 'name="elbow" type="prismatic"')
ONE_JOINT = TWO_JOINTS.replace('name="elbow" type="revolute"', 'name="elbow" type="fixed"')


def series(path: Path, entity: str, component: str) -> tuple[Array, Array]:
    """Times [s] of an entity on the log's time, and the values of one component."""
    for chunk in RrdReader(path).stream():
        if str(chunk.entity_path) == entity and "log_time_s" in chunk.timeline_names:
            batch = chunk.to_record_batch()
            columns = dict(zip(batch.schema.names, batch.columns, strict=True))
            times = columns["log_time_s"].cast("int64").to_numpy().astype(np.float64) * 1e-9
            return times, np.array(columns[component].to_pylist(), np.float64)
    raise AssertionError(entity)


def drawn(tuning: Tuning, folder: Path) -> Path:
    path = folder / "a.rrd"
    write_review(tuning, record_of(tuning), path)
    verified(path)
    return path


@pytest.fixture(scope="module")
def tuned() -> Tuning:
    """A Jaco as its driver publishes it."""
    return tune_episode(simulate_payload(PayloadOrder(mass_kg=0.7, is_driver=True)), TuneOptions())


@pytest.fixture(scope="module")
def review(tuned: Tuning, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return drawn(tuned, tmp_path_factory.mktemp("review"))


def test_the_torques_lie_on_the_logs_time(tuned: Tuning, review: Path):
    found = tuned.detection
    for joint in range(7):
        torque, residual = f"/torque/joint_{joint + 1}", f"/residual/joint_{joint + 1}"
        times, observed = series(review, f"{torque}/observed", "Scalars:scalars")
        assert times == pytest.approx(found.path.seconds, abs=1e-8)
        assert observed[:, 0] == pytest.approx(found.effort_nm[:, joint])
        _, simulated = series(review, f"{torque}/iterations", "Scalars:scalars")
        assert simulated.shape == (len(times), 7)
        _, off = series(review, f"{residual}/iterations", "Scalars:scalars")
        assert off == pytest.approx(simulated - observed)
        _, left = series(review, f"{residual}/fit", "Scalars:scalars")
        assert left[:, 0] == pytest.approx(-found.fit.residual_nm[:, joint])


def test_the_last_iteration_is_the_rigid_arm_with_the_result(tuned: Tuning, review: Path):
    _, simulated = series(review, "/torque/joint_2/iterations", "Scalars:scalars")
    assert tuned.estimate is not None
    rollout = tuned.detection.simulator.rollout({"payload_mass": float(tuned.estimate[0])})
    expected = rollout.signals["/joint_states.effort"].values
    assert simulated[:, -1] == pytest.approx(expected[:, 1])


def test_the_fit_explains_what_the_rigid_arm_does_not(tuned: Tuning):
    data = payload_review_data(tuned)
    assert data.fitted is not None
    rigid, fitted = (
        np.sqrt(np.mean((one.effort_nm - data.observed_nm) ** 2))
        for one in (data.simulated[-1], data.fitted)
    )
    assert fitted < 0.25
    assert rigid > 1.5 * fitted


def test_joints_that_feel_the_payload_most_come_first(tuned: Tuning):
    data = payload_review_data(tuned)
    assert [joint + 1 for joint in data.order] == [2, 4, 5, 6, 3, 1, 7]


def test_the_arm_is_where_it_was_measured(tuned: Tuning, review: Path):
    found = tuned.detection
    times, tool_m = series(review, "/scene/arm/tool", "Transform3D:translation")
    assert np.diff(times).max() < 2 / 30
    at = np.column_stack(
        [np.interp(times, found.path.seconds, q) for q in found.path.position_rad.T]
    )
    assert tool_m[:, 0] == pytest.approx(link_poses(found.arm, at).position_m[:, -1], abs=1e-5)
    entities = contents(review)
    for number in range(1, 8):
        assert entities[f"/scene/arm/link_{number}"] == {"static", "log_time_s"}
    assert entities["/scene/arm/tool/payload"] == {"static"}


def test_a_heavier_payload_is_a_larger_ball_that_can_be_seen():
    sizes = [payload_radius_m(mass, 1.0) for mass in (-1.0, 0.0, 0.1, 0.5, 2.0, 1e3)]
    assert sizes == sorted(sizes)
    assert sizes[0] > 0.01
    assert sizes[-1] < 0.2
    assert sizes[3] == pytest.approx((3 * 0.5 / (4 * np.pi * 1000)) ** (1 / 3))


def test_iterations_can_be_scrubbed_over_fixed_torques(review: Path):
    entities = contents(review)
    for joint in range(1, 8):
        assert entities[f"/sheets/torque_{joint}/observed"] == {"static"}
        assert entities[f"/sheets/torque_{joint}/simulated"] >= {"iteration"}
    assert entities["/sheets/convergence/values"] == {"static"}
    assert entities["/sheets/convergence/current"] >= {"iteration", "log_time_s"}
    assert entities["/step"] >= {"iteration"}


def test_every_kind_of_term_has_a_chart(tmp_path: Path):
    held = simulate_payload(PayloadOrder(mass_kg=0.7, is_driver=True))
    empty = record(tmp_path / "empty.mcap", is_empty=True, is_driver=True)
    tuning = tune_episode(held, TuneOptions(tares=(empty,)))
    entities = contents(drawn(tuning, tmp_path))
    charts = [
        one for one in entities if one.startswith("/sheets/terms_") and one.endswith("/values")
    ]
    assert len(charts) == 7
    assert entities["/terms"] == {"static"}


@needs_pybullet
def test_without_a_fit_there_is_none_to_show(tmp_path: Path):
    episode = simulate_payload(PayloadOrder(mass_kg=0.7, preset="paper"))
    entities = contents(drawn(tune_episode(episode, TuneOptions(preset="paper-code")), tmp_path))
    assert "/torque/joint_2/iterations" in entities
    assert not [one for one in entities if "fit" in one or "terms" in one]


@pytest.mark.parametrize(
    ("urdf", "joints"), [(TWO_JOINTS, 2), (SLIDER, 2), (ONE_JOINT, 1)], ids=["two", "slider", "one"]
)
def test_any_arm_has_a_review(tmp_path: Path, urdf: str, joints: int):
    path = tmp_path / "a.urdf"
    path.write_text(urdf)
    order = PayloadOrder(
        mass_kg=1.2, urdf=path, tool_link="hand", path="random", torque_noise_nm=0.05, seed=4
    )
    selection = TuneOptions(urdf=path, tool_link="hand")
    tuning = tune_episode(simulate_payload(order), selection)
    entities = contents(drawn(tuning, tmp_path))
    assert f"/torque/joint_{joints}/fit" in entities
    assert f"/torque/joint_{joints + 1}/fit" not in entities
    assert ("/scene/slides" in entities) == (urdf is SLIDER)


def test_a_fast_log_is_thinned(tmp_path: Path):
    episode = simulate_payload(PayloadOrder(mass_kg=0.7, rate_hz=1000.0, torque_noise_nm=0.2))
    path = drawn(tune_episode(episode, TuneOptions()), tmp_path)
    times, _ = series(path, "/torque/joint_2/observed", "Scalars:scalars")
    assert 400 < len(times) <= 700
    assert path.stat().st_size < 3e6


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
    path = drawn(tuning, tmp_path)
    assert shown in {one.replace("\\", "") for one in contents(path)}
    assert b"rejected" in path.read_bytes()


def test_a_rejected_mass_is_not_shown(tuned: Tuning):
    assert payload_review_data(tuned).has_estimate
    assert not payload_review_data(replace(tuned, verdict="rejected")).has_estimate
