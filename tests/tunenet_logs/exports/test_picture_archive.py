"""Numbered pictures in a folder or a zip, and an animated WebP, as films."""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.analysis.films import short_film
from tests.conftest import Made
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import FRAME_NS, Episode
from tunenet_logs.errors import LogError
from tunenet_logs.formats.options import ReadOptions
from tunenet_logs.reader import read_episode

COUNT = 12


def numbered(number: int) -> np.ndarray:
    """RGB, a brightness that tells the number."""
    return np.full((24, 32, 3), 20 * number, np.uint8)


def encoded(number: int, suffix: str) -> bytes:
    return cv2.imencode(suffix, numbered(number))[1].tobytes()


def folder_of(path: Path, names: list[str]) -> Path:
    path.mkdir()
    for number, name in enumerate(names):
        (path / name).write_bytes(encoded(number, Path(name).suffix))
    return path


def order_of(episode: Episode, topic: str | None = None) -> list[int]:
    """Which pictures they are."""
    return [round(float(frame.decode().mean()) / 20) for frame in episode.frames(topic)]


def stamps_of(episode: Episode) -> list[int]:
    return [frame.stamp_ns for frame in episode.frames()]


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".webp", ".ppm"])
def test_numbers_count_and_not_letters(tmp_path: Path, suffix: str):
    path = folder_of(tmp_path / "a", [f"take2_img{number}{suffix}" for number in range(COUNT)])
    episode = read_episode(path, ReadOptions(fps=500))
    assert order_of(episode) == list(range(COUNT))
    assert stamps_of(episode) == [2_000_000 * number for number in range(COUNT)]
    assert not episode.frames_untimed


def test_without_a_rate_they_count_frames(tmp_path: Path):
    episode = read_episode(folder_of(tmp_path / "a", [f"{n}.png" for n in range(1, COUNT)]))
    assert episode.frames_untimed
    assert episode.info.notes["rate_hz"] == "unknown"
    assert stamps_of(episode) == [FRAME_NS * number for number in range(COUNT - 1)]
    assert "say it with --fps" in episode.warnings[0]


def test_a_number_that_is_missing_is_a_gap(tmp_path: Path):
    names = [f"{10 * number}.png" for number in range(COUNT) if number != 3]
    episode = read_episode(folder_of(tmp_path / "a", names), ReadOptions(fps=100))
    wanted = [10_000_000 * number for number in range(COUNT) if number != 3]
    assert stamps_of(episode) == wanted
    assert "1 numbers between the first and the last have no picture" in episode.warnings[0]


def test_names_that_are_times_are_the_clock(tmp_path: Path):
    times = [1403636579763555584 + 50_000_000 * number for number in range(COUNT)]
    episode = read_episode(folder_of(tmp_path / "a", [f"{one}.png" for one in times]))
    assert stamps_of(episode) == times
    assert not episode.frames_untimed


def test_two_cameras_are_two_films(tmp_path: Path):
    names = [f"{side}_{number}.png" for number in range(5) for side in ("left", "right")]
    episode = read_episode(folder_of(tmp_path / "a", [*names, "calibration.png"]))
    assert episode.picture_topics == ("left", "right")
    assert order_of(episode, "right") == [1, 3, 5, 7, 9]
    assert [one.topic for one in episode.channels if one.skipped] == ["calibration.png"]


def test_twelve_bits_in_sixteen_are_not_dark(tmp_path: Path):
    for suffix in (".tif", ".png"):
        (tmp_path / suffix).mkdir()
        for number in range(COUNT):
            deep = numbered(number)[:, :, 0].astype(np.uint16) << 4
            (tmp_path / suffix / f"{number}{suffix}").write_bytes(
                cv2.imencode(suffix, deep)[1].tobytes()
            )
        assert order_of(read_episode(tmp_path / suffix)) == list(range(COUNT))


