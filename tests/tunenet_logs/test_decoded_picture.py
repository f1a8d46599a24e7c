"""Pictures of a decoded video: made RGB when they are asked for, at the size that is wanted."""

from __future__ import annotations

from dataclasses import replace

import av
import numpy as np
import pytest

from tunenet_logs import messages
from tunenet_logs.images import mean_of_blocks
from tunenet_logs.messages import compressed
from tunenet_logs.video import decoded_frame


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
