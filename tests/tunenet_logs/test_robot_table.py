"""Tables of robots: what is measured is used, what is commanded or modelled says so."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.analysis.payload.arm_log import read_arm_log
from tunenet_logs.copying import import_log
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.arm.description import jaco

RTDE = ("actual_q", "actual_qd", "actual_current", "target_moment", "target_q", "actual_TCP_pose")


def table(
    path: Path,
    stems: Sequence[str] = RTDE,
    joints: int = 6,
    *,
    time: str = "timestamp",
    separator: str = ",",
    form: str = "{}_{}",
) -> Path:
    """A table of 50 rows; the values of a quantity say which it is: 10 * its number + joint."""
    names = [form.format(stem, joint) for stem in stems for joint in range(joints)]
    rows = [
        [str(row if "dur" in time else row * 0.002)]
        + [str(10 * at + joint + row * 1e-3) for at in range(len(stems)) for joint in range(joints)]
        for row in range(50)
    ]
    path.write_text("\n".join(separator.join(row) for row in [[time, *names], *rows]) + "\n")
    return path


def skipped(episode: Episode) -> dict[str, str]:
    return {channel.topic: channel.skipped for channel in episode.channels if channel.skipped}


@pytest.mark.parametrize("separator", [",", " ", ";"])
def test_measured_joints_of_an_rtde_recording(tmp_path: Path, separator: str):
    episode = read_episode(table(tmp_path / "ur.csv", (*RTDE, "target_q"), separator=separator))
    assert set(episode.signals) == {"joints.position", "joints.velocity"}
    position = episode.signals["joints.position"]
    assert (position.columns[0], position.unit) == ("shoulder_pan_joint", "rad")
    np.testing.assert_allclose(position.values[0], range(6))
    assert position.stamps_ns[1] == 2_000_000
    reasons = skipped(episode)
    assert "the payload that was set" in reasons["target_moment 0 to 5"]
    assert reasons["target_q 0 to 5"] == "commanded, not measured"
    assert "--torque-constants K1,K2,K3,...,K6" in reasons["actual_current 0 to 5"]


def test_currents_become_torques_with_the_constants_that_are_said(tmp_path: Path):
    log = table(tmp_path / "ur.csv")
    with pytest.raises(NotFoundError) as refusal:  # which columns and option give torques
        read_arm_log(read_episode(log), jaco())
    for words in ("actual_current 0 to 5", "--torque-constants", "target_moment 0 to 5"):
        assert words in str(refusal.value)
    assert "\n" not in str(refusal.value)
    episode = read_episode(log, ReadOptions(torque_constants=(1, 2, 3, 4, 5, 6)))
    effort = episode.signals["joints.effort"]
    assert effort.unit == "N·m"
    np.testing.assert_allclose(effort.values[0], np.arange(1, 7) * np.arange(20, 26))
    stems = ("actual_q", "actual_current_as_torque", "target_moment")  # by the controller
    efforts = read_episode(table(tmp_path / "a.csv", stems)).signals["joints.effort"]
    np.testing.assert_allclose(efforts.values[0][:2], [10, 11])


@pytest.mark.parametrize(
    ("stems", "constants", "says"),
    [
        (RTDE, (1, 2), "has 2 numbers for the 6 joints of actual_current"),
        (("actual_q", "target_q"), (1, 2), "there are no measured currents"),
        (("target_q", "target_qd"), (), "commanded, not measured; record the measured position"),
    ],
)
def test_refusals(tmp_path: Path, stems: Sequence[str], constants: tuple[float, ...], says: str):
    log = table(tmp_path / "a.csv", stems)
    with pytest.raises(LogError, match=says):
        read_episode(log, ReadOptions(torque_constants=constants))


@pytest.mark.parametrize(
    ("form", "time", "step_ns"),
    [
        ("{}[{}]", "duration,success rate", 1_000_000),
        ("state.{}[{}]", "time,success_rate", 2_000),
        ("{}[{}]", "time", 2_000_000),
    ],
)
def test_measured_joints_of_a_franka(tmp_path: Path, form: str, time: str, step_ns: int):
    stems = ("q", "q_d", "dq", "dq_d", "tau_J", "tau_ext_hat_filtered")
    log = table(tmp_path / "f.csv", stems, 7, time=time, form=form)
    if "," in time:  # its rows have a cell more
        head, *rows = log.read_text().splitlines()
        log.write_text("\n".join([head, *(row.replace(",", ",1,", 1) for row in rows)]) + "\n")
    episode = read_episode(log)
    by_name = {name: one.values[0][1] for name, one in episode.signals.items()}
    assert by_name == {"joints.position": 1, "joints.velocity": 21, "joints.effort": 41}
    effort = episode.signals["joints.effort"]
    assert effort.columns == tuple(f"joint{n}" for n in range(1, 8))
    assert effort.stamps_ns[1] == step_ns
    estimates = [why for name, why in skipped(episode).items() if "tau_ext" in name]
    assert estimates == ["the controller's estimate, not a measurement"]


def test_two_names_for_one_quantity_are_a_question(tmp_path: Path):
    log = table(tmp_path / "a.csv", ("actual_q", "measured_q", "actual_qd"))
    episode = read_episode(log)
    assert set(episode.signals) == {"joints.velocity"}
    assert "say which: --columns position_1=" in skipped(episode)["actual_q 0 to 5"]
    said = ReadOptions(columns={"t": "timestamp", "position_1": "measured_q_0"})
    assert read_episode(log, said).signals["joints.position"].values[0] == [10]


def test_rows_that_are_cut_are_counted_and_joints_that_lack_a_quantity_imported(tmp_path: Path):
    log = table(tmp_path / "ur.csv")
    log.write_text(log.read_text()[:-40])
    episode = read_episode(log)
    assert len(episode.signals["joints.position"].stamps_ns) == 49
    assert "1 of 50 rows could not be read" in episode.warnings[0]
    log.write_text("t,q_1,q_2,qd_1\n0,1,2,3\n0.1,1,2,\n")
    import_log(log, tmp_path / "a.mcap")
    signals = read_episode(tmp_path / "a.mcap").signals
    assert signals["/joints.position"].columns == ("joint1", "joint2")
    np.testing.assert_array_equal(signals["/joints.velocity"].values[0], [3, np.nan])
