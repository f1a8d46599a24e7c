"""Which layout a file is, by its content and under any name; what is not read is named truly."""

from __future__ import annotations

import json
import pickle
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT
from tunenet_logs.episode import Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import AS_IT_SAYS, ReadOptions, columns_of
from tunenet_logs.formats.registry import may_be_log
from tunenet_logs.reader import read_episode

S, NS = 1_790_000_000, 10**9
PLACES = np.round(np.random.default_rng(1).uniform(-1, 1, (30, 3)), 6)
TIMES_NS = S * NS + 10_000_000 * np.arange(30)


def read(path: Path, content: str | bytes, options: ReadOptions = AS_IT_SAYS) -> Episode:
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_episode(path, options)


def refusal(path: Path, content: str | bytes) -> str:
    with pytest.raises(LogError) as caught:
        read(path, content)
    return str(caught.value)


def rows(row: Callable[[int, str, str, np.ndarray], str], last: int = 30) -> str:
    """A line each for seconds, nanoseconds and place."""
    parts = zip(TIMES_NS[:last].tolist(), PLACES, strict=False)
    return "".join(row(at // NS, f"{at % NS}", f"{at / NS:.6f}", one) + "\n" for at, one in parts)


def numbers(values: Iterable[float], mark: str = " ") -> str:
    return mark.join(f"{one:.6f}" for one in values)


TUM = rows(lambda _s, _n, t, one: f"{t} {numbers(one)} 0 0 0.6 0.8")
ECHO = rows(lambda s, n, _t, one: f"{s},{n},map,{numbers(one, ',')},0.0,0.0,0.6,0.8")
TRANSFORM = ECHO.replace("map", "map,ball")
COVARIANCE = ",".join(["0.01"] * 36)
ODOMETRY = TRANSFORM.replace(
    ",0.6,0.8\n", f",0.6,0.8,{COVARIANCE},{','.join(['2.5'] * 6)},{COVARIANCE}\n"
)
WITH_COVARIANCE = ECHO.replace(",0.6,0.8\n", f",0.6,0.8,{COVARIANCE}\n")
KITTI = rows(lambda _s, _n, _t, one: f"0 0 1 {one[0]:.6f} 1 0 0 {one[1]:.6f} 0 1 0 {one[2]:.6f}")
STO = "Ball{0}\nversion=1\nnRows=30\nnColumns=4\ninDegrees=no\nendheader{0}\n" + (
    "time\tball_X\tball_Y\tball_Z\n"
    + rows(lambda s, n, _t, one: f"{s - S + int(n) / NS:.6f}\t{numbers(one, chr(9))}")
)


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("a.txt", TUM, "a TUM trajectory"),
        ("a.tum", "# timestamp tx ty tz qx qy qz qw\n" + TUM, "a TUM trajectory"),
        ("a", "# ground truth\n# file: drop seven\n\n" + TUM, "a TUM trajectory"),
        ("a.csv", "timestamp,tx,ty,tz,qx,qy,qz,qw\n" + TUM.replace(" ", ","), "a TUM trajectory"),
        ("a.log", ECHO, "PoseStamped"),
        ("a.csv", ECHO.replace("map", ""), "PoseStamped"),
        ("a.dat", WITH_COVARIANCE, "PoseWithCovarianceStamped"),
        ("a.csv", TRANSFORM, "TransformStamped"),
        ("a.csv", ODOMETRY, "Odometry"),
        ("a.sto", STO.format(""), "of OpenSim"),
        ("a.mot", STO.format("\t\t\t"), "of OpenSim"),
        ("a.poses", "t x y z\n" + TUM.replace(" 0 0 0.6 0.8", ""), ""),
        ("a.log", "=~=~= PuTTY log =~=~=\r\nready\r\n" + STO.partition("endheader{0}\n")[2], ""),
    ],
)
def test_places_under_any_name(tmp_path: Path, name: str, text: str, what: str):
    episode = read(tmp_path / name, text)
    (signal,) = episode.signals.values()
    np.testing.assert_allclose(signal.values, PLACES, atol=1e-9)
    steps = (signal.stamps_ns - signal.stamps_ns[0]).tolist()
    assert steps == (TIMES_NS - TIMES_NS[0]).tolist()
    assert episode.info.source == f"table {name}" + (f", {what}" if what in SAID else SAID_AS[what])
    assert may_be_log(tmp_path / name) == (Path(name).suffix not in (".tum", ".poses"))


