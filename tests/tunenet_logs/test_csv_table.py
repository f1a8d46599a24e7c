"""Tables as people and tools write them, what is none, and what a user says of one."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from tests.reading import one, read, refusal, tuned, write_arrays
from tests.strangers import Stranger, write_table
from tunenet_logs.episode import FRAME_NS, UNSTATED
from tunenet_logs.errors import LogError
from tunenet_logs.formats.columns import cells as lines
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode

XYZ = [[1, 2, 3], [4, 5, 6.5]]
GERMAN = "Zeit (ms);Höhe (cm);Note\n500;100,5;a\n1000;50;b\n"


@pytest.mark.parametrize(
    "text",
    [
        "t,x,y,z\n0.5,1,2,3\n1,4,5,6.5\n",
        "\ufefft,x,y,z\r\n0.5,1,2,3\r\n1,4,5,6.5\r\n",
        "t;x;y;z\n0,5;1;2;3\n1,0;4;5;6,5\n",
        "t\tx\ty\tz\n0,5\t1\t2\t3\n1\t4\t5\t6,5",
        "t x y z\n0.5 1 2 3\n1  4 5 6.5\n",
        '"t" , "x","y" ,"z"\n"0.5",1, 2 ,3\n1,4,5,6.5\n',
        "# by hand\nt,x,y,z\n# first\n0.5,1,2,3\n\n1,4,5,6.5\n# end\n",
        "# t x y z\n0.5 1 2 3\n1 4 5 6.5\n",
        "mass A\nt,x,y,z\n0.5,1,2,3\n1,4,5,6.5\n",
        "frame,t,x,y,z,\n1,0.5,1,2,3,\n2,1,4,5,6.5,\n",
        "t,x,y,z\r0.5,1,2,3\r1,4,5,6.5",
        "t\tx\ty\tz\n0.5\t1\t2\t3\n1\t4\t5\t6.5\n".encode("utf-16"),  # spreadsheets' "Unicode"
        "time_ms,x_mm,y_mm,z_mm\n500,1000,2000,3000\n1000,4000,5000,6500\n",
        "Time (ms),X [cm],Y [cm],Z [m]\n500,100,200,3\n1000,400,500,6.5\n",
        "stamp_us,pos_x,pos_y,pos_z\n500000,1,2,3\n1000000,4,5,6.5\n",
        "timestamp_ns,position.x,position.y,position.z\n500000000,1,2,3\n1000000000,4,5,6.5\n",
        "sec,nanosec,x_pos,y_pos,z_pos\n0,500000000,1,2,3\n1,0,4,5,6.5\n",
        "secs,nsecs,x,y,z\n0,500000000,1,2,3\n1,0,4,5,6.5\n",
        "header.stamp.sec,header.stamp.nanosec,pose.position.x,pose.position.y,pose.position.z,"
        "pose.orientation.x\n0,500000000,1,2,3,0\n1,0,4,5,6.5,0\n",
        "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.position.x,"
        "field.pose.position.y,field.pose.position.z\n"
        "9000000000,1,500000000,map,1,2,3\n9500000000,2,1000000000,map,4,5,6.5\n",
        "__time,x,y,z,vx,qw,velocity.x,orientation.z\n0.5,1,2,3,0,0,0,0\n1,4,5,6.5,0,0,0,0\n",
        "rosbagTimestamp,posX,posY,posZ\n500000000,1,2,3\n1000000000,4,5,6.5\n",
    ],
)
def test_a_track_however_it_is_written(tmp_path: Path, text: str | bytes):
    signal = one(tmp_path, text)
    unit = "m" if "mm" in str(text) or "[m]" in str(text) else UNSTATED
    assert (signal.name, signal.columns, signal.unit) == ("track", ("x", "y", "z"), unit)
    assert signal.stamps_ns.tolist() == [500_000_000, 1_000_000_000]
    np.testing.assert_allclose(signal.values, XYZ, rtol=1e-15)


@pytest.mark.parametrize("name", ["z", "height", "height_m", "Height (m)", "z_m"])
def test_a_height_alone_is_a_track(tmp_path: Path, name: str):
    assert one(tmp_path, f"t,{name}\n0,1.5\n").values.tolist() == [[0, 0, 1.5]]


def test_several_things_by_their_names(tmp_path: Path):
    text = "__time,/ball/pose/pose/position/x,/ball/pose/header/stamp,hand_x,x1,y1\n"
    signals = read(tmp_path, text + "1.5,1,1.25,,,\n2.5,,,2,3,4\n3.5,5,3.25,,,\n").signals
    assert set(signals) == {"ball", "hand", "track1"}
    assert signals["ball"].stamps_ns.tolist() == [1_250_000_000, 3_250_000_000]
    assert signals["hand"].stamps_ns.tolist() == [2_500_000_000]
    assert signals["track1"].values.tolist() == [[3, 4, 0]]


def test_torques_positions_and_velocities_of_joints(tmp_path: Path):
    text = "t,joint1_effort,elbow_torque_Nm,tau_3,joint1_angle_deg,LF_HAA.vel,qd_2 (deg/s)\n"
    signals = read(tmp_path, text + "0,1,2,3,180,5,180\n1,1,,nan,90,5,90\n").signals
    joints = ("joint1", "elbow", "joint3", "LF_HAA", "joint2")
    assert all(signal.columns == joints for signal in signals.values())
    effort = signals["joints.effort"].values
    assert np.array_equal(effort[:, :3], [[1, 2, 3], [1, np.nan, np.nan]], equal_nan=True)
    assert np.isnan(effort[:, 3:]).all()
    np.testing.assert_allclose(signals["joints.position"].values[:, 0], [np.pi, np.pi / 2])
    np.testing.assert_allclose(signals["joints.velocity"].values[:, 4], [np.pi, np.pi / 2])
    units = {name: one.unit for name, one in signals.items()}
    assert (units["joints.effort"], units["joints.velocity"]) == ("N·m", "rad/s")


def test_a_joint_that_is_told_twice_at_one_time_is_counted(tmp_path: Path):
    rows = "".join(f"{n // 3},{'aba'[n % 3]},{n / 10}\n" for n in range(30))
    episode = read(tmp_path, f"t,joint_name,position\n{rows}")
    signal = episode.signals["joints.position"]
    assert signal.values[1].tolist() == [0.3, 0.4]
    assert sum(signal.left_out.values()) == 10
    said = "joints.position, a: 10 samples with a stamp already seen were left out"
    assert said in episode.warnings


@pytest.mark.parametrize(
    ("place", "command", "columns"),
    [
        ("qpos[{}]", "ctrl[{}]", ("joint1", "joint2")),  # MuJoCo's own names
        ("Servo{} Actual (rad)", "Servo{} Cmd (rad)", ("Servo0", "Servo1")),
        ("hip_{}", "hip_{}_cmd", ("hip_0", "hip_1")),
        ("actual_{}_l", "desired_{}_l", ("0_l", "1_l")),
        ("Axis{}.ActPos", "Axis{}.SetPos", ("Axis0", "Axis1")),  # TwinCAT's
        ("joint_positions[{}]", "joint_targets[{}]", ("joint1", "joint2")),
        ("hip{}_measured (rad)", "hip{}_setpoint (rad)", ("hip0", "hip1")),
    ],
)
def test_names_of_joints_and_their_commands(
    tmp_path: Path, place: str, command: str, columns: tuple[str, ...]
):
    header = ",".join(name.format(at) for name in (place, command) for at in range(2))
    rows = "".join(f"{n},{n},{n + 3},{n + 0.1},{n + 3.1}\n" for n in range(9))
    signals = read(tmp_path, f"t,{header}\n{rows}").signals
    assert {name: (one.columns, one.drives) for name, one in signals.items()} == {
        "joints.position": (columns, False),
        "commands.position": (columns, True),
    }
    assert signals["joints.position"].values[1].tolist() == [1, 4]


@pytest.mark.parametrize("name", ["pressure", "heater_temp", "speed", "pump_power", "grip_force"])
def test_a_command_makes_no_joint_of_what_is_none(tmp_path: Path, name: str):
    text = f"t,z,{name},{name}_setpoint\n0,1,2,3\n1,1,2,4\n"
    assert list(read(tmp_path, text).signals) == ["track"]


def test_a_controller_s_topics_are_of_its_joints(tmp_path: Path):
    topic = "/velocity_trajectory_controller/controller_state"
    fields = [f"{topic}/{what}/{name}[{at}]" for what, name, at in (
        ("reference", "positions", 0), ("reference", "positions", 1), ("feedback", "positions", 0),
        ("feedback", "positions", 1), ("feedback", "velocities", 1), ("error", "positions", 0),
        ("feedback", "accelerations", 1), ("output", "effort", 0))]  # fmt: skip
    cells = "1,2,3,4,5,6,7,8"
    text = f"__time,{','.join(fields)}\n0,{cells}\n1,{cells}\n"
    episode = read(tmp_path, text)
    robot = "velocity_trajectory_controller/state"
    assert {name: one.columns for name, one in episode.signals.items()} == {
        f"{robot}.commands.position": ("joint0", "joint1"),
        f"{robot}.position": ("joint0", "joint1"),
        f"{robot}.velocity": ("joint0", "joint1"),
    }
    assert episode.signals[f"{robot}.position"].values[0].tolist() == [3, 4]
    why = {one.topic: one.skipped or "" for one in episode.channels}
    assert why[fields[-1]] == "it is the output of the controller, no effort of a joint"
    assert why[fields[-2]] == "its name says no time, position (x, y, z, height) or joint torque"


@pytest.mark.parametrize(
    ("ids", "columns", "step"),
    [
        ("motor_id:1,2", ("motor1", "motor2"), 2),  # all at one time
        ("motor_id:1,2", ("motor1", "motor2"), 1),  # in turn
        ("joint_name:hip,knee", ("hip", "knee"), 2),
        ("device:hip,knee", ("hip", "knee"), 2),  # told by times that stand twice
    ],
)
def test_joints_below_each_other_are_columns(
    tmp_path: Path, ids: str, columns: tuple[str, ...], step: int
):
    name, _, listed = ids.partition(":")
    rows = [f"{n // step},{listed.split(',')[n % 2]},{n},{n + 0.5}\n" for n in range(12)]
    episode = read(tmp_path, f"t,{name},position,target_position\n{''.join(rows)}")
    assert set(episode.signals) == {"joints.position", "commands.position"}
    if name != "device":  # needs no command to be joints'
        rows = [row.rpartition(",")[0] + "\n" for row in rows]
        alone = one(tmp_path, f"t,{name},position\n{''.join(rows)}")
        assert (alone.name, alone.columns) == ("joints.position", columns)
    for signal, offset in (("joints.position", 0), ("commands.position", 0.5)):
        found = episode.signals[signal]
        assert found.columns == columns
        for place in range(2):
            own = found.values[:, place]
            assert own[np.isfinite(own)].tolist() == [n + offset for n in range(place, 12, 2)]


def test_a_quantity_in_two_units_is_read_once(tmp_path: Path):
    header = "t,elbow_pos_deg,elbow_pos_rad,elbow_pos_last,elbow_vel,elbow_vel"
    episode = read(tmp_path, f"{header}\n0,180,3.14,0,1,2\n1,90,1.57,3,1,2\n")
    (signal,) = episode.signals.values()
    assert (signal.name, signal.columns) == ("joints.position", ("elbow",))
    assert signal.values.tolist() == [[3.14], [1.57]]
    why = {one.topic: one.skipped or "" for one in episode.channels}
    assert why["elbow_pos_deg"] == "the same as 'elbow_pos_rad'"
    assert "several columns" in why["elbow_vel"]


def test_joints_in_a_row_are_named_by_their_first_and_last_column(tmp_path: Path):
    columns = "t=1,position=2:4,command=5:7"
    signals = read(tmp_path, "0 1 2 3 4 5 6 7\n1 2 3 4 5 6 7 8\n", columns).signals
    assert signals["joints.position"].columns == ("joint1", "joint2", "joint3")
    assert signals["joints.position"].values.tolist() == [[1, 2, 3], [2, 3, 4]]
    assert signals["commands"].values.tolist() == [[4, 5, 6], [5, 6, 7]]


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        *((name, ("joint1",)) for name in (
            "/joint_states/joint1/effort", "/joint_states/effort[1]", "tau_J_1", "field.effort1",
            "effort_1", "joint1_effort (N·m)", "joint_1_effort", "effort")),
        ("shoulder_lift_joint.effort", ("shoulder_lift_joint",)),
        ("hip_controller_torque", ("hip_controller",)),
        ("field.name0,field.name1,field.effort0,field.effort1", ("elbow", "wrist")),
    ],
)  # fmt: skip
def test_names_of_joints(tmp_path: Path, header: str, columns: tuple[str, ...]):
    cells = "elbow,wrist,1,2" if "name0" in header else "1.5"
    signal = one(tmp_path, f"{'%time' if 'name0' in header else 't'},{header}\n0,{cells}\n")
    assert (signal.name, signal.columns) == ("joints.effort", columns)


@pytest.mark.parametrize(
    ("column", "reason"),
    [
        *(("x_px", "unit of length"), ("quat_x", "no position"), ("mood", "name")),
        *(("lift_pos_m", "unit"), ("Velocity (m/s)", "speed"), ("a (m/s²)", "speed")),
        *(("frame", "times"), ("target_force", "asked for"), ("height", "column z")),
        *(("joint_position_deviation_ratio", "no position of a joint"), ("current", "no joint")),
    ],
)
def test_columns_that_are_not_used_say_why(tmp_path: Path, column: str, reason: str):
    channels = {one.topic: one for one in read(tmp_path, f"t,z,{column}\n0,1,2\n").channels}
    assert reason in (channels[column].skipped or "")
    assert (channels["track"].messages, channels["track"].skipped) == (1, None)


NAMES = ",".join(f"value{n} of something" for n in range(300))
ROWS = "".join(f"{n},1\n" for n in range(94))


@pytest.mark.parametrize(
    ("text", "columns", "says"),
    [
        ("0,1.9,2\n1,1.6,0.02\n", "", "has no line that names its columns; its columns by number "
         "are 1: 0 to 1, 2: 1.9 to 1.6, 3: 2 to 0.02; say which they are, for example --columns "
         "t=1,z=2"),
        ("0,1\n1,2\n", "", "perhaps --columns t=1,z=2"),
        ("0.1\n0.5\n0.7\n", "", "times=1 for times of impacts.*, or --columns z=1 --fps F"),
        ("z_mm\n3\n2\n1\n", "", "'z_mm' would be taken as positions.*--columns z=z_mm --fps F"),
        ("tau_est_0,q_0\n1,2\n", "", "add a column of times.*have an even rate, say it: --fps"),
        ("t,mood,angle\n0,1,2\n", "", "--columns t=t,position_1=angle;"),
        (" ".join("123456789") + "\n", "", "or, of a robot's joints, t=1,position=2:7"),
        ("0 1 2 3\n1 2 3 4\n", "", "perhaps --columns t=1,x=2,y=3,z=4"),
        ("x,y,z\n1,2,3\n", "", r"none of its columns is a time .*\('x', 'y', 'z'\).*add a column"),
        ("Aika;Pään (cm)\n1;2\n", "", r"--columns t=Aika,z='Pään \(cm\)'"),
        ("just a text\n", "", "times"),
        ("t,x,y,z\n", "", "no row"),
        ("t,x,y,z\na,b,c,d\n", "", "none of its 1 rows"),
        ("t,x,x\n0,1,2\n", "", "several columns"),
        ("t,position\n0,1\n", "", "of what"),
        ("time,angle\n0,1\n", "", "for example --columns t=time,position_1=angle"),
        ("t,x,x\ns,mm,mm\n0,1,2\n", "", "several columns"),
        ("t,x\ns,km\n0,1\n", "", "line 2: 'x' is in 'km'.*convert it to m"),
        ("t,x\nh,mm\n0,1\n", "", "line 2: 't' is in 'h'.*convert it"),
        ("t_ms,x\ns,mm\n0,1\n", "", "line 2: 't_ms' is said to be in 's'"),
        ("Length Units,Miles\nt,x\n0,1\n", "", "line 1: lengths are in 'Miles'.*convert it to m"),
        ("t,x\n,\n-,\n", "", "none of its 1 rows holds a value"),
        ("t,x\n\nnoon,1\n", "", "line 3, column 't': 'noon' is no time; write"),
        ("t,x\n2026-13-21 10:00,1\n", "", "'2026-13-21 10:00' is no time"),
        ("t,x\n9026-11-21 10:00,1\n", "", "'9026-11-21 10:00' is no time"),
        ("t,x\n0,1.5.2\n", "", "line 2, column 'x': '1.5.2' is no number; write numbers as"),
        ("t,x\n0,5,1,5\n0,6,1,5\n", "", "line 2, it has 4 cells, the header 2; .*';'"),
        ("t;x\n0,5;1.050\n", "", "'1.050' may be 1.050 or 1050"),
        ('t,x\n0.5,"1,050"\n', "", "'1,050' may be 1.050 or 1050"),
        ("t;x_mm\n0;1.050\n1;985\n", "", "'1.050' beside whole numbers may be 1.050 or 1050; wri"),
        ("t;x_mm\n0;1,050\n1;985\n", "", "'1,050' beside whole numbers may be 1.050 or 1050; wri"),
        ("t_ms;x\n990;1\n1.000;2\n", "", "'t_ms': '1.000' beside whole numbers may be"),
        ("\n\n", "", "columns"),
        (",,R,R,P,P\nFrame,Time (Seconds),X,Y,X,Y\n0,0,1,2,3,4\n", "", "several columns"),
        (f"t,z\n{ROWS}" + "94,1'050\n" * 6, "", "6 of 100 rows cannot be read; the first is line "
         "96, column"),
        ("t," * 6000, "", "line 1 is a header of 6001 columns, over the limit of 5000"),
        ("\nt,z," + ",".join(f"column{n}" for n in range(200_000)) + "\n0,1\n", "",
         r"line 2 is longer than 1 MiB.* 5000 columns"),
        (f"{NAMES}\n{','.join(['1'] * 300)}\n", "",
         r"\.\.\. \(300 in all\).*--columns t='value0 of some"),
        # What a user says wrongly.
        (GERMAN, "t=Zeit,z=Breite", r"no column 'Breite'; its columns are 'Zeit \(ms\)', 'Höhe"),
        (GERMAN, "t=1,z=4", "no column '4'; its columns are"),
        ("Aika;b\n0;1\n", "z=2", "none of its columns is known as a time; say it as well: t=COL"),
        ("0 1\n1 2\n", "t=1,position=2:4", "no column '3'; its columns"),
        ("0 1\n1 2\n", "t=1,z=3", "no column '3'; its columns are 'column 1', 'column 2'"),
        ("a,b (m/s)\n0,1\n", "t=a,z=b", r"'b \(m/s\)' is z, but it is in 'm/s', which is no unit"),
        ("a (h),b\n0,1\n", "t=1,z=b", r"'a \(h\)' is t, but it is in 'h'"),
        ("a,b\n0,1\n", "t=a,frame=b", "says t and frame; say one"),
        ("a,b\n0,1\n", "times=a,z=b", "say times alone"),
        ("a\n0.2\n0.1\n", "times=1", r"do not increase: 0.2 s is followed by 0.1 s; .*intervals"),
        ("just text\n", "t=a,z=b", "no column 'a' in its first 200 lines"),
        ("bounce,time_s\n1,0.73\n2,0.65\n3,0.58\n", "", "not intervals"),  # flights between
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_one_clear_error(tmp_path: Path, text: str, columns: str, says: str):
    assert re.search(says, refusal(tmp_path, text, columns))


@pytest.mark.parametrize("row", ["", "x,1,2,3", "1,1", "1,1,2,x", ",1,2,3", "1,2,3,4,5"])
def test_rows_that_cannot_be_read_are_counted(tmp_path: Path, row: str):
    episode = read(tmp_path, f"t,x,y,z\n0,1,2,3\n{row}\n2,4,5,6\n")
    assert len(episode.signals["track"].values) == 2
    assert any("1 of 3 rows" in loss for loss in episode.losses) == bool(row)
    assert episode.warnings[: len(episode.losses)] == episode.losses


@pytest.mark.parametrize("text", ["", "NaN", "nan", "NA", "N/A", "null", "-", " ", "#N/A"])
def test_samples_that_are_missing_are_no_damage(tmp_path: Path, text: str):
    episode = read(tmp_path, f"t,x,y,z\n0,1,2,3\n1,1,2,{text}\n2,4,5,6\n3,{','.join([text] * 3)}\n")
    assert episode.signals["track"].stamps_ns.tolist() == [0, 2_000_000_000]
    assert not episode.losses
    assert episode.warnings[0] == "track: 1 samples without all coordinates were left out"


def test_damage_costs_its_rows_and_the_first_is_shown(tmp_path: Path):
    rows = "".join(f"{n},1,2\n" for n in range(50))
    (loss,) = read(tmp_path, f"by hand\n\nt,x,z\n# note\n{rows}50,1,1..5\n{rows}x,1,2\n").losses
    assert loss.startswith("2 of 102 rows")
    assert "(the first is line 55, column 'z': '1..5' is no number)" in loss
    assert read(tmp_path, f"t,z\n{ROWS}" + "94,1'050\n" * 4).losses
    assert read(tmp_path, f"t,z\n{ROWS}" + "94\n" * 60).losses  # leaves the rest as it is
    quote = read(tmp_path, 't,x,y,z\n-1,"1,2,3\n' + rows.replace("\n", ",3\n"))  # is not closed
    assert len(quote.signals["track"].values) == 50
    long = read(tmp_path, "t,z\n0,1\n" + "1" * (3 * 2**20) + "\n1,2\n")
    assert len(long.signals["track"].values) == 2
    assert any("1 of 3 rows" in loss for loss in long.losses)


def test_disorder_and_duplicates_are_put_right(tmp_path: Path):
    episode = read(tmp_path, "t,z\n0,1\n0.2,3\n0.1,2\n0.1,2\n")
    assert episode.signals["track"].values[:, 2].tolist() == [1, 2, 3]
    assert any("sorted" in one for one in episode.warnings)
    assert any("already seen" in one for one in episode.warnings)


def test_a_drop_in_millimetres_with_decimal_commas_tunes(tmp_path: Path):
    stamps, positions = Stranger(0.7).samples()
    write_table(tmp_path / "a.csv", stamps, positions)
    rows = [
        f"{(stamp - stamps[0]) / 1e6:.3f};{1000 * z:.3f}".replace(".", ",")
        for stamp, (_, _, z) in zip(stamps, positions, strict=True)
    ]
    (tmp_path / "b.csv").write_text("time_ms;height_mm\n" + "\n".join(rows))
    values = [tuned(tmp_path / name) for name in ("a.csv", "b.csv")]
    assert values == pytest.approx([0.7, 0.7], abs=0.01)


def test_what_is_no_text_or_too_long_is_no_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(LogError, match=r"an MCAP log, a bag \(.bag, .db3\), a table of .*convert"):
        read(tmp_path, b"\0\1\2" * 100)
    with pytest.raises(LogError, match=r"\.bag, \.db3.*copy it again"):
        read(tmp_path / "a.mcap", b"\x89")
    monkeypatch.setattr(lines, "_MAX_TABLE_BYTES", 10)
    with pytest.raises(LogError, match="512 MiB"):
        read(tmp_path, "t,z\n0,1\n1,2\n")


@pytest.mark.parametrize(
    ("text", "x_m"),
    [
        *((f"t;x_mm\n0;1.050\n1;{second}\n", [1.05e-3, float(second) * 1e-3])
          for second in ("985.5", "0.985", "2.000", "1234")),
        ("t;x_mm\n0;1.05\n1;985\n", [1.05e-3, 0.985]),
        ("t;x\n0,5;1,050\n1,125;2,000\n", [1.05, 2]),
        ("t;x\n0.5;1.050\n1.125;2.000\n", [1.05, 2]),
        ("t,x\n0,1.050\n1,2.000\n", [1.05, 2]),
    ],
)  # fmt: skip
def test_decimals_are_no_thousands(tmp_path: Path, text: str, x_m: list[float]):
    assert one(tmp_path, text).values[:, 0].tolist() == pytest.approx(x_m)


# What a user says of a table: its columns, its rate, its unit.
@pytest.mark.parametrize(
    "columns",
    [
        "t=Zeit (ms),z=Höhe (cm)", "t='Zeit (ms)',z=\"Höhe (cm)\"", "t=zeit (MS),z=HÖHE (cm)",
        "t=Zeit,z=höhe", "t=1,z=2", "t=Zeit,z=2",
    ],
)  # fmt: skip
def test_columns_by_name_or_number(tmp_path: Path, columns: str):
    episode = read(tmp_path, GERMAN, columns)
    signal = episode.signals["track"]
    assert signal.stamps_ns.tolist() == [500_000_000, 1_000_000_000]
    assert (signal.unit, signal.values[:, 2].tolist()) == ("m", pytest.approx([1.005, 0.5]))
    assert any(channel.topic == "Note" and channel.skipped for channel in episode.channels)


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("0.5 1 2 3\n1 4 5 6.5\n", "t=1,x=2,y=3,z=4"),
        ("# by hand\n0.5,1,2,3\n1,4,5,6.5\n", "t=1,x=2,y=3,z=4"),
        ("a,b,c,d\n0.5,1,2,3\n1,4,5,6.5\n", "t=a,x=b,y=c,z=d"),
        ("a,b,c,d\ns,mm,mm,mm\n0.5,1000,2000,3000\n1,4000,5000,6500\n", "t=1,x=2,y=3,z=4"),
        ("Zeit,x,y,z\n0.5,1,2,3\n1,4,5,6.5\n", "t=Zeit"),
        ("t,p,q,r\n0.5,1,2,3\n1,4,5,6.5\n", "x=p,y=q,z=r"),
        ("4,x,y,z\n7,1,2,3\n8,4,5,6.5\n", "frame=4"),
    ],
)
def test_what_is_not_said_goes_by_the_file(tmp_path: Path, text: str, columns: str):
    signal = one(tmp_path, text, columns, fps=2 if "frame" in columns else None)
    assert (signal.stamps_ns - signal.stamps_ns[0]).tolist() == [0, 500_000_000]
    np.testing.assert_allclose(signal.values, XYZ)


def test_joints_and_currents_that_are_said(tmp_path: Path):
    text = "a,b (deg),c,d (Nm),e (mA)\n0,180,1,2,3000\n1,90,1,2,3000\n"
    columns = "t=a,position_1=b (deg),velocity_1=c,effort_2=d,current_1=5"
    signals = read(tmp_path, text, columns).signals
    assert all(signal.columns == ("joint1", "joint2") for signal in signals.values())
    assert signals["joints.position"].values[0, 0] == pytest.approx(np.pi)
    assert signals["joints.current"].unit == "A"
    assert signals["joints.current"].values[0, 0] == pytest.approx(3)
    text = "t,joint1_current (mA),joint2_current (A)\n0,500,2\n"
    effort = one(tmp_path, text, torque_constants=(10.0, 5.0))
    assert (effort.name, effort.unit) == ("joints.effort", "N·m")
    assert effort.values.tolist() == [[5, 10]]
    with pytest.raises(LogError, match=r"has 1 numbers for the 2 joints of joints\.current"):
        read(tmp_path, text, torque_constants=(10.0,))


HITS = [204_000_000, 376_000_000, 800_000_000]
NUMBERED = [500_000_000, 1_250_000_000]


@pytest.mark.parametrize(
    ("text", "columns", "stamps"),
    [
        ("0.204\n0.376\n0.8\n", "times=1", HITS),
        ("Event time (s),Interval (s)\n0.204,0.172\n0.376,0.424\n0.8,\n", "times=Event time (s)",
         HITS),
        ("n;ms\n1;204\n2;376\n3;800\n", "times=ms", HITS),
        ("n,t\n1,0.204\n2,\n2,0.376\n3,0.8\n", "times=t", HITS),
        ("BOUNCE COUNT,TIME\n1,0.5\n2,1.25\n", "", NUMBERED),
        ("Bounce #,Time (ms)\n1,500\n2,1250\n", "", NUMBERED),
        ("Impact;Frame\n1;50\n2;75\n", "", [50 * FRAME_NS, 75 * FRAME_NS]),
        ("a,Frame\n1,50\n2,75\n", "times=Frame", [50 * FRAME_NS, 75 * FRAME_NS]),
    ],
)  # fmt: skip
def test_times_of_impacts(tmp_path: Path, text: str, columns: str, stamps: list[int]):
    signal = one(tmp_path, text, columns)
    assert (signal.name, signal.columns, signal.unit) == ("impacts", ("impact",), "1")
    assert signal.stamps_ns.tolist() == stamps
    assert set(signal.values[:, 0]) == {1}
    assert not signal.is_position
    assert signal.counts_frames == ("Frame" in text)


@pytest.mark.parametrize("name", ["frame", "Frame #", "frame_number", "Frame No.", "video frame"])
def test_frames_are_counted_where_there_is_no_time(tmp_path: Path, name: str):
    text = f"{name},x,y\n10,1,2\n11,3,4\n13,5,6\n"
    signal = one(tmp_path, text)
    assert signal.counts_frames
    assert signal.stamps_ns.tolist() == [10 * FRAME_NS, 11 * FRAME_NS, 13 * FRAME_NS]
    known = one(tmp_path, text, fps=240.0)
    assert not known.counts_frames
    assert known.stamps_ns.tolist() == [41_666_667, 45_833_333, 54_166_667]
    assert not one(tmp_path, f"t,{name},z\n0,10,1\n1,11,2\n").counts_frames


@pytest.mark.parametrize(
    ("text", "said", "unit", "row"),
    [
        *((f"{header}\n0,100,200\n1,110,220\n", "", "px", [100, 200, 0]) for header in (
            "frame,x_px,y_px", "frame,u,v", "t,ball_u,ball_v", "t,image_u,image_v")),
        ("t,z\n0,1000\n1,500\n", "", UNSTATED, [0, 0, 1000]),
        ("t,z\n0,1000\n1,500\n", "mm", "m", [0, 0, 1]),
        ("t,z\n0,1000\n1,500\n", "px", "px", [0, 0, 1000]),
        ("t,z_px\n0,1\n", "mm", "m", [0, 0, 0.001]),
        ("t,z_ft\n0,1\n", "", "m", [0, 0, 0.3048]),
        ("t,x,z_mm\n0,1,1\n", "", "m", [0.001, 0, 0.001]),
        ("t,z_mm\n0,1\n", "mm", "m", [0, 0, 0.001]),
        # Lengths of paths beside x and y are no heights.
        ("Time (s),Pos X (m),Pos Y (m),Displacement (m),Distance (m)\n0,1,2,9,9\n0.5,3,4,9,9\n",
         "", "m", [1, 2, 0]),
    ],
)  # fmt: skip
def test_units_of_lengths(tmp_path: Path, text: str, said: str, unit: str, row: list[float]):
    signal = one(tmp_path, text, length_unit=said)
    assert (signal.unit, signal.values[0].tolist()) == (unit, pytest.approx(row))
    assert signal.is_position


def test_a_unit_that_contradicts_is_refused(tmp_path: Path):
    with pytest.raises(LogError, match=r"'z_mm' is in mm, and --length-unit says cm; leave it out"):
        read(tmp_path, "t,z_mm\n0,1\n", length_unit="cm")


@pytest.mark.parametrize("names", ["x,y\n", "", "x,y\nmm,mm\n", "# of a film\nx,y\n"])
def test_rows_without_a_clock_are_frames_where_their_rate_is_said(tmp_path: Path, names: str):
    text = names + "5,9\n4,8\n\n# a remark\n6,7\n7,6\n"
    with pytest.raises(LogError, match=r"--columns x=\w,y=\w --fps 30$"):
        read(tmp_path, text)
    with pytest.raises(LogError, match=r"for example --fps 30$"):
        read(tmp_path, text, "x=1,y=2")
    signal = one(tmp_path, text, "x=1,y=2", fps=25)
    assert signal.stamps_ns.tolist() == [0, 40_000_000, 80_000_000, 120_000_000]
    scale = 1e-3 if "mm" in names else 1.0
    assert np.allclose(signal.values[:, :2], scale * np.array([[5, 9], [4, 8], [6, 7], [7, 6]]))
    assert signal.unit == ("m" if "mm" in names else "")


def test_a_row_that_breaks_off_keeps_its_place_among_the_frames(tmp_path: Path):
    text = "x,y\n" + "".join(f"{at},{at % 7}\n" if at != 5 else "5\n" for at in range(40))
    signal = one(tmp_path, text, "x=x,y=y", fps=10)
    assert 500_000_000 not in signal.stamps_ns.tolist()
    assert signal.stamps_ns[-1] == 3_900_000_000


JOINTS = "joint1_position,joint2_position,joint1_effort,joint2_effort"


@pytest.mark.parametrize("kind", ["csv", "jsonl", "parquet"])
@pytest.mark.parametrize("names", [JOINTS, "q_1,q_2,tau_1,tau_2", JOINTS.replace("joint", "leg_")])
def test_rows_of_joints_without_a_clock_need_a_rate(tmp_path: Path, names: str, kind: str):
    path = tmp_path / f"a.{kind}"
    columns = enumerate(names.split(","))
    write_arrays(path, {name: np.arange(50) / 7 + at for at, name in columns})
    with pytest.raises(LogError, match="--fps"):
        read_episode(path)
    signals = read_episode(path, ReadOptions(fps=200)).signals
    assert set(signals) == {"joints.position", "joints.effort"}
    assert signals["joints.effort"].rate_hz == pytest.approx(200)
    assert signals["joints.effort"].values[0].tolist() == [2, 3]


@pytest.mark.parametrize(
    ("names", "scale"),
    [
        ("joint1 angle in degrees,joint1 torque in Nm", np.pi / 180),
        ("joint1 angle (radians),joint1 torque (N.m)", 1.0),
        ("q1_deg,tau1,tau_ext_1", np.pi / 180),
        ("joint1_position,tau1,tauExt1,tau1_estimated", 1.0),
        ("joint1_angle_degrees,tau_measured_1,tau_des_1", np.pi / 180),
        ("joint1 Angle/deg,joint1 torque/Nm,joint1 AngVel/rad/s", np.pi / 180),
    ],
)
def test_units_of_angles_and_estimates_of_torques(tmp_path: Path, names: str, scale: float):
    cells = ",".join(str(10 + at) for at in range(names.count(",") + 1))
    signals = read(tmp_path, f"t,{names}\n0,{cells}\n1,{cells}\n").signals
    assert signals["joints.position"].values[0].tolist() == pytest.approx([10 * scale])
    assert signals["joints.effort"].values[0].tolist() == [11]
    assert signals["joints.effort"].columns == signals["joints.position"].columns == ("joint1",)
