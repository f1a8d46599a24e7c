"""Images keep their bytes, and a header's claim is checked before memory is spent on it."""

from __future__ import annotations

import zlib
from contextlib import suppress

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError, TuneNetError
from tunenet_logs.images import MAX_PIXELS, decode_image, image_format, image_size

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


@given(name=st.sampled_from(sorted(WHOLE)), data=st.data())
def test_a_damaged_image_decodes_or_is_refused(name: str, data: st.DataObject):
    whole = bytearray(WHOLE[name])
    for _ in range(data.draw(st.integers(1, 4))):
        whole[data.draw(st.integers(0, len(whole) - 1))] = data.draw(st.integers(0, 255))
    broken = bytes(whole[: data.draw(st.integers(0, len(whole)))])
    if name == "png" and len(broken) >= 33:  # else hardly any would pass its checksums
        broken = broken[:29] + zlib.crc32(broken[12:29]).to_bytes(4, "big") + broken[33:]
    with suppress(TuneNetError):
        pixels = Frame(0, "jpeg", broken).decode()
        assert pixels.dtype == np.uint8
        assert pixels.shape[2:] == (3,)


@pytest.mark.parametrize(("least_px", "size"), [(8, (6, 8)), (16, (12, 16)), (17, (24, 32))])
def test_a_jpeg_is_decoded_small(least_px: int, size: tuple[int, int]):
    small = decode_image(JPEG, "jpeg", least_px)
    assert small.shape == (*size, 3)
    expected = cv2.resize(PICTURE, size[::-1], interpolation=cv2.INTER_AREA)
    assert np.abs(small.astype(int) - expected).mean() < 8


def test_what_cannot_be_decoded_small_is_decoded_whole():
    assert decode_image(JPEG, "jpeg", 33).shape == PICTURE.shape
    assert np.array_equal(decode_image(encoded(".png"), "png", 8), PICTURE)
    for damaged in (with_size(30_000, 30_000), JPEG[:200], b"\xff\xd8"):
        with pytest.raises(LogError):
            decode_image(damaged, "jpeg", 8)
