"""Identify an arm's payload from its torques: mass, centre of mass, inertia, with intervals.

Torques are linear in the payload. Nuisance terms make it hard: friction, offsets, gains, a lag,
link masses other than the model's, a base that is not level. They are fitted too, with priors
whose scale the log decides on (`noise.py`), and with runs of the empty gripper (tares) that
have all of them but the payload.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import log_ndtr

from tunenet_logs.analysis.payload.noise import (
    Noises,
    NormalEquations,
    TermPosterior,
    averaged,
    estimated,
    likeliest_scales,
    posterior,
    scaled,
    unknown,
    without,
)
from tunenet_logs.analysis.payload.torque_model import (
    CENTRE,
    CONVENTIONS,
    GAIN,
    INERTIA,
    MASS,
    NOT_SIMULATED,
    OWN_TERMS,
    PAYLOAD_TERMS,
    ArmModel,
    ArmMotion,
    Convention,
    Linearization,
    LoggedArm,
    Terms,
    make_terms,
    moments,
    torque_scales_nm,
)
from tunenet_logs.analysis.statistics import TWO_SIDED
from tunenet_logs.episode import Array
from tunenet_logs.recorders.simulators.arm.description import PAYLOAD_RADIUS_M, Arm

# ---- Physically consistent payload from the fitted terms
# They are those of some distribution of mass: the pseudo-inertia matrix is positive semidefinite
# (Wensing, Kim and Slotine 2018). Such bodies are a convex set: the mean of sampled ones is one.

Three = tuple[float, float, float]
Pair = tuple[float, float]
MIN_MASS_KG = 0.05  # below which a payload has no centre of mass that torques show
# Of each axis of a centre of mass: its interval is then narrower than a hand.
_IDENTIFIABLE_SD_M = 0.012
# Bodies that are drawn, and how many of them there must be.
_DRAWS, _MIN_DRAWS, _SEED = 4000, 200, 17


@dataclass(frozen=True)
class Centre:
    """Centre of mass of the payload in the tool frame."""

    com_m: Three  # x, y, z [m]
    sds_m: Three  # standard deviation of each [m]
    mass_kg: float  # that it is the centre of
    # error of a mass that is fitted with the centre in the tool frame, per metre that the centre
    # is off along x, y, z
    kg_for_m: Three

    @property
    def is_identifiable(self) -> bool:
        """Whether the log identifies it beside the mass."""
        return max(self.sds_m) < _IDENTIFIABLE_SD_M and self.mass_kg > MIN_MASS_KG

    @property
    def likely_m(self) -> Three:
        """Centre of mass for a simulation: the tool frame's origin if this one cannot be."""
        # No hand holds a thing by a point half a metre away.
        can_be = self.mass_kg > MIN_MASS_KG and max(map(abs, self.com_m)) < 0.5
        return self.com_m if can_be else (0.0, 0.0, 0.0)

    @property
    def loose(self) -> tuple[str, ...]:
        """Axes along which it is not identifiable, with their standard deviations."""
        return tuple(
            f"{axis} (sd {1000 * sd:.0f} mm)"
            for axis, sd in zip("xyz", self.sds_m, strict=True)
            if sd >= _IDENTIFIABLE_SD_M
        )

    @property
    def interval95(self) -> tuple[Pair, ...]:
        """Lower and upper end of each axis [m]."""
        pairs = zip(self.com_m, self.sds_m, strict=True)
        return tuple((mean - TWO_SIDED * sd, mean + TWO_SIDED * sd) for mean, sd in pairs)


@dataclass(frozen=True)
class Inertia:
    """Moments of inertia about the centre of mass, along the tool frame's axes."""

    kg_m2: tuple[float, ...]  # xx, xy, yy, xz, yz, zz
    interval95: tuple[Pair, ...]  # of each


@dataclass(frozen=True)
class Held:
    """Payload of the arm."""

    mass_kg: float  # 0 or more
    interval95: Pair  # of the mass [kg]; from 0 if it is not significant
    signed_kg: float  # mass as fitted, which may be below 0
    sd_kg: float  # its standard deviation
    centre: Centre  # of mass, whether identifiable or not
    inertia: Inertia | None  # None if unidentifiable


