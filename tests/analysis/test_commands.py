"""The commands of the analysis as a user runs them: help, results, `--json`, and refusals."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.analysis.records import drop_record
from tests.conftest import COMMANDS, ROOT, Command
from tests.engines import HAS_PYBULLET, needs_pybullet
from tests.tunenet_logs.test_info_and_check import strict
from tunenet_logs.analysis.cli import tune
from tunenet_logs.analysis.record import to_json
from tunenet_logs.errors import pip_install
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders import cli as recorders_cli
from tunenet_logs.recorders.simulators.known import ENGINE_VARIABLE, engine


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_examples(command: Command, name: str):
    result = command(name, "--help")
    assert result.returncode == 0
    assert re.search(rf"\nexamples:.*\n  {name} ", result.stdout, re.DOTALL)


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


def options_of_help(text: str) -> list[str]:
    return re.findall(r"^  (?:-\w(?: \S+)?, )?(--[\w-]+)", text, re.MULTILINE)


def test_tune_prints_a_table_and_says_how_to_look(command: Command, drop_log: Path):
    result = command("tunenet-tune", drop_log)
    assert result.returncode == 0, result.stderr
    assert "0.7000" in result.stdout
    assert f"rerun {drop_log.with_suffix('.rrd')}" in result.stdout
    assert not result.stderr
    assert drop_log.with_suffix(".json").exists()
    assert drop_log.with_suffix(".rrd").exists()
    said = command("tunenet-tune", "-v", drop_log).stderr
    told = ("Python 3.", "drop in /ball/pose", "impact ", "rollouts in", "total ", "passed: ")
    assert all(words in said for words in told)


def test_an_output_that_cannot_be_written_is_one_line_and_the_result_is_shown(
    command: Command, drop_log: Path
):
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


def kept(log: Path) -> dict[str, Any]:
    """What NAME.json beside a log holds, but the curves."""
    fields = json.loads(log.with_suffix(".json").read_text())
    del fields["curves"]
    return fields


def test_json_of_one_log_is_what_its_file_holds(process: Command, drop_log: Path):
    """In a process of its own: libraries that print would show here."""
    result = process("tunenet-tune", drop_log, "--json", "-")
    assert (result.returncode, result.stderr) == (0, "")
    [found] = strict(result.stdout)
    own = {key: found.pop(key) for key in ("path", "json", "rrd", "error")}
    assert own == {
        "path": str(drop_log),
        "json": str(drop_log.with_suffix(".json")),
        "rrd": str(drop_log.with_suffix(".rrd")),
        "error": None,
    }
    assert found == kept(drop_log)
    assert found["parameters"]["restitution"]["value"] == pytest.approx(0.7, abs=1e-3)
    assert drop_log.with_suffix(".rrd").stat().st_size > 0


def test_json_has_a_line_for_each_log_be_it_readable_or_not(
    command: Command, drop_log: Path, tmp_path: Path
):
    hostile = tmp_path / os.fsdecode(b"\xff\x1b[31m\n.mcap")
    hostile.write_text("no log")
    logs = [drop_log, hostile, tmp_path / "none.mcap"]
    words = ["-o", tmp_path / "out", "--no-review", "--jobs", 1, "--json"]
    result = command("tunenet-tune", *logs, *words, "-")
    assert result.returncode == 1
    assert result.stdout.isascii()
    found = strict(result.stdout)
    assert [os.fsencode(one["path"]) for one in found] == [os.fsencode(log) for log in logs]
    assert [one["verdict"] for one in found] == ["ok", "rejected", "rejected"]
    assert [set(one) for one in found] == [set(found[0])] * 3
    assert found[0]["rrd"] is None
    assert found[2]["json"] is None
    assert all(one["json"] is None or Path(one["json"]).is_file() for one in found)
    for _ in range(2):  # a file replaces its own, and the table stays
        result = command("tunenet-tune", drop_log, *words, tmp_path / "all.json")
        assert result.returncode == 0
        assert "restitution" in result.stdout
    [found] = strict((tmp_path / "all.json").read_text())
    assert found["verdict"] == "ok"


def test_json_of_a_plan_and_an_experiment(command: Command, tmp_path: Path):
    words = ["--restitution", 0.7, "--shots", 20, "--json"]
    [found] = strict(command("tunenet-plan", *words, "-").stdout)
    command("tunenet-plan", *words, tmp_path / "plan.json")
    in_file = json.loads((tmp_path / "plan.json").read_text())
    assert found | {"seconds": 0} == in_file | {"seconds": 0}
    words = ["--seeds", 1, "--targets", 2, "--jobs", 1, "--quiet", "--json", "-"]
    [found] = strict(command("tunenet-eval", "intervals", *words).stdout)
    assert found


@pytest.mark.parametrize("name", [pytest.param("pybullet", marks=needs_pybullet), "mujoco"])
def test_what_simulates_is_printed_and_recorded(command: Command, tmp_path: Path, name: str):
    version, log = engine(name).name, tmp_path / "a.mcap"
    words = ("--simulate", "drop", "--restitution", 0.7, "--height", 1, "--engine", name)
    made = command("tunenet-record", *words, "-o", log)
    assert made.returncode == 0, made.stderr
    assert f"by {version}; " in made.stdout
    assert read_episode(log).info.source == version
    tuned = command("tunenet-tune", log, "--engine", name, "--quiet")
    assert tuned.returncode == 0, tuned.stderr
    assert f"\nsimulated by {version}\n" in tuned.stdout
    found = kept(log)
    assert found["simulator"]["engine"] == found["provenance"]["engine"] == version
    assert found["parameters"]["restitution"]["value"] == pytest.approx(0.7, abs=1e-4)
    plan = command("tunenet-plan", log.with_suffix(".json"), "--engine", name)
    assert f"in {version} it " in plan.stdout
    for kind in ("payload", "bounce-shot"):
        words = ("--simulate", kind, "--engine", name, "-o", tmp_path / f"{kind}.mcap")
        assert command("tunenet-record", *words).returncode == 0
        assert read_episode(tmp_path / f"{kind}.mcap").info.source.startswith(version)


def test_workers_take_the_engine_of_the_command(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """The paper's simulator is PyBullet's: a worker that refuses it is one of MuJoCo."""
    monkeypatch.delenv(ENGINE_VARIABLE, raising=False)
    weights = tmp_path / "a.safetensors"
    words = ("drop", "--preset", "paper", "--pairs", 10, "--epochs", 1, "-o", weights)
    refused = command("tunenet-train", *words, "--jobs", 2, "--engine", "mujoco", "--quiet")
    assert refused.returncode == 2
    assert refused.stderr == (
        "tunenet-train: the preset paper is PyBullet's own behaviour, not MuJoCo's; take "
        "--engine pybullet, or --preset default\n"
    )
    assert not weights.exists()


WITHOUT_TORCH = """
import io, json, sys
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
sys.modules["torch"] = None
told = []
for module, *words in json.loads(sys.argv[1]):
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = import_module(f"tunenet_logs.analysis.{module}").main(words)
    engines = sorted({"pybullet", "mujoco"} & set(sys.modules))
    told.append([code, out.getvalue(), err.getvalue(), engines])