SAID = ("a TUM trajectory", "of OpenSim")
SAID_AS = {
    "": "",
    **{
        kind: f", `ros2 topic echo --csv` of {kind}"
        for kind in ("PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Odometry")
    },
}


def test_matrices_of_kitti_are_frames(tmp_path: Path):
    (signal,) = read(tmp_path / "00.txt", KITTI).signals.values()
    np.testing.assert_allclose(signal.values, PLACES, atol=1e-9)
    assert signal.counts_frames
    (signal,) = read(tmp_path / "01.txt", KITTI, ReadOptions(fps=50.0)).signals.values()
    assert signal.rate_hz == pytest.approx(50)


def test_echoed_joints_are_told_by_their_names(tmp_path: Path):
    text = rows(lambda s, n, _t, one: f"{s},{n},,a,b,{numbers([*one, *-one], ',')}")
    signals = read(tmp_path / "a.csv", text).signals
    np.testing.assert_allclose(signals["joints.position"].values, PLACES[:, :2])
    np.testing.assert_allclose(signals["joints.effort"].values, -PLACES[:, 1:])
    assert signals["joints.effort"].columns == ("a", "b")


def test_what_an_echo_does_not_tell_is_asked_for_by_a_line_that_works(tmp_path: Path):
    text = rows(lambda s, n, _t, one: f"{s},{n},map,{numbers(one, ',')}")
    told = refusal(tmp_path / "a.csv", text)
    assert told.endswith("--columns x=4,y=5,z=6")
    columns = ReadOptions(columns=columns_of(told.rpartition(" ")[2]))
    (signal,) = read(tmp_path / "a.csv", text, columns).signals.values()
    np.testing.assert_allclose(signal.values, PLACES)
    assert signal.stamps_ns.tolist() == TIMES_NS.tolist()


def test_rows_of_two_frames_are_no_track(tmp_path: Path):
    text = ECHO.replace("map", "other", 40) + ECHO.replace("map", "b")
    told = refusal(tmp_path / "a.csv", text)
    assert "line 31 is of 'b', those before it of 'other'" in told
    subprocess.run(told.rpartition("example: ")[2], shell=True, cwd=tmp_path, check=True)
    assert len(read_episode(tmp_path / "one.csv").signals["track"].values) == 30


def test_numbers_that_are_no_turns_are_no_trajectory(tmp_path: Path):
    text = TUM.replace("0.6 0.8", "0.6 0.9")
    assert "has no line that names its columns" in refusal(tmp_path / "a.txt", text)
    text = "t fx fy fz a b c d\n" + TUM
    assert "holds no track" in refusal(tmp_path / "a.txt", text)


@pytest.mark.parametrize(("degrees", "scale"), [("no", 1.0), ("yes", np.pi / 180)])
def test_opensim_s_angles_are_in_what_its_head_says(tmp_path: Path, degrees: str, scale: float):
    head = f"Coordinates\nversion=1\nnRows=3\nnColumns=2\ninDegrees={degrees}\nendheader\n"
    episode = read(tmp_path / "a.mot", head + "time\tknee_angle\n0\t30\n.1\t60\n.2\t90\n")
    (signal,) = episode.signals.values()
    np.testing.assert_allclose(signal.values[:, 0], np.array([30, 60, 90]) * scale)


