"""Drops whose clock jumps: positions, films, and stamps that no rollout follows."""

from dataclasses import replace

import numpy as np
import pytest

from tests.analysis.films import short_film
from tests.conftest import Made
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tracking.frames import Pictures
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.ball import DropRig, DropSimulator

DAY_NS = 86_400 * 10**9


def with_frames(episode: Episode, change) -> Episode:
    """The film with each stamp as `change` (of its number and itself) has it."""

    def opened(topic: str):
        for number, frame in enumerate(episode.frames(topic)):
            yield replace(frame, stamp_ns=change(number, frame.stamp_ns))

    return replace(episode, open_frames=opened)


@pytest.mark.parametrize("at", [0, 20])
@pytest.mark.parametrize("days", [1, -1])
def test_a_picture_a_day_off_hides_no_other(made: Made, at: int, days: int):
    """Before, all that followed one a day late had "a stamp already seen"."""
    film = read_episode(short_film(made))
    topic = film.picture_topics[0]
    whole = Pictures(film, topic)
    off = with_frames(film, lambda number, ns: ns + (days * DAY_NS if number == at else 0))
    pictures = Pictures(off, topic)
    assert np.array_equal(pictures.stamps_ns, np.delete(whole.stamps_ns, at))
    assert pictures.start_ns == pictures.stamps_ns[0]
    assert len(list(pictures)) == len(whole.stamps_ns) - 1
    assert "not used" in pictures.jumps[0]
    assert not whole.jumps


def test_a_part_of_a_film_counts_from_its_clock(made: Made):
    film = read_episode(short_film(made))
    topic = film.picture_topics[0]
    off = with_frames(film, lambda number, ns: ns + (0 if number else DAY_NS))
    pictures = Pictures(off, topic, start_s=0.5)
    assert 0.5 <= (pictures.stamps_ns[0] - pictures.start_ns) * 1e-9 < 0.6


def test_pictures_of_a_clock_that_is_set_back_are_no_mixture(made: Made):
    film = read_episode(short_film(made))
    topic = film.picture_topics[0]
    count = len(Pictures(film, topic).stamps_ns)
    first = 2 * count // 3
    off = with_frames(film, lambda number, ns: ns - (500_000_000 if number >= first else 0))
    pictures = Pictures(off, topic)
    assert len(pictures.stamps_ns) == first
    assert "is set back by" in pictures.jumps[0]


def test_positions_on_both_sides_of_a_jump_are_one_part():
    episode = DropSimulator(DropRig(gap_m=0.8, rate_hz=100.0, samples=300, hold_s=0.1)).rollout(
        {"restitution": 0.8}
    )
    (name, signal), *_ = episode.signals.items()
    stamps = signal.stamps_ns.copy()
    stamps[250:] += DAY_NS
    off = replace(episode, signals={name: replace(signal, stamps_ns=stamps)})
    tuning = tune_episode(off, TuneOptions())
    assert tuning.trace is not None, tuning.reason
    assert abs(float(tuning.trace.estimate[0]) - 0.8) < 0.005
    assert any("after sample 250 of 300" in words for words in tuning.warnings)
    assert tuning.episode is not None
    assert len(tuning.episode.signals[name].stamps_ns) == 250


def test_no_rollout_lasts_for_days():
    with pytest.raises(UsageError, match="not within an hour"):
        DropRig(samples=2, times_s=(0.0, 86_400.0))
