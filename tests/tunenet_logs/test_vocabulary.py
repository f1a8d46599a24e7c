"""What a column's name means is said once, and so is a unit: every reader of tables knows both."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.export_writers_video import write_xlsx
from tunenet_logs.formats.columns import names
from tunenet_logs.reader import read_episode

CUBIT_M = 0.4572
HEIGHTS = np.linspace(4.0, 1.0, 30)  # in cubits
HEADER = ("t (s)", "visota (cubit)", "asteroid", "x (cubit)")


def rows() -> list[list[float | str]]:
    """Two things at the same times, one at 0 and one at 5 cubits."""
    return [
        [at / 100, float(height), thing, x]
        for at, height in enumerate(HEIGHTS)
        for thing, x in (("vesta", 0.0), ("juno", 5.0))
    ]


def write(path: Path) -> None:
    """Write the same table in the format that a name says."""
    table = pd.DataFrame(rows(), columns=list(HEADER))
    if path.suffix == ".csv":
        table.to_csv(path, index=False)
    elif path.suffix == ".xlsx":
        write_xlsx(path, {"S": [list(HEADER), *rows()]})
    elif path.suffix == ".parquet":
        table.to_parquet(path)
    elif path.suffix == ".jsonl":
        path.write_text("\n".join(map(json.dumps, table.to_dict("records"))))
    else:
        arrays = {name: table[name].to_numpy() for name in HEADER}
        np.savez(path, **{**arrays, "asteroid": table["asteroid"].to_numpy("U8")})  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("name", ["a.csv", "a.xlsx", "a.parquet", "a.jsonl", "a.npz"])
def test_a_word_and_a_unit_that_are_added_once_are_read_everywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
):
    if name == "a.xlsx":
        pytest.importorskip("python_calamine")
    if name == "a.parquet":
        pytest.importorskip("pyarrow")
    monkeypatch.setitem(names.LENGTHS, "cubit", CUBIT_M)
    monkeypatch.setattr(names, "_HEIGHTS", names._HEIGHTS | {"visota"})
    monkeypatch.setitem(names._RUNS, "asteroid", "object")
    names._meaning_of.cache_clear()
    write(tmp_path / name)
    signals = read_episode(tmp_path / name).signals
    names._meaning_of.cache_clear()
    assert set(signals) == {"track.vesta", "track.juno"}
    for signal in signals.values():
        assert signal.unit == "m"
        np.testing.assert_allclose(signal.values[:, 2], HEIGHTS * CUBIT_M)
        assert signal.stamps_ns[1] == 10_000_000
    np.testing.assert_allclose(signals["track.juno"].values[:, 0], 5 * CUBIT_M)


JUMP = ["23:59:59.98", "23:59:59.99", "0:00:00.00", "0:00:00.01"]


@pytest.mark.parametrize("name", ["a.csv", "a.xlsx", "a.parquet", "a.jsonl"])
@pytest.mark.parametrize("has_date", [False, True])
def test_times_of_the_day_and_dates_are_read_everywhere(tmp_path: Path, name: str, has_date: bool):
    days = ["2026-11-21", "2026-11-21", "2026-11-22", "2026-11-22"]
    table = pd.DataFrame({"Date": days, "Time": JUMP, "z": [4.0, 3.0, 2.0, 1.0]})
    table = table if has_date else table.drop(columns="Date")
    if name == "a.csv":
        table.to_csv(tmp_path / name, index=False)
    elif name == "a.xlsx":
        pytest.importorskip("python_calamine")
        write_xlsx(tmp_path / name, {"S": [list(table), *table.to_numpy().tolist()]})
    elif name == "a.parquet":
        pytest.importorskip("pyarrow")
        table.to_parquet(tmp_path / name)
    else:
        (tmp_path / name).write_text("\n".join(map(json.dumps, table.to_dict("records"))))
    (signal,) = read_episode(tmp_path / name).signals.values()
    assert np.diff(signal.stamps_ns).tolist() == [10_000_000] * 3
