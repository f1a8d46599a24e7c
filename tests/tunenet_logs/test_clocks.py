"""Clocks that were set, samples that overtook each other, and pauses that are neither."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.writer import Writer

from tests.conftest import Command
from tests.strangers import Stranger, write_poses, write_poses_folder, write_table
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import Episode, EpisodeInfo, Signal
from tunenet_logs.formats.columns.table import rows_of_runs
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.stamps import (
    filmed_part,
    order_samples,
    part_on_grid,
    sorted_stamps,
    sound_part,
    trim_clock_jumps,
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


def test_samples_of_one_stamp_count_only_where_they_differ():
    stamps, values = np.array([1, 2, 2, 3, 3, 4]), np.array([1.0, 2, 2, 3, 5, np.nan])
    found = sorted_stamps(stamps, (values[:, None],))
    assert sum(found.left_out.values()) == 1
    assert "2 samples with a stamp already seen" in found.notes[0]


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


@pytest.mark.parametrize("back_s", [0.5, 2.0])
def test_a_clock_that_is_set_back_is_not_sorted_into_itself(back_s: float):
    keep, ordered, notes, _ = sorted_stamps(shifted(slice(250, None), -back_s + 0.003))
    assert keep.tolist() == list(range(250))
    assert np.array_equal(ordered, EVEN[:250])
    assert "is set back by" in notes[0]
    assert "before it, is used (250 samples)" in notes[0]


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


def test_an_episode_says_once_what_is_cut_of_it():
    stamps = shifted(slice(300, None), 86400)
    values = np.arange(800.0).reshape(400, 2)
    signals = {
        f"/joints.{part}": Signal(f"/joints.{part}", stamps, values, ("a", "b"), "rad")
        for part in ("position", "velocity")
    }
    whole = Episode(EpisodeInfo(), signals, warnings=("something else",))
    cut = trim_clock_jumps(whole)
    assert [len(one.stamps_ns) for one in cut.signals.values()] == [300, 300]
    assert np.array_equal(cut.signals["/joints.position"].values, values[:300])
    assert len(cut.warnings) == 2
    assert trim_clock_jumps(cut).warnings == cut.warnings
    assert len(whole.signals["/joints.position"].stamps_ns) == 400


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
    stamps = stamps_at(100, 0, 0.05, 0)
    header = stamps.copy()
    header[280:] -= 6 * SECOND  # into a time of its own
    found = order_samples(header, stamps)
    assert np.array_equal(found.stamps_ns, stamps)
    assert "is set back by" in found.notes[0]


@pytest.mark.parametrize("kind", ["mcap", "db3", "csv"])
def test_a_log_is_tuned_as_in_order(tmp_path: Path, kind: str, command: Command):
    stamps, positions = DROP.samples()
    write = {"mcap": write_poses, "csv": write_table, "db3": write_poses_folder}[kind]
    values, path = [], tmp_path
    for window in (1, 9):
        order = mixed(len(stamps), window, "delayed")
        path = tmp_path / (str(window) if kind == "db3" else f"{window}.{kind}")
        write(path, stamps[order], positions[order])
        tuning = tune_log(path, TuneOptions())
        assert tuning.verdict == "ok", tuning.reason
        assert tuning.trace is not None
        values.append(tuning.trace.estimate)
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
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        for topic in ("/ball", "/base"):
            writer.register_channel(topic, "json", 0)
        for number in range(40):
            writer.add_message(1 + number % 2, number, b"{}", number)
        writer.finish()
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
