"""What the tests of the sandbox run in it."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from typing import Any

from tunenet_logs.formats.sandbox import Refusal

Yields = Iterator[tuple[Any, dict[str, Any]]]
kept: list[int] = []


def doubled(number: int, arrays: dict[str, Any]) -> Yields:
    yield number + 1, {name: one * 2 for name, one in arrays.items()}


def counted(count: int) -> Yields:
    import numpy as np

    for number in range(count):
        yield f"number {number}", {"empty": np.zeros((0, 3)), "text": np.array(["a", "bc"])}


def remembers(number: int) -> Yields:
    kept.append(number)
    yield kept, {}


def refuses() -> Yields:
    yield 1, {}
    raise Refusal("it is of wood", "take one of steel")


def raises() -> Yields:
    raise KeyError("no such\nthing")
    yield


def prints() -> Yields:
    os.write(1, b"noise\n" * 1000)
    os.write(2, b"noise\n" * 1000)
    yield "quiet", {}


def killed(number: int) -> Yields:
    os.kill(os.getpid(), number)
    yield 0, {}


def crashes() -> Yields:
    import ctypes

    ctypes.string_at(0)
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


def leaves() -> Yields:
    os._exit(0)
    yield


def objects() -> Yields:
    import numpy as np

    yield 0, {"a": np.array([signal], object)}


def much(count: int) -> Yields:
    import numpy as np

    yield 0, {"a": np.zeros(count)}
