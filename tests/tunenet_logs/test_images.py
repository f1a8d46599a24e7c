"""Pictures: of every encoding as their pixels were, and no claim of theirs believed too far."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

import av
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
    packets,
    png,
    video,
    write_pictures,
)
from tunenet_logs import messages
from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError, TuneNetError
from tunenet_logs.images import (
    MAX_PIXELS,
    decode_image,
    image_format,
    image_size,
    mean_of_blocks,
)
from tunenet_logs.reader import read_episode
from tunenet_logs.video import CODECS, Packet, decoded, decoded_frame

PICTURE = np.zeros((48, 64, 3), np.uint8)
PICTURE[:, :32] = (255, 0, 0)  # red, in RGB
LOSSY_WEBP = [cv2.IMWRITE_WEBP_QUALITY, 90]


def encoded(suffix: str, settings_: list[int] | None = None) -> bytes:
    return cv2.imencode(suffix, PICTURE[:, :, ::-1], settings_ or [])[1].tobytes()


JPEG = encoded(".jpg")


def with_size(width: int, height: int, filler: int = 0) -> bytes:
    """A JPEG of 64 x 48 px that claims another size, with bytes in it that mean nothing."""
    data = bytearray(JPEG)
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = height.to_bytes(2, "big") + width.to_bytes(2, "big")
    comment = b"\xff\xfe\xff\xff" + bytes(0xFFFD)
    return bytes(data[:2]) + comment * (filler // 0xFFFF) + bytes(data[2:])


def extended_webp(flags: int = 0) -> bytes:
    """A lossy WebP with the header of one that has extras."""
    inner = encoded(".webp", LOSSY_WEBP)[12:]
    size = b"".join((one - 1).to_bytes(3, "little") for one in (64, 48))
    body = b"WEBPVP8X" + (10).to_bytes(4, "little") + bytes([flags, 0, 0, 0]) + size + inner
    return b"RIFF" + len(body).to_bytes(4, "little") + body


WHOLE = {
    "jpeg": JPEG,
    "png": encoded(".png"),
    "lossless webp": encoded(".webp"),
    "lossy webp": encoded(".webp", LOSSY_WEBP),
    "extended webp": extended_webp(),
}


@pytest.mark.parametrize("name", WHOLE)
def test_it_is_known_by_its_content_and_decodes_to_rgb(name: str):
    """Whatever a message says that it is; its size without decoding."""
    data = WHOLE[name]
    assert image_format(data) == name.rsplit(maxsplit=1)[-1]
    decoded = Frame(0, "bgr8; something compressed", data).decode()
    assert decoded.shape == PICTURE.shape
    assert np.abs(decoded[:, :24].astype(int) - PICTURE[:, :24]).max() < 10
    assert image_size(data) == Frame(0, "", data).size_px() == (64, 48)
    assert image_format(b"GIF89a") is None


def test_sixteen_bits_are_shown_by_the_upper_eight():
    grey = np.arange(48 * 64, dtype=np.uint16).reshape(48, 64) * 21
    decoded = Frame(0, "mono16; png compressed ", cv2.imencode(".png", grey)[1].tobytes()).decode()
    assert np.abs(decoded - (grey // 256)[..., None].astype(int)).max() <= 1


def test_a_note_to_turn_the_picture_changes_no_pixel():
    entry = b"\x01\x12\x00\x03\x00\x00\x00\x01\x00\x06\x00\x00"
    exif = b"Exif\0\0MM\x00\x2a\x00\x00\x00\x08\x00\x01" + entry + bytes(4)
    turned = JPEG[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + JPEG[2:]
    frame = Frame(0, "jpeg", turned)
    assert frame.size_px() == (64, 48)
    assert np.array_equal(frame.decode(), Frame(0, "jpeg", JPEG).decode())
    for least_px in (8, 16, 32):
        small = decode_image(turned, "jpeg", least_px)
        assert np.array_equal(small, decode_image(JPEG, "jpeg", least_px))


def hidden_size(marker: int) -> bytes:
    """Behind a marker whose bytes we would take for a length, and a decoder would not."""
    true = with_size(30_000, 30_000)
    decoy = b"\xff\xc0\x00\x11\x08\x00\x30\x00\x40" + bytes(10)
    return true[:2] + b"\xff" + bytes([marker]) + b"\xff\xfe" + bytes(0xFFFC) + decoy + true[2:]


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (with_size(30_000, 30_000), "30000 x 30000"),
        (with_size(6001, 6000, filler=200_000), "over the limit"),
        (with_size(4000, 3000), "damaged"),
        *((hidden_size(marker), "") for marker in (0x00, 0x01, 0xD0, 0xD8, 0xD9)),
        (extended_webp(flags=2), ""),  # it moves
        (b"", ""),
        (b"\xff\xd8", ""),
        (b"\xff\xd8\xff\xff\xff\xff", ""),
        (b"hello" * 9, ""),
        (b"\xff\xd8" + b"\xff" * 10_000_000, ""),
        (b"\xff\xd8" + b"\xff\xfe\x00\x02" * 2_000_000, ""),
        *((one[:end], "") for one in WHOLE.values() for end in (15, 23, 29)),
    ],
)
def test_what_is_no_image_is_refused(data: bytes, says: str):
    with pytest.raises(LogError, match=says or None):
        Frame(0, "jpeg", data).decode()


def test_the_largest_image_is_read():
    assert image_size(with_size(6000, 6000, filler=200_000)) == (6000, 6000)
    assert MAX_PIXELS == 6000 * 6000


# Pictures of other people's logs: every encoding as its pixels were, nothing believed too far.
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


# Video in messages: each picture at its own message's stamp, whatever is missing or damaged.
FILM_WIDTH, FILM_HEIGHT, COUNT = 160, 96, 40
START_NS, PERIOD_NS = 1_700_000_000_000_000_003, 16_666_667
ALL = list(range(COUNT))
CODECS_WRITTEN = ("h264", "h265", "vp9", "av1")
each_codec = pytest.mark.parametrize("codec", CODECS_WRITTEN)


def numbered(count: int = COUNT) -> Iterator[np.ndarray]:
    """Grey pictures in which a bright column says which one it is."""
    for number in range(count):
        pixels = np.full((FILM_HEIGHT, FILM_WIDTH, 3), 60, np.uint8)
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
        assert (frame.encoding, frame.size_px()) == ("rgb8", (FILM_WIDTH, FILM_HEIGHT))
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
        image(stamp(number), "rgb8", (FILM_WIDTH, FILM_HEIGHT), pixels.tobytes())
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
    assert peak < 6 * FILM_WIDTH * FILM_HEIGHT * 3 + 300_000
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
    assert messages.compressed(later).stamp_ns == 9


def blobs(width: int, height: int) -> bytes:
    """A JPEG of soft blobs."""
    coarse = np.random.default_rng(0).integers(0, 255, (height // 99, width // 99, 3), np.uint8)
    return cv2.imencode(".jpg", cv2.resize(coarse, (width, height)))[1].tobytes()


@pytest.mark.parametrize("size", [(3840, 2160), (4032, 3024)], ids=["4K", "12 megapixels"])
def test_pictures_of_usual_sizes_are_the_mean_of_their_blocks(size: tuple[int, int]):
    frame = Frame(0, "jpeg", blobs(*size))
    assert frame.coarse == 1
    assert (frame.decode(8) == mean_of_blocks(decode_image(frame.data, "jpeg"), 8)).all()


@pytest.mark.parametrize("size", [(4501, 3003), (4800, 3607)])
def test_a_large_jpeg_is_reduced_while_it_is_decoded(size: tuple[int, int]):
    frame = Frame(0, "jpeg", blobs(*size))
    assert frame.coarse == 4
    for scale in (4, 12):
        expected = mean_of_blocks(decode_image(frame.data, "jpeg"), scale).astype(int)
        found = frame.decode(scale)
        assert found.shape == (size[1] // scale, size[0] // scale, 3) == expected.shape
        assert np.abs(found - expected).max() <= 4
    assert frame.decode().shape == (size[1], size[0], 3)
