"""Recordings that are long, that repeat pictures, and balls that are hard to see."""

from __future__ import annotations

import gc
import tracemalloc
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.analysis.films import CAMERA, ORDER, rendered_ball, short_film
from tests.conftest import Made
from tests.strangers import bounce_heights
from tunenet_logs.analysis.drop.film import find_filmed_drop
from tunenet_logs.analysis.tracking import frames as kept_film
from tunenet_logs.analysis.tracking.candidates import Candidates
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.track import Track, new_frames, track_ball
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import simulate_drop
from tunenet_logs.recorders.simulators.ball import TOPIC


def tracked(episode: Episode) -> Track:
    return track_ball(Pictures(episode, episode.picture_topics[0]))


@pytest.fixture(scope="module")
def episode(made: Made) -> Episode:
    return rendered_ball(made)


def long_hold(frames: list[Frame], times: int) -> Episode:
    """The same drop after a first picture that lasts: the ball in the hand."""
    period_ns = frames[1].stamp_ns - frames[0].stamp_ns
    held = [
        replace(frames[number % 5], stamp_ns=frames[0].stamp_ns + (number - times) * period_ns)
        for number in range(times)
    ]
    channel = Channel("c", "", "", np.arange(times + len(frames)), pictures=True)
    return Episode(EpisodeInfo(), {}, (channel,), open_frames=lambda _topic: iter([*held, *frames]))


@pytest.mark.parametrize("more", [40, pytest.param(250, marks=pytest.mark.slow)])
def test_memory_does_not_grow_with_the_recording(
    made: Made, monkeypatch: pytest.MonkeyPatch, more: int
):
    """Once there are more pictures than are kept; what grows is a few numbers for each."""
    frames = list(read_episode(short_film(made, rate_hz=30)).frames())
    monkeypatch.setattr(kept_film, "_MAX_BYTES", 5_000_000)
    peaks = []
    for times in (1, more):
        longer = long_hold(frames, times)
        tracemalloc.start()
        track = tracked(longer)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert track.found[times + 10 :].mean() > 0.95
    assert peaks[1] < 1.3 * peaks[0]


def test_a_film_that_is_not_kept_is_the_same(episode: Episode, monkeypatch: pytest.MonkeyPatch):
    kept = tracked(episode)
    assert kept_film.kept_film(episode, episode.picture_topics[0]) is not None
    monkeypatch.setattr(kept_film, "_MAX_BYTES", 1_000_000)
    again = tracked(episode)
    assert kept_film.kept_film(episode, episode.picture_topics[0]) is None
    assert np.array_equal(kept.places_px, again.places_px, equal_nan=True)


def test_pictures_that_come_twice_count_once(episode: Episode):
    """As phones store them that play a film of 30 at 60 frames a second; where it bounces, too."""
    frames = list(episode.frames())
    twice = [frames[index - index % 2] for index in range(len(frames))]
    stamped = [replace(one, stamp_ns=two.stamp_ns) for one, two in zip(twice, frames, strict=True)]
    track = tracked(replace(episode, open_frames=lambda _topic: iter(stamped)))
    places = CAMERA.image_from_world(simulate_drop(ORDER).signals[TOPIC].values)
    rows = np.searchsorted([one.stamp_ns for one in frames], track.stamps_ns)
    moved = np.abs(np.gradient(places[:, 1]))[rows] > 0.5
    assert moved.sum() > 20
    assert (rows[moved] % 2 == 0).all()
    assert np.median(np.abs(track.places_px - places[rows])[moved]) < 0.3


def test_a_camera_that_freezes_leaves_a_gap(episode: Episode):
    frames = list(episode.frames())
    frozen = [replace(frames[22], stamp_ns=one.stamp_ns) for one in frames[22:28]]
    stuck = frames[:22] + frozen + frames[28:]
    track = tracked(replace(episode, open_frames=lambda _topic: iter(stuck)))
    gone = set(range(23, 28))
    stamps = {frames[index].stamp_ns for index in gone}
    assert not stamps & set(track.stamps_ns.tolist())
    assert len(track.stamps_ns) == len(frames) - len(gone)


