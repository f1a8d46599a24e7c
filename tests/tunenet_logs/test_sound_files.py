"""Sound of films, of its own files and in logs: at the times at which a player plays it."""

from __future__ import annotations

import base64
import wave
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from tests import message_logs
from tests.clips import RATE_HZ, clicks, found_late_s, write_clip
from tests.conftest import ROOT
from tests.hostile_files import Block, tones, write_blocks
from tests.message_logs import foxglove, write_protobuf
from tests.recorders.films import film
from tunenet_logs import messages
from tunenet_logs.copying import check, import_log
from tunenet_logs.episode import Episode, EpisodeInfo, Sound
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.device import VideoFile
from tunenet_logs.recorders.camera.recording import Limits, record_camera
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


# Sound in logs: what a recorder kept, what others wrote, and what nobody can have heard.
BLOCK = 4800
PCM = np.round(SAMPLES * 32768).astype("<i2")
PIECES = [PCM[begin : begin + BLOCK] for begin in range(0, len(PCM), BLOCK)]


def record(film: Path, log: Path, rate_hz: float | None = None, limits: Limits | None = None):
    quiet = {"overwrite": False, "progress": Progress(quiet=True)}
    source, info = VideoFile(film, rate_hz), EpisodeInfo(kind="drop")
    return record_camera(source, info, log, limits=limits or Limits(), **quiet)  # type: ignore[arg-type]


@pytest.mark.parametrize("rate_hz", [None, 113.7])
@pytest.mark.parametrize("late_s", [0.0, 0.25, -0.25])
def test_a_recording_keeps_the_sound_of_its_film(
    tmp_path: Path, rate_hz: float | None, late_s: float
):
    tags = {"creation_time": "2025-04-19T15:15:22.000000Z"}
    film, log = tmp_path / "a.mov", tmp_path / "a.mcap"
    write_clip(film, SAMPLES, "pcm_s16le", film="mpeg4", late_s=late_s, tags=tags)
    summary = record(film, log, rate_hz)
    assert (summary.captured, summary.written, summary.dropped) == (90, 90, 0)
    assert " s of sound" in summary.in_words("frames")
    before, after = sound_in(read_episode(film, ReadOptions(fps=rate_hz))), sound_in(log)
    assert after.rate_hz == before.rate_hz
    assert (after.file_rate_hz, after.codec) == (RATE_HZ, "pcm-s16")
    assert abs(after.start_ns - before.start_ns) * 1e-9 < 1 / after.rate_hz
    np.testing.assert_allclose(after.samples, before.samples, atol=HALF_BIT)


def test_a_recording_has_the_sound_from_the_beginning_of_time_to_its_own_end(tmp_path: Path):
    film, whole, short = tmp_path / "a.mov", tmp_path / "a.mcap", tmp_path / "b.mcap"
    write_clip(film, SAMPLES, "pcm_s16le", film="mpeg4", late_s=0.0)
    record(film, whole)
    assert sound_in(whole).start_ns == 0
    np.testing.assert_allclose(sound_in(whole).samples, PCM / 32768, atol=HALF_BIT)
    record(film, short, limits=Limits(seconds=1.0))
    assert sound_in(short).lasts_s == pytest.approx(1.0, abs=0.11)
    assert read_episode(short).info.counts == {"captured": 40, "written": 40, "dropped": 0}


def audio_fields(number: int, pcm: np.ndarray, **changed: Any) -> dict[str, Any]:
    stamp_ns = round(number * BLOCK / RATE_HZ * 1e9) + 10**9
    said = {
        "timestamp": {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9},
        "data": base64.b64encode(pcm.tobytes()).decode(),
        "format": "pcm-s16",
        "sample_rate": RATE_HZ,
        "number_of_channels": 1,
    }
    return {**said, **changed}


def write_json(path: Path, blocks: list[dict], step_ns: int = 10**8) -> Path:
    sent = (("/mic", "foxglove.RawAudio", n * step_ns, block) for n, block in enumerate(blocks))
    return message_logs.write_json(path, sent, start_ns=10**9)


def in_protobuf(path: Path) -> Path:
    sent = []
    for number, pcm in enumerate(PIECES):
        fields = audio_fields(number, pcm, data=pcm.tobytes())
        at = fields.pop("timestamp")
        audio = foxglove("RawAudio")(**fields)
        audio.timestamp.seconds, audio.timestamp.nanos = at["sec"], at["nsec"]
        sent.append(("/mic", 10**9 + number, audio))
    return write_protobuf(path, sent)