def test_opensim_s_table_that_is_cut_or_of_velocities_is_said(tmp_path: Path):
    cut = read(tmp_path / "a.sto", "".join(STO.format("").splitlines(keepends=True)[:-5]))
    assert cut.losses == ("it says that it has 30 rows, and has 25",)
    told = refusal(tmp_path / "v.sto", STO.format("").replace("Ball\n", "Velocities\n", 1))
    assert "OpenSim's table of 'Velocities'" in told


def deeplabcut(*, individuals: bool) -> str:
    heads = {"scorer": ["DLC"] * 6, "individuals": ["one"] * 3 + ["two"] * 3}
    heads |= {"bodyparts": ["ball"] * 3 + ["hand"] * 3, "coords": ["x", "y", "likelihood"] * 2}
    if not individuals:
        del heads["individuals"]
    text = "".join(f"{name},{','.join(cells)}\n" for name, cells in heads.items())
    sure = [0.99] * 20 + [0.3] * 10
    return text + "".join(
        f"{at},{x:.6f},{y:.6f},0.99,{x:.6f},{y:.6f},{sure[at]}\n"
        for at, (x, y, _) in enumerate(PLACES)
    )


@pytest.mark.parametrize("individuals", [False, True])
def test_deeplabcut_s_three_rows_of_names(tmp_path: Path, individuals: bool):
    episode = read(tmp_path / "a.csv", deeplabcut(individuals=individuals))
    names = ["one.ball", "two.hand"] if individuals else ["ball", "hand"]
    assert list(episode.signals) == names
    ball, hand = episode.signals.values()
    np.testing.assert_allclose(ball.values[:, :2], PLACES[:, :2])
    assert (ball.unit, ball.counts_frames) == ("px", True)
    assert len(hand.values) == 20
    assert "10 places with a likelihood below 0.6 were left out" in episode.warnings


@pytest.mark.parametrize("tracks", [("",), ("track_0", "track_1")])
def test_sleap_s_instances_are_in_pixels(tmp_path: Path, tracks: tuple[str, ...]):
    rows = "".join(
        f"{track},{at},0.99,{x + shift:.6f},{y:.6f},0.98\n"
        for at, (x, y, _) in enumerate(PLACES)
        for shift, track in enumerate(tracks)
    )
    episode = read(tmp_path / "a.csv", "track,frame_idx,instance.score,ball.x,ball.y,s\n" + rows)
    assert len(episode.signals) == len(tracks)
    for shift, signal in enumerate(episode.signals.values()):
        np.testing.assert_allclose(signal.values[:, :2], PLACES[:, :2] + [shift, 0])
        assert (signal.unit, signal.counts_frames) == ("px", True)


@pytest.mark.parametrize(
    ("names", "mark", "form"),
    [
        ("t,position,colour", ",", '"[{}, {}, {}]"'),
        ("t;ball;colour", ";", "[{}, {}, {}]"),
        ("# by hand\nt,ball_mm,colour", ",", "[{}  {} {}]"),
    ],
)
def test_lists_in_cells_are_columns(tmp_path: Path, names: str, mark: str, form: str):
    scale = 1000.0 if "mm" in names else 1.0
    rows = "".join(
        f"{at / 100}{mark}{form.format(*(scale * one))}{mark}red\n" for at, one in enumerate(PLACES)
    )
    (signal,) = read(tmp_path / "a.csv", f"{names}\n{rows}").signals.values()
    np.testing.assert_allclose(signal.values, PLACES, atol=1e-12)
    assert signal.unit == ("m" if "mm" in names else "")


def test_a_list_that_breaks_off_costs_its_row(tmp_path: Path):
    rows = "".join(f'{at / 100},"[{at}, 2, 3]"\n' for at in range(30))
    episode = read(tmp_path / "a.csv", f"t,position\n{rows}".replace("[7, 2, 3]", "[7, 2"))
    assert len(next(iter(episode.signals.values())).values) == 29
    assert "1 of 30 rows" in episode.losses[0]


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "cp1252"])
def test_encodings(tmp_path: Path, encoding: str):
    text = "Drop in Köln, µ\nt (s),x (m),y (m),z (m)\n" + TUM.replace(" ", ",").replace(
        ",0,0,0.6,0.8", ""
    )
    (signal,) = read(tmp_path / "a.dat", text.encode(encoding)).signals.values()
    np.testing.assert_allclose(signal.values, PLACES, atol=1e-9)


