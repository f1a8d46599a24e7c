"""Sound of films and of files of its own: at the times at which a player plays it."""

from __future__ import annotations

import wave
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import av
import numpy as np
import pytest

from tests.clips import RATE_HZ, clicks, found_late_s, write_clip
from tests.conftest import ROOT
from tests.recorders.films import film
from tunenet_logs.copying import check, import_log
from tunenet_logs.episode import Episode, Sound
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode
from tunenet_logs.terminal import Progress

SAMPLES = clicks([0.6, 1.5])
SAMPLE_S = 1 / RATE_HZ
HALF_BIT = 0.6 / 32768
RED_BALL = ROOT.parent / "shared/real/videos/red_ball_drop_120fps.mp4"
NOISE = np.random.default_rng(0).integers(0, 256, 5000, dtype=np.uint8).tobytes()


def sound_in(episode: Episode | Path) -> Sound:
    sound = (read_episode(episode) if isinstance(episode, Path) else episode).sounds()
    assert sound is not None
    return sound


def write_wav(path: Path, samples: np.ndarray) -> None:
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, RATE_HZ, 0, "NONE", ""))
        file.writeframes(np.round(np.clip(samples, -1, 1) * 32767).astype("<i2").tobytes())


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
    if name == "a.avi" and late_s:
        pytest.skip("an AVI's sound has no times of its own")
    write_clip(tmp_path / name, SAMPLES, codec, film=film, late_s=late_s)
    episode = read_episode(tmp_path / name)
    assert (episode.picture_topics, episode.sound_topics) == (("video",), ("/audio",))
    sound = sound_in(episode)
    assert (sound.rate_hz, sound.file_rate_hz, sound.channels) == (RATE_HZ, RATE_HZ, 1)
    start_s = (sound.start_ns - int(episode.channels[0].log_ns[0])) * 1e-9
    if late_s and codec == "aac":
        within_s = 1e-3  # the muxer delays a track by whole ms
    found_s = start_s + found_late_s(sound.samples, SAMPLES, RATE_HZ)
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
    write_clip(tmp_path / name, SAMPLES, codec, channels=2, form=form)
    episode = read_episode(tmp_path / name)
    assert not episode.signals
    assert (episode.picture_topics, episode.sound_topics) == ((), ("/audio",))
    sound = sound_in(episode)
    assert (sound.start_ns, sound.channels, sound.warnings) == (0, 2, ())
    assert found_late_s(sound.samples, SAMPLES, RATE_HZ) == pytest.approx(0.0, abs=SAMPLE_S)
    if codec.startswith(("pcm", "flac")):
        np.testing.assert_allclose(sound.samples, SAMPLES, atol=1e-4)


@pytest.mark.parametrize(("sound_s", "slower"), [(4.0, 4.0), (1.0, 1.0)])
def test_sound_is_slowed_down_with_its_film_or_not(tmp_path: Path, sound_s: float, slower: float):
    """A film of 4 s, filmed at 120 pictures a second and played at 30."""
    tags = {"movflags": "use_metadata_tags", "com.android.capture.fps": "120.000000"}
    clip = clicks([sound_s / 2], sound_s)
    write_clip(tmp_path / "a.mp4", clip, "aac", film="libx264", pictures=120, tags=tags)
    sound = sound_in(read_episode(tmp_path / "a.mp4", ReadOptions(fps=120.0)))
    assert sound.file_rate_hz == RATE_HZ
    assert sound.rate_hz == pytest.approx(slower * RATE_HZ, rel=1e-4)
    begins_s = sound.start_ns * 1e-9 + found_late_s(sound.samples, clip, sound.rate_hz)
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


def test_what_holds_no_sound_is_said(tmp_path: Path):
    silent, bare, mute = tmp_path / "a.mp4", tmp_path / "a.mkv", tmp_path / "b.mp4"
    write_clip(silent, np.zeros(48_000, np.float32), "aac", film="libx264")
    assert not sound_in(silent).samples.any()
    assert sound_in(silent).warnings == ("the sound track is silent",)
    write_clip(bare, np.zeros(0, np.float32), "flac", film="mpeg4")
    assert sum(1 for _ in read_episode(bare).frames()) == 90
    assert len(sound_in(bare).samples) == 0
    assert sound_in(bare).warnings == ("the sound track holds no sound",)
    mute.write_bytes(film("mp4"))
    assert not read_episode(mute).sound_topics
    assert read_episode(mute).sounds() is None
    write_clip(tmp_path / "a.wav", np.zeros(RATE_HZ, np.float32), "pcm_s16le")
    health = check(tmp_path / "a.wav", Progress(quiet=True))
    assert (list(health.damage), health.doubts) == ([], ("/audio: the sound track is silent",))


