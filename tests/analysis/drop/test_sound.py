"""A ball by its sound or the times of its impacts, and what sound adds to a ball that is seen."""

from __future__ import annotations

import json
import re
import wave
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from rerun.chunk import RrdReader

from tests.analysis.answers import ends, known, value
from tests.analysis.drop.made import DRAG_1_M, HEIGHT_M, RESTITUTION, SLOPE, episode_of, impacts
from tests.export_writers_video import phyphox_xlsx
from tunenet_logs.analysis.cli.tune import main
from tunenet_logs.analysis.drop.audio import sound_beside
from tunenet_logs.analysis.drop.detection import DropDetection
from tunenet_logs.analysis.drop.experiments import DropFromTimes
from tunenet_logs.analysis.drop.times.model import DropSetup, heard_ball
from tunenet_logs.analysis.evaluation.studies.audio import (
    UNRELATED,
    answer_to,
    is_answered,
    unrelated_sound,
    without_sound,
)
from tunenet_logs.analysis.evaluation.studies.impact_times import (
    NO_BALLS,
    counted_verdicts,
    figures_of,
    scored_sets,
)
from tunenet_logs.analysis.evaluation.worlds.audio import (
    NO_BOUNCES,
    SoundClip,
    draw_negative,
    draw_sound,
    film_with_sound,
    track_with_sound,
    with_sound,
)
from tunenet_logs.analysis.experiment import Claim, Tuning, record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.presentation import sound_words
from tunenet_logs.analysis.record import Estimate, Record, SoundShare, read_record, to_json
from tunenet_logs.analysis.tuning import tune_episode, tune_log
from tunenet_logs.episode import FRAME_NS, Episode, EpisodeInfo, Signal
from tunenet_logs.errors import LogError, NotFoundError
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.ball import Bounce
from tunenet_logs.recorders.simulators.known import ball_named

QUIET = (7, 8, 9)  # clips of a seed that nothing else uses


def quiet_clip(number: int) -> SoundClip:
    return draw_sound(-7, number, background="quiet", snr_db=35.0)


