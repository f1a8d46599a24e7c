"""Whether a reason ends with what to do: the law for everything that a log is refused for."""

import re

# First words of a clause that tells a user what to do.
_ORDERS = """
add ask calibrate check choose close convert copy correct create cut decrypt drop export film
filter free give hold install keep leave let link lower make mark measure mend mount move name
number open pass pip put record recover rename replace report rewrite run save say see select
set shorten split take track try tune unpack use wait widen write
"""
ORDERS = frozenset(_ORDERS.split())

_CONDITION = re.compile(r"(?:if|where|first|then|or|and|either)\b[^,;:]*, |first ", re.I)


def has_remedy(reason: str) -> bool:
    """Whether a line ends with an order, or with one for the next drop or run."""
    last = reason.rsplit("; ", 1)[-1]
    order = re.split(r"at the next \w+: ", last, maxsplit=1)[-1]
    return any(map(_is_order, (last, order, *re.split(r"[:?] ", last)[1:])))


def _is_order(clause: str) -> bool:
    words = re.match(r"[a-z]+", _CONDITION.sub("", clause.strip(" )"), count=1))
    return words is not None and words[0] in ORDERS
