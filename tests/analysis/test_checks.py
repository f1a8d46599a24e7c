"""The fault that fails each check, of every experiment; good logs fail none."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import tunenet_logs as tn
from tests.analysis.answers import known, trace_of
from tests.analysis.drop.made import (
    HEIGHT_M,
    episode_of,
    filmed,
    impacts,
    pixels,
    seen,
    track_of,
    with_a_lost_picture,
)
from tests.analysis.payload.arm_logs import ARM, CLEAN, changed, circle_log, driver, with_values
from tests.analysis.sysid.test_own_simulator import Spring, spring_log
from tests.conftest import real
from tests.strangers import bounce_heights
from tunenet_logs.analysis.checks import Check
from tunenet_logs.analysis.drop import checks as drop
from tunenet_logs.analysis.drop.audio import FusedEstimate
from tunenet_logs.analysis.drop.bounce_model import AudioImpacts
from tunenet_logs.analysis.drop.bounce_posterior import drop_posterior
from tunenet_logs.analysis.drop.detection import FilmDetection
from tunenet_logs.analysis.drop.film import FilmedDrop, find_filmed_drop
from tunenet_logs.analysis.drop.free_flight import Drop, find_drops
from tunenet_logs.analysis.estimators.base import Observation
from tunenet_logs.analysis.evaluation.worlds.audio import NO_BOUNCES, draw_negative, with_sound
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.payload import checks as payload
from tunenet_logs.analysis.payload.arm_log import ArmLog, read_arm_log
from tunenet_logs.analysis.payload.torque_fit import PayloadFit, fit_payload
from tunenet_logs.analysis.payload.torque_model import arm_motion
from tunenet_logs.analysis.record import SimulationFit
from tunenet_logs.analysis.sysid import checks as sysid
from tunenet_logs.analysis.sysid.columns import Column, ComparedColumns, noise_of
from tunenet_logs.analysis.sysid.fit import Agreement, HeldOut, SimulatorFit
from tunenet_logs.analysis.tracking.track import Track
from tunenet_logs.analysis.tuning import tune_episode
from tunenet_logs.episode import Array, Episode, EpisodeInfo
from tunenet_logs.reader import read_episode
from tunenet_logs.recorders.simulators.arm.description import Payload
from tunenet_logs.recorders.simulators.arm.path import JointPath, circle
from tunenet_logs.recorders.simulators.arm.payload import driver_episode
from tunenet_logs.recorders.simulators.ball import Bounce
from tunenet_logs.recorders.simulators.known import Ball
from tunenet_logs.recorders.simulators.model.rollout import STOPPED

Faults = Mapping[str, Callable[[], Iterable[Check]]]


def failed(checks: Iterable[Check]) -> dict[str, Check]:
    return {one.name: one for one in checks if not one.passed}


def once(check: Check) -> list[Check]:
    return [check]


# ---- A ball's positions

TIMES_S = np.arange(600) / 120


@cache
def dropped() -> Drop:
    return find_drops(TIMES_S, bounce_heights(0.7, 1.0, TIMES_S - 0.5))[0]


def of_recording(sideways_m: float = 0.0, **changes: Any) -> list[Check]:
    sideways = np.linspace(0, sideways_m, 2)[:, None]
    return drop.recording_checks(replace(dropped(), **changes), sideways)


def without_samples(first: int, last: int | None = None) -> list[Check]:
    kept = np.delete(np.arange(len(dropped().seconds)), slice(first, last))
    one = dropped()
    return of_recording(seconds=one.seconds[kept], heights_m=one.heights_m[kept])


def of_motion(**changes: Any) -> list[Check]:
    whole = {"rms_percent": 0.1, "worst_percent": 0.2, "noise_percent": 0.1}
    fit = SimulationFit(
        **whole, held_out_percent=0.1, samples=100, left_out=0, noise=1e-3, unit="m"
    )
    return drop.motion_checks(replace(fit, **changes))


def of_heights(heights: Array) -> tuple[Check, ...]:
    return tune_episode(seen(heights), TuneOptions()).checks


def beside_a_parabola() -> list[Check]:
    tuning = tune_episode(seen(bounce_heights(0.7, 1.0, TIMES_S - 0.5)), TuneOptions())
    units = tuning.detection.units
    return drop.fall_checks(replace(dropped(), flight_restitution=np.nan), 0.7, units)


def of_the_papers(off_m: float) -> list[Check]:
    curve = np.zeros((5, 1))
    one, other = (
        Observation(curve + off, np.arange(5.0), "height", ("z",)) for off in (0.0, off_m)
    )
    return once(drop.paper_fit_check(one, other, dropped()))


def of_sound_apart() -> list[Check]:
    seen_alone = drop_posterior(dropped(), None)
    assert seen_alone is not None
    both = replace(seen_alone, values=seen_alone.values + 0.1)
    touches = AudioImpacts(np.arange(3), np.arange(3.0), np.ones(3))
    return drop.sound_checks(FusedEstimate(both, seen_alone, touches=touches))


DROP: Faults = {
    "first flight seen": lambda: without_samples(int(np.searchsorted(dropped().seconds, 1.2))),
    "stays on the table": lambda: of_recording(
        heights_m=np.where(dropped().seconds > 3, -0.05, dropped().heights_m)
    ),
    "falls straight": lambda: of_recording(15.0),
    "no samples missing": lambda: without_samples(150, 156),
    "sure enough": lambda: once(drop.sure_check(0.5, 0.55)),
    "simulation fits": lambda: of_motion(rms_percent=1.0),
    "samples are the ball's": lambda: of_motion(left_out=8),
    "hold-out prediction": lambda: of_motion(held_out_percent=1.5),
    "sound agrees": of_sound_apart,
}
POSITIONS: Faults = {
    "gravity": lambda: of_heights(0.9 * bounce_heights(0.7, 1.0, TIMES_S - 0.5)),
    "rests where it hit": lambda: of_heights(
        np.where(TIMES_S > 1.95, 0.02, bounce_heights(0.5, 1.0, TIMES_S - 0.5))
    ),
    "flies a parabola": beside_a_parabola,
    "rebound stands out": lambda: once(drop.rebound_check(replace(dropped(), noise_m=0.01), 0.2)),
}
PAPER: Faults = {
    "as in training": lambda: once(drop.paper_height_check(1.0)),
    "simulation fits": lambda: of_the_papers(0.05),
}

# ---- A film


@cache
def found() -> FilmedDrop:
    return find_filmed_drop(filmed(0.7), 0)


def of_track(track: Track) -> list[Check]:
    return drop.film_checks(find_filmed_drop(track, 0))


def with_places(change: Callable[[Array], None]) -> list[Check]:
    track = filmed(0.7, rate_hz=120)
    places = track.places_px.copy()
    change(places)
    return of_track(replace(track, places_px=places))


def lost(places: Array) -> None:
    places[70::2] = np.nan


def repeated(places: Array) -> None:
    places[1::2] = places[::2][: len(places[1::2])]


def some_lost(*, is_stamped: bool = False) -> list[Check]:
    """A film of 30 Hz of which pictures are lost here and there, and no stamp tells of it."""
    track = filmed(0.8, gap_m=1.5, rate_hz=30, seconds=3.0)
    kept = np.delete(np.arange(len(track.stamps_ns)), [29, 40, 47, 61])
    told = track.stamps_ns[kept if is_stamped else slice(len(kept))]
    parts = {name: getattr(track, name)[kept] for name in ("places_px", "radius_px", "confidence")}
    return of_track(replace(track, stamps_ns=told, **parts))


def of_another_law() -> list[Check]:
    times = (np.arange(150) / 60.0 - 0.3) / np.sqrt(2 / 9.81) - 1
    heights = Bounce(0.7, each=(0.7, 0.45, 0.85, 0.5)).heights(times)
    return of_track(track_of(pixels(heights, 120.0, 0.2), 60.0))


def of_size(radius_px: Callable[[Array], Array]) -> list[Check]:
    """The ball's size in the picture, by the share of the film."""
    track = filmed(0.7)
    share = np.linspace(0, 1, len(track.radius_px))
    rows = (200 - track.places_px[:, 1]) / 120
    return of_track(replace(track, radius_px=radius_px(np.column_stack([share, rows]))))


