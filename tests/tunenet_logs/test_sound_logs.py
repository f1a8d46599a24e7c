"""Sound in logs: what a recorder kept, what others wrote, and what nobody can have heard."""

from __future__ import annotations

import base64
import json
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from tests.clips import RATE_HZ, clicks, write_clip
from tests.tunenet_logs.test_protobuf import foxglove
from tunenet_logs import messages
from tunenet_logs.copying import check, import_log
from tunenet_logs.episode import Episode, EpisodeInfo, Sound
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.device import VideoFile
from tunenet_logs.recorders.camera.recording import Limits, record_camera
from tunenet_logs.terminal import Progress

SAMPLES = clicks([0.6, 1.5])
HALF_BIT = 0.6 / 32768
BLOCK = 4800
PCM = np.round(SAMPLES * 32768).astype("<i2")


def sound_in(episode: Episode) -> Sound:
    sound = episode.sounds()
    assert sound is not None
    return sound


def record(film: Path, log: Path, rate_hz: float | None = None, limits: Limits | None = None):
    return record_camera(
        VideoFile(film, rate_hz),
        EpisodeInfo(kind="drop"),
        log,
        limits=limits or Limits(),
        overwrite=False,
        progress=Progress(quiet=True),
    )


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
    options = ReadOptions(fps=rate_hz)
    before, after = sound_in(read_episode(film, options)), sound_in(read_episode(log))
    assert after.rate_hz == before.rate_hz
    assert (after.file_rate_hz, after.codec) == (RATE_HZ, "pcm-s16")
    assert abs(after.start_ns - before.start_ns) * 1e-9 < 1 / after.rate_hz
    np.testing.assert_allclose(after.samples, before.samples, atol=HALF_BIT)


def test_what_is_before_all_time_is_left_out(tmp_path: Path):
    film, log = tmp_path / "a.mov", tmp_path / "a.mcap"
    write_clip(film, SAMPLES, "pcm_s16le", film="mpeg4", late_s=0.0)
    record(film, log)
    sound = sound_in(read_episode(log))
    assert sound.start_ns == 0
    np.testing.assert_allclose(sound.samples, PCM / 32768, atol=HALF_BIT)


def test_a_recording_that_ends_early_ends_its_sound(tmp_path: Path):
    film, log = tmp_path / "a.mp4", tmp_path / "a.mcap"
    write_clip(film, SAMPLES, "aac", film="libx264")
    record(film, log, limits=Limits(seconds=1.0))
    episode = read_episode(log)
    assert sound_in(episode).lasts_s == pytest.approx(1.0, abs=0.11)
    counts = episode.info.counts
    assert counts["captured"] == counts["written"] == 40
    assert counts["dropped"] == 0


def test_an_import_keeps_the_sound(tmp_path: Path):
    for name, codec, film in (("a.mp4", "aac", "libx264"), ("a.flac", "flac", "")):
        path, log = tmp_path / name, (tmp_path / name).with_suffix(".mcap")
        write_clip(path, SAMPLES, codec, film=film)
        import_log(path, log, overwrite=True)
        before, after = sound_in(read_episode(path)), sound_in(read_episode(log))
        np.testing.assert_allclose(after.samples, before.samples, atol=HALF_BIT)
        assert (after.start_ns, after.rate_hz) == (before.start_ns, before.rate_hz)


def test_an_import_reduces_a_high_rate_once(tmp_path: Path):
    path, log = tmp_path / "a.wav", tmp_path / "a.mcap"
    write_clip(path, clicks([0.6], 1.0, 192_000), "pcm_s16le", rate_hz=192_000)
    import_log(path, log)
    before, after = sound_in(read_episode(path)), sound_in(read_episode(log))
    assert before.rate_hz == after.rate_hz == 48_000
    assert before.file_rate_hz == after.file_rate_hz == 192_000
    np.testing.assert_allclose(after.samples, before.samples, atol=HALF_BIT)


def test_a_check_says_that_a_track_is_silent(tmp_path: Path):
    path = tmp_path / "a.wav"
    write_clip(path, np.zeros(RATE_HZ, np.float32), "pcm_s16le")
    health = check(path, Progress(quiet=True))
    assert not health.damage
    assert health.doubts == ("/audio: the sound track is silent",)


