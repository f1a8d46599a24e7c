"""List twenty more faults, chosen as the first and the second were, in other places.

From the source alone, before any test was looked at: six where values are fitted, five where logs
are read, five where they are written, four where a verdict is passed. Of these the suite caught 11
at first; eight tests were written for the rest, and one was extended.
"""

from __future__ import annotations

from tests.bench.faults.fault import Fault

FITS = (
    Fault(
        "how long flights last seems surer than it is: the errors of the impact between cancel",
        "analysis/drop/bounce_posterior.py",
        "slopes = np.array([ratio, -1 - ratio, 1.0]) / (second - first)",
        "slopes = np.array([ratio, 1 - ratio, 1.0]) / (second - first)",
        ("tests/analysis/drop/test_film_fit.py",),
    ),
    Fault(
        "the last sample of a burst stays as late as it came",
        "tunenet_logs/timing/arrivals.py",
        "            return at + 1\n",
        "            return at\n",
        ("tests/tunenet_logs/test_late_stamps.py",),
    ),
    Fault(
        "the second opinion forgets that a driver's torques have another sign",
        "analysis/payload/experiment.py",
        "residual = convention.sign * run.effort - empty_nm",
        "residual = run.effort - empty_nm",
        ("tests/analysis/payload/test_torque_fit.py",),
    ),
    Fault(
        "a ball that is twice in one place as it turns back is taken for a doubled picture",
        "analysis/tracking/track.py",
        "repeats = [run for run in runs if _goes_on(places_px, *run)]",
        "repeats = list(runs)",
        ("tests/analysis/tracking/test_trouble.py",),
    ),
    Fault(
        "a plan does not see how near the lowest height is from which the ball passes",
        "analysis/planning.py",
        "room_m = min(height - ends[0], ends[1] - height)",
        "room_m = ends[1] - height",
        ("tests/analysis/planning/test_plan.py",),
    ),
    Fault(
        "friction at an impact is bounded by the push outward alone, not by the whole push",
        "recorders/simulators/shot.py",
        "friction * pushed)",
        "friction * outward)",
        ("tests/recorders/test_bounce_shot.py",),
    ),
)

READERS = (
    Fault(
        "a place that is infinite is taken for a place",
        "tunenet_logs/signals.py",
        "known = np.isfinite(values)",
        "known = ~np.isnan(values)",
        ("tests/tunenet_logs/test_collect.py",),
    ),
    Fault(
        "a thousand and more behind a comma, where decimals have points, is read as one and more",
        "tunenet_logs/formats/columns/cells.py",
        'return mark == self.separator or self.decimal not in ("", mark)',
        "return mark == self.separator",
        ("tests/tunenet_logs/test_csv_table.py",),
    ),
    Fault(
        "a picture whose header stamp is not set is one of 1970",
        "tunenet_logs/media_messages.py",
        "trusts_header and sample.stamp_ns else record.log_ns",
        "trusts_header else record.log_ns",
        ("tests/tunenet_logs/test_pictures.py",),
    ),
    Fault(
        "a JPEG that is decoded small is turned as its note asks, unlike the whole one",
        "tunenet_logs/images.py",
        "np.frombuffer(data, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION",
        "np.frombuffer(data, np.uint8), flag | cv2.IMREAD_IGNORE_ORIENTATION * (part == 1)",
        ("tests/tunenet_logs/test_images.py",),
    ),
    Fault(
        "the rate of a channel counts an interval more than there are",
        "tunenet_logs/timing/stamps.py",
        "count = len(seconds) - 1",
        "count = len(seconds)",
        ("tests/tunenet_logs/test_cli.py", "tests/tunenet_logs/test_measured_rate.py"),
    ),
)

WRITERS = (
    Fault(
        "a recording that a full disk cut replaces the whole one that was there",
        "tunenet_logs/writing/owned_path.py",
        "replaces = self._overwrite and not is_cut",
        "replaces = self._overwrite",
        ("tests/tunenet_logs/test_full_disk.py",),
    ),
    Fault(
        "a second recorder takes the file that the first one writes",
        "tunenet_logs/writing/owned_path.py",
        "        if lock is False:\n",
        "        if lock is None:\n",
        ("tests/recorders/test_ownership.py",),
    ),
    Fault(
        "a recorder does not notice that its file is gone",
        "tunenet_logs/writing/writer.py",
        "                self._look_after_the_file()\n",
        "",
        ("tests/recorders/test_ownership.py",),
    ),
    Fault(
        "the end of a log counts each topic's messages in its last chunk alone",
        "tunenet_logs/writing/writer.py",
        "self._counts[channel_id] = self._counts.get(channel_id, 0) + len(pairs) // 2",
        "self._counts[channel_id] = len(pairs) // 2",
        ("tests/tunenet_logs/test_mcap_output.py",),
    ),
    Fault(
        "a log whose pictures cannot be read to their end is found whole",
        "tunenet_logs/copying.py",
        "            except LogError as error:\n"
        '                damage.append(f"{topic}: reading ends after {count} of {stated} pictures: '
        '{error}")\n',
        "            except LogError:\n                pass\n",
        ("tests/tunenet_logs/test_hostile.py",),
    ),
    Fault(
        "an arm is refused because its gripper, which has none of its joints, spoke as well",
        "recorders/ros2/recording.py",
        "if self._doubt is not None and not self.is_met:",
        "if self._doubt is not None:",
        ("tests/recorders/test_ros2.py",),
    ),
    Fault(
        "at a thousand samples a second, one that comes 2 ms late is told as a gap",
        "recorders/ros2/recording.py",
        "longest_ns = max(2.5 * self._usual_ns(), 10_000_000)",
        "longest_ns = 2.5 * self._usual_ns()",
        ("tests/recorders/test_ros2_pace.py",),
    ),
)

VERDICTS = (
    Fault(
        "the perspective by the ball's size has the wrong sign",
        "analysis/drop/checks.py",
        "perspective=float(-found[1] - projection.perspective),",
        "perspective=float(found[1] - projection.perspective),",
        ("tests/analysis/drop/test_film_fit.py",),
    ),
    Fault(
        "the simulated curve lies a radius too low beside the observed one",
        "analysis/drop/motion.py",
        'heights_m = signal.values[:, 2] - rig["ball_diameter_m"] / 2',
        'heights_m = signal.values[:, 2] - rig["ball_diameter_m"]',
        ("tests/analysis/drop/test_review.py",),
    ),
    Fault(
        "shots of whose drop nothing is known count as shots after a rejected drop",
        "analysis/campaign.py",
        '("drop rejected", 0.18, lambda one: one.is_accepted is False),',
        '("drop rejected", 0.18, lambda one: one.is_accepted is not True),',
        ("tests/analysis/campaign/test_campaign.py",),
    ),
    Fault(
        "a filmed bounce is taken to be as high as its restitution, not its square",
        "analysis/drop/checks.py",
        "clear.measured(restitution**2 * span_px, max(clear",
        "clear.measured(restitution * span_px, max(clear",
        ("tests/analysis/drop/test_film.py",),
    ),
)

THIRD = (*FITS, *READERS, *WRITERS, *VERDICTS)
