"""Clocks that were set, samples that overtook each other, pauses; the clock behind arrivals."""

from __future__ import annotations

import struct
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike, NDArray

from tests.conftest import ROOT, Command
from tests.message_logs import Schema, write_raw
from tests.reading import tuned
from tests.strangers import Stranger, write_poses, write_poses_folder, write_table
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.formats.columns.signals import (
    rows_of_runs,
)
from tunenet_logs.media import StoredTimes, clock_of
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.arrivals import (
    Clocks,
    UniformClock,
    assign_ticks,
    changing_rate,
    conversions,
    correct_late_stamps,
    likeliest_ticks,
    recover_uniform_clock,
)
from tunenet_logs.timing.stamps import (
    MAX_SPEED_CAMERA_HZ,
    filmed_part,
    measured_hz,
    order_samples,
    part_on_grid,
    sorted_stamps,
    sound_part,
    written_part,
)
from tunenet_logs.writing.writer import EpisodeWriter

SECOND = 10**9
EVEN = 1_700_000_000 * SECOND + np.arange(400) * 10_000_000
DROP = Stranger(0.7, hold_s=0.4, seconds=3.0, noise_m=0.0004)


def shifted(rows: slice | int, by_s: float) -> np.ndarray:
    stamps = EVEN.copy()
    stamps[rows] += round(by_s * SECOND)
    return stamps


def order(header: list[int], log: list[int] | range):
    return order_samples(np.array(header, np.int64), np.array(log, np.int64))


# The clock that is believed.
LATE = [*range(10, 300, 10), 205]


@pytest.mark.parametrize(
    ("header", "log", "stamps", "says"),
    [
        ([10, 20, 30], [1, 2, 3], [10, 20, 30], ""),
        ([0, 20, 30], [7, 8, 9], [0, 20, 30], ""),  # a clock that starts at zero is set
        ([0, 0, 0], [7, 8, 9], [7, 8, 9], None),  # and one that is not set
        (LATE, range(30), sorted(LATE), "1 samples out of order were sorted"),
        ([30, 20, 10], [1, 2, 3], [1, 2, 3], "backwards"),
        ([10, 20, 20, 30], [1, 2, 3, 4], [10, 20, 30], "1 samples"),
        ([], [], [], ""),
        ([5] * 40, range(40), list(range(40)), "hardly change"),
    ],
    ids=["header", "from zero", "not set", "late", "backwards", "twice", "none", "constant"],
)
def test_which_clock_is_believed(header: list[int], log, stamps: list[int], says: str | None):
    found = order(header, log)
    assert found.stamps_ns.tolist() == stamps
    assert says is None or bool(says) == bool(found.notes)
    assert (says or "") in " ".join(found.notes)
    if header == LATE:
        assert found.keep[20] == 29
    if says == "1 samples":
        assert list(found.keep) == [0, 1, 3]


@given(st.lists(st.integers(0, 1000), max_size=40))
def test_stamps_always_increase_and_belong_to_their_samples(header: list[int]):
    keep, stamps, _, _ = order(header, range(len(header)))
    assert np.all(np.diff(stamps) > 0)
    assert tuple(stamps) in {tuple(np.array(header, np.int64)[keep]), tuple(keep)}


# Jumps.
@pytest.mark.parametrize("at", [0, 200, 399])
@pytest.mark.parametrize("off_s", [3600, 86400, 8_640_000, 1_577_836_800, -3600, -86400])
def test_a_stamp_that_is_off_is_left_out_alone(at: int, off_s: float):
    _, stamps, _, _ = sorted_stamps(shifted(at, off_s))
    part = sound_part(stamps)
    assert len(part.keep) == 399
    assert np.ptp(stamps[part.keep]) < 5 * SECOND
    assert "1 of 400 samples: not used" in part.words[0]


@pytest.mark.parametrize("pause_s", [0.5, 60, 3600, 36_000])
def test_a_pause_is_no_jump(pause_s: float):
    stamps = shifted(slice(150, None), pause_s)
    for part in (sound_part(stamps), written_part(stamps), filmed_part(stamps)):
        assert (len(part.keep), list(part.words)) == (400, [])
    hits = np.array([0, 1, 1.8, 2.4, 2000, 2001, 2001.8, 2002.4, 9000, 9001, 9001.8]) * SECOND
    assert not sound_part(hits.astype(np.int64)).words


