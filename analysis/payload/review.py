"""Review of a payload: torques, the arm in 3D, the mass, and the nuisance terms.

The log's timeline shows the torques of all iterations and their residuals; the iterations'
timeline, what one iteration's payload adds to the empty arm's torques.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from tunenet_logs.analysis.experiment import Tuning
from tunenet_logs.analysis.payload.detection import EFFORT, PayloadDetection
from tunenet_logs.analysis.payload.torque_fit import Nuisance, PayloadFit
from tunenet_logs.analysis.presentation import quantity
from tunenet_logs.analysis.review import drawing as draw
from tunenet_logs.analysis.statistics import TWO_SIDED
from tunenet_logs.episode import Array, median_step
from tunenet_logs.recorders.simulators.arm.description import Arm, rotation_from_rpy
from tunenet_logs.recorders.simulators.arm.path import LinkPoses, link_poses
from tunenet_logs.recorders.simulators.arm.payload import PAYLOAD_MASS

# ---- Data that the review draws: torques over the log's time

_MAX_JOINTS = 8  # that are drawn, those that feel the payload most: more would be too small to read


@dataclass(frozen=True, eq=False)
class TorqueCurve:
    """Simulated torques of all joints, and how they are drawn."""

    name: str  # "k=3", "refined", "fit"
    label: str  # the same with its mass, for a legend
    color: draw.Color  # of the line
    width: float  # of the line [points]
    mass_kg: float  # that they were simulated with
    effort_nm: Array  # [N·m], shape (T, J)


@dataclass(frozen=True, eq=False)
class PayloadReviewData:
    """Torques of one tuning, and the motion that they drive."""

    arm: Arm  # without a payload
    seconds: Array  # since the log's first sample [s], shape (T,)
    position_rad: Array  # of the joints [rad], shape (T, J)
    # Torques with the joint's sign, the arm's weight included [N·m], shape (T, J).
    observed_nm: Array
    empty_nm: Array  # of the model with an empty gripper [N·m], shape (T, J)
    felt_nm_per_kg: Array  # RMS torque per kilogram at each joint [N·m/kg], shape (J,)
    used: NDArray[np.bool_]  # joints whose torques count, shape (J,)
    order: tuple[int, ...]  # joints that are drawn; those that feel the payload most first
    # Torques of the rigid model, one per iteration; the last is the result.
    simulated: tuple[TorqueCurve, ...]
    # Torques with friction, offsets and all that the fit finds; None without a fit.
    fitted: TorqueCurve | None
    fit: PayloadFit | None  # the fit itself; None without
    com_m: tuple[float, float, float]  # position of the payload in the tool frame [m]
    interval95: tuple[float, float] | None  # of the mass [kg]; None if no valid one exists
    has_estimate: bool  # whether there is a mass to report

    def title(self, joint: int, what: str = "") -> str:
        """Format a joint's number with the unit of its torque: "joint 2 [N·m]"."""
        return " ".join(filter(None, (f"joint {joint + 1}", what, f"[{self.unit(joint)}]")))

    def unit(self, joint: int) -> str:
        """Return the unit of a joint's torque, or of its force."""
        return "N" if self.arm.joints[joint].is_prismatic else "N·m"


