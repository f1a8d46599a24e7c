"""tunenet-tune and tunenet-train as a user runs them."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType

import pytest

from tests.conftest import Command
from tunenet_logs.analysis.cli import tune
from tunenet_logs.recorders import cli as recorders_cli


@pytest.mark.parametrize(
    "name", ["logs", "record", "tune", "review", "train", "plan", "eval", "export"]
)
def test_help_shows_examples(process: Command, name: str):
    result = process(f"tunenet-{name}", "--help")
    assert result.returncode == 0
    assert "examples:" in result.stdout
    assert f"  tunenet-{name} " in result.stdout


@pytest.mark.parametrize("words", [["tune", "--help"], ["record", "--help", "microphone"]])
def test_help_says_that_sound_is_tuned(process: Command, words: list[str]):
    said = process(f"tunenet-{words[0]}", *words[1:]).stdout
    assert "tunenet-tune bounce.wav" in " ".join(said.split())


def test_help_names_sound_among_the_logs(process: Command):
    said = process("tunenet-tune", "--help").stdout
    assert "sound to tune from" in " ".join(said.partition("\noptions:")[2].split())


@pytest.mark.parametrize("module", [tune, recorders_cli], ids=["tune", "record"])
def test_help_is_short_and_its_topics_tell_the_rest(module: ModuleType, command: Command):
    """Each option stands in one topic, or in what everybody needs; all of them in all."""
    name = module.build_parser().prog
    said = {topic: command(name, "--help", topic).stdout for topic in (*module.TOPICS, "all")}
    short = command(name, "-h").stdout
    assert short.count("\n") <= 45
    assert all(f"\n  {topic}" in short for topic in module.TOPICS)
    every = set(options_of_help(said.pop("all")))
    of_all = {"--version", "--debug", "--print-completion"}
    shown = options_of_help("\n".join([short, *said.values()]))
    assert sorted(shown) == sorted(every - of_all)
    assert all("examples:" in text for text in said.values())
    wrong = command(name, "--help", "cooking")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr.count("\n") == 1
    assert ", ".join((*module.TOPICS, "all")) in wrong.stderr


def options_of_help(text: str) -> list[str]:
    return re.findall(r"^  (?:-\w(?: \S+)?, )?(--[\w-]+)", text, re.MULTILINE)


def test_tune_prints_a_table_and_says_how_to_look(process: Command, drop_log: Path):
    result = process("tunenet-tune", drop_log)
    assert result.returncode == 0, result.stderr
    assert "0.7000" in result.stdout
    assert f"rerun {drop_log.with_suffix('.rrd')}" in result.stdout
    assert not result.stderr
    assert drop_log.with_suffix(".json").exists()
    assert drop_log.with_suffix(".rrd").exists()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda path: None, "no such file"),
        (lambda path: path.mkdir(), "is a directory"),
        (lambda path: path.write_bytes(b""), "is empty"),
        (lambda path: path.write_text("hello"), "not an MCAP log"),
    ],
    ids=["missing", "directory", "empty", "text"],
)
def test_a_bad_log_is_one_line_and_exit_code_1(command: Command, tmp_path: Path, make, says: str):
    path = tmp_path / "a.mcap"
    make(path)
    result = command("tunenet-tune", path)
    assert result.returncode == 1
    assert not result.stdout
    assert result.stderr.count("\n") == 1
    assert says in result.stderr
    assert str(path) in result.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("--iterations", "0"),
        ("--initial", "1.2"),
        ("--initial", "nan"),
        ("--preset", "best"),
        ("--start", "3", "--end", "2"),
        ("--unknown",),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(command: Command, drop_log: Path, words):
    result = command("tunenet-tune", drop_log, *words)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert not drop_log.with_suffix(".json").exists()


def test_weights_meant_for_another_preset_are_refused(command: Command, drop_log: Path):
    from tunenet_logs.analysis import tunenet

    shipped = Path(tunenet.__path__[0]) / "weights" / "drop-paper.safetensors"
    result = command("tunenet-tune", drop_log, "--weights", shipped)
    assert result.returncode == 1
    assert result.stderr.count("\n") == 1
    assert "preset 'paper', not 'default'" in result.stderr


def test_an_output_that_cannot_be_written_is_one_line(command: Command, drop_log: Path):
    result = command("tunenet-tune", drop_log, "-o", "/proc/nowhere")
    assert result.returncode == 1
    assert "0.7000" in result.stdout
    assert result.stderr.count("\n") == 1
    assert "with -o" in result.stderr


def test_train_writes_weights_that_tune_takes(command: Command, drop_log: Path, tmp_path: Path):
    weights = tmp_path / "w.safetensors"
    words = ("--pairs", 40, "--epochs", 2, "--jobs", 1, "-o", weights)
    result = command("tunenet-train", "drop", *words)
    assert result.returncode == 0, result.stderr
    assert "s in all" in result.stdout
    assert command("tunenet-tune", drop_log, "--weights", weights).returncode == 0
    again = command("tunenet-train", "drop", *words)
    assert again.returncode == 1
    assert "--overwrite" in again.stderr


def test_a_preset_that_a_task_does_not_have_is_one_line(command: Command, tmp_path: Path):
    words = ["--preset", "paper-code", "-o", tmp_path / "w.safetensors"]
    result = command("tunenet-train", "drop-video", *words)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert "default, paper" in result.stderr


def test_plan_prints_shots_from_nothing_but_a_restitution(process: Command, tmp_path: Path):
    result = process("tunenet-plan", "--restitution", 0.6, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "<- best" in result.stdout
    assert not list(tmp_path.iterdir())


def test_verbose_says_where_how_and_how_long_on_standard_error(command: Command, drop_log: Path):
    done = command("tunenet-tune", "-v", str(drop_log), cwd=drop_log.parent)
    quiet = command("tunenet-tune", str(drop_log), cwd=drop_log.parent)
    assert not quiet.stderr
    said = done.stderr
    for words in (
        "Python 3.",
        "drop in /ball/pose",
        "impact ",
        "rollouts in",
        "total ",
        "passed: ",
    ):
        assert words in said
    assert done.stdout.split()[:3] == quiet.stdout.split()[:3]