print(json.dumps(told))
"""


def test_only_training_needs_torch_and_says_what_to_install_before_any_work(
    drop_log: Path, tmp_path: Path
):
    needing = [
        ("cli.train drop", "train"),
        ("cli.train payload -o a.safetensors --pairs 10", "train"),
        ("evaluation.cli drop --methods tunenet-paper", "eval"),
        ("evaluation.cli motion", "eval"),
        ("evaluation.cli payload", "eval"),
        ("evaluation.cli bounce-shot --sections campaigns", "eval"),
    ]
    others = [f"cli.tune {drop_log} --method tunenet+refine --no-review"]
    if HAS_PYBULLET:
        words = "--methods secant --seeds 1 --targets 2 --rollouts 2"
        others.append(f"evaluation.cli drop {words}")
    lines = [line.split() for line in (*(line for line, _ in needing), *others)]
    (tmp_path / "empty").mkdir()
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_TORCH, json.dumps(lines)],
        cwd=tmp_path / "empty",
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    for (_, extra), (code, out, err, engines) in zip(needing, told, strict=False):
        assert (code, out, engines) == (2, "", [])
        assert err.count("\n") == 1
        assert err.endswith(f": torch is not installed; {pip_install(extra)}\n")
    assert not list((tmp_path / "empty").iterdir())
    assert [code for code, *_ in told[len(needing) :]] == [0] * len(others), told[len(needing) :]
    assert "0.7000" in told[len(needing)][1]


@pytest.mark.parametrize(
    ("name", "option"), [("tunenet-report", "-o"), ("tunenet-compare", "--html")]
)
def test_without_matplotlib_one_line_names_its_extra(
    tmp_path: Path, command: Command, monkeypatch: pytest.MonkeyPatch, name: str, option: str
):
    (tmp_path / "red.json").write_text(to_json(drop_record(0.7)))
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    done = command(name, tmp_path / "red.json", option, tmp_path / "a.html")
    assert done.returncode == 2
    assert pip_install("report") in done.stderr
    assert done.stderr.count("\n") == 1
