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
from scipy.special import log_ndtr, ndtr, ndtri

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
_IDENTIFIABLE_SD_M = 0.012  # of each axis of a centre: its interval is then narrower than a hand


@dataclass(frozen=True)
class Centre:
    """Centre of mass of the payload in the tool frame."""

    com_m: Three  # x, y, z [m]
    sds_m: tuple[float, ...]  # standard deviation of each [m]
    mass_kg: float  # that it is the centre of, as fitted
    # error of a mass that is fitted with the centre in the tool frame, per metre that the centre
    # is off along x, y, z
    kg_for_m: tuple[float, ...]

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
    # Divide first moments by the mass; the error of a quotient to first order.
    mass_kg = max(signed_kg, MIN_MASS_KG)
    com_m = means[CENTRE] / mass_kg
    to_com = np.concatenate([-com_m[:, None], np.eye(3)], axis=1) / mass_kg
    own = covariance[: CENTRE.stop, : CENTRE.stop]
    sds_m = np.sqrt(np.diag(to_com @ own @ to_com.T))
    precision = np.linalg.inv(own)
    kg_for_m = precision[MASS, CENTRE] / precision[MASS, MASS] * mass_kg
    x, y, z = com_m.tolist()
    centre = Centre((x, y, z), tuple(sds_m.tolist()), signed_kg, tuple(kg_for_m.tolist()))
    inertia = _inertia(means, covariance) if centre.is_identifiable else None
    # The 95 % interval of a Gaussian, truncated at 0 if its mean is hardly above.
    interval95 = signed_kg - TWO_SIDED * sd_kg, signed_kg + TWO_SIDED * sd_kg
    if signed_kg <= TWO_SIDED * sd_kg:
        above = float(ndtr(signed_kg / sd_kg))
        # Far below 0, the part above it is an exponential's: the quantile by its tail.
        interval95 = 0.0, signed_kg - sd_kg * float(ndtri(0.05 * above))
    return Held(max(signed_kg, 0.0), interval95, signed_kg, sd_kg, centre, inertia)


def _inertia(means: Array, covariance: Array) -> Inertia | None:
    """Average sampled inertias with a positive semidefinite pseudo-inertia."""
    rng = np.random.default_rng(17)
    drawn = rng.multivariate_normal(means, covariance, 4000, method="eigh")
    tensors = np.einsum("nk,kij->nij", drawn[:, INERTIA], moments())
    tensors += 0.4 * PAYLOAD_RADIUS_M**2 * drawn[:, MASS, None, None] * np.eye(3)
    masses, firsts = drawn[:, MASS], drawn[:, CENTRE]
    pseudo = np.zeros((len(drawn), 4, 4))
    traces = np.trace(tensors, axis1=1, axis2=2)
    pseudo[:, :3, :3] = 0.5 * traces[:, None, None] * np.eye(3) - tensors
    pseudo[:, :3, 3] = pseudo[:, 3, :3] = firsts
    pseudo[:, 3, 3] = masses
    there = np.linalg.eigvalsh(pseudo)[:, 0] >= 0
    if np.count_nonzero(there) < 200:  # too few that can be to average over
        return None
    masses, firsts = masses[there, None, None], firsts[there]
    about = np.einsum("ni,ni->n", firsts, firsts)[:, None, None] * np.eye(3)
    own = tensors[there] - (about - np.einsum("ni,nj->nij", firsts, firsts)) / masses
    rows = own[:, *np.tril_indices(3)]
    # Unidentifiable with a standard deviation of more than a fifth of the largest moment.
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

    residual_nm: Array  # measured less predicted, of the fitted joints [N·m], shape (T, U)
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
    learnt: NormalEquations  # of the arm's own terms (`Terms.arms`), by all runs, for later logs

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
        loose = (
            f"{axis} (sd {1000 * sd:.0f} mm)"
            for axis, sd in zip("xyz", centre.sds_m, strict=True)
            if sd >= _IDENTIFIABLE_SD_M
        )
        most_g = 10 * max(abs(kg_for_m) for kg_for_m in centre.kg_for_m)
        remedy = "turn the hand by 90° about two axes in the motion (the last three joints)"
        if not self.tare_residuals:
            remedy = f"record the empty gripper too (--tare), and {remedy}"
        return (
            f"the log cannot separate the payload's mass from its centre along "
            f"{', '.join(loose)}: 1 cm off the tool frame is {most_g:.0f} g; {remedy}"
        )


# ---- Difference and mean of a log and a tare along one path, which separate unmodelled effects
# Ripple, hoses and other unmodelled effects depend on the arm's configuration. Of two runs in the
# same places at the same times, such effects are in the mean alone, not in the difference.


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
        """Return the residual, (T, J), after the terms have changed by `change`, (N,)."""
        return self.left_nm - np.einsum("tjc,jc->tj", self.slopes, change[self.columns])


