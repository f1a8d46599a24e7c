"""MCAP files by others: in each topic, as many messages as the library finds."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader

from tests.conftest import real
from tunenet_logs.errors import LogError
from tunenet_logs.reader import read_episode


def counted(path: Path) -> Counter[str]:
    with path.open("rb") as file:
        found = NonSeekingReader(file).iter_messages(log_time_order=False)
        return Counter(channel.topic for _, channel, _ in found)


def counted_by_us(path: Path) -> Counter[str] | str:
    """The counts, or why there are none."""
    ours: Counter[str] = Counter()
    try:
        channels = read_episode(path).channels
    except LogError as error:
        return str(error)
    for channel in channels:
        ours[channel.topic] += channel.messages
    return +ours


@pytest.mark.parametrize("folder", ["mcap_rosbag2", "mcap_conformance"])
def test_the_counts_are_those_of_the_library(folder: str):
    paths = sorted(real(folder).glob("*.mcap"))
    assert paths
    counts = {path.name: (counted_by_us(path), counted(path)) for path in paths}
    assert not {name: both for name, both in counts.items() if both[0] != both[1]}
