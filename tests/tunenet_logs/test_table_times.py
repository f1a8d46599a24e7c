"""Times and units of tables, runs and things apart; what is measured in tables of robots."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from tests.reading import one, read, skipped
from tests.tunenet_logs.test_csv_table import XYZ
from tunenet_logs.analysis.payload.arm_log import read_arm_log
from tunenet_logs.copying import import_log
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.arm.description import jaco


@pytest.mark.parametrize(
    ("text", "stamps"),
    [
        ("2026-11-21T10:00:00.008333Z", [1_795_255_200_008_333_000]),
        ("2026-11-21 10:00:00.008333333Z", [1_795_255_200_008_333_333]),
        ("2026-11-21T11:00:00.5+01:00", [1_795_255_200_500_000_000]),
        ("2026-11-21 10:00+0000", [1_795_255_200_000_000_000]),
        ("0.008 sec", [8_000_000]),
        ("1700000000.123456789", [1_700_000_000_123_456_789]),
        ("1.700000000123456789e9", [1_700_000_000_123_456_789]),
        ("1700000000123456.789", [1_700_000_000_123_456_789]),
        ("1700000000123456789", [1_700_000_000_123_456_789]),
        ("1.5 ms", [1_500_000]),
    ],
)
def test_times_that_say_what_they_are(tmp_path: Path, text: str, stamps: list[int]):
    episode = read(tmp_path, f"timestamp,z\n{text},1\n")
    assert episode.signals["track"].stamps_ns.tolist() == stamps
    assert not episode.warnings


@pytest.mark.parametrize(
    "text",
    [
        "t_ms;z_mm\n8,5;1.050,00\n1.008,5;999,5\n",
        't_ms,z_mm\n8.5,"1,050.00"\n"1,008.5",999.5\n',
        "t_ms\tz_mm\n8,5\t1.050,00\n1.008,5\t999,5\n",
        "t_us;z_mm\n8500;1050,00\n1.008.500;999,5\n",
        "t_us;z_mm\n8500;1050.0\n1,008,500;999.5\n",
    ],
)
def test_thousands_that_are_set_apart(tmp_path: Path, text: str):
    signal = one(tmp_path, text)
    assert signal.stamps_ns.tolist() == [8_500_000, 1_008_500_000]
    np.testing.assert_allclose(signal.values[:, 2], [1.05, 0.9995])


@pytest.mark.parametrize(
    "text",
    [
        "time,x,y,z\ns,mm,mm,mm\n0.5,1000,2000,3000\n1,4000,5000,6500\n",
        "t,x,y,z\n# a note\n\n(ms),[mm],(cm),m\n500,1000,200,3\n1000,4000,500,6.5\n",
        "# t x y z\n# s mm mm mm\n0.5 1000 2000 3000\n1 4000 5000 6500\n",
        "n,t_s,x_mm,y (mm),z\n-,s,mm,millimeters,mm\n1,0.5,1000,2000,3000\n2,1,4000,5000,6500\n",
        "secs,nsecs,x,y,z\ns,ns,,,m\n0,500000000,1,2,3\n1,0,4,5,6.5\n",
        "Length Units,Millimeters\n\nt,x,y,z_m\n0.5,1000,2000,3\n1,4000,5000,6.5\n",
        '"Start Time","9","Length Units","Centimeters"\nt,x,y,z\n0.5,100,200,300\n1,400,500,650\n',
        "# units: mm\n# t,x,y,z\n0.5,1000,2000,3000\n1,4000,5000,6500\n",
        "Length Units,Meters\nt,x,y,z\ns,mm,mm,mm\n0.5,1000,2000,3000\n1,4000,5000,6500\n",
    ],
)
def test_units_beside_the_names(tmp_path: Path, text: str):
    episode = read(tmp_path, text)
    signal = episode.signals["track"]
    assert signal.stamps_ns.tolist() == [500_000_000, 1_000_000_000]
    np.testing.assert_allclose(signal.values, XYZ, rtol=1e-15)
    assert not episode.losses


def test_units_of_joints_below_their_names(tmp_path: Path):
    text = "t,elbow_effort,elbow_position,lift_position\ns,N·m,°,mm\n0,1,180,5\n"
    episode = read(tmp_path, text)
    assert episode.signals["joints.effort"].values.tolist() == [[1]]
    np.testing.assert_allclose(episode.signals["joints.position"].values, [[np.pi]])
    assert any("unit" in (one.skipped or "") for one in episode.channels)


SPREADSHEET = "".join(f"{46328.4375 + n / 8_640_000:.10f},{n}\n" for n in range(50))
NO_ZONE = "".join(f"2026-11-21 10:00:{n:02},{n}\n" for n in (8, 16, 24))


@pytest.mark.parametrize(
    ("text", "first_ns", "rate_hz", "says"),
    [
        (f"timestamp,z\n{NO_ZONE}", 1_795_255_208_000_000_000, 0.125,
         "'timestamp' names no time zone and was taken as UTC"),
        ("t,z\n-0.5,1\n0.1,2\n", 0, 1 / 0.6, "-0.5 s"),  # before zero
        (f"Time,z\n{SPREADSHEET}", None, 100, "days of a spreadsheet"),
        ("t,z\n0,1\n8,2\n16,3\n", 0, None, "unit"),
        ("t_ms,z\n0,1\n8,2\n16,3\n", 0, 125, ""),
        *((f"t,z\n1700000000{digits},1\n1700000001{digits},1\n", None, 1, None)
          for digits in ("", "123", "123456", "123456789")),  # since 1970: by their size
    ],
)  # fmt: skip
def test_what_is_taken_for_granted_is_said(
    tmp_path: Path, text: str, first_ns: int | None, rate_hz: float | None, says: str | None
):
    episode = read(tmp_path, text)
    signal = episode.signals["track"]
    assert signal.stamps_ns[0] in (first_ns, signal.stamps_ns[0] if first_ns is None else first_ns)
    if rate_hz:
        assert signal.rate_hz == pytest.approx(rate_hz, rel=1e-3)
    if says is not None:
        assert any(says in one for one in episode.warnings) == bool(says)
    if "17000" in text:
        assert signal.stamps_ns[0] // 10**9 == 1_700_000_000


UNITS_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}


def written(times_ns: list[int], unit: str) -> list[str]:
    """Times as decimal numbers of a unit, exactly."""
    size = UNITS_NS[unit]
    return [
        f"{at // size}.{at % size * (10**9 // size):09}".rstrip("0").rstrip(".") for at in times_ns
    ]


@pytest.mark.parametrize("start_s", [0, 53, 170_000, 1_790_000_000])
@pytest.mark.parametrize("rate_hz", [25, 240, 960])
@pytest.mark.parametrize("unit", list(UNITS_NS))
@pytest.mark.parametrize("kind", ["csv", "jsonl", "npz"])
def test_units_that_no_name_tells_go_by_the_steps(
    tmp_path: Path, kind: str, unit: str, rate_hz: int, start_s: int
):
    rows = [n if n < 30 else n + rate_hz // 2 for n in range(120)]  # a gap of half a second
    times_ns = [start_s * 10**9 + n * 10**9 // rate_hz for n in rows]
    texts = written(times_ns, unit)
    path = tmp_path / f"a.{kind}"
    if kind == "csv":
        path.write_text("timestamp,z\n" + "".join(f"{text},1\n" for text in texts))
    elif kind == "jsonl":
        path.write_text("".join(f'{{"timestamp": {text}, "z": 1.5}}\n' for text in texts))
    else:
        np.savez(path, timestamp=np.array(texts, np.float64), z=np.ones(len(texts)))
    episode = read_episode(path)
    stamps_ns = episode.signals["track"].stamps_ns
    exact_to_ns = 1 if kind != "npz" else 1000  # float64 holds 1.79e18 ns to 256 ns
    assert np.abs(stamps_ns - np.array(times_ns)).max() <= exact_to_ns
    doubted = any("names no unit" in one for one in episode.warnings)
    assert doubted == (unit != "s" and start_s < 1e9)


@pytest.mark.parametrize(
    ("header", "cells", "seconds"),
    [
        ("Date,Time", ("2026-11-21,10:00:00.5", "2026-11-22,9:00:00"), 82_799.5),
        ("Datum;Uhrzeit", ("21.11.2026;10:00:00,5", "21.11.2026;10:00:01,25"), 0.75),
        ("Date,Time", ("11/21/2026,11:59:59.5 AM", "11/21/2026,12:00:00.5 PM"), 1.0),
        ("Time", ("23:59:59.9", "0:00:00.1"), 0.2),
        ("Time", ("59:59.9", "00:00.1"), 0.2),
        ("Date", ("2026-11-21 10:00:00.5", "2026-11-21 10:00:01"), 0.5),
        ("Date,t", ("2026-11-21,0.5", "2026-11-21,0.75"), 0.25),
    ],
)
def test_dates_and_times_of_the_day(
    tmp_path: Path, header: str, cells: tuple[str, str], seconds: float
):
    mark = ";" if ";" in header else ","
    text = f"{header}{mark}z\n" + "".join(f"{one}{mark}1\n" for one in cells)
    assert one(tmp_path, text).seconds.tolist() == pytest.approx([0, seconds])


@pytest.mark.parametrize("name", ["Höhe (µm)", "hauteur / um", "h in µm"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16"])
def test_units_are_kept_in_every_encoding(tmp_path: Path, encoding: str, name: str):
    signal = one(tmp_path, f"Zeit (µs);{name}\n0;1000000\n10000;2000000\n".encode(encoding))
    assert (signal.stamps_ns.tolist(), signal.unit) == ([0, 10_000_000], "m")
    assert signal.values[:, 2].tolist() == pytest.approx([1, 2])


# Runs and things of one table.
STEPS = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
IN_ORDER = "".join(f"{n / 10},{n}\n" for n in range(20))
LATER = "2.1,1\n2.2,1\n2.3,1\n2.4,1\n2.5,1\n"
BOTH = {"track.run1", "track.run2"}


def stacked(separator: str = "") -> str:
    rows = ["".join(f"{t + start:g},{1 - t:g}\n" for t in STEPS) for start in (0, 0.01)]
    return "t,z\n" + separator.join(rows)


@pytest.mark.parametrize(
    ("text", "names"),
    [
        *((f"{name},t,z\n1,0,1\n1,0.1,2\n2,0,3\n2,0.1,4\n", BOTH) for name in (
            "Drop #", "Run", "run", "trial", "Trial #", "take", "run_id")),
        ("body,t,x,y\nball,0,1,2\nHand A,0,5,6\nball,0.1,1,3\nHand A,0.1,5,7\n",
         {"track.ball", "track.hand_a"}),
        ("t,Run,q1,tau1\n0,Run 1,0,0\n1,Run 1,0,0\n0,Run 2,0,0\n1,Run 2,0,0\n",
         {f"joints.run{n}.{part}" for n in (1, 2) for part in ("position", "effort")}),
        # Numbers of what goes on are no other run.
        ("run,t,z\n1,0,1\n1,0.1,2\n2,0.2,3\n2,0.3,4\n", {"track"}),
        ("id,t,z\n1,0,1\n2,0.1,2\n3,0.1,3\n4,0.3,4\n", {"track"}),
        # Times that begin again, and a few rows out of order.
        *((stacked(between), BOTH) for between in ("", "\n", "t,z\n", "Run 2\nt,z\n", "Run 2,\n")),
        *((f"t,z\n{IN_ORDER}{stray}{LATER}", {"track"}) for stray in (
            "0,9\n", "0.1,9\n0.2,9\n", "0.45,9\n")),
        ("t,x-ball,y-ball,x-axis,y score\n0,1,2,3,4\n1,2,3,4,5\n", {"ball"}),
        ("trial,ball,t,z\n" + "".join(f"{run},{ball},{n / 10},{run + n}\n" for run in (1, 2)
                                      for n in range(9) for ball in "ab"),
         {f"track.run{run}.{ball}" for run in (1, 2) for ball in "ab"}),
        # A label of what happens is no thing.
        ("t,label,z\n" + "".join(f"{n / 10},{'fall' if n < 20 else 'rest'},{n}\n"
                                 for n in range(40)), {"track"}),
    ],
)  # fmt: skip
def test_runs_and_things_are_apart(tmp_path: Path, text: str, names: set[str]):
    episode = read(tmp_path, text)
    assert set(episode.signals) == names
    if names == BOTH:
        first, second = (len(one.values) for one in episode.signals.values())
        assert first == second == (6 if text.startswith("t,") else 2)
        assert [one.messages for one in episode.channels] == [first, second]
        assert not episode.losses
    if text.startswith("Drop"):
        values = [one.values[:, 2].tolist() for one in episode.signals.values()]
        assert (values, episode.warnings) == ([[1, 2], [3, 4]], ())


@pytest.mark.parametrize(
    "header",
    [
        "t1,z1,t2,z2",
        "Time 1,Height 1,Time 2,Height 2",
        "t,z,t,z",
        "Time (s),Height (m),Time (s),Height (m)",
        "Time (s) Run #1,Position (m) Run #1,Time (s) Run #2,Position (m) Run #2",
        "Data Set 1:Time(s),Data Set 1:Position(m),Data Set 2:Time(s),Data Set 2:Position(m)",
    ],
)
def test_runs_side_by_side(tmp_path: Path, header: str):
    episode = read(tmp_path, f"{header}\n0,1,0.5,3\n0.1,2,0.7,4\n0.2,3,,\n")
    first, second = episode.signals["track.run1"], episode.signals["track.run2"]
    assert first.values[:, 2].tolist() == [1, 2, 3]
    assert second.stamps_ns.tolist() == [500_000_000, 700_000_000]
    assert not episode.losses


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("run,t,z\n" + "".join(f"{n},0,1\n{n},1,1\n" for n in range(501)),
         "501 runs, over the limit of 500"),
        ("Time,z\n" + "".join(f"{n / 8_640_000:.12f},{n}\n" for n in range(50)),
         r"'Time' rises by 1.2e-07 .*too fast to be s; write it in s"),
        ("time,z\n" + "".join(f"{1.79e9 + n / 100:.6e},{n}\n" for n in range(50)),
         r"49 of 50 rows .* the stamps have too few digits; write times with all"),
    ],
)  # fmt: skip
def test_times_and_runs_that_no_log_has(tmp_path: Path, text: str, says: str):
    with pytest.raises(LogError, match=says):
        read(tmp_path, text)


THINGS = [
    *("name", "label", "entity", "rigid_body", "Ball", "object_id", "track_name"),
    *("colour", "Serial"),  # what no vocabulary knows
]


def woven(name: str, labels: tuple[str, str], count: int = 40) -> list[dict[str, object]]:
    """Rows of two things at the same times: one at x = 0, the other at x = 5."""
    return [
        {"t": n / 100, name: label, "x": x, "z": 1 - n / 100}
        for n in range(count)
        for label, x in zip(labels, (0, 5), strict=True)
    ]


@pytest.mark.parametrize("labels", [("B2", "A"), ("2", "7")])
@pytest.mark.parametrize("name", THINGS)
def test_things_of_one_time_are_told_apart_by_any_column(
    tmp_path: Path, name: str, labels: tuple[str, str]
):
    rows = woven(name, labels)
    text = "\n".join(",".join(map(str, row.values())) for row in [{k: k for k in rows[0]}, *rows])
    signals = read(tmp_path, text).signals
    assert [set(one.values[:, 0].tolist()) for one in signals.values()] == [{0}, {5}]
    assert [len(one.values) for one in signals.values()] == [40, 40]
    if name in THINGS[:-2]:  # the other readers know the same names
        (tmp_path / "a.jsonl").write_text("\n".join(map(json.dumps, rows)))
        assert set(read_episode(tmp_path / "a.jsonl").signals) == set(signals)


@pytest.mark.parametrize("kind", ["csv", "jsonl"])
def test_things_that_nothing_tells_apart_are_asked_about(tmp_path: Path, kind: str):
    rows = woven("name", ("a", "b"))
    path = tmp_path / f"a.{kind}"
    plain = [{key: row[key] for key in ("t", "x", "z")} for row in rows]
    if kind == "csv":
        path.write_text("t,x,z\n" + "".join(f"{row['t']},{row['x']},{row['z']}\n" for row in rows))
    else:
        path.write_text("\n".join(map(json.dumps, plain)))
    with pytest.raises(LogError, match=r"40 of 80 rows have the stamp of another.*object=NAME"):
        read_episode(path)
    if kind == "jsonl":
        plain = [{**row, "of": one["name"]} for row, one in zip(plain, rows, strict=True)]
        path.write_text("\n".join(map(json.dumps, plain)))
        for said in (ReadOptions(), ReadOptions(columns={"object": "of"})):
            assert set(read_episode(path, said).signals) == {"track.a", "track.b"}


# Tables of robots: what is measured and what is commanded is used, what is modelled says so.
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


@pytest.mark.parametrize("separator", [",", " ", ";"])
def test_measured_joints_of_an_rtde_recording(tmp_path: Path, separator: str):
    episode = read_episode(table(tmp_path / "ur.csv", (*RTDE, "target_q"), separator=separator))
    assert set(episode.signals) == {"joints.position", "joints.velocity", "commands.position"}
    position, command = (episode.signals[f"{one}.position"] for one in ("joints", "commands"))
    assert (position.drives, command.drives) == (False, True)
    assert (command.columns, command.unit) == (position.columns, "rad")
    np.testing.assert_allclose(command.values[0], 40 + np.arange(6))
    assert (position.columns[0], position.unit) == ("shoulder_pan_joint", "rad")
    np.testing.assert_allclose(position.values[0], range(6))
    assert position.stamps_ns[1] == 2_000_000
    reasons = skipped(episode)
    assert "the payload that was set" in reasons["target_moment 0 to 5"]
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
        (("target_q", "target_qd"), (1, 2), "there are no measured currents"),
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
    states = {"joints.position": 1, "joints.velocity": 21, "joints.effort": 41}
    assert by_name == states | {"commands.position": 11, "commands.velocity": 31}
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