def held(means: Array, covariance: Array) -> Held:
    """Build a payload from the Gaussian posterior of its terms, shapes (10,) and (10, 10)."""
    signed_kg, sd_kg = float(means[MASS]), float(np.sqrt(covariance[MASS, MASS]))
    # Divide first moments by the mass, with first-order error propagation.
    mass_kg = max(float(means[MASS]), MIN_MASS_KG)
    com_m = means[CENTRE] / mass_kg
    # The error of a quotient to first order: its Jacobian by mass and first moments.
    to_com = np.concatenate([-com_m[:, None], np.eye(3)], axis=1) / mass_kg
    own = covariance[: CENTRE.stop, : CENTRE.stop]
    sds_m = np.sqrt(np.diag(to_com @ own @ to_com.T))
    precision = np.linalg.inv(own)
    kg_for_m = precision[MASS, CENTRE] / precision[MASS, MASS] * mass_kg
    x, y, z = com_m.tolist()
    sd_x, sd_y, sd_z = sds_m.tolist()
    kg_x, kg_y, kg_z = kg_for_m.tolist()
    centre = Centre((x, y, z), (sd_x, sd_y, sd_z), float(means[MASS]), (kg_x, kg_y, kg_z))
    inertia = _inertia(means, covariance) if centre.is_identifiable else None
    # The 95 % interval of a Gaussian, truncated at 0 if its mean is hardly above.
    from scipy.special import ndtr, ndtri

    if signed_kg > TWO_SIDED * sd_kg:
        interval95 = signed_kg - TWO_SIDED * sd_kg, signed_kg + TWO_SIDED * sd_kg
    else:
        above = float(ndtr(signed_kg / sd_kg))
        # Far below 0, the part above it is an exponential's: the quantile by its tail.
        end = signed_kg - sd_kg * float(ndtri(0.05 * above))
        interval95 = 0.0, end
    return Held(max(signed_kg, 0.0), interval95, signed_kg, sd_kg, centre, inertia)


def _inertia(means: Array, covariance: Array) -> Inertia | None:
    """Average sampled inertias with a positive semidefinite pseudo-inertia."""
    rng = np.random.default_rng(_SEED)
    drawn = rng.multivariate_normal(means, covariance, _DRAWS, method="eigh")
    tensors = np.einsum("nk,kij->nij", drawn[:, INERTIA], np.stack(moments()))
    tensors += 0.4 * PAYLOAD_RADIUS_M**2 * drawn[:, MASS, None, None] * np.eye(3)
    masses, firsts = drawn[:, MASS], drawn[:, CENTRE]
    pseudo = np.zeros((_DRAWS, 4, 4))
    traces = np.trace(tensors, axis1=1, axis2=2)
    pseudo[:, :3, :3] = 0.5 * traces[:, None, None] * np.eye(3) - tensors
    pseudo[:, :3, 3] = pseudo[:, 3, :3] = firsts
    pseudo[:, 3, 3] = masses
    there = np.linalg.eigvalsh(pseudo)[:, 0] >= 0
    if np.count_nonzero(there) < _MIN_DRAWS:
        return None
    masses, firsts = masses[there, None, None], firsts[there]
    about = np.einsum("ni,ni->n", firsts, firsts)[:, None, None] * np.eye(3)
    own = tensors[there] - (about - np.einsum("ni,nj->nij", firsts, firsts)) / masses
    rows = own[:, *np.tril_indices(3)]
    # Standard deviation of a moment of inertia, by the largest one: with more it is
    # unidentifiable
    if np.std(rows, axis=0).max() > 0.2 * np.abs(np.mean(rows, axis=0)).max():
        return None
    lows, highs = np.quantile(rows, (0.025, 0.975), axis=0)
    return Inertia(
        tuple(np.mean(rows, axis=0).tolist()),
        tuple(zip(lows.tolist(), highs.tolist(), strict=True)),
    )


# ---- Result of a fit of an arm's torques: the payload, and all nuisance terms


@dataclass(frozen=True)
class Nuisance:
    """One nuisance term."""

    name: str  # in words
    group: str  # that it is scaled with (`make_terms`)
    value: float  # its mean [N·m, N·m for each rad/s or rad/s², m, rad, s, or a fraction]
    sd: float  # standard deviation, in the same unit
    prior_sd: float  # of its prior about 0 at scale 1, in the same unit


