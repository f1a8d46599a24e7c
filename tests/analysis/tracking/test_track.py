"""The ball is found by how it flies, wherever it is, and nothing else is taken for it."""

from __future__ import annotations

import gc
import re
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.analysis.answers import known, value
from tests.analysis.films import CAMERA, ORDER, film_of, kept, rendered_ball, short_film
from tests.conftest import Made
from tests.strangers import bounce_heights
from tunenet_logs.analysis.drop.film import find_filmed_drop
from tunenet_logs.analysis.evaluation.studies.video import tune_track
from tunenet_logs.analysis.options import Hints, TuneOptions
from tunenet_logs.analysis.tracking import frames as kept_film
from tunenet_logs.analysis.tracking.candidates import Candidates
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.track import Track, new_frames, track_ball
from tunenet_logs.episode import Episode, Frame
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop, simulate_drop
from tunenet_logs.recorders.simulators.ball import TOPIC
from tunenet_logs.recorders.simulators.camera import PinholeCamera


def tracked(episode: Episode, hints: Hints | None = None) -> Track:
    return track_ball(Pictures(episode, episode.picture_topics[0]), hints)


def rgb(stamp_ns: int, pixels: np.ndarray) -> Frame:
    height, width = pixels.shape[:2]
    return Frame(stamp_ns, "rgb8", np.ascontiguousarray(pixels).tobytes(), (width, height))


def changed(episode: Episode, change: Callable[[int, np.ndarray], np.ndarray]) -> Episode:
    """The same episode with other pixels."""
    return film_of(
        rgb(frame.stamp_ns, change(index, frame.decode().copy()))
        for index, frame in enumerate(episode.frames())
    )


def off_px(track: Track, order: DropOrder = ORDER, camera: PinholeCamera = CAMERA) -> np.ndarray:
    """Tracked less projected centre, its median removed, shape (found, 2)."""
    signal = simulate_drop(order).signals[TOPIC]
    rows = np.searchsorted(signal.stamps_ns, track.stamps_ns)
    off = (track.places_px - camera.image_from_world(signal.values)[rows])[track.found]
    return off - np.median(off, axis=0)


@pytest.fixture(scope="module")
def episode(made: Made) -> Episode:
    return rendered_ball(made)


@pytest.fixture(scope="module")
def track(episode: Episode) -> Track:
    return tracked(episode)


def test_the_rendered_ball_is_tracked_to_a_part_of_a_pixel(track: Track):
    """The figure to hold: .3 px (sd)."""
    assert track.found.all()
    assert off_px(track).std(axis=0).max() < 0.2
    expected = np.median(CAMERA.radius_px(simulate_drop(ORDER).signals[TOPIC].values, 0.05))
    assert np.median(track.radius_px) == pytest.approx(expected, rel=0.25)
    assert (track.confidence > 0.3).all()


@pytest.mark.parametrize(
    "seed", [21, *(pytest.param(one, marks=pytest.mark.slow) for one in (22, 23))]
)
def test_random_cameras_colours_blur_and_noise(seed: int):
    order = replace(ORDER, seed=seed, radius_m=0.05)
    filmed = kept(film_drop(order, FilmOrder(size_px=(240, 180), exposure_s=0.006, noise=3)))
    notes = filmed.info.notes
    place, target = (
        tuple(float(part) for part in notes[name].split(","))
        for name in ("camera_position_m", "camera_target_m")
    )
    camera = PinholeCamera(place, target, (240, 180))  # type: ignore[arg-type]
    track = tracked(filmed)
    assert track.found.mean() > 0.95
    assert off_px(track, order, camera).std(axis=0).max() < 0.3
    assert value(tune_track(track, TuneOptions())) == pytest.approx(0.65, abs=0.01)


def drawn(
    restitution: float, ball: int, wall: tuple[int, ...], floor: tuple[int, ...], rate_hz: float
) -> tuple[Episode, np.ndarray]:
    """A grey ball with its shadow, drawn here, and the rows of its centre."""
    times = np.arange(round(2.2 * rate_hz)) / rate_hz - 0.25
    rows = 430 - 380 * bounce_heights(restitution, 1.0, times)
    rng = np.random.default_rng(4)
    frames = []
    for index, row in enumerate(rows.tolist()):
        pixels = np.full((480, 360, 3), wall, np.uint8)
        pixels[420:] = floor
        dark = tuple(int(0.75 * part) for part in floor)
        width = int(16 + 0.1 * (430 - row))
        cv2.ellipse(pixels, (180, 443), (width, 5), 0, 0, 360, dark, -1, cv2.LINE_AA)
        place = (180 * 16, round(row * 16))
        cv2.circle(pixels, place, 12 * 16, (ball, ball, ball), -1, cv2.LINE_AA, 4)
        noisy = pixels + 3 * rng.standard_normal(pixels.shape, np.float32)
        stamp_ns = round(index * 1e9 / rate_hz)
        frames.append(rgb(stamp_ns, np.clip(noisy, 0, 255).astype(np.uint8)))
    return film_of(frames), rows


