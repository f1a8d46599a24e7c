"""What every encoding of messages offers: a decoder for a channel, or the reason for none."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from tunenet_logs.formats.base import RawChannel

Decode = Callable[[bytes | memoryview], Any]
"""From a message's bytes to an object with its fields. Raises MessageError."""

Codec = Callable[[RawChannel], Decode]
"""Makes the decoder for a channel. Raises UnusableError."""


class UnusableError(Exception):
    """Why no message of a channel can be used; shown by `tunenet-logs info`."""


class MessageError(Exception):
    """Why one message cannot be used; the messages are counted."""