def audio_fields(number: int, pcm: np.ndarray, rate_hz: int = RATE_HZ, channels: int = 1) -> dict:
    stamp_ns = round(number * BLOCK / RATE_HZ * 1e9) + 10**9
    return {
        "timestamp": {"sec": stamp_ns // 10**9, "nsec": stamp_ns % 10**9},
        "data": base64.b64encode(pcm.tobytes()).decode(),
        "format": "pcm-s16",
        "sample_rate": rate_hz,
        "number_of_channels": channels,
    }


def write_json(path: Path, blocks: list[dict], step_ns: int = 0) -> Path:
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.RawAudio", "jsonschema", b"{}")
        channel = writer.register_channel("/mic", "json", schema)
        for number, block in enumerate(blocks):
            log_ns = 10**9 + number * (step_ns or 10**8)
            writer.add_message(channel, log_ns, json.dumps(block).encode(), log_ns)
        writer.finish()
    return path


def write_protobuf(path: Path, pieces: list[np.ndarray]) -> Path:
    from google.protobuf.timestamp_pb2 import Timestamp
    from mcap_protobuf.writer import Writer as ProtobufWriter

    with path.open("wb") as file, ProtobufWriter(file) as writer:
        for number, pcm in enumerate(pieces):
            fields = audio_fields(number, pcm)
            stamp = Timestamp(seconds=fields["timestamp"]["sec"], nanos=fields["timestamp"]["nsec"])
            rest = {name: fields[name] for name in ("format", "sample_rate", "number_of_channels")}
            audio = foxglove("RawAudio")(timestamp=stamp, data=pcm.tobytes(), **rest)
            writer.write_message("/mic", audio, 10**9 + number, 10**9 + number)
    return path


def pieces_of(pcm: np.ndarray) -> list[np.ndarray]:
    return [pcm[begin : begin + BLOCK] for begin in range(0, len(pcm), BLOCK)]


def test_others_logs_in_json_and_protobuf(tmp_path: Path):
    pieces = pieces_of(PCM)
    blocks = [audio_fields(number, pcm) for number, pcm in enumerate(pieces)]
    for path in (
        write_json(tmp_path / "json.mcap", blocks),
        write_protobuf(tmp_path / "protobuf.mcap", pieces),
    ):
        episode = read_episode(path)
        assert episode.sound_topics == ("/mic",)
        sound = sound_in(episode)
        assert (sound.start_ns, sound.rate_hz, sound.channels) == (10**9, RATE_HZ, 1)
        np.testing.assert_array_equal(sound.samples, PCM.astype(np.float32) / 32768)


def test_a_message_that_is_lost_leaves_a_hole(tmp_path: Path):
    blocks = [audio_fields(number, pcm) for number, pcm in enumerate(pieces_of(PCM))]
    del blocks[3:5]
    sound = sound_in(read_episode(write_json(tmp_path / "a.mcap", blocks)))
    kept = PCM.astype(np.float32) / 32768
    kept[3 * BLOCK : 5 * BLOCK] = 0
    np.testing.assert_array_equal(sound.samples, kept)
    assert sound.warnings == ("1 hole in the sound, 0.20 s in all",)


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"sample_rate": 0}, "claims 0 samples a second"),
        ({"sample_rate": -48000}, "damaged"),
        ({"sample_rate": 10**12}, "claims 1000000000000 samples a second"),
        ({"number_of_channels": 0}, "claims 0 channels"),
        ({"number_of_channels": 10**9}, "claims 1000000000 channels"),
        ({"number_of_channels": 7}, "no whole samples of 7 channels"),
        ({"format": "opus"}, "format 'opus' is not read (only pcm-s16)"),
        ({"data": "####"}, "damaged"),
    ],
)
def test_messages_that_nobody_heard(tmp_path: Path, changed: dict, says: str):
    blocks = [{**audio_fields(0, PCM[:BLOCK]), **changed}] * 3
    episode = read_episode(write_json(tmp_path / "a.mcap", blocks))
    assert not episode.sound_topics
    assert episode.sounds() is None
    assert says in (episode.channels[0].skipped or "")


def test_one_bad_message_is_left_out(tmp_path: Path):
    blocks = [audio_fields(number, pcm) for number, pcm in enumerate(pieces_of(PCM))]
    blocks[1] |= {"sample_rate": 44_100}
    sound = sound_in(read_episode(write_json(tmp_path / "a.mcap", blocks)))
    assert len(sound.samples) == len(PCM)
    assert "1 messages of another rate were left out" in sound.warnings


def test_stamps_far_apart_make_no_long_silence(tmp_path: Path):
    blocks = [audio_fields(0, PCM[:BLOCK]), audio_fields(360_000, PCM[:BLOCK])]
    path = write_json(tmp_path / "a.mcap", blocks, step_ns=36_000 * 10**9)
    sound = sound_in(read_episode(path))
    assert len(sound.samples) == 600 * RATE_HZ
    assert any("10 minutes are enough" in said for said in sound.warnings)


def test_what_we_write_is_what_foxglove_defines():
    text = messages.definition(messages.RAW_AUDIO)
    fields = [line.split()[1] for line in text.splitlines()[:5]]
    assert fields == [field.name for field in foxglove("RawAudio").DESCRIPTOR.fields]