def test_no_link_is_followed_and_damage_is_counted(tmp_path: Path):
    path = folder_of(tmp_path / "a", [f"{number}.png" for number in range(COUNT)])
    secret = tmp_path / "secret.png"
    secret.write_bytes(encoded(1, ".png"))
    (path / "99.png").symlink_to(secret)
    (path / "3.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(50))
    frames = list(read_episode(path).frames())
    assert len(frames) == COUNT
    with pytest.raises(LogError):
        frames[3].decode()


def zip_of(path: Path, names: list[str]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number, name in enumerate(names):
            archive.writestr(name, encoded(number, Path(name).suffix))
    return path


def test_a_zip_is_read_where_it_lies(tmp_path: Path):
    names = [f"../drop/{number}.png" for number in range(COUNT)]
    path = zip_of(tmp_path / "a.zip", [*names, "__MACOSX/drop/._1.png"])
    episode = read_episode(path, ReadOptions(fps=100))
    assert order_of(episode) == list(range(COUNT))
    assert sorted(tmp_path.iterdir()) == [path]


def bomb(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for number in range(10):
            archive.writestr(f"{number}.bmp", bytes(40_000_000))


def of_many(path: Path) -> None:
    data = bytearray(zip_of(path, [f"{number}.png" for number in range(COUNT)]).read_bytes())
    data[-10:-6] = b"\xff\xff\xff\x7f"
    path.write_bytes(data)


def cut(path: Path) -> None:
    data = zip_of(path, [f"{number}.png" for number in range(COUNT)]).read_bytes()
    path.write_bytes(data[: len(data) // 2])


BAD_ZIPS = {
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


def animation(path: Path, *, milliseconds: int = 20) -> Path:
    """Numbered pictures whose lower half alone changes."""
    film: Any = cv2.Animation()
    film.frames = [np.vstack([numbered(5), numbered(number)]) for number in range(COUNT)]
    film.durations = [milliseconds] * COUNT
    assert cv2.imwriteanimation(str(path), film, [cv2.IMWRITE_WEBP_QUALITY, 101])
    return path


def test_an_animated_webp_is_a_film(tmp_path: Path):
    path = animation(tmp_path / "a.webp")
    episode = read_episode(path)
    shown = [frame.decode() for frame in episode.frames()]
    assert [round(float(one[24:].mean()) / 20) for one in shown] == list(range(COUNT))
    assert {round(float(one[:24].mean()) / 20) for one in shown} == {5}
    assert stamps_of(episode) == [20_000_000 * number for number in range(COUNT)]
    assert stamps_of(read_episode(path, ReadOptions(fps=100)))[1] == 10_000_000


def test_a_cut_animation_is_damaged(tmp_path: Path):
    path = animation(tmp_path / "a.webp")
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])
    episode = read_episode(path)
    assert episode.losses
    assert 0 < len(list(episode.frames())) < COUNT


@pytest.mark.parametrize("kind", ["folder", "zip"])
def test_a_drop_in_numbered_pictures_is_tuned(made: Made, tmp_path: Path, kind: str):
    film = read_episode(short_film(made, rate_hz=60))
    names = [f"img{number}.jpg" for number, _ in enumerate(film.frames())]
    path = tmp_path / ("a.zip" if kind == "zip" else "a")
    if kind == "zip":
        with zipfile.ZipFile(path, "w") as archive:
            for name, frame in zip(names, film.frames(), strict=True):
                archive.writestr(name, frame.data)
    else:
        path.mkdir()
        for name, frame in zip(names, film.frames(), strict=True):
            (path / name).write_bytes(frame.data)
    tuning = tune_log(path, TuneOptions())
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.estimate is not None
    assert tuning.estimate[0] == pytest.approx(0.7, abs=0.005)


def test_a_file_without_a_name_is_no_picture(tmp_path: Path):
    path = zip_of(tmp_path / "a.zip", ["1.png", "2.png", "3.png", "4.png"])
    data = path.read_bytes()
    at = data.rindex(b"PK\x01\x02")  # the directory's last entry: its name becomes a remark
    name = len("4.png").to_bytes(2, "little")
    assert data[at + 28 : at + 30] == name
    path.write_bytes(data[: at + 28] + bytes(2) + bytes(2) + name + data[at + 34 :])
    assert len(list(read_episode(path).frames())) == 3