def payload_review_data(tuning: Tuning) -> PayloadReviewData:
    """Collect the data from a tuning that found an arm's motion."""
    found: PayloadDetection = tuning.detection
    seconds = found.path.seconds
    kept = slice(None, None, draw.drawn_every(seconds))
    felt = np.sqrt(np.mean(found.simulator.efforts_nm_per_kg**2, axis=0))
    fit = tuning.trace.fit.detail if tuning.trace and tuning.trace.fit else None
    fitted = None
    if fit is not None:
        # As the observed torques are drawn: with the arm's weight in them.
        effort_nm = (fit.predicted_nm + found.effort_nm - fit.effort_nm)[kept]
        label = "result, with friction"
        fitted = TorqueCurve("fit", label, draw.RESULT, draw.BOLD, fit.held.mass_kg, effort_nm)
    steps = tuning.trace.steps if tuning.trace else ()
    simulated: list[TorqueCurve] = []
    for k, step in enumerate(steps):
        assert step.evaluation is not None
        is_last = k == len(steps) - 1
        name = "refined" if is_last and fit is not None else f"k={k}"
        mass_kg = float(step.values[0])
        simulated.append(
            TorqueCurve(
                name=name,
                label=f"{name}  {mass_kg:.4f} kg",
                # Warmest of all is the result: of a fit, the curve with friction.
                color=draw.ramp(k, len(steps) + (fit is not None)),
                width=draw.BOLD if is_last else draw.FINE,
                mass_kg=mass_kg,
                effort_nm=step.evaluation.episode.signals[EFFORT].values[kept],
            )
        )
    interval = tuning.interval95
    return PayloadReviewData(
        arm=found.arm,
        seconds=seconds[kept],
        position_rad=found.path.position_rad[kept],
        observed_nm=found.effort_nm[kept],
        empty_nm=found.simulator.empty_efforts_nm[kept],
        felt_nm_per_kg=felt,
        used=found.fit.used,
        order=tuple(np.argsort(-felt, kind="stable")[:_MAX_JOINTS].tolist()),
        simulated=tuple(simulated),
        fitted=fitted,
        fit=fit,
        com_m=found.simulator.com_m,
        interval95=None if interval is None else (float(interval[0, 0]), float(interval[0, 1])),
        has_estimate=tuning.estimate is not None,
    )


# ---- 3D scene of the arm along its measured path, with its payload

# Greys, so that the payload alone has a colour.
_ARM = (150, 156, 170)
_JOINT = (92, 98, 114)
# Radius of the fingers, in reaches of the arm as all sizes here: an arm of any size looks the same.
_FINGER = 0.010


