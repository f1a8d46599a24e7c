"""Sound beside a live camera: a played file in the microphone's place, over real sockets."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import Command
from tests.recorders.mjpeg_camera import playing
from tunenet_logs.analysis.evaluation.worlds.audio import write_sound
from tunenet_logs.errors import MicrophoneError, UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.microphone import (
    InputDevice,
    SampleClock,
    SoundPiece,
    TimedPiece,
    chosen,
)

RATE_HZ = 16_000
PIECE = 320
START_NS = 1_700_000_000_000_000_000


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """A tone that rises, so that each moment of it is told from all others."""
    seconds = np.arange(20 * RATE_HZ) / RATE_HZ
    path = tmp_path / "sweep.wav"
    write_sound((0.5 * np.sin(200 * seconds**2)).astype(np.float32), RATE_HZ, path)
    return path


@pytest.mark.live
def test_a_played_file_is_recorded_beside_the_pictures_of_a_camera(
    command: Command, tmp_path: Path, sweep: Path
):
    with playing(frames=90, rate_hz=60.0) as address:
        words = ["--camera", f"http://{address}", "--microphone", str(sweep), "-o", "a.mcap"]
        result = command("tunenet-record", *words, cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert "s of sound" in result.stdout + result.stderr
    episode = read_episode(tmp_path / "a.mcap")
    sound, pictures = episode.sounds("/audio"), list(episode.frames())
    assert sound is not None
    assert sound.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert pictures[0].stamp_ns == pytest.approx(sound.start_ns, abs=60_000_000)
    # what was kept is one whole stretch of the file, sample by sample
    played = read_episode(sweep).sounds(None)
    assert played is not None
    assert len(sound.samples) > RATE_HZ / 2
    begin = sound.samples[: RATE_HZ // 4]
    places = np.correlate(played.samples, begin, "valid")
    at = int(places.argmax())
    whole = played.samples[at : at + len(sound.samples)]
    assert np.abs(whole - sound.samples).max() < 2 / 32768


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["--camera", "a.mp4", "--microphone"], "live camera"),
        (["--simulate", "drop", "--microphone"], "--microphone"),
    ],
)
def test_a_microphone_without_a_live_camera_is_refused(
    command: Command, tmp_path: Path, words: list[str], names: str
):
    (tmp_path / "a.mp4").touch()
    result = command("tunenet-record", *words, cwd=tmp_path)
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1
    assert names in result.stderr


def pieces(lost_after: int | None = None, *, told: bool = True) -> list[SoundPiece]:
    """Ten seconds whose told times jitter by 4 ms; a tenth of a second is lost after so many."""
    rng, found = np.random.default_rng(3), []
    for number in range(10 * RATE_HZ // PIECE):
        first = number * PIECE
        late_s = 0.1 if lost_after is not None and number > lost_after else 0.0
        begin_s = first / RATE_HZ + late_s + 0.004 * rng.uniform(-1, 1)
        follows = told and lost_after is not None and number == lost_after + 1
        pcm = np.full(PIECE, number, np.int16)
        found.append(SoundPiece(first, START_NS + round(1e9 * begin_s), pcm, follows))
    return found


def timed(clock: SampleClock, given: list[SoundPiece]) -> list[TimedPiece]:
    found = [out for one in given for out in clock.timed(one, one.begin_ns)]
    return [*found, *clock.rest()]


def test_a_driver_s_jitter_is_not_in_the_samples_times():
    clock = SampleClock(RATE_HZ)
    found = timed(clock, pieces())
    at_ms = np.array([one.stamp_ns - START_NS for one in found]) * 1e-6
    due_ms = np.arange(len(found)) * 1000 * PIECE / RATE_HZ
    assert len(found) == 10 * RATE_HZ // PIECE
    assert np.abs(at_ms - due_ms).max() < 1.5
    assert np.abs(np.diff(at_ms) - 20).max() < 0.3
    assert clock.losses == 0


@pytest.mark.parametrize("told", [True, False], ids=["told by the device", "found by its times"])
def test_samples_that_are_lost_leave_a_gap_and_are_told(told: bool):
    clock = SampleClock(RATE_HZ)
    found = timed(clock, pieces(200, told=told))
    at_ms = np.array([one.stamp_ns - START_NS for one in found]) * 1e-6
    due_ms = np.arange(len(found)) * 20.0 + 100.0 * (np.arange(len(found)) > 200)
    assert clock.losses == 1
    assert clock.lost_s == pytest.approx(0.1, abs=0.004)
    assert np.abs(at_ms - due_ms).max() < 4


DEVICES = (
    InputDevice(0, "HDA Intel PCH: ALC257 (hw:0,0)", 2, 44_100.0),
    InputDevice(4, "Blue Yeti: USB Audio (hw:1,0)", 2, 48_000.0),
    InputDevice(6, "default", 32, 44_100.0),
)


@pytest.mark.parametrize(("wanted", "number"), [("", 6), ("yeti", 4), ("0", 0), ("DEFAULT", 6)])
def test_a_microphone_is_named_by_number_or_part_of_its_name(wanted: str, number: int):
    assert chosen(wanted, DEVICES, 6).number == number


def test_a_name_that_none_or_several_have_lists_them():
    with pytest.raises(MicrophoneError, match="Blue Yeti"):
        chosen("rode", DEVICES, 6)
    with pytest.raises(UsageError, match="2 are called so"):
        chosen("hw:", DEVICES, 6)
    with pytest.raises(MicrophoneError, match="no microphone is plugged in"):
        chosen("", (), -1)