def grey(*levels: int) -> list[tuple[int, int, int]]:
    return [(level, level, level) for level in levels]


@pytest.mark.parametrize(
    ("restitution", "ball", "wall", "floor", "rate_hz"),
    [
        (0.75, 110, *grey(170, 170), 60.0),
        (0.75, 235, *grey(90, 90), 30.0),
        pytest.param(0.75, 40, *grey(190, 190), 30.0, marks=pytest.mark.slow),
        pytest.param(0.75, 20, *grey(230, 230), 24.0, marks=pytest.mark.slow),
        (0.15, 55, (205, 200, 190), (120, 110, 100), 60.0),  # and lies for most of the film
        pytest.param(0.15, 125, (150, 150, 165), (90, 20, 30), 60.0, marks=pytest.mark.slow),
    ],
)
def test_a_ball_without_colour_differs_from_the_wall_as_its_shadow_does(
    restitution: float, ball: int, wall: tuple[int, ...], floor: tuple[int, ...], rate_hz: float
):
    film, rows = drawn(restitution, ball, wall, floor, rate_hz)
    track = tracked(film)
    assert track.found.mean() > 0.97
    off = (track.places_px - np.column_stack([np.full(len(rows), 180.0), rows]))[track.found]
    assert off.std(axis=0).max() < (0.5 if restitution > 0.5 else 0.3)
    found = find_filmed_drop(track, 0).projection.bounce.restitution
    assert found == pytest.approx(restitution, abs=0.01 if restitution > 0.5 else 0.015)


def test_a_picture_without_the_ball_is_a_gap(episode: Episode):
    ground = np.median([frame.decode() for frame in episode.frames()], axis=0).astype(np.uint8)
    gone = {40, 41, 42, 43}
    track = tracked(changed(episode, lambda index, pixels: ground if index in gone else pixels))
    assert not track.found[[*gone]].any()
    assert np.delete(track.found, [*gone]).mean() > 0.95


def test_a_ball_at_rest_stays_found():
    order = replace(ORDER, restitution=0.3, seconds=2.0)
    camera = PinholeCamera(CAMERA.position_m, CAMERA.target_m, (240, 180))
    track = tracked(kept(film_drop(order, FilmOrder(camera=camera))))
    assert track.found[-60:].all()
    assert np.ptp(track.places_px[-60:], axis=0).max() < 0.5


def test_flicker_and_a_person_who_walks_in_later_change_little(episode: Episode):
    rng = np.random.default_rng(1)
    light = rng.uniform(0.85, 1.1, 400)

    def disturbed(index: int, pixels: np.ndarray) -> np.ndarray:
        if index > 60:
            left = 20 + 3 * (index - 60)
            pixels[60:230, left : left + 40] = (90, 60, 50)
        return np.clip(pixels * light[index], 0, 255).astype(np.uint8)

    track = tracked(changed(episode, disturbed))
    early = slice(15, 60)
    assert track.found[early].mean() > 0.95
    truth = CAMERA.image_from_world(simulate_drop(ORDER).signals[TOPIC].values)[early]
    off = (track.places_px[early] - truth)[track.found[early]]
    assert (off - np.median(off, axis=0)).std(axis=0).max() < 0.3


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_video_that_lies_on_its_side_falls_sideways(episode: Episode, track: Track, turns: int):
    turned = tracked(changed(episode, lambda _index, pixels: np.rot90(pixels, turns)))
    assert turned.found.mean() > 0.95
    down = np.array([[0, 1], [1, 0], [0, -1], [-1, 0]][turns])
    assert turned.gravity_px @ down > 0.99 * np.linalg.norm(turned.gravity_px)
    assert np.linalg.norm(turned.gravity_px) == pytest.approx(
        np.linalg.norm(track.gravity_px), rel=0.2
    )


