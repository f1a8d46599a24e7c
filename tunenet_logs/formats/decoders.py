"""Cache of message decoders: one per type definition in the log."""

from __future__ import annotations

from tunenet_logs.formats.any_messages import SchemaBudget
from tunenet_logs.formats.base import Decode, RawChannel, UnusableError
from tunenet_logs.formats.registry import decoder_for


class Decoders:
    """Factory of message decoders, within a budget of definition bytes."""

    def __init__(self, budget: SchemaBudget) -> None:
        self._budget = budget
        self._made: dict[tuple[str, str, str, bytes], Decode | str] = {}

    def of(self, channel: RawChannel) -> Decode:
        """Return the decoder of a channel, shared by channels of the same definition.

        Raises:
            UnusableError: its messages cannot be decoded.
        """
        key = (channel.encoding, channel.schema_encoding, channel.type_name, channel.schema)
        if key not in self._made:
            try:
                self._budget.spend(channel)
                self._made[key] = decoder_for(channel)
            except UnusableError as reason:
                self._made[key] = str(reason)
        made = self._made[key]
        if isinstance(made, str):
            raise UnusableError(made)
        return made