def heard(
    path: Path, samples: NDArray[np.float32], rate_hz: float, options: TuneOptions | None = None
) -> Record:
    """What is tuned from a WAV of 16 bit, written by Python's own library."""
    with wave.open(str(path / "a.wav"), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(int(rate_hz))
        file.writeframes((np.clip(samples, -1, 1) * 32767).astype("<i2").tobytes())
    return record_of(tune_episode(read_episode(path / "a.wav"), options or TuneOptions()))


def told(found: Record) -> tuple[float, float, float]:
    """Value and ends of its interval; NaN where there are none."""
    estimate = found.estimate("restitution")
    assert estimate is not None, found.reason
    ends = (np.nan, np.nan) if estimate.interval95 is None else estimate.interval95
    low, high = np.ravel(ends).tolist()
    return float(np.ravel(estimate.value)[0]), low, high


@pytest.mark.parametrize("number", QUIET)
def test_a_bounce_is_tuned_by_its_sound(tmp_path: Path, number: int):
    clip = quiet_clip(number)
    found = heard(tmp_path, clip.samples, clip.rate_hz)
    value, low, high = told(found)
    assert found.verdict != "rejected", found.reason
    assert abs(value - clip.restitutions[1]) < 0.01
    assert low - 0.005 < clip.restitutions[1] < high + 0.005


def test_the_height_tells_the_first_impact_and_silence_around_it_nothing(tmp_path: Path):
    clip = quiet_clip(QUIET[0])
    known = TuneOptions(height_m=clip.scene.history.order.height_m)
    value, _, _ = told(heard(tmp_path, clip.samples, clip.rate_hz, known))
    assert abs(value - clip.restitutions[0]) < 0.02
    noise = 1e-4 * np.random.default_rng(0).standard_normal(3 * int(clip.rate_hz))
    around = np.concatenate([noise, clip.samples, noise]).astype(np.float32)
    near, far = (told(heard(tmp_path, one, clip.rate_hz)) for one in (clip.samples, around))
    assert abs(near[0] - far[0]) < 0.003


def alarm_clock() -> NDArray[np.float32]:
    """Four beeps each second: noises at random times explain them better than a ball."""
    beeps_s = [0.5 + second + beep / 8 for second in range(6) for beep in range(4)]
    samples = 0.002 * np.random.default_rng(1).standard_normal(7 * 44_100)
    tone = 0.3 * np.sign(np.sin(2 * np.pi * 2048 * np.arange(2646) / 44_100))
    for at in np.round(np.array(beeps_s) * 44_100).astype(int):
        samples[at : at + len(tone)] += tone
    return samples.astype(np.float32)


def short_bounce() -> NDArray[np.float32]:
    clip = quiet_clip(QUIET[2])
    fourth_s, fifth_s = clip.scene.impacts_s[3:5]
    return clip.samples[: int(clip.rate_hz * (fourth_s + fifth_s) / 2)]


UNHEARD = "times are the ball's: no bouncing ball is heard: "
# How the reason begins, a word in it, and whether it is rejected for certain.
NO_SOUNDS = {
    **dict.fromkeys(NO_BOUNCES, ("", "", False)),
    **dict.fromkeys(("music", "metronome", "rain"), (UNHEARD, "", False)),
    "two balls": ("", "for a second ball at the same time", False),
    "alarm clock": ("", "no bouncing ball is heard", True),
    "silence": ("", "bounce", True),
    "short bounce": ("enough impacts: 4 impacts heard", "let it bounce longer", False),
}


@pytest.mark.parametrize("kind", NO_SOUNDS)
def test_what_is_no_bounce_is_told(tmp_path: Path, kind: str):
    begins, word, is_rejected = NO_SOUNDS[kind]
    rate_hz = 44_100.0
    if kind in NO_BOUNCES:
        made = draw_negative(-7, list(NO_BOUNCES).index(kind))
        samples, rate_hz = made.samples, made.rate_hz
    elif kind == "short bounce":
        samples, rate_hz = short_bounce(), quiet_clip(QUIET[2]).rate_hz
    else:
        samples = alarm_clock() if kind == "alarm clock" else np.zeros(48_000, dtype=np.float32)
    found = heard(tmp_path, samples, rate_hz)
    reason = found.reason or ""
    assert found.verdict == "rejected" if is_rejected else found.verdict != "ok"
    assert reason.startswith(begins)
    assert word in reason
    assert reason
    assert ("let it bounce longer" in reason) <= (begins != UNHEARD)


@pytest.mark.parametrize("number", QUIET[1:])
def test_an_earlier_throw_of_the_ball_is_told_and_can_be_left_out(tmp_path: Path, number: int):
    clip = quiet_clip(number)
    impacts_s = clip.scene.impacts_s
    end_s = float(impacts_s[3] + impacts_s[4]) / 2
    end, begin = (int(at_s * clip.rate_hz) for at_s in (end_s, float(impacts_s[0]) - 0.3))
    twice = np.concatenate([clip.samples[:end], clip.samples[begin:]])
    found = heard(tmp_path, twice, clip.rate_hz)
    assert found.verdict == "suspect"
    told = (
        f"the 4 knocks from {impacts_s[0]:.2f} to {impacts_s[3]:.2f} s, just before its first at "
        f"{end_s + 0.3:.2f} s, are the same ball's"
    )
    assert told in (found.reason or "")
    assert (found.reason or "").endswith("choose one drop with --start and --end")
    chosen = heard(tmp_path, twice, clip.rate_hz, TuneOptions(start_s=end_s + 0.1))
    assert chosen.verdict == "ok", chosen.reason


# ---- Beside positions and pictures


SEED = 77
TRACKS = range(3)
LASTING = 7  # a track whose ball is heard for long


def restitution(tuning: Tuning) -> Estimate:
    return known(tuning.record.estimate("restitution"))


def share(tuning: Tuning) -> SoundShare:
    return known(tuning.record.motion.sound)


def test_sound_beside_positions_narrows_the_interval_and_says_by_how_much():
    ratios = []
    for number in TRACKS:
        track = track_with_sound(SEED, number)
        deaf = tune_episode(without_sound(track.episode()), TuneOptions())
        heard = tune_episode(track.episode(), TuneOptions())
        sound = share(heard)
        assert sound.used, sound.reason
        assert sound.offset_s == pytest.approx(track.offset_s, abs=0.006)  # sound travels
        assert 3 <= sound.heard <= sound.impacts
        assert sound.restitution == restitution(deaf).value
        assert sound.interval95 == restitution(deaf).interval95
        assert restitution(heard).value == pytest.approx(track.restitution, abs=0.02)
        assert "by ear" in known(heard.cross_check).method
        assert known(heard.cross_check).agrees
        assert "impacts heard" in sound_words(heard.record)
        widths = [float(np.ptp(np.array(restitution(one).interval95))) for one in (heard, deaf)]
        ratios.append(widths[0] / widths[1])
    assert max(ratios) < 1  # every one, not only most


def test_later_bounces_than_the_pictures_tell_are_heard_and_narrow_it_most():
    track = track_with_sound(SEED, LASTING)
    assert track.clip.scene.audible > 8
    detection = tune_episode(track.episode(), TuneOptions()).detection
    assert isinstance(detection, DropDetection)
    ear = known(detection.ear)
    numbers = known(ear.touches).numbers
    assert numbers.max() >= len(known(ear.impacts).times_s)
    assert np.all(np.diff(numbers) > 0)  # each knock once
    assert len(numbers) <= ear.share.impacts
    ends = ear.posterior.interval95[0], ear.pictures.interval95[0]
    assert np.ptp(ends[0]) < np.ptp(ends[1]) / 2
    assert ends[0][0] < track.restitution < ends[0][1]


@pytest.mark.parametrize("what", UNRELATED)
def test_a_sound_that_is_another_ones_changes_nothing(what: str):
    track = track_with_sound(SEED, 1)
    episode = without_sound(track.episode())
    deaf = tune_episode(episode, TuneOptions())
    other = unrelated_sound(what, track.clip.scene.lasts_s, SEED, 1)
    heard = tune_episode(with_sound(episode, other), TuneOptions())
    assert not share(heard).used
    assert sound_words(heard.record) == f"sound: not used: {share(heard).reason}"
    assert restitution(heard) == restitution(deaf)
    assert heard.cross_check == deaf.cross_check
    assert heard.verdict == deaf.verdict


def test_a_film_is_heard_too(tmp_path: Path):
    film = film_with_sound(SEED, 1)
    file, silent = tmp_path / "heard.mp4", tmp_path / "silent.mp4"
    film.write(file)
    film.write(silent, with_sound=False)
    heard, deaf = tune_log(file, TuneOptions()), tune_log(silent, TuneOptions())
    assert json.loads(to_json(deaf.record))["sound"] is None
    assert sound_words(deaf.record) == ""
    sound = share(heard)
    assert sound.used, sound.reason
    assert sound.restitution == pytest.approx(restitution(deaf).value, abs=1e-9)
    assert sound.offset_s == pytest.approx(film.offset_s, abs=0.02)
    assert restitution(heard).value == pytest.approx(film.restitution, abs=0.02)


def test_a_record_keeps_what_the_sound_added_and_none_where_cameras_are_several(tmp_path: Path):
    episode = track_with_sound(SEED, 0).episode()
    file = tmp_path / "heard.json"
    file.write_text(to_json(tune_episode(episode, TuneOptions()).record))
    fields = json.loads(file.read_text())
    assert set(fields["sound"]) == {"impacts", "heard", "offset_s", "used", "reason", "without"}
    file.write_text(json.dumps(fields | {"sound": fields["sound"] | {"used": False}}))
    with pytest.raises(LogError, match="its sound"):
        read_record(file)
    assert sound_beside(episode, 0) is not None
    camera = replace(episode.channels[0], pictures=True, sounds=False)
    cameras = (replace(camera, topic="/left"), replace(camera, topic="/right"))
    assert sound_beside(replace(episode, channels=(*episode.channels, *cameras)), 0) is None


@pytest.mark.parametrize(
    ("tracks", "answered"), [(8, 6), pytest.param(20, 15, marks=pytest.mark.slow)]
)
def test_intervals_of_uneven_balls_hold_the_law_with_sound(tracks: int, answered: int):
    """About 9 of 10 in the long run; without sound 3 of 4, as a fit to positions is too sure."""
    seen: list[bool] = []
    both: list[bool] = []
    for number in range(tracks):
        track = track_with_sound(79, number, uneven=0.003)
        answers = [answer_to(one)[0] for one in (without_sound(track.episode()), track.episode())]
        if all(map(is_answered, answers)):
            for held, one in zip((seen, both), answers, strict=True):
                held.append(one["low"] <= track.restitution <= one["high"])
    assert len(both) >= answered
    assert sum(both) >= 0.8 * len(both)
    assert sum(both) >= sum(seen)


# ---- Times of impacts alone


def at_second() -> float:
    """Restitution at the second impact."""
    ball = Bounce(RESTITUTION, SLOPE, DRAG_1_M * HEIGHT_M)
    _, speeds = ball.flights(10.0)
    second = ball.flight(float(speeds[0]))[1]
    return RESTITUTION * (second / ball.impact_speed) ** -SLOPE


def tuned(
    times_s: NDArray[Any], selection: TuneOptions | None = None, *, frames: bool = False
) -> Tuning:
    options = selection or TuneOptions()
    return tune_episode(episode_of(times_s, frames=frames), options, Path("stopwatch.csv"))


def test_a_clean_sequence_tells_the_second_impact_and_with_a_height_the_first():
    tuning = tuned(impacts(9))
    assert tuning.verdict == "ok", tuning.reason
    low, high = ends(tuning)
    assert low < at_second() < high
    assert value(tuning) == pytest.approx(at_second(), abs=0.01)
    assert (tuning.method, tuning.rollouts) == ("fit", 2)
    rebounds = record_of(tuning).rebounds
    assert len(rebounds) == 7  # all but the first and the last
    assert rebounds[0].impact_speed_m_s == pytest.approx(3.7, abs=0.1)
    tuning = tuned(impacts(9), TuneOptions(height_m=HEIGHT_M))
    low, high = ends(tuning)
    assert low < RESTITUTION < high < low + 0.03
    first = record_of(tuning).rebounds[0]
    assert first.impact_s == pytest.approx(0.0, abs=0.002)
    assert first.impact_speed_m_s == pytest.approx(4.75, abs=0.05)


@pytest.mark.parametrize("restitution", [0.6, 0.9])
def test_a_ball_of_one_restitution_is_not_doubted_for_its_slope(restitution: float):
    """The interval of its slope holds 0, at one end: what air may hide lies at the other."""
    starts, _ = Bounce(restitution, 0.0, 0.0).flights(10.0)
    tuning = tuned(0.8 + 0.45 * starts[:7])
    assert tuning.verdict == "ok", tuning.reason


def test_a_known_ball_makes_it_surer():
    squash = TuneOptions(ball=ball_named("squash"))
    assert np.ptp(ends(tuned(impacts(9), squash))) < np.ptp(ends(tuned(impacts(9))))


@pytest.mark.parametrize(
    ("missed", "noises_s"),
    [
        *(([one], []) for one in (2, 3, 5)),
        *(([], [one]) for one in (1.1, 1.9, 2.6)),
        ([3, 6], [1.3, 2.05]),
    ],
)
def test_missed_impacts_and_noises_are_found(missed: list[int], noises_s: list[float]):
    count = 10 if len(missed) == 2 else 9
    times_s = np.sort(np.append(np.delete(impacts(count), missed), noises_s))
    ball = known(heard_ball(times_s, DropSetup()))
    assert (ball.reading.missed, ball.reading.false) == (len(missed), len(noises_s))
    assert ball.numbers.tolist() == [one for one in range(count) if one not in missed]
    assert not set(noises_s) & set(ball.times_s.tolist())
    assert ball.values[0] == pytest.approx(at_second(), abs=0.015)
    if len(missed) == 1:
        assert tuned(times_s).verdict == "ok"


def test_an_unknown_clock_tells_the_restitution_and_no_speed():
    frames = np.round(impacts(9) * 1000) * FRAME_NS * 1e-9  # of a camera with 1000 a second
    tuning = tuned(frames, TuneOptions(height_m=HEIGHT_M), frames=True)
    assert value(tuning) == pytest.approx(at_second(), abs=0.012)
    record = record_of(tuning)
    assert {bounce.impact_speed_m_s for bounce in record.rebounds} == {None}
    assert any("--height not used" in warning for warning in record.warnings)


RNG = np.random.default_rng(5)
# Intervals between noises, and the verdict and the reason where they are certain.
NO_TIMES = {
    "clapping": (0.4 + RNG.normal(0, 0.002, 12), "", ""),
    "a hand's clapping": (0.4 + RNG.normal(0, 0.02, 12), "", ""),
    "increasing": (0.2 * 1.12 ** np.arange(12), "", ""),
    "linear": (0.6 - 0.3 * np.arange(12) / 12, "", ""),
    "linear, faster": (np.linspace(0.6, 0.2, 9), "rejected", "beats that shorten by one"),
    "three": (np.array([0.0, 0.5, 0.4]), "", ""),
    "two": (np.array([0.0, 0.5]), "rejected", "2 impact times, too few for two whole flights"),
    "a rattle at the end": (np.array([0.68, 0.43, 1.44, 0.0042, 0.0059]), "", ""),
    "a rattle at the start": (np.array([0.28, 0.001, 0.001, 0.36, 0.075, 0.115]), "", ""),
    "doubles": (np.array([0.0142, 0.0151, 0.0019, 0.1514, 0.0022, 0.0097]), "", ""),
    "a metronome": (np.full(40, 0.5), "", ""),
    "too lively": (0.5 * 0.97 ** np.arange(12), "suspect", "flights shorten as a ball's"),
    **{
        f"random {seed}": (np.random.default_rng([seed, 77]).exponential(0.4, 5 + seed), "", "")
        for seed in range(5)
    },
}


@pytest.mark.parametrize("height_m", [None, 1.0])
@pytest.mark.parametrize("name", NO_TIMES)
def test_what_is_no_ball_is_never_ok(name: str, height_m: float | None):
    between_s, verdict, says = NO_TIMES[name]
    tuning = tuned(np.cumsum(between_s), TuneOptions(height_m=height_m))
    assert tuning.verdict in ([verdict] if verdict else ["suspect", "rejected"])
    assert says in (tuning.reason or "")


@pytest.mark.parametrize(
    ("times_s", "verdict"),
    [
        (np.cumsum([0.0, 0.2040, 0.1715, 0.4236, 0.1193]), "rejected"),
        (np.sort(np.append(impacts(9), 1.9)), "ok"),
    ],
)
def test_a_phone_s_sheet_with_a_false_time(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], times_s: NDArray[Any], verdict: str
):
    pytest.importorskip("python_calamine")
    phyphox_xlsx(tmp_path / "phone.xlsx", (times_s - times_s[0]).tolist())
    code = main([str(tmp_path / "phone.xlsx"), "--jobs", "1", "--quiet"])
    assert code == int(verdict == "rejected")
    head, line, *_ = capsys.readouterr().out.splitlines()
    assert verdict in line
    assert re.search(r" \d impacts ", line)  # and no height
    assert "drop" in head
    assert "fall" not in head
    assert " m " not in line
    assert (tmp_path / "phone.rrd").stat().st_size > 10_000
    chunks = list(RrdReader(tmp_path / "phone.rrd").stream())
    assert any(chunk.timeline_names for chunk in chunks)


