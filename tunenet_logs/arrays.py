"""NumPy array types shared by the package."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  # real numbers; the shape is said where it is used
# Pixels: (height, width, 3) of RGB, or of BGR where it is said, or (height, width) of grey.
Picture = NDArray[np.uint8]