def rows_of(
    runs: Sequence[LoggedArm], lines: Sequence[Linearization], convention: Convention
) -> list[TorqueRows]:
    """Build the rows of each run; of a log and a tare along it, their difference and mean."""
    rows = [
        TorqueRows(
            run.motion.seconds,
            convention.sign * run.motion.effort - line.predicted_nm,
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
    lag, drifts = -OWN_TERMS - 3, slice(-2, None)  # columns of a run's own terms
    columns = np.hstack([log.columns, tare.columns[:, lag, None], tare.columns[:, drifts]])
    alone = np.concatenate([tare.slopes[..., lag, None], tare.slopes[..., drifts]], axis=-1)
    shared = tare.slopes.copy()
    shared[..., lag] = 0.0
    shared[..., drifts] = 0.0
    own = np.append(log.own, len(columns[0]) + np.array([-2, -1]))
    pair = []
    for of_log, of_tare, counted in ((1.0, -1.0, own[-4:]), (0.5, 0.5, own)):
        slopes = of_log * log.slopes + of_tare * shared
        both = np.concatenate([slopes, of_tare * alone], axis=-1)[inside]
        left_nm = (of_log * log.left_nm + of_tare * tare.left_nm)[inside]
        used = log.used & tare.used
        pair.append(TorqueRows(log.seconds[inside], left_nm, columns, both, counted, used))
    return [*pair, *rows[1:]]


def along(motion: ArmMotion, tare: ArmMotion) -> tuple[ArmMotion, NDArray[np.bool_]] | None:
    """Resample a tare at the log's own times, and say which it covers; None if elsewhere."""
    seconds = motion.seconds
    length_s = float(seconds[-1] - seconds[0])
    step_s = 0.05  # between the shifts in time that are tried, at most 400 of them
    overlap = 0.9  # of the log that a tare along its path covers at least
    grid = np.arange(seconds[0], seconds[-1], max(step_s, length_s / 500))
    where = motion.spline(grid)
    first, last = float(tare.seconds[0]), float(tare.seconds[-1])
    slack_s = (1 - overlap) * length_s
    low, high = first - seconds[0] - slack_s, last - seconds[-1] + slack_s
    if high < low:
        return None

    def off(shift: float) -> tuple[float, float]:
        at = grid + shift
        inside = (at >= first) & (at <= last)
        if np.mean(inside) < overlap:
            return np.inf, np.inf
        away = np.abs(where[inside] - tare.spline(at[inside]))
        return float(np.sqrt(np.mean(away**2))), float(away.max())

    count = int(min(np.ceil((high - low) / step_s) + 1, 400))
    shifts = np.linspace(low, high, count)
    best = min(shifts.tolist(), key=off)
    step = float(shifts[1] - shifts[0]) if count > 1 else step_s
    for _ in range(12):
        step /= 2
        best = min((best - step, best, best + step), key=off)
    rms, worst = off(best)
    # How well a controller repeats a path, rms and at most [rad].
    if rms > 0.01 or worst > 0.05:
        return None
    at = seconds + best
    inside = (at >= first) & (at <= last)
    effort = np.column_stack([np.interp(at, tare.seconds, column) for column in tare.effort.T])
    return replace(tare, seconds=at, effort=effort), inside


# ---- Gauss-Newton over all terms at once: their values, their prior scales, and the noise


@dataclass(frozen=True, eq=False)
class GaussNewton:
    """Gauss-Newton iterate of all terms."""

    runs: tuple[LoggedArm, ...]  # the log and its tares
    terms: Terms  # the unknowns
    convention: Convention  # the driver's torque convention
    known: NormalEquations | None  # on the arm, about terms of 0; None for nothing
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
        # Before anything is fitted: a fiftieth of what a joint is built for.
        noises = tuple(
            tuple(unknown(seconds, 0.02 * scale) for scale in terms.scales_nm.tolist())
            for seconds in (*paired, *others)
        )
        sds = terms.sds
        nothing = TermPosterior(np.zeros(len(sds)), np.diag(sds), sds, -np.inf)
        return cls(runs, terms, convention, known, noises, nothing)

    def fitted(self, rows: Sequence[TorqueRows], at: Array, *, roughly: bool) -> GaussNewton:
        """Solve for the terms about `at`, (N,), their groups' scales, then the residual's noise."""
        normal = self.normal_equations(rows, at)
        # At scale 1, the payload's centre and inertia go by its mass.
        usual_sds = self.terms.sds.copy()
        mass_kg = max(abs(float(self.found.means[MASS])), MIN_MASS_KG)
        usual_sds[CENTRE] *= mass_kg
        usual_sds[INERTIA] *= mass_kg
        searched = self.groups
        if roughly:
            del searched["offset"]
        # The search for scales goes on where the last one ended. With 3 steps it stood still for
        # some, and a wrong convention looked likelier by 130.
        logs = likeliest_scales(normal, usual_sds, searched, self.logs, 12)
        # With this logarithm of its scale an offset explains any constant torque.
        logs["offset"] = 2.5 if roughly else logs["offset"]
        sds = scaled(usual_sds, self.groups, logs)
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
            indices = self.terms.of[name]
            means[indices] = np.clip(means[indices], -0.2, 0.2)
        found = replace(found, means=means)
        least_nm = 2e-5 * self.terms.scales_nm  # the best sensor's, by what a joint is built for
        noises: list[Noises] = []
        for own, series in zip(self.noises, rows, strict=True):
            residual_nm = series.after_nm(found.means - at)
            fitted = told[series.columns[:, series.own]].sum(axis=1)
            noises.append(estimated(own, residual_nm, fitted, least_nm, roughly=roughly))
        return replace(self, noises=tuple(noises), found=found, logs=logs, log_evidence=evidence)

    @property
    def groups(self) -> dict[str, NDArray[np.int64]]:
        """Terms that share a scale; the payload's mass and terms fixed at 0 have none."""
        return {
            name: indices
            for name, indices in self.terms.of.items()
            if name != "payload" and self.terms.sds[indices].all()
        }

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


# ---- Fit of the payload: the likeliest convention, refined


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
    for _ in range(3):
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

    They are over every other convention (below 0 if an excluded one is likelier), and over a model
    without an arm.
    """
    nothing = np.zeros(len(runs[0].terms.sds))
    lines = {
        convention: [run.linearized(nothing, convention) for run in runs]
        for convention in CONVENTIONS
    }
    rows = {convention: rows_of(runs, lines[convention], convention) for convention in CONVENTIONS}
    fits = {
        convention: _compared(GaussNewton.start(runs, convention, known), rows[convention], 2)
        for convention in CONVENTIONS
    }
    # Log evidence by which a convention may be behind and still win: noise settles slowly.
    for behind in (1000.0, *[50.0] * 6):
        leader = max(fit.log_evidence for fit in fits.values())
        near = [one for one, fit in fits.items() if fit.log_evidence > leader - behind]
        if len(near) == 1 and behind < 1000.0:
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
    no_arm = _compared(start, rows_of(runs, bare, best), 3)
    odds = evidence - max(others), evidence - no_arm.log_evidence
    # From here on sensor offsets have their usual prior again.
    return replace(fits[best], logs={**fits[best].logs, "offset": 0.0}), *odds


def _compared(fit: GaussNewton, rows: Sequence[TorqueRows], count: int) -> GaussNewton:
    """Run some rough fits of linear models about 0, each with the last one's noise."""
    for _ in range(count):
        fit = fit.fitted(rows, np.zeros(len(fit.terms.sds)), roughly=True)
    return fit


def _result(
    fit: GaussNewton,
    lines: Sequence[Linearization],
    at: Array,
    normal: NormalEquations,
    odds: tuple[float, float],
    learnt: NormalEquations,
    common: float,
) -> PayloadFit:
    """Average two models: an arm with all nuisance terms, and a simulated one, without any.

    `odds` are of the convention, and of the arm; `common` is an error of all torques, a fraction.
    """
    terms, found, motion = fit.terms, fit.found, fit.runs[0].motion
    own = np.arange(PAYLOAD_TERMS)
    means, covariance = averaged(found, fit.groups, fit.logs, own)
    if len(fit.runs) > 1 or fit.known is not None:
        # Factor on standard deviations where runs share an arm: what a model of it lacks is in
        # none of them alone. By made arms of another generator, whose intervals held 88 to 92 %
        # without it
        covariance = 1.2**2 * covariance
    ideal, weight = without(normal, found, fit.groups, fit.logs, NOT_SIMULATED)
    off = ideal.means[own] - means
    covariance = (1 - weight) * covariance + weight * ideal.covariance[np.ix_(own, own)]
    likelier = ideal if weight > 0.5 else found
    means = means + weight * off
    covariance = covariance + weight * (1 - weight) * np.outer(off, off)
    covariance = covariance + common**2 * np.outer(means, means)
    residuals: list[FitResidual] = []
    for run, line in zip(fit.runs, lines, strict=True):
        effort_nm, change = (
            fit.convention.sign * run.motion.effort,
            (found.means - at)[line.columns],
        )
        left_nm = effort_nm - line.predicted_nm - np.einsum("tjc,jc->tj", line.slopes, change)
        residuals.append(FitResidual(left_nm, effort_nm, terms.scales_nm))
    tare_residuals: list[FitResidual] = []
    for run, whole in zip(fit.runs[1:], residuals[1:], strict=True):
        inside = np.ones(len(run.motion.seconds), bool) if run.covered is None else run.covered
        counted, scales_nm = np.ix_(inside, run.motion.used), terms.scales_nm[run.motion.used]
        left_nm, effort_nm = whole.residual_nm[counted], whole.effort_nm[counted]
        tare_residuals.append(FitResidual(left_nm, effort_nm, scales_nm))
    sds = np.sqrt(np.diag(found.covariance))
    effort_nm = residuals[0].effort_nm
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
        bound_kg=float(np.sqrt(likelier.covariance[MASS, MASS])),
        scales={name: float(np.exp(log)) for name, log in fit.logs.items()},
        scales_nm=terms.scales_nm,
        seconds=motion.seconds,
        effort_nm=effort_nm,
        predicted_nm=effort_nm - residuals[0].residual_nm,
        used=motion.used,
        lag_s=float(found.means[int(terms.of["lag"][0])]),
        tare_residuals=tuple(tare_residuals),
        learnt=learnt,
    )
