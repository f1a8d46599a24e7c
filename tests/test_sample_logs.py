"""The samples are what their README says, and tune to their truth."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path

import pytest

from analysis.tuning import Options, tune_log
from tests.conftest import BIN, ROOT

FOLDER = ROOT / "sample_logs"
SAMPLES = sorted(FOLDER.glob("*.mcap"))


def test_there_are_samples():
    assert SAMPLES


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_readme_names_its_checksum(path: Path):
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    rows = (FOLDER / "README.md").read_text().splitlines()
    assert any(path.name in row and digest in row for row in rows)


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.stem)
def test_tunes_to_its_truth(path: Path):
    tuning = tune_log(path, Options())
    assert tuning.verdict == "ok"
    assert tuning.estimate is not None
    assert tuning.episode is not None
    assert abs(tuning.estimate[0] - tuning.episode.info.truth["restitution"]) < 0.003


def test_the_recorder_writes_the_same_bytes_again(tmp_path: Path):
    shutil.copy(FOLDER / "record.sh", tmp_path)
    script = ["sh", str(tmp_path / "record.sh"), str(BIN / "tunenet-record")]
    subprocess.run(script, check=True, capture_output=True, timeout=120)
    for path in SAMPLES:
        assert (tmp_path / path.name).read_bytes() == path.read_bytes()
