"""Commands of joints: in every reader they are signals of one name, and never a measured state."""

from __future__ import annotations

import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.reading import read, skipped
from tunenet_logs.copying import import_log
from tunenet_logs.episode import Array, Episode
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.formats.columns.angles import told_by_values
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode, without_commands

STATES, COMMANDS = ("lift", "pan"), {"position": 3.0, "velocity": 4.0, "effort": 5.0, "": 6.0}


@pytest.mark.parametrize(
    ("column", "name", "joint"),
    [
        *((f"{word}_lift_pos", "commands.position", "lift") for word in (
            "goal", "target", "desired", "des", "cmd", "command", "reference", "ref", "action")),
        *((text, "commands.position", "lift") for text in (
            "action.lift.pos", "lift.pos.target", "goal_position_lift", "lift/position_setpoint")),
        *((text, "commands", "lift") for text in (
            "action.lift", "lift_cmd", "lift target", "ctrl_lift")),
        *(("target_velocity_lift", "commands.velocity", "lift"),
          ("lift_effort_cmd", "commands.effort", "lift")),
    ],
)  # fmt: skip
def test_what_a_command_is_called(tmp_path: Path, column: str, name: str, joint: str):
    rows = "".join(f"{row / 10},{row},{row + 1},{row + 2}\n" for row in range(9))
    episode = read(tmp_path, f"t,lift_pos,pan_pos,{column}\n{rows}")
    signal = episode.signals[name]
    assert (signal.columns, signal.drives) == ((joint,), True)
    np.testing.assert_allclose(signal.values[:, 0], np.arange(9) + 2)
    assert episode.signals["joints.position"].columns == ("lift", "pan")
    assert set(without_commands(episode).signals) == {"joints.position"}
    channel = next(one for one in episode.channels if one.topic == name)
    assert channel.drives


@pytest.mark.parametrize(
    ("column", "why"),
    [
        *((text, "no effort") for text in ("torque_enable", "lift_torque_enabled", "torque_on")),
        *((text, "no position") for text in ("position_mode", "lift_position_p_gain")),
        *((text, "asked for") for text in ("target", "action_mode_lift", "goal_name", "wrist_cmd")),
    ],
)
def test_switches_and_commands_of_nothing_are_none(tmp_path: Path, column: str, why: str):
    episode = read(tmp_path, f"t,lift_pos,pan_pos,{column}\n0,1,2,1\n0.1,1,2,1\n")
    assert set(episode.signals) == {"joints.position"}
    assert why in skipped(episode)[column] or skipped(episode)[column].startswith("its name says")


@pytest.mark.parametrize("off", [0.3, 3.0])
def test_commands_of_no_quantity_are_of_positions_where_these_follow(tmp_path: Path, off: float):
    rows = "".join(f"{k / 10},{k % 7},{k % 7 + off}\n" for k in range(60))
    episode = read(tmp_path, f"t,lift_pos,action.lift\n{rows}")
    name, unit = ("commands.position", "rad") if off < 1 else ("commands", "")
    assert (episode.signals[name].unit, len(episode.signals)) == (unit, 2)


def test_numbered_commands_and_lists(tmp_path: Path):
    rows = [{"time": row / 50, "dof_pos": [row, 2.0, 3.0], "action": [4.0, row, 6.0]}
            for row in range(9)]  # fmt: skip
    path = tmp_path / "a.json"
    path.write_text(json.dumps(rows))
    signals = read_episode(path).signals
    position, command = signals["joints.position"], signals["commands"]
    assert position.columns == command.columns == ("joint1", "joint2", "joint3")
    np.testing.assert_allclose(command.values[:, 1], range(9))
    assert (command.unit, command.drives) == ("", True)


def servo(path: Path, *, fields: tuple[str, ...] = ("position", "goal_position")) -> Path:
    """Records of one servo, and numbers beside them, as BAM writes them."""
    entries = [
        {"timestamp": row * 0.005, "torque_enable": True, "load": 7}
        | {name: np.sin(row * 0.05) + at for at, name in enumerate(fields)}
        for row in range(60)
    ]
    path.write_text(json.dumps({"mass": 0.5, "kp": 400, "motor": "a", "entries": entries}))
    return path


