"""Sound of films and of files of its own: at the times at which a player plays it."""

from __future__ import annotations

import wave
from pathlib import Path

import numpy as np
import pytest

from tests.clips import RATE_HZ, clicks, found_late_s, write_clip
from tests.recorders.films import film
from tunenet_logs.episode import Episode, Sound
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode

SAMPLES = clicks([0.6, 1.5])
SAMPLE_S = 1 / RATE_HZ
RED_BALL = Path(__file__).resolve().parents[3] / "shared/real/videos/red_ball_drop_120fps.mp4"


def sound_in(episode: Episode) -> Sound:
    sound = episode.sounds()
    assert sound is not None
    return sound


def write_wav(path: Path, samples: np.ndarray, rate_hz: int = RATE_HZ, channels: int = 1) -> None:
    """A file of 16 bits; `samples` is of shape (N,), the same in all channels."""
    with wave.open(str(path), "wb") as file:
        file.setnchannels(channels)
        file.setsampwidth(2)
        file.setframerate(rate_hz)
        whole = np.round(np.clip(samples, -1, 1) * 32767).astype("<i2")
        file.writeframes(np.repeat(whole, channels).tobytes())


@pytest.mark.parametrize(
    ("name", "codec", "film", "within_s"),
    [
        ("a.mp4", "aac", "libx264", SAMPLE_S),
        ("a.mov", "pcm_s16le", "mpeg4", SAMPLE_S),
        ("a.mkv", "aac", "libx264", 1e-3),  # its times are whole ms
        ("a.webm", "libopus", "libvpx", 1e-3),
        ("a.avi", "pcm_s16le", "mpeg4", SAMPLE_S),
    ],
)
@pytest.mark.parametrize("late_s", [0.0, 0.25])
def test_a_films_sound_lies_where_it_plays(
    tmp_path: Path, name: str, codec: str, film: str, within_s: float, late_s: float
):
    path = tmp_path / name
    if name == "a.avi" and late_s:
        pytest.skip("an AVI's sound has no times of its own")
    write_clip(path, SAMPLES, codec, film=film, late_s=late_s)
    episode = read_episode(path)
    assert episode.picture_topics == ("video",)
    assert episode.sound_topics == ("/audio",)
    sound = sound_in(episode)
    assert (sound.rate_hz, sound.file_rate_hz, sound.channels) == (RATE_HZ, RATE_HZ, 1)
    first = episode.channels[0]
    start_s = (sound.start_ns - int(first.log_ns[0])) * 1e-9
    found_s = start_s + found_late_s(sound.samples, SAMPLES, RATE_HZ)
    if late_s and codec == "aac":
        within_s = 1e-3  # the muxer delays a track by whole ms
    assert found_s == pytest.approx(late_s, abs=within_s)


@pytest.mark.parametrize(
    ("name", "codec", "form"),
    [
        ("a.m4a", "aac", None),
        ("a.mp3", "libmp3lame", None),
        ("a.flac", "flac", None),
        ("a.ogg", "libopus", None),
        ("a.wav", "pcm_s16le", None),
        ("a.wav", "pcm_f32le", None),
        ("a.aiff", "pcm_s16be", None),
        ("voice", "flac", "ogg"),
    ],
)
def test_sound_alone_is_a_log(tmp_path: Path, name: str, codec: str, form: str | None):
    path = tmp_path / name
    write_clip(path, SAMPLES, codec, channels=2, form=form)
    episode = read_episode(path)
    assert not episode.signals
    assert not episode.picture_topics
    assert episode.sound_topics == ("/audio",)
    sound = sound_in(episode)
    assert sound.start_ns == 0
    assert sound.channels == 2
    assert not sound.warnings
    assert found_late_s(sound.samples, SAMPLES, RATE_HZ) == pytest.approx(0.0, abs=SAMPLE_S)
    if codec.startswith(("pcm", "flac")):
        np.testing.assert_allclose(sound.samples, SAMPLES, atol=1e-4)


