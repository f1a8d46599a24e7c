"""Video in messages: each picture at its own message's stamp, whatever is missing or damaged."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import av
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.picture_strangers import image, packets, video, write_pictures
from tunenet_logs import messages
from tunenet_logs.episode import Frame
from tunenet_logs.errors import TuneNetError
from tunenet_logs.images import mean_of_blocks
from tunenet_logs.messages import compressed
from tunenet_logs.reader import read_episode
from tunenet_logs.video import CODECS, Packet, decoded, decoded_frame

WIDTH, HEIGHT, COUNT = 160, 96, 40
START_NS, PERIOD_NS = 1_700_000_000_000_000_003, 16_666_667
ALL = list(range(COUNT))
CODECS_WRITTEN = ("h264", "h265", "vp9", "av1")
each_codec = pytest.mark.parametrize("codec", CODECS_WRITTEN)


def numbered(count: int = COUNT) -> Iterator[np.ndarray]:
    """Grey pictures in which a bright column says which one it is."""
    for number in range(count):
        pixels = np.full((HEIGHT, WIDTH, 3), 60, np.uint8)
        pixels[:, 3 * number : 3 * number + 6] = (240, 200, 40)
        yield pixels


def stamp(number: int) -> int:
    return START_NS + number * PERIOD_NS


@cache
def stream(codec: str, keyframe_every: int = 12, b_frames: int = 0) -> tuple[Packet, ...]:
    made = packets(numbered(), codec, keyframe_every, b_frames)
    return tuple(Packet(stamp(number), codec, data) for number, data in made)


def shown(some: Iterable[Frame]) -> list[int]:
    """The numbers of the pictures, each checked to be at its own stamp."""
    numbers = []
    for frame in some:
        assert (frame.encoding, frame.size_px()) == ("rgb8", (WIDTH, HEIGHT))
        bright = np.flatnonzero(frame.decode()[10:-10, :, 0].mean(axis=0) > 150)
        numbers.append(round((bright.mean() - 2.5) / 3))
        assert frame.stamp_ns == stamp(numbers[-1])
    return numbers


@each_codec
def test_every_picture_at_its_own_stamp(tmp_path: Path, codec: str):
    film = [video(one.stamp_ns, codec, one.data) for one in stream(codec)]
    episode = read_episode(write_pictures(tmp_path / "a.mcap", film))
    assert episode.picture_topics == ("/eye",)
    for _ in range(2):
        assert shown(episode.frames()) == ALL


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_pictures_that_need_a_later_one(codec: str):
    """Their messages come out of order; the decoder's delay is flushed at the end."""
    film = stream(codec, b_frames=2)
    stamps = [one.stamp_ns for one in film]
    assert stamps != sorted(stamps)
    assert shown(decoded(film)) == ALL


@each_codec
def test_begins_with_the_first_picture_that_stands_alone_and_damage_is_skipped(codec: str):
    assert shown(decoded(stream(codec)[5:])) == ALL[12:]
    whole = list(stream(codec))
    for at in (6, 7, 20):
        whole[at] = Packet(whole[at].stamp_ns, codec, b"\xa5" * 50)
    whole[30] = Packet(whole[30].stamp_ns, codec, b"")
    numbers = [round((one.stamp_ns - START_NS) / PERIOD_NS) for one in decoded(whole)]
    assert {*range(6), *range(12, 20), *range(24, 30), *range(36, 40)} <= set(numbers)
    assert numbers == sorted(set(numbers))


def test_a_stream_that_changes_its_codec_or_to_bare_pixels(tmp_path: Path):
    parts = [*stream("h264")[:12], *stream("vp9")[12:24], *stream("h264")[24:]]
    assert shown(decoded(parts)) == ALL
    film = [video(one.stamp_ns, "h264", one.data) for one in stream("h264")[:12]]
    still = [
        image(stamp(number), "rgb8", (WIDTH, HEIGHT), pixels.tobytes())
        for number, pixels in enumerate(numbered())
    ]
    path = write_pictures(tmp_path / "a.mcap", [*film, *still[12:]])
    assert shown(read_episode(path).frames()) == ALL


def test_one_picture_in_memory_and_one_of_each_message():
    """As Python counts it; all that a bomb of AV1 pictures holds would be decoded at once."""
    tracemalloc.start()
    for _ in decoded(stream("h264")):
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 6 * WIDTH * HEIGHT * 3 + 300_000
    film = stream("av1")
    bomb = Packet(stamp(0), "av1", b"".join(one.data for one in film))
    assert list(decoded([bomb])) == []
    assert shown(decoded([bomb, *film])) == ALL


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


# Pictures of a decoded video: made RGB when they are asked for, at the size that is wanted.
def picture(width: int, height: int) -> av.VideoFrame:
    """A smooth one in a video's own colours, each of which two by two pixels share."""
    y, x = np.mgrid[:height, :width]
    rgb = np.stack([40 + 150 * x / width, 60 + 120 * y / height, 90 + 60 * (x + y) / (width)], 2)
    frame = av.VideoFrame.from_ndarray(rgb.astype(np.uint8), format="rgb24")
    return frame.reformat(format="yuv420p")


@pytest.mark.parametrize("scale", [1, 2, 3, 5])
@pytest.mark.parametrize("rotation", [0, 90, 180, 270])
@pytest.mark.parametrize("size", [(120, 60), (122, 62)])
def test_a_reduced_picture_is_the_mean_of_its_pixels(
    size: tuple[int, int], rotation: int, scale: int
):
    frame = decoded_frame(7, picture(*size), rotation)
    width, height = frame.size_px()
    assert (width, height) == (size[::-1] if rotation % 180 else size)
    whole, small = frame.decode(), frame.decode(scale)
    assert whole.shape == (height, width, 3)
    assert small.shape == (height // scale, width // scale, 3)
    assert np.array_equal(small, mean_of_blocks(whole, scale))


def test_pixels_that_alternate_stand_for_their_mean_and_are_written_as_seen():
    board = np.indices((40, 40)).sum(axis=0) % 2 * 255
    rgb = np.repeat(board[:, :, None], 3, axis=2).astype(np.uint8)
    frame = decoded_frame(0, av.VideoFrame.from_ndarray(rgb, format="rgb24"), dithered=True)
    assert np.ptp(frame.decode()[5:-5, 5:-5].astype(int)) < 10
    frame = decoded_frame(5, picture(16, 8))
    _, data = messages.frame(frame)
    assert frame.decode().tobytes() in data
    later = replace(frame, stamp_ns=9)
    assert np.array_equal(later.decode(), frame.decode())
    assert compressed(later).stamp_ns == 9