def of_span(span_px: float, noise_px: float = 0.1) -> list[Check]:
    heights = bounce_heights(0.7, 1.0, np.arange(150) / 60 - 0.3)
    return of_track(track_of(pixels(heights, span_px, 0.0), 60.0, noise_px))


def of_scale(diameter_m: float | None = None, height_m: float | None = None) -> list[Check]:
    """Of a fall of 1 m, before a ball of 83 mm."""
    detection = FilmDetection(True, "/camera", 0, filmed(0.7), Ball(diameter_m), height_m)
    return drop.scale_checks(detection)


def kicked() -> Array:
    one = found()
    return np.maximum(one.projection.fall_times(one.drop.seconds), 0.0)


FILM: Faults = {
    "large enough": lambda: of_span(30.0),
    "first impact": lambda: drop.film_checks(replace(found(), left_out=2)),
    "stays in view": lambda: with_places(lost),
    "pictures differ": lambda: with_places(repeated),
    "no pictures missing": some_lost,
    "bounces along parabolas": lambda: of_span(120.0, 3.5),
    "bounces alike": of_another_law,
    "bounces upright": lambda: drop.film_checks(replace(found(), sideways=kicked())),
    "even clock": lambda: drop.film_checks(with_a_lost_picture(0.4)[0]),
    "seen from a distance": lambda: of_track(filmed(0.7, perspective=1.9)),
    "keeps its distance": lambda: of_size(lambda at: 5 * np.exp(0.4 * at[:, 0])),
    "size fits perspective": lambda: of_size(lambda at: 5 * np.exp(-0.5 * at[:, 1])),
    "frame rate": lambda: of_scale(height_m=4.0),
    "rebound stands out": lambda: once(drop.hop_check(found(), 0.08)),
}