def log_arm(stream: rr.RecordingStream, data: PayloadReviewData) -> rrb.View:
    """Log the ground, the arm in its poses, and its payload."""
    rate_hz = 1 / median_step(data.seconds)
    kept = slice(None, None, max(1, round(rate_hz / 30.0)))  # a screen shows few more poses
    seconds, poses = data.seconds[kept], link_poses(data.arm, data.position_rad[kept])
    steps = [joint.origin_m for joint in data.arm.joints] + [data.arm.tool_from_last_m]
    reach_m = max(sum(math.hypot(*step) for step in steps), 1e-3)
    stream.log("scene", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    tile, half = 0.3 * reach_m, 5 * 0.3 * reach_m / 2  # five tiles along each side of the ground
    at = [-half + tile * k for k in range(5 + 1)]
    lines = [[[x, -half, 0], [x, half, 0]] for x in at]
    lines += [[[-half, y, 0], [half, y, 0]] for y in at]
    grid = rr.LineStrips3D(lines, colors=[(52, 55, 64)], radii=draw.screen_radius(0.6))
    stream.log("scene/ground", grid, static=True)
    axes = rr.Arrows3D(
        vectors=0.28 * reach_m * np.eye(3),
        colors=((230, 90, 90), (110, 200, 110), (100, 150, 255)),  # x, y, z as usual
        radii=[0.006 * reach_m],
        labels=["x", "y", "z"],
        show_labels=True,
    )
    stream.log("scene/base_axes", axes, static=True)
    _log_links(stream, data.arm, reach_m)
    for frame in range(1, poses.position_m.shape[1]):
        columns = rr.Transform3D.columns(
            translation=poses.position_m[:, frame], mat3x3=poses.rotation[:, frame]
        )
        is_tool = frame == len(data.arm.joints) + 1
        entity = "scene/arm/tool" if is_tool else f"scene/arm/link_{frame}"
        index = rr.TimeColumn(draw.LOG_TIME, duration=seconds)
        stream.send_columns(entity, indexes=[index], columns=columns)
    if any(joint.is_prismatic for joint in data.arm.joints):
        # Log the connections of links with prismatic joints.
        strips = poses.position_m.astype(np.float32)
        style = rr.LineStrips3D.from_fields(colors=[_JOINT], radii=[_FINGER * reach_m])
        columns = rr.LineStrips3D.columns(strips=list(strips))
        draw.log_moving(stream, "scene/slides", style, seconds, columns)
    radius_m = payload_radius_m(data.simulated[-1].mass_kg, reach_m)
    # The mass stands above the ball, by a part of the reach.
    _log_payload(stream, data, seconds, poses, radius_m, radius_m + 0.055 * reach_m)
    return _view(poses, radius_m + 0.04 * reach_m)


def _view(poses: LinkPoses, margin_m: float) -> rrb.View:
    """Place the camera in front of the path so that all of the arm fits."""
    points = poses.position_m.reshape(-1, 3)
    # Along the normal of the plane that the tool moves in, turned aside and up.
    tool = poses.position_m[:, -1]
    outward = tool.mean(axis=0)[:2]
    normal = np.linalg.svd(tool - tool.mean(axis=0))[2][2] if len(tool) > 2 else np.zeros(3)
    flat = normal[:2]
    if np.linalg.norm(flat) < 0.3:  # too level: it is seen from the arm's side
        reaches = np.linalg.norm(outward) > 0
        flat = np.array([outward[1], -outward[0]]) if reaches else np.array([0.0, -1.0])
    if flat @ outward < 0:
        flat = -flat
    azimuth_rad = math.atan2(flat[1], flat[0]) + 0.85  # aside, where links hide each other less
    eye = draw.eye_and_target(points, azimuth_rad, margin_m)
    return draw.scene_view("the arm along its measured path", *eye)


def payload_radius_m(mass_kg: float, reach_m: float) -> float:
    """Return the radius of a ball of water of that mass, as the payload's density is unknown.

    In bounds: it can be seen, and does not hide the arm.
    """
    water_m = (3 * max(mass_kg, 0.0) / (4 * math.pi * 1000.0)) ** (1 / 3)
    return min(max(water_m, 0.018 * reach_m), 0.15 * reach_m)


def _log_links(stream: rr.RecordingStream, arm: Arm, reach_m: float) -> None:
    """Log each link from its own joint to the next one, in its own frame, and the gripper."""
    ends = [joint.origin_m for joint in arm.joints]
    radii = np.linspace(0.042, 0.026, len(ends) + 1) * reach_m
    stream.log("scene/arm/base", _capsules([((0, 0, 0), ends[0])], [radii[0]], _ARM), static=True)
    for number, radius in enumerate(radii[1:], start=1):
        entity = f"scene/arm/link_{number}"
        if number < len(ends):
            parts = [((0, 0, 0), ends[number])]
            stream.log(entity, _capsules(parts, [radius], _ARM), static=True)
        hinge = rr.Ellipsoids3D(
            half_sizes=[[1.25 * radius] * 3], colors=[_JOINT], fill_mode="solid"
        )
        stream.log(f"{entity}/joint", hinge, static=True)
        draw.log_labels(stream, f"{entity}/number", [[0, 0, 0]], [str(number)])
    tip = np.array(arm.tool_from_last_m)
    length = float(np.linalg.norm(tip))
    if length < 1e-3 * reach_m:
        return
    # The gripper: a palm and two fingers up to the tool frame, in the last link's.
    entity = f"scene/arm/link_{len(ends)}"
    axes = rotation_from_rpy(arm.tool_from_last_rpy)
    aside = next((axis for axis in axes.T[[1, 2]] if abs(axis @ tip) < 0.7 * length), axes[:, 0])
    aside = aside - (aside @ tip) / length**2 * tip
    aside *= 0.3 * length / np.linalg.norm(aside)
    # The palm is half of the way to the tool frame, the fingers are the rest.
    palm = 0.5 * tip
    stream.log(entity, _capsules([((0, 0, 0), palm)], [radii[-1]], _ARM), static=True)
    fingers = [(palm + side * aside, tip + side * aside) for side in (-1, 1)]
    bones = [(palm - aside, palm + aside), *fingers]
    widths = [_FINGER * reach_m] * len(bones)
    stream.log(f"{entity}/gripper", _capsules(bones, widths, (205, 208, 214)), static=True)


def _log_payload(
    stream: rr.RecordingStream,
    data: PayloadReviewData,
    seconds: Array,
    poses: LinkPoses,
    radius_m: float,
    label_m: float,
) -> None:
    """Log a ball in the tool frame, its mass `label_m` above it, and its path."""
    result, at_m = data.simulated[-1], np.array(data.com_m)
    color = draw.RESULT if data.has_estimate else draw.MUTED
    ball = rr.Ellipsoids3D(
        centers=[at_m], half_sizes=[[radius_m] * 3], colors=[color], fill_mode="solid"
    )
    stream.log("scene/arm/tool/payload", ball, static=True)
    centers = poses.position_m[:, -1] + poses.rotation[:, -1] @ at_m
    over = np.array([0.0, 0.0, label_m])
    style = rr.Points3D.from_fields(
        labels=[f"{result.mass_kg:.3f} kg" if data.has_estimate else "rejected"],
        colors=[color],
        radii=draw.screen_radius(0.1),
        show_labels=True,
    )
    columns = rr.Points3D.columns(positions=centers + over)
    draw.log_moving(stream, "scene/mass", style, seconds, columns)
    path = rr.LineStrips3D([centers], colors=[draw.MUTED], radii=draw.screen_radius(0.7))
    stream.log("scene/path", path, static=True)
    style = rr.LineStrips3D.from_fields(colors=[color], radii=draw.screen_radius(1.8))
    begins = np.searchsorted(seconds, seconds - 1.0)  # a second shows which way it moves
    trails = [centers[begin : end + 1] for end, begin in enumerate(begins)]
    draw.log_moving(stream, "scene/trail", style, seconds, rr.LineStrips3D.columns(strips=trails))


def _capsules(
    bones: Sequence[tuple[Sequence[float] | Array, Sequence[float] | Array]],
    radii: Sequence[float],
    color: tuple[int, int, int],
) -> rr.Capsules3D:
    """Build capsules between pairs of points [m]."""
    starts = np.array([start for start, _ in bones], np.float64)
    along = np.array([end for _, end in bones], np.float64) - starts
    turns: list[rr.Quaternion] = []  # the shortest from z to each
    for bone in along:
        length = float(np.linalg.norm(bone))
        turn = np.array([0.0, 0.0, 0.0, 1.0])
        if length and bone[2] <= -length * (1 - 1e-9):
            turn = np.array([1.0, 0.0, 0.0, 0.0])
        elif length:
            x, y, z = bone / length
            turn = np.array([-y, x, 0.0, 1 + z])
            turn = turn / np.linalg.norm(turn)
        turns.append(rr.Quaternion(xyzw=turn))
    return rr.Capsules3D(
        lengths=np.linalg.norm(along, axis=1),
        radii=radii,
        translations=starts,
        quaternions=turns,
        colors=[color],
        fill_mode="solid",
    )


# ---- Charts of the nuisance terms, and of how much each joint feels the payload

_CHART_HEADROOM = 1.1  # of a chart's axis, over the largest value
_BAR = 0.3  # half a bar's width, of the width that a joint has


# Of each kind of terms, one per joint or more: their names before the joint's number, the chart's
# title, and the scale from the fit's unit to the chart's.
_CHARTS = (
    (("offset of joint",), "offset by joint [N·m]", 1.0),
    (("viscous friction of joint",), "viscous friction by joint [N·m s/rad]", 1.0),
    (("dry friction of joint",), "dry friction by joint [N·m]", 1.0),
    (("gain of joint",), "gain error by joint [%]", 100.0),
    (("mass of link",), "link heavier than the model's [%]", 100.0),
    (
        ("centre x of link", "centre y of link", "centre z of link"),
        "link's centre off the model's, x y z [mm]",
        1000.0,
    ),
    (("drift of joint",), "drift of the zero since the tare [N·m]", 1.0),
)


def log_terms(stream: rr.RecordingStream, data: PayloadReviewData) -> list[rrb.View]:
    """Log a chart by joint of the torque per kilogram, and of each kind of term."""
    _log_felt(stream, data)
    felt = "what 1 kg does, dots: what is left [N·m]"
    if data.fitted is None:
        felt = "what 1 kg does to each joint [N·m]"
    views: list[rrb.View] = [draw.chart_view("felt", felt)]
    if data.fit is not None:
        # Describe what no chart shows.
        fit = data.fit
        whose = "the joint's own" if fit.convention.sign > 0 else "the load's (the sign is turned)"
        sentence = fit.identifiability[:1].upper() + fit.identifiability[1:]
        weight = "with" if fit.convention.has_gravity else "without"
        lines = [
            "Dots and bars: by the log, 95 %. Boxes: before it, 95 %.",
            f"The driver's torques are {whose}, {weight} the arm's weight in them; this leads by a "
            f"log evidence of {fit.convention_odds:.0f}.",
            f"{sentence}.",
        ]
        lags = [
            f"{term.name} {round(1000 * term.value)} ± {1000 * TWO_SIDED * term.sd:.0f} ms"
            for term in fit.nuisances
            if term.group == "lag"
        ]
        lines.append(f"Torques behind positions: {', '.join(lags)}.")
        lines.append(
            f"Standard deviation of the mass: {fit.held.sd_kg:.4f} kg; the least that such torques "
            f"allow: {fit.bound_kg:.4f} kg."
        )
        draw.log_words(stream, "terms", "\n\n".join(lines))
        views.append(rrb.TextDocumentView(origin="/terms", name="in words"))
    named = [
        (term.name.rpartition(" ")[0], term) for term in (data.fit.nuisances if data.fit else ())
    ]
    number = 0
    for endings, title, scale in _CHARTS:
        terms = [[term for name, term in named if name == ending] for ending in endings]
        if all(terms):
            _log_chart(stream, f"sheets/terms_{number}", scale, terms)
            views.append(draw.chart_view(f"terms_{number}", title))
            number += 1
    return views


def _log_chart(
    stream: rr.RecordingStream, sheet: str, scale: float, terms: list[list[Nuisance]]
) -> None:
    """Log each term with its 95 % interval over that of its prior."""
    numbers = [[(term.value, term.sd, term.prior_sd) for term in row] for row in terms]
    values, sds, priors = scale * np.moveaxis(np.array(numbers), -1, 0)
    ends = TWO_SIDED * np.array([-sds, sds]) + values
    reach = _CHART_HEADROOM * max(float(np.abs(ends).max()), TWO_SIDED * float(priors.max()), 1e-9)
    count = len(terms[0])
    x, marks = _joint_marks(count)
    rows = [(-0.5 - value / (2 * reach), f"{value:g}") for value in draw.ticks(-reach, reach, 3)]
    draw.log_grid(stream, sheet, draw.WIDTH, rows, marks)
    half = _BAR * draw.WIDTH / count
    boxes = rr.Boxes2D(
        centers=np.column_stack([x, np.full(count, -0.5)]),
        half_sizes=np.column_stack([np.full(count, half), TWO_SIDED * priors[0] / (2 * reach)]),
        colors=[(70, 74, 86)],  # a grey behind the values
        radii=draw.screen_radius(0.6),
    )
    stream.log(f"{sheet}/prior", boxes, static=True)
    aside = (np.arange(len(terms)) - (len(terms) - 1) / 2) * 2 * half / len(terms)
    across = (x + aside[:, None]).ravel()
    low, high = (-0.5 - ends / (2 * reach)).reshape(2, -1)
    cap = min(0.015, half / len(terms))
    strips = []
    for at, bottom, top in zip(across.tolist(), low.tolist(), high.tolist(), strict=True):
        strips.append([[at, bottom], [at, top]])
        strips += [[[at - cap, end], [at + cap, end]] for end in (bottom, top)]
    draw.log_strips(stream, f"{sheet}/intervals", strips, [draw.RESULT], 0.9)
    dots = np.column_stack([across, -0.5 - values.ravel() / (2 * reach)])
    size = 3.5 if len(terms) == 1 else 2.5
    draw.log_dots(stream, f"{sheet}/values", dots, [draw.RESULT], size, 40.0)


def _log_felt(stream: rr.RecordingStream, data: PayloadReviewData) -> None:
    """Log the torque per kilogram of each joint as bars, the fit's residual as dots."""
    felt = data.felt_nm_per_kg
    x, marks = _joint_marks(len(felt))
    top = _CHART_HEADROOM * max(float(felt.max()), 1e-9)
    rows = [(-value / top, f"{value:g}") for value in draw.ticks(0.0, top, 2)]
    draw.log_grid(stream, "sheets/felt", draw.WIDTH, rows, marks)
    half = _BAR * draw.WIDTH / len(felt)
    # A bar below a thousandth of the axis is none.
    bars = [
        (at - half, at + half, -value / top, 0.0)
        for at, value in zip(x, felt, strict=True)
        if value > 1e-3 * top
    ]
    color = draw.mixed(data.simulated[-1].color, 0.6)
    draw.log_filled(stream, "sheets/felt/values", bars, color, 10.0)
    if data.fitted is not None:
        rms_nm = np.sqrt(np.mean((data.fitted.effort_nm - data.observed_nm) ** 2, axis=0))
        dots = np.column_stack([x, -np.minimum(rms_nm / top, 1.0)])
        draw.log_dots(stream, "sheets/felt/left", dots, [draw.RESULT], 4.0, 40.0)


def _joint_marks(count: int) -> tuple[Array, list[tuple[float, str]]]:
    """Return positions across a chart, shape (J,), and the marks below."""
    x = (np.arange(count) + 0.5) / count * draw.WIDTH
    every = -(-count // 16)  # numbers of joints below a chart: more would overlap
    return x, [(float(x[index]), str(index + 1)) for index in range(0, count, every)]


# ---- Plots of the torques, sheets of one iteration, and the layout of all

# Joints that the first tab has room for, so that their axes have ticks; the others have a tab.
_PLAYED = 3


def log_payload(stream: rr.RecordingStream, tuning: Tuning) -> rrb.Container:
    """Log all views of a payload's review, and return their layout."""
    data = payload_review_data(tuning)
    masses_kg = [curve.mass_kg for curve in data.simulated]
    torques, residuals = _log_torques(stream, data)
    # Log the legend of the curves.
    entries: list[tuple[str, list[draw.Color]]] = [("observed", [draw.OBSERVED])]
    entries.append(("rigid arm, by iteration", [curve.color for curve in data.simulated]))
    if data.fitted is not None:
        entries.append((data.fitted.label, [data.fitted.color]))

    draw.log_key(stream, entries)

    def with_key(*views: rrb.View, columns: int, name: str = "") -> rrb.Container:
        key, grid = draw.key_view(len(entries)), rrb.Grid(*views, grid_columns=columns)
        return rrb.Vertical(key, grid, row_shares=draw.KEY_SHARES, name=name or None)

    arm = log_arm(stream, data)
    mass = draw.log_iterates(
        stream,
        f"{quantity('payload mass', PAYLOAD_MASS.unit)} by iteration",
        [curve.name for curve in data.simulated],
        masses_kg,
        [curve.color for curve in data.simulated],
        # With a span under .02 kg steps of a gram would look large.
        draw.span_of([*masses_kg, *(data.interval95 or ())], 0.02),
        data.interval95,
        float(data.seconds[0]),
    )
    # What the iteration's payload adds to the empty arm's torque, over the observed torque.
    sheets: list[rrb.View] = []
    for joint in data.order:
        empty = data.empty_nm[:, joint]
        observed = data.observed_nm[:, joint] - empty
        simulated = [curve.effort_nm[:, joint] - empty for curve in data.simulated]
        fitted = data.fitted and (data.fitted.effort_nm[:, joint] - empty, data.fitted.color)
        shown = np.concatenate([observed, *simulated, [0.0]])
        # With room for 5 % above and below; on a shorter axis noise would look like torque.
        reach = max(float(np.ptp(shown)), 0.5) * (1 + 2 * 0.05)
        low = float(shown.min() + shown.max() - reach) / 2
        draw.log_sheet(
            stream,
            f"sheets/torque_{joint + 1}",
            data.seconds,
            observed,
            np.column_stack(simulated),
            [curve.color for curve in data.simulated],
            (low, low + reach),
            fitted=fitted,
        )
        title = f"{data.title(joint)} beyond the empty arm"
        sheets.append(draw.chart_view(f"torque_{joint + 1}", title))
    words = [_words(data, k) for k in range(len(data.simulated))]
    step = draw.log_steps(stream, words, float(data.seconds[0]))
    terms = log_terms(stream, data)
    overlay = rrb.Horizontal(
        arm,
        with_key(*torques[:_PLAYED], columns=1),  # wide enough for ticks of time
        draw.result_view(),
        column_shares=[4, 6, 4.6],
        name=f"overlay (timeline {draw.LOG_TIME})",
    )
    scrub = rrb.Horizontal(
        rrb.Grid(*sheets, grid_columns=2 if len(sheets) > 3 else 1),
        rrb.Vertical(step, mass),
        column_shares=[5, 4],
        name=draw.SCRUB,
    )
    others = rrb.Grid(*terms, grid_columns=3, name="what else is in the torques")
    name = f"what is left (timeline {draw.LOG_TIME})"
    # Of three columns titles and ticks fit on a laptop's screen.
    tabs = [overlay, with_key(*residuals, columns=3, name=name), scrub, others]
    if len(torques) > _PLAYED:
        name = f"other joints (timeline {draw.LOG_TIME})"
        tabs.insert(1, with_key(*torques[_PLAYED:], columns=2, name=name))
    return rrb.Tabs(*tabs, active_tab=0)


def _log_torques(
    stream: rr.RecordingStream, data: PayloadReviewData
) -> tuple[list[rrb.View], list[rrb.View]]:
    """Log two charts per joint: observed torques with those of all iterations, and the residuals.

    A torque's axis fits the observed and the result; earlier iterates may run off. That of
    residuals has the scale of the result's of most joints.
    """
    # Of more samples, dots of the usual size would hide the lines.
    size = 1.0 if len(data.seconds) > 150 else 1.5
    curves = {"iterations": data.simulated}
    if data.fitted is not None:
        curves["fit"] = (data.fitted,)
    off = np.abs(data.simulated[-1].effort_nm - data.observed_nm)
    usual = np.quantile(off, 0.98, axis=0)  # or a spike would make the axis useless
    least = max(float(np.median(usual[data.used])), 0.05)
    begin_s, end_s = float(data.seconds[0]), float(data.seconds[-1])
    shown_s = (0.0 if 0 < begin_s < 0.1 * end_s else begin_s), end_s  # or the tick of 0 is cut
    best = data.fitted or data.simulated[-1]
    torques: list[rrb.View] = []
    residuals: list[rrb.View] = []
    for joint in data.order:
        torque, residual = f"torque/joint_{joint + 1}", f"residual/joint_{joint + 1}"
        observed = data.observed_nm[:, joint]
        for name, lines in curves.items():
            values = np.column_stack([line.effort_nm[:, joint] for line in lines])
            style = [(line.label, line.color, line.width) for line in lines]
            draw.log_lines(stream, f"{torque}/{name}", data.seconds, values, style)
            off_nm = values - observed[:, None]
            draw.log_lines(stream, f"{residual}/{name}", data.seconds, off_nm, style)
        dots = "observed", draw.OBSERVED, size
        draw.log_marks(stream, f"{torque}/observed", *dots, data.seconds, observed)
        own = {"rigid": data.simulated[-1], "fitted": data.fitted}
        both = {name: one.effort_nm[:, joint] for name, one in own.items() if one is not None}
        said = f"joint {joint + 1}", data.unit(joint)
        draw.log_signal(stream, joint, draw.ReviewedSignal(*said, data.seconds, observed, both))
        shown = np.concatenate([observed, best.effort_nm[:, joint]])
        low, high = float(shown.min()), float(shown.max())
        more = max(0.0, 2.0 - (high - low)) / 2  # less would make noise look like torque
        reach = 1.3 * max(float(usual[joint]), least)
        title = data.title(joint, "torque") + ("" if data.used[joint] else ", not used")
        span = draw.ticked(low - more, high + more)
        torques.append(draw.plot_view(torque, title, span, shown_s))
        title = data.title(joint, "simulated - observed")
        residuals.append(draw.plot_view(residual, title, draw.ticked(-reach, reach), shown_s))
    return torques, residuals


def _words(data: PayloadReviewData, k: int) -> str:
    """Describe an iteration: its mass, and the RMS residual of its torques."""
    curve = data.simulated[k]
    rms_nm = float(np.sqrt(np.mean((curve.effort_nm - data.observed_nm) ** 2)))
    lines = [
        f"# {curve.name}",
        f"payload mass **{curve.mass_kg:.4f} kg**",
        f"{rms_nm:.3f} N·m rms from the observed torques",
        "Dots: observed torques less the empty arm's. Thick line: what this payload adds to them.",
    ]
    if data.fitted is not None:
        rms_nm = float(np.sqrt(np.mean((data.fitted.effort_nm - data.observed_nm) ** 2)))
        lines.append(
            f"Thin line: the fit, with friction, offsets and all else; {rms_nm:.3f} N·m rms is "
            "left."
        )
    return "\n\n".join(lines)
