"""What may be the ball in all pictures, as one table."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis.tracking.blobs import Blobs
from tunenet_logs.arrays import Array


@dataclass(frozen=True, eq=False)
class Candidates:
    """The blobs of all pictures as one table, NaN where a picture has fewer.

    Attributes:
        seconds: shape (T,).
        places_px: shape (T, M, 2).
        areas_px: shape (T, M).
        colours: shape (T, M, 3).
        whole: shape (T, M).
        misfits: shape (T, M).
    """

    seconds: Array
    places_px: Array
    areas_px: Array
    colours: Array
    whole: NDArray[np.bool_]
    misfits: Array

    def inside(self) -> Candidates:
        """Without those that the picture's edge cuts: arms and people, not balls."""
        places = np.where(self.whole[:, :, None], self.places_px, np.nan)
        areas = np.where(self.whole, self.areas_px, np.nan)
        return replace(self, places_px=places, areas_px=areas)

    def some(self, frames: NDArray[np.intp]) -> Candidates:
        """Those of some pictures."""
        return Candidates(
            self.seconds[frames],
            self.places_px[frames],
            self.areas_px[frames],
            self.colours[frames],
            self.whole[frames],
            self.misfits[frames],
        )


def tabulate(seconds: Array, blobs: Sequence[Blobs]) -> Candidates:
    """Put the blobs of T pictures into one table."""
    most = max((len(one) for one in blobs), default=0)
    places = np.full((len(blobs), most, 2), np.nan)
    areas = np.full((len(blobs), most), np.nan)
    colours = np.full((len(blobs), most, 3), np.nan)
    whole = np.zeros((len(blobs), most), dtype=bool)
    misfits = np.zeros((len(blobs), most))
    for index, one in enumerate(blobs):
        places[index, : len(one)] = one.places_px
        areas[index, : len(one)] = one.areas_px
        colours[index, : len(one)] = one.colours
        whole[index, : len(one)] = one.whole
        misfits[index, : len(one)] = one.misfits
    return Candidates(seconds, places, areas, colours, whole, misfits)
