"""Numbered pictures in a folder or a zip, and an animated WebP, as films."""

from __future__ import annotations

import shutil
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.analysis.films import short_film
from tests.conftest import Made
from tests.reading import tuned
from tunenet_logs.episode import FRAME_NS, Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode

COUNT = 12
PNGS = [f"{number}.png" for number in range(COUNT)]


def numbered(number: int) -> np.ndarray:
    """RGB, a brightness that tells the number."""
    return np.full((24, 32, 3), 20 * number, np.uint8)


def encoded(number: int, suffix: str, depth: int = 8) -> bytes:
    pixels = numbered(number)
    if depth > 8:  # of 12 bits in 16
        pixels = pixels[:, :, 0].astype(np.uint16) << 4
    return cv2.imencode(suffix, pixels)[1].tobytes()


def folder_of(path: Path, names: Sequence[str] = PNGS, depth: int = 8) -> Path:
    path.mkdir()
    for number, name in enumerate(names):
        (path / name).write_bytes(encoded(number, Path(name).suffix, depth))
    return path


def zip_of(path: Path, names: Sequence[str] = PNGS) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number, name in enumerate(names):
            archive.writestr(name, encoded(number, Path(name).suffix))
    return path


def order_of(episode: Episode, topic: str | None = None) -> list[int]:
    """Which pictures they are."""
    return [round(float(frame.decode().mean()) / 20) for frame in episode.frames(topic)]


def stamps_of(episode: Episode) -> list[int]:
    return [frame.stamp_ns for frame in episode.frames()]


TIMES = [1403636579763555584 + 50_000_000 * number for number in range(COUNT)]


@pytest.mark.parametrize(
    ("names", "fps", "stamps", "says"),
    [
        *(([f"take2_img{n}{suffix}" for n in range(COUNT)], 500,
           [2_000_000 * n for n in range(COUNT)], "")
          for suffix in (".png", ".jpg", ".bmp", ".tif", ".webp", ".ppm")),
        (PNGS, None, [FRAME_NS * n for n in range(COUNT)], "say it with --fps"),
        ([f"{10 * n}.png" for n in range(COUNT) if n != 3], 100,
         [10_000_000 * n for n in range(COUNT) if n != 3],
         "1 numbers between the first and the last have no picture"),
        ([f"{one}.png" for one in TIMES], None, TIMES, ""),  # names that are the clock
    ],
)  # fmt: skip
def test_numbers_count_and_not_letters(
    tmp_path: Path, names: list[str], fps: float | None, stamps: list[int], says: str
):
    episode = read_episode(folder_of(tmp_path / "a", names), ReadOptions(fps=fps))
    assert order_of(episode) == list(range(len(names)))
    assert stamps_of(episode) == stamps
    assert says in " ".join(episode.warnings)
    assert episode.frames_untimed == (names is PNGS)
    if names is PNGS:
        assert episode.info.notes["rate_hz"] == "unknown"


def test_two_cameras_are_two_films_and_twelve_bits_in_sixteen_are_not_dark(tmp_path: Path):
    names = [f"{side}_{number}.png" for number in range(5) for side in ("left", "right")]
    episode = read_episode(folder_of(tmp_path / "a", [*names, "calibration.png"]))
    assert episode.picture_topics == ("left", "right")
    assert order_of(episode, "right") == [1, 3, 5, 7, 9]
    assert [one.topic for one in episode.channels if one.skipped] == ["calibration.png"]
    for suffix in (".tif", ".png"):
        deep = [f"{number}{suffix}" for number in range(COUNT)]
        assert order_of(read_episode(folder_of(tmp_path / suffix, deep, 12))) == list(range(COUNT))


def test_no_link_is_followed_and_damage_is_counted(tmp_path: Path):
    path = folder_of(tmp_path / "a")
    (tmp_path / "secret.png").write_bytes(encoded(1, ".png"))
    (path / "99.png").symlink_to(tmp_path / "secret.png")
    (path / "3.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))
    frames = list(read_episode(path).frames())
    assert len(frames) == COUNT
    with pytest.raises(LogError):
        frames[3].decode()


def test_a_zip_is_read_where_it_lies(tmp_path: Path):
    names = [f"../drop/{number}.png" for number in range(COUNT)]
    path = zip_of(tmp_path / "a.zip", [*names, "__MACOSX/drop/._1.png"])
    assert order_of(read_episode(path, ReadOptions(fps=100))) == list(range(COUNT))
    assert sorted(tmp_path.iterdir()) == [path]
    data = zip_of(path, PNGS[:4]).read_bytes()
    at = data.rindex(b"PK\x01\x02")  # the directory's last entry: its name becomes a remark
    name = len("3.png").to_bytes(2, "little")
    assert data[at + 28 : at + 30] == name
    path.write_bytes(data[: at + 28] + bytes(2) + bytes(2) + name + data[at + 34 :])
    assert len(list(read_episode(path).frames())) == 3  # a file without a name is no picture


def bomb(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(10):
            archive.writestr(f"{number}.bmp", bytes(40_000_000))


def of_many(path: Path) -> None:
    data = bytearray(zip_of(path).read_bytes())
    data[-10:-6] = b"\xff\xff\xff\x7f"
    path.write_bytes(data)


def cut(path: Path) -> None:
    data = zip_of(path).read_bytes()
    path.write_bytes(data[: len(data) // 2])


BAD_ZIPS: dict[str, Callable[[Path], object]] = {
    "without pictures": lambda path: zip_of(path, ["a.bmp"]),
    "unpacks to": bomb,
    "too many files": of_many,
    "without an end": cut,
    "without a film": lambda path: zip_of(path, ["a.png", "b.png", "c.png"]),
}


@pytest.mark.parametrize("words", BAD_ZIPS)
def test_a_zip_that_is_no_film_says_what_it_is(tmp_path: Path, words: str):
    path = tmp_path / "a.zip"
    BAD_ZIPS[words](path)
    with pytest.raises(LogError, match=words) as refused:
        read_episode(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


def test_an_animated_webp_is_a_film(tmp_path: Path):
    """Of pictures whose lower half alone changes."""
    path, film = tmp_path / "a.webp", cv2.Animation()
    film.frames = [np.vstack([numbered(5), numbered(number)]) for number in range(COUNT)]
    durations: Any = [20] * COUNT
    film.durations = durations
    assert cv2.imwriteanimation(str(path), film, [cv2.IMWRITE_WEBP_QUALITY, 101])
    episode = read_episode(path)
    shown = [frame.decode() for frame in episode.frames()]
    assert [round(float(one[24:].mean()) / 20) for one in shown] == list(range(COUNT))
    assert {round(float(one[:24].mean()) / 20) for one in shown} == {5}
    assert stamps_of(episode) == [20_000_000 * number for number in range(COUNT)]
    assert stamps_of(read_episode(path, ReadOptions(fps=100)))[1] == 10_000_000
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    episode = read_episode(path)
    assert episode.losses
    assert 0 < len(list(episode.frames())) < COUNT


@pytest.mark.parametrize("kind", ["folder", "zip"])
def test_a_drop_in_numbered_pictures_is_tuned(made: Made, tmp_path: Path, kind: str):
    pictures = {
        f"img{number}.jpg": frame.data
        for number, frame in enumerate(read_episode(short_film(made, rate_hz=60)).frames())
    }
    path = tmp_path / ("a.zip" if kind == "zip" else "a")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as archive:
        for name, data in pictures.items():
            archive.writestr(name, data)
    if kind == "folder":
        shutil.unpack_archive(tmp_path / "a.zip", path)
    assert tuned(path) == pytest.approx(0.7, abs=0.005)
