"""A ball by its sound alone: from a file to a verdict."""

from __future__ import annotations

import wave
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from tunenet_logs.analysis.evaluation.worlds.audio import (
    NO_BOUNCES,
    SoundClip,
    draw_negative,
    draw_sound,
)
from tunenet_logs.analysis.experiment import record_of
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.record import Record
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.reader import read_episode

QUIET = (7, 8, 9)  # clips of a seed that nothing else uses


def write_wav(path: Path, samples: NDArray[np.float32], rate_hz: float) -> Path:
    """16 bit, by Python's own library."""
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(int(rate_hz))
        file.writeframes((np.clip(samples, -1, 1) * 32767).astype("<i2").tobytes())
    return path


def quiet_clip(number: int) -> SoundClip:
    return draw_sound(-7, number, background="quiet", snr_db=35.0)


def record(path: Path, selection: TuneOptions | None = None) -> Record:
    options = TuneOptions() if selection is None else selection
    return record_of(tune_episode(read_episode(path), options))


def restitution(found: Record) -> tuple[float, float, float]:
    """Value and ends of its interval; NaN where there are none."""
    estimate = found.estimate("restitution")
    assert estimate is not None, found.reason
    ends = (np.nan, np.nan) if estimate.interval95 is None else estimate.interval95
    low, high = np.ravel(ends).tolist()
    return float(np.ravel(estimate.value)[0]), low, high


@pytest.mark.parametrize("number", QUIET)
def test_a_bounce_is_tuned_by_its_sound(tmp_path: Path, number: int):
    clip = quiet_clip(number)
    found = record(write_wav(tmp_path / "bounce.wav", clip.samples, clip.rate_hz))
    value, low, high = restitution(found)
    assert found.verdict != "rejected", found.reason
    assert abs(value - clip.restitutions[1]) < 0.01
    assert low - 0.005 < clip.restitutions[1] < high + 0.005


def test_the_height_tells_the_first_impact(tmp_path: Path):
    clip = quiet_clip(QUIET[0])
    path = write_wav(tmp_path / "bounce.wav", clip.samples, clip.rate_hz)
    value, _, _ = restitution(record(path, TuneOptions(height_m=clip.scene.history.order.height_m)))
    assert abs(value - clip.restitutions[0]) < 0.02


def test_silence_before_and_after_changes_nothing_but_the_times(tmp_path: Path):
    clip = quiet_clip(QUIET[1])
    noise = 1e-4 * np.random.default_rng(0).standard_normal(3 * int(clip.rate_hz))
    around = np.concatenate([noise, clip.samples, noise]).astype(np.float32)
    near = restitution(record(write_wav(tmp_path / "near.wav", clip.samples, clip.rate_hz)))
    far = restitution(record(write_wav(tmp_path / "far.wav", around, clip.rate_hz)))
    assert abs(near[0] - far[0]) < 0.003


@pytest.mark.parametrize("kind", sorted(set(NO_BOUNCES) - {"two balls"}))
def test_no_bounce_is_ok(tmp_path: Path, kind: str):
    number = list(NO_BOUNCES).index(kind)
    made = draw_negative(-7, number)
    found = record(write_wav(tmp_path / "no.wav", made.samples, made.rate_hz))
    assert found.verdict != "ok"
    assert found.reason


@pytest.mark.parametrize("kind", ["music", "metronome", "rain"])
def test_where_no_ball_is_heard_that_is_the_first_reason(tmp_path: Path, kind: str):
    made = draw_negative(-7, list(NO_BOUNCES).index(kind))
    reason = record(write_wav(tmp_path / "no.wav", made.samples, made.rate_hz)).reason or ""
    assert reason.startswith("times are the ball's: no bouncing ball is heard: ")
    assert "let it bounce longer" not in reason


def test_an_alarm_clock_is_rejected(tmp_path: Path):
    """Four beeps each second: noises at random times explain them better than a ball."""
    beeps_s = [0.5 + second + beep / 8 for second in range(6) for beep in range(4)]
    samples = 0.002 * np.random.default_rng(1).standard_normal(7 * 44_100)
    tone = 0.3 * np.sign(np.sin(2 * np.pi * 2048 * np.arange(2646) / 44_100))
    for at in np.round(np.array(beeps_s) * 44_100).astype(int):
        samples[at : at + len(tone)] += tone
    found = record(write_wav(tmp_path / "alarm.wav", samples.astype(np.float32), 44_100))
    assert found.verdict == "rejected"
    assert "no bouncing ball is heard" in (found.reason or "")


def test_a_short_bounce_is_told_to_bounce_longer(tmp_path: Path):
    clip = quiet_clip(QUIET[2])
    fourth_s, fifth_s = clip.scene.impacts_s[3:5]
    samples = clip.samples[: int(clip.rate_hz * (fourth_s + fifth_s) / 2)]
    found = record(write_wav(tmp_path / "short.wav", samples, clip.rate_hz))
    assert (found.reason or "").startswith("enough impacts: 4 impacts heard")
    assert (found.reason or "").endswith("let it bounce longer")


@pytest.mark.parametrize("number", QUIET[1:])
def test_an_earlier_throw_of_the_ball_is_told_and_can_be_left_out(tmp_path: Path, number: int):
    clip = quiet_clip(number)
    impacts_s = clip.scene.impacts_s
    end_s = float(impacts_s[3] + impacts_s[4]) / 2
    begin_s = float(impacts_s[0]) - 0.3
    ends = (int(at_s * clip.rate_hz) for at_s in (end_s, begin_s))
    twice = np.concatenate([clip.samples[: next(ends)], clip.samples[next(ends) :]])
    path = write_wav(tmp_path / "twice.wav", twice, clip.rate_hz)
    found = record(path)
    assert found.verdict == "suspect"
    told = (
        f"the 4 knocks from {impacts_s[0]:.2f} to {impacts_s[3]:.2f} s, just before its first at "
        f"{end_s + 0.3:.2f} s, are the same ball's"
    )
    assert told in (found.reason or "")
    assert (found.reason or "").endswith("choose one drop with --start and --end")
    chosen = record(path, TuneOptions(start_s=end_s + 0.1))
    assert chosen.verdict == "ok", chosen.reason


def test_a_second_ball_meanwhile_is_no_earlier_throw(tmp_path: Path):
    made = draw_negative(-7, list(NO_BOUNCES).index("two balls"))
    reason = record(write_wav(tmp_path / "two.wav", made.samples, made.rate_hz)).reason or ""
    assert "for a second ball at the same time" in reason


def test_silence_is_refused_with_what_to_do(tmp_path: Path):
    found = record(write_wav(tmp_path / "no.wav", np.zeros(48_000, dtype=np.float32), 48_000))
    assert found.verdict == "rejected"
    assert "bounce" in (found.reason or "")
