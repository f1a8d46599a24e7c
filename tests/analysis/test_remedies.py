"""Every rejection ends with what to do: of strangers' files, faulty tracks and made logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import real
from tests.hostile import HOSTILE
from tests.remedies import has_remedy
from tunenet_logs.analysis.drop.film import find_filmed_drop
from tunenet_logs.analysis.evaluation.worlds.camera import (
    FAULT_BALLS,
    FAULT_SET,
    TRACK_FAULTS,
    TrackFault,
    draw_scene,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.errors import NotFoundError

# Characters of a reason: two wide lines of a terminal, with names of topics in them.
_MAX_LENGTH = 350
ROOT = Path(__file__).parents[2]

FALL = {
    "still": np.zeros_like,
    "falls_on": lambda t: 1.0 - 9.81 * t**2 / 2,
    "stays": lambda t: np.maximum(1.0 - 9.81 * t**2 / 2, 0.0),
    "carried": lambda t: 1.0 - 0.3 * t,
    "swings": lambda t: np.cos(2 * np.pi * t),
    "noise": lambda t: np.random.default_rng(1).normal(size=len(t)),
    "gap": lambda t: np.where(t < 0.3, 1.0 - 9.81 * t**2 / 2, np.nan),
    "slow_fall": lambda t: np.maximum(1.0 - 0.5 * t**2, 0.0),
}


@pytest.mark.parametrize("name", FALL)
@pytest.mark.parametrize("count", [5, 300])
def test_a_track_that_is_no_drop(name: str, count: int, tmp_path: Path) -> None:
    seconds = np.linspace(0, 2, count)
    rows = zip(seconds, FALL[name](seconds), strict=True)
    log = tmp_path / "track.csv"
    log.write_text("t,z\n" + "".join(f"{t:.5f},{z:.6f}\n" for t, z in rows))
    _check(log)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "hello",
        "t\n1\n2\n",
        "a,b\n1,2\n3,4\n",
        "times\n1\n2\n",
        "times\n3\n1\n2\n",
        "times\n1\n2\n3\n4\n5\n6\n",
        "t,z\nx,y\nx,y\n",
        "t,z\n0,1\n",
        '{"a": 1}',
        "\x00\x01\x02" * 50,
    ],
)
def test_a_file_that_is_no_log(text: str, tmp_path: Path) -> None:
    for ending in (".csv", ".mcap", ".bag", ".mp4", ".json"):
        (tmp_path / f"log{ending}").write_text(text)
        _check(tmp_path / f"log{ending}")


@pytest.mark.parametrize(
    "name",
    ["zstd_of_4_gib", "many_small_bombs", "chunk_in_chunk", "huge_length", "huge_sequence",
     "nested_json", "forged_jpeg", "blank_pictures", "nested_metadata"],
)  # fmt: skip
def test_a_hostile_file(name: str, tmp_path: Path) -> None:
    _check(HOSTILE[name].write(tmp_path))


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    _check(tmp_path / "none.mcap")
    _check(tmp_path)


@pytest.mark.parametrize(
    "selection",
    [
        TuneOptions(topic="/nowhere"),
        TuneOptions(start_s=1e6),
        TuneOptions(start_s=0.0, end_s=0.05),
    ],
)
@pytest.mark.parametrize("name", ["dull", "filmed", "payload"])
def test_a_part_of_a_log_in_which_there_is_nothing(name: str, selection: TuneOptions) -> None:
    _check(ROOT / "sample_logs" / f"{name}.mcap", selection)


@pytest.mark.parametrize("task", ["drop", "payload"])
@pytest.mark.parametrize("fraction", [0.02, 0.3, 0.7])
@pytest.mark.parametrize("name", ["dull", "filmed", "payload"])
def test_a_log_that_is_cut_or_of_another_task(
    name: str, fraction: float, task: str, tmp_path: Path
) -> None:
    whole = (ROOT / "sample_logs" / f"{name}.mcap").read_bytes()
    log = tmp_path / "cut.mcap"
    log.write_bytes(whole[: int(fraction * len(whole))])
    _check(log, TuneOptions(task=task), must_be_rejected=False)


@pytest.mark.parametrize("fault", TRACK_FAULTS, ids=lambda fault: fault.name)
def test_a_faulty_track(fault: TrackFault) -> None:
    reasons: list[str] = []
    for number in range(3):
        track = fault.track(draw_scene(FAULT_SET, FAULT_BALLS, 0.3, 7, number))
        try:
            find_filmed_drop(track, int(track.stamps_ns[0]), None)
        except NotFoundError as error:
            reasons.append(str(error))
    assert all(map(has_remedy, reasons)), reasons


@pytest.mark.parametrize(
    ("folder", "names"),
    [
        pytest.param("negatives", "*.mp4", marks=pytest.mark.slow),
        ("labs", "*"),
        ("ros1", "*.bag"),
        ("mcap_rosbag2", "*.mcap"),
        ("mcap_conformance", "On*sum*"),
    ],
)
def test_real_files(folder: str, names: str) -> None:
    files = sorted(real(folder).glob(names))
    assert files
    for log in files[:12]:
        _check(log, must_be_rejected=False)


def _check(log: Path, options: TuneOptions | None = None, *, must_be_rejected: bool = True) -> None:
    tuning = tune_log(log, options or TuneOptions())
    assert not must_be_rejected or tuning.verdict == "rejected"
    if tuning.verdict == "rejected":
        assert tuning.reason is not None
        assert has_remedy(tuning.reason), f"{log.name}: {tuning.reason}"
        assert "\n" not in tuning.reason
        assert len(tuning.reason) <= _MAX_LENGTH, f"{log.name}: {tuning.reason}"
