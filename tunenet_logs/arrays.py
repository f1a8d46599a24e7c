"""What numbers are kept in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Real numbers; the shape is said where it is used."""

Picture = NDArray[np.uint8]
"""Pixels: (height, width, 3) of RGB, or of BGR where it is said, or (height, width) of grey."""