def slow_clip(path: Path, sound_s: float) -> Episode:
    """Of 4 s, filmed at 120 pictures a second and played at 30; a click in its middle."""
    samples = clicks([sound_s / 2], sound_s)
    tags = {"com.android.capture.fps": "120.000000"}
    with_tags = {"movflags": "use_metadata_tags", **tags}
    write_clip(path, samples, "aac", film="libx264", pictures=120, tags=with_tags)
    return read_episode(path, ReadOptions(fps=120.0))


@pytest.mark.parametrize(("sound_s", "slower"), [(4.0, 4.0), (1.0, 1.0)])
def test_sound_is_slowed_down_with_its_film_or_not(tmp_path: Path, sound_s: float, slower: float):
    sound = sound_in(slow_clip(tmp_path / "slow.mp4", sound_s))
    assert sound.file_rate_hz == RATE_HZ
    assert sound.rate_hz == pytest.approx(slower * RATE_HZ, rel=1e-4)
    expected = clicks([0.5], 1.0) if slower == 1.0 else clicks([2.0], 4.0)
    begins_s = sound.start_ns * 1e-9 + found_late_s(sound.samples, expected, sound.rate_hz)
    assert begins_s == pytest.approx(0.0, abs=2 * SAMPLE_S)
    (said,) = sound.warnings
    assert "slowed down" in said


@pytest.mark.skipif(not RED_BALL.exists(), reason="the film is not here")
def test_a_phones_slow_motion():
    episode = read_episode(RED_BALL)
    sound = sound_in(episode)
    assert sound.rate_hz == pytest.approx(4 * 48_000, rel=1e-3)
    film_s = float(np.ptp(episode.channels[0].log_ns)) * 1e-9
    assert sound.lasts_s == pytest.approx(film_s, rel=0.1)


def test_a_silent_track_is_said(tmp_path: Path):
    write_clip(tmp_path / "a.mp4", np.zeros(48_000, np.float32), "aac", film="libx264")
    sound = sound_in(read_episode(tmp_path / "a.mp4"))
    assert not sound.samples.any()
    assert sound.warnings == ("the sound track is silent",)


def test_a_track_without_packets_is_said(tmp_path: Path):
    write_clip(tmp_path / "a.mkv", np.zeros(0, np.float32), "flac", film="mpeg4")
    episode = read_episode(tmp_path / "a.mkv")
    assert sum(1 for _ in episode.frames()) == 90
    sound = sound_in(episode)
    assert len(sound.samples) == 0
    assert sound.warnings == ("the sound track holds no sound",)


def test_a_film_without_sound_has_none(tmp_path: Path):
    (tmp_path / "a.mp4").write_bytes(film("mp4"))
    episode = read_episode(tmp_path / "a.mp4")
    assert not episode.sound_topics
    assert episode.sounds() is None


def test_a_file_of_no_samples_is_refused(tmp_path: Path):
    path = tmp_path / "a.wav"
    write_wav(path, np.zeros(0))
    with pytest.raises(LogError, match="holds no sound"):
        read_episode(path)


NOISE = np.random.default_rng(0).integers(0, 256, 5000, dtype=np.uint8).tobytes()


@pytest.mark.parametrize("name", ["a.wav", "a.MP3", "a.m4a", "a.ogg"])
def test_what_calls_itself_sound_is_refused_as_sound(tmp_path: Path, name: str):
    path = tmp_path / name
    path.write_bytes(NOISE)
    with pytest.raises(LogError) as refused:
        read_episode(path)
    assert refused.value.what.startswith(f"{path}: is no sound that can be read (")
    assert refused.value.what.endswith(": it has 5000 bytes")
    assert refused.value.remedy == "copy it again, or save it as WAV of 16 bits a sample"


@pytest.mark.parametrize(("kept", "what"), [(20, "is no sound that can be read"), (44, "holds no")])
def test_a_sound_that_is_cut_off_at_its_head(tmp_path: Path, kept: int, what: str):
    path = tmp_path / "a.wav"
    write_wav(path, SAMPLES)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(LogError, match=f"{what}.*: it has {kept} bytes; copy it again"):
        read_episode(path)


def test_a_film_that_cannot_be_read_is_no_sound(tmp_path: Path):
    path = tmp_path / "a.mp4"
    path.write_bytes(NOISE)
    with pytest.raises(LogError, match="is no video that can be read"):
        read_episode(path)
