"""Sound in logs: what a recorder kept, what others wrote, and what nobody can have heard."""

from __future__ import annotations

import base64
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import Writer

from tests.clips import RATE_HZ, write_clip
from tests.hostile_files import Block, tones, write_blocks
from tests.strangers import foxglove
from tests.tunenet_logs.test_sound_files import HALF_BIT, SAMPLES, sound_in
from tunenet_logs import messages
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.camera.device import VideoFile
from tunenet_logs.recorders.camera.recording import Limits, record_camera
from tunenet_logs.terminal import Progress

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
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("foxglove.RawAudio", "jsonschema", b"{}")
        channel = writer.register_channel("/mic", "json", schema)
        for number, block in enumerate(blocks):
            log_ns = 10**9 + number * step_ns
            writer.add_message(channel, log_ns, json.dumps(block).encode(), log_ns)
        writer.finish()
    return path


def write_protobuf(path: Path) -> Path:
    from google.protobuf.timestamp_pb2 import Timestamp
    from mcap_protobuf.writer import Writer as ProtobufWriter

    with path.open("wb") as file, ProtobufWriter(file) as writer:
        for number, pcm in enumerate(PIECES):
            fields = audio_fields(number, pcm, data=pcm.tobytes())
            at = fields.pop("timestamp")
            stamp = Timestamp(seconds=at["sec"], nanos=at["nsec"])
            audio = foxglove("RawAudio")(timestamp=stamp, **fields)
            writer.write_message("/mic", audio, 10**9 + number, 10**9 + number)
    return path


def blocks() -> list[dict[str, Any]]:
    return [audio_fields(number, pcm) for number, pcm in enumerate(PIECES)]


def test_others_logs_in_json_and_protobuf(tmp_path: Path):
    text = messages.definition(messages.RAW_AUDIO)  # what we write is what Foxglove defines
    fields = [line.split()[1] for line in text.splitlines()[:5]]
    assert fields == [field.name for field in foxglove("RawAudio").DESCRIPTOR.fields]
    for path in (write_json(tmp_path / "a.mcap", blocks()), write_protobuf(tmp_path / "b.mcap")):
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
