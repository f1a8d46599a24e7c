"""Videos that claim much and hold little: refused in a line, with little memory."""

from __future__ import annotations

from collections import deque
from pathlib import Path

import pytest

from tests.conftest import BIN
from tests.hostile import spent
from tests.mp4_bombs import fragment_of_many, mp4_of_many
from tunenet_logs.errors import LogError
from tunenet_logs.media import Mp4Claims

COUNT = 80_000_000
MAX_KIB = 500_000  # each took 1 to 3 GB


@pytest.mark.parametrize("bomb", [mp4_of_many(COUNT), fragment_of_many(COUNT)])
@pytest.mark.parametrize(
    "words", [("tunenet-tune", "film.mp4"), ("tunenet-record", "--camera", "film.mp4")]
)
def test_an_mp4_that_claims_far_too_much_is_refused(
    tmp_path: Path, words: tuple[str, ...], bomb: bytes
):
    (tmp_path / "film.mp4").write_bytes(bomb)
    program, *rest = words
    told = spent([str(BIN / program), *rest], tmp_path)
    assert told.code == 1
    assert told.peak_kib < MAX_KIB
    assert f"claims {COUNT} samples in {len(bomb)} bytes; cut the drop out of it" in told.said
    assert told.said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir() if path.suffix == ".mcap"] == []


@pytest.mark.parametrize("bomb", [mp4_of_many(COUNT), fragment_of_many(COUNT)])
def test_it_is_seen_wherever_a_read_cuts_it(bomb: bytes):
    for cut in range(len(bomb)):
        claims = Mp4Claims(len(bomb))
        with pytest.raises(LogError, match=f"claims {COUNT} samples"):
            deque(map(claims.check, (bomb[:cut], bomb[cut:])), 0)


def test_what_a_file_s_size_is_worth_may_be_claimed():
    Mp4Claims().check(mp4_of_many(5_000_000))
    Mp4Claims(16 * COUNT).check(mp4_of_many(COUNT))
