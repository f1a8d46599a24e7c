"""The physics engines that this Python has."""

from __future__ import annotations

from importlib.util import find_spec

import pytest

HAS_PYBULLET = find_spec("pybullet") is not None

needs_pybullet = pytest.mark.skipif(
    not HAS_PYBULLET, reason="PyBullet has no wheels for this Python or platform"
)
