"""MCAP files by others: in each topic, as many messages as the library finds."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader

from tests.conftest import ROOT, real
from tunenet_logs.reader import read_episode

FOLDERS = ("mcap_rosbag2", "mcap_conformance")
REAL = ROOT.parent / "shared" / "real"
NAMES = [f"{one}/{path.name}" for one in FOLDERS for path in sorted((REAL / one).glob("*.mcap"))]


def counted(path: Path) -> Counter[str]:
    with path.open("rb") as file:
        found = NonSeekingReader(file).iter_messages(log_time_order=False)
        return Counter(channel.topic for _, channel, _ in found)


@pytest.mark.parametrize("name", NAMES or ["mcap_rosbag2"])
def test_the_counts_are_those_of_the_library(name: str):
    path = real(name)
    ours: Counter[str] = Counter()
    for channel in read_episode(path).channels:
        ours[channel.topic] += channel.messages
    assert +ours == counted(path)
