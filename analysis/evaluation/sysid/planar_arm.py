"""Simulate a planar two-link arm under delayed servos, with a payload at its tip."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, sin

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

from analysis.evaluation.sysid.model_log import GRAVITY_M_S2
from tunenet_logs.arrays import Array

LINKS_M = (0.4, 0.3)
LINKS_KG = (1.5, 1.0)
LINKS_KG_M2 = (0.02, 0.008)  # about the links' centres, which are in their middles
ARMATURE_KG_M2, DAMPING = 0.02, 0.3
KP, KV = np.array([120.0, 60.0]), np.array([12.0, 3.0])

TIP_RADIUS_M = 0.02  # of the payload, a ball
_TERMS = 3
_MAX_RAD = 0.6
_MIN_HZ, _MAX_HZ = 0.15, 1.2
_EASING_S = 0.5
_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Commands:
    """Sums of sines, eased in from rest.

    Attributes:
        middle: of each joint [rad], shape (2,).
        amplitudes: of each sine [rad], shape (K, 2).
        rates: of each sine [rad/s], shape (K, 2).
        phases: of each sine [rad], shape (K, 2).
    """

    middle: Array
    amplitudes: Array
    rates: Array
    phases: Array

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Commands:
        """Draw commands of some 0.6 rad about some posture."""
        shape = (_TERMS, 2)
        middle = np.array([rng.uniform(0.3, 1.2), rng.uniform(-0.3, 1.0)])
        shares = rng.uniform(0.5, 1.0, shape)
        amplitudes = _MAX_RAD * shares / np.sum(shares, axis=0)
        rates = 2 * np.pi * rng.uniform(_MIN_HZ, _MAX_HZ, shape)
        return cls(middle, amplitudes, rates, rng.uniform(0, 2 * np.pi, shape))

    def at(self, seconds: Array) -> Array:
        """Return positions [rad] at times of shape (T,), shape (T, 2)."""
        share = (seconds / _EASING_S).clip(0.0, 1.0)
        ease = (share**2 * (3 - 2 * share))[:, None]
        waves = self.rates * seconds[:, None, None] + self.phases
        return self.middle + ease * np.sum(self.amplitudes * np.sin(waves), axis=1)


@dataclass(frozen=True)
class PlanarArm:
    """Planar arm; angles are 0 where it hangs down, the elbow's against the first link.

    Attributes:
        payload_kg: at the tip.
        delay_s: after which a servo obeys a command.
        elbow_is_held: whether a brake holds the elbow where the first command wants it.
    """

    payload_kg: float
    delay_s: float
    elbow_is_held: bool = False

    @classmethod
    def drawn(cls, rng: np.random.Generator, *, elbow_is_held: bool = False) -> PlanarArm:
        """Draw an arm."""
        payload_kg = float(np.exp(rng.uniform(np.log(0.2), np.log(2.0))))
        return cls(payload_kg, float(rng.uniform(0.005, 0.06)), elbow_is_held)

    def weight(self, first_rad: float, second_rad: float) -> tuple[float, float]:
        """Return the gravity torques of the joints [N·m]."""
        first_m, second_m = LINKS_M
        second = LINKS_KG[1] * second_m / 2 + self.payload_kg * second_m
        first = LINKS_KG[0] * first_m / 2 + (LINKS_KG[1] + self.payload_kg) * first_m
        tip = GRAVITY_M_S2 * second * sin(first_rad + second_rad)
        return GRAVITY_M_S2 * first * sin(first_rad) + tip, tip

    def accelerations(
        self, angles_rad: tuple[float, float], speeds: tuple[float, float], torques: Array
    ) -> tuple[float, float]:
        """Return joint accelerations [rad/s²] under the servos' torques [N·m], shape (2,)."""
        first_m, second_m = LINKS_M
        tip_kg_m2 = 0.4 * self.payload_kg * TIP_RADIUS_M**2
        # moments of the second link and the payload about the elbow, first and second
        moment = LINKS_KG[1] * second_m / 2 + self.payload_kg * second_m
        elbow = LINKS_KG_M2[1] + LINKS_KG[1] * (second_m / 2) ** 2
        elbow += tip_kg_m2 + self.payload_kg * second_m**2
        carried = LINKS_KG_M2[0] + LINKS_KG[0] * (first_m / 2) ** 2
        carried += (LINKS_KG[1] + self.payload_kg) * first_m**2
        cross = first_m * moment * cos(angles_rad[1])
        swing = first_m * moment * sin(angles_rad[1])
        weight = self.weight(*angles_rad)
        first = float(torques[0]) - DAMPING * speeds[0] - weight[0]
        first += swing * (2 * speeds[0] + speeds[1]) * speeds[1]
        second = float(torques[1]) - DAMPING * speeds[1] - weight[1] - swing * speeds[0] ** 2
        shoulder = carried + elbow + 2 * cross + ARMATURE_KG_M2
        if self.elbow_is_held:
            return first / shoulder, 0.0
        both, elbow = elbow + cross, elbow + ARMATURE_KG_M2
        area = shoulder * elbow - both**2
        return (elbow * first - both * second) / area, (shoulder * second - both * first) / area

    def moved(self, seconds: Array, told_s: Array, told_rad: Array) -> tuple[Array, Array, Array]:
        """Integrate angles [rad], speeds [rad/s] and servo torques [N·m], each (T, 2).

        Args:
            seconds: increasing, from 0 on, shape (T,).
            told_s: when commands are given, from 0 on, shape (K,).
            told_rad: the commands, each held until the next, shape (K, 2); before the first is
                obeyed the arm rests where the first holds it.
        """
        edges = told_s + self.delay_s
        wanted = told_rad[np.maximum(np.searchsorted(edges, seconds, "right") - 1, 0)]
        state = np.concatenate([self._rest(told_rad[0]), np.zeros(2)])
        states = np.empty((len(seconds), 4))
        states[seconds < edges[0]] = state
        ends = np.append(edges[1:], max(seconds[-1], edges[-1]) + 1e-3)
        for start_s, end_s, command in zip(edges, ends, told_rad, strict=True):
            inside = (seconds >= start_s) & (seconds < end_s)
            solved = solve_ivp(
                self._rates,
                (start_s, end_s),
                state,
                "DOP853",
                t_eval=np.append(seconds[inside], end_s),
                args=(command,),
                rtol=_TOLERANCE,
                atol=_TOLERANCE,
            )
            states[inside] = solved.y[:, :-1].T
            state = solved.y[:, -1]
        angles_rad, speeds = states[:, :2], states[:, 2:]
        return angles_rad, speeds, KP * (wanted - angles_rad) - KV * speeds

    def _rates(self, _: float, state: Array, command: Array) -> Array:
        torques = KP * (command - state[:2]) - KV * state[2:]
        first_rad, second_rad, first, second = state.tolist()
        pulls = self.accelerations((first_rad, second_rad), (first, second), torques)
        return np.array([first, second, *pulls])

    def _rest(self, command: Array) -> Array:
        """Solve for where the servos hold the arm, shape (2,) [rad]."""

        def unheld(angles_rad: Array) -> Array:
            torques = KP * (command - angles_rad) - self.weight(*angles_rad.tolist())
            if self.elbow_is_held:
                torques[1] = command[1] - angles_rad[1]
            return torques

        return np.asarray(fsolve(unheld, command, xtol=1e-12), np.float64)