def test_a_large_picture_is_reduced_and_its_pixels_are_its_own(episode: Episode):
    size = (960, 720)
    camera = PinholeCamera(CAMERA.position_m, CAMERA.target_m, size)
    large = changed(episode, lambda _index, pixels: cv2.resize(pixels, size))
    pictures = Pictures(large, large.picture_topics[0])
    assert pictures.scale == 2
    track = track_ball(pictures)
    assert track.size_px == size
    assert off_px(track, camera=camera).std(axis=0).max() < 0.5


def seconds_of(track: Track, frame: int) -> float:
    return float(track.stamps_ns[frame] - track.stamps_ns[0]) * 1e-9


def hinted(track: Track, by: str) -> Hints:
    """What a user says who knows the ball's way, its colour, or where it was once."""
    if by == "box":
        return Hints(roi=(int(np.nanmedian(track.places_px[:, 0])) - 30, 20, 60, 200))
    if by == "colour":
        hue, *_ = cv2.cvtColor(np.uint8([[track.colour]]), cv2.COLOR_RGB2HSV)[0, 0].tolist()  # type: ignore[arg-type]
        return Hints(hsv=(((hue - 8) % 180, 90, 40), ((hue + 8) % 180, 255, 255)))
    x, y = track.places_px[30] + ((30, -20) if by == "a place near it" else (0, 0))
    return Hints(ball_at=(x, y, seconds_of(track, 30)))


@pytest.mark.parametrize("by", ["box", "colour", "its place", "a place near it"])
def test_one_hint_is_enough(episode: Episode, track: Track, by: str):
    found = tracked(episode, hinted(track, by))
    assert found.found.mean() > (0.9 if by == "colour" else 0.95)
    assert off_px(found).std(axis=0).max() < 0.5


WHOLE = r"0\.00 to 1\.38 s \(the recording is 1\.38 s long\)"
PART = r"0\.50 to 1\.18 s .* 1\.38 s long"


@pytest.mark.parametrize(
    ("hints", "part", "says"),
    [
        (Hints(roi=(300, 0, 100, 100)), {}, "320 x 240"),
        (Hints(roi=(0, 0, 10, 1000)), {}, "320 x 240"),
        (Hints(ball_at=(400.0, 10.0, 0.0)), {}, "320 x 240"),
        (Hints(ball_at=(160.0, 120.0, 1.9)), {}, WHOLE),
        (Hints(ball_at=(160.0, 120.0, 99.0)), {}, WHOLE),
        (Hints(ball_at=(160.0, 120.0, 0.2)), {"start_s": 0.5, "end_s": 1.19}, PART),
        (Hints(ball_at=(160.0, 120.0, 1.5)), {"start_s": 0.5, "end_s": 1.19}, PART),
    ],
)
def test_a_mark_outside_picture_or_part_is_refused(
    episode: Episode, hints: Hints, part: dict[str, Any], says: str
):
    with pytest.raises(UsageError, match=says):
        track_ball(Pictures(episode, episode.picture_topics[0], **part), hints)


def test_what_cannot_be_looked_for_is_named(episode: Episode, track: Track):
    topic, still = episode.picture_topics[0], next(episode.frames()).decode()
    with pytest.raises(NotFoundError, match=r"--start 9 is past the end: .* is 1\.38 s long"):
        Pictures(episode, topic, start_s=9)
    first = next(episode.frames())
    with pytest.raises(NotFoundError, match="too few"):
        tracked(film_of([first]))
    with pytest.raises(NotFoundError, match="nothing moves near 5, 5 px") as refused:
        tracked(episode, Hints(ball_at=(5.0, 5.0, seconds_of(track, 30))))
    named = known(re.search(r"the nearest at (\d+), (\d+) px", str(refused.value)))
    assert [float(one) for one in named.groups()] == pytest.approx(track.places_px[30], abs=1)

    def noisy(index: int, _pixels: np.ndarray) -> np.ndarray:
        noise = 4 * np.random.default_rng(index).standard_normal(still.shape, np.float32)
        return np.clip(still + noise, 0, 255).astype(np.uint8)

    with pytest.raises(NotFoundError, match="no ball is seen to fly"):
        tracked(changed(episode, noisy))


WIDE, TALL = 320, 240