@dataclass(frozen=True, eq=False)
class FitResidual:
    """Residual of a fit to the torques of one run."""

    # measured less predicted, of the joints that were fitted [N·m], shape (T, U)
    residual_nm: Array
    effort_nm: Array  # as measured, of the same [N·m], shape (T, U)
    scales_nm: Array  # rated torque of these joints [N·m], shape (U,)


@dataclass(frozen=True, eq=False)
class PayloadFit:
    """Fit of the payload and all nuisance terms."""

    held: Held  # mass, centre of mass and inertia
    convention: Convention  # sign of the torques, and whether gravity is included
    # log evidence (natural) by which it leads the next one; below 0 if the log speaks for one
    # that the user excluded
    convention_odds: float
    arm_odds: float  # log evidence over a model without an arm
    nuisances: tuple[Nuisance, ...]  # all other terms
    bound_kg: float  # cramér-Rao bound of the mass's standard deviation, under the likeliest scales
    scales: Mapping[str, float]  # of each group of terms, relative to its usual size
    scales_nm: Array  # rated torque of each joint [N·m], shape (J,)
    seconds: Array  # of the torques [s], shape (T,)
    effort_nm: Array  # as measured, with the joint's sign [N·m], shape (T, J)
    predicted_nm: Array  # by the fit [N·m], shape (T, J)
    used: NDArray[np.bool_]  # joints that were fitted, shape (J,)
    lag_s: float  # of the torques behind the positions [s]
    tare_residuals: tuple[FitResidual, ...]  # of the empty runs' torques
    # what all runs identify of the arm's own terms (`Terms.arms`), for later logs
    learnt: NormalEquations

    @property
    def residual_nm(self) -> Array:
        """Residual, measured less predicted [N·m], shape (T, J)."""
        return self.effort_nm - self.predicted_nm

    @property
    def residual(self) -> FitResidual:
        """Residual of the joints that were fitted."""
        used = self.used
        return FitResidual(self.residual_nm[:, used], self.effort_nm[:, used], self.scales_nm[used])

    @property
    def identifiability(self) -> str:
        """Whether mass, centre of mass and inertia are identifiable, in a sentence."""
        centre = self.held.centre
        if centre.is_identifiable:
            spread = ", ".join(f"{1000 * sd:.1f}" for sd in centre.sds_m)
            told = f"mass and centre of mass are separated (sd of the centre: {spread} mm)"
            if self.held.inertia:
                return f"{told}, and its inertia"
            return f"{told}; its inertia needs faster turns of the hand, there and back in a second"
        if centre.mass_kg <= MIN_MASS_KG:
            return "the payload is too light for its centre of mass to show"
        most_g = 10 * max(abs(kg_for_m) for kg_for_m in centre.kg_for_m)
        remedy = "turn the hand by 90° about two axes in the motion (the last three joints)"
        if not self.tare_residuals:
            remedy = f"record the empty gripper too (--tare), and {remedy}"
        return (
            f"the log cannot separate the payload's mass from its centre along "
            f"{', '.join(centre.loose)}: 1 cm off the tool frame is {most_g:.0f} g; {remedy}"
        )


# ---- Difference and mean of a log and a tare along one path, which separate unmodelled effects
# Ripple, hoses and other unmodelled effects depend on the arm's configuration. Of two runs in the
# same places at the same times, such effects are in the mean alone, not in the difference.

_OVERLAP = 0.9  # of the log that a tare along its path covers at least
# Of the search for the time by which the one began later: positions a second, shifts that are
# tried, and how often the step between them is halved then.
_COARSE_HZ, _MAX_SHIFTS, _HALVINGS = 20.0, 400, 12
_DRIFTS, _LAG = slice(-2, None), -OWN_TERMS - 3  # columns of a run's own terms


@dataclass(frozen=True, eq=False)
class TorqueRows:
    """Least-squares rows of a series of torques."""

    seconds: Array  # [s], shape (T,)
    left_nm: Array  # residual at the linearisation point, shape (T, J)
    columns: NDArray[np.int64]  # terms that each joint's slopes are by, shape (J, C)
    slopes: Array  # shape (T, J, C)
    own: NDArray[np.int64]  # which of those columns belong to a joint alone
    used: NDArray[np.bool_]  # joints that count, shape (J,)

    def after_nm(self, change: Array) -> Array:
        """Return the residual, (T, J), after the terms have changed by `change`, shape (N,)."""
        return self.left_nm - np.einsum("tjc,jc->tj", self.slopes, change[self.columns])