# ---- Times of impacts


def of_times(times_s: Array, **options: Any) -> tuple[Check, ...]:
    return tune_episode(episode_of(times_s), TuneOptions(**options)).checks


def of_sound(kind: str) -> tuple[Check, ...]:
    made = draw_negative(-7, list(NO_BOUNCES).index(kind))
    deaf = Episode(EpisodeInfo(), {})
    return tune_episode(with_sound(deaf, made), TuneOptions()).checks


def livelier_when_faster() -> Array:
    return 0.8 + 0.45 * Bounce(0.7, -0.1, 0.0).flights(10.0)[0][:9]


TIMES: Faults = {
    "enough impacts": lambda: of_times(impacts(4)),
    "times are the ball's": lambda: of_times(
        np.cumsum(np.random.default_rng([2, 77]).exponential(0.4, 7))
    ),
    "times are sharp": lambda: of_times(impacts(9, 2, 0.01)),
    "one ball alone": lambda: of_sound("two balls"),
    "softens as a ball does": lambda: of_sound("claps"),
    "a ball rather than a rhythm": lambda: of_times(
        np.cumsum(np.linspace(0.6, 0.2, 9), dtype=np.float64)
    ),
    "flights shorten as a ball's": lambda: of_times(
        np.cumsum(0.5 * 0.97 ** np.arange(12), dtype=np.float64)
    ),
    "slows as balls do": lambda: of_times(livelier_when_faster()),
    "height fits the times": lambda: of_times(impacts(9), height_m=HEIGHT_M / 2),
}
# ---- An arm
FIELDS = ("position", "velocity", "effort")


@cache
def held(seed: int | None = None) -> Episode:
    """A clean log, or a driver's."""
    return circle_log(Payload(0.5)) if seed is None else circle_log(Payload(0.5), driver(seed))


