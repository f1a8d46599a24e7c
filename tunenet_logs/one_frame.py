"""The one frame that all messages of a topic are in, if there is one."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class OneFrame:
    """Hears the frame of each message.

    Attributes:
        name: of the one that all had; "" where they differ, or none was named.
    """

    name: str = ""
    _is_told: bool = False

    def add(self, name: str) -> None:
        """The frame of one more message."""
        if not self._is_told:
            self.name, self._is_told = name, True
        elif name != self.name:
            self.name = ""
