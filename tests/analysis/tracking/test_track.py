"""The ball is found by how it flies, wherever it is, and nothing else is taken for it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from tests.analysis.films import CAMERA, ORDER, kept, rendered_ball
from tests.conftest import Made
from tests.strangers import bounce_heights
from tunenet_logs.analysis.drop.film import find_filmed_drop
from tunenet_logs.analysis.evaluation.studies.video import tune_track
from tunenet_logs.analysis.options import Hints, TuneOptions
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tracking.track import Track, track_ball
from tunenet_logs.episode import Channel, Episode, EpisodeInfo, Frame, Picture
from tunenet_logs.errors import NotFoundError, UsageError
from tunenet_logs.recorders.simulated import DropOrder, FilmOrder, film_drop, simulate_drop
from tunenet_logs.recorders.simulators.ball import TOPIC
from tunenet_logs.recorders.simulators.camera import PinholeCamera


def tracked(episode: Episode, hints: Hints | None = None) -> Track:
    return track_ball(Pictures(episode, episode.picture_topics[0]), hints)


def changed(episode: Episode, change: Callable[[int, np.ndarray], np.ndarray]) -> Episode:
    """The same episode with other pixels."""

    def frames(topic: str) -> Iterator[Frame]:
        for index, frame in enumerate(episode.frames(topic)):
            pixels = change(index, frame.decode().copy())
            height, width = pixels.shape[:2]
            data = np.ascontiguousarray(pixels).tobytes()
            yield Frame(frame.stamp_ns, "rgb8", data, (width, height))

    return replace(episode, open_frames=frames)


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
    found = tune_track(track, TuneOptions()).estimate
    assert found is not None
    assert found[0] == pytest.approx(0.65, abs=0.01)


@pytest.mark.parametrize(
    ("ball", "wall", "rate_hz"),
    [
        (110, 170, 60.0),
        (235, 90, 30.0),
        pytest.param(40, 190, 30.0, marks=pytest.mark.slow),
        pytest.param(20, 230, 24.0, marks=pytest.mark.slow),
    ],
)
def test_a_grey_ball_before_a_grey_wall_casting_a_shadow(ball: int, wall: int, rate_hz: float):
    """Drawn here: a ball without colour differs from the wall as its own shadow does."""
    times = np.arange(round(2.2 * rate_hz)) / rate_hz - 0.25
    rows = 430 - 380 * bounce_heights(0.75, 1.0, times)
    rng = np.random.default_rng(4)
    frames = []
    for index, row in enumerate(rows):
        pixels = np.full((480, 360, 3), wall, np.uint8)
        dark = int(0.75 * wall)
        width = int(16 + 0.1 * (430 - row))
        cv2.ellipse(pixels, (180, 443), (width, 5), 0, 0, 360, (dark, dark, dark), -1, cv2.LINE_AA)
        place = (180 * 16, round(float(row) * 16))
        cv2.circle(pixels, place, 12 * 16, (ball, ball, ball), -1, cv2.LINE_AA, 4)
        noise = 3 * rng.standard_normal(pixels.shape, np.float32)
        noisy = np.clip(pixels + noise, 0, 255).astype(np.uint8)
        stamp_ns = round(index * 1e9 / rate_hz)
        frames.append(Frame(stamp_ns, "rgb8", noisy.tobytes(), (360, 480)))
    channel = Channel("video", "drawn", "video", np.arange(len(frames)), pictures=True)
    drawn = Episode(EpisodeInfo(), {}, (channel,), open_frames=lambda _topic: iter(frames))
    track = tracked(drawn)
    assert track.found.mean() > 0.97
    off = (track.places_px - np.column_stack([np.full(len(rows), 180.0), rows]))[track.found]
    assert (off - np.median(off, axis=0)).std(axis=0).max() < 0.5
    assert find_filmed_drop(track, 0).projection.bounce.restitution == pytest.approx(0.75, abs=0.01)


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


def test_damaged_pictures_are_left_out_and_counted(episode: Episode):
    def frames(topic: str) -> Iterator[Frame]:
        for index, frame in enumerate(episode.frames(topic)):
            yield replace(frame, data=frame.data[:40]) if index % 20 == 7 else frame

    pictures = Pictures(replace(episode, open_frames=frames), episode.picture_topics[0])
    assert pictures.damaged == len([index for index in range(84) if index % 20 == 7])
    assert track_ball(pictures).found.mean() > 0.95


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
        tracked(replace(episode, open_frames=lambda _topic: iter([first])))
    with pytest.raises(NotFoundError, match="nothing moves near 5, 5 px") as refused:
        tracked(episode, Hints(ball_at=(5.0, 5.0, seconds_of(track, 30))))
    named = re.search(r"the nearest at (\d+), (\d+) px", str(refused.value))
    assert named is not None
    assert [float(one) for one in named.groups()] == pytest.approx(track.places_px[30], abs=1)

    def noisy(index: int, _pixels: np.ndarray) -> np.ndarray:
        noise = 4 * np.random.default_rng(index).standard_normal(still.shape, np.float32)
        return np.clip(still + noise, 0, 255).astype(np.uint8)

    with pytest.raises(NotFoundError, match="no ball is seen to fly"):
        tracked(changed(episode, noisy))


WIDE, TALL = 320, 240


def room() -> Picture:
    """Something to see everywhere, three times as wide as a picture."""
    rng = np.random.default_rng(3)
    coarse = rng.integers(40, 220, (TALL // 12, 3 * WIDE // 12, 3)).astype(np.uint8)
    size = (3 * WIDE, TALL)
    return np.asarray(cv2.resize(coarse, size, interpolation=cv2.INTER_CUBIC), np.uint8)


def with_ball(picture: Picture, x: float, y: float) -> Picture:
    shown = picture.copy()
    cv2.circle(shown, (round(x), round(y)), 9, (250, 120, 20), -1, cv2.LINE_AA)
    return shown


def episode_of(pictures: Sequence[Picture], rate_hz: float = 30.0) -> Episode:
    stamps = np.round(np.arange(len(pictures)) / rate_hz * 1e9).astype(np.int64)
    frames = [
        Frame(int(stamp), "rgb8", picture.tobytes(), (WIDE, TALL))
        for stamp, picture in zip(stamps, pictures, strict=True)
    ]
    channel = Channel("c", "rgb8", "raw", stamps, pictures=True)
    return Episode(EpisodeInfo(), {}, (channel,), open_frames=lambda _topic: iter(frames))


def test_a_camera_that_moves_is_named_before_anything_is_looked_for():
    view = room()
    pictures = [view[:, 8 * at : 8 * at + WIDE] for at in range(60)]
    with pytest.raises(NotFoundError, match="the camera moves"):
        track_ball(Pictures(episode_of([np.ascontiguousarray(one) for one in pictures]), "c"))


def test_a_ball_that_rolls_across_the_picture_never_falls():
    view = np.ascontiguousarray(room()[:, :WIDE] // 2)
    pictures = [with_ball(view, 20 + 6 * at - 0.03 * at**2, 180) for at in range(50)]
    with pytest.raises(NotFoundError, match=r"never falls|nothing falls"):
        find_filmed_drop(track_ball(Pictures(episode_of(pictures), "c")), 0)