def test_json_under_another_name(tmp_path: Path):
    records = [{"t": at / 100, "z": z} for at, z in enumerate(PLACES[:, 2].tolist())]
    (signal,) = read(tmp_path / "a.log", json.dumps(records, indent=1)).signals.values()
    np.testing.assert_allclose(signal.values[:, 2], PLACES[:, 2])


@pytest.mark.parametrize(
    ("name", "data", "what", "remedy"),
    [
        ("a.h5", b"\x89HDF\r\n\x1a\n" + bytes(600), "an HDF5 file that is not read", "write it"),
        ("b.h5", bytes(512) + b"\x89HDF\r\n\x1a\n" + bytes(9), "an HDF5 file", "write it again"),
        ("a.mat", b"MATLAB 7.3 MAT-file".ljust(600), "a MATLAB file that is not read", "-v7"),
        ("a.slp", b"\x89HDF\r\n\x1a\n" + bytes(600), "a project of SLEAP", "Analysis CSV"),
        ("p.h5", b"\x89HDF\r\n\x1a\n" + bytes(99) + b"pandas_type", "an HDF5", "read_hdf"),
        ("a.mf4", b"MDF     4.10    " + bytes(99), "a measurement of ASAM (MDF)", "asammdf"),
        ("a.nc", b"CDF\x01" + bytes(99), "a NetCDF file", "xarray"),
        ("a.feather", b"FEA1\0\0" + bytes(99), "a Feather file of version 1", "read_feather"),
        ("b.feather", b"ARROW1\0\0" + bytes(99), "Arrow file that is not read", "write it again"),
        ("a.arrows", b"\xff\xff\xff\xff\x10\0\0\0", "Arrow file that is not read", "write it"),
        ("a.ulg", b"ULog\x01\x12\x35\x01" + bytes(99), "a PX4 autopilot", "ulog2csv "),
        ("a.tdms", b"TDSm" + bytes(99), "a TDMS file", "nptdms"),
        ("a.rrd", b"RRF2" + bytes(99), "for the Rerun viewer", "name the log"),
        ("a.pkl", pickle.dumps({"t": [1]}), "a Python pickle", "numpy.savez"),
        ("a.pkl", pickle.dumps({"t": [1]}, protocol=0), "a Python pickle", "numpy.savez"),
        ("a.csv", b"<!DOCTYPE html><title>Log in</title>", "a web page", "download it again"),
        ("a.xml", b'<?xml version="1.0"?>\n<a/>', "an XML file", "CSV"),
        ("a.yaml", b"header:\n  stamp:\n    sec: 1\n", "prints", "--csv"),
        ("a.json", b'{"task": 1, "verdict": 2, "provenance": {}}', "a tuning", "the log it is of"),
        ("notes.log", b"the ball was red\nand the floor hard\n", "is text in which", "t,x,y,z"),
    ],
)
def test_what_is_not_read_is_called_what_it_is(
    tmp_path: Path, name: str, data: bytes, what: str, remedy: str
):
    told = refusal(tmp_path / name, data)
    assert what in told
    assert remedy in told.partition("; ")[2]


@pytest.mark.parametrize("name", ["body.sto", "tum_hash.txt", "ros2_echo.csv", "dlc.csv"])
def test_layouts_of_others(name: str):
    path = ROOT.parent / "shared" / "cases" / "logs" / name
    if not path.exists():
        pytest.skip(f"needs {name}, which others made and which is not part of the project")
    signal = next(iter(read_episode(path).signals.values()))
    assert len(signal.values) == 400
