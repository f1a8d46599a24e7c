"""Runs and things of one table: each its own signal."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.conftest import real
from tests.tunenet_logs.test_csv_table import read
from tunenet_logs.copying import import_log
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode

_RUN = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]


def stacked(separator: str = "") -> str:
    rows = ["".join(f"{t + start:g},{1 - t:g}\n" for t in _RUN) for start in (0, 0.01)]
    return separator.join(rows)


@pytest.mark.parametrize("name", ["Drop #", "Run", "run", "trial", "Trial #", "take", "run_id"])
def test_runs_that_a_column_numbers(tmp_path: Path, name: str):
    episode = read(tmp_path, f"{name},t,z\n1,0,1\n1,0.1,2\n2,0,3\n2,0.1,4\n")
    assert {key: one.values[:, 2].tolist() for key, one in episode.signals.items()} == {
        "track.run1": [1, 2],
        "track.run2": [3, 4],
    }
    assert not episode.warnings
    assert [channel.messages for channel in episode.channels] == [2, 2]


def test_runs_and_things_of_other_names(tmp_path: Path):
    text = "body,t,x,y\nball,0,1,2\nHand A,0,5,6\nball,0.1,1,3\nHand A,0.1,5,7\n"
    assert set(read(tmp_path, text).signals) == {"track.ball", "track.hand_a"}
    text = "t,Run,q1,tau1\n0,Run 1,0,0\n1,Run 1,0,0\n0,Run 2,0,0\n1,Run 2,0,0\n"
    names = {f"joints.run{n}.{part}" for n in (1, 2) for part in ("position", "effort")}
    assert set(read(tmp_path, text).signals) == names


def test_a_number_of_a_run_that_goes_on_is_no_other_run(tmp_path: Path):
    assert set(read(tmp_path, "run,t,z\n1,0,1\n1,0.1,2\n2,0.2,3\n2,0.3,4\n").signals) == {"track"}
    assert set(read(tmp_path, "id,t,z\n1,0,1\n2,0.1,2\n3,0.1,3\n4,0.3,4\n").signals) == {"track"}


@pytest.mark.parametrize("between", ["", "\n", "t,z\n", "Run 2\nt,z\n", "Run 2,\n"])
def test_times_that_begin_again(tmp_path: Path, between: str):
    episode = read(tmp_path, "t,z\n" + stacked(between))
    assert set(episode.signals) == {"track.run1", "track.run2"}
    assert [len(one.values) for one in episode.signals.values()] == [6, 6]
    assert not episode.losses


@pytest.mark.parametrize("stray", ["0,9\n", "0.1,9\n0.2,9\n", "0.45,9\n"])
def test_a_few_rows_out_of_order_are_no_run(tmp_path: Path, stray: str):
    rows = "".join(f"{n / 10},{n}\n" for n in range(20))
    episode = read(tmp_path, f"t,z\n{rows}{stray}2.1,1\n2.2,1\n2.3,1\n2.4,1\n2.5,1\n")
    assert set(episode.signals) == {"track"}


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


def test_things_named_behind_their_axis(tmp_path: Path):
    episode = read(tmp_path, "t,x-ball,y-ball,x-axis,y score\n0,1,2,3,4\n1,2,3,4,5\n")
    assert set(episode.signals) == {"ball"}


def test_joints_of_a_robot_agree(tmp_path: Path):
    read(tmp_path, "t,q_1,q_2,qd_1\n0,1,2,3\n1,2,3,4\n")
    import_log(tmp_path / "a.csv", tmp_path / "a.mcap", overwrite=False)
    signals = read_episode(tmp_path / "a.mcap").signals
    assert signals["/joints.position"].columns == ("joint1", "joint2")


def test_too_many_runs_are_refused(tmp_path: Path):
    rows = "".join(f"{n},0,1\n{n},1,1\n" for n in range(501))
    with pytest.raises(LogError, match="501 runs, over the limit of 500"):
        read(tmp_path, f"run,t,z\n{rows}")


def test_drops_from_a_tower():
    signals = read_episode(real("labs/Ball_drops_data.csv")).signals
    assert {name: len(one.values) for name, one in signals.items()} == {
        "track.run1": 51,
        "track.run2": 56,
    }


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


def test_runs_of_several_things(tmp_path: Path):
    rows = "".join(
        f"{run},{ball},{n / 10},{run + n}\n" for run in (1, 2) for n in range(9) for ball in "ab"
    )
    names = {f"track.run{run}.{ball}" for run in (1, 2) for ball in "ab"}
    assert set(read(tmp_path, "trial,ball,t,z\n" + rows).signals) == names


def test_a_label_of_what_happens_is_no_thing(tmp_path: Path):
    rows = "".join(f"{n / 10},{'fall' if n < 20 else 'rest'},{n}\n" for n in range(40))
    assert set(read(tmp_path, "t,label,z\n" + rows).signals) == {"track"}


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