def test_of_a_clock_that_is_set_the_longer_part_is_used():
    stamps = EVEN.copy()
    stamps[:100] = np.arange(100) * 10_000_000  # until it hears of today
    part = sound_part(stamps)
    assert part.keep.tolist() == list(range(100, 400))
    words = "after sample 100 of 400: the longer part, after it, is used (300 samples)"
    assert words in part.words[0]
    stamps = EVEN.copy()
    stamps[0] = 0
    assert sound_part(stamps).words == ("1 of 400 samples without a stamp: not used",)
    ends = np.array([-(2**63), *EVEN.tolist(), 2**63 - 1])  # which fit are no overflow
    assert len(sound_part(ends).keep) == 400
    part = filmed_part(shifted(slice(250, None), -60))
    assert part.keep.tolist() == list(range(250))
    assert "is set back by" in part.words[0]
    assert filmed_part(shifted(0, 86400)).keep.tolist() == list(range(1, 400))


@pytest.mark.parametrize("by_s", [-0.5, -1e9, 86400])
def test_a_header_that_jumps_gives_way_to_the_logs_own_times(by_s: float):
    keep, stamps, notes, _ = order_samples(shifted(slice(200, None), by_s), EVEN + 5)
    assert len(keep) == 400
    assert np.array_equal(stamps, EVEN + 5)
    assert "so the log's own times are used" in notes[0]


def test_a_grid_is_bounded_whatever_the_pauses_are():
    steps = np.where(np.arange(20_000) % 2, 0.01, 5.0 + np.arange(20_000) * 1e-3)
    seconds = np.cumsum(steps)
    part = part_on_grid(seconds, 1000.0)
    assert np.ptp(seconds[part.keep]) <= 1000.0
    assert len(part.words) == 1
    assert len(part_on_grid(seconds[:100], 1000.0).keep) == 100


# Disorder.
def stamps_at(rate_hz: float, jitter: float, lost: float, seed: int) -> np.ndarray:
    """5 s of a clock, with a jitter in periods, and some of its samples lost [ns]."""
    rng = np.random.default_rng(seed)
    ticks = np.arange(int(5 * rate_hz)) + rng.normal(0, jitter, int(5 * rate_hz))
    ticks = np.sort(ticks)[rng.random(len(ticks)) >= lost]
    return 1_790_000_000 * SECOND + np.round(ticks / rate_hz * SECOND).astype(np.int64)


def mixed(count: int, window: int, how: str, seed: int = 0) -> np.ndarray:
    """Numbers of samples, none over `window` places from its own, in the order of a file."""
    rng = np.random.default_rng(seed)
    order = np.arange(count)
    if how == "delayed":
        return np.argsort(order + rng.uniform(0, window, count), kind="stable")
    for at in range(0, count, window):
        block = order[at : at + window]
        if how == "shuffled":
            order[at : at + window] = rng.permutation(block)
        elif how == "backwards":
            order[at : at + window] = block[::-1]
        else:  # two threads, each with its own buffer
            own = rng.random(len(block)) < 0.5
            order[at : at + window] = np.concatenate([block[own], block[~own]])
    return order


@pytest.mark.parametrize("how", ["shuffled", "delayed", "backwards", "two threads"])
@pytest.mark.parametrize(
    ("rate_hz", "jitter", "lost"), [(60, 0, 0), (240, 0.1, 0.05), (1000, 0.02, 0.01)]
)
def test_disorder_is_sorted_whole(how: str, rate_hz: float, jitter: float, lost: float):
    for window in (2, 5, 8, 20, 60):
        stamps = stamps_at(rate_hz, jitter, lost, window)
        written = stamps[mixed(len(stamps), window, how)]
        found = sorted_stamps(written)
        assert np.array_equal(found.stamps_ns, stamps)
        assert not found.left_out
        assert np.array_equal(order_samples(written, written).stamps_ns, stamps)
        assert len(rows_of_runs(written, np.empty(0, np.int64), ())) == 1


