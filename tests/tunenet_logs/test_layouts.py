"""Which layout a file is, by its content and under any name; what is not read is named truly.

What a column's name means is said once, and so is a unit: every reader of tables knows both.
"""

from __future__ import annotations

import json
import pickle
import subprocess
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT
from tests.reading import one, read, refusal, write_arrays
from tunenet_logs.formats.columns import names
from tunenet_logs.formats.registry import may_be_log
from tunenet_logs.reader import read_episode

S, NS = 1_790_000_000, 10**9
PLACES = np.round(np.random.default_rng(1).uniform(-1, 1, (30, 3)), 6)
TIMES_NS = S * NS + 10_000_000 * np.arange(30)


def rows(row: Callable[[int, str, str, np.ndarray], str]) -> str:
    """A line each for seconds, nanoseconds and place."""
    parts = zip(TIMES_NS.tolist(), PLACES, strict=True)
    return "".join(row(at // NS, f"{at % NS}", f"{at / NS:.6f}", one) + "\n" for at, one in parts)


def numbers(values: Iterable[float], mark: str = " ") -> str:
    return mark.join(f"{one:.6f}" for one in values)


TUM = rows(lambda _s, _n, t, one: f"{t} {numbers(one)} 0 0 0.6 0.8")
ECHO = rows(lambda s, n, _t, one: f"{s},{n},map,{numbers(one, ',')},0.0,0.0,0.6,0.8")
COVARIANCE = ",".join(["0.01"] * 36)
ODOMETRY = ECHO.replace("map", "map,ball").replace(
    ",0.6,0.8\n", f",0.6,0.8,{COVARIANCE},{','.join(['2.5'] * 6)},{COVARIANCE}\n"
)
STO = "Ball{0}\nversion=1\nnRows=30\nnColumns=4\ninDegrees=no\nendheader{0}\n" + (
    "time\tball_X\tball_Y\tball_Z\n"
    + rows(lambda s, n, _t, one: f"{s - S + int(n) / NS:.6f}\t{numbers(one, chr(9))}")
)
TUM_SAID, STO_SAID, ECHO_SAID = (
    ", a TUM trajectory",
    ", of OpenSim",
    ", `ros2 topic echo --csv` of ",
)


@pytest.mark.parametrize(
    ("name", "text", "what"),
    [
        ("a.txt", TUM, TUM_SAID),
        ("a.tum", "# timestamp tx ty tz qx qy qz qw\n" + TUM, TUM_SAID),
        ("a", "# ground truth\n# file: drop seven\n\n" + TUM, TUM_SAID),
        ("a.csv", "timestamp,tx,ty,tz,qx,qy,qz,qw\n" + TUM.replace(" ", ","), TUM_SAID),
        ("a.log", ECHO, f"{ECHO_SAID}PoseStamped"),
        ("a.csv", ECHO.replace("map", ""), f"{ECHO_SAID}PoseStamped"),
        ("a.dat", ECHO.replace(",0.6,0.8\n", f",0.6,0.8,{COVARIANCE}\n"),
         f"{ECHO_SAID}PoseWithCovarianceStamped"),
        ("a.csv", ECHO.replace("map", "map,ball"), f"{ECHO_SAID}TransformStamped"),
        ("a.csv", ODOMETRY, f"{ECHO_SAID}Odometry"),
        ("a.sto", STO.format(""), STO_SAID),
        ("a.mot", STO.format("\t\t\t"), STO_SAID),
        ("a.poses", "t x y z\n" + TUM.replace(" 0 0 0.6 0.8", ""), ""),
        ("a.log", "=~=~= PuTTY log =~=~=\r\nready\r\n" + STO.partition("endheader{0}\n")[2], ""),
    ],
)  # fmt: skip
def test_places_under_any_name(tmp_path: Path, name: str, text: str, what: str):
    episode = read(tmp_path / name, text)
    (signal,) = episode.signals.values()
    np.testing.assert_allclose(signal.values, PLACES, atol=1e-9)
    steps = (signal.stamps_ns - signal.stamps_ns[0]).tolist()
    assert steps == (TIMES_NS - TIMES_NS[0]).tolist()
    assert episode.info.source == f"table {name}{what}"
    assert may_be_log(tmp_path / name) == (Path(name).suffix not in (".tum", ".poses"))


def test_matrices_of_kitti_are_frames(tmp_path: Path):
    kitti = rows(lambda *of: "0 0 1 {:.6f} 1 0 0 {:.6f} 0 1 0 {:.6f}".format(*of[3]))
    signal = one(tmp_path / "00.txt", kitti)
    np.testing.assert_allclose(signal.values, PLACES, atol=1e-9)
    assert signal.counts_frames
    signal = one(tmp_path / "01.txt", kitti, fps=50.0)
    assert signal.rate_hz == pytest.approx(50)


def test_echoes_of_joints_of_bare_places_and_of_two_frames(tmp_path: Path):
    path = tmp_path / "a.csv"
    joints = rows(lambda s, n, _t, one: f"{s},{n},,a,b,{numbers([*one, *-one], ',')}")
    signals = read(path, joints).signals
    np.testing.assert_allclose(signals["joints.position"].values, PLACES[:, :2])
    np.testing.assert_allclose(signals["joints.effort"].values, -PLACES[:, 1:])
    assert signals["joints.effort"].columns == ("a", "b")
    bare = rows(lambda s, n, _t, one: f"{s},{n},map,{numbers(one, ',')}")
    told = refusal(path, bare)  # asks by a line that works
    assert told.endswith("--columns x=4,y=5,z=6")
    signal = one(path, bare, told.rpartition(" ")[2])
    np.testing.assert_allclose(signal.values, PLACES)
    assert signal.stamps_ns.tolist() == TIMES_NS.tolist()
    told = refusal(path, ECHO.replace("map", "other", 40) + ECHO.replace("map", "b"))
    assert "line 31 is of 'b', those before it of 'other'" in told
    subprocess.run(told.rpartition("example: ")[2], shell=True, cwd=tmp_path, check=True)
    assert len(read_episode(tmp_path / "one.csv").signals["track"].values) == 30


@pytest.mark.parametrize(("degrees", "scale"), [("no", 1.0), ("yes", np.pi / 180)])
def test_opensim_s_angles_are_in_what_its_head_says(tmp_path: Path, degrees: str, scale: float):
    head = f"Coordinates\nversion=1\nnRows=3\nnColumns=2\ninDegrees={degrees}\nendheader\n"
    episode = read(tmp_path / "a.mot", head + "time\tknee_angle\n0\t30\n.1\t60\n.2\t90\n")
    (signal,) = episode.signals.values()
    np.testing.assert_allclose(signal.values[:, 0], np.array([30, 60, 90]) * scale)
    cut = read(tmp_path / "a.sto", "".join(STO.format("").splitlines(keepends=True)[:-5]))
    assert cut.losses == ("it says that it has 30 rows, and has 25",)


@pytest.mark.parametrize("individuals", [False, True])
def test_deeplabcut_s_three_rows_of_names(tmp_path: Path, individuals: bool):
    heads = {"scorer": ["DLC"] * 6, "individuals": ["one"] * 3 + ["two"] * 3}
    heads |= {"bodyparts": ["ball"] * 3 + ["hand"] * 3, "coords": ["x", "y", "likelihood"] * 2}
    if not individuals:
        del heads["individuals"]
    text = "".join(f"{name},{','.join(cells)}\n" for name, cells in heads.items())
    for at, (x, y, _) in enumerate(PLACES):
        text += f"{at},{x:.6f},{y:.6f},0.99,{x:.6f},{y:.6f},{0.99 if at < 20 else 0.3}\n"
    episode = read(tmp_path / "a.csv", text)
    assert list(episode.signals) == (["one.ball", "two.hand"] if individuals else ["ball", "hand"])
    ball, hand = episode.signals.values()
    np.testing.assert_allclose(ball.values[:, :2], PLACES[:, :2])
    assert (ball.unit, ball.counts_frames, len(hand.values)) == ("px", True, 20)
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
    lines = [
        f"{at / 100}{mark}{form.format(*(scale * one))}{mark}red" for at, one in enumerate(PLACES)
    ]
    signal = one(tmp_path / "a.csv", "\n".join([names, *lines]))
    np.testing.assert_allclose(signal.values, PLACES, atol=1e-12)
    assert signal.unit == ("m" if "mm" in names else "")
    lines[7] = lines[7].partition("]")[0] + '"'  # breaks off, which costs its row
    episode = read(tmp_path / "a.csv", "\n".join([names, *lines]))
    assert len(next(iter(episode.signals.values())).values) == 29
    assert "1 of 30 rows" in episode.losses[0]


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be", "utf-32", "cp1252"])
def test_encodings(tmp_path: Path, encoding: str):
    bare = TUM.replace(" ", ",").replace(",0,0,0.6,0.8", "")
    text = f"Drop in Köln, µ\nt (s),x (m),y (m),z (m)\n{bare}"
    signal = one(tmp_path / "a.dat", text.encode(encoding))
    np.testing.assert_allclose(signal.values, PLACES, atol=1e-9)


def test_json_under_another_name(tmp_path: Path):
    records = [{"t": at / 100, "z": z} for at, z in enumerate(PLACES[:, 2].tolist())]
    signal = one(tmp_path / "a.log", json.dumps(records, indent=1))
    np.testing.assert_allclose(signal.values[:, 2], PLACES[:, 2])


HDF5 = b"\x89HDF\r\n\x1a\n"


@pytest.mark.parametrize(
    ("name", "data", "what", "remedy"),
    [
        ("a.txt", TUM.replace("0.6 0.8", "0.6 0.9").encode(), "no line that names its", "columns"),
        ("a.txt", b"t fx fy fz a b c d\n" + TUM.encode(), "holds no track", ""),
        ("v.sto", STO.format("").replace("Ball\n", "Velocities\n", 1).encode(),
         "OpenSim's table of 'Velocities'", ""),
        ("a.h5", HDF5 + bytes(600), "an HDF5 file that is not read", "write it"),
        ("a.dat", HDF5 + bytes(1000), "is an HDF5 file that is not read", ""),
        ("b.h5", bytes(512) + HDF5 + bytes(9), "an HDF5 file", "write it again"),
        ("a.mat", b"MATLAB 7.3 MAT-file".ljust(600), "a MATLAB file that is not read", "-v7"),
        ("a.slp", HDF5 + bytes(600), "a project of SLEAP", "Analysis CSV"),
        ("p.h5", HDF5 + bytes(99) + b"pandas_type", "an HDF5", "read_hdf"),
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
        ("a.dat", b"\x7fELF" + bytes(1000), "is a program", ""),
        ("a.dat", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + bytes(1000), "a file of an office pro", ""),
        ("a.dat", b"version https://git-lfs.github.com/spec/v1\n", "", "git lfs pull"),
        ("a.dat", bytes(1100), "nothing but zeros", ""),
    ],
)  # fmt: skip
def test_what_is_not_read_is_called_what_it_is(
    tmp_path: Path, name: str, data: bytes, what: str, remedy: str
):
    told = refusal(tmp_path / name, data)
    assert what in told
    assert remedy in told.partition("; ")[2]
    assert "video" not in told or name == "notes.log"


@pytest.mark.parametrize("name", ["body.sto", "tum_hash.txt", "ros2_echo.csv", "dlc.csv"])
def test_layouts_of_others(name: str):
    path = ROOT.parent / "shared" / "cases" / "logs" / name
    if not path.exists():
        pytest.skip(f"needs {name}, which others made and which is not part of the project")
    signal = next(iter(read_episode(path).signals.values()))
    assert len(signal.values) == 400


@pytest.mark.parametrize("name", ["a.csv", "a.xlsx", "a.parquet", "a.jsonl", "a.npz"])
def test_a_word_and_a_unit_that_are_added_once_are_read_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
):
    cubit_m, heights = 0.4572, np.linspace(4.0, 1.0, 30)
    monkeypatch.setitem(names.LENGTHS, "cubit", cubit_m)
    monkeypatch.setattr(names, "_HEIGHTS", names._HEIGHTS | {"visota"})
    monkeypatch.setitem(names._RUNS, "asteroid", "object")
    names._meaning_of.cache_clear()
    told = [
        [at / 100, float(height), thing, x]
        for at, height in enumerate(heights)
        for thing, x in (("vesta", 0.0), ("juno", 5.0))
    ]
    header = ["t (s)", "visota (cubit)", "asteroid", "x (cubit)"]
    write_arrays(tmp_path / name, dict(zip(header, zip(*told, strict=True), strict=True)))
    signals = read_episode(tmp_path / name).signals
    names._meaning_of.cache_clear()
    assert set(signals) == {"track.vesta", "track.juno"}
    for signal in signals.values():
        assert signal.unit == "m"
        np.testing.assert_allclose(signal.values[:, 2], heights * cubit_m)
        assert signal.stamps_ns[1] == 10_000_000
    np.testing.assert_allclose(signals["track.juno"].values[:, 0], 5 * cubit_m)


@pytest.mark.parametrize("name", ["a.csv", "a.xlsx", "a.parquet", "a.jsonl"])
@pytest.mark.parametrize("has_date", [False, True])
def test_times_of_the_day_and_dates_are_read_everywhere(tmp_path: Path, name: str, has_date: bool):
    jump = ["23:59:59.98", "23:59:59.99", "0:00:00.00", "0:00:00.01"]
    days = ["2026-11-21", "2026-11-21", "2026-11-22", "2026-11-22"]
    dates = {"Date": days} if has_date else {}
    write_arrays(tmp_path / name, {**dates, "Time": jump, "z": [4.0, 3.0, 2.0, 1.0]})
    (signal,) = read_episode(tmp_path / name).signals.values()
    assert np.diff(signal.stamps_ns).tolist() == [10_000_000] * 3
