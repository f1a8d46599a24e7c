"""The examples run as they stand there, and say what is true of their logs."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pandas as pd
import pytest

from tests.docs.stand_ins import SAMPLES
from tests.wheel import ROOT

EXAMPLES = ROOT / "docs" / "examples"


def run(name: str, *arguments: object, cwd: Path) -> str:
    words = [sys.executable, str(EXAMPLES / name), *map(str, arguments)]
    done = subprocess.run(words, cwd=cwd, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_drop_is_simulated_and_tuned(tmp_path: Path):
    said = run("drop.py", cwd=tmp_path)
    assert said.startswith("ok")
    speed, bounce = map(float, re.findall(r"^([\d.]+) m/s: ([\d.]+)$", said, re.MULTILINE)[0])
    assert speed == pytest.approx((2 * 9.80665 * 1.2) ** 0.5, rel=0.01)
    assert bounce == pytest.approx(0.75, abs=0.001)
    assert "failed" not in said


def test_a_folder_becomes_a_table(tmp_path: Path):
    said = run("folder.py", SAMPLES / "campaign", "table.csv", cwd=tmp_path)
    table = pd.read_csv(tmp_path / "table.csv")
    values = {
        Path(log).stem: value for log, value in zip(table["log"], table["restitution"], strict=True)
    }
    assert values["drop_2"] == pytest.approx(0.741, abs=0.001)
    assert values["drop_5"] == pytest.approx(0.786, abs=0.001)
    assert len(re.findall(r"drop_(?:3a|6)\.mcap  rejected  ", said)) == 2
    assert len(table) == 7


def test_the_tuned_ball_rebounds_so_in_another_engine(tmp_path: Path):
    said = run("own_engine.py", SAMPLES / "bouncy.mcap", cwd=tmp_path)
    tuned, stepped = (float(one) for one in re.findall(r"(?:tuned|stepped) ([\d.]+)", said))
    assert tuned == pytest.approx(0.85, abs=0.001)
    assert stepped == pytest.approx(0.85, abs=0.003)


def test_each_is_short_and_in_the_documents():
    text = (ROOT / "docs" / "examples.md").read_text()
    for path in EXAMPLES.glob("*.py"):
        assert f"examples/{path.name})" in text
        assert len(path.read_text().splitlines()) < 40
