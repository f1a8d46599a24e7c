"""Files of arrays as laboratories' programs lay them out, each by the format's own library.

A drop is one of restitution `RESTITUTION`; an arm's joints are `joints()`. ULog is written here, by
https://docs.px4.io/main/en/dev_log/ulog_file_format.html: its library only reads.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pandas as pd
import scipy.io
from numpy.typing import NDArray

from tests.export_writers_video import write_xlsx
from tests.strangers import bounce_heights

Floats = NDArray[np.float64]

RESTITUTION = 0.7
RATE_HZ = 240.0


def drop(height_m: float = 1.2, seconds: float = 2.0) -> tuple[Floats, Floats]:
    """Times, and the places of a ball that falls, z up, shape (T, 3)."""
    times = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    heights = bounce_heights(RESTITUTION, height_m, times, 9.80665)
    return times, np.column_stack([0.1 + 0 * times, 0.2 + 0 * times, heights])


def joints(phase: float = 0.0) -> tuple[Floats, Floats, Floats, Floats]:
    """Times, angles, speeds and torques of seven joints, shape (T, 7)."""
    times = np.arange(200) / 50
    rows = times[:, None] + np.arange(7) + phase
    return times, np.sin(rows), np.cos(rows), 3 * np.sin(rows) + 1


def write_hdf5(
    path: Path, arrays: Mapping[str, Any], attributes: Mapping[str, Any] | None = None
) -> None:
    """Arrays by their names, attributes by those of their groups and their own: `data@env`."""
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file[name] = array
        for name, value in (attributes or {}).items():
            group, _, key = name.partition("@")
            (file[group] if group else file).attrs[key] = value


def plain_hdf5(path: Path) -> None:
    times, places = drop()
    with h5py.File(path, "w") as file:
        file["time"] = times
        file.create_dataset("ball/position", data=places, compression="gzip", shuffle=True)


def table_hdf5(path: Path) -> None:
    """One data set of named fields, as PyTables writes tables."""
    times, places = drop()
    kind = np.dtype([("t", "f8"), ("x", "f8"), ("y", "f8"), ("z", "f8")])
    rows = np.array([(time, *place) for time, place in zip(times, places, strict=True)], kind)
    write_hdf5(path, {"track/table": rows})


def matlab_73(path: Path) -> None:
    """As MATLAB saves with -v7.3: behind 512 bytes, columns first, classes as attributes."""
    times, places = drop()
    arrays = {"t": times[:, None], "ball": places, "note": np.frombuffer(b"h\0i\0", "<u2")[None]}
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, array in arrays.items():
            made = file.create_dataset(name, data=array.T)
            made.attrs["MATLAB_class"] = np.bytes_("char" if name == "note" else "double")
        file.create_group("#refs#")["a"] = np.zeros(3)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + bytes(8) + b"\x00\x02IM"
    with path.open("r+b") as file:
        file.write(head)


def robomimic(path: Path) -> None:
    """Demonstrations of an arm: data/demo_N/obs, at the environment's rate of control."""
    arrays: dict[str, Any] = {"mask/train": np.array([b"demo_0", b"demo_1"])}
    environment = {"env_name": "Lift", "type": 1, "env_kwargs": {"control_freq": 50}}
    attributes: dict[str, Any] = {"data@env_args": json.dumps(environment)}
    for number in (0, 1, 10):
        _, angles, speeds, torques = joints(number)
        demo = f"data/demo_{number}"
        attributes[f"{demo}@num_samples"] = len(angles)
        arrays |= {
            f"{demo}/actions": angles + 1,
            f"{demo}/obs/robot0_joint_pos": angles,
            f"{demo}/obs/robot0_joint_vel": speeds,
            f"{demo}/obs/robot0_joint_torque": torques,
            f"{demo}/obs/agentview_image": np.zeros((len(angles), 4, 4, 3), "u1"),
        }
    write_hdf5(path, arrays, attributes)


def isaac_lab(path: Path) -> None:
    """As its recorder manager exports episodes."""
    environment = {"env_name": "Isaac-Lift", "type": 2, "sim_args": {"dt": 0.01, "decimation": 2}}
    _, angles, speeds, torques = joints()
    demo, robot = "data/demo_0", "articulation/robot"
    arrays = {
        f"{demo}/actions": angles + 1,
        f"{demo}/obs/joint_effort": torques,
        f"{demo}/states/{robot}/joint_position": angles,
        f"{demo}/states/{robot}/joint_velocity": speeds,
        f"{demo}/initial_state/{robot}/joint_position": angles[:1],
    }
    write_hdf5(path, arrays, {"data@env_args": json.dumps(environment)})


def aloha(path: Path) -> None:
    """An episode of ACT and ALOHA, which says no rate."""
    _, angles, speeds, torques = joints()
    arrays = {
        "observations/qpos": angles,
        "observations/qvel": speeds,
        "observations/effort": torques,
        "observations/images/top": np.zeros((len(angles), 4, 4, 3), "u1"),
        "action": angles + 1,
    }
    write_hdf5(path, arrays, {"@sim": False})


