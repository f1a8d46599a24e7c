"""Tables as people and tools write them, and what is none."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.strangers import Stranger, write_table
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import UNSTATED, Episode, Signal
from tunenet_logs.errors import LogError, TuneNetError
from tunenet_logs.formats.columns import cells as lines
from tunenet_logs.formats.options import ReadOptions, columns_of
from tunenet_logs.reader import read_episode


def read(
    tmp_path: Path, text: str | bytes, columns: str = "", name: str = "a.csv", **said: Any
) -> Episode:
    """A table, with what a user says of its columns."""
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_episode(path, ReadOptions(columns_of(columns) if columns else {}, **said))


def one(tmp_path: Path, text: str | bytes, columns: str = "", **said: Any) -> Signal:
    (signal,) = read(tmp_path, text, columns, **said).signals.values()
    return signal


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


@pytest.mark.parametrize(
    ("header", "columns"),
    [
        *((name, ("joint1",)) for name in (
            "/joint_states/joint1/effort", "/joint_states/effort[1]", "tau_J_1", "field.effort1",
            "effort_1", "joint1_effort (N·m)", "joint_1_effort", "effort")),
        ("shoulder_lift_joint.effort", ("shoulder_lift_joint",)),
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
        *(("frame", "times"), ("target_q_1", "asked for"), ("height", "column z")),
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
    with pytest.raises(LogError, match=says) as caught:
        read(tmp_path, text, columns)
    assert str(tmp_path / "a.csv") in str(caught.value)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 700


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
    tuned = [tune_log(tmp_path / name, TuneOptions()) for name in ("a.csv", "b.csv")]
    values = [float(one.estimate[0]) for one in tuned if one.estimate is not None]
    assert values == pytest.approx([0.7, 0.7], abs=0.01)
    assert tuned[1].verdict == "ok"


def test_what_is_no_text_or_too_long_is_no_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(LogError, match=r"an MCAP log, a bag \(.bag, .db3\), a table of .*convert"):
        read(tmp_path, b"\0\1\2" * 100)
    with pytest.raises(LogError, match=r"\.bag, \.db3.*copy it again"):
        read(tmp_path, b"\x89", name="a.mcap")
    monkeypatch.setattr(lines, "_MAX_TABLE_BYTES", 10)
    with pytest.raises(LogError, match="512 MiB"):
        read(tmp_path, "t,z\n0,1\n1,2\n")


WORDS = ["t", "x", "z", "time_ms", "sec", "nsec", "header.stamp", "effort1", "q", "u", "v", '"',
         "Zeit", "z (cm)", "run", "t1", "z1", "t2", "z2", "frame", "s"]  # fmt: skip
CELLS = ["0", "1.5", "-1", "1e400", "nan", "", " ", "1,5", "#", "%", "9" * 400, "é\0", "_1", "mm",
         "s", "1.050", "1,050.0", "2026-11-21 10:00", "1 s", "x", "Run 2", "-3"]  # fmt: skip
SAID = st.dictionaries(
    st.sampled_from(["t", "frame", "times", "x", "z", "effort_1", "current_1"]),
    st.sampled_from([*WORDS, "1", "2", "7", ""]),
    max_size=3,
)


@pytest.mark.parametrize("is_said", [False, True])
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_anything_gives_only_our_errors(tmp_path: Path, data: st.DataObject, is_said: bool):
    header = data.draw(st.lists(st.sampled_from(WORDS), max_size=5))
    cells = st.sampled_from([*WORDS, *CELLS])
    rows = data.draw(st.lists(st.lists(cells, max_size=6), max_size=12))
    separator = data.draw(st.sampled_from([",", ";", "\t", " "]))
    text = "\n".join(separator.join(row) for row in [header, *rows]).encode()
    options = ReadOptions()
    if is_said:
        options = ReadOptions(data.draw(SAID), data.draw(st.sampled_from([None, 50.0])), "", (2.0,))
    path = tmp_path / data.draw(st.sampled_from(["a.csv", "a.TSV", "a.txt"]))
    path.write_bytes(text + data.draw(st.binary(max_size=30)))
    try:
        episode = read_episode(path, options)
    except TuneNetError:
        return
    assert episode.signals
    assert all(np.all(np.diff(one.stamps_ns) > 0) for one in episode.signals.values())


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