def test_a_bare_position_beside_its_command_is_a_servos(tmp_path: Path):
    episode = read_episode(servo(tmp_path / "a.json"))
    assert set(episode.signals) == {"joints.position", "commands.position", "commands.power"}
    command = episode.signals["commands.position"]
    assert command.columns == episode.signals["joints.position"].columns == ("joint1",)
    np.testing.assert_allclose(command.values[:, 0], np.sin(np.arange(60) * 0.05) + 1)
    assert np.all(episode.signals["commands.power"].values == 1)


def test_motions_of_lists_side_by_side(tmp_path: Path):
    motions = [
        {"type": "chirp", "actions": list(np.sin(np.arange(20 + at) / 3)),
         "sensor_data": list(np.sin(np.arange(20 + at) / 3 - 0.1))} for at in range(3)
    ]  # fmt: skip
    document = {"config": {"action_hz": 50, "limits": [-1, 1]}, "data": motions}
    path = tmp_path / "a.json"
    path.write_text(json.dumps(document))
    columns = {"position_1": "sensor_data", "command_1": "actions"}
    signals = read_episode(path, ReadOptions(columns=columns)).signals
    names = [f"{one}.run{at}.position" for one in ("commands", "joints") for at in (1, 2, 3)]
    assert sorted(signals) == names
    for at, motion in enumerate(motions, 1):
        command = signals[f"commands.run{at}.position"]
        np.testing.assert_allclose(command.values[:, 0], motion["actions"])
        assert command.rate_hz == pytest.approx(50)
    with pytest.raises(LogError, match="'actions': it is what was asked for"):
        read_episode(path)


@pytest.mark.parametrize("words", [("1", "0"), ("True", "False")])
def test_when_a_motor_was_on_is_a_signal(tmp_path: Path, words: tuple[str, str]):
    rows = "".join(f"{k / 10},{k},{k},{words[k >= 6]},1\n" for k in range(20))
    head = "t,lift_pos,goal_lift_pos,lift_torque_enable,pan_torque_enable"
    episode = read(tmp_path, f"{head}\n{rows}")
    power = episode.signals["commands.power"]
    assert (power.columns, power.unit, power.drives) == (("lift",), "1", True)
    np.testing.assert_array_equal(power.values[:, 0], np.arange(20) < 6)
    assert np.isfinite(episode.signals["commands.position"].values).all()
    assert any("14 of 20 rows 'lift_torque_enable' is off" in one for one in episode.warnings)
    assert "a switch" in skipped(episode)["pan_torque_enable"]  # of a joint that nothing commands


def sage(folder: Path, joints: int = 3, *, commanded: int | None = None, names: str = "") -> Path:
    """A motion as SAGE writes it: two tables whose cells are lists, times in us."""
    folder.mkdir(parents=True)
    times = np.arange(40) * 20_000.0 + 5.8
    states, commands = (
        [str([row * 0.01 + joint + shift for joint in range(count)]) for row in range(40)]
        for shift, count in ((0.0, joints), (0.5, commanded or joints))
    )
    rows = [f'CONTROL,{t},"{cell}"' for t, cell in zip(times, commands, strict=True)]
    (folder / "control.csv").write_text("type,timestamp,positions\n" + "\n".join(rows))
    rows = [f'STATE_MOTOR,{t},"{c}","{c}","{c}"' for t, c in zip(times, states, strict=True)]
    head = "type,timestamp,positions,velocities,torques\n"
    (folder / "state_motor.csv").write_text(head + "\n".join(rows))
    (folder / "event.csv").write_text("type,timestamp,event\nEVENT,0,MOTION_START\n")
    if names:
        (folder / "joint_list.txt").write_text(names)
    return folder


@pytest.mark.parametrize("file", ["", "control.csv", "state_motor.csv"])
def test_commands_in_a_file_beside_the_states(tmp_path: Path, file: str):
    folder = sage(tmp_path / "wave", names="Pan\nLift\nJaw\n")
    episode = read_episode(folder / file if file else folder)
    parts = ("joints.position", "joints.velocity", "joints.effort", "commands.position")
    assert tuple(episode.signals) == parts
    assert {one.columns for one in episode.signals.values()} == {("Pan", "Lift", "Jaw")}
    position, command = episode.signals["joints.position"], episode.signals["commands.position"]
    np.testing.assert_allclose(command.values - position.values, 0.5)
    assert command.seconds[-1] == pytest.approx(39 * 0.02)
    assert (position.drives, command.drives, episode.warnings) == (False, True, ())


