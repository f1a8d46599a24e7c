"""Episodes of a LeRobot data set in one fit, as the set lies there, and one held out."""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import tunenet_logs as tn
from tests.analysis.review.stored import reviewed
from tests.conftest import Command
from tunenet_logs.analysis.evaluation.worlds.servos import MODEL, NAME, Servo
from tunenet_logs.errors import UsageError

pytestmark = pytest.mark.skipif(find_spec("pyarrow") is None, reason="pyarrow is missing")

TRUTH = {
    f"actuator/{NAME}.kp": 2.5,
    f"joint/{NAME}.damping": 0.05,
    f"joint/{NAME}.frictionloss": 0.03,
}
RATE_HZ, LENGTH_S, EPISODES = 50, 3.0, 4
OPENPI = "state", "actions"


def rows_of(servo: Servo) -> Iterator[pd.DataFrame]:
    """Each episode's rows, as LeRobot writes them: degrees, of 24 bits."""
    frames = np.arange(int(LENGTH_S * RATE_HZ))
    for number in range(EPISODES):
        rng = np.random.default_rng(number)
        seconds = frames / RATE_HZ
        asked = np.where(
            seconds % 1.5 < 0.8,
            rng.uniform(0.5, 1.0) * np.sin(2 * np.pi * rng.uniform(0.7, 1.5) * seconds),
            np.repeat(rng.uniform(-0.8, 0.8, 6), 25),
        )
        seen = np.round(np.degrees(servo.moved(seconds, seconds, asked)) * 4096 / 360) * 360 / 4096
        yield pd.DataFrame(
            {
                "observation.state": [np.array([one], np.float32) for one in seen],
                "action": [np.array([np.degrees(one)], np.float32) for one in asked],
                "timestamp": seconds.astype(np.float32),
                "frame_index": frames,
                "episode_index": np.full(len(frames), number),
            }
        )


def written(folder: Path, version: int, servo: Servo) -> Path:
    chunk = folder / "set" / "data" / "chunk-000"
    chunk.mkdir(parents=True)
    rows, names = list(rows_of(servo)), ("observation.state", "action")
    if version == 2:  # with the names of openpi's sets
        rows = [one.rename(columns=dict(zip(names, OPENPI, strict=True))) for one in rows]
        names = OPENPI
    if version == 3:
        pd.concat(rows).to_parquet(chunk / "file-000.parquet")
    for number, one in enumerate(rows if version == 2 else ()):
        one.to_parquet(chunk / f"episode_{number:06d}.parquet")
    features = {one: {"names": [f"{NAME}.pos"]} for one in names}
    (folder / "set" / "meta").mkdir()
    info = {"fps": RATE_HZ, "robot_type": "made", "features": features}
    (folder / "set" / "meta" / "info.json").write_text(json.dumps(info))
    (folder / "servo.xml").write_text(MODEL)
    return folder / "set"


@pytest.mark.parametrize("version", [2, 3])
def test_episodes_are_runs_of_one_machine(version: int, command: Command, tmp_path: Path):
    written(tmp_path, version, Servo(2.5, 0.05, 0.002, 0.03))
    words = ["set", "--model", "servo.xml", *(f"--tune={name}" for name in TRUTH)]
    words += ["--angle-unit", "deg", "--together", "--hold-out", "episode:2", "-o", "out"]
    plan = command("tunenet-tune", *words, "--dry-run", cwd=tmp_path)
    assert "together with episode1, episode3, " in plan.stdout
    assert "held out: episode2, " in plan.stdout
    assert not (tmp_path / "out").exists()
    result = command("tunenet-tune", *words, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    told = json.loads((tmp_path / "out" / "set.json").read_text())
    assert told["verdict"] == "ok", told["reason"]
    for name, value in TRUTH.items():
        assert told["parameters"][name]["value"] == pytest.approx(value, rel=0.02), name
    gaps = {one["motion"]: one for one in told["gaps"]}
    assert list(gaps) == ["episode0", "episode1", "episode3", "episode2"]
    assert [one["is_held_out"] for one in gaps.values()] == [False, False, False, True]
    for one in gaps.values():
        assert one["rms"][1] < 0.2 * one["rms"][0]
        assert one["left"] < 0.02
    assert "episode2 position servo [rad], held out" in result.stdout
    assert told["provenance"]["options"]["hold_out"] == {"run": "episode:2"}
    assert len(told["provenance"]["log_sha256"]) == 64


@pytest.fixture(scope="module")
def data_set(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return written(
        tmp_path_factory.mktemp("other"), 3, Servo(2.5, 0.05, 0.002, 0.03, commands=0.02)
    )


def tuned(data_set: Path, *, together: tuple[Path, ...] | None, hold_out: str) -> tn.Tuning:
    return tn.tune(
        data_set,
        model=data_set.parent / "servo.xml",
        parameters=list(TRUTH),
        angle_unit="deg",
        together=together,
        hold_out=Path(hold_out),
    )


def test_a_run_that_is_held_out_is_drawn_and_its_delay_named(data_set: Path, tmp_path: Path):
    tuning = tuned(data_set, together=None, hold_out="episode:1")  # by the first alone
    assert tuning.verdict != "ok"  # of 20 ms that nobody tuned
    (fitted, held) = tuning.record.gaps
    assert (fitted.motion, held.motion) == ("", "episode1")
    assert held.delay_s is not None
    assert held.delay_s[0] == pytest.approx(0.02, abs=0.01)
    views = {view.name for view in reviewed(tuning, tmp_path).views}
    assert any("predicted" in name for name in views), views


def test_runs_that_are_not_there(data_set: Path):
    with pytest.raises(UsageError, match=r"no episode:7 .* there is: episode0, episode1, "):
        tuned(data_set, together=(), hold_out="episode:7")
