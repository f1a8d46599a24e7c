"""Check the user's `--map` against the log and the model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from difflib import get_close_matches

from analysis.sysid.names import topic_of
from tunenet_logs.episode import Signal
from tunenet_logs.errors import UsageError
from tunenet_logs.terminal import listed, short_name

IGNORE = "-"  # as a target of `--map`: the signal is left out
TURNED = "-"  # before a site or a body: the log has the force of the child on its parent
_FEW = 6


def check_told(
    told: Mapping[str, str], signals: Mapping[str, Signal], names: Mapping[str, Sequence[str]]
) -> None:
    """Check that each key of `--map` is in the log and each target in the model.

    Raises:
        UsageError: One is not.
    """
    topics = set(map(topic_of, signals))
    known = {*signals, *topics}
    for name, signal in signals.items():
        for column in signal.columns:
            known |= {f"{name}.{column}", f"{topic_of(name)}.{column}", column}
    for key, target in told.items():
        if key not in known:
            near = get_close_matches(key, known, _FEW, 0.5) or sorted(known)
            raise UsageError(
                f"--map {short_name(key)}: the log has no such signal",
                f"there is: {listed(near, _FEW)}",
            )
        kind, _, name = target.partition("/")
        if kind in (f"{TURNED}body", f"{TURNED}site"):
            kind = kind.removeprefix(TURNED)
        is_whole = key in signals or key in topics
        if not is_whole and (target in ("commands", "states") or kind in ("body", "site")):
            raise UsageError(
                f"--map {short_name(key)}={short_name(target)}: is one column alone",
                f"map its signal or topic, or {short_name(key)}=joint/NAME",
            )
        if target in ("commands", "states", IGNORE):
            continue
        if not name or name not in names.get(kind, ()):
            known_names = [f"{one}/{each}" for one, some in names.items() for each in some if each]
            near = get_close_matches(target, known_names, _FEW, 0.5) or known_names
            raise UsageError(
                f"--map {short_name(key)}={short_name(target)}: is no part of the model",
                f"there is: commands, states, -, {listed(near, _FEW)}",
            )
