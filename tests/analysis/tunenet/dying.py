"""Work whose processes die: a module that is quickly imported, as each of them does."""

from __future__ import annotations

import os
import signal
from collections.abc import Sequence
from pathlib import Path

import numpy as np


def dies_once(folder: Path, items: Sequence[int]) -> np.ndarray:
    """The process of the first chunk dies, the first time."""
    mark = folder / "died"
    if 0 in items and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return np.array(items, float)[:, None, None]


def dies(items: Sequence[int]) -> np.ndarray:
    os.kill(os.getpid(), signal.SIGKILL)
    return np.array(items, float)[:, None, None]
