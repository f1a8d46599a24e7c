"""From a track to a drop: any camera, height and rate; and what is no drop is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.strangers import bounce_heights
from tunenet_logs.analysis.checks import Check
from tunenet_logs.analysis.drop.bounce_model import BounceSamples
from tunenet_logs.analysis.drop.checks import (
    film_checks,
    hop_check,
    recording_checks,
    scale_checks,
    seconds_out_of_view,
)
from tunenet_logs.analysis.drop.detection import FilmDetection
from tunenet_logs.analysis.drop.film import canonical_film, find_filmed_drop, free_flight, why_not
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.ball import Bounce
from tunenet_logs.recorders.simulators.known import Ball

GRAVITY = 9.81


def pixels(heights: np.ndarray, span_px: float, perspective: float) -> np.ndarray:
    """Image rows, down, of heights [drop heights]."""
    grow = np.exp(perspective)
    return 200 - span_px * grow * heights / (1 + (grow - 1) * heights)


def track_of(
    rows: np.ndarray, rate_hz: float, noise_px: float = 0.1, sideways: np.ndarray | None = None
) -> Track:
    rng = np.random.default_rng(7)
    columns = np.full(len(rows), 150.0) if sideways is None else sideways
    places = np.column_stack([columns, rows]) + rng.normal(0, noise_px, (len(rows), 2))
    return Track(
        stamps_ns=np.round(np.arange(len(rows)) * 1e9 / rate_hz).astype(np.int64),
        places_px=places,
        radius_px=np.full(len(rows), 5.0),
        confidence=np.ones(len(rows)),
        size_px=(320, 240),
        gravity_px=np.array([0.0, 1000.0]),
        colour=(200, 80, 30),
    )


def filmed(
    restitution: float,
    gap_m: float = 1.0,
    rate_hz: float = 60.0,
    perspective: float = 0.0,
    seconds: float = 2.5,
    start_s: float = -0.3,
) -> Track:
    """A drop in closed form; `start_s` after the release."""
    times = start_s + np.arange(round(seconds * rate_hz)) / rate_hz
    heights = bounce_heights(restitution, gap_m, times, GRAVITY) / gap_m
    return track_of(pixels(heights, 120.0, perspective), rate_hz)


@pytest.mark.parametrize("restitution", [0.2, 0.5, 0.8, 0.95])
@pytest.mark.parametrize("perspective", [-0.5, pytest.param(0.0, marks=pytest.mark.slow), 0.5])
@pytest.mark.parametrize(("gap_m", "rate_hz"), [(0.5, 120.0), (2.0, 30.0)])
def test_any_camera_height_and_rate(
    restitution: float, perspective: float, gap_m: float, rate_hz: float
):
    track = filmed(restitution, gap_m, rate_hz, perspective, seconds=6 * np.sqrt(gap_m))
    found = find_filmed_drop(track, 0)
    fit = found.projection
    assert fit.bounce.restitution == pytest.approx(restitution, abs=0.012)
    assert fit.fall_time_s == pytest.approx(np.sqrt(2 * gap_m / GRAVITY), rel=0.02)
    assert found.drop.drop_height_m == pytest.approx(gap_m, rel=0.04)
    observed = canonical_film(found).values[:, 0]
    exact = bounce_heights(restitution, 1.0, canonical_film(found).axis + 1, gravity=2.0)
    assert np.nanmax(np.abs(observed - exact)) < 0.06


@pytest.mark.parametrize("start_s", [0.1, 0.2, 0.3])
def test_a_release_that_is_not_seen(start_s: float):
    found = find_filmed_drop(filmed(0.7, start_s=start_s), 0)
    assert found.projection.bounce.restitution == pytest.approx(0.7, abs=0.02)


def test_a_ball_that_was_lowered_before_it_was_let_go():
    rate = 60.0
    hand = np.concatenate([np.linspace(1.15, 1.0, 40), np.full(15, 1.0)])
    free = bounce_heights(0.6, 1.0, np.arange(120) / rate, GRAVITY)
    track = track_of(pixels(np.concatenate([hand, free]), 120, 0.2), rate)
    assert find_filmed_drop(track, 0).projection.bounce.restitution == pytest.approx(0.6, abs=0.012)


def test_a_film_that_ends_in_the_second_flight():
    found = find_filmed_drop(filmed(0.8, seconds=1.6), 0)
    assert found.projection.bounce.restitution == pytest.approx(0.8, abs=0.01)
    observed = canonical_film(found).values[:, 0]
    assert np.isnan(observed[-1])
    assert np.isfinite(observed[:40]).all()


def test_gaps_and_single_outliers():
    track = filmed(0.65, rate_hz=120)
    places = track.places_px.copy()
    rng = np.random.default_rng(2)
    places[rng.choice(len(places), 30, replace=False)] = np.nan
    places[[80, 150]] += [0, 12]
    found = find_filmed_drop(replace(track, places_px=places), 0)
    assert found.projection.bounce.restitution == pytest.approx(0.65, abs=0.01)


@pytest.mark.parametrize(
    ("each", "flights", "passes"),
    [
        ((0.7, 0.7, 0.7, 0.7), None, True),
        ((0.7, 0.7, 0.45, 0.8), 2, True),  # on a seam
        ((0.7, 0.45, 0.85, 0.5), 1, False),
    ],
)
def test_a_ball_is_one_as_far_as_one_law_goes(
    each: tuple[float, ...], flights: int | None, passes: bool
):
    """Restitution within .01, whatever the later bounces are."""
    fall_s = np.sqrt(2 / GRAVITY)
    times = (np.arange(150) / 60.0 - 0.3) / fall_s - 1
    heights = Bounce(0.7, each=each).heights(times)
    found = find_filmed_drop(track_of(pixels(heights, 120.0, 0.2), 60.0), 0)
    assert found.projection.bounce.restitution == pytest.approx(0.7, abs=0.01)
    assert found.flights == flights
    (check,) = (one for one in film_checks(found) if one.name == "bounces alike")
    assert check.passed == passes
    assert not check.fatal


def test_where_heights_are_in_the_picture_and_back():
    fit = find_filmed_drop(filmed(0.6, perspective=0.4), 0).projection
    heights, seconds = np.linspace(-0.02, 1, 30), np.linspace(0, 1, 30)
    assert fit.heights(fit.positions(heights, seconds), seconds) == pytest.approx(heights, abs=1e-9)


def flight_only() -> np.ndarray:
    """Thrown up and caught."""
    times = np.linspace(-0.4, 0.4, 60)
    return 1 - (times / 0.4) ** 2


@pytest.mark.parametrize(
    ("heights", "reason"),
    [
        (np.full(100, 0.5), "moves by only"),
        (flight_only(), "no bounce is seen: the ball never falls onto anything"),
        (0.5 + 0.5 * np.sin(np.arange(300) / 20), "no bounce is seen|no free fall"),
        (np.linspace(1, 0, 100), "no bounce is seen|no free fall|no drop"),
        (0.5 + 0.5 * np.sin(np.arange(150) / 9), "no bounce|no free fall|no drop"),
    ],
)
def test_what_is_no_drop_is_named(heights: np.ndarray, reason: str):
    with pytest.raises(NotFoundError, match=reason):
        find_filmed_drop(track_of(pixels(heights, 120, 0), 60), 0)


def test_what_moves_across_the_picture_alone_rolls_or_is_seen_from_above():
    track = track_of(np.full(60, 200.0), 60, sideways=np.linspace(20, 300, 60))
    with pytest.raises(NotFoundError, match=r"280 px across .* rolls, or is filmed from above"):
        find_filmed_drop(track, 0)


def test_a_ball_that_is_carried_is_told_so():
    """Up and down in a hand, with turns that are no bounces."""
    times = np.arange(400) / 60
    heights = 0.5 + 0.3 * np.sin(2 * times) + 0.15 * np.sin(4 * times)
    track = track_of(pixels(heights, 120, 0), 60)
    assert free_flight(track).is_carried
    assert not free_flight(filmed(0.7)).is_carried
    with pytest.raises(NotFoundError, match=r"the ball hardly flies, it is carried"):
        find_filmed_drop(track, 0)


def test_a_contact_out_of_view_is_told_so():
    track = filmed(0.7)
    places = track.places_px.copy()
    places[places[:, 1] > 160] = np.nan
    track = replace(track, places_px=places, size_px=(320, 165))
    seconds = (track.stamps_ns[track.found] * 1e-9).astype(np.float64)
    whole = BounceSamples(seconds, -places[track.found][:, 1], noise=0.1)
    impact = int(np.diff(seconds).argmax())
    assert "where it hits is not in view" in why_not(track, whole, [impact], fitted=True)
    tall = replace(track, size_px=(320, 400))
    assert "not in view" not in why_not(tall, whole, [impact], fitted=True)


def test_a_ball_cut_off_at_its_apex_leaves_the_rest():
    """The picture ends where the first bounce is two thirds of its height."""
    track = filmed(0.9, rate_hz=120, seconds=3.5)
    places = track.places_px.copy()
    top = 200 - 0.81 * 120 * 0.65
    after = np.arange(len(places)) > 100
    places[after & (places[:, 1] < top)] = np.nan
    places[:, 1] -= top - 5
    found = find_filmed_drop(replace(track, places_px=places), 0)
    assert found.projection.bounce.restitution == pytest.approx(0.9, abs=0.01)
    checks = {one.name: one.passed for one in film_checks(found)}
    assert checks["stays in view"]
    excused_s = seconds_out_of_view(found)
    assert len(excused_s) > 30
    kept = recording_checks(found.drop, np.zeros((2, 1)), 0.4, excused_s)
    assert all(one.passed for one in kept)
    assert not all(one.passed for one in recording_checks(found.drop, np.zeros((2, 1)), 0.4))


def failed(track: Track) -> set[str]:
    found = find_filmed_drop(track, 0)
    return {one.name for one in film_checks(found) if not one.passed}


def test_a_good_film_passes_every_check():
    assert failed(filmed(0.7)) == set()


def test_a_ball_that_is_lost_half_of_the_time_is_not_in_view():
    track = filmed(0.7, rate_hz=120)
    places = track.places_px.copy()
    places[70::2] = np.nan
    assert "stays in view" in failed(replace(track, places_px=places))


def test_a_camera_that_repeats_pictures_is_seen():
    track = filmed(0.7, rate_hz=120)
    places = track.places_px.copy()
    places[1::2] = places[::2][: len(places[1::2])]
    assert "pictures differ" in failed(replace(track, places_px=places))


def test_pictures_that_were_dropped_unevenly_are_missed():
    """A film of 30 Hz, copied at 25: every sixth picture is lost, and no stamp tells of it."""
    track = filmed(0.8, gap_m=1.5, rate_hz=30, seconds=3.0)
    kept = np.flatnonzero(np.arange(len(track.stamps_ns)) % 6 != 4)
    stamps_ns = np.arange(len(kept)) * 40_000_000
    copied = replace(
        track,
        stamps_ns=stamps_ns,
        places_px=track.places_px[kept],
        radius_px=track.radius_px[kept],
        confidence=track.confidence[kept],
    )
    assert "no pictures missing" in failed(copied)
    assert "no pictures missing" not in failed(track)
    stamped = replace(copied, stamps_ns=track.stamps_ns[kept])
    assert "no pictures missing" not in failed(stamped)


def scale_of(track: Track, diameter_m: float | None, height_m: float | None) -> list[Check]:
    return scale_checks(FilmDetection(True, "/camera", 0, track, Ball(diameter_m), height_m))


def test_a_frame_rate_that_cannot_be_is_seen_where_a_length_is_known():
    track = filmed(0.7, gap_m=1.0)
    assert all(one.passed for one in scale_of(track, None, 1.0))
    assert not all(one.passed for one in scale_of(track, None, 4.0))
    diameter_m = 1.0 * 10 / 120
    assert all(one.passed for one in scale_of(track, diameter_m, None))
    assert not all(one.passed for one in scale_of(track, 4 * diameter_m, None))
    assert scale_of(track, None, None) == []


@pytest.mark.parametrize("unknown", [0.0, -1.0, np.nan, np.inf])
def test_a_height_that_cannot_be_is_not_known(unknown: float):
    track = filmed(0.7, gap_m=1.0)
    assert scale_of(track, None, unknown) == []
    assert scale_of(track, 0.08, unknown) == scale_of(track, 0.08, None) != []


@pytest.mark.parametrize(
    ("slower", "diameter_m", "said", "tells"),
    [
        (1, None, False, True),
        (4, None, False, False),  # 16 m by the clock, a ball of 1.3 m
        (4, None, True, True),
        (4, 0.083, False, False),
        (1, 0.083, False, True),
        (2, 0.083, False, False),
    ],
)
def test_what_hangs_on_the_clock_is_told_only_where_nothing_doubts_it(
    slower: int, diameter_m: float | None, said: bool, tells: bool
):
    track = filmed(0.7, gap_m=1.0)
    track = replace(track, stamps_ns=track.stamps_ns * slower)
    detection = FilmDetection(True, "/camera", 0, track, Ball(diameter_m), is_rate_known=said)
    assert detection.tells_speed == tells
    assert (detection.extent[1] != "height unknown") == tells
    assert all((one.impact_speed_m_s is not None) == tells for one in detection.rebounds)
    warned = any("slow motion" in one for one in detection.warnings)
    assert warned == (not tells and diameter_m is None)


@pytest.mark.parametrize(("restitution", "stands_out"), [(0.08, False), (0.2, True)])
def test_a_bounce_is_as_high_as_the_square_of_its_restitution(restitution: float, stands_out: bool):
    """Of a fall of 120 px, 0.8 px, less than any noise leaves, and 4.8 px."""
    check = hop_check(find_filmed_drop(filmed(0.7), 0), restitution)
    assert float(check.detail.split()[0]) == pytest.approx(120 * restitution**2, rel=0.03, abs=0.05)
    assert check.passed == stands_out
