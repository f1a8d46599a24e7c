"""A ball that is seen and heard: what its sound adds, and that another sound adds nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tunenet_logs.analysis.drop.audio import HeardImpacts, foretold, sound_beside
from tunenet_logs.analysis.drop.audio import with_sound as heard_with
from tunenet_logs.analysis.drop.detection import DropDetection
from tunenet_logs.analysis.evaluation.studies.audio import UNRELATED, unrelated_sound, without_sound
from tunenet_logs.analysis.evaluation.worlds.audio import (
    film_with_sound,
    track_with_sound,
    with_sound,
)
from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.presentation import sound_words
from tunenet_logs.analysis.record import Estimate, read_record, to_json
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.errors import LogError

SEED = 77
TRACKS = range(3)
LASTING = 7  # a track whose ball is heard for long


def restitution(tuning: Tuning) -> Estimate:
    found = tuning.record.estimate("restitution")
    assert found is not None
    return found


def width(tuning: Tuning) -> float:
    return float(np.ptp(np.array(restitution(tuning).interval95)))


def test_sound_beside_positions_narrows_the_interval_and_says_by_how_much():
    ratios = []
    for number in TRACKS:
        track = track_with_sound(SEED, number)
        deaf = tune_episode(without_sound(track.episode()), TuneOptions())
        heard = tune_episode(track.episode(), TuneOptions())
        sound = heard.record.motion.sound
        assert sound is not None
        assert sound.used, sound.reason
        assert sound.offset_s == pytest.approx(track.offset_s, abs=0.006)  # sound travels
        assert 3 <= sound.heard <= sound.impacts
        assert sound.restitution == restitution(deaf).value
        assert sound.interval95 == restitution(deaf).interval95
        assert restitution(heard).value == pytest.approx(track.restitution, abs=0.02)
        assert heard.cross_check is not None
        assert "by ear" in heard.cross_check.method
        assert heard.cross_check.agrees
        assert "impacts heard" in sound_words(heard.record)
        ratios.append(width(heard) / width(deaf))
    assert max(ratios) < 1  # every one, not only most


def test_later_bounces_than_the_pictures_tell_are_heard_and_narrow_it_most():
    track = track_with_sound(SEED, LASTING)
    assert track.clip.scene.audible > 8
    detection = tune_episode(track.episode(), TuneOptions()).detection
    assert isinstance(detection, DropDetection)
    assert detection.ear is not None
    assert detection.ear.touches is not None
    assert detection.ear.impacts is not None
    assert detection.ear.touches.numbers.max() >= len(detection.ear.impacts.times_s)
    assert np.all(np.diff(detection.ear.touches.numbers) > 0)  # each knock once
    assert len(detection.ear.touches.numbers) <= detection.ear.share.impacts
    ends = detection.ear.posterior.interval95[0], detection.ear.pictures.interval95[0]
    assert np.ptp(ends[0]) < np.ptp(ends[1]) / 2
    assert ends[0][0] < track.restitution < ends[0][1]


def test_the_touches_of_an_uneven_ball_are_trusted_less():
    """Each impact returns half a percent more or less than the law says."""
    detection = tune_episode(track_with_sound(SEED, LASTING).episode(), TuneOptions()).detection
    assert isinstance(detection, DropDetection)
    assert detection.ear is not None
    pictures, even = detection.ear.pictures, detection.ear.touches
    assert even is not None
    returned = np.random.default_rng(3).normal(0.0, 0.005, len(even.times_s) - 1)
    flights_s = np.diff(even.times_s) * np.exp(np.cumsum(returned))
    times_s = even.times_s[0] + np.concatenate([[0.0], np.cumsum(flights_s)])
    sds_s, half = np.full(len(times_s), 1e-4), np.full(len(times_s), 0.5)
    found = heard_with(pictures, HeardImpacts(times_s, sds_s, half))
    assert found.touches is not None, found.reason
    assert found.touches.scatter > even.scatter
    widths = [np.ptp(one.posterior.interval95[0]) for one in (found, detection.ear)]
    assert widths[0] > 1.5 * widths[1]


def test_a_record_keeps_what_the_sound_added(tmp_path: Path):
    record = tune_episode(track_with_sound(SEED, 0).episode(), TuneOptions()).record
    file = tmp_path / "heard.json"
    file.write_text(to_json(record))
    fields = json.loads(file.read_text())
    assert set(fields["sound"]) == {"impacts", "heard", "offset_s", "used", "reason", "without"}
    assert read_record(file).motion.sound == record.motion.sound
    fields["sound"]["used"] = False
    file.write_text(json.dumps(fields))
    with pytest.raises(LogError, match="its sound"):
        read_record(file)


@pytest.mark.parametrize("what", UNRELATED)
def test_a_sound_that_is_another_ones_changes_nothing(what: str):
    track = track_with_sound(SEED, 1)
    episode = without_sound(track.episode())
    deaf = tune_episode(episode, TuneOptions())
    other = unrelated_sound(what, track.clip.scene.lasts_s, SEED, 1)
    heard = tune_episode(with_sound(episode, other), TuneOptions())
    sound = heard.record.motion.sound
    assert sound is not None
    assert not sound.used
    assert sound_words(heard.record) == f"sound: not used: {sound.reason}"
    assert restitution(heard) == restitution(deaf)
    assert heard.cross_check == deaf.cross_check
    assert heard.verdict == deaf.verdict


def test_without_sound_a_record_is_silent_about_it():
    deaf = tune_episode(without_sound(track_with_sound(SEED, 0).episode()), TuneOptions())
    assert deaf.record.motion.sound is None
    assert json.loads(to_json(deaf.record))["sound"] is None
    assert sound_words(deaf.record) == ""


def test_of_several_cameras_none_is_listened_to():
    episode = track_with_sound(SEED, 0).episode()
    assert sound_beside(episode, 0) is not None
    camera = replace(episode.channels[0], pictures=True, sounds=False)
    cameras = (replace(camera, topic="/left"), replace(camera, topic="/right"))
    assert sound_beside(replace(episode, channels=(*episode.channels, *cameras)), 0) is None


def test_false_and_lost_knocks_are_told_from_impacts():
    """Make-believe onsets: one lost, four false, .15 ms of jitter."""
    detection = tune_episode(track_with_sound(SEED, 2).episode(), TuneOptions()).detection
    assert isinstance(detection, DropDetection)
    assert detection.ear is not None
    pictures, both = detection.ear.pictures, detection.ear.posterior
    impacts = foretold(pictures.fit)
    numbers = np.delete(np.arange(len(impacts.times_s)), 1)
    rng = np.random.default_rng(5)
    true_s = both.fit.samples.touches_s(both.fit.unknowns, numbers) + 0.0237
    true_s += rng.normal(0, 0.00015, len(true_s))
    false_s = rng.uniform(true_s[0], true_s[-1], 4)
    times_s = np.sort(np.concatenate([true_s, false_s]))
    sds_s, half = np.full(len(times_s), 0.00015), np.full(len(times_s), 0.5)
    found = heard_with(pictures, HeardImpacts(times_s, sds_s, half))
    assert found.touches is not None, found.reason
    assert found.offset_s == pytest.approx(0.0237, abs=0.005)
    assert set(found.touches.numbers.tolist()) <= set(numbers.tolist())
    assert len(found.touches.numbers) >= len(numbers) - 1


def test_a_film_is_heard_too(tmp_path: Path):
    film = film_with_sound(SEED, 1)
    file, silent = tmp_path / "heard.mp4", tmp_path / "silent.mp4"
    film.write(file)
    film.write(silent, with_sound=False)
    heard, deaf = tune_log(file, TuneOptions()), tune_log(silent, TuneOptions())
    assert deaf.record.motion.sound is None
    sound = heard.record.motion.sound
    assert sound is not None
    assert sound.used, sound.reason
    assert sound.restitution == pytest.approx(restitution(deaf).value, abs=1e-9)
    assert sound.offset_s == pytest.approx(film.offset_s, abs=0.02)
    assert restitution(heard).value == pytest.approx(film.restitution, abs=0.02)