@pytest.mark.parametrize(
    ("name", "kept", "says"),
    [
        *((name, 0, "is no sound that can be read (") for name in ("a.wav", "a.MP3", "a.ogg")),
        ("a.m4a", 0, "is no sound that can be read ("),
        ("a.mp4", 0, "is no video that can be read"),
        ("a.wav", 20, "is no sound that can be read"),
        ("a.wav", 44, "holds no sound"),
    ],
)
def test_what_is_no_sound_is_refused_as_what_it_calls_itself(
    tmp_path: Path, name: str, kept: int, says: str
):
    path = tmp_path / name
    write_wav(path, SAMPLES)
    path.write_bytes(path.read_bytes()[:kept] if kept else NOISE)
    with pytest.raises(LogError) as refused:
        read_episode(path)
    assert says in refused.value.what
    if name != "a.mp4":
        assert refused.value.what.startswith(f"{path}: {says}")
        assert refused.value.what.endswith(f": it has {kept or 5000} bytes")
        assert refused.value.remedy == "copy it again, or save it as WAV of 16 bits a sample"


def damaged(data: bytes) -> Iterator[bytes]:
    """A file that is cut, and one with other bytes in it, at many places."""
    draw = np.random.default_rng(28)
    for cut in np.linspace(0, len(data) - 1, 12, dtype=int):
        yield data[:cut]
    for _ in range(20):
        changed = np.frombuffer(data, np.uint8).copy()
        places = draw.integers(0, len(data), 1 + len(data) // 2000)
        changed[places] = draw.integers(0, 256, len(places))
        yield changed.tobytes()
    yield data[:64] + draw.bytes(len(data))


@pytest.mark.parametrize(
    ("name", "codec", "film"),
    [
        ("a.wav", "pcm_s16le", ""),
        ("a.wav", "pcm_f32le", ""),
        ("a.flac", "flac", ""),
        ("a.m4a", "aac", ""),
        ("a.ogg", "libopus", ""),
        ("a.mp3", "libmp3lame", ""),
        ("a.mp4", "aac", "libx264"),
    ],
)
def test_a_damaged_file_is_refused_or_heard(tmp_path: Path, name: str, codec: str, film: str):
    path = tmp_path / name
    write_clip(path, clicks([0.2], 0.5), codec, film=film, pictures=15)
    for data in damaged(path.read_bytes()):
        path.write_bytes(data)
        with suppress(LogError):
            sound = read_episode(path).sounds()
            if sound is not None:
                assert np.isfinite(sound.samples).all()
                assert np.abs(sound.samples).max(initial=0.0) <= 8
                assert sound.rate_hz > 0
                assert len(sound.samples) <= 600 * RATE_HZ


def test_pictures_do_without_a_track_of_garbage(tmp_path: Path):
    clean, path = tmp_path / "clean.mkv", tmp_path / "a.mkv"
    write_clip(clean, clicks([0.5], 1.0), "aac", film="mpeg4")
    draw = np.random.default_rng(1)
    with av.open(str(clean)) as source, av.open(str(path), "w") as target:
        copies = {one.index: target.add_stream_from_template(one) for one in source.streams}
        for packet in source.demux():
            if packet.dts is None:
                continue
            if packet.stream.type == "audio":
                packet.update(draw.bytes(packet.size))
            packet.stream = copies[packet.stream.index]
            target.mux(packet)
    assert sum(1 for _ in read_episode(path).frames()) == 90
    assert any("damaged packets of sound were left out" in one for one in sound_in(path).warnings)


@pytest.mark.parametrize(
    ("name", "codec", "film", "rate_hz"),
    [
        ("a.mp4", "aac", "libx264", RATE_HZ),
        ("a.flac", "flac", "", RATE_HZ),
        ("a.wav", "pcm_s16le", "", 192_000),  # is reduced once
    ],
)
def test_an_import_keeps_the_sound(tmp_path: Path, name: str, codec: str, film: str, rate_hz: int):
    path, log = tmp_path / name, tmp_path / "a.mcap"
    write_clip(path, clicks([0.6], 1.0, rate_hz), codec, film=film, rate_hz=rate_hz)
    import_log(path, log)
    before, after = sound_in(path), sound_in(log)
    np.testing.assert_allclose(after.samples, before.samples, atol=HALF_BIT)
    assert (after.start_ns, after.rate_hz) == (before.start_ns, before.rate_hz)
    assert before.rate_hz == 48_000
    assert after.file_rate_hz == before.file_rate_hz == rate_hz
