"""Folders that hold pipes, circles of links and depths: a line for each, and no waiting."""

from __future__ import annotations

import os
from contextlib import chdir
from pathlib import Path

import pytest

from tests.conftest import Command
from tunenet_logs.analysis.campaign import material_of
from tunenet_logs.errors import LogError
from tunenet_logs.writing.owned_path import OutputPlace, nothing

SUFFIXES = (".mcap", ".json", ".csv", ".mp4")


def pipes(folder: Path) -> Path:
    for suffix in SUFFIXES:
        os.mkfifo(folder / f"a{suffix}")
    return folder


def circles(folder: Path) -> Path:
    for suffix in SUFFIXES:
        (folder / f"a{suffix}").symlink_to(f"b{suffix}")
        (folder / f"b{suffix}").symlink_to(f"a{suffix}")
    (folder / "self").symlink_to(".")
    return folder


@pytest.mark.parametrize("fill", [pipes, circles])
def test_they_are_left_out_of_a_campaign(command: Command, tmp_path: Path, drop_log: Path, fill):
    fill(tmp_path)
    result = command("tunenet-review", tmp_path, "-o", tmp_path / "all.rrd", "--quiet")
    assert result.returncode == 0, result.stderr
    for suffix in SUFFIXES:
        assert f"{tmp_path}/a{suffix}: is no regular file; it is left out" in result.stderr
    assert drop_log.with_name("all.rrd").exists()


@pytest.mark.parametrize("fill", [pipes, circles])
@pytest.mark.parametrize(
    "words",
    [
        "tunenet-review a.mcap -o x.rrd",
        "tunenet-tune a.mcap",
        "tunenet-tune a.mcap a.csv -o out",
        "tunenet-tune drop.mcap --tare a.mcap -o out",
        "tunenet-tune drop.mcap --weights a.json -o out",
        "tunenet-plan a.json",
        "tunenet-plan --restitution 0.7 --rig a.json",
        "tunenet-record --camera a.mp4",
        "tunenet-record --outcome success --ball x --tuning a.json",
        "tunenet-logs info a.csv",
        "tunenet-logs check a.mp4",
        "tunenet-logs import a.csv",
        "tunenet-logs recover a.mcap -o x.mcap",
    ],
)
def test_named_they_are_told(command: Command, tmp_path: Path, drop_log: Path, fill, words: str):
    fill(tmp_path)
    result = command(*words.split(), cwd=tmp_path)
    assert drop_log.exists()
    if "--tare" not in words:  # which a drop has no use for
        assert result.returncode in (1, 2), result.stdout
    assert "Traceback" not in result.stderr


def test_a_folder_may_be_deeper_than_python_calls(tmp_path: Path):
    depth = 1500
    with chdir(tmp_path):
        for _ in range(depth):
            Path("d").mkdir()
            os.chdir("d")
        try:
            with pytest.raises(LogError, match="holds no drop"):
                material_of([tmp_path], lambda _text: None)
        finally:  # pytest could not take it away
            for _ in range(depth):
                os.chdir("..")
                Path("d").rmdir()


def test_a_folder_of_folders_has_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("tunenet_logs.analysis.campaign._MAX_ENTRIES", 50)
    for number in range(60):
        (tmp_path / str(number)).mkdir()
    told: list[str] = []
    with pytest.raises(LogError, match="holds no drop"):
        material_of([tmp_path], told.append)
    assert told == [f"{tmp_path}: holds over 50 files and folders; those beyond are left out"]


@pytest.mark.parametrize("make", [os.mkfifo, Path.mkdir, Path.touch])
def test_what_lies_where_a_result_is_written_first_stays(tmp_path: Path, make):
    place = OutputPlace(tmp_path / "a.json", "result", nothing)
    scratch = tmp_path / f"a.json.{os.getpid()}.partial"
    make(scratch)
    before = scratch.lstat()
    place.check()
    with place.replacing() as unfinished:
        unfinished.write_text("whole")
    assert place.path.read_text() == "whole"
    assert scratch.lstat() == before
    assert len(list(tmp_path.iterdir())) == 2
