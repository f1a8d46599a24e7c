"""Signals and what is known of an episode are checked once; small files have bounds and kinds."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.message_logs import in_steps, write_json
from tests.strangers import Stranger, write_poses, write_poses_bag
from tunenet_logs.analysis.cli.tune import main as tunenet_tune
from tunenet_logs.analysis.record import read_record
from tunenet_logs.cli import main as logs
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.files import open_regular, open_regular_text, parse_json, read_small_file
from tunenet_logs.recorders.simulators.arm.description import read_urdf
from tunenet_logs.recorders.simulators.shot import read_rig
from tunenet_logs.terminal import one_line
from tunenet_logs.writing.writer import EpisodeWriter


def signal(stamps: list[int], rows: int | None = None) -> Signal:
    count = len(stamps) if rows is None else rows
    return Signal("/a", np.array(stamps, np.int64), np.zeros((count, 2)), ("x", "y"), "m")


def test_signal_is_checked_and_a_read_only_copy():
    with pytest.raises(ValueError, match="increase"):
        signal([1, 2, 2])
    with pytest.raises(ValueError, match=r"\(3, 2\).*\(2, 2\)"):
        signal([1, 2], rows=3)
    values = np.zeros((2, 1))
    made = Signal("/a", np.array([0, 10**7]), values, ("x",), "m")
    values[0] = 5
    assert made.values[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        made.values[0] = 1
    assert made.rate_hz == pytest.approx(100)


def test_pandas_table_keeps_stamps_and_names():
    table = Episode(EpisodeInfo(), {"/a": signal([5, 7])}).to_pandas()
    assert list(table.index) == [5, 7]
    assert list(table.columns) == [("/a", "x"), ("/a", "y")]


words = st.text(max_size=20)
names = st.from_regex(r"[a-z_]{1,10}", fullmatch=True)
numbers = st.floats(allow_nan=False, allow_infinity=False)


@given(
    words,
    words,
    st.dictionaries(names, numbers, max_size=3),
    st.dictionaries(names, st.integers(0, 10**12), max_size=3),
    st.dictionaries(names, words, max_size=3),
)
def test_info_survives_strings(
    kind: str, source: str, rig: dict[str, float], counts: dict[str, int], notes: dict[str, str]
):
    info = EpisodeInfo(kind=kind, source=source, rig=rig, truth=rig, counts=counts, notes=notes)
    assert EpisodeInfo.from_strings(info.to_strings()) == info


@given(st.dictionaries(st.text(max_size=30), st.text(max_size=30), max_size=8))
def test_any_strings_make_an_info(record: dict[str, str]):
    EpisodeInfo.from_strings(record)
    info = EpisodeInfo.from_strings({"truth.restitution": "nan", "rig.ball_diameter_m": "1e999"})
    assert not info.truth
    assert not info.rig


# Small files beside logs, and what is no file: bounds, kinds, and JSON without its traps.
@pytest.mark.parametrize(
    "text",
    ["1e999", "NaN", "-Infinity", "9" * 5000, str(2**63), '{"a": 1, "a": 2}', "[" * 40 + "]" * 40,
     "[" * 100_000, '{"a":' * 5000, "", "{", '"\\',
     # A text of a million characters that does not end: at once, where its square took an hour.
     *('{"a": "' + atom * (1_000_000 // len(atom))
       for atom in ('\\"', '"', "\\\\", "\\", "[", '"a', "1"))],
    ids=lambda text: text[:12],
)  # fmt: skip
def test_no_json_of_ours(text: str):
    with pytest.raises(ValueError) as caught:  # noqa: PT011 (whatever json says)
        parse_json(text.encode())
    assert len(str(caught.value)) < 200


def test_brackets_in_strings_are_text():
    text = "[" * 100 + '\\"' + "{" * 100
    assert parse_json(f'["{text}", -9223372036854775808, 0.5]')[1:] == [-(2**63), 0.5]


@pytest.mark.parametrize(
    "text",
    ["[" * 2000, "{" * 2000, "gravity_m_s2: !!bool x", "a: &a 1\nb: &a 2", "a: *b", "x" * 30_000],
)
def test_a_rig_that_is_none_is_refused_before_it_costs_anything(tmp_path: Path, text: str):
    (tmp_path / "rig.yaml").write_text(text)
    with pytest.raises(UsageError, match=r"brackets|holds &|larger|no YAML"):
        read_rig(tmp_path / "rig.yaml")


@pytest.mark.parametrize("value", ["9" * 400, "1e999", '"' + "x" * 100_000 + '"'])
def test_a_record_with_a_number_that_is_none(tmp_path: Path, value: str):
    file = tmp_path / "a.json"
    file.write_text(f'{{"verdict": "ok", "parameters": null, "iterations": [{{"e": {value}}}]}}')
    with pytest.raises(LogError) as caught:
        read_record(file)
    assert len(str(caught.value)) < len(str(file)) + 300


def test_a_description_of_very_many_elements(tmp_path: Path):
    (tmp_path / "a.urdf").write_text("<robot>" + "<a>" * 900_000)
    with pytest.raises(UsageError, match="tags"):
        read_urdf(tmp_path / "a.urdf")


def test_a_file_and_a_link_to_it_are_read(tmp_path: Path):
    data = "Höhe\r\n".encode()
    (tmp_path / "a").write_bytes(data)
    (tmp_path / "link").symlink_to("a")
    for name in ("a", "link"):
        with open_regular(tmp_path / name) as file:
            assert file.read() == data
            assert os.get_blocking(file.fileno())
            assert not os.get_inheritable(file.fileno())
    with open_regular_text(tmp_path / "a", "utf-8") as text:
        assert text.read() == "Höhe\n"
    assert read_small_file(tmp_path / "a", len(data)) == data
    with pytest.raises(ValueError, match="larger than"):
        read_small_file(tmp_path / "a", len(data) - 1)


def test_what_is_no_regular_file_is_refused_before_anything_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pipe, whole = tmp_path / "pipe", tmp_path / "whole"
    os.mkfifo(pipe)
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "socket"))
        for path in (pipe, tmp_path / "socket", Path("/dev/zero"), Path("/dev/tty")):
            with pytest.raises(LogError, match=f"^{path}: is no regular file"):
                open_regular(path)
    for place in (tmp_path, pipe):
        with pytest.raises((OSError, LogError), match=r"regular file|directory"):
            read_small_file(place, 4)
    whole.write_bytes(b"x")  # a pipe that takes a file's place is not waited for
    state = Path.stat
    monkeypatch.setattr(Path, "stat", lambda path, **_: state(whole if path == pipe else path))
    with pytest.raises(LogError, match="is no regular file"):
        open_regular(pipe)


def test_folders_and_circles_are_errors_of_the_system_and_what_states_no_size_is_empty(
    tmp_path: Path,
):
    (tmp_path / "circle").symlink_to("circle")
    for path in (tmp_path, tmp_path / "circle", tmp_path / "nothing"):
        before = len(list(Path("/proc/self/fd").iterdir()))
        with pytest.raises(OSError, match=str(path)):
            open_regular(path)
        assert len(list(Path("/proc/self/fd").iterdir())) == before
    (tmp_path / "empty").write_bytes(b"")
    for path in (tmp_path / "empty", Path("/proc/self/maps")):
        with open_regular(path) as file:
            assert file.read() == b""


# Texts of others on a terminal: nothing but characters that print, whatever a log holds.
HOSTILE = "/b\x1b[31m\nwarning: x\r\t\x9b5m\u202e\u2066\x00\x7f"
SHOWN = r"/b\x1b[31m\nwarning: x\r\t\x9b5m\u202e\u2066\x00\x7f"
SAMPLES = Stranger(0.7).samples()
INFO = EpisodeInfo(
    kind=HOSTILE, source=HOSTILE, preset=HOSTILE, rig={HOSTILE: 1.0}, notes={HOSTILE: HOSTILE}
)
TABLE = "time,\x1b[31mq\u202e,x\x9b,z\n0,1,2,3\n1,2,3,4\n"
LOGS: dict[str, Callable[[Path], object]] = {
    "a.mcap": lambda path: write_poses(path, *SAMPLES, topic=HOSTILE),
    "a.bag": lambda path: write_poses_bag(path, *SAMPLES, topic=HOSTILE),
    "type.mcap": lambda path: write_json(path, in_steps(HOSTILE, f"pkg/msg/{HOSTILE}", [{}])),
    "notes.mcap": lambda path: EpisodeWriter(path, INFO, live=False).close(),
    "a.csv": lambda path: path.write_text(TABLE),
    "damage.mcap": lambda path: write_json(
        path, in_steps(HOSTILE, "foxglove.PoseInFrame", [{}, {}])
    ),
}


@pytest.mark.parametrize("name", LOGS)
def test_every_command_prints_what_prints(
    tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]
):
    folder = tmp_path / "\x1b[31m\nwarning: y\u202e"
    folder.mkdir()
    log = folder / name
    LOGS[name](log)
    tune = (log, "-o", folder / "out", "--quiet")
    for main, *words in (
        (logs, "info", log),
        (logs, "info", log, folder / "none.mcap"),
        (logs, "check", log),
        (logs, "recover", log, "-o", folder / "saved.mcap"),
        (logs, "import", log, "-o", folder / "ours.mcap"),
        (logs, "import", log, "-o", folder / "ours.mcap"),
        (tunenet_tune, *tune),
        (tunenet_tune, *tune, "--start", "3"),
        (tunenet_tune, *tune, "--topic", HOSTILE + "?"),
        (tunenet_tune, *tune, "--preview", "--debug", "--topic", HOSTILE + "?"),
    ):
        main([str(one) for one in words])
        lines = "".join(capfd.readouterr()).split("\n")
        assert not [line for line in lines if not line.isprintable()], words
        assert not [line for line in lines if line.startswith("warning")], words
        assert any(r"\x1b[31m\nwarning: y\u202e" in line for line in lines), words


def test_a_hostile_name_is_shown_as_its_escapes(tmp_path: Path, capfd: pytest.CaptureFixture[str]):
    log = str(tmp_path / "a.mcap")
    LOGS["a.mcap"](Path(log))
    assert logs(["info", log]) == 0
    assert SHOWN in capfd.readouterr().out
    assert tunenet_tune([log, "--topic", "nope"]) == 1
    assert f"there is: {SHOWN}" in capfd.readouterr().out


@given(st.text())
def test_one_line_prints_and_leaves_alone_what_prints_already(text: str):
    line = one_line(text)
    assert line.isprintable()
    assert one_line(line) == line
    assert line == text or not text.isprintable()
    assert one_line(Path("a\udcff.mcap")) == r"a\udcff.mcap"
