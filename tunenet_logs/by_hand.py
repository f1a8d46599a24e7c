"""Read the message fields that the user names: positions, joints and impacts of any log."""

from __future__ import annotations

from pathlib import Path

from tunenet_logs.episode import Signal
from tunenet_logs.errors import LogError
from tunenet_logs.formats.any_messages import SchemaBudget, any_type
from tunenet_logs.formats.base import RawChannel, UnusableError
from tunenet_logs.formats.read_options import ReadOptions
from tunenet_logs.formats.structure import likely_field, numbers_in
from tunenet_logs.hand_rows import AXES, HandRows, listed


class HandPicked:
    """The user's columns (`--columns`), gathered while the log is read."""

    def __init__(self, path: Path, options: ReadOptions, budget: SchemaBudget) -> None:
        self._path = path
        self._options = options
        self._budget = budget
        self._topics: list[HandRows] = []
        self._channels: list[RawChannel] = []
        self._found: set[str] = set()
        self._missed: dict[str, LogError] = {}  # why not, by topic

    def rows_of(self, channel: RawChannel) -> HandRows | None:
        """Return the collector of a channel's named fields; None if one is absent."""
        self._channels.append(channel)
        picks = {
            target: rest
            for target, text in self._options.columns.items()
            if target not in self._found and (rest := _behind(text, channel.topic)) is not None
        }
        if not picks:
            return None
        try:
            rows = HandRows(self._path, channel, picks, any_type(channel, self._budget))
        except UnusableError as reason:
            why = f"{self._path}: {channel.topic} cannot be read: {reason}"
            self._missed.setdefault(channel.topic, LogError(why, "name another topic"))
            return None
        except LogError as error:  # another channel of that topic may have it
            self._missed.setdefault(channel.topic, error)
            return None
        self._found.update(picks)
        self._topics.append(rows)
        return rows

    def signals(self) -> tuple[list[Signal], list[str]]:
        """Return the signals of the user's columns, and notes on what was repaired.

        Raises:
            LogError: a topic is missing, or the columns do not go together.
        """
        for target, text in self._options.columns.items():
            if target not in self._found:
                missed = [
                    error
                    for topic, error in self._missed.items()
                    if _behind(text, topic) is not None
                ]
                raise missed[0] if missed else self._no_topic(target, text)
        self._check()
        found: list[Signal] = []
        notes: list[str] = []
        for rows in self._topics:
            signals, repairs = rows.signals(self._options)
            found += signals
            notes += repairs
        if not found:
            raise LogError(
                f"{self._path}: the fields that --columns names hold no value", "name others"
            )
        return found, notes

    def _check(self) -> None:
        """Check that each group of columns comes from one topic."""
        groups: dict[str, set[str]] = {}
        for rows in self._topics:
            for target in rows.targets:
                group = "x, y and z" if target in AXES else target.partition("_")[0]
                if target not in ("t", "frame"):
                    groups.setdefault(group, set()).add(rows.topic)
        for group, topics in groups.items():
            if len(topics) > 1:
                shown = " and ".join(sorted(topics)[:2])
                raise LogError(f"{self._path}: {group} come from {shown}; name fields of one topic")
        if {"effort", "current"} <= set(groups) and self._options.torque_constants:
            raise LogError(f"{self._path}: --columns names efforts and currents; name one of them")

    def _no_topic(self, target: str, text: str) -> LogError:
        topics = list(dict.fromkeys(channel.topic for channel in self._channels))
        example = ""
        for channel in self._channels:
            try:
                structure = any_type(channel, self._budget).structure
            except UnusableError:
                continue
            if structure is not None and (fields := numbers_in(structure)):
                example = f"; write TOPIC.FIELD, such as --columns {target}={channel.topic}."
                example += likely_field(fields)
                break
        return LogError(
            f"{self._path}: no topic of --columns {target}={text[:80]} "
            f"(there are: {listed(topics)})",
            f"name one of these{example}" if topics else "leave --columns out",
        )


def _behind(text: str, topic: str) -> str | None:
    """Return what follows a topic's name in a text; None where the text does not begin with it."""
    for name in (topic, topic.lstrip("/")):
        if name and text.startswith(name):
            rest = text[len(name) :]
            if not rest or rest[0] in ".[":
                return rest
    return None