def test_stretches_in_another_order_are_sorted_and_that_is_said():
    for stamps in (np.concatenate([EVEN[200:], EVEN[:200]]), EVEN[::-1]):
        assert len(sorted_stamps(stamps)[0]) == 400
    order = np.arange(400)
    for at in range(20, 380, 40):
        order[at : at + 4] = order[[at + 2, at + 3, at, at + 1]]
    keep, ordered, notes, _ = sorted_stamps(EVEN[order])
    assert np.array_equal(ordered, EVEN)
    assert (len(keep), notes) == (400, ["9 samples out of order were sorted"])


@pytest.mark.parametrize("window", [1, 4, 30])
@pytest.mark.parametrize("back_s", [0.3, 1.0004, 2.6, 60.0])
def test_a_clock_that_is_set_back_is_cut_though_samples_overtook_each_other(
    window: int, back_s: float
):
    stamps = stamps_at(200, 0.02, 0.01, 1)
    stamps[550:] -= round(back_s * SECOND)
    found = sorted_stamps(stamps[mixed(len(stamps), window, "delayed")])
    assert len(found.keep) == pytest.approx(550, abs=2 * window)
    assert "is set back by" in found.notes[0]
    assert "and" not in found.notes[0].partition(":")[0]  # once
    left_out = found.left_out["by a clock that was set"]
    assert left_out == pytest.approx(len(stamps) - 550, abs=2 * window)


def test_a_header_is_believed_whose_messages_overtook_each_other_but_not_any():
    stamps = stamps_at(240, 0, 0, 0)
    rng = np.random.default_rng(0)
    arrivals = stamps + np.round(rng.uniform(0, 0.02, len(stamps)) * SECOND).astype(np.int64)
    order = np.argsort(arrivals)
    assert np.array_equal(order_samples(stamps[order], arrivals[order]).stamps_ns, stamps)
    noise = rng.permutation(stamps)  # no clock's
    found = order_samples(noise + rng.integers(-(10**7), 10**7, len(noise)), arrivals[order])
    assert np.array_equal(found.stamps_ns, arrivals[order])
    assert "so the log's own times are used" in found.notes[0]


@pytest.mark.parametrize("kind", ["mcap", "db3", "csv"])
def test_a_log_is_tuned_as_in_order(tmp_path: Path, kind: str, command: Command):
    stamps, positions = DROP.samples()
    write = {"mcap": write_poses, "csv": write_table, "db3": write_poses_folder}[kind]
    values, path = [], tmp_path
    for window in (1, 9):
        order = mixed(len(stamps), window, "delayed")
        path = tmp_path / (str(window) if kind == "db3" else f"{window}.{kind}")
        write(path, stamps[order], positions[order])
        values.append(tuned(path))
    assert np.allclose(*values, rtol=0, atol=1e-9)
    checked = command("tunenet-logs", "check", path)
    assert checked.returncode == 0
    assert "out of order were sorted" in checked.stdout


def test_what_is_left_out_caps_the_verdict_and_is_said(tmp_path: Path, command: Command):
    stamps, positions = DROP.samples()
    stamps[300:] -= SECOND // 2
    write_poses(tmp_path / "a.mcap", stamps, positions)
    tuning = tune_log(tmp_path / "a.mcap", TuneOptions())
    assert tuning.verdict == "suspect"
    assert "samples are all there" in str(tuning.reason)
    checked = command("tunenet-logs", "check", tmp_path / "a.mcap")
    assert checked.returncode == 1
    assert "whole, " in checked.stdout
    assert "a.mcap: not whole, " in checked.stdout
    imported = command("tunenet-logs", "import", tmp_path / "a.mcap", "-o", tmp_path / "b.mcap")
    for said in (checked, imported):
        assert f"{len(stamps) - 300} by a clock that was set" in said.stdout
    assert tune_log(tmp_path / "b.mcap", TuneOptions()).verdict == "suspect"


def test_local_time_at_the_end_of_summer_time_is_a_clock_that_is_set_back(tmp_path: Path):
    stamps, positions = DROP.samples()
    stamps[150:] -= 3600 * SECOND
    write_table(tmp_path / "a.csv", stamps, positions)
    tuning = tune_log(tmp_path / "a.csv", TuneOptions())
    assert tuning.verdict == "suspect"
    assert tuning.reason is not None
    assert tuning.reason.startswith("samples are all there")
    assert "by a clock that was set" in tuning.reason
    assert "clock that is not set" in tuning.reason.rpartition(";")[2]