@pytest.mark.parametrize(
    ("ball", "wall", "floor"),
    [
        ((60, 55, 50), (205, 200, 190), (120, 110, 100)),
        pytest.param((90, 130, 160), (150, 150, 165), (90, 20, 30), marks=pytest.mark.slow),
    ],
)
def test_a_dull_ball_that_hardly_bounces_and_comes_to_rest(
    ball: tuple[int, int, int], wall: tuple[int, int, int], floor: tuple[int, int, int]
):
    """Before a light wall and a dark floor; it lies for most of the recording."""
    rate_hz, restitution = 60.0, 0.15
    times = np.arange(round(2.1 * rate_hz)) / rate_hz - 0.4
    rows = 400 - 330 * bounce_heights(restitution, 1.0, times)
    rng = np.random.default_rng(9)
    frames = []
    for index, row in enumerate(rows):
        pixels = np.full((480, 360, 3), wall, np.uint8)
        pixels[390:] = floor
        dark = tuple(int(0.6 * part) for part in floor)
        cv2.ellipse(pixels, (180, 412), (16, 5), 0, 0, 360, dark, -1, cv2.LINE_AA)
        cv2.circle(pixels, (180 * 16, round(float(row) * 16)), 192, ball, -1, cv2.LINE_AA, 4)
        noise = 4 * rng.standard_normal(pixels.shape, np.float32)
        noisy = np.clip(pixels + noise, 0, 255).astype(np.uint8)
        frames.append(Frame(round(index * 1e9 / rate_hz), "rgb8", noisy.tobytes(), (360, 480)))
    channel = Channel("video", "drawn", "video", np.arange(len(frames)), pictures=True)
    drawn = Episode(EpisodeInfo(), {}, (channel,), open_frames=lambda _topic: iter(frames))
    track = tracked(drawn)
    assert track.found[30:].mean() > 0.97
    off = (track.places_px - np.column_stack([np.full(len(rows), 180.0), rows]))[track.found]
    assert off.std(axis=0).max() < 0.3
    assert find_filmed_drop(track, 0).projection.bounce.restitution == pytest.approx(
        0.15, abs=0.015
    )


@pytest.mark.parametrize(
    ("rows", "kept"),
    [
        ((0, 4, 8, 12, 12, 16, 20), (0, 1, 2, 3, 5, 6)),
        ((0, 4, 8, 12, 12, 8, 4), (0, 1, 2, 3, 4, 5, 6)),
        ((12, 12, 12, 12, 12, 12, 12), (0, 1, 2, 3, 4, 5, 6)),
    ],
    ids=["falls on", "bounces", "lies"],
)
def test_seen_twice_in_one_place_a_ball_that_turns_back_counts_twice(
    rows: tuple[int, ...], kept: tuple[int, ...]
):
    """Of seven pictures the fifth is as the fourth: once more only where the ball goes on."""
    count = len(rows)
    table = Candidates(
        seconds=np.arange(count) / 60,
        places_px=np.array([[[50.0, row]] for row in rows]),
        areas_px=np.full((count, 1), 80.0),
        colours=np.zeros((count, 1, 3)),
        whole=np.ones((count, 1), dtype=bool),
        misfits=np.zeros((count, 1)),
    )
    assert tuple(new_frames(table, np.arange(count) == 4)) == kept


def test_one_film_is_kept_and_no_longer_than_its_episode(made: Made):
    first, second = rendered_ball(made), rendered_ball(made)
    for one in (first, second):
        tracked(one)
    topic = first.picture_topics[0]
    assert kept_film.kept_film(first, topic) is None
    assert kept_film.kept_film(second, topic) is not None
    del one, second
    gc.collect()
    assert not len(kept_film._last)
