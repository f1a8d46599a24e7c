"""Write one small log of every kind that is read, for those who break them."""

from __future__ import annotations

from pathlib import Path

from rosbags.rosbag1 import Writer as BagWriter

from tests import hostile, strangers
from tests.bench.damage import write_log


def write_all(folder: Path) -> None:
    """Write the logs, each under a name that says its kind."""
    samples = strangers.Stranger(0.6, seconds=0.4, hold_s=0.1).samples()
    write_log(folder / "ours.mcap", samples=24, pictures=2)
    strangers.without_chunks(folder / "ours.mcap", folder / "plain.mcap")
    ours = folder / "ours.mcap"  # checksums hide what is behind them from a fuzzer
    strangers.without_chunks(ours, folder / "bare.mcap", crcs=False)
    strangers.without_chunks(ours, folder / "chunks.mcap", chunks=True, crcs=False)
    strangers.write_poses(folder / "lz4.mcap", *samples)
    strangers.write_ros1(folder / "ros1.mcap", *samples)
    strangers.write_protobuf(folder / "protobuf.mcap", *samples)
    strangers.write_json(folder / "json.mcap", *samples)
    strangers.write_table(folder / "table.csv", *samples)
    for number, compression in enumerate((None, *BagWriter.CompressionFormat)):
        strangers.write_poses_bag(folder / f"{number}.bag", *samples, compression=compression)
    strangers.write_poses_folder(folder / "folder", *samples).rename(folder / "a.db3")
    for left in (folder / "folder").iterdir():
        left.unlink()
    (folder / "folder").rmdir()
    hostile.forged_jpeg(folder / "pictures.mcap")