def test_what_lies_beside_the_states_is_not_trusted(tmp_path: Path):
    folder = sage(tmp_path / "a", commanded=2)
    episode = read_episode(folder)
    assert episode.signals["commands.position"].columns == ("command1", "command2")
    assert any("different numbers of joints" in one for one in episode.warnings)
    other = sage(tmp_path / "b", names="Pan\nLift\n")
    assert any("names 2 joints" in one for one in read_episode(other).warnings)
    for text in ("", "\n\n", "a\n1\n", "type,timestamp,positions\n", "\0" * 99):
        (other / "control.csv").write_text(text)
        assert "commands.position" not in read_episode(other / "state_motor.csv").signals
    (folder / "control.csv").rename(tmp_path / "control.csv")
    (other / "control.csv").unlink()
    (other / "control.csv").symlink_to(tmp_path / "control.csv")
    assert "commands.position" not in read_episode(other / "state_motor.csv").signals


def copied(log: Path) -> tuple[Episode, Episode]:
    """A log's episode, and that of its import, whose topics have the same names in ROS' way."""
    copy = log.with_name("copy.mcap")
    import_log(log, copy)
    return read_episode(log), read_episode(copy)


@pytest.mark.parametrize("head", ["lift_pos,goal_lift_pos", "lift_pos,action.lift"])
def test_an_import_keeps_commands_as_what_they_are(tmp_path: Path, head: str):
    rows = "".join(f"{k / 10},{k % 7},{k % 5 - 9}\n" for k in range(60))
    (tmp_path / "a.csv").write_text(f"t,{head}\n{rows}")
    own, copy = copied(tmp_path / "a.csv")
    assert {f"/{name.replace('.position', '')}" for name in own.signals} == {
        name.removesuffix(".position") for name in copy.signals
    }
    for name, signal in own.signals.items():
        other = copy.signals[f"/{name}"]
        assert (other.columns, other.unit, other.drives) == (
            *(signal.columns, signal.unit, signal.drives),
        )
        np.testing.assert_allclose(other.values, signal.values)
        np.testing.assert_array_equal(other.stamps_ns, signal.stamps_ns)
    assert set(without_commands(copy).signals) == {"/joints.position"}
    assert {one.topic for one in copy.channels if one.drives} == {"/commands"}


def test_an_import_keeps_the_unit_of_joints(tmp_path: Path):
    rows = "".join(f"{k / 10},{k % 7 * 300},{k % 7 * 300}\n" for k in range(60))
    (tmp_path / "a.csv").write_text(f"t,lift_pos,goal_lift_pos\n{rows}")
    own, copy = copied(tmp_path / "a.csv")
    assert {one.unit for one in (*own.signals.values(), *copy.signals.values())} == {""}
    said = ReadOptions(angle_unit="percent")
    import_log(tmp_path / "a.csv", tmp_path / "b.mcap", options=said)
    assert {one.unit for one in read_episode(tmp_path / "b.mcap").signals.values()} == {"%"}


# The unit of angles: which lattice an encoder's values lie on.
TICKS = [np.round(2000 + 700 * np.sin(np.arange(300) / (9 + 4 * at) + at)) for at in range(4)]
RANGES = [(900, 3100), (1010, 3001), (1100, 3333), (1000, 3100)]
NAMES = ("pan", "lift", "elbow", "roll")


def servos(unit: str) -> list[Array]:
    """The servos' positions as LeRobot writes them, of 24 bits."""
    found: list[Array] = []
    for ticks, (low, high) in zip(TICKS, RANGES, strict=True):
        values = {
            "deg": (ticks - (low + high) / 2) * 360 / 4095,
            "deg4096": (ticks - 2048) * 360 / 4096,
            "rad": (ticks - 2048) * np.pi / 2048,
            "percent": (ticks - low) / (high - low) * 200 - 100,
            "smooth": np.sin(ticks / 300),
            "ticks": ticks,
        }[unit]
        found.append(values.astype(np.float32).astype(float))
    return found


@pytest.mark.parametrize(
    ("unit", "told"),
    [
        *(("deg", "degrees"), ("deg4096", "degrees"), ("rad", "rad")),
        *(("percent", "per cent of the range"), ("smooth", None), ("ticks", None)),
    ],
)
def test_an_encoders_lattice_tells_the_unit(unit: str, told: str | None):
    found = told_by_values(NAMES, servos(unit))
    assert (found and found.words) == told
    rounded = [np.round(values, 2) for values in servos("smooth")]
    assert told_by_values(NAMES, rounded) is None
    assert told_by_values(NAMES[:1], servos(unit)[:1]) is None or unit in ("deg", "deg4096", "rad")


