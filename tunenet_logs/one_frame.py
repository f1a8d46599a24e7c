"""Track whether all messages of a topic share one coordinate frame."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class OneFrame:
    """Common coordinate frame of a topic's messages.

    Attributes:
        name: of the one that all had; "" where they differ, or none was named.
    """

    name: str = ""
    _is_told: bool = False

    def add(self, name: str) -> None:
        """Register the frame of one more message."""
        if not self._is_told:
            self.name, self._is_told = name, True
        elif name != self.name:
            self.name = ""
