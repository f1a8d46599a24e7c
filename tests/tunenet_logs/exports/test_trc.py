"""TRC files, as different programs write them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.conftest import real
from tests.export_writers import write_trc
from tests.tunenet_logs.exports.tracks import BALL, RATE_HZ, SECONDS, TRACKS, read
from tunenet_logs.errors import LogError

SEEN = np.isfinite(BALL[:, 0])


def take(folder: Path, **options: object) -> Path:
    path = folder / "take.trc"
    write_trc(path, SECONDS, TRACKS, rate_hz=RATE_HZ, **options)  # type: ignore[arg-type]
    return path


@pytest.mark.parametrize("separator", ["\t", ",", ";"])
def test_tabs_or_commas(tmp_path: Path, separator: str):
    ball = read(take(tmp_path, separator=separator)).signals["Ball 1"]
    np.testing.assert_allclose(ball.values[:, 1], BALL[SEEN, 2], atol=1e-6)


def changed(path: Path, line: int, text: str) -> None:
    lines = path.read_text().splitlines()
    lines[line] = text
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.parametrize(
    ("line", "text"),
    [
        (3, "Frame#\tTime\t\tBall 1\t\t\tOther\t\t"),
        (3, "Frame#\tTime\tBall 1\tOther"),
        (3, "Frame#\tTime\tBall 1\t\t\tOther\t\t\t\t\t\t\t\t"),
        (4, "\t\t\tX1\tY1\tZ1\tX2\tY2\tZ2"),
        (4, "X1\tY1\tZ1\tX2\tY2\tZ2"),
    ],
)
def test_names_and_axes_may_stand_elsewhere(tmp_path: Path, line: int, text: str):
    path = take(tmp_path)
    changed(path, line, text)
    episode = read(path)
    assert list(episode.signals) == list(TRACKS)
    np.testing.assert_allclose(episode.signals["Ball 1"].values[:, 1], BALL[SEEN, 2], atol=1e-6)


def test_the_empty_line_or_the_axes_may_be_missing(tmp_path: Path):
    path = take(tmp_path)
    lines = path.read_text().splitlines()
    for left in (lines[:5] + lines[6:], lines[:4] + lines[6:]):
        path.write_text("\n".join(left) + "\n")
        assert len(read(path).signals["Ball 1"].stamps_ns) == SEEN.sum()


@pytest.mark.parametrize("unseen", ["NaN", "nan", "Nan", "NAN", "nAn", " ", "0"])
def test_unseen_is_written_in_many_ways(tmp_path: Path, unseen: str):
    path = take(tmp_path)
    path.write_text(path.read_text().replace("\t\t\t", f"\t{unseen}\t{unseen}\t"))
    changed(path, 3, "Frame#\tTime\tBall 1\t\t\tOther\t\t")
    changed(path, 4, "\t\tX1\tY1\tZ1\tX2\tY2\tZ2")
    episode = read(path)
    assert episode.losses == ()
    assert len(episode.signals["Ball 1"].stamps_ns) == SEEN.sum()


def test_times_are_exact_where_the_file_rounds_them(tmp_path: Path):
    path = take(tmp_path)
    lines = path.read_text().splitlines()
    rows = [line.split("\t") for line in lines[6:]]
    cut = ["\t".join([row[0], f"{float(row[1]):.3f}", *row[2:]]) for row in rows]
    path.write_text("\n".join([*lines[:6], *cut]) + "\n")
    np.testing.assert_allclose(read(path).signals["Ball 1"].seconds, SECONDS[SEEN], atol=2e-9)


def test_times_that_are_not_even_are_believed(tmp_path: Path):
    path = take(tmp_path)
    path.write_text(path.read_text().replace("120.00", "60.00"))
    np.testing.assert_allclose(read(path).signals["Ball 1"].seconds, SECONDS[SEEN], atol=1e-6)


def test_without_a_marker_it_is_refused(tmp_path: Path):
    path = tmp_path / "take.trc"
    path.write_text("PathFileType\t4\t(X/Y/Z)\ttake.trc\nDataRate\n100\n")
    with pytest.raises(LogError, match="TRC file of markers that names no marker"):
        read(path)


def test_a_file_of_a_laboratory_says_what_it_lacks():
    episode = read(real("labs/markers.trc"))
    assert len(episode.signals) == 51
    assert "93 of the 652 frames" in episode.losses[0]
