"""Only training needs PyTorch: without it one line says what to install, before any work."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.engines import needs_pybullet

RUN = """
import sys
from importlib import import_module
sys.modules["torch"] = None
code = import_module(sys.argv[1]).main(sys.argv[2:])
engines = {"pybullet", "mujoco"} & set(sys.modules)
sys.exit(code if code == 0 or not engines else f"simulated with {engines}")
"""


def run(module: str, *words: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    line = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(ROOT)!r})\n{RUN}"]
    return subprocess.run(
        [*line, module, *words], cwd=cwd, capture_output=True, text=True, timeout=120
    )


@pytest.mark.parametrize(
    ("module", "words", "extra"),
    [
        ("tunenet_logs.analysis.cli.train", ("drop",), "train"),
        (
            "tunenet_logs.analysis.cli.train",
            ("payload", "-o", "a.safetensors", "--pairs", "10"),
            "train",
        ),
        ("tunenet_logs.analysis.evaluation.cli", ("drop", "--methods", "tunenet-paper"), "eval"),
        ("tunenet_logs.analysis.evaluation.cli", ("motion",), "eval"),
        ("tunenet_logs.analysis.evaluation.cli", ("payload",), "eval"),
        (
            "tunenet_logs.analysis.evaluation.cli",
            ("bounce-shot", "--sections", "campaigns"),
            "eval",
        ),
    ],
)
def test_training_says_what_to_install(
    module: str, words: tuple[str, ...], extra: str, tmp_path: Path
):
    done = run(module, *words, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert done.stderr.endswith(f": torch is not installed; pip install 'tunenet-logs[{extra}]'\n")
    assert done.stderr.count("\n") == 1
    assert not done.stdout
    assert not list(tmp_path.iterdir())


def test_tuning_does_not_need_it(drop_log: Path, tmp_path: Path):
    tuned = run(
        "tunenet_logs.analysis.cli.tune", str(drop_log), "--method", "tunenet+refine", cwd=tmp_path
    )
    assert tuned.returncode == 0, tuned.stderr
    assert "0.7000" in tuned.stdout


@needs_pybullet
def test_an_experiment_without_a_network_does_not_need_it(tmp_path: Path):
    words = ("drop", "--methods", "secant", "--seeds", "1", "--targets", "2", "--rollouts", "2")
    measured = run("tunenet_logs.analysis.evaluation.cli", *words, cwd=tmp_path)
    assert measured.returncode == 0, measured.stderr
