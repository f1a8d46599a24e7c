"""Match forces and torques in a log with a model's sites and bodies, and their sign."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from analysis.sysid.names import named_as, topic_of, words_of
from analysis.sysid.told import TURNED
from recorders.simulators.mujoco.library import mujoco
from recorders.simulators.mujoco.model_frames import free_joint
from recorders.simulators.mujoco.model_parameters import element_names
from recorders.simulators.mujoco.model_sensors import Kind, SensedSignal, Sensor
from tunenet_logs.arrays import Array
from tunenet_logs.episode import Episode, Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import short_name

_KINDS: dict[str, Kind] = {"N": "force", "N·m": "torque"}
# In a sensor's name: a model has one for each of the two.
_QUANTITY = re.compile(r"(?:(?<![_\W])[_\W]++)?(force|torque)[_\W]*")

_FIRST_NS = 100_000_000  # of a log, by which a sign is told
_OPPOSED = -0.9  # cosine between what is seen and what is simulated
# Of the simulated force, that the log's has to be for its sign to tell: no tared sensor's is.
_MIN_SHARE = 0.2


def is_wrench(signal: Signal) -> bool:
    """Return whether a signal is a 3D force or torque."""
    return signal.columns == ("x", "y", "z") and signal.unit in _KINDS


def sensed_wrench(signal: Signal, told: str, model: Any) -> tuple[SensedSignal | None, str]:
    """Match a force or torque with a compiled model.

    Args:
        signal: Of the log.
        told: The user's `site/NAME` or `body/NAME`, with a `-` for the other sign; "" if none.
        model: Compiled.

    Returns:
        The matched signal, and its use in words; or None, and why not.

    Raises:
        UsageError: The user names a site for a signal that is no force.
    """
    if not is_wrench(signal):
        raise UsageError(
            f"--map {short_name(signal.name)}={short_name(told)}: is no force in N or torque in "
            "N·m",
            "map the topic of a wrench to a site",
        )
    if told:
        kind, _, name = told.removeprefix(TURNED).partition("/")
        is_body = kind == "body"
    else:
        is_body, name = _place(signal, model)
    if not name:
        return None, "no force sensor, site or body of the model is called so"
    if np.isfinite(signal.values).all(axis=1).sum() < 2:
        return None, "fewer than two samples"
    body = name if is_body else model.body(int(model.site(name).bodyid[0])).name
    if not model.body(body).id or free_joint(model, body) is not None:
        return None, f"{short_name(name)} hangs on nothing, and no force holds it"
    kind, sign = _KINDS[signal.unit], -1.0 if told.startswith(TURNED) else 1.0
    sensors = tuple(Sensor(kind, name, axis, is_at_body=is_body, sign=sign) for axis in range(3))
    where = f"{'body' if is_body else 'site'} {short_name(name)}"
    words = f"{kind} at {where}, {'of its parent on it' if sign > 0 else 'of it on its parent'}"
    if signal.frame and named_as(signal.frame, [name, body]) is None:
        words += f", frame {short_name(signal.frame)} taken for its axes"
    return SensedSignal(signal, signal.columns, sensors), words


def _place(signal: Signal, model: Any) -> tuple[bool, str]:
    """Return whether it is a body's, and the site or body; "" if none has that name."""
    words = [*filter(None, [signal.frame]), *words_of(topic_of(signal.name))]
    sites = [name for name in element_names(model, "site") if name]
    bodies = [name for name in element_names(model, "body")[1:] if name]
    sensors = _sites_by_sensor(model)
    for is_body, names in ((False, list(sensors)), (False, sites), (True, bodies)):
        for word in words:
            if found := named_as(word, names):
                return is_body, sensors.get(found, found)
    return False, ""


def _sites_by_sensor(model: Any) -> dict[str, str]:
    """Map the name of each force sensor, with and without `force` in it, to its site."""
    kinds = mujoco().mjtSensor
    wanted = (int(kinds.mjSENS_FORCE), int(kinds.mjSENS_TORQUE))
    found: dict[str, str] = {}
    for number in range(model.nsensor):
        if int(model.sensor_type[number]) not in wanted:
            continue
        name = model.sensor(number).name
        site = model.site(int(model.sensor_objid[number])).name
        if name and site:
            found |= {name: site}
            if plain := _QUANTITY.sub("", name):
                found.setdefault(plain, site)
    return found


def doubts(sensed: Sequence[SensedSignal], rollout: Episode) -> tuple[str, ...]:
    """Describe forces that oppose those of a rollout at their beginning."""
    found: list[str] = []
    for one in sensed:
        first = one.sensors[0]
        if first.kind != "force" or not _is_opposed(one.signal, rollout.signals[one.signal.name]):
            continue
        place = f"{'body' if first.is_at_body else 'site'}/{short_name(first.name)}"
        target = f"{TURNED}{place}" if first.sign > 0 else place
        found.append(
            f"{one.signal.name}: at the start it points against what is simulated; of the other "
            f"sign it is with --map {short_name(topic_of(one.signal.name))}={target}"
        )
    return tuple(found)


def _is_opposed(observed: Signal, rolled: Signal) -> bool:
    seen, simulated = _beginning(observed), _beginning(rolled)
    sizes = float(np.linalg.norm(seen)), float(np.linalg.norm(simulated))
    is_seen = sizes[0] > _MIN_SHARE * sizes[1] > 0
    return is_seen and float(seen @ simulated) < _OPPOSED * sizes[0] * sizes[1]


def _beginning(signal: Signal) -> Array:
    """Return the mean of a signal's first samples, shape (C,); 0 if it has none."""
    first = signal.values[signal.stamps_ns <= signal.stamps_ns[0] + _FIRST_NS]
    good = first[np.isfinite(first).all(axis=1)]
    return good.mean(axis=0) if len(good) else np.zeros(signal.values.shape[1])
