"""List twenty more faults, chosen as the first were, in other files.

From the source alone, before any test was looked at: six where values are fitted, five where logs
are read, five where they are written, four where a verdict is passed. Of these the suite caught 11
at first; nine tests were written for the rest.
"""

from __future__ import annotations

from tests.bench.faults.fault import Fault

FITS = (
    Fault(
        "the speed of an impact is twice what it is",
        "analysis/drop/bounce_posterior.py",
        "unit_m_s = CALIBRATED.gravity_m_s2 * fall_s / 2",
        "unit_m_s = CALIBRATED.gravity_m_s2 * fall_s",
        ("tests/analysis/drop/test_film_fit.py",),
    ),
    Fault(
        "torques that lag are compared with where the arm will be",
        "analysis/payload/torque_model.py",
        "self.motion.at(seconds - values[columns[0, first - 1]])",
        "self.motion.at(seconds + values[columns[0, first - 1]])",
        ("tests/analysis/payload/test_torque_fit.py",),
    ),
    Fault(
        "torques in a gap of an arm's positions count",
        "analysis/payload/torque_model.py",
        "keep = inside & (gaps[after - 1] < most_s)",
        "keep = inside",
        ("tests/analysis/payload/test_arm_log.py", "tests/analysis/payload/test_torque_fit.py"),
    ),
    Fault(
        "where a part of a film is selected, a mark's time is not counted from there",
        "analysis/tracking/frames.py",
        "return x / self.scale, y / self.scale, at_s - before_s",
        "return x / self.scale, y / self.scale, at_s",
        ("tests/analysis/tracking/test_ball_picker.py", "tests/analysis/tracking/test_track.py"),
    ),
    Fault(
        "a line goes through the shortest beginning that it explains, not the longest",
        "analysis/estimators/methods.py",
        "np.flatnonzero((above <= values) & (values <= below))[-1]",
        "np.flatnonzero((above <= values) & (values <= below))[0]",
        (
            "tests/analysis/estimators/test_rollout_line.py",
            "tests/analysis/evaluation/motion/test_filmed_targets.py",
        ),
    ),
    Fault(
        "links that are fixed to each other have the products of inertia with the wrong sign",
        "recorders/simulators/arm/description.py",
        "(away @ away * np.eye(3) - np.outer(away, away))",
        "(away @ away * np.eye(3) + np.outer(away, away))",
        ("tests/recorders/test_arm_description.py",),
    ),
)

READERS = (
    Fault(
        "a WebP of the extended kind is taken for a pixel smaller than it is",
        "tunenet_logs/images.py",
        'return tuple(1 + int.from_bytes(body[at : at + 3], "little") for at in (4, 7))',
        'return tuple(int.from_bytes(body[at : at + 3], "little") for at in (4, 7))',
        ("tests/tunenet_logs/test_images.py",),
    ),
    Fault(
        "what a decoder makes up of a damaged video is taken for its pictures",
        "tunenet_logs/video.py",
        "made_up = picture.is_corrupt or (made_up and not picture.key_frame)",
        "made_up = False",
        ("tests/recorders/test_video_file.py",),
    ),
    Fault(
        "a bag's file 10 is read before its file 2",
        "tunenet_logs/formats/registry.py",
        "return sorted(files, key=lambda file: (int(numbered[file][2]), file.name))",
        "return sorted(files, key=lambda file: file.name)",
        ("tests/tunenet_logs/test_ros2_folder.py",),
    ),
    Fault(
        "a table's speeds in degrees a second are taken for radians",
        "tunenet_logs/formats/columns/names.py",
        '(word, *one): (("velocity",), math.pi / 180)',
        '(word, *one): (("velocity",), 1.0)',
        ("tests/tunenet_logs/test_csv_table.py",),
    ),
    Fault(
        "where the first header stamp is 0, none of them is believed",
        "tunenet_logs/timing/stamps.py",
        "if np.count_nonzero(header_ns == 0) > 1:",
        "if np.count_nonzero(header_ns == 0) > 0:",
        ("tests/tunenet_logs/test_stamps.py", "tests/tunenet_logs/test_collect.py"),
    ),
)

WRITERS = (
    Fault(
        "a network camera's picture is stamped when its last byte came",
        "recorders/camera/streams.py",
        "yield Part(arrived_ns, data",
        "yield Part(self._arrived_ns, data",
        ("tests/recorders/test_mjpeg_stream.py",),
    ),
    Fault(
        "two pictures that came at once are recorded with one stamp",
        "recorders/camera/clock.py",
        "max(stamp_ns, self._last_arrival_ns + 1)",
        "max(stamp_ns, self._last_arrival_ns)",
        (
            "tests/recorders/test_mjpeg_stream.py",
            "tests/recorders/test_device.py",
            "tests/recorders/test_camera_faults.py",
        ),
    ),
    Fault(
        "an import loses what the log's notes say",
        "tunenet_logs/copying.py",
        'notes = {**episode.info.notes, **said, "imported_from": path.name}',
        'notes = {**said, "imported_from": path.name}',
        ("tests/tunenet_logs/test_importing.py", "tests/tunenet_logs/test_ecosystem.py"),
    ),
    Fault(
        "on a disk that knows no nameless files, a new outcome takes another's place",
        "tunenet_logs/writing/owned_path.py",
        "        rename_new(aside, path)\n",
        "        aside.replace(path)\n",
        ("tests/tunenet_logs/test_outcome.py",),
    ),
    Fault(
        "the next attempt is how many outcomes there are, and one",
        "recorders/outcome.py",
        "number = 1 + max((other.attempt for other in earlier), default=0)",
        "number = 1 + len(earlier)",
        ("tests/recorders/test_outcome_cli.py",),
    ),
)

VERDICTS = (
    Fault(
        "an offset that is far too negative is taken for usual",
        "analysis/payload/checks.py",
        "worst = max(usual, key=lambda term: abs(term.value) / term.prior_sd)",
        "worst = max(usual, key=lambda term: term.value / term.prior_sd)",
        ("tests/analysis/payload/test_checks.py",),
    ),
    Fault(
        "results of a log with a dot in its name are called by what stands before the dot",
        "analysis/batch/logs.py",
        'name.removesuffix(ACTIVE_SUFFIX).rsplit(".", 1)[0]',
        'name.removesuffix(ACTIVE_SUFFIX).split(".", 1)[0]',
        ("tests/analysis/batch/test_results.py",),
    ),
    Fault(
        "shots from a doubtful drop are counted among those whose drop was rejected",
        "analysis/campaign.py",
        'return None if self.used is None else self.used.verdict != "rejected"',
        'return None if self.used is None else self.used.verdict == "ok"',
        ("tests/analysis/campaign/test_campaign.py", "tests/analysis/campaign/test_pairing.py"),
    ),
    Fault(
        "what was found beside the value is given an interval where the value has none",
        "analysis/experiment.py",
        "ends = None if intervals is None else tuple(map(tuple, extra.interval95.tolist()))",
        "ends = tuple(map(tuple, extra.interval95.tolist()))",
        (
            "tests/analysis/test_record.py",
            "tests/analysis/drop/test_bounces.py",
            "tests/analysis/payload/test_payload.py",
        ),
    ),
)

SECOND = (*FITS, *READERS, *WRITERS, *VERDICTS)
