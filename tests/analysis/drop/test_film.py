"""From a track to a drop: any camera, height and rate; and what is no drop is named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.analysis.drop.made import GRAVITY, filmed, pixels, track_of
from tests.strangers import bounce_heights
from tunenet_logs.analysis.drop.bounce_model import BounceSamples
from tunenet_logs.analysis.drop.checks import (
    film_checks,
    hop_check,
    recording_checks,
    seconds_out_of_view,
)
from tunenet_logs.analysis.drop.detection import FilmDetection
from tunenet_logs.analysis.drop.film import canonical_film, find_filmed_drop, why_not
from tunenet_logs.analysis.drop.motion import drop_problem
from tunenet_logs.analysis.drop.presets import FILM_TRAININGS
from tunenet_logs.analysis.estimators.methods import TuneNet
from tunenet_logs.analysis.evaluation.worlds.camera import B, BallRanges, draw_scene, film
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.analysis.tunenet.network import Model
from tunenet_logs.analysis.tunenet.weights import shipped_model
from tunenet_logs.errors import NotFoundError
from tunenet_logs.recorders.simulators.ball import Bounce
from tunenet_logs.recorders.simulators.known import Ball


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


def test_a_film_that_ends_in_the_second_flight():
    found = find_filmed_drop(filmed(0.8, seconds=1.6), 0)
    assert found.projection.bounce.restitution == pytest.approx(0.8, abs=0.01)
    observed = canonical_film(found).values[:, 0]
    assert np.isnan(observed[-1])
    assert np.isfinite(observed[:40]).all()


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


def lowered() -> Track:
    """By a hand that then holds it."""
    hand = np.concatenate([np.linspace(1.15, 1.0, 40), np.full(15, 1.0)])
    free = bounce_heights(0.6, 1.0, np.arange(120) / 60.0, GRAVITY)
    return track_of(pixels(np.concatenate([hand, free]), 120, 0.2), 60.0)


def with_gaps_and_outliers() -> Track:
    track = filmed(0.65, rate_hz=120)
    places = track.places_px.copy()
    rng = np.random.default_rng(2)
    places[rng.choice(len(places), 30, replace=False)] = np.nan
    places[[80, 150]] += [0, 12]
    return replace(track, places_px=places)


@pytest.mark.parametrize(
    ("track", "restitution", "off"),
    [
        *((filmed(0.7, start_s=start_s), 0.7, 0.02) for start_s in (0.1, 0.2, 0.3)),
        (lowered(), 0.6, 0.012),
        (with_gaps_and_outliers(), 0.65, 0.01),
    ],
    ids=["let go before", "earlier", "still earlier", "lowered by a hand", "gaps and outliers"],
)
def test_whatever_is_seen_before_and_between(track: Track, restitution: float, off: float):
    found = find_filmed_drop(track, 0)
    assert found.projection.bounce.restitution == pytest.approx(restitution, abs=off)


def moved(heights: np.ndarray, sideways: np.ndarray | None = None) -> Track:
    return track_of(pixels(heights, 120, 0), 60, sideways=sideways)


NO_DROPS = {
    "still": (moved(np.full(100, 0.5)), "moves by only"),
    "thrown and caught": (
        moved(1 - np.linspace(-1, 1, 60) ** 2),
        "no bounce is seen: the ball never falls onto anything",
    ),
    "waved slowly": (moved(0.5 + 0.5 * np.sin(np.arange(300) / 20)), "no bounce|no free fall"),
    "waved": (moved(0.5 + 0.5 * np.sin(np.arange(150) / 9)), "no bounce|no free fall|no drop"),
    "lowered": (moved(np.linspace(1, 0, 100)), "no bounce|no free fall|no drop"),
    "rolls": (
        moved(np.zeros(60), np.linspace(20, 300, 60)),
        r"280 px across .* rolls, or is filmed from above",
    ),
    "carried": (
        moved(0.5 + 0.3 * np.sin(np.arange(400) / 30) + 0.15 * np.sin(np.arange(400) / 15)),
        "the ball hardly flies, it is carried",
    ),
}


@pytest.mark.parametrize("name", NO_DROPS)
def test_what_is_no_drop_is_named(name: str):
    track, reason = NO_DROPS[name]
    with pytest.raises(NotFoundError, match=reason):
        find_filmed_drop(track, 0)


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
    assert {one.name: one.passed for one in film_checks(found)}["stays in view"]
    excused_s = seconds_out_of_view(found)
    assert len(excused_s) > 30
    kept = recording_checks(found.drop, np.zeros((2, 1)), 0.4, excused_s)
    assert all(one.passed for one in kept)


@pytest.fixture(scope="module")
def model() -> Model:
    return shipped_model(FILM_TRAININGS["default"].purpose)


@pytest.mark.parametrize(
    ("noise_px", "most"), [(0.3, 0.006), pytest.param(1.0, 0.015, marks=pytest.mark.slow)]
)
def test_the_network_alone_finds_restitutions_in_tracks(model: Model, noise_px: float, most: float):
    off: list[float] = []
    for number in range(8):
        scene = draw_scene(B, BallRanges((0.2, 0.95), slope=(0.0, 0.1)), noise_px, -78, number)
        found = FilmDetection(True, "", 0, film(scene), Ball())
        problem = drop_problem(found, np.zeros(3))
        off.append(float(TuneNet(model).estimate(problem, 5).estimate[0]) - scene.ball.restitution)
    assert np.mean(np.abs(off)) < most


@pytest.mark.parametrize("restitution", [0.2, 0.5, 0.95])
def test_equal_observations_do_not_differ(model: Model, restitution: float):
    scene = draw_scene(B, BallRanges((restitution, restitution)), 0.3, -78, 1)
    seen = canonical_film(find_filmed_drop(film(scene), 0)).values[None]
    assert np.array_equal(model(seen, seen), np.zeros((1, 3)))


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