def room() -> np.ndarray:
    """Something to see everywhere, three times as wide as a picture."""
    rng = np.random.default_rng(3)
    coarse = rng.integers(40, 220, (TALL // 12, 3 * WIDE // 12, 3)).astype(np.uint8)
    return cv2.resize(coarse, (3 * WIDE, TALL), interpolation=cv2.INTER_CUBIC)


def test_a_camera_that_moves_is_named_before_anything_is_looked_for():
    view = room()
    pictures = (rgb(at * 33_333_333, view[:, 8 * at : 8 * at + WIDE]) for at in range(60))
    with pytest.raises(NotFoundError, match="the camera moves"):
        tracked(film_of(pictures))


def test_a_ball_that_rolls_across_the_picture_never_falls():
    pictures = []
    for at in range(50):
        shown = np.ascontiguousarray(room()[:, :WIDE] // 2)
        place = round(20 + 6 * at - 0.03 * at**2), 180
        cv2.circle(shown, place, 9, (250, 120, 20), -1, cv2.LINE_AA)
        pictures.append(rgb(at * 33_333_333, shown))
    with pytest.raises(NotFoundError, match=r"never falls|nothing falls"):
        find_filmed_drop(tracked(film_of(pictures)), 0)


# ---- Films that are long, that repeat pictures, that are kept in memory


@pytest.mark.parametrize("more", [40, pytest.param(250, marks=pytest.mark.slow)])
def test_memory_does_not_grow_with_the_recording(
    made: Made, monkeypatch: pytest.MonkeyPatch, more: int
):
    """The ball lies in the hand for long; what grows is a few numbers for each picture."""
    frames = list(read_episode(short_film(made, rate_hz=30)).frames())
    start_ns, period_ns = frames[0].stamp_ns, frames[1].stamp_ns - frames[0].stamp_ns
    monkeypatch.setattr(kept_film, "_MAX_BYTES", 5_000_000)
    peaks = []
    for times in (1, more):
        held = [
            replace(frames[number % 5], stamp_ns=start_ns + (number - times) * period_ns)
            for number in range(times)
        ]
        longer = film_of([*held, *frames])
        tracemalloc.start()
        track = tracked(longer)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert track.found[times + 10 :].mean() > 0.95
    assert peaks[1] < 1.3 * peaks[0]


def test_a_film_that_is_not_kept_is_the_same_and_one_is_kept_while_its_episode_lasts(
    made: Made, monkeypatch: pytest.MonkeyPatch
):
    first, second = rendered_ball(made), rendered_ball(made)
    topic = first.picture_topics[0]
    whole, _ = tracked(first), tracked(second)
    assert kept_film.kept_film(first, topic) is None
    assert kept_film.kept_film(second, topic) is not None
    del second
    gc.collect()
    assert not len(kept_film._last)
    monkeypatch.setattr(kept_film, "_MAX_BYTES", 1_000_000)
    again = tracked(first)
    assert kept_film.kept_film(first, topic) is None
    assert np.array_equal(whole.places_px, again.places_px, equal_nan=True)


def test_pictures_that_come_twice_count_once(episode: Episode):
    """As phones store them that play a film of 30 at 60 frames a second; where it bounces, too."""
    frames = list(episode.frames())
    track = tracked(
        film_of(
            replace(frames[index - index % 2], stamp_ns=one.stamp_ns)
            for index, one in enumerate(frames)
        )
    )
    places = CAMERA.image_from_world(simulate_drop(ORDER).signals[TOPIC].values)
    rows = np.searchsorted([one.stamp_ns for one in frames], track.stamps_ns)
    moved = np.abs(np.gradient(places[:, 1]))[rows] > 0.5
    assert moved.sum() > 20
    assert (rows[moved] % 2 == 0).all()
    assert np.median(np.abs(track.places_px - places[rows])[moved]) < 0.3


def test_every_picture_twice_is_the_film_at_twice_its_rate(episode: Episode):
    """Shown evenly, the ball stands in every second picture: none of its flights is a parabola."""
    frames = list(episode.frames())
    half_ns = (frames[1].stamp_ns - frames[0].stamp_ns) // 2
    twice = [
        replace(one, stamp_ns=one.stamp_ns + later) for one in frames for later in (0, half_ns)
    ]
    film = find_filmed_drop(tracked(film_of(twice)), frames[0].stamp_ns)
    low, high = film.posterior.interval95[0]
    assert low < ORDER.restitution < high
    assert high - low < 0.02


def test_a_camera_that_freezes_leaves_a_gap(episode: Episode):
    frames = list(episode.frames())
    frozen = [replace(frames[22], stamp_ns=one.stamp_ns) for one in frames[22:28]]
    track = tracked(film_of([*frames[:22], *frozen, *frames[28:]]))
    stamps_ns = [one.stamp_ns for one in [*frames[:23], *frames[28:]]]
    assert track.stamps_ns.tolist() == stamps_ns


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