def rows_of(
    runs: Sequence[LoggedArm], lines: Sequence[Linearization], convention: Convention
) -> list[TorqueRows]:
    """Build the rows of each run; of a log and a tare along it, their difference and mean."""
    rows = [
        TorqueRows(
            run.motion.seconds,
            run.torques_nm(convention) - line.predicted_nm,
            line.columns,
            line.slopes,
            np.arange(line.columns.shape[1])[-OWN_TERMS - 2 :],
            run.motion.used,
        )
        for run, line in zip(runs, lines, strict=True)
    ]
    beside = next((run for run in runs if run.covered is not None), None)
    if beside is None:
        return rows
    log, tare, inside = rows[0], rows.pop(beside.run), beside.covered
    lags, drifts = tare.columns[:, _LAG, None], tare.columns[:, _DRIFTS]
    columns = np.hstack([log.columns, lags, drifts])
    alone = np.concatenate([tare.slopes[..., _LAG, None], tare.slopes[..., _DRIFTS]], axis=-1)
    shared = tare.slopes.copy()
    shared[..., _LAG] = 0.0
    shared[..., _DRIFTS] = 0.0
    own = np.append(log.own, len(columns[0]) + np.array([-2, -1]))
    used = log.used & tare.used
    pair = []
    for of_log, of_tare, counted in ((1.0, -1.0, own[-4:]), (0.5, 0.5, own)):
        slopes = of_log * log.slopes + of_tare * shared
        both = np.concatenate([slopes, of_tare * alone], axis=-1)
        left_nm = of_log * log.left_nm + of_tare * tare.left_nm
        seconds = log.seconds[inside]
        pair.append(TorqueRows(seconds, left_nm[inside], columns, both[inside], counted, used))
    rows[0] = pair[0]
    rows.insert(1, pair[1])
    return rows


def along(motion: ArmMotion, tare: ArmMotion) -> tuple[ArmMotion, NDArray[np.bool_]] | None:
    """Resample a tare at the log's own times, and say which it covers; None if elsewhere."""
    seconds = motion.seconds
    length_s = float(seconds[-1] - seconds[0])
    step_s = 1 / _COARSE_HZ
    grid = np.arange(seconds[0], seconds[-1], max(step_s, length_s / 500))
    where = motion.spline(grid)
    first, last = float(tare.seconds[0]), float(tare.seconds[-1])
    slack_s = (1 - _OVERLAP) * length_s
    low, high = first - seconds[0] - slack_s, last - seconds[-1] + slack_s
    if high < low:
        return None

    def off(shift: float) -> tuple[float, float]:
        at = grid + shift
        inside = (at >= first) & (at <= last)
        if np.mean(inside) < _OVERLAP:
            return np.inf, np.inf
        away = np.abs(where[inside] - tare.spline(at[inside]))
        return float(np.sqrt(np.mean(away**2))), float(away.max())

    count = int(min(np.ceil((high - low) / step_s) + 1, _MAX_SHIFTS))
    shifts = np.linspace(low, high, count)
    best = min(shifts.tolist(), key=off)
    step = float(shifts[1] - shifts[0]) if count > 1 else step_s
    for _ in range(_HALVINGS):
        step /= 2
        best = min((best - step, best, best + step), key=off)
    rms, worst = off(best)
    # Root mean square and greatest distance of two runs along one path: how a controller repeats
    # [rad]
    if rms > 0.01 or worst > 0.05:
        return None
    at = seconds + best
    inside = (at >= first) & (at <= last)
    effort = np.column_stack([np.interp(at, tare.seconds, column) for column in tare.effort.T])
    return replace(tare, seconds=at, effort=effort), inside


# ---- Gauss-Newton over all terms at once: their values, their prior scales, and the noise


# Noise before anything is fitted, and of the best sensor, by what a joint is built for.
_START_SHARE, _MIN_SHARE = 0.02, 2e-5


