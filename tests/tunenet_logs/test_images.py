"""Images keep their bytes, and a header's claim is checked before memory is spent on it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from tunenet_logs.episode import Frame
from tunenet_logs.errors import LogError
from tunenet_logs.images import image_size

PICTURE = np.zeros((48, 64, 3), np.uint8)
PICTURE[:, :32] = (255, 0, 0)  # red, in RGB


def encoded(suffix: str) -> bytes:
    return cv2.imencode(suffix, PICTURE[:, :, ::-1])[1].tobytes()


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_decodes_to_rgb(suffix: str):
    decoded = Frame(0, suffix[1:], encoded(suffix)).decode()
    assert decoded.shape == PICTURE.shape
    assert np.abs(decoded[:, :24].astype(int) - PICTURE[:, :24]).max() < 10


@pytest.mark.parametrize("suffix", [".jpg", ".png"])
def test_reads_the_size_without_decoding(suffix: str):
    assert image_size(encoded(suffix)) == (64, 48)


def test_refuses_a_forged_size():
    data = bytearray(encoded(".jpg"))
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = (30_000).to_bytes(2, "big") * 2
    with pytest.raises(LogError, match="30000 x 30000"):
        Frame(0, "jpeg", bytes(data)).decode()


@pytest.mark.parametrize("data", [b"", b"\xff\xd8", b"\xff\xd8\xff\xff\xff\xff", b"hello" * 9])
def test_refuses_what_is_no_image(data: bytes):
    with pytest.raises(LogError):
        Frame(0, "jpeg", data).decode()
