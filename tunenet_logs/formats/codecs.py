"""The encodings of messages that are read, by name. A new one is one file, and one line here."""

from __future__ import annotations

from tunenet_logs.formats.base import RawChannel
from tunenet_logs.formats.codec import Codec, Decode, UnusableError
from tunenet_logs.formats.json_messages import json_decoder
from tunenet_logs.formats.protobuf import protobuf_decoder
from tunenet_logs.formats.ros import cdr_decoder, ros1_decoder

CODECS: dict[str, Codec] = {
    "cdr": cdr_decoder,
    "ros1": ros1_decoder,
    "protobuf": protobuf_decoder,
    "json": json_decoder,
}


def check_encoding(channel: RawChannel) -> None:
    """Whether messages of that encoding are read at all.

    Raises:
        UnusableError: they are not.
    """
    if channel.encoding not in CODECS:
        known = ", ".join(CODECS)
        raise UnusableError(
            f"message encoding {channel.encoding[:20]!r} is not read (only {known})"
        )


def decoder_for(channel: RawChannel) -> Decode:
    """How the channel's messages are decoded.

    Raises:
        UnusableError: they cannot be.
    """
    check_encoding(channel)
    return CODECS[channel.encoding](channel)
