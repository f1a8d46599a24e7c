"""What a user says of a table: its columns, its rate, its unit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.conftest import real
from tests.tunenet_logs.test_csv_table import GERMAN, XYZ, one, read
from tunenet_logs.episode import FRAME_NS, UNSTATED
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode


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


def test_two_bare_columns_of_a_textbook():
    path = real("labs/fallingtennisball02.txt")
    with pytest.raises(LogError, match=r"1: 0 to 2.499, 2: 1.6 to 0.03997; .*--columns t=1,z=2"):
        read_episode(path)
    signal = read_episode(path, ReadOptions({"t": "1", "z": "2"})).signals["track"]
    assert len(signal.values) == 2500


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
    table = pd.DataFrame({name: np.arange(50) / 7 + at for at, name in enumerate(names.split(","))})
    path = tmp_path / f"a.{kind}"
    if kind == "csv":
        table.to_csv(path, index=False)
    elif kind == "jsonl":
        table.to_json(path, orient="records", lines=True)
    else:
        pytest.importorskip("pyarrow")
        table.to_parquet(path)
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
