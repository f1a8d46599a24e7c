"""Pictures of other people's logs: every encoding as its pixels were, nothing believed too far."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.picture_strangers import (
    ENCODED,
    RAW,
    Fields,
    compressed,
    image,
    png,
    video,
    write_pictures,
)
from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError, TuneNetError
from tunenet_logs.reader import read_episode

WIDTH, HEIGHT = SIZE = 64, 48
STAMP_NS = 1_700_000_000_123_456_789
PIXEL_BYTES = {"rgb8": 3, "bgra8": 4, "mono8": 1, "mono16": 2, "yuyv": 2, "bayer_grbg8": 1}


def drawn() -> np.ndarray:
    """Smooth, and of all colours: no encoding then loses much."""
    across, down = np.meshgrid(np.linspace(0, 1, WIDTH), np.linspace(0, 1, HEIGHT))
    parts = [60 + 150 * across, 40 + 180 * down, 200 - 120 * across * down]
    return np.dstack(parts).astype(np.uint8)


RGB = drawn()


def read(tmp_path: Path, *messages: Fields) -> list[Frame]:
    episode = read_episode(write_pictures(tmp_path / "a.mcap", messages))
    assert not episode.losses
    return list(episode.frames())


@pytest.mark.parametrize("encoding", ENCODED)
def test_every_encoding_shows_what_was_drawn(tmp_path: Path, encoding: str):
    data = ENCODED[encoding](RGB)
    step = WIDTH if encoding.startswith("nv") else None
    (frame,) = read(tmp_path, image(STAMP_NS, encoding, SIZE, data, step))
    assert (frame.stamp_ns, frame.encoding) == (STAMP_NS, encoding)
    assert (frame.data, frame.size_px()) == (data, SIZE)
    wanted = RGB
    if "mono" in encoding or encoding.endswith("UC1"):
        wanted = np.repeat(cv2.cvtColor(RGB, cv2.COLOR_RGB2GRAY)[..., None], 3, axis=2)
    off = np.abs(frame.decode().astype(int) - wanted)[2:-2, 2:-2]
    is_exact = not encoding.startswith(("bayer", "yuv", "yuyv", "uyvy", "nv"))
    assert off.max() <= (0 if is_exact else 8)


@pytest.mark.parametrize("encoding", PIXEL_BYTES)
def test_rows_may_be_padded(tmp_path: Path, encoding: str):
    data, row = ENCODED[encoding](RGB), WIDTH * PIXEL_BYTES[encoding]
    rows = np.frombuffer(data, np.uint8).reshape(HEIGHT, row)
    padded = np.pad(rows, ((0, 2), (0, 24)), constant_values=9).tobytes()
    with_padding = image(STAMP_NS, encoding, SIZE, padded, row + 24)
    without = image(STAMP_NS + 1, encoding, SIZE, data, 0)
    assert [one.data for one in read(tmp_path, with_padding, without)] == [data] * 2


def test_the_other_byte_order_and_foxgloves_type_are_read(tmp_path: Path):
    small = np.arange(WIDTH * HEIGHT, dtype="<u2") * 20
    big = np.pad(small.astype(">u2").reshape(HEIGHT, WIDTH), ((0, 0), (0, 3)))
    sent = image(STAMP_NS, "mono16", SIZE, big.tobytes(), 2 * WIDTH + 6, is_bigendian=1)
    (frame,) = read(tmp_path, sent)
    assert frame.data == small.tobytes()
    assert np.array_equal(frame.decode()[..., 0].ravel(), small >> 8)
    fields = {"width": WIDTH, "height": HEIGHT, "encoding": "rgb8", "step": 3 * WIDTH}
    (frame,) = read(tmp_path, (STAMP_NS, RAW, {**fields, "data": RGB.tobytes()}))
    assert np.array_equal(frame.decode(), RGB)
    assert frame.stamp_ns == STAMP_NS


def test_a_picture_whose_stamp_was_not_set_has_the_time_of_the_log(tmp_path: Path):
    """The others keep their own: times of this log are 5 ms later."""
    data = bytes(WIDTH * HEIGHT)
    stamps = [0, *(STAMP_NS + number * 33_000_000 for number in range(9))]
    frames = read(tmp_path, *(image(stamp_ns, "mono8", SIZE, data) for stamp_ns in stamps))
    assert [one.stamp_ns for one in frames] == [5_000_000, *stamps[1:]]


@pytest.mark.parametrize("said", ["jpeg", "bgr8; png compressed ", "rgb8; jpeg compressed bgr8"])
def test_compressed_pictures_are_what_they_are(tmp_path: Path, said: str):
    (frame,) = read(tmp_path, compressed(STAMP_NS, said, png(RGB)))
    assert (frame.encoding, frame.data) == ("png", png(RGB))
    assert np.array_equal(frame.decode(), RGB)


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (image(STAMP_NS, "32FC1", (2, 2), bytes(16)), "distances"),
        (image(STAMP_NS, "rgb9", (2, 2), bytes(16)), "'rgb9' are not read"),
        (compressed(STAMP_NS, "32FC1; compressedDepth rvl", bytes(40)), "distances"),
        (compressed(STAMP_NS, "16UC1; compressedDepth png", bytes(40)), "distances"),
        (video(STAMP_NS, "mjpeg", b"\0"), "'mjpeg' is not read"),
    ],
)
def test_what_is_no_picture_is_left_out_with_a_reason(tmp_path: Path, message, reason: str):
    episode = read_episode(write_pictures(tmp_path / "a.mcap", [message] * 3))
    assert reason in (episode.channels[0].skipped or "")
    assert episode.picture_topics == ()
    assert episode.losses == ()


BAD = {
    "cut": image(STAMP_NS, "rgb8", (4, 4), bytes(47), 12),
    "no width": image(STAMP_NS, "rgb8", (0, 4), bytes(48)),
    "short rows": image(STAMP_NS, "rgb8", (4, 4), bytes(48), 11),
    "odd": image(STAMP_NS, "yuyv", (3, 4), bytes(48)),
    "over the limit": image(STAMP_NS, "mono8", (2**31, 2**31), bytes(48), 1),
    "wide step": image(STAMP_NS, "mono8", (4, 4), bytes(48), 2**32 - 1),
    "one more encoding": image(STAMP_NS, "64FC2", (1, 3), bytes(48)),
}


@pytest.mark.parametrize("bad", BAD)
def test_damaged_pictures_are_counted_and_left_out(tmp_path: Path, bad: str):
    good = image(STAMP_NS, "rgb8", (4, 4), bytes(range(48)))
    episode = read_episode(write_pictures(tmp_path / "a.mcap", [BAD[bad], good, BAD[bad]]))
    assert [frame.data for frame in episode.frames()] == [bytes(range(48))]
    [said] = [one for one in episode.warnings if "left out" in one]
    assert said.startswith("/eye: 2 ")
    assert (said in episode.losses) == ("damaged" in said)


sides = st.integers(-2, 70)


@given(
    encoding=st.sampled_from([*ENCODED, "32FC1", ""]),
    size=st.tuples(sides, sides),
    length=st.integers(0, 20_000),
)
def test_bare_pixels_decode_or_are_refused(encoding: str, size: tuple[int, int], length: int):
    with suppress(TuneNetError):
        pixels = Frame(0, encoding, bytes(length), size).decode()
        assert pixels.shape == (size[1], size[0], 3)
    width, height = 1 + abs(size[0]) % 9, 1 + abs(size[1]) % 9  # the smallest decode
    for small_length in {width * height * n // 2 for n in (2, 3, 4, 6, 8)}:
        with suppress(LogError):
            small = Frame(0, encoding, bytes(small_length), (width, height))
            assert small.decode().shape == (height, width, 3)


@given(
    fields=st.tuples(*[st.integers(0, 20) | st.integers(0, 2**32 - 1)] * 3),
    length=st.integers(0, 300),
)
def test_what_a_message_claims_is_believed_only_if_it_is_there(
    tmp_path_factory, fields: tuple[int, int, int], length: int
):
    width, height, step = fields
    path = tmp_path_factory.mktemp("claims") / "a.mcap"
    write_pictures(path, [image(STAMP_NS, "rgb8", (width, height), bytes(length), step)])
    row = step or 3 * width
    is_there = width * height > 0 and row >= 3 * width and row * height <= length
    sizes = [(one.size, len(one.data)) for one in read_episode(path).frames()]
    assert sizes == ([((width, height), 3 * width * height)] if is_there else [])
