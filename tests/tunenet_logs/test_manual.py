"""The documents in the terminal: the list, a page, and what is found first for a question."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tunenet_logs.manual import main

UMBRELLA = Path(sys.executable).with_name("tunenet")


@pytest.mark.parametrize(
    ("question", "page"),
    [
        ("recover a truncated MCAP file", "logs"),
        ("coefficient of restitution to solref in MuJoCo", "physics"),
        ("identify frictionloss armature damping of a real motor", "actuators"),
        ("joint torques with or without gravity compensation", "live-joints"),
        ("what does restitution_coefficient mean in Gazebo", "engines"),
        ("payload of a UR5e wrong by several newtons", "payload"),
        ("frame rate drops in low light", "camera"),
        ("MJPEG stream latency timestamps", "camera"),
        ("beside lerobot and its rerun version", "install"),
        ("tune many logs on a cluster", "scale"),
        ("csv columns", "formats"),
    ],
)
def test_the_first_page_that_is_found_answers(question: str, page: str, capsys):
    assert main(question.split()) == 0
    assert capsys.readouterr().out.startswith(f"{page}: ")


def test_the_list_has_every_page_and_a_page_is_shown_as_it_is(capsys):
    assert main([]) == 0
    pages = {line.split()[0] for line in capsys.readouterr().out.splitlines()}
    assert pages == {path.stem for path in (ROOT / "docs").glob("*.md")}
    assert main(["camera.md"]) == 0
    assert capsys.readouterr().out == (ROOT / "docs" / "camera.md").read_text()


def test_what_no_page_says_is_told(capsys):
    assert main(["xyzzy"]) == 1
    assert "nothing is said of xyzzy" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["docs", "camera"], 0, "# Filming"),
        (["tune", "none.mcap"], 1, "tunenet-tune: none.mcap: no such file"),
        (["tunes"], 2, "did you mean tune?"),
        (["--help"], 0, "tunenet tune drop.mcap"),
    ],
)
def test_every_command_is_a_word_after_tunenet(words: list[str], code: int, said: str):
    result = subprocess.run([UMBRELLA, *words], capture_output=True, text=True)
    assert result.returncode == code
    assert said in result.stdout + result.stderr