@pytest.mark.parametrize(("every", "verdict"), [(200, "ok"), (20, "suspect")])
def test_rows_that_cannot_be_read_count(tmp_path: Path, every: int, verdict: str):
    stamps, positions = DROP.samples()
    write_table(tmp_path / "a.csv", stamps, positions)
    head, *rows = (tmp_path / "a.csv").read_text().splitlines()
    rows = [row[: len(row) // 2] if at % every == 7 else row for at, row in enumerate(rows)]
    (tmp_path / "a.csv").write_text("\n".join((head, *rows)) + "\n")
    [signal] = read_episode(tmp_path / "a.csv").signals.values()
    assert sum(signal.left_out.values()) == pytest.approx(len(stamps) / every, abs=1)
    assert tune_log(tmp_path / "a.csv", TuneOptions()).verdict == verdict


def test_lost_chunks_count_in_the_log_and_in_what_is_recovered(tmp_path: Path, command: Command):
    stamps, positions = DROP.samples()
    write_poses(tmp_path / "a.mcap", stamps, positions, chunk_bytes=4096)
    data = bytearray((tmp_path / "a.mcap").read_bytes())
    at = data.index(b"lz4", len(data) // 4) + 200
    data[at : at + 8] = bytes(8 * [0x5A])
    (tmp_path / "a.mcap").write_bytes(bytes(data))
    [signal] = read_episode(tmp_path / "a.mcap").signals.values()
    missing = len(stamps) - len(signal.stamps_ns)
    assert missing > 0.02 * len(stamps)
    assert sum(signal.left_out.values()) == missing  # as the log's own count says
    command("tunenet-logs", "recover", tmp_path / "a.mcap", "-o", tmp_path / "b.mcap")
    [saved] = read_episode(tmp_path / "b.mcap").signals.values()
    assert sum(saved.left_out.values()) == missing
    assert tune_log(tmp_path / "b.mcap", TuneOptions()).verdict == "suspect"


def test_a_channel_that_is_defined_again_as_another_is_damage(tmp_path: Path, command: Command):
    path = tmp_path / "b.mcap"
    schema = Schema("a", "jsonschema", b"{}", "json")
    sent = ((("/ball", "/base")[number % 2], schema, number, b"{}") for number in range(40))
    write_raw(path, sent, chunk_bytes=0)
    data = path.read_bytes()
    second = data.index(b"/base") - 4 - 2 - 2  # its number, its schema's, the topic's length
    assert struct.unpack_from("<H", data, second) == (2,)
    path.write_bytes(data[:second] + struct.pack("<H", 1) + data[second + 2 :])
    checked = command("tunenet-logs", "check", path)
    assert checked.returncode == 1
    assert "channel 1, /ball, is defined again as /base" in checked.stdout


def test_pictures_that_overtook_each_other_are_sorted(tmp_path: Path, filmed_log: Path):
    frames = [
        replace(one, stamp_ns=one.stamp_ns + SECOND) for one in read_episode(filmed_log).frames()
    ]
    with EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo()) as writer:
        for number in mixed(len(frames), 6, "shuffled").tolist():
            writer.write_frame("/camera", frames[number])
    found = read_episode(tmp_path / "a.mcap")
    assert [one.data for one in found.frames()] == [one.data for one in frames]
    assert any("pictures out of order were sorted" in line for line in found.warnings)
    assert not any(found.channels[0].left_out.values())


def test_a_table_whose_times_begin_again_says_so(tmp_path: Path):
    """Runs below each other look like a clock that was set back before the first row."""
    times_s = [*np.arange(50) * 0.01 + 3, *np.arange(80) * 0.01]
    rows = "".join(f"{t:.2f},{1 - t / 9:.5f}\n" for t in times_s)
    (tmp_path / "again.csv").write_text(f"t,z_m\n{rows}")
    episode = read_episode(tmp_path / "again.csv")
    assert sorted(episode.signals) == ["track.run1", "track.run2"]
    assert any("begin again 1 times" in one for one in episode.warnings)


# The clock behind arrivals: even, with pauses and bursts, and the rate that it has.
Stamps = NDArray[np.int64]
PERIOD_NS = 16_666_667
CLOCK = 1_000_000_000 + PERIOD_NS * np.arange(180)
FILMED = ROOT / "sample_logs" / "filmed.mcap"
DELAYS = ("up to 40 ms", "exponential", "bursts")


def arrivals(
    seed: int, rate_hz: float, delay: str, missing: float = 0.0
) -> tuple[NDArray[np.intp], NDArray[np.floating], Stamps]:
    """Ticks of the samples that come, when they were taken [ms], and when they come [ns]."""
    rng = np.random.default_rng(seed)
    ticks = np.flatnonzero(rng.random(round(3 * rate_hz)) >= missing)
    taken = rng.uniform(0, 100) + ticks * 1e3 / rate_hz
    late = {
        "up to 40 ms": rng.uniform(0, 40, len(ticks)),
        "exponential": rng.exponential(10, len(ticks)),
        "bursts": -taken % 100,
    }[delay]
    came = np.maximum.accumulate(taken + late + rng.exponential(0.1, len(ticks)))
    return ticks, taken, np.round(came * 1e6).astype(np.int64) + np.arange(len(ticks))


def found(came_ns: Stamps) -> UniformClock:
    clock = recover_uniform_clock(came_ns)
    assert clock is not None
    return clock


@pytest.mark.parametrize("delay", DELAYS)
@pytest.mark.parametrize("rate_hz", [30, 60, 120, 27.3])
def test_where_all_samples_come_each_is_put_on_its_tick(delay: str, rate_hz: float):
    errors = []
    for seed in range(2):
        ticks, taken, came_ns = arrivals(seed, rate_hz, delay)
        clock = found(came_ns)
        sure = ~clock.unsure
        assert np.mean(sure) > 0.8
        assert np.ptp((clock.ticks - ticks)[sure]) == 0
        assert clock.rate_hz == pytest.approx(rate_hz, rel=4e-3)
        errors.append(np.std((clock.stamps - taken)[sure]))
        assert not changing_rate(came_ns, 24)
    assert np.mean(errors) < (0.3 if rate_hz != 27.3 else 1.5)  # a usual rate is known exactly


def test_what_delays_do_not_tell_apart_is_not_taken_for_television_s_rate():
    rates_hz = [found(arrivals(seed, 60, "up to 40 ms")[2]).rate_hz for seed in range(16)]
    assert np.count_nonzero(np.isclose(rates_hz, 60, rtol=1e-6)) >= 14
    assert found(arrivals(0, 60 / 1.001, "exponential")[2]).rate_hz == pytest.approx(60 / 1.001)


def test_a_clock_that_drifts_is_followed_and_few_samples_tell_none():
    rng = np.random.default_rng(1)
    ticks = np.arange(4000)
    taken = ticks * 1e3 / 60 + 2e-6 * ticks**2  # 32 ms in a minute
    came = np.maximum.accumulate(taken + rng.exponential(10, len(ticks)))
    clock = found(np.round(came * 1e6).astype(np.int64) + ticks)
    assert np.ptp(clock.ticks - ticks) == 0
    assert np.std(clock.stamps - taken) < 0.5
    assert recover_uniform_clock(np.arange(10) * 1_000_000) is None
    assert recover_uniform_clock(np.full(100, 5)) is None


def test_the_likeliest_ticks_are_those_of_all_ways():
    """Viterbi's ways are as cheap as the cheapest of min-sum, which looks at all of them."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        taken = np.flatnonzero(rng.random(90) > 0.1) * 10.0
        came = np.maximum.accumulate(taken + rng.exponential(rng.choice([1.0, 8.0]), len(taken)))
        periods = np.array([9.9, 10.0, 10.2])
        clocks = Clocks(periods, np.zeros(3), np.full(3, 5.0), np.array([0, 1, 0]))  # of both laws
        costs, skipped = likeliest_ticks(came, clocks, 2)
        every = assign_ticks(came, clocks, 2)
        assert costs == pytest.approx(every.costs, rel=1e-6)
        assert (np.diff(skipped) >= 0).all()
        extra = np.take_along_axis(every.excess, skipped[:, :, None] + 2, axis=2)
        assert np.abs(extra).max() < 1e-3


@pytest.mark.parametrize("share", [0.0, 0.1, 0.3])
@pytest.mark.parametrize("noise_us", [0, 20, 200])
def test_exact_stamps_with_dropouts_stay_what_they_are(share: float, noise_us: int):
    for seed in range(2):
        rng = np.random.default_rng(seed)
        ticks = np.flatnonzero(rng.random(400) >= share)
        exact = np.round(ticks * 1e9 / 120).astype(np.int64)
        stamps = exact + np.round(rng.normal(0, 1e3 * noise_us, len(ticks))).astype(np.int64)
        assert np.abs(correct_late_stamps(stamps).stamps_ns - stamps).max() < 50_000


@pytest.mark.parametrize("jitter_ms", [0.0, 40.0])
def test_a_camera_that_slows_down_in_the_dark_is_named(jitter_ms: float):
    rng = np.random.default_rng(2)
    taken = np.cumsum(np.linspace(1e3 / 30, 1e3 / 12, 200))
    came = np.maximum.accumulate(taken + rng.uniform(0, jitter_ms + 1e-9, len(taken)))
    stamps = np.round(came * 1e6).astype(np.int64) + np.arange(len(taken))
    corrected = correct_late_stamps(stamps)
    assert np.array_equal(corrected.stamps_ns, stamps)
    assert "the rate of the pictures goes from" in corrected.warnings("pictures")[0]


# Pauses and bursts.
def held_up(stamps_ns: Stamps, first: int, pause_ms: float, apart_us: int = 200) -> Stamps:
    """As they arrive where nothing comes through for a while from a sample on."""
    free_ns = stamps_ns[first] + round(pause_ms * 1e6)
    arrived = stamps_ns.copy()
    waiting = np.flatnonzero((stamps_ns >= stamps_ns[first]) & (stamps_ns < free_ns))
    arrived[waiting] = free_ns + apart_us * 1000 * np.arange(len(waiting))
    return np.maximum.accumulate(arrived) + np.arange(len(arrived))


@pytest.mark.parametrize("pause_ms", [30, 80, 150, 300])
@pytest.mark.parametrize("first", [20, 80, 150])
@pytest.mark.parametrize("jitter_ms", [0.0, 2.0])
def test_a_burst_is_put_where_its_clock_says(first: int, pause_ms: float, jitter_ms: float):
    rng = np.random.default_rng(first)
    taken = CLOCK + np.round(rng.uniform(0, jitter_ms, len(CLOCK)) * 1e6).astype(np.int64)
    arrivals = correct_late_stamps(held_up(taken, first, pause_ms))
    assert np.abs(arrivals.stamps_ns - CLOCK).max() < 0.3 * PERIOD_NS + jitter_ms * 1e6
    assert np.all(np.diff(arrivals.stamps_ns) > 0)
    assert "ms late" in arrivals.warnings("pictures")[0]
    late = len(arrivals.taken_ns)
    if jitter_ms:
        assert arrivals.clock is not None
        late = np.count_nonzero(arrivals.clock.lateness > 8)
    assert late == pytest.approx(pause_ms / 16.7, abs=1.5)


@pytest.mark.parametrize("quantum_ns", [1, 1_000, 100_000, 1_000_000])
def test_bursts_in_a_burst_and_in_rounded_stamps(quantum_ns: int):
    late = held_up(held_up(held_up(CLOCK, 40, 150, 1000), 90, 150, 1000), 150, 150, 1000)
    arrivals = correct_late_stamps(late // quantum_ns * quantum_ns)
    assert np.abs(arrivals.stamps_ns - CLOCK).max() < 0.5 * PERIOD_NS
    assert "ms late" in arrivals.warnings("samples")[0]
    arrivals = correct_late_stamps(held_up(held_up(CLOCK, 60, 150), 66, 180))
    assert np.abs(arrivals.stamps_ns - CLOCK).max() < 0.3 * PERIOD_NS


UNEVEN = [np.cumsum(np.abs(np.random.default_rng(n).normal(33e6, 2e6, 200))) for n in range(3)]


@pytest.mark.parametrize(
    "stamps",
    [
        CLOCK,
        np.delete(CLOCK, slice(60, 70)),  # lost for good
        np.delete(held_up(CLOCK, 60, 150), slice(64, 68)),  # lost on the way: nobody knows which
        np.concatenate([CLOCK[:60], CLOCK[60:] + 10 * PERIOD_NS]),  # held up for good
        np.sort(np.concatenate([CLOCK, CLOCK[::10] + 1_000_000])),  # written twice
        CLOCK[np.arange(len(CLOCK)) % 5 != 0],  # every fifth is missing
        CLOCK[:5],
        CLOCK[:0],
        *(one.astype(np.int64) for one in UNEVEN),  # a sensor that is not even
    ],
)
def test_what_tells_of_no_burst_is_left_as_it_is(stamps: Stamps):
    arrivals = correct_late_stamps(stamps)
    assert np.array_equal(arrivals.stamps_ns, stamps)
    assert not arrivals.warnings("pictures")


@pytest.mark.parametrize("rate_hz", [100, 120, 360])
@pytest.mark.parametrize("decimals", [6, 9])
@pytest.mark.parametrize("seen", [0.3, 0.5, 0.6, 0.9])
def test_frames_that_were_not_seen_are_no_burst(rate_hz: int, decimals: int, seen: float):
    frames = np.flatnonzero(np.random.default_rng(rate_hz).random(2000) < seen)
    frames = np.delete(frames, slice(300, 500))
    stamps = np.round(np.round(frames / rate_hz, decimals) * 1e9).astype(np.int64)
    arrivals = correct_late_stamps(stamps)
    np.testing.assert_array_equal(arrivals.stamps_ns, stamps)
    assert arrivals.warnings("samples") == []


@pytest.mark.parametrize(
    ("first", "pause_ms"),
    [(35, 150), *(pytest.param(*one, marks=pytest.mark.slow) for one in ((45, 80), (80, 300)))],
)
def test_a_film_that_stalls_tells_the_same(tmp_path: Path, first: int, pause_ms: float):
    """Within .001; without the mending each of these is rejected, or its value doubted."""
    frames = list(read_episode(FILMED).frames())
    stamps = held_up(np.array([frame.stamp_ns for frame in frames]), first, pause_ms)
    path = tmp_path / "stalled.mcap"
    with EpisodeWriter(path, EpisodeInfo(kind="drop"), live=False) as writer:
        for frame, stamp_ns in zip(frames, stamps, strict=True):
            writer.write_frame("/camera", replace(frame, stamp_ns=int(stamp_ns)))
    tuning = tune_log(path, TuneOptions())
    assert tuning.verdict == "ok", tuning.reason
    assert tuning.estimate is not None
    assert tuning.estimate[0] == pytest.approx(tuned(FILMED), abs=0.001)
    assert any("came in bursts" in warning for warning in tuning.warnings)


def test_positions_that_stall_tell_the_same(tmp_path: Path):
    stamps, positions = Stranger(restitution=0.6, gap_m=1.0).samples()
    found = []
    for arrived in (stamps, held_up(stamps, 90, 80)):
        path = tmp_path / f"{len(found)}.mcap"
        with EpisodeWriter(path, EpisodeInfo(kind="drop"), live=False) as writer:
            for stamp_ns, position_m in zip(arrived, positions, strict=True):
                writer.write_pose("/mocap/ball", int(stamp_ns), position_m)
        found.append(tuned(path))
    assert found[1] == pytest.approx(found[0], abs=1e-4)


# Rates: messages over time, whatever delays, pauses and losses do to single steps.
HZ = 60.0
EVEN_S = np.arange(600) / HZ
RNG = np.random.default_rng(0)


def hz(seconds: ArrayLike) -> float:
    from_ns = 1_700_000_000_000_000_000
    return measured_hz(from_ns + np.round(np.asarray(seconds) * 1e9).astype(np.int64))


def bursts(every_s: float) -> np.ndarray:
    return np.ceil(EVEN_S / every_s) * every_s + np.arange(600) * 1e-9


def stopped(of_waiting: slice) -> np.ndarray:
    """A reader that was stopped from 4 s to 6 s, and what had waited for it."""
    inside = np.flatnonzero((EVEN_S > 4) & (EVEN_S < 6))
    waited = 6 - np.arange(len(inside))[::-1] * 1e-6
    return np.r_[EVEN_S[EVEN_S <= 4], waited[of_waiting], EVEN_S[EVEN_S >= 6] + 1e-6]


@pytest.mark.parametrize(
    ("seconds", "rate_hz", "rel"),
    [
        (EVEN_S, HZ, 0.002),
        (EVEN_S[:2], HZ, 0.002),
        (EVEN_S + RNG.uniform(0, 0.04, 600), HZ, 0.002),
        (EVEN_S + RNG.exponential(0.01, 600), HZ, 0.002),
        *((bursts(every_s), HZ, 0.002) for every_s in (0.1, 0.25, 1.0)),
        *((stopped(slice(kept)), HZ, 0.002) for kept in (None, 0, 60)),  # some of it lost
        (np.r_[EVEN_S, 7200.0], HZ, 0.002),
        (np.r_[-7200.0, EVEN_S], HZ, 0.002),
        (np.r_[EVEN_S[:200], EVEN_S[200:400] + 5, EVEN_S[400:] + 12], HZ, 0.002),  # pauses
        (np.r_[np.full(120, 2.0) + np.arange(120) * 1e-4, EVEN_S[120:]], HZ, 0.002),  # read ahead
        (EVEN_S[np.argsort(np.arange(600) + RNG.uniform(0, 3, 600))], HZ, 0.002),  # out of order
        (EVEN_S[RNG.random(600) > 0.1], 0.9 * HZ, 0.03),  # what is missing is not counted
        (np.r_[EVEN_S[:300], EVEN_S[299] + np.arange(1, 151) / 30], 45, 0.002),  # it changes
        (np.arange(20) * 10.0, 0.1, 1e-6),
        (np.r_[np.arange(30), np.arange(90, 120)], 1.0, 0.03),
        (np.arange(300) * 1e-9, 0, 0),  # what came in one piece tells none
        ([], 0, 0),
        ([3.0], 0, 0),
    ],
)
def test_measured_rates(seconds: ArrayLike, rate_hz: float, rel: float):
    assert hz(seconds) == pytest.approx(rate_hz, rel=rel)


def test_rates_of_a_few_pictures():
    assert measured_hz([0, 100_000, 200_000], MAX_SPEED_CAMERA_HZ) == 0
    times = StoredTimes(ticks=[0, 10, 110], count=3, base_s=Fraction(1, 100), rate_hz=None, tags={})
    clock = clock_of(times, None)
    assert clock.stamps_ns.tolist() == [0, 100_000_000, 1_100_000_000]
    assert clock.stored_hz == 1 / 0.55


# ---- Films that were converted to another rate


@pytest.mark.parametrize(
    ("shown_hz", "rates_hz"),
    [
        (24.0, {25, 30, 50, 60}),
        (24000 / 1001, {25, 30, 50, 60}),
        (25.0, {24, 30, 60}),
        (30.0, {24, 25, 50}),
        (60.0, {24, 25, 50}),
        (120.0, set[int]()),
        (27.0, set[int]()),
    ],
)
def test_a_film_may_have_been_converted_from_usual_rates(shown_hz: float, rates_hz: set[int]):
    stamps_ns = np.round(np.arange(60) * 1e9 / shown_hz).astype(np.int64)
    found = conversions(stamps_ns)
    # 25 to 24 too: one picture of 25.
    assert {round(one.source_hz) for one in found} == rates_hz
    for one in found:
        placed_ns = one.placed_ns(stamps_ns)
        assert placed_ns[0] == stamps_ns[0]
        assert np.abs(placed_ns - stamps_ns).max() < 1.01e9 / one.source_hz
        assert one.unexplained(stamps_ns) == 0
        assert len({*one.placed_ns(stamps_ns).tolist()}) == len({*one.numbers(stamps_ns).tolist()})


@pytest.mark.parametrize(
    ("source_hz", "shown_hz", "words"),
    [
        (30, 24, "from 30 to 24 pictures a second (1 of 5 is missing)"),
        (60, 25, "from 60 to 25 pictures a second (7 of 12 are missing)"),
        (24, 30, "from 24 to 30 pictures a second (1 of 4 is shown twice)"),
    ],
)
def test_a_doubled_picture_has_no_stamp_and_a_conversion_has_words(
    source_hz: int, shown_hz: int, words: str
):
    stamps_ns = np.round(np.arange(60) * 1e9 / shown_hz).astype(np.int64)
    (first, *_) = (one for one in conversions(stamps_ns) if round(one.source_hz) == source_hz)
    assert first.words == words
    kept = np.unique(first.numbers(stamps_ns), return_index=True)[1]
    assert first.unexplained(stamps_ns[kept]) == 0
    assert (first.unexplained(np.delete(stamps_ns, kept[5])) == 1) == (kept[5] > 0)
