"""Whether a log is made again as it is kept, on whatever processor."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mcap.reader import make_reader

from tunenet_logs.reader import read_episode


def assert_same_log(made: Path, kept: Path) -> None:
    """To the byte; signals to the last bits of sines and logarithms, where processors differ."""
    if made.read_bytes() == kept.read_bytes():
        return
    one, other = read_episode(made), read_episode(kept)
    assert one.info == other.info, kept.name
    assert one.signals, f"{kept.name}: other pictures"
    assert one.signals.keys() == other.signals.keys()
    differs = False
    for topic, signal in one.signals.items():
        differs |= not np.array_equal(signal.values, other.signals[topic].values)
        np.testing.assert_array_equal(signal.stamps_ns, other.signals[topic].stamps_ns)
        np.testing.assert_allclose(signal.values, other.signals[topic].values, rtol=0, atol=1e-12)
    with made.open("rb") as first, kept.open("rb") as second:
        pairs = zip(*(make_reader(file).iter_messages() for file in (first, second)), strict=True)
        for (_, channel, message), (_, other_channel, again) in pairs:  # poses that are no signals
            assert (channel.topic, message.log_time) == (other_channel.topic, again.log_time)
            differs |= message.data != again.data
            words = [
                np.frombuffer(one.data, "<f8", (len(one.data) - 4) // 8, offset=4)
                for one in (message, again)
            ]  # of CDR, text among them, which is alike or not
            np.testing.assert_allclose(*words, rtol=0, atol=1e-12)
    assert differs, f"{kept.name}: the same messages, but other bytes"