@cache
def fitted() -> tuple[ArmLog, PayloadFit]:
    log = read_arm_log(held(), ARM)
    return log, fit_payload(ARM, arm_motion(log))


def of_arm(episode: Episode, tare: Episode | None = None, **part: Any) -> list[Check]:
    log = read_arm_log(episode, ARM, **part)
    motion = arm_motion(log)
    empty = [arm_motion(read_arm_log(tare, ARM))] if tare else []
    checks = payload.arm_checks(log, motion, ARM)
    return checks + payload.payload_checks(
        fit_payload(ARM, motion, empty), ARM, log, is_stated=False
    )


def of_fit(**changes: Any) -> list[Check]:
    log, fit = fitted()
    return payload.payload_checks(replace(fit, **changes), ARM, log, is_stated=False)


def of_offset(sds: float) -> list[Check]:
    terms = list(fitted()[1].nuisances)
    at = next(index for index, one in enumerate(terms) if one.group == "offset")
    terms[at] = replace(terms[at], value=sds * terms[at].prior_sd)
    return of_fit(nuisances=tuple(terms))


def with_efforts(change: Callable[[Array], Array], seed: int | None = None) -> list[Check]:
    return of_arm(changed(held(seed), effort=with_values(change)))


def every_twelfth(field: str) -> list[Check]:
    log = changed(
        held(),
        **{field: lambda one: replace(one, stamps_ns=one.stamps_ns[::12], values=one.values[::12])},
    )
    return of_arm(log)


def dead(values: Array) -> Array:
    values[:, 3] = 7.0
    return values