@dataclass(frozen=True, eq=False)
class GaussNewton:
    """Gauss-Newton iterate of all terms."""

    runs: tuple[LoggedArm, ...]  # the log and its tares
    terms: Terms  # the unknowns
    convention: Convention  # the driver's torque convention
    # prior information on the arm, about terms of 0; None for nothing
    known: NormalEquations | None
    noises: tuple[Noises, ...]  # of each series of rows (`rows_of`) and joint
    found: TermPosterior  # posterior of the terms
    logs: Mapping[str, float] = field(default_factory=dict)  # logarithms of the scale of each group
    log_evidence: float = -np.inf  # up to a constant that all models of these runs share

    @classmethod
    def start(
        cls,
        runs: tuple[LoggedArm, ...],
        convention: Convention,
        known: NormalEquations | None = None,
    ) -> GaussNewton:
        """Start with all terms at 0, the mean of their priors."""
        terms = runs[0].terms
        beside = next((run.covered for run in runs if run.covered is not None), None)
        log_s = runs[0].motion.seconds
        paired = [log_s[beside]] * 2 if beside is not None else [log_s]
        others = [run.motion.seconds for run in runs[1:] if run.covered is None]
        noises = tuple(
            tuple(unknown(seconds, _START_SHARE * scale) for scale in terms.scales_nm.tolist())
            for seconds in (*paired, *others)
        )
        sds = terms.sds
        nothing = TermPosterior(np.zeros(len(sds)), np.diag(sds), sds, -np.inf)
        return cls(runs, terms, convention, known, noises, nothing)

    def fitted(self, rows: Sequence[TorqueRows], at: Array, *, roughly: bool) -> GaussNewton:
        """Solve linear models for the terms, their groups' scales, then the noise of the residual.

        `at` (N,).
        """
        normal = self.normal_equations(rows, at)
        searched = self.groups
        if roughly:
            del searched["offset"]
        # The search for scales goes on where the last one ended. With 3 steps it stood still for
        # some, and a wrong convention looked likelier by 130.
        logs = likeliest_scales(normal, self._sds, searched, self.logs, 12)
        # With this logarithm of its scale an offset explains any constant torque.
        logs["offset"] = 2.5 if roughly else logs["offset"]
        sds = scaled(self._sds, self.groups, logs)
        found = posterior(normal, sds)
        told = 1 - found.variances / np.maximum(sds, 1e-150) ** 2
        # A mass is 0 or more: its prior is half a normal one.
        mass_sds = float(found.means[MASS]) / float(np.sqrt(found.variances[MASS]))
        evidence = found.log_evidence + float(log_ndtr(mass_sds))
        for own, series in zip(self.noises, rows, strict=True):
            target = series.after_nm(-at)
            for joint in np.flatnonzero(series.used).tolist():
                evidence += own[joint].log_likelihood(target[:, joint])
        means = found.means.copy()
        # Torques are linear in lags [s], tilts and encoders' zeros [rad] only while they are small.
        for name in ("lag", "tilt", "zeros"):
            indices, most = self.terms.of[name], 0.2
            means[indices] = np.clip(means[indices], -most, most)
        found = replace(found, means=means)
        least_nm = _MIN_SHARE * self.terms.scales_nm
        noises: list[Noises] = []
        for own, series in zip(self.noises, rows, strict=True):
            residual_nm = series.after_nm(found.means - at)
            fitted = told[series.columns[:, series.own]].sum(axis=1)
            noises.append(estimated(own, residual_nm, fitted, least_nm, roughly=roughly))
        return replace(self, noises=tuple(noises), found=found, logs=logs, log_evidence=evidence)

    @property
    def groups(self) -> dict[str, NDArray[np.int64]]:
        """Terms that share a scale; the payload's mass and terms fixed at 0 have none."""
        of = self.terms.of
        return {
            name: indices
            for name, indices in of.items()
            if name != "payload" and self.terms.sds[indices].all()
        }

    @property
    def _sds(self) -> Array:
        """Prior deviations at scale 1, shape (N,); the payload's centre and inertia go by mass."""
        sds = self.terms.sds.copy()
        mass_kg = max(abs(float(self.found.means[MASS])), MIN_MASS_KG)
        sds[CENTRE] *= mass_kg
        sds[INERTIA] *= mass_kg
        return sds

    def normal_equations(self, rows: Sequence[TorqueRows], at: Array) -> NormalEquations:
        """Accumulate the normal equations of the terms, linear about `at`."""
        count = len(self.terms.sds)
        precision, gradient = np.zeros((count, count)), np.zeros(count)
        if self.known is not None:
            precision += self.known.precision
            gradient += self.known.gradient
        for noises, series in zip(self.noises, rows, strict=True):
            target = series.after_nm(-at)
            for joint in np.flatnonzero(series.used).tolist():
                columns, slopes = series.columns[joint], series.slopes[:, joint]
                weighed = noises[joint].weighed(slopes)
                precision[np.ix_(columns, columns)] += slopes.T @ weighed
                gradient[columns] += weighed.T @ target[:, joint]
        return NormalEquations(precision, gradient)

    def residual_nm(self, run: int, lines: Sequence[Linearization], change: Array) -> Array:
        """Return the residual after a `change` from the linearisation point, shape (T, J)."""
        measured_nm = self.runs[run].torques_nm(self.convention)
        return measured_nm - lines[run].predicted_nm - lines[run].moved_nm(change)


