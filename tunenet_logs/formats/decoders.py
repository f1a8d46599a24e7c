"""How the messages of a log's types are decoded: made once for each definition that it holds."""

from __future__ import annotations

from tunenet_logs.formats.any_messages import SchemaBudget
from tunenet_logs.formats.base import Decode, RawChannel, UnusableError
from tunenet_logs.formats.registry import decoder_for


class Decoders:
    """Makes decoders, of as many bytes of definitions as are read.

    Args:
        budget: for these.
    """

    def __init__(self, budget: SchemaBudget) -> None:
        self._budget = budget
        self._made: dict[tuple[str, str, str, bytes], Decode | str] = {}

    def of(self, channel: RawChannel) -> Decode:
        """The decoder of a channel; that of another, where their definitions are the same.

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
