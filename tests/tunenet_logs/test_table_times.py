"""Times and units of tables: exact, in whatever way they are written."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.tunenet_logs.test_csv_table import XYZ, one, read
from tunenet_logs.errors import LogError
from tunenet_logs.formats.columns.cells import exact_ns
from tunenet_logs.reader import read_episode


@pytest.mark.parametrize(
    ("text", "nanoseconds"),
    [
        ("2026-11-21T10:00:00.008333Z", 1_795_255_200_008_333_000),
        ("2026-11-21 10:00:00.008333333Z", 1_795_255_200_008_333_333),
        ("2026-11-21T11:00:00.5+01:00", 1_795_255_200_500_000_000),
        ("2026-11-21 10:00+0000", 1_795_255_200_000_000_000),
        ("0.008 sec", 8_000_000),
        ("1.5 ms", 1_500_000),
    ],
)
def test_times_that_say_what_they_are(tmp_path: Path, text: str, nanoseconds: int):
    episode = read(tmp_path, f"timestamp,z\n{text},1\n")
    assert episode.signals["track"].stamps_ns.tolist() == [nanoseconds]
    assert not episode.warnings


def test_a_date_without_a_zone_is_taken_as_utc(tmp_path: Path):
    text = "".join(f"2026-11-21 10:00:{n:02},{n}\n" for n in (8, 16, 24))
    episode = read(tmp_path, "timestamp,z\n" + text)
    assert episode.signals["track"].stamps_ns[0] == 1_795_255_208_000_000_000
    assert episode.warnings == ("'timestamp' names no time zone and was taken as UTC",)


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


def test_three_decimals_are_no_thousands(tmp_path: Path):
    assert one(tmp_path, "t;z\n0,5;1,050\n1,125;2,000\n").values[:, 2].tolist() == [1.05, 2]
    assert one(tmp_path, "t;z\n0.5;1.050\n1.125;2.000\n").values[:, 2].tolist() == [1.05, 2]
    assert one(tmp_path, "t,z\n0,1.050\n1,2.000\n").values[:, 2].tolist() == [1.05, 2]


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


def test_times_before_zero_begin_at_zero(tmp_path: Path):
    episode = read(tmp_path, "t,z\n-0.5,1\n0.1,2\n")
    assert episode.signals["track"].stamps_ns.tolist() == [0, 600_000_000]
    assert any("-0.5 s" in one for one in episode.warnings)


@pytest.mark.parametrize(
    ("text", "power", "nanoseconds"),
    [
        ("1700000000.123456789", 0, 1_700_000_000_123_456_789),
        ("1700000000123456789", -9, 1_700_000_000_123_456_789),
        ("1700000000123456.789", -6, 1_700_000_000_123_456_789),
        ("1.700000000123456789e9", 0, 1_700_000_000_123_456_789),
        ("0.1", -9, 0),
    ],
)
def test_times_are_exact(text: str, power: int, nanoseconds: int):
    assert exact_ns(text, power) == nanoseconds


@pytest.mark.parametrize(
    "text", ["", "x", "nan", "inf", "1e999999999", "9" * 30, "9" * 1000, "1e20"]
)
def test_what_is_no_time_is_refused(text: str):
    with pytest.raises(ValueError):  # noqa: PT011 (no user sees it)
        exact_ns(text, 0)


@pytest.mark.parametrize("digits", ["", "123", "123456", "123456789"])
def test_units_of_times_since_1970_go_by_their_size(tmp_path: Path, digits: str):
    signal = one(tmp_path, f"t,z\n1700000000{digits},1\n")
    assert signal.stamps_ns[0] // 10**9 == 1_700_000_000


def test_a_doubtful_unit_is_named(tmp_path: Path):
    assert any("unit" in one for one in read(tmp_path, "t,z\n0,1\n8,2\n16,3\n").warnings)
    assert not read(tmp_path, "t_ms,z\n0,1\n8,2\n16,3\n").warnings


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


def test_days_of_a_spreadsheet_are_times(tmp_path: Path):
    rows = "".join(f"{46328.4375 + n / 8_640_000:.10f},{n}\n" for n in range(50))
    episode = read(tmp_path, "Time,z\n" + rows)
    assert episode.signals["track"].rate_hz == pytest.approx(100, rel=1e-3)
    assert any("days of a spreadsheet" in one for one in episode.warnings)


def test_steps_that_no_log_has_are_named(tmp_path: Path):
    rows = "".join(f"{n / 8_640_000:.12f},{n}\n" for n in range(50))
    with pytest.raises(
        LogError, match=r"'Time' rises by 1.2e-07 .*too fast to be s; write it in s"
    ):
        read(tmp_path, "Time,z\n" + rows)


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
    text = f"Zeit (µs);{name}\n0;1000000\n10000;2000000\n"
    signal = one(tmp_path, text.encode(encoding))
    assert (signal.stamps_ns.tolist(), signal.unit) == ([0, 10_000_000], "m")
    assert signal.values[:, 2].tolist() == pytest.approx([1, 2])


def test_stamps_that_are_cut_short_are_named(tmp_path: Path):
    rows = "".join(f"{1.79e9 + n / 100:.6e},{n}\n" for n in range(50))
    with pytest.raises(
        LogError, match=r"49 of 50 rows .* the stamps have too few digits; write times with all"
    ):
        read(tmp_path, "time,z\n" + rows)
