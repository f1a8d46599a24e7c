"""Texts of others on a terminal: nothing but characters that print, whatever a log holds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.strangers import Stranger, write_poses, write_poses_bag, write_texts
from tunenet_logs.analysis.cli.tune import main as tunenet_tune
from tunenet_logs.cli import main as logs
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.terminal import listed, one_line, short_name
from tunenet_logs.writing.writer import EpisodeWriter

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
    "type.mcap": lambda path: write_texts(path, f"pkg/msg/{HOSTILE}", [{}], topic=HOSTILE),
    "notes.mcap": lambda path: EpisodeWriter(path, INFO, live=False).close(),
    "a.csv": lambda path: path.write_text(TABLE),
    "damage.mcap": lambda path: write_texts(path, "foxglove.PoseInFrame", [{}, {}], topic=HOSTILE),
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


@pytest.mark.parametrize("length", [1, 59, 60, 61, 241, 5000])
def test_long_names_keep_their_ends_and_of_many_the_first_are_listed(length: int):
    name = "/a" + "b" * (length - 3) + "/z" if length > 3 else "/"
    short = short_name(name)
    assert len(short) == min(len(name), 60)
    assert (short[0], short[-1]) == (name[0], name[-1])
    assert ("…" in short) == (len(name) > 60)
    assert (listed(["a", "b"]), listed([])) == ("a, b", "")
    assert listed(str(one) for one in range(500)).endswith("18, 19 and 480 more")
