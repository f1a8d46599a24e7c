"""What is heard is shown: the envelope, the knocks on it, and nothing where nothing sounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.analysis.review.stored import Stored
from tests.analysis.review.test_no_view_is_empty import empty_views, review_of
from tests.conftest import ROOT, film, record
from tunenet_logs.analysis.drop.review.views import envelope
from tunenet_logs.analysis.evaluation.studies.audio import (
    sound_alone,
    unrelated_sound,
    without_sound,
)
from tunenet_logs.analysis.evaluation.worlds.audio import (
    NoBounce,
    draw_sound,
    track_with_sound,
    with_sound,
)
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Episode
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.base import GRAVITY_M_S2

RATE_HZ = 48_000
SPEECH = unrelated_sound("speech", 4.0, 1, 0)
SILENCE = unrelated_sound("silence", 4.0, 1, 0)
TRACK = track_with_sound(11, 0)


def knocks(seconds: NDArray[np.float64], lasts_s: float) -> NoBounce:
    """Clicks at these times, over a faint noise."""
    rng = np.random.default_rng(0)
    samples = rng.normal(0, 1e-3, round(lasts_s * RATE_HZ)).astype(np.float32)
    click = 0.5 * rng.normal(0, 1, 300) * np.exp(-np.arange(300) / 50)
    for at in np.round(seconds * RATE_HZ).astype(int).tolist():
        samples[at : at + 300] += click[: len(samples) - at].astype(np.float32)
    return NoBounce("knocks", np.clip(samples, -1, 1), RATE_HZ, "pcm")


def filmed_impacts_s() -> NDArray[np.float64]:
    """Of the filmed sample, after its first picture."""
    fall_s = np.sqrt(2 * 1.1 / GRAVITY_M_S2)
    return 0.4 + fall_s + np.append(0.0, np.cumsum(2 * fall_s * 0.74 ** np.arange(1, 6)))


def bounce() -> Episode:
    return sound_alone(draw_sound(11, 0, snr_db=25.0))


def one_knock() -> Episode:
    return sound_alone(knocks(np.array([1.0]), 2.0))


def film_and_sound() -> Episode:
    filmed = read_episode(ROOT / "sample_logs" / "filmed.mcap")
    impacts_s = filmed_impacts_s()
    return with_sound(filmed, knocks(impacts_s[impacts_s < 2.5], 2.7), 0.02)


def track_and_speech() -> Episode:
    return with_sound(without_sound(TRACK.episode()), SPEECH)


def track_and_silence() -> Episode:
    return with_sound(without_sound(TRACK.episode()), SILENCE)


def fall_and_speech(folder: Path) -> Episode:
    order = {"restitution": 0.7, "height_m": 1.0, "seconds": 0.45, "hold_s": 0.2, "seed": 5}
    return with_sound(read_episode(film(folder / "a.mcap", **order)), SPEECH)


def review_in(folder: Path, episode: Episode, verdict: str | None = None) -> Stored:
    """The review of an episode; no view of it is ever empty."""
    path = review_of(tune_episode(episode, TuneOptions()), folder, verdict)
    assert empty_views(path) == []
    return Stored(path)


def sound_views(review: Stored) -> list[str]:
    return [view.name for view in review.views if view.name.startswith("sound")]


def marked_s(review: Stored, entity: str) -> NDArray[np.float64]:
    """When marks are, on the log's time."""
    (times_ns, _) = review.entities[entity]["Scalars:scalars"].timed["log_time_s"]
    return times_ns.astype(np.float64) * 1e-9


def off_s(seconds: NDArray[np.float64], truth_s: NDArray[np.float64]) -> float:
    """The largest distance of a time from the nearest true one."""
    return float(np.abs(seconds[:, None] - truth_s).min(axis=1).max())


def test_a_bounce_that_is_heard_alone_has_its_impacts_on_both(tmp_path: Path):
    review = review_in(tmp_path, bounce(), "ok")
    scene = draw_sound(11, 0, snr_db=25.0).scene
    assert sound_views(review) == ["sound [dBFS], white: its impacts, red: other knocks"]
    for place in ("sound", "height"):
        heard_s = marked_s(review, f"/{place}/heard")
        assert len(heard_s) >= 5
        assert off_s(heard_s, scene.impacts_s) < 0.002


