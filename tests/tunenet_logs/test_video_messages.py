"""Video in messages: each picture at its own message's stamp, whatever is missing or damaged."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.picture_strangers import image, packets, video, write_pictures
from tunenet_logs.episode import Frame
from tunenet_logs.errors import TuneNetError
from tunenet_logs.reader import read_episode
from tunenet_logs.video import CODECS, Packet, decoded

WIDTH, HEIGHT, COUNT = 160, 96, 40
START_NS, PERIOD_NS = 1_700_000_000_000_000_003, 16_666_667
CODECS_WRITTEN = ("h264", "h265", "vp9", "av1")


def numbered(count: int = COUNT) -> Iterator[np.ndarray]:
    """Grey pictures in which a bright column says which one it is."""
    for number in range(count):
        pixels = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
        pixels[:, 3 * number : 3 * number + 6] = (240, 200, 40)
        yield pixels


def number_of(frame: Frame) -> int:
    bright = np.flatnonzero(frame.decode()[10:-10, :, 0].mean(axis=0) > 150)
    return round((bright.mean() - 2.5) / 3)


def stamp(number: int) -> int:
    return START_NS + number * PERIOD_NS


@cache
def stream(codec: str, keyframe_every: int = 12, b_frames: int = 0) -> tuple[Packet, ...]:
    made = packets(numbered(), codec, keyframe_every, b_frames)
    return tuple(Packet(stamp(number), codec, data) for number, data in made)


def shown(some: Iterator[Frame]) -> list[int]:
    """The numbers of the pictures, each checked to be at its own stamp."""
    numbers = []
    for frame in some:
        assert (frame.encoding, frame.size_px()) == ("rgb8", (WIDTH, HEIGHT))
        numbers.append(number_of(frame))
        assert frame.stamp_ns == stamp(numbers[-1])
    return numbers


@pytest.mark.parametrize("codec", CODECS_WRITTEN)
def test_every_picture_at_its_own_stamp(tmp_path: Path, codec: str):
    messages = [video(one.stamp_ns, codec, one.data) for one in stream(codec)]
    episode = read_episode(write_pictures(tmp_path / "a.mcap", messages))
    assert episode.picture_topics == ("/eye",)
    assert shown(episode.frames()) == list(range(COUNT))
    assert shown(episode.frames()) == list(range(COUNT))


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_pictures_that_need_a_later_one(codec: str):
    """Their messages come out of order; the decoder's delay is flushed at the end."""
    messages = stream(codec, b_frames=2)
    stamps = [one.stamp_ns for one in messages]
    assert stamps != sorted(stamps)
    assert shown(decoded(messages)) == list(range(COUNT))


@pytest.mark.parametrize("codec", CODECS_WRITTEN)
def test_begins_with_the_first_picture_that_stands_alone(codec: str):
    numbers = shown(decoded(stream(codec)[5:]))
    assert numbers == list(range(numbers[0], COUNT))
    assert numbers[0] == 12


@pytest.mark.parametrize("codec", CODECS_WRITTEN)
def test_damaged_packets_are_skipped(codec: str):
    whole = list(stream(codec))
    for at in (6, 7, 20):
        whole[at] = Packet(whole[at].stamp_ns, codec, b"\xa5" * 50)
    whole[30] = Packet(whole[30].stamp_ns, codec, b"")
    numbers = [round((one.stamp_ns - START_NS) / PERIOD_NS) for one in decoded(whole)]
    assert {*range(6), *range(12, 20), *range(24, 30), *range(36, 40)} <= set(numbers)
    assert numbers == sorted(set(numbers))


def test_a_stream_that_changes_its_codec():
    parts = [*stream("h264")[:12], *stream("vp9")[12:24], *stream("h264")[24:]]
    assert shown(decoded(parts)) == list(range(COUNT))


def test_a_topic_that_changes_to_bare_pixels(tmp_path: Path):
    film = [video(one.stamp_ns, "h264", one.data) for one in stream("h264")[:12]]
    still = [
        image(stamp(number), "rgb8", (WIDTH, HEIGHT), pixels.tobytes())
        for number, pixels in enumerate(numbered())
        if number >= 12
    ]
    path = write_pictures(tmp_path / "a.mcap", [*film, *still])
    assert shown(read_episode(path).frames()) == list(range(COUNT))


def test_one_picture_in_memory():
    """As Python counts it; what the decoder keeps is its own."""
    tracemalloc.start()
    for _ in decoded(stream("h264")):
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 6 * WIDTH * HEIGHT * 3 + 300_000


def test_one_message_is_one_picture():
    """All that a bomb of AV1 pictures holds would be decoded at once."""
    messages = stream("av1")
    bomb = Packet(stamp(0), "av1", b"".join(one.data for one in messages))
    assert list(decoded([bomb])) == []
    assert shown(decoded([bomb, *messages])) == list(range(COUNT))


@given(codec=st.sampled_from(CODECS_WRITTEN), data=st.data())
def test_a_damaged_stream_is_decoded_as_far_as_it_goes(codec: str, data: st.DataObject):
    some = []
    for one in stream(codec)[:8]:
        broken = bytearray(one.data)
        for at in data.draw(st.lists(st.integers(0, len(broken) - 1), max_size=2)):
            broken[at] = data.draw(st.integers(0, 255))
        some.append(Packet(one.stamp_ns, codec, bytes(broken)))
    with suppress(TuneNetError):
        assert len(list(decoded(some))) <= 8


@given(codec=st.sampled_from(sorted(CODECS)), parts=st.lists(st.binary(max_size=80), max_size=6))
def test_noise_is_no_video(codec: str, parts: list[bytes]):
    assert list(decoded(Packet(0, codec, one) for one in parts)) == []
