"""Check of a still camera: without a still background no ball can be found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from analysis.tracking.background import middle_of
from tunenet_logs.arrays import Array, Picture
from tunenet_logs.errors import NotFoundError

# To which the longer side of a picture is reduced: noise and a shaking hand average out.
_SIDE_PX = 240

_TILES = 6  # a picture's tiles, each way
# Standard deviation [of 255] of a tile that shows something: more than a wall and noise.
_TEXTURE = 8.0

# Tiles of 36 that show something, in most pictures: in fewer it may be what moves, an arm or a
# large ball.
_MIN_COUNT = 14

_SAME = 0.7  # correlation of a tile with the still picture's, below which it shows something else
# Of the tiles that show something, and of the pictures: with more the background is none.
_MAX_ELSEWHERE = 0.5


def check_still(samples: Sequence[Picture]) -> None:
    """Check that the camera is still, before the costly search for what flies.

    Raises:
        NotFoundError: most pictures show something else than the median of all.
    """
    share = share_elsewhere(samples)
    if share > _MAX_ELSEWHERE:
        raise NotFoundError(
            f"the camera moves: {100 * share:.0f} % of the pictures looked at show another view; "
            "at the next drop: fix the camera, or tune the part in which it stands still "
            "(--start, --end)"
        )


def share_elsewhere(samples: Sequence[Picture]) -> float:
    """Return the fraction of pictures most of whose textured tiles differ from the median's."""
    reduced = [_reduced(sample) for sample in samples]
    still = _tiles(middle_of(reduced))
    spread = still.std(axis=1)
    seen, changed = np.zeros(len(reduced)), np.zeros(len(reduced))
    for at, picture in enumerate(reduced):  # all at once would take much memory
        tiles = _tiles(picture)
        spreads = tiles.std(axis=1)
        shown = np.maximum(spreads, spread) > _TEXTURE
        alike = (tiles * still).mean(axis=1) / np.maximum(spreads * spread, 1e-3)
        seen[at], changed[at] = shown.sum(), (shown & (alike < _SAME)).sum()
    return float(np.mean(changed > _MAX_ELSEWHERE * seen)) if np.median(seen) >= _MIN_COUNT else 0.0


def _reduced(picture: Picture) -> Picture:
    """Reduce a picture to its brightness, small and smooth, shape (H, W)."""
    import cv2

    scale = min(1.0, _SIDE_PX / max(picture.shape[:2]))
    grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
    small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.GaussianBlur(small, (3, 3), 0), np.uint8)


def _tiles(picture: Picture) -> Array:
    """Cut a picture of shape (H, W) into tiles, each less its mean, shape (tiles, pixels)."""
    tall, wide = picture.shape[0] // _TILES, picture.shape[1] // _TILES
    cut = picture[: tall * _TILES, : wide * _TILES].astype(np.float64)
    parts = cut.reshape(_TILES, tall, _TILES, wide).transpose(0, 2, 1, 3)
    tiles = parts.reshape(_TILES * _TILES, tall * wide)
    return tiles - tiles.mean(axis=1, keepdims=True)
