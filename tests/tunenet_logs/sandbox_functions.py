"""What the tests of the sandbox run in it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from typing import Any

from tunenet_logs.formats.sandbox import Refusal

Yields = Iterator[tuple[Any, dict[str, Any]]]


def refuses() -> Yields:
    yield 1, {}
    raise Refusal("it is of wood", "take one of steel")


def raises() -> Yields:
    raise KeyError("no such\nthing")
    yield


def killed(number: int) -> Yields:
    os.kill(os.getpid(), number)
    yield 0, {}


def eats() -> Yields:
    held = []
    while True:
        held.append(bytearray(2**24))
        yield len(held), {}


def loops() -> Yields:
    while True:
        pass
    yield


def sleeps() -> Yields:
    time.sleep(1000)
    yield 0, {}


def objects() -> Yields:
    import numpy as np

    yield 0, {"a": np.array([signal], object)}
