"""What is heard is shown: the envelope, the knocks on it, and nothing where nothing sounds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.analysis.review.stored import Stored, empty_views, review_of
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
    return NoBounce(np.clip(samples, -1, 1), RATE_HZ, "pcm", "knocks")


def marked_s(review: Stored, entity: str) -> NDArray[np.float64]:
    """When marks are, on the log's time."""
    (times_ns, _) = review.entities[entity]["Scalars:scalars"].timed["log_time_s"]
    return times_ns.astype(np.float64) * 1e-9


def off_s(seconds: NDArray[np.float64], truth_s: NDArray[np.float64]) -> float:
    """The largest distance of a time from the nearest true one."""
    return float(np.abs(seconds[:, None] - truth_s).min(axis=1).max())


def filmed_impacts_s() -> NDArray[np.float64]:
    """Of the filmed sample, after its first picture."""
    fall_s = np.sqrt(2 * 1.1 / GRAVITY_M_S2)
    return 0.4 + fall_s + np.append(0.0, np.cumsum(2 * fall_s * 0.74 ** np.arange(1, 6)))


def film_and_sound(_: Path) -> Episode:
    impacts_s = filmed_impacts_s()
    heard = knocks(impacts_s[impacts_s < 2.5], 2.7)
    return with_sound(read_episode(ROOT / "sample_logs" / "filmed.mcap"), heard, 0.02)


def fall_and_speech(folder: Path) -> Episode:
    order = {"restitution": 0.7, "height_m": 1.0, "seconds": 0.45, "hold_s": 0.2, "seed": 5}
    return with_sound(read_episode(film(folder / "a.mcap", **order)), SPEECH)


def flat_track_and_knocks(folder: Path) -> Episode:
    track = read_episode(record(folder / "a.mcap", restitution=0.0, height_m=1.0))
    ends_s = track.signals["/ball/pose"].seconds[-1]
    return with_sound(track, knocks(np.array([0.5, 1.3, ends_s + 0.5]), ends_s + 1.0), 0.2)


def last_s(track: Path) -> float:
    return float(read_episode(track).signals["/ball/pose"].seconds[-1])


SCENE = draw_sound(11, 0, snr_db=25.0)
HEARD = [  # an episode, its verdict, a title, where marks are, of what, and how far off at most
    (lambda _: sound_alone(SCENE), "ok", "white: its impacts, red: other knocks",
     ("/sound/heard", "/height/heard"), SCENE.scene.impacts_s, 0.002),
    (lambda _: TRACK.episode(), "ok", "white: heard",
     ("/sound/touch", "/height/touch"), TRACK.clip.scene.touches_s, 0.01),
    (film_and_sound, "ok", "white: heard", ("/height/touch",), filmed_impacts_s(), 0.01),
    (lambda _: sound_alone(knocks(np.array([1.0]), 2.0)), "rejected", "what knocks",
     ("/sound/knock",), np.array([1.0]), 0.002),
    (flat_track_and_knocks, "rejected", "what knocks",
     ("/sound/knock",), np.array([0.7, 1.5]), 0.002),
    (fall_and_speech, "rejected", "sound", (), None, 0.0),
    (lambda _: with_sound(without_sound(TRACK.episode()), SPEECH), "ok", "not used", (), None, 0.0),
    (lambda _: with_sound(without_sound(TRACK.episode()), SILENCE), "ok", "", (), None, 0.0),
    (lambda _: sound_alone(SILENCE), "rejected", "", (), None, 0.0),
]  # fmt: skip


@pytest.mark.parametrize(("make", "verdict", "title", "places", "truth_s", "most_s"), HEARD)
def test_what_is_heard_is_shown_where_it_sounds(
    tmp_path: Path, make, verdict: str, title: str, places, truth_s, most_s: float
):
    """No view is ever empty, and nothing is shown of silence."""
    path = review_of(tune_episode(make(tmp_path), TuneOptions()), tmp_path, verdict)
    assert empty_views(path) == []
    review = Stored(path)
    titles = [view.name for view in review.views if view.name.startswith("sound")]
    assert [title in one for one in titles] == [True] * bool(title)
    for place in places:
        marks_s = marked_s(review, place)
        if verdict == "ok":
            assert len(marks_s) >= (5 if place.endswith("heard") else 3)
            assert off_s(marks_s, truth_s) < most_s
        else:  # other sounds knock, too
            assert off_s(truth_s, marks_s) < most_s
            assert marks_s.max() <= 1 or marks_s.max() <= last_s(tmp_path / "a.mcap")
    assert ("/sound/touch" in review.entities) == (title == "white: heard")
    if make is film_and_sound:
        (pictures_ns, _) = review.entities["/film/picture"]["EncodedImage:blob"].timed["log_time_s"]
        (sent_ns, _) = review.entities["/sound/envelope"]["Scalars:scalars"].timed["log_time_s"]
        assert sent_ns[0] >= pictures_ns[0]  # or the review would begin without a picture


def test_an_envelope_has_the_peaks_few_points_and_nothing_of_broken_samples():
    sound = knocks(np.array([1.0, 100.0]), 150.0).sound()
    seconds, levels_db = envelope(sound, (99.0, 101.0))
    assert len(seconds) <= 30_000
    assert np.median(np.diff(seconds)) == pytest.approx(0.004)
    assert seconds[levels_db.argmax()] == pytest.approx(100.0, abs=0.008)
    whole_s, whole_db = envelope(sound, (0.0, 150.0))
    assert len(whole_s) <= 30_000
    assert whole_db.max() == pytest.approx(levels_db.max(), abs=3.0)
    samples = np.array([0.5, np.nan, np.inf, -0.25, 0.0, 0.0], np.float32)
    broken = replace(sound, samples=samples, rate_hz=100.0, file_rate_hz=100.0)
    _, levels_db = envelope(broken, (0.0, 1.0))
    assert levels_db[[0, 3]] == pytest.approx([-6.02, -12.04], abs=0.01)
    assert np.isneginf(levels_db[[1, 2, 4, 5]]).all()
