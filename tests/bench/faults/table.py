"""List some sixty faults as a careless engineer makes them, in three sets.

Each set was chosen from the source alone, before any test was looked at: six where values are
fitted, five to seven where logs are read and where they are written, four where a verdict is
passed. Of the sets the suite caught 13, 11 and 11 at first; tests were written for the rest.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

_CHANGE = re.compile("⟦(.*?)→(.*?)⟧", re.DOTALL)


@dataclass(frozen=True)
class Fault:
    """Small change that leaves the code running."""

    name: str  # what is wrong, in plain words
    file: str  # where
    tests: str  # that should notice, as `python -m tests.bench.faults --list` shows them
    change: str  # text that is there once, ⟦and a part of it→with what it becomes⟧

    @property
    def old(self) -> str:
        return _CHANGE.sub(lambda part: part[1], self.change)

    @property
    def new(self) -> str:
        return _CHANGE.sub(lambda part: part[2], self.change)

    @property
    def likely(self) -> list[str]:
        """Return the files of the tests, which are run before all others."""
        return [str(Path("tests", f"{name}.py")) for name in self.tests.split()]


# fmt: off
SETS: dict[str, tuple[Fault, ...]] = {
    "first": (
        Fault("through the air, a bounce comes down in the time that it went up",
              "recorders/simulators/ball.py", "recorders/test_engines",
              "lasted = (math.atan(reach) + math.⟦asinh→atan⟧(reach)) / math.sqrt(2.0 * "
              "self.drag)"),
        Fault("the interval of a smoothed track counts every sample as one of its own",
              "analysis/drop/bounce_posterior.py", "analysis/drop/test_positions_fit",
              "return seen / ⟦(self.scale**2 * self.factor)→self.scale**2⟧, likely"),
        Fault("the drag of a known ball goes with the fall time, not with its square",
              "analysis/drop/bounce_model.py",
              "analysis/drop/test_film",
              "height_m = GRAVITY_M_S2 * float(np.exp(⟦2 * →⟧unknowns[FALL])) / 2"),
        Fault("the error of the centre of mass has the mass's part with the wrong sign",
              "analysis/payload/torque_fit.py",
              "analysis/payload/test_torque_fit analysis/payload/test_payload",
              "np.concatenate([⟦-→⟧com_m[:, None], np.eye(3)], axis=1)"),
        Fault("a sample of an arm is fresh only if all of its joints changed",
              "analysis/payload/arm_log.py",
              "analysis/payload/test_arm_log analysis/payload/test_torque_fit",
              "changes = np.⟦any→all⟧(values[1:] != values[:-1], axis=1)"),
        Fault("the restitution of a simulated ball rises with the speed of an impact",
              "recorders/simulators/ball.py", "recorders/test_engines",
              "return np.clip(self.restitution * ratio**⟦-→⟧self.slope, 0.0, 1.0)"),
        Fault("a log whose data checksum is wrong is not taken for changed",
              "tunenet_logs/formats/mcap.py",
              "analysis/drop/test_doubts tunenet_logs/test_containers",
              "self.losses.append(Loss(what⟦, taints=self.unprotected→⟧))"),
        Fault("a chunk that a killed rosbag never closed is not read",
              "tunenet_logs/formats/rosbag1.py", "tunenet_logs/test_ros_bags",
              "if head.end > self.file.size⟦ or not head.data_bytes:  # cut, or never "
              "closed→:  # cut⟧"),
        Fault("a single missing message of a .db3 bag is not told",
              "tunenet_logs/formats/rosbag2.py", "tunenet_logs/test_ros_bags",
              "if last > seen ⟦→+ 1 ⟧and"),
        Fault("the decimals of a table's seconds are taken for nanoseconds",
              "tunenet_logs/formats/columns/cells.py",
              "tunenet_logs/test_table_times tunenet_logs/test_csv_table",
              'int(⟦(part or "").ljust(9, "0")→part or "0"⟧)'),
        Fault("a protobuf pose without a position is at 0, 0, 0",
              "tunenet_logs/formats/decoders.py", "tunenet_logs/test_encodings",
              "⟦            _check_present(getattr(message, name), inner)\n→⟧"),
        Fault("after a write that failed, the next one leaves a hole of zeros",
              "tunenet_logs/writing/owned_path.py",
              "tunenet_logs/test_writer",
              "⟦                os.lseek(self._descriptor, self.size_bytes, os.SEEK_SET)\n→⟧"),
        Fault("a full disk gives up the whole summary before the index of chunks",
              "tunenet_logs/writing/writer.py", "tunenet_logs/test_writer",
              "            record + ⟦self._ending(record, index, has_chunk_index=False),\n"
              "            record + bare_ending(zlib.crc32(record, "
              "self._file.crc32)→bare_ending(zlib.crc32(record, self._file.crc32)),\n"
              "            record + self._ending(record, index, has_chunk_index=False⟧),\n"),
        Fault("a recovered message has receipt and acquisition swapped",
              "tunenet_logs/copying.py", "tunenet_logs/test_info_and_check",
              "data, log_ns, publish_ns = bytes(record.data), record.⟦log_ns, "
              "record.publish_ns→publish_ns, record.log_ns⟧"),
        Fault("a message larger than the queue never passes",
              "recorders/session.py", "recorders/test_live",
              "return ⟦bool(self._items) and →⟧self._held_bytes + size_bytes > self._limit_bytes"),
        Fault("what a full disk never took is not counted as dropped",
              "tunenet_logs/writing/writer.py",
              "tunenet_logs/test_writer",
              "dropped = captured - self.⟦written→accepted⟧"),
        Fault("an interval is given although the cross-check disagrees",
              "analysis/experiment.py", "analysis/test_tuning analysis/drop/test_doubts",
              "if doubts⟦ or (self.cross_check is not None and not self.cross_check.agrees)→⟧:"),
        Fault("a drop that falls with too little gravity passes",
              "analysis/drop/checks.py", "analysis/test_checks analysis/drop/test_doubts",
              "off = 100 * ⟦(drop.gravity_m_s2 / standard - 1→max(drop.gravity_m_s2 / "
              "standard - 1, 0⟧)"),
        Fault("a ball's diameter in the picture is taken for its radius",
              "analysis/drop/checks.py", "analysis/test_checks analysis/drop/test_film",
              "radius = ⟦→2 * ⟧float(np.nanmedian(track.radius_px[film.used]))"),
        Fault("an arm's slow torques are hidden by its fast positions",
              "analysis/payload/checks.py", "analysis/test_checks analysis/payload/test_payload",
              "slow_hz = ⟦min→max⟧(log.position.rate_hz, log.effort.rate_hz)"),
    ),
    "second": (
        Fault("the speed of an impact is twice what it is",
              "analysis/drop/bounce_posterior.py", "analysis/drop/test_film",
              "unit_m_s = CALIBRATED.gravity_m_s2 * fall_s⟦ / 2→⟧"),
        Fault("torques that lag are compared with where the arm will be",
              "analysis/payload/torque_model.py", "analysis/payload/test_torque_fit",
              "self.motion.at(seconds ⟦-→+⟧ values[columns[0, first - 1]])"),
        Fault("torques in a gap of an arm's positions count",
              "analysis/payload/torque_model.py",
              "analysis/payload/test_arm_log analysis/payload/test_torque_fit",
              "keep = inside⟦ & (gaps[after - 1] < most_s)→⟧"),
        Fault("where a part of a film is selected, a mark's time is not counted from there",
              "analysis/tracking/frames.py",
              "analysis/tracking/test_ball_picker analysis/tracking/test_track",
              "return x / self.scale, y / self.scale, at_s⟦ - before_s→⟧"),
        Fault("a line goes through the shortest beginning that it explains, not the longest",
              "analysis/estimators/methods.py",
              "analysis/test_estimators",
              "np.flatnonzero((above <= values) & (values <= below))[⟦-1→0⟧]"),
        Fault("links that are fixed to each other have the products of inertia with the "
              "wrong sign",
              "recorders/simulators/arm/description.py", "recorders/test_arm_description",
              "(away @ away * np.eye(3) ⟦-→+⟧ np.outer(away, away))"),
        Fault("a WebP of the extended kind is taken for a pixel smaller than it is",
              "tunenet_logs/images.py", "tunenet_logs/test_images",
              'return tuple(⟦1 + →⟧int.from_bytes(body[at : at + 3], "little") for at in (4, 7))'),
        Fault("what a decoder makes up of a damaged video is taken for its pictures",
              "tunenet_logs/video.py", "recorders/test_devices",
              "made_up = ⟦picture.is_corrupt or (made_up and not picture.key_frame)→False⟧"),
        Fault("a bag's file 10 is read before its file 2",
              "tunenet_logs/formats/registry.py", "tunenet_logs/test_ros_bags",
              "return sorted(files, key=lambda file: ⟦(int(numbered[file][2]), "
              "file.name)→file.name⟧)"),
        Fault("a table's speeds in degrees a second are taken for radians",
              "tunenet_logs/formats/columns/names.py", "tunenet_logs/test_csv_table",
              '(word, *one): (("velocity",), ⟦math.pi / 180→1.0⟧)'),
        Fault("where the first header stamp is 0, none of them is believed",
              "tunenet_logs/timing/stamps.py",
              "tunenet_logs/test_clocks tunenet_logs/test_two_sources",
              "if np.count_nonzero(header_ns == 0) > ⟦1→0⟧:"),
        Fault("a network camera's picture is stamped when its last byte came",
              "recorders/camera/streams.py", "recorders/test_mjpeg_stream",
              "yield Part(⟦arrived_ns→self._arrived_ns⟧, data"),
        Fault("two pictures that came at once are recorded with one stamp",
              "recorders/camera/clock.py",
              "recorders/test_mjpeg_stream recorders/test_devices recorders/test_camera_time",
              "max(stamp_ns, self._last_arrival_ns⟦ + 1→⟧)"),
        Fault("an import loses what the log's notes say",
              "tunenet_logs/copying.py", "tunenet_logs/test_importing",
              'notes = {**⟦episode.info.notes, **→⟧said, "imported_from": path.name}'),
        Fault("on a disk that knows no nameless files, a new outcome takes another's place",
              "tunenet_logs/writing/owned_path.py", "tunenet_logs/test_outcome",
              "        ⟦rename_new(aside, →aside.replace(⟧path)\n"),
        Fault("the next attempt is how many outcomes there are, and one",
              "recorders/outcome.py", "recorders/test_outcome_cli",
              "number = 1 + ⟦max((other.attempt for other in earlier), default=0→len(earlier⟧)"),
        Fault("an offset that is far too negative is taken for usual",
              "analysis/payload/checks.py", "analysis/test_checks",
              "worst = max(usual, key=lambda term: ⟦abs(term.value)→term.value⟧ / term.prior_sd)"),
        Fault("results of a log with a dot in its name are called by what stands before the dot",
              "analysis/batch/logs.py", "analysis/batch/test_results",
              'name.removesuffix(ACTIVE_SUFFIX).⟦rsplit→split⟧(".", 1)[0]'),
        Fault("shots from a doubtful drop are counted among those whose drop was rejected",
              "analysis/campaign.py",
              "analysis/campaign/test_campaign",
              'return None if self.used is None else self.used.verdict ⟦!= "rejected→== "ok⟧"'),
        Fault("what was found beside the value is given an interval where the value has none",
              "analysis/experiment.py",
              "analysis/test_record analysis/drop/test_review analysis/payload/test_payload",
              "ends = ⟦None if intervals is None else →⟧tuple(map(tuple, "
              "extra.interval95.tolist()))"),
    ),
    "third": (
        Fault("how long flights last seems surer than it is: the errors of the impact "
              "between cancel",
              "analysis/drop/bounce_posterior.py", "analysis/drop/test_film",
              "slopes = np.array([ratio, ⟦-→⟧1 - ratio, 1.0]) / (second - first)"),
        Fault("the last sample of a burst stays as late as it came",
              "tunenet_logs/timing/arrivals.py", "tunenet_logs/test_clocks",
              "            return at⟦ + 1→⟧\n"),
        Fault("the second opinion forgets that a driver's torques have another sign",
              "analysis/payload/experiment.py", "analysis/payload/test_torque_fit",
              "residual = ⟦convention.sign * →⟧run.effort - empty_nm"),
        Fault("a ball that is twice in one place as it turns back is taken for a doubled picture",
              "analysis/tracking/track.py", "analysis/tracking/test_track",
              "repeats = ⟦[run for run in runs if _goes_on(places_px, *run)]→list(runs)⟧"),
        Fault("a plan does not see how near the lowest height is from which the ball passes",
              "analysis/planning.py", "analysis/test_planning",
              "room_m = ⟦min(height - ends[0], ends[1] - height)→ends[1] - height⟧"),
        Fault("friction at an impact is bounded by the push outward alone, not by the whole push",
              "recorders/simulators/shot.py", "recorders/test_bounce_shot",
              "friction * ⟦pushed→outward⟧)"),
        Fault("a place that is infinite is taken for a place",
              "tunenet_logs/signals.py", "tunenet_logs/test_two_sources",
              "known = ⟦np.isfinite→~np.isnan⟧(values)"),
        Fault("a thousand and more behind a comma, where decimals have points, is read as "
              "one and more",
              "tunenet_logs/formats/columns/cells.py", "tunenet_logs/test_csv_table",
              'return mark == self.separator⟦ or self.decimal not in ("", mark)→⟧'),
        Fault("a picture whose header stamp is not set is one of 1970",
              "tunenet_logs/media_messages.py", "tunenet_logs/test_images",
              "trusts_header ⟦and sample.stamp_ns →⟧else record.log_ns"),
        Fault("a JPEG that is decoded small is turned as its note asks, unlike the whole one",
              "tunenet_logs/images.py", "tunenet_logs/test_images",
              "np.frombuffer(data, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION⟦→ * "
              "(part == 1)⟧"),
        Fault("the rate of a channel counts an interval more than there are",
              "tunenet_logs/timing/stamps.py",
              "tunenet_logs/test_info_and_check tunenet_logs/test_clocks",
              "count = len(seconds)⟦ - 1→⟧"),
        Fault("a recording that a full disk cut replaces the whole one that was there",
              "tunenet_logs/writing/owned_path.py", "tunenet_logs/test_writer",
              "replaces = self._overwrite⟦ and not is_cut→⟧"),
        Fault("a second recorder takes the file that the first one writes",
              "tunenet_logs/writing/owned_path.py", "recorders/test_live",
              "        if lock is ⟦False→None⟧:\n"),
        Fault("a recorder does not notice that its file is gone",
              "tunenet_logs/writing/writer.py", "recorders/test_live",
              "⟦                self._look_after_the_file()\n→⟧"),
        Fault("the end of a log counts each topic's messages in its last chunk alone",
              "tunenet_logs/writing/writer.py", "tunenet_logs/test_writer",
              "self._counts[channel_id] = ⟦self._counts.get(channel_id, 0) + →⟧len(pairs) // 2"),
        Fault("a log whose pictures cannot be read to their end is found whole",
              "tunenet_logs/copying.py", "tunenet_logs/test_hostile",
              "            except LogError⟦ as error:\n"
              '                damage.append(f"{topic}: reading ends after {count} of '
              '{stated} pictures: {error}")→:\n                pass⟧\n'),
        Fault("an arm is refused because its gripper, which has none of its joints, spoke "
              "as well",
              "recorders/ros2/recording.py", "recorders/test_ros2",
              "if self._doubt is not None⟦ and not self.is_met→⟧:"),
        Fault("at a thousand samples a second, one that comes 2 ms late is told as a gap",
              "recorders/ros2/recording.py", "recorders/test_ros2",
              "longest_ns = ⟦max(2.5 * self._usual_ns(), 10_000_000→2.5 * self._usual_ns(⟧)"),
        Fault("the perspective by the ball's size has the wrong sign",
              "analysis/drop/checks.py", "analysis/drop/test_film",
              "perspective=float(⟦-→⟧found[1] - projection.perspective),"),
        Fault("the simulated curve lies a radius too low beside the observed one",
              "analysis/drop/motion.py", "analysis/drop/test_review",
              'heights_m = signal.values[:, 2] - rig["ball_diameter_m"]⟦ / 2→⟧'),
        Fault("shots of whose drop nothing is known count as shots after a rejected drop",
              "analysis/campaign.py", "analysis/campaign/test_campaign",
              '("drop rejected", 0.18, lambda one: one.is_accepted is ⟦False→not True⟧),'),
        Fault("a filmed bounce is taken to be as high as its restitution, not its square",
              "analysis/drop/checks.py", "analysis/test_checks",
              "clear.measured(restitution⟦**2→⟧ * span_px, max(clear"),
    ),
}
# fmt: on