def _drop_table() -> Any:
    import pyarrow as pa

    times, places = drop()
    return pa.table({"t": times} | dict(zip("xyz", places.T, strict=True)))


def feather(path: Path) -> None:
    import pyarrow.feather

    pyarrow.feather.write_feather(_drop_table(), path)


def _arrow(kind: str, path: Path) -> None:
    import pyarrow as pa

    table = _drop_table()
    with getattr(pa.ipc, kind)(path, table.schema) as writer:
        writer.write_table(table, max_chunksize=100)


def arrow_stream(path: Path) -> None:
    _arrow("new_stream", path)


def tensors(path: Path) -> None:
    import torch

    times, places = drop()
    state = {"time": torch.tensor(times), "ball": torch.tensor(places, dtype=torch.float64)}
    torch.save({**state, "epoch": 3, "note": "red ball"}, path)


def rerun_points(path: Path) -> None:
    import rerun as rr

    times, places = drop()
    stream = rr.RecordingStream("lab")
    stream.save(path)
    index = rr.TimeColumn("time", duration=times)
    for entity, columns in (
        ("world/ball", rr.Points3D.columns(positions=places)),
        ("motor/load", rr.Scalars.columns(scalars=0 * times)),
    ):
        stream.send_columns(entity, indexes=[index], columns=columns)
    stream.flush()
    del stream


def write_ulog(path: Path, topics: Mapping[str, Mapping[str, Any]]) -> None:
    """Write topics; times are `timestamp` [µs], other fields floats, lists `NAME[N]`."""

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<H", len(body)) + kind + body

    data = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0) + message(b"B", bytes(40))
    for name, fields in topics.items():
        words = [f"{name}:uint64_t timestamp"]
        for field, values in fields.items():
            width = np.shape(values)[1:]
            if field != "timestamp":
                words.append(f"float{f'[{width[0]}]' if width else ''} {field}")
        data += message(b"F", (";".join(words) + ";").encode())
    for number, name in enumerate(topics):
        data += message(b"A", struct.pack("<BH", 0, number) + name.encode())
    for number, fields in enumerate(topics.values()):
        rest = [np.asarray(one, "<f4") for name, one in fields.items() if name != "timestamp"]
        for row, stamp in enumerate(np.asarray(fields["timestamp"])):
            body = struct.pack("<HQ", number, int(stamp))
            data += message(b"D", body + b"".join(one[row].tobytes() for one in rest))
    path.write_bytes(data)


def ulog(path: Path) -> None:
    """A ball that a motion capture system sends to an autopilot, and its battery."""
    times, places = drop()
    stamps = np.round(times * 1e6) + 5_000_000
    battery = {"timestamp": stamps[::10], "voltage_v": 0 * stamps[::10] + 12}
    ball = {"timestamp": stamps, "position": places}
    write_ulog(path, {"vehicle_mocap_odometry": ball, "battery_status": battery})


def _rows(arrays: Mapping[str, Any]) -> list[dict[str, Any]]:
    columns = {name: np.asarray(one).tolist() for name, one in arrays.items()}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]


def _table(arrays: Mapping[str, Any]) -> pd.DataFrame:
    return pd.DataFrame({name: np.asarray(one).tolist() for name, one in arrays.items()})


# By the name of the file that each of them writes: arrays by their names.
ARRAYS: dict[str, Callable[[Path, Mapping[str, Any]], object]] = {
    "a.npz": lambda path, arrays: np.savez(path, **arrays),
    "b.npz": lambda path, arrays: np.savez_compressed(path, **arrays),
    "a.mat": lambda path, arrays: scipy.io.savemat(path, dict(arrays)),
    "b.mat": lambda path, arrays: scipy.io.savemat(path, dict(arrays), do_compression=True),
    "c.mat": lambda path, arrays: scipy.io.savemat(path, dict(arrays), format="4"),
    "a.json": lambda path, arrays: path.write_text(
        json.dumps({name: np.asarray(one).tolist() for name, one in arrays.items()})),
    "b.json": lambda path, arrays: path.write_text(json.dumps(_rows(arrays))),
    "a.jsonl": lambda path, arrays: path.write_text("\n".join(map(json.dumps, _rows(arrays)))),
    "a.parquet": lambda path, arrays: _table(arrays).to_parquet(path),
    "a.csv": lambda path, arrays: _table(arrays).to_csv(path, index=False),
    "a.xlsx": lambda path, arrays: write_xlsx(
        path, {"S": [list(arrays), *_table(arrays).to_numpy().tolist()]}),
}  # fmt: skip
# Likewise: a drop, and the joints of an arm.
DROPS: dict[str, Callable[[Path], None]] = {
    "plain.h5": plain_hdf5, "table.h5": table_hdf5, "saved.mat": matlab_73, "drop.feather": feather,
    "drop.arrow": lambda path: _arrow("new_file", path), "drop.arrows": arrow_stream,
    "drop.pt": tensors, "drop.rrd": rerun_points, "drop.ulg": ulog,
}  # fmt: skip
ARMS: dict[str, Callable[[Path], None]] = {
    "robomimic.hdf5": robomimic, "isaac_lab.hdf5": isaac_lab, "aloha.hdf5": aloha,
}  # fmt: skip
