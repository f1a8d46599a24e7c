"""Samples that overtook each other, and clocks that were set back: told apart by their stamps."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer

from tests.conftest import Command
from tests.strangers import Stranger, write_poses, write_poses_folder, write_table
from tunenet_logs.analysis.options import TuneOptions
from tunenet_logs.analysis.tuning import tune_log
from tunenet_logs.episode import EpisodeInfo
from tunenet_logs.formats.columns.table import rows_of_runs
from tunenet_logs.reader import read_episode
from tunenet_logs.timing.stamps import order_samples, sorted_stamps
from tunenet_logs.writing.writer import EpisodeWriter

SECOND = 10**9
DROP = Stranger(0.7, hold_s=0.4, seconds=3.0, noise_m=0.0004)


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
@pytest.mark.parametrize("window", [2, 5, 8, 20, 60])
@pytest.mark.parametrize(
    ("rate_hz", "jitter", "lost"), [(60, 0, 0), (240, 0.1, 0.05), (1000, 0.02, 0.01)]
)
def test_disorder_is_sorted_whole(
    how: str, window: int, rate_hz: float, jitter: float, lost: float
):
    stamps = stamps_at(rate_hz, jitter, lost, window)
    written = stamps[mixed(len(stamps), window, how)]
    found = sorted_stamps(written)
    assert np.array_equal(found.stamps_ns, stamps)
    assert not found.left_out
    assert np.array_equal(order_samples(written, written).stamps_ns, stamps)
    assert len(rows_of_runs(written, np.empty(0, np.int64), ())) == 1


@pytest.mark.parametrize("window", [1, 4, 30])
@pytest.mark.parametrize("back_s", [0.3, 1.0004, 2.6, 60.0])
def test_a_clock_that_is_set_back_is_cut_though_samples_overtook_each_other(
    window: int, back_s: float
):
    stamps = stamps_at(200, 0.02, 0.01, 1)
    stamps[550:] -= round(back_s * SECOND)
    written = stamps[mixed(len(stamps), window, "delayed")]
    found = sorted_stamps(written)
    assert len(found.keep) == pytest.approx(550, abs=2 * window)
    assert "is set back by" in found.notes[0]
    assert "and" not in found.notes[0].partition(":")[0]  # once
    left_out = found.left_out["by a clock that was set"]
    assert left_out == pytest.approx(len(stamps) - 550, abs=2 * window)


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


def test_a_header_is_believed_whose_messages_overtook_each_other():
    stamps = stamps_at(240, 0, 0, 0)
    rng = np.random.default_rng(0)
    arrivals = stamps + np.round(rng.uniform(0, 0.02, len(stamps)) * SECOND).astype(np.int64)
    order = np.argsort(arrivals)
    found = order_samples(stamps[order], arrivals[order])
    assert np.array_equal(found.stamps_ns, stamps)
    noise = rng.permutation(stamps)  # no clock's
    found = order_samples(noise + rng.integers(-(10**7), 10**7, len(noise)), arrivals[order])
    assert np.array_equal(found.stamps_ns, arrivals[order])
    assert "so the log's own times are used" in found.notes[0]


def test_a_header_that_is_set_into_a_time_of_its_own_gives_way_to_the_log():
    stamps = stamps_at(100, 0, 0.05, 0)
    header = stamps.copy()
    header[280:] -= 6 * SECOND
    found = order_samples(header, stamps)
    assert np.array_equal(found.stamps_ns, stamps)
    assert "is set back by" in found.notes[0]


@pytest.mark.parametrize("kind", ["mcap", "db3", "csv"])
def test_a_log_is_tuned_as_in_order(tmp_path: Path, kind: str, command: Command):
    stamps, positions = DROP.samples()
    values, path = [], tmp_path
    for window in (1, 9):
        order = mixed(len(stamps), window, "delayed")
        path = tmp_path / f"{window}.{kind}"
        if kind == "csv":
            write_table(path, stamps[order], positions[order])
        elif kind == "mcap":
            write_poses(path, stamps[order], positions[order])
        else:
            path = tmp_path / str(window)
            write_poses_folder(path, stamps[order], positions[order], "/ball/pose")
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
    assert f"{len(stamps) - 300} by a clock that was set" in checked.stdout
    imported = command("tunenet-logs", "import", tmp_path / "a.mcap", "-o", tmp_path / "b.mcap")
    assert f"{len(stamps) - 300} by a clock that was set" in imported.stdout
    assert tune_log(tmp_path / "b.mcap", TuneOptions()).verdict == "suspect"


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


def test_samples_of_one_stamp_count_only_where_they_differ():
    stamps, values = np.array([1, 2, 2, 3, 3, 4]), np.array([1.0, 2, 2, 3, 5, np.nan])
    found = sorted_stamps(stamps, (values[:, None],))
    assert sum(found.left_out.values()) == 1
    assert "2 samples with a stamp already seen" in found.notes[0]


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
    with (tmp_path / "b.mcap").open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        for topic in ("/ball", "/base"):
            writer.register_channel(topic, "json", 0)
        for number in range(40):
            writer.add_message(1 + number % 2, number, b"{}", number)
        writer.finish()
    data = (tmp_path / "b.mcap").read_bytes()
    second = data.index(b"/base") - 4 - 2 - 2  # its number, its schema's, the topic's length
    assert struct.unpack_from("<H", data, second) == (2,)
    (tmp_path / "b.mcap").write_bytes(data[:second] + struct.pack("<H", 1) + data[second + 2 :])
    checked = command("tunenet-logs", "check", tmp_path / "b.mcap")
    assert checked.returncode == 1
    assert "channel 1, /ball, is defined again as /base" in checked.stdout


def test_pictures_that_overtook_each_other_are_sorted(tmp_path: Path, filmed_log: Path):
    frames = [
        replace(one, stamp_ns=one.stamp_ns + SECOND) for one in read_episode(filmed_log).frames()
    ]
    order = mixed(len(frames), 6, "shuffled")
    with EpisodeWriter(tmp_path / "a.mcap", EpisodeInfo()) as writer:
        for number in order.tolist():
            writer.write_frame("/camera", frames[number])
    found = read_episode(tmp_path / "a.mcap")
    assert [one.data for one in found.frames()] == [one.data for one in frames]
    assert any("pictures out of order were sorted" in line for line in found.warnings)
    assert not any(found.channels[0].left_out.values())


def test_a_table_whose_times_begin_again_says_so(tmp_path: Path):
    """Runs below each other look like a clock that was set back before the first row."""
    path = tmp_path / "again.csv"
    times_s = [*np.arange(50) * 0.01 + 3, *np.arange(80) * 0.01]
    path.write_text("t,z_m\n" + "".join(f"{t:.2f},{1 - t / 9:.5f}\n" for t in times_s))
    episode = read_episode(path)
    assert sorted(episode.signals) == ["track.run1", "track.run2"]
    assert any("begin again 1 times" in one for one in episode.warnings)