def test_a_hundred_thousand_times_are_bounded():
    times_s = np.append(impacts(10), 20 + 0.01 * np.arange(100_000))
    tuning = tuned(times_s)
    assert tuning.seconds["total"] < 20
    assert any("the first 60 of 100010 times" in warning for warning in tuning.warnings)


def test_the_signal_with_the_most_times_is_used_unless_one_is_named():
    times_s = impacts(9)
    few, many = episode_of(times_s[:4], "Simple/impacts"), episode_of(times_s)
    episode, way = Episode(EpisodeInfo(), {**few.signals, **many.signals}), DropFromTimes()
    assert way.claim(episode, None) == Claim.CERTAIN
    assert way.detect(episode, TuneOptions(), "default").topic == "All/impacts"
    named = way.detect(episode, TuneOptions(topic="Simple/impacts"), "default")
    assert len(named.times_s) == 4
    with pytest.raises(NotFoundError, match="there are: All/impacts, Simple/impacts"):
        way.detect(episode, TuneOptions(topic="Sound"), "default")
    stamps_ns = np.arange(10) * 10_000_000
    positions = Signal("/ball", stamps_ns, np.zeros((10, 3)), ("x", "y", "z"), "m")
    seen = Episode(EpisodeInfo(), {**many.signals, "/ball": positions})
    assert way.claim(seen, None) == Claim.POSSIBLE  # positions come first


@pytest.mark.slow
def test_verdicts_errors_and_intervals_of_many():
    found = {row["label"]: row for row in counted_verdicts((5, 12, 48))}
    assert sum(found[name]["ok"] for name in NO_BALLS) <= 2
    many = found["balls, 6 or more"]
    assert many["ok"] > 0.35 * many["sets"]
    every = figures_of("all", scored_sets((5, 150, False)))
    assert every["told"] == every["sets"]
    assert every["mae"] < 1.4 * every["bound"]
    assert every["covered"] > 0.92
