"""The samples are what their README says, and tune to their truth."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.conftest import BIN, ROOT, Command
from tests.engines import needs_pybullet
from tests.same_log import assert_same_log
from tunenet_logs.analysis.campaign import campaign_of, overall_rates
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.terminal import Progress

FOLDER = ROOT / "sample_logs"
SAMPLES = sorted(FOLDER.glob("*.mcap"))
CAMPAIGN = sorted((FOLDER / "campaign").glob("*.mcap"))
DROPS = [path for path in SAMPLES if not path.name.startswith("payload")]


def test_there_are_samples():
    assert SAMPLES


def test_the_readme_names_every_checksum():
    rows = (FOLDER / "README.md").read_text().splitlines()
    others = []
    for path in (*SAMPLES, *CAMPAIGN):
        digest = hashlib.sha256(path.read_bytes()).hexdigest()
        if not any(path.name in row and digest in row for row in rows):
            others.append(f"{path.relative_to(FOLDER)}: {digest}")
    assert not others, "\n".join(others)


@pytest.mark.parametrize("path", DROPS, ids=lambda path: path.stem)
def test_tunes_to_its_truth(path: Path):
    tuning = tune_log(path, TuneOptions())
    assert tuning.verdict == "ok"
    assert tuning.estimate is not None
    assert tuning.episode is not None
    assert abs(tuning.estimate[0] - tuning.episode.info.truth["restitution"]) < 0.003


def test_the_payload_is_weighed_with_its_tare():
    selection = TuneOptions(tares=(FOLDER / "payload_empty.mcap",))
    tuning = tune_log(FOLDER / "payload.mcap", selection)
    assert tuning.verdict == "ok"
    assert tuning.estimate is not None
    assert tuning.interval95 is not None
    assert abs(tuning.estimate[0] - 0.8) < 0.025
    low, high = tuning.interval95[0]
    assert low < 0.8 < high


@needs_pybullet
@pytest.mark.parametrize("name", ["dull", "noisy"])
def test_the_recorder_writes_a_drop_of_the_samples_again(
    command: Command, tmp_path: Path, name: str
):
    script = (FOLDER / "record.sh").read_text().splitlines()
    (line,) = [one for one in script if f"/{name}.mcap" in one]
    words = line.replace("$here", str(tmp_path)).replace('"', "").split()
    assert command("tunenet-record", *words[1:]).returncode == 0
    assert_same_log(tmp_path / f"{name}.mcap", FOLDER / f"{name}.mcap")


@pytest.mark.slow
@pytest.mark.parametrize("folder", [FOLDER, FOLDER / "campaign"], ids=lambda one: one.name)
def test_the_recorder_writes_all_again(tmp_path: Path, folder: Path):
    shutil.copy(folder / "record.sh", tmp_path)
    script = ["sh", str(tmp_path / "record.sh"), str(BIN / "tunenet-record")]
    subprocess.run(script, check=True, capture_output=True, timeout=120)
    kept = sorted(folder.glob("*.mcap"))
    assert sorted(one.name for one in tmp_path.glob("*.mcap")) == [one.name for one in kept]
    for path in kept:
        assert_same_log(tmp_path / path.name, path)


def test_the_campaign_is_small_and_tells_what_happened():
    assert sum(path.stat().st_size for path in CAMPAIGN) < 1_500_000
    attempts = campaign_of([FOLDER / "campaign"], 2, Progress(quiet=True), pytest.fail).attempts
    assert [one.ball for one in attempts] == ["red gel", "racquetball"] * 3
    assert [len(one.drops) for one in attempts] == [1, 1, 2, 1, 1, 1]
    every, accepted, rejected = overall_rates(attempts)
    assert (every.successes, every.count) == (4, 6)
    assert (accepted.successes, accepted.count) == (4, 5)
    assert (rejected.successes, rejected.count) == (0, 1)
    truths = [0.789, 0.741, 0.793, 0.738, 0.786]
    assert [one.value for one in attempts[:5]] == pytest.approx(truths, abs=0.003)
