"""Training data is the same bits whoever makes it, and however it is cut."""

import hashlib
import os
import signal
from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Command
from tunenet_logs.analysis.drop.presets import TRAININGS as DROPS
from tunenet_logs.analysis.experiment import Training
from tunenet_logs.analysis.parallel import HERE, Cluster
from tunenet_logs.analysis.payload.detection import TRAININGS as PAYLOADS
from tunenet_logs.analysis.tunenet import network as pairs
from tunenet_logs.analysis.tunenet.network import Workers, observe_all
from tunenet_logs.episode import Array
from tunenet_logs.errors import TuneNetError
from tunenet_logs.terminal import Progress

QUIET = Progress(quiet=True)
PRESETS = {
    "drop default": DROPS["default"],
    "drop paper-code": DROPS["paper-code"],
    "payload default": PAYLOADS["default"],
    "payload paper": PAYLOADS["paper"],
}
_FEW, _SEED = 60, 3


def _made(preset: Training, workers: Workers) -> Array:
    return preset.make_pairs(_FEW, _SEED, workers, QUIET).observations


@pytest.mark.parametrize("name", PRESETS)
def test_processes_make_the_bits_that_one_makes(name: str):
    assert _made(PRESETS[name], 1).tobytes() == _made(PRESETS[name], 2).tobytes()


@pytest.mark.live
@pytest.mark.parametrize(
    "name", [pytest.param("drop paper-code", marks=pytest.mark.slow), "payload default"]
)
def test_a_cluster_makes_the_same_bits(name: str):
    pytest.importorskip("ray")
    assert _made(PRESETS[name], 1).tobytes() == _made(PRESETS[name], Cluster(HERE, 2)).tobytes()


@pytest.mark.parametrize("name", PRESETS)
def test_bits_do_not_depend_on_how_items_are_cut(name: str, monkeypatch: pytest.MonkeyPatch):
    found = []
    for most in (1, 7, 1000):
        monkeypatch.setattr(pairs, "_MAX_AT_A_TIME", most)
        monkeypatch.setattr(pairs, "_CHUNKS", 1)
        found.append(_made(PRESETS[name], 1).tobytes())
    assert found[0] == found[1] == found[2]


def _weights_sha256(command: Command, path: Path, *words: str) -> str:
    small = ("--preset", "paper-code", "--pairs", "40", "--epochs", "3", "--quiet")
    done = command("tunenet-train", "drop", *small, "-o", str(path), *words)
    assert done.returncode == 0, done.stderr
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_weights_do_not_depend_on_the_number_of_processes(command: Command, tmp_path: Path):
    pytest.importorskip("torch")
    one, two = (
        _weights_sha256(command, tmp_path / f"{jobs}.safetensors", "--jobs", jobs)
        for jobs in ("1", "2")
    )
    assert one == two


@pytest.mark.live
@pytest.mark.slow
def test_weights_are_the_same_from_a_cluster(command: Command, tmp_path: Path):
    pytest.importorskip("torch")
    pytest.importorskip("ray")
    one = _weights_sha256(command, tmp_path / "1.safetensors", "--jobs", "1")
    words = ("--ray", "--jobs", "2")
    assert _weights_sha256(command, tmp_path / "ray.safetensors", *words) == one


def _dies_once(folder: Path, items: Sequence[int]) -> Array:
    """The process of the first chunk dies, the first time."""
    if 0 in items:
        mark = folder / "died"
        if not mark.exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return np.array(items, float)[:, None, None]


def _dies(items: Sequence[int]) -> Array:
    os.kill(os.getpid(), signal.SIGKILL)
    return np.array(items, float)[:, None, None]


@pytest.mark.parametrize("on", ["processes", pytest.param("ray", marks=pytest.mark.live)])
def test_what_a_dead_worker_had_is_made_again(on: str, tmp_path: Path):
    if on == "ray":
        pytest.importorskip("ray")
    workers = Cluster(HERE, 2) if on == "ray" else 2
    found = observe_all(partial(_dies_once, tmp_path), range(300), workers, QUIET)
    assert (tmp_path / "died").exists()
    assert np.array_equal(found[:, 0, 0], np.arange(300))


def test_a_worker_that_always_dies_is_one_error():
    with pytest.raises(TuneNetError, match="died each time"):
        observe_all(_dies, range(4), 2, QUIET)


def _fails(items: Sequence[int]) -> Array:
    raise ValueError(f"no {items[0]}")


@pytest.mark.live
def test_a_cluster_raises_what_its_work_raises():
    pytest.importorskip("ray")
    with pytest.raises(ValueError, match="no 0"):
        observe_all(_fails, [0], Cluster(HERE, 1), QUIET)
