"""What `tunenet-record` says to options that do not go together, and to cameras that are not."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.conftest import Command
from tunenet_logs.console import Parser


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--camera", "a.mp4", "--simulate", "drop"], "--simulate"),
        ([], "--camera"),
        (["--camera", "a.mp4", "--restitution", "0.5"], "--restitution"),
        (["--camera", "a.mp4", "--seed", "0"], "--seed"),
        (["--camera", "--hold", "0"], "--hold"),
        (["--simulate", "drop", "--fps", "60"], "--fps"),
        (["--simulate", "drop", "--ball", "red"], "--ball"),
        (["--simulate", "drop", "--drop-height", "1"], "--drop-height"),
        (["--camera", "a.mp4", "--exposure", "4"], "--exposure"),
        (["--camera", "http://127.0.0.1/", "--size", "640x480"], "--size"),
        (["--camera", "a.mp4", "--rate", "60"], "--rate"),
        (["--camera", "0", "--fps", "60"], "--fps"),
        (["--camera", "http://127.0.0.1/", "--fps", "60"], "--fps"),
        (["--camera", "a.mp4", "--size", "0x9"], "'0x9'"),
        (["--camera", "a.mp4", "--size", "big"], "'big'"),
        (["--camera", "a.mp4", "--ball-diameter", "-1"], "'-1'"),
        (["--camera", "a.mp4", "--ball-mass", "nan"], "'nan'"),
        (["--camera", "a.mp4", "--ball", "basketball", "--ball-mass", "0.001"], "lighter than"),
        (["--camera", "a.mp4", "--stall", "0"], "'0'"),
        (["--camera", "a.mp4", "--seconds", "inf"], "'inf'"),
        (["--camera", "a.mp4", "--ball", "a\nb"], "--ball"),
        (["--camera", "a.mp4", "--fps", "1e9"], "--fps"),
    ],
)
def test_what_does_not_go_together_is_one_line_that_names_it(
    command: Command, tmp_path: Path, words: list[str], names: str
):
    result = command("tunenet-record", *words, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert names in result.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("source", ["97", "/dev/video97", "/dev/null"])
def test_a_device_that_is_none_is_one_line_that_names_those_there_are(
    command: Command, tmp_path: Path, source: str
):
    result = command("tunenet-record", "--camera", source, cwd=tmp_path)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "/dev/video" in result.stderr
    assert source in result.stderr
    assert not list(tmp_path.iterdir())


def test_the_first_camera_is_meant_when_none_is_named():
    from tunenet_logs.recorders.cli import build_parser

    parser: Parser = build_parser()
    assert parser.parse_args(["--camera"]).camera == "0"
    assert parser.parse_args(["--camera", "-o", "a.mcap"]).camera == "0"
