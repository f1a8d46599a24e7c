"""Laws of every kind of file: whole it is read, damaged it is one line or read, and soon.

Without an optional library every other kind is read, and what needs one says what to install.
"""

from __future__ import annotations

import os
import random
import re
import subprocess
import sys
import time
import zlib
from collections.abc import Callable
from contextlib import suppress
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import ROOT, real
from tests.small_exports import KINDS, SLOW, small
from tunenet_logs.errors import LogError, pip_install
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode

MAX_S = 10.0
MUTANTS = int(os.environ.get("TUNENET_FUZZ_MUTANTS", "400"))
SEED = int(os.environ.get("TUNENET_FUZZ_SEED", "0"))
OPTIONS = (
    ReadOptions(),
    ReadOptions(fps=240.0, length_unit="mm"),
    ReadOptions(columns={"t": "t", "z": "z"}),
    ReadOptions(columns={"t": "1", "x": "2", "z": "4"}),
)
NUMBERS = (b"0", b"-1", b"nan", b"inf", b"1e308", b"-1e308", b"9" * 25, b"9" * 400, b"1,5", b"")
WORDS = (b"\0", b"\n", b"\r", b'"', b",", b"\t", b";", b"\xff\xfe", b"[", b"{", b"<", b"=" * 80)
FILLS = (b"\xff" * 4, bytes(4), b"\xff\xff\xff\x7f")


def renumber(data: bytes, at: int, chance: random.Random) -> bytes:
    if found := list(re.finditer(rb"[-+.\deE]{1,20}", data[at : at + 300])):
        begin, end = chance.choice(found).span()
        return data[: at + begin] + chance.choice(NUMBERS) + data[at + end :]
    return data


def reorder(data: bytes, _: int, chance: random.Random) -> bytes:
    lines = data.split(b"\n")
    chance.shuffle(lines)
    return b"\n".join(lines)


# What changes some bytes at a place.
DAMAGES: tuple[Callable[[bytes, int, random.Random], bytes], ...] = (
    lambda data, at, chance: data[:at] + bytes(one ^ 1 << chance.randrange(8)
                                               for one in data[at : at + 1]) + data[at + 1 :],
    lambda data, at, chance: data[:at] + chance.choice(FILLS) + data[at + 4 :],
    lambda data, at, chance: data[:at] + data[at + chance.randint(1, 60) :],
    lambda data, at, chance: data[:at] + data[at : at + chance.randint(1, 200)]
    * chance.choice((1, 2, 30)) + data[at:],
    lambda data, at, _: data[:at],
    lambda data, at, chance: data[:at] + chance.choice(WORDS) * chance.choice((1, 3, 200))
    + data[at:],
    renumber,
    lambda data, at, chance: data[:at] + chance.randbytes(8) + data[at + 8 :],
    reorder,
)  # fmt: skip


def mutant(data: bytes, chance: random.Random) -> bytes:
    """The same with some damage, of one to four kinds, half of it near the beginning."""
    for _ in range(chance.randint(1, 4)):
        most = len(data) if chance.random() < 0.5 else min(len(data), 600)
        data = chance.choice(DAMAGES)(data, chance.randrange(most + 1), chance)
    return data


def attempt(path: Path, options: ReadOptions) -> str:
    """What came of reading a file: "read", or the refusal."""
    try:
        episode = read_episode(path, options)
        for topic in episode.picture_topics[:2]:
            for frame in islice(episode.frames(topic), 12):
                with suppress(LogError):
                    frame.decode()
        sound = episode.sounds()
    except LogError as error:
        return str(error)
    for signal in episode.signals.values():
        assert np.all(np.diff(signal.stamps_ns) > 0)
        assert not np.isinf(signal.values).any() or not signal.is_position
    if sound is not None:
        assert np.abs(sound.samples).max(initial=0.0) <= 8  # and finite
        assert sound.rate_hz > 0
        assert len(sound.samples) <= 600 * 48_000
    return "read"


def fuzzed(tmp_path: Path, kind: str, seeds: range) -> None:
    path = tmp_path / kind
    for seed in seeds:
        chance = random.Random(zlib.crc32(kind.encode()) + seed)
        path.write_bytes(mutant(small(kind), chance))
        begun_s = time.process_time()
        said = attempt(path, chance.choice(OPTIONS))
        assert time.process_time() - begun_s < MAX_S, seed
        assert not {"\n", "\0"} & set(said), seed
        assert [one.name for one in tmp_path.iterdir()] == [kind]
        assert len(said) < 3000, seed


@pytest.mark.parametrize("kind", KINDS)
def test_a_whole_file_is_read_and_damage_is_said_in_one_line(tmp_path: Path, kind: str):
    (tmp_path / kind).write_bytes(small(kind))
    options = ReadOptions(columns={"t": "1", "z": "4"}) if kind == "a.npy" else ReadOptions()
    assert kind == "defined.mcap" or attempt(tmp_path / kind, options) == "read"
    fuzzed(tmp_path, kind, range(2 if kind in SLOW else 50))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_much_more_damage_is_said_in_one_line(tmp_path: Path, kind: str):
    count = MUTANTS // 10 if kind in SLOW else MUTANTS
    fuzzed(tmp_path, kind, range(50 + SEED, 50 + SEED + count))


# Without a library, what is read, and what is not.
RUN = """
import sys
sys.modules[sys.argv[1]] = None
from tunenet_logs.cli import main
sys.exit(sum(main(["info", path]) << at for at, path in enumerate(sys.argv[2:])))
"""
OTHERS = ("c3d.c3d", "phyphox.zip", "a.npz", "level5.mat", "plain.csv.zst")


@pytest.mark.parametrize(
    ("library", "needed"),
    [("pyarrow", ["a.parquet"]), ("python_calamine", ["book.xlsx", "phyphox.xlsx"]), ("ezc3d", [])],
)
def test_without_a_library_what_needs_it_is_told_and_the_rest_is_read(
    tmp_path: Path, library: str, needed: list[str]
):
    paths = [tmp_path / kind for kind in (*needed, *OTHERS)]
    for path in paths:
        path.write_bytes(small(path.name))
    line = [sys.executable, "-c", RUN, library, *map(str, paths)]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2 ** len(needed) - 1, done.stderr
    said = done.stderr.splitlines()
    assert len(said) == len(needed)
    assert all(pip_install("tables") in one for one in said)


@pytest.mark.parametrize(
    ("name", "columns", "lengths"),
    [
        ("tracker.txt", {}, {"mass A": 10}),
        ("tracker_multi_data.txt", {}, {"mass A": 128, "mass B": 128}),
        ("Ball_drops_data.csv", {}, {"track.run1": 51, "track.run2": 56}),
        ("fallingtennisball02.txt", {"t": "1", "z": "2"}, {"track": 2500}),
        ("lerobot_episode.parquet", {}, {"observation.state": 479}),
        ("rosbag2_zstd/file_compression", {}, 775),
    ],
)
def test_files_of_laboratories(name: str, columns: dict[str, str], lengths: dict[str, int] | int):
    episode = read_episode(real(f"labs/{name}"), ReadOptions(columns=columns))
    assert not episode.losses
    if isinstance(lengths, int):
        assert sum(channel.messages for channel in episode.channels) == lengths
    else:
        found = {name: len(one.stamps_ns) for name, one in episode.signals.items()}
        assert found == {**found, **lengths}
