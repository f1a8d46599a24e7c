"""List twenty faults as a careless engineer makes them.

They were chosen from the source alone, before any test was looked at: six where values are fitted,
five where logs are read, five where they are written, four where a verdict is passed. Of these the
suite caught 13 at first; seven tests were written for the rest.
"""

from __future__ import annotations

from tests.bench.faults.fault import Fault

FITS = (
    Fault(
        "through the air, a bounce comes down in the time that it went up",
        "recorders/simulators/ball.py",
        "lasted = (math.atan(reach) + math.asinh(reach)) / math.sqrt(2.0 * self.drag)",
        "lasted = (math.atan(reach) + math.atan(reach)) / math.sqrt(2.0 * self.drag)",
        ("tests/recorders/test_bounce.py",),
    ),
    Fault(
        "the interval of a smoothed track counts every sample as one of its own",
        "analysis/drop/bounce_posterior.py",
        "return seen / (self.scale**2 * self.factor), likely",
        "return seen / self.scale**2, likely",
        ("tests/analysis/drop/test_positions_fit.py",),
    ),
    Fault(
        "the drag of a known ball goes with the fall time, not with its square",
        "analysis/drop/bounce_model.py",
        "height_m = GRAVITY_M_S2 * float(np.exp(2 * unknowns[FALL])) / 2",
        "height_m = GRAVITY_M_S2 * float(np.exp(unknowns[FALL])) / 2",
        ("tests/analysis/drop/test_film_fit.py", "tests/analysis/drop/test_film.py"),
    ),
    Fault(
        "the error of the centre of mass has the mass's part with the wrong sign",
        "analysis/payload/torque_fit.py",
        "np.concatenate([-com_m[:, None], np.eye(3)], axis=1)",
        "np.concatenate([com_m[:, None], np.eye(3)], axis=1)",
        ("tests/analysis/payload/test_torque_fit.py", "tests/analysis/payload/test_payload.py"),
    ),
    Fault(
        "a sample of an arm is fresh only if all of its joints changed",
        "analysis/payload/arm_log.py",
        "changes = np.any(values[1:] != values[:-1], axis=1)",
        "changes = np.all(values[1:] != values[:-1], axis=1)",
        ("tests/analysis/payload/test_arm_log.py", "tests/analysis/payload/test_rests.py"),
    ),
    Fault(
        "the restitution of a simulated ball rises with the speed of an impact",
        "recorders/simulators/ball.py",
        "return np.clip(self.restitution * ratio**-self.slope, 0.0, 1.0)",
        "return np.clip(self.restitution * ratio**self.slope, 0.0, 1.0)",
        ("tests/recorders/test_drop.py",),
    ),
)

READERS = (
    Fault(
        "a log whose data checksum is wrong is not taken for changed",
        "tunenet_logs/formats/mcap.py",
        "self.losses.append(Loss(what, taints=self.unprotected))",
        "self.losses.append(Loss(what))",
        ("tests/analysis/drop/test_doubts.py", "tests/tunenet_logs/test_reader.py"),
    ),
    Fault(
        "a chunk that a killed rosbag never closed is not read",
        "tunenet_logs/formats/rosbag1.py",
        "if head.end > self.file.size or not head.data_bytes:  # cut, or never closed",
        "if head.end > self.file.size:  # cut",
        ("tests/tunenet_logs/test_ros1_bag.py",),
    ),
    Fault(
        "a single missing message of a .db3 bag is not told",
        "tunenet_logs/formats/rosbag2.py",
        "if last > seen and",
        "if last > seen + 1 and",
        ("tests/tunenet_logs/test_ros2_db3.py",),
    ),
    Fault(
        "the decimals of a table's seconds are taken for nanoseconds",
        "tunenet_logs/formats/columns/cells.py",
        'int((part or "").ljust(9, "0"))',
        'int(part or "0")',
        ("tests/tunenet_logs/test_table_times.py", "tests/tunenet_logs/test_csv_table.py"),
    ),
    Fault(
        "a protobuf pose without a position is at 0, 0, 0",
        "tunenet_logs/formats/decoders.py",
        "            _check_present(getattr(message, name), inner)\n",
        "",
        ("tests/tunenet_logs/test_protobuf.py",),
    ),
)

WRITERS = (
    Fault(
        "after a write that failed, the next one leaves a hole of zeros",
        "tunenet_logs/writing/owned_path.py",
        "            os.lseek(self._descriptor, self.size_bytes, os.SEEK_SET)\n",
        "",
        ("tests/tunenet_logs/test_mcap_output.py", "tests/tunenet_logs/test_full_disk.py"),
    ),
    Fault(
        "a full disk gives up the whole summary before the index of chunks",
        "tunenet_logs/writing/writer.py",
        "            record + self._ending(record, index, has_chunk_index=False),\n"
        "            record + bare_ending(zlib.crc32(record, self._file.crc32)),\n",
        "            record + bare_ending(zlib.crc32(record, self._file.crc32)),\n"
        "            record + self._ending(record, index, has_chunk_index=False),\n",
        ("tests/tunenet_logs/test_mcap_output.py",),
    ),
    Fault(
        "a recovered message has receipt and acquisition swapped",
        "tunenet_logs/copying.py",
        "data, log_ns, publish_ns = bytes(record.data), record.log_ns, record.publish_ns",
        "data, log_ns, publish_ns = bytes(record.data), record.publish_ns, record.log_ns",
        ("tests/tunenet_logs/test_recovery.py",),
    ),
    Fault(
        "a message larger than the queue never passes",
        "recorders/session.py",
        "return bool(self._items) and self._held_bytes + size_bytes > self._limit_bytes",
        "return self._held_bytes + size_bytes > self._limit_bytes",
        ("tests/recorders/test_live.py",),
    ),
    Fault(
        "what a full disk never took is not counted as dropped",
        "tunenet_logs/writing/writer.py",
        "dropped = captured - self.written",
        "dropped = captured - self.accepted",
        ("tests/tunenet_logs/test_full_disk.py", "tests/tunenet_logs/test_writer.py"),
    ),
)

VERDICTS = (
    Fault(
        "an interval is given although the cross-check disagrees",
        "analysis/experiment.py",
        "if doubts or (self.cross_check is not None and not self.cross_check.agrees):",
        "if doubts:",
        ("tests/analysis/test_tuning.py", "tests/analysis/drop/test_doubts.py"),
    ),
    Fault(
        "a drop that falls with too little gravity passes",
        "analysis/drop/checks.py",
        "off = 100 * (drop.gravity_m_s2 / standard - 1)",
        "off = 100 * max(drop.gravity_m_s2 / standard - 1, 0)",
        ("tests/analysis/drop/test_doubts.py", "tests/analysis/test_tuning.py"),
    ),
    Fault(
        "a ball's diameter in the picture is taken for its radius",
        "analysis/drop/checks.py",
        "radius = float(np.nanmedian(track.radius_px[film.used]))",
        "radius = 2 * float(np.nanmedian(track.radius_px[film.used]))",
        ("tests/analysis/drop/test_film.py", "tests/analysis/drop/test_film_fit.py"),
    ),
    Fault(
        "an arm's slow torques are hidden by its fast positions",
        "analysis/payload/checks.py",
        "slow_hz = min(log.position.rate_hz, log.effort.rate_hz)",
        "slow_hz = max(log.position.rate_hz, log.effort.rate_hz)",
        ("tests/analysis/payload/test_checks.py", "tests/analysis/payload/test_payload.py"),
    ),
)

FIRST = (*FITS, *READERS, *WRITERS, *VERDICTS)
