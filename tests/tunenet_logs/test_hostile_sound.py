"""Sound made to hurt, or damaged: a line or a warning, and little memory."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from tests import sound_bombs
from tests.clips import RATE_HZ, clicks, write_clip
from tests.conftest import BIN, ROOT
from tests.hostile import LAUNCHER, spent
from tests.sound_bombs import Block, tones, write_blocks
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode

MAX_BYTES = 512 * 2**20
# By each bomb: how `tunenet-logs check` ends, and what it says.
SAID = {
    "hours_claimed": (0, "whole"),
    "hours_of_holes": (0, "only the first 600.0 s of the sound are used: 10 minutes are enough"),
    "hour_of_flac": (0, "only the first 600.0 s of the sound are used: 10 minutes are enough"),
    "many_channels": (0, "whole"),
    "most_channels": (0, "/audio: the sound track holds no sound"),
    "high_rate": (0, "the sound was reduced from 192000 to 48000 Hz"),
    "no_numbers": (0, "3 samples that are no numbers, or far too loud, became silence"),
    "no_rate": (1, "is no sound that can be read (Invalid data"),
    "impossible_rate": (0, "the sound cannot be used: it claims 2.14748e+09 samples a second"),
    "far_apart": (
        0,
        "the sound of 12 channels were left out: the log has over 8 channels of sound",
    ),
    "many_moments": (0, "1 hole in the sound, 3600.00 s in all"),
}

# All in one process, whose peak of memory only grows.
CHECKER = """
import io, json, resource, sys
from contextlib import redirect_stderr, redirect_stdout
from tunenet_logs.cli import main
for path in sys.argv[1:]:
    printed = io.StringIO()
    with redirect_stdout(printed), redirect_stderr(printed):
        code = main(["check", path])
    peak = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    print(json.dumps({"code": code, "peak": peak, "said": printed.getvalue()}), flush=True)
"""


@pytest.fixture(scope="module")
def met(tmp_path_factory: pytest.TempPathFactory) -> dict[str, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("sounds")
    paths = [bomb(folder) for bomb in sound_bombs.BOMBS]
    line = [sys.executable, "-c", LAUNCHER, sys.executable, "-c", CHECKER, *map(str, paths)]
    done = subprocess.run(line, cwd=ROOT, stdout=subprocess.PIPE, text=True, timeout=300)
    told = [json.loads(one) for one in done.stdout.splitlines()]
    return dict(zip((bomb.__name__ for bomb in sound_bombs.BOMBS), told, strict=False))


@pytest.mark.parametrize("bomb", [bomb.__name__ for bomb in sound_bombs.BOMBS])
def test_a_bomb_of_sound_is_said_and_costs_little(met: dict[str, dict[str, Any]], bomb: str):
    assert bomb in met, f"the process ended at {list(met)[-1:]} or behind it"
    told = met[bomb]
    code, says = SAID[bomb]
    assert "Traceback" not in told["said"]
    assert told["code"] == code, told["said"]
    assert says in told["said"]
    assert told["peak"] < MAX_BYTES


def test_an_import_holds_few_sounds(tmp_path: Path):
    sound_bombs.far_apart(tmp_path)
    command = [str(BIN / "tunenet-logs"), "import", "apart.mcap", "-o", "out.mcap"]
    told = spent(command, tmp_path)
    assert told.code == 0, told.said
    assert "left out: /mic7: the log has more sound than an import takes" in told.said
    assert told.peak_kib < 700_000


def test_an_import_says_what_sound_is_none(tmp_path: Path):
    path = sound_bombs.impossible_rate(tmp_path)
    told = spent([str(BIN / "tunenet-logs"), "import", path.name, "-o", "out.mcap"], tmp_path)
    assert told.code == 1
    assert told.said.count("\n") == 1
    assert "it claims 2.14748e+09 samples a second" in told.said


def heard(path: Path) -> tuple[int, tuple[str, ...]]:
    """How many samples there are, and what is said of them."""
    episode = read_episode(path)
    sound = episode.sounds()
    if sound is None:
        return 0, ()
    assert np.isfinite(sound.samples).all()
    assert np.abs(sound.samples).max(initial=0.0) <= 8
    assert sound.rate_hz > 0
    return len(sound.samples), sound.warnings


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
            count, _ = heard(path)
            assert count <= 600 * RATE_HZ


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
    episode = read_episode(path)
    assert sum(1 for _ in episode.frames()) == 90
    _, said = heard(path)
    assert any("damaged packets of sound were left out" in one for one in said)


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
    path = write_blocks(tmp_path / "bad.mcap", {"/mic": [good[0]._replace(**changed)]})
    assert heard(path) == (0, ())
    assert says in (read_episode(path).channels[0].skipped or "")
    mixed = [*good[:2], good[2]._replace(**changed), *good[3:]]
    count, said = heard(write_blocks(tmp_path / "mixed.mcap", {"/mic": mixed}))
    assert count == 5 * 4800
    assert said == ("1 hole in the sound, 0.10 s in all",)
    warnings = read_episode(tmp_path / "mixed.mcap").warnings
    assert any("/mic: 1 " in one and says in one for one in warnings)


def test_a_message_of_64_channels(tmp_path: Path):
    blocks = [Block(10**9, tones(0.1, channels=64), channels=64)]
    sound = read_episode(write_blocks(tmp_path / "a.mcap", {"/mic": blocks})).sounds()
    assert sound is not None
    assert sound.channels == 64
    one = np.frombuffer(tones(0.1), "<i2").astype(np.float32) / 32768
    np.testing.assert_allclose(sound.samples, one, atol=1e-6)
