"""Pictures of a decoded video: made RGB when they are asked for, at the size that is wanted."""

from __future__ import annotations

from dataclasses import replace

import av
import numpy as np
import pytest

from tunenet_logs import messages
from tunenet_logs.formats.decoded_picture import decoded_frame
from tunenet_logs.jpeg import compressed
from tunenet_logs.pixels import mean_of_blocks


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
    off = small.astype(int) - mean_of_blocks(whole, scale)
    assert np.abs(off).max() <= 6  # of 255: colours are rounded before and after
    assert np.abs(off.mean(axis=(0, 1))).max() < 1.5


@pytest.mark.parametrize("scale", [2, 3, 5])
def test_a_ball_stays_where_it_is(scale: int):
    y, x = np.mgrid[:90, :120]
    disc = np.clip(12.5 - np.hypot(x - 51.3, y - 40.7), 0, 1)
    rgb = (60 + disc[:, :, None] * np.array([160, 90, 20])).astype(np.uint8)
    video = av.VideoFrame.from_ndarray(rgb, format="rgb24").reformat(format="yuv420p")
    small = decoded_frame(0, video).decode(scale).astype(float)[:, :, 0] - 60
    rows, columns = np.mgrid[: small.shape[0], : small.shape[1]]
    small[small < 10] = 0
    middle = [(small * one).sum() / small.sum() for one in (columns, rows)]
    wanted = [(one + 0.5) / scale - 0.5 for one in (51.3, 40.7)]
    assert middle == pytest.approx(wanted, abs=0.05)


def test_pixels_that_alternate_stand_for_their_mean():
    board = np.indices((40, 40)).sum(axis=0) % 2 * 255
    rgb = np.repeat(board[:, :, None], 3, axis=2).astype(np.uint8)
    frame = decoded_frame(0, av.VideoFrame.from_ndarray(rgb, format="rgb24"), dithered=True)
    assert np.ptp(frame.decode()[5:-5, 5:-5].astype(int)) < 10


def test_it_is_written_as_it_is_seen():
    frame = decoded_frame(5, picture(16, 8))
    _, data = messages.frame(frame)
    assert frame.decode().tobytes() in data
    later = replace(frame, stamp_ns=9)
    assert np.array_equal(later.decode(), frame.decode())
    assert compressed(later).stamp_ns == 9