@pytest.mark.parametrize(
    ("unit", "scale", "zero"),
    [
        *(("deg", np.pi / 180, 0.0), ("turn", 2 * np.pi, 0.0), ("rad", 1.0, 0.0)),
        *(("ticks", np.pi / 2048, 2048.0), ("ticks:1024:512", np.pi / 512, 512.0)),
        *(("percent", 1.0, 0.0), ("ticks:100", np.pi / 50, 50.0)),
    ],
)
def test_a_unit_that_a_user_names(tmp_path: Path, unit: str, scale: float, zero: float):
    rows = "".join(f"{k / 10},{k * 30},{k * 30 + 1}\n" for k in range(30))
    episode = read(tmp_path, f"t,lift_pos,goal_lift_pos\n{rows}", angle_unit=unit)
    for at, name in enumerate(("joints.position", "commands.position")):
        values = episode.signals[name].values[:, 0]
        np.testing.assert_allclose(values, (np.arange(30) * 30 + at - zero) * scale)
        assert episode.signals[name].unit == ("%" if unit == "percent" else "rad")
    with pytest.raises(LogError, match="states its unit, and --angle-unit says"):
        read(tmp_path, f"t,lift_pos_deg\n{'0,1' + chr(10)}0.1,2\n", angle_unit=unit)


@pytest.mark.parametrize("unit", ["degrees", "ticks:0", "ticks:x", "ticks:1:2:3", "ticks:inf", "x"])
def test_a_unit_that_is_none(unit: str):
    with pytest.raises(UsageError, match="--angle-unit"):
        ReadOptions(angle_unit=unit)


def test_registers_are_ticks_and_other_whole_numbers_are_of_no_unit(tmp_path: Path):
    for names, unit in (("present_position_1,goal_position_1", "rad"), ("pos_1,goal_pos_1", "")):
        rows = "".join(f"{at / 10},{k:.0f},{k:.0f}\n" for at, k in enumerate(TICKS[0]))
        episode = read(tmp_path, f"t,{names}\n{rows}")
        assert {one.unit for one in episode.signals.values()} == {unit}
        assert any("--angle-unit" in words for words in episode.warnings)


@pytest.mark.skipif(find_spec("pyarrow") is None, reason="pyarrow is missing")
@pytest.mark.parametrize("unit", ["deg", "percent"])
def test_a_lerobot_data_sets_states_and_actions(tmp_path: Path, unit: str):
    log = tmp_path / "data" / "chunk-000" / "file-000.parquet"
    log.parent.mkdir(parents=True)
    opening = np.linspace(0, 100, 300)
    states = np.column_stack([*servos(unit), opening])
    times = np.arange(300) / 30
    table = {
        "observation.state": list(states.astype(np.float32)),
        "action": list(np.roll(states, -2, axis=0).astype(np.float32)),
        "timestamp": times.astype(np.float32),
        "frame_index": np.arange(300),
        "episode_index": np.zeros(300, int),
    }
    pd.DataFrame(table).to_parquet(log)
    names = [f"{name}.pos" for name in (*NAMES, "gripper")]
    features = {one: {"names": names} for one in ("observation.state", "action")}
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta" / "info.json").write_text(json.dumps({"fps": 30, "features": features}))
    signals = read_episode(log).signals
    scale, shown = (np.pi / 180, "rad") if unit == "deg" else (1.0, "%")
    state, action = signals["observation.state.position"], signals["action.position"]
    assert (state.columns, state.unit, action.unit) == (NAMES, shown, shown)
    assert (state.drives, action.drives) == (False, True)
    np.testing.assert_allclose(state.values, states[:, :4] * scale, rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(action.values[:-2], state.values[2:])
    for topic in ("observation.state", "action"):
        assert signals[f"{topic}.gripper.position"].unit == "%"
    np.testing.assert_allclose(
        signals["observation.state.gripper.position"].values[:, 0], 2 * opening - 100, atol=1e-4
    )


def test_per_cent_of_others_are_of_no_unit(tmp_path: Path):
    for form, unit in (("{}.pos", "%"), ("{}_pos", "")):
        head = ",".join(form.format(name) for name in NAMES)
        cells = np.column_stack([np.arange(300) / 50, *servos("percent")])
        rows = "".join(",".join(map(repr, row)) + "\n" for row in cells.tolist())
        assert read(tmp_path, f"t,{head}\n{rows}").signals["joints.position"].unit == unit
