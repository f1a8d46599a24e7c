"""Damaged exports end in a LogError or are read: never in a traceback, and never late."""

from __future__ import annotations

import os
import random
import re
import time
import zlib
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import pytest

from tests.small_exports import KINDS, SLOW, small
from tunenet_logs.errors import LogError
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


Damage = Callable[[bytearray, int, random.Random], None]  # changes some bytes at a place


def flip(made: bytearray, at: int, chance: random.Random) -> None:
    if at < len(made):
        made[at] ^= 1 << chance.randrange(8)


def fill(made: bytearray, at: int, chance: random.Random) -> None:
    made[at : at + 4] = chance.choice((b"\xff" * 4, bytes(4), b"\xff\xff\xff\x7f"))


def cut_out(made: bytearray, at: int, chance: random.Random) -> None:
    del made[at : at + chance.randint(1, 60)]


def repeat(made: bytearray, at: int, chance: random.Random) -> None:
    made[at:at] = made[at : at + chance.randint(1, 200)] * chance.choice((1, 2, 30))


def cut_off(made: bytearray, at: int, _: random.Random) -> None:
    del made[at:]


def insert(made: bytearray, at: int, chance: random.Random) -> None:
    made[at:at] = chance.choice(WORDS) * chance.choice((1, 3, 200))


def renumber(made: bytearray, at: int, chance: random.Random) -> None:
    if found := list(re.finditer(rb"[-+.\deE]{1,20}", bytes(made[at : at + 300]))):
        begin, end = chance.choice(found).span()
        made[at + begin : at + end] = chance.choice(NUMBERS)


def scramble(made: bytearray, at: int, chance: random.Random) -> None:
    made[at : at + 8] = chance.randbytes(8)


def reorder(made: bytearray, _: int, chance: random.Random) -> None:
    lines = bytes(made).split(b"\n")
    chance.shuffle(lines)
    made[:] = b"\n".join(lines)


DAMAGES: tuple[Damage, ...] = (
    flip, fill, cut_out, repeat, cut_off, insert, renumber, scramble, reorder,
)  # fmt: skip


def mutant(data: bytes, chance: random.Random) -> bytes:
    """The same with some damage, of one to four kinds, half of it near the beginning."""
    made = bytearray(data)
    for _ in range(chance.randint(1, 4)):
        most = len(made) if chance.random() < 0.5 else min(len(made), 600)
        chance.choice(DAMAGES)(made, chance.randrange(most + 1), chance)
    return bytes(made)


def attempt(path: Path, options: ReadOptions) -> str:
    """What came of reading a file: "read", or the refusal."""
    try:
        episode = read_episode(path, options)
    except LogError as error:
        return str(error)
    for topic in episode.picture_topics[:2]:
        try:
            for frame in islice(episode.frames(topic), 12):
                try:
                    frame.decode()
                except LogError:
                    continue
        except LogError as error:
            return str(error)
    return "read"


def fuzzed(tmp_path: Path, kind: str, seeds: range) -> None:
    path = tmp_path / kind
    for seed in seeds:
        chance = random.Random(zlib.crc32(kind.encode()) + seed)
        path.write_bytes(mutant(small(kind), chance))
        begun_s = time.process_time()
        said = attempt(path, chance.choice(OPTIONS))
        assert time.process_time() - begun_s < MAX_S, seed
        assert "\n" not in said, seed
        assert "\0" not in said, seed
        assert len(said) < 3000, seed


@pytest.mark.parametrize("kind", KINDS)
def test_a_whole_file_is_read(tmp_path: Path, kind: str):
    (tmp_path / kind).write_bytes(small(kind))
    options = ReadOptions(columns={"t": "1", "z": "4"}) if kind == "a.npy" else ReadOptions()
    if kind == "defined.mcap":
        return
    assert attempt(tmp_path / kind, options) == "read"


@pytest.mark.parametrize("kind", KINDS)
def test_damage_is_said_in_one_line(tmp_path: Path, kind: str):
    fuzzed(tmp_path, kind, range(2 if kind in SLOW else 50))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_much_more_damage_is_said_in_one_line(tmp_path: Path, kind: str):
    count = MUTANTS // 10 if kind in SLOW else MUTANTS
    fuzzed(tmp_path, kind, range(50 + SEED, 50 + SEED + count))