def blocks() -> list[dict[str, Any]]:
    return [audio_fields(number, pcm) for number, pcm in enumerate(PIECES)]


def test_others_logs_in_json_and_protobuf(tmp_path: Path):
    text = messages.definition(messages.RAW_AUDIO)  # what we write is what Foxglove defines
    fields = [line.split()[1] for line in text.splitlines()[:5]]
    assert fields == [field.name for field in foxglove("RawAudio").DESCRIPTOR.fields]
    for path in (write_json(tmp_path / "a.mcap", blocks()), in_protobuf(tmp_path / "b.mcap")):
        assert read_episode(path).sound_topics == ("/mic",)
        sound = sound_in(path)
        assert (sound.start_ns, sound.rate_hz, sound.channels) == (10**9, RATE_HZ, 1)
        np.testing.assert_array_equal(sound.samples, PCM.astype(np.float32) / 32768)


def test_what_is_lost_leaves_a_hole_and_stamps_far_apart_no_long_silence(tmp_path: Path):
    path = tmp_path / "a.mcap"
    sound = sound_in(write_json(path, [*blocks()[:3], *blocks()[5:]]))
    kept = PCM.astype(np.float32) / 32768
    kept[3 * BLOCK : 5 * BLOCK] = 0
    np.testing.assert_array_equal(sound.samples, kept)
    assert sound.warnings == ("1 hole in the sound, 0.20 s in all",)
    other = [*blocks()[:1], blocks()[1] | {"sample_rate": 44_100}, *blocks()[2:]]
    sound = sound_in(write_json(path, other))
    assert len(sound.samples) == len(PCM)
    assert "1 messages of another rate were left out" in sound.warnings
    far = [audio_fields(0, PIECES[0]), audio_fields(360_000, PIECES[0])]
    sound = sound_in(write_json(path, far, step_ns=36_000 * 10**9))
    assert len(sound.samples) == 600 * RATE_HZ
    assert any("10 minutes are enough" in said for said in sound.warnings)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"sample_rate": -48000}, "damaged"),
        ({"number_of_channels": 10**9}, "claims 1000000000 channels"),
        ({"format": "opus"}, "format 'opus' is not read (only pcm-s16)"),
        ({"data": "####"}, "damaged"),
    ],
)
def test_messages_that_nobody_heard(tmp_path: Path, changed: dict[str, Any], says: str):
    sent = [audio_fields(0, PIECES[0], **changed)] * 3
    episode = read_episode(write_json(tmp_path / "a.mcap", sent))
    assert not episode.sound_topics
    assert episode.sounds() is None
    assert says in (episode.channels[0].skipped or "")


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"rate_hz": 0}, "claims 0 samples a second"),
        ({"rate_hz": 2**32 - 1}, "claims 4294967295 samples a second"),
        ({"channels": 0}, "claims 0 channels"),
        ({"channels": 2**32 - 1}, "claims 4294967295 channels"),
        ({"channels": 7}, "9600 bytes are no whole samples of 7 channels"),
        ({"pcm": b"\1"}, "1 bytes are no whole samples of 1 channels"),
    ],
)
def test_messages_that_claim_what_cannot_be(tmp_path: Path, changed: dict[str, Any], says: str):
    good = [Block(10**9 + number * 10**8, tones(0.1)) for number in range(5)]
    bad, path = good[2]._replace(**changed), tmp_path / "a.mcap"
    episode = read_episode(write_blocks(path, {"/mic": [bad]}))
    assert episode.sounds() is None
    assert says in (episode.channels[0].skipped or "")
    sound = sound_in(write_blocks(path, {"/mic": [*good[:2], bad, *good[3:]]}))
    assert len(sound.samples) == 5 * 4800
    assert sound.warnings == ("1 hole in the sound, 0.10 s in all",)
    assert any("/mic: 1 " in one and says in one for one in read_episode(path).warnings)


def test_a_message_of_64_channels(tmp_path: Path):
    sent = [Block(10**9, tones(0.1, channels=64), channels=64)]
    sound = sound_in(write_blocks(tmp_path / "a.mcap", {"/mic": sent}))
    assert sound.channels == 64
    one = np.frombuffer(tones(0.1), "<i2").astype(np.float32) / 32768
    np.testing.assert_allclose(sound.samples, one, atol=1e-6)