# ---- Fit of the payload: the likeliest convention, refined

# Fits of linear models to choose a convention: of all four, then of those that may still win; and
# of Gauss-Newton with the best.
_COMPARISONS, _MORE_COMPARISONS, _ITERATIONS = 3, 6, 3


def fit_payload(
    arm: Arm,
    motion: ArmMotion,
    tares: Sequence[ArmMotion] = (),  # while it held nothing: any motions will do
    *,
    conventions: Sequence[Convention] = CONVENTIONS,
    known: NormalEquations | None = None,  # of the arm's own terms, see `PayloadFit.learnt`
    gain: float = GAIN,  # usual error of the torques of each joint, a fraction
) -> PayloadFit:
    """Fit mass, centre of mass and inertia of an arm's payload.

    Linear models of all torque conventions are compared by their evidence. Gauss-Newton refines the
    best one, and its posterior is marginalised over the scale of each group of terms.
    """
    model = ArmModel(arm)
    motions: list[ArmMotion] = [motion]
    covered: list[NDArray[np.bool_] | None] = [None]
    for tare in tares:
        beside = along(motion, tare) if not any(one is not None for one in covered) else None
        motions.append(tare if beside is None else beside[0])
        covered.append(None if beside is None else beside[1])
    empty_nm = [model.empty_nm(*one.at(one.seconds)) for one in motions]
    scales_nm = torque_scales_nm(arm, motions, empty_nm)
    drifts = known is not None or len(motions) > 1
    terms = make_terms(arm, scales_nm, len(motions), drifts=drifts, gain=gain)
    if known is not None:
        known = known.among(terms.arms, len(terms.names))
    runs = tuple(
        LoggedArm(model, terms, one, number, inside)
        for number, (one, inside) in enumerate(zip(motions, covered, strict=True))
    )
    best, odds, arm_odds = _likeliest(runs, conventions, known)
    at, lines, rows = best.found.means, [], []
    for _ in range(_ITERATIONS):
        at = best.found.means
        lines = [run.linearized(at, best.convention) for run in runs]
        rows = rows_of(runs, lines, best.convention)
        best = best.fitted(rows, at, roughly=False)
    normal = best.normal_equations(rows, at)
    # A run to come drifts from these, even where one alone does not show what drifted.
    drifting = make_terms(arm, scales_nm, len(motions), drifts=True).sds
    priors = np.where(terms.sds > 0, best.found.sds, drifting)
    learnt = normal.marginal(terms.arms, priors)
    common = np.sqrt(max(gain**2 - GAIN**2, 0.0))
    return _result(best, lines, at, normal, (odds, arm_odds), learnt, common)


def _likeliest(
    runs: tuple[LoggedArm, ...], conventions: Sequence[Convention], known: NormalEquations | None
) -> tuple[GaussNewton, float, float]:
    """Fit all conventions, and return the likeliest allowed one with its log evidence ratios.

    The first is over every other convention (below 0 if one that was excluded is likelier), the
    second over a model without an arm.
    """
    nothing = np.zeros(len(runs[0].terms.sds))
    lines = {
        convention: [run.linearized(nothing, convention) for run in runs]
        for convention in CONVENTIONS
    }
    rows = {convention: rows_of(runs, lines[convention], convention) for convention in CONVENTIONS}
    fits = {
        convention: _compared(
            GaussNewton.start(runs, convention, known), rows[convention], _COMPARISONS
        )
        for convention in CONVENTIONS
    }
    for _ in range(_MORE_COMPARISONS):
        leader = max(fit.log_evidence for fit in fits.values())
        # Log evidence by which a convention may be behind and still win: noise settles slowly
        near = [one for one, fit in fits.items() if fit.log_evidence > leader - 50.0]
        if len(near) == 1:
            break
        fits |= {one: _compared(fits[one], rows[one], 1) for one in near}
    best = max(conventions, key=lambda convention: fits[convention].log_evidence)
    evidence = fits[best].log_evidence
    others = [fit.log_evidence for convention, fit in fits.items() if convention != best]
    # Without an arm: the torques of sensors and friction alone.
    kept = np.isin(runs[0].terms.groups, ("offset", "friction", "drift", "warming"))
    bare = [
        replace(
            line,
            predicted_nm=np.zeros_like(line.predicted_nm),
            slopes=line.slopes * kept[line.columns],
        )
        for line in lines[best]
    ]
    start = GaussNewton.start(runs, best, known)
    no_arm = _compared(start, rows_of(runs, bare, best), _COMPARISONS)
    odds = evidence - max(others), evidence - no_arm.log_evidence
    # From here on sensor offsets have their usual prior again.
    return replace(fits[best], logs={**fits[best].logs, "offset": 0.0}), *odds