def test_a_sound_without_a_ball_shows_what_knocks(tmp_path: Path):
    review = review_in(tmp_path, one_knock(), "rejected")
    assert "what knocks" in sound_views(review)[0]
    assert off_s(np.array([1.0]), marked_s(review, "/sound/knock")) < 0.002


def test_impacts_heard_beside_a_track_lie_where_the_ball_hits(tmp_path: Path):
    review = review_in(tmp_path, TRACK.episode(), "ok")
    for place in ("sound", "height"):
        heard_s = marked_s(review, f"/{place}/touch")
        assert len(heard_s) >= 3
        assert off_s(heard_s, TRACK.clip.scene.touches_s) < 0.01
    assert "white: heard" in sound_views(review)[0]


def test_impacts_heard_beside_a_film_lie_where_the_ball_hits(tmp_path: Path):
    review = review_in(tmp_path, film_and_sound(), "ok")
    assert "white: heard" in sound_views(review)[0]
    assert off_s(marked_s(review, "/height/touch"), filmed_impacts_s()) < 0.01
    pictures = picture_times_ns(review)
    (sent_ns, _) = review.entities["/sound/envelope"]["Scalars:scalars"].timed["log_time_s"]
    assert sent_ns[0] >= pictures[0]  # or the review would begin without a picture


def picture_times_ns(review: Stored) -> NDArray[np.int64]:
    (times_ns, _) = review.entities["/film/picture"]["EncodedImage:blob"].timed["log_time_s"]
    return times_ns


def test_a_sound_that_is_not_used_says_so(tmp_path: Path):
    review = review_in(tmp_path, track_and_speech(), "ok")
    assert "not used" in sound_views(review)[0]
    assert "/sound/touch" not in review.entities


def test_a_rejected_film_has_its_sound_too(tmp_path: Path):
    assert sound_views(review_in(tmp_path, fall_and_speech(tmp_path), "rejected"))


def test_a_rejected_track_has_its_sound_too(tmp_path: Path):
    track = read_episode(record(tmp_path / "a.mcap", restitution=0.0, height_m=1.0))
    ends_s = track.signals["/ball/pose"].seconds[-1]
    knocks_s = np.array([0.5, 1.3, ends_s + 0.5])
    review = review_in(tmp_path, with_sound(track, knocks(knocks_s, ends_s + 1.0), 0.2), "rejected")
    (view,) = sound_views(review)
    assert "what knocks" in view
    marks_s = marked_s(review, "/sound/knock")
    assert off_s(knocks_s[:2] + 0.2, marks_s) < 0.002
    assert marks_s.max() <= ends_s


@pytest.mark.parametrize("make", [track_and_silence, lambda: sound_alone(SILENCE)])
def test_silence_has_no_view(tmp_path: Path, make: Callable[[], Episode]):
    assert not sound_views(review_in(tmp_path, make()))


def test_an_envelope_has_the_peaks_and_few_points():
    sound = knocks(np.array([1.0, 100.0]), 150.0).sound()
    seconds, levels_db = envelope(sound, (99.0, 101.0))
    assert len(seconds) <= 30_000
    assert np.median(np.diff(seconds)) == pytest.approx(0.004)
    assert seconds[levels_db.argmax()] == pytest.approx(100.0, abs=0.008)
    whole_s, whole_db = envelope(sound, (0.0, 150.0))
    assert len(whole_s) <= 30_000
    assert whole_db.max() == pytest.approx(levels_db.max(), abs=3.0)


def test_an_envelope_of_broken_samples_is_finite_or_silent():
    samples = np.array([0.5, np.nan, np.inf, -0.25, 0.0, 0.0], np.float32)
    sound = replace(SILENCE.sound(), samples=samples, rate_hz=100.0, file_rate_hz=100.0)
    _, levels_db = envelope(sound, (0.0, 1.0))
    assert levels_db[[0, 3]] == pytest.approx([-6.02, -12.04], abs=0.01)
    assert np.isneginf(levels_db[[1, 2, 4, 5]]).all()