def stuck(values: Array) -> Array:
    return values[np.arange(len(values)) // 5 * 5]


def shaken(count: int, joints: int) -> Array:
    return np.random.default_rng(1).normal(0, 3, (count, joints))


def still() -> list[Check]:
    path = circle(500.0, 5.2)
    place = path.position_rad[:1] + np.zeros_like(path.position_rad)
    resting = JointPath(path.seconds, place, 0 * place, 0 * place)
    noisy = replace(CLEAN, position_noise_rad=2e-4, torque_noise_nm=0.2)
    return of_arm(driver_episode(ARM, resting, Payload(0.5), noisy))


def hurried() -> list[Check]:
    """Stamps that are six times too close."""
    log = read_arm_log(
        changed(
            held(), **dict.fromkeys(FIELDS, lambda one: replace(one, stamps_ns=one.stamps_ns // 6))
        ),
        ARM,
    )
    return payload.arm_checks(log, arm_motion(log), ARM)


def with_a_gap(signal: Any) -> Any:
    keep = np.abs(signal.seconds - signal.seconds.mean()) > 0.4
    return replace(signal, stamps_ns=signal.stamps_ns[keep], values=signal.values[keep])


def made_up(name: str, topic: str | None = None) -> list[Check]:
    """Up to 40 times what the joints can do."""
    return of_arm(read_episode(real(f"ros1/jaco_names_recorded_by_{name}.bag")), topic=topic)


def wide() -> list[Check]:
    fit = fitted()[1]
    return once(
        payload.sure_check(replace(fit, held=replace(fit.held, interval95=(0.0, 1.0))), ARM)
    )


PAYLOAD: Faults = {
    "long enough": lambda: of_arm(held(6), start_s=1.0, end_s=3.5),
    "the arm moves": still,
    "every torque changes": lambda: with_efforts(dead, 6),
    "rate": lambda: every_twelfth("effort"),
    "samples are new": lambda: of_arm(changed(held(), **dict.fromkeys(FIELDS, with_values(stuck)))),
    "no gaps": lambda: of_arm(changed(held(), **dict.fromkeys(FIELDS, with_a_gap))),
    "speeds are an arm's": hurried,
    "velocities agree": lambda: of_arm(changed(held(), velocity=with_values(np.negative))),
    "torques fit the arm": lambda: with_efforts(lambda one: shaken(*one.shape)),
    "sign and gravity": lambda: of_fit(convention_odds=3.0),
    "lag": lambda: of_fit(lag_s=0.15),
    "friction and sensors are usual": lambda: of_offset(-9.0),
    "within what the arm lifts": lambda: made_up("rosbag", "/j2s7s300_driver/out/joint_torques"),
    "sure enough": wide,
}
# ---- A simulator
SECONDS = np.arange(0, 4, 0.01)
RNG = np.random.default_rng(3)
# A servo's efforts: a new command with every second sample.
STAIRS = np.repeat(RNG.normal(0, 2.0, len(SECONDS) // 2), 2)
SENSOR = RNG.normal(0, 0.05, len(SECONDS))


def compared(values: Array) -> ComparedColumns:
    spread = float(np.std(values))
    column = Column("/effort", "elbow", "N·m", SECONDS, values, noise_of(values), spread)
    return ComparedColumns(0, (column,))


@cache
def matched() -> SimulatorFit:
    """The fit of a user's own object to its log."""
    return known(trace_of(tn.tune(spring_log(), simulator=Spring())).fit).detail


def of_simulator(**changes: Any) -> tuple[Check, ...]:
    return sysid.fit_checks(replace(matched(), **changes))


def held_out() -> HeldOut:
    told = known(matched().held_out)
    return replace(told, rms=10 * told.rms + 1)


def on_the_end() -> tuple[Check, ...]:
    values = matched().solution.values.copy()
    values[0] = matched().parameters[0].training_range[1]
    return of_simulator(solution=replace(matched().solution, values=values))


# Of two logs, by which one parameter is 2 and 3, ten standard deviations apart.
APART = Agreement(
    ("a", "b"), np.array([[2.0], [3.0]]), np.array([[3.0], [2.0]]), 10 * np.ones((2, 1))
)

SYSID: Faults = {
    "it moves": lambda: sysid.recording_checks(compared(SENSOR)),
    "simulation is whole": lambda: [
        check
        for check in [sysid.whole_check(Episode(EpisodeInfo(notes={STOPPED: "full"}), {}))]
        if check is not None
    ],
    "simulation matches": lambda: once(
        sysid.match_check(compared(STAIRS + SENSOR), SENSOR + np.sin(3 * SECONDS))
    ),
    "predicts what it was not fitted to": lambda: of_simulator(held_out=held_out()),
    "the logs agree": lambda: once(sysid.agreement_check(matched(), APART)),
    "inside its range": on_the_end,
    "every parameter is identifiable": lambda: of_simulator(half95=1e3 + matched().half95),
    "the step is short enough": lambda: of_simulator(step_shift=1e2 * matched().half95),
}
TABLES = {
    "drop": (drop.DROP, DROP),
    "positions": (drop.POSITIONS, POSITIONS),
    "paper": (drop.PAPER, PAPER),
    "film": (drop.FILM, FILM),
    "times": (drop.TIMES, TIMES),
    "payload": (payload.PAYLOAD, PAYLOAD),
    "simulator": (sysid.SYSID, SYSID),
}
# Failed by whole commands in tests of their own: a video with a hole, a hand that carries, the
# rollouts of another ball and of the paper's arm.
ELSEWHERE = {
    "film": {"pictures as they were recorded", "flies freely"},
    "times": {"simulation fits"},
    "payload": {"simulation fits"},
}


@pytest.mark.parametrize(
    ("room", "name"), [(room, name) for room, (_, faults) in TABLES.items() for name in faults]
)
def test_a_fault_fails_its_check(room: str, name: str):
    checks = failed(TABLES[room][1][name]())
    assert name in checks, checks.keys()
    assert checks[name].advice


@pytest.mark.parametrize("room", TABLES)
def test_every_check_has_its_fault(room: str):
    specs, faults = TABLES[room]
    assert set(specs) == set(faults) | ELSEWHERE.get(room, set())


GOOD: Faults = {
    "positions": lambda: of_heights(bounce_heights(0.7, 1.0, TIMES_S - 0.5)),
    "motion": of_motion,
    "film": lambda: [*of_track(filmed(0.7)), *drop.film_checks(found())],
    "film with a lost picture that its stamps tell": lambda: [
        one for one in some_lost(is_stamped=True) if one.name == "no pictures missing"
    ],
    "film of a known height": lambda: of_scale(height_m=1.0),
    "film of a known ball": lambda: of_scale(1.0 * 10 / 120),
    "bounce of .2": lambda: once(drop.hop_check(found(), 0.2)),
    "times": lambda: of_times(impacts(9)),
    "arm": lambda: of_arm(held()),
    "driver with a tare": lambda: of_arm(held(71), circle_log(None, driver(71).another_run())),
    "payload off centre": lambda: of_arm(
        circle_log(Payload(1.5, (0.0, 0.06, 0.06)), replace(driver(8), torque_noise_nm=0.05))
    ),
    "efforts that jump": lambda: once(sysid.match_check(compared(STAIRS + SENSOR), SENSOR)),
    "simulator": of_simulator,
}


@pytest.mark.parametrize("name", GOOD)
def test_a_good_log_fails_none(name: str):
    assert failed(GOOD[name]()) == {}


# ---- What a check says, and how bad it is


@pytest.mark.parametrize("field", ["position", "effort"])
def test_the_slower_of_positions_and_torques_counts(field: str):
    rate = failed(every_twelfth(field))["rate"]
    assert "5 Hz" in rate.detail
    assert "60 Hz" in rate.detail


FIT, LIFTS = "torques fit the arm", "within what the arm lifts"
NO_ARM = {
    "noise": (FIT, lambda: with_efforts(lambda one: shaken(*one.shape))),
    "other joints'": (FIT, lambda: with_efforts(lambda one: one[:, [3, 0, 6, 5, 1, 2, 4]], 5)),
    "constant": (
        FIT,
        lambda: with_efforts(
            lambda one: np.array([1.5, -2.25, 3.0, 4.0, 5.0, 6.0, 1.0]) + 0.003 * shaken(*one.shape)
        ),
    ),
    "made up": (LIFTS, lambda: made_up("rosbag", "/j2s7s300_driver/out/joint_torques")),
    "made up, packed": (LIFTS, lambda: made_up("rosbag_lz4", "/j2s7s300_driver/out/joint_state")),
}


@pytest.mark.parametrize("name", NO_ARM)
def test_torques_of_no_arm_are_fatal(name: str):
    check, make = NO_ARM[name]
    assert failed(make())[check].fatal


@pytest.mark.parametrize("sds", [-9.0, 9.0])
def test_a_sensor_that_is_far_off_is_named_whichever_way(sds: float):
    check = failed(of_offset(sds))["friction and sensors are usual"]
    assert next(one.name for one in fitted()[1].nuisances if one.group == "offset") in check.detail


@pytest.mark.parametrize("restitution", [0.08, 0.2])
def test_a_filmed_bounce_is_as_high_as_the_square_of_its_restitution(restitution: float):
    """Of a fall of 120 px, 0.8 px, less than any noise leaves, and 4.8 px."""
    check = drop.hop_check(found(), restitution)
    assert float(check.detail.split()[0]) == pytest.approx(120 * restitution**2, rel=0.03, abs=0.05)


@pytest.mark.parametrize("unknown", [None, 0.0, -1.0, np.nan, np.inf])
def test_a_height_that_cannot_be_is_not_known(unknown: float | None):
    assert of_scale(height_m=unknown) == []
    assert of_scale(0.08, unknown) == of_scale(0.08) != []


@pytest.mark.parametrize("noise", [0.2, 1.0, 5.0])
def test_white_noise_may_be_left_of_a_simulation_and_no_more(noise: float):
    white = noise * RNG.normal(size=len(SECONDS))
    target = compared(np.sin(3 * SECONDS) + white)
    assert sysid.match_check(target, white).passed
    more = 2 * np.sin(3 * SECONDS) * max(noise, 0.3)
    assert not sysid.match_check(target, white + more).passed