def _compared(fit: GaussNewton, rows: Sequence[TorqueRows], count: int) -> GaussNewton:
    """Run some rough fits of linear models about 0, each with the last one's noise."""
    for _ in range(count):
        fit = fit.fitted(rows, np.zeros(len(fit.terms.sds)), roughly=True)
    return fit


def _payload(fit: GaussNewton, normal: NormalEquations) -> tuple[Array, Array, float]:
    """Return means of the payload's terms, shape (10,), covariance, (10, 10), and a bound [kg].

    Averages two models: an arm with all nuisance terms, and a simulated one, without any.
    """
    own = np.arange(PAYLOAD_TERMS)
    means, covariance = averaged(fit.found, fit.groups, fit.logs, own)
    if len(fit.runs) > 1 or fit.known is not None:
        # Factor on standard deviations where runs share an arm: what a model of it lacks is in
        # none of them alone. By made arms of another generator, whose intervals held 88 to 92 %
        # without it
        covariance = 1.2**2 * covariance
    ideal, weight = without(normal, fit.found, fit.groups, fit.logs, NOT_SIMULATED)
    off = ideal.means[own] - means
    covariance = (1 - weight) * covariance + weight * ideal.covariance[np.ix_(own, own)]
    likelier = ideal if weight > 0.5 else fit.found
    bound_kg = float(np.sqrt(likelier.covariance[MASS, MASS]))
    means = means + weight * off
    return means, covariance + weight * (1 - weight) * np.outer(off, off), bound_kg


def _result(
    fit: GaussNewton,
    lines: Sequence[Linearization],
    at: Array,
    normal: NormalEquations,
    odds: tuple[float, float],
    learnt: NormalEquations,
    common: float,
) -> PayloadFit:
    """Args: odds: of the convention, and of the arm. common: error of all torques, a fraction."""
    terms, found = fit.terms, fit.found
    means, covariance, bound_kg = _payload(fit, normal)
    covariance = covariance + common**2 * np.outer(means, means)
    change = found.means - at
    log = fit.runs[0]
    residual_nm = fit.residual_nm(0, lines, change)
    tare_residuals = []
    for run in fit.runs[1:]:
        counted = np.ix_(run.inside, run.motion.used)
        tare_residuals.append(
            FitResidual(
                fit.residual_nm(run.run, lines, change)[counted],
                run.torques_nm(fit.convention)[counted],
                terms.scales_nm[run.motion.used],
            )
        )
    effort_nm = log.torques_nm(fit.convention)
    sds = np.sqrt(np.diag(found.covariance))
    lag = int(terms.of["lag"][0])
    return PayloadFit(
        held=held(means, covariance),
        convention=fit.convention,
        convention_odds=odds[0],
        arm_odds=odds[1],
        nuisances=tuple(
            Nuisance(
                name, terms.groups[k], float(found.means[k]), float(sds[k]), float(terms.sds[k])
            )
            for k, name in enumerate(terms.names)
            if k >= PAYLOAD_TERMS and terms.sds[k]
        ),
        bound_kg=bound_kg,
        scales={name: float(np.exp(log)) for name, log in fit.logs.items()},
        scales_nm=terms.scales_nm,
        seconds=log.motion.seconds,
        effort_nm=effort_nm,
        predicted_nm=effort_nm - residual_nm,
        used=log.motion.used,
        lag_s=float(found.means[lag]),
        tare_residuals=tuple(tare_residuals),
        learnt=learnt,
    )
