"""Read tuned parameters from a YAML file: a line per address, with its range."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tunenet_logs.errors import LogError, UsageError
from tunenet_logs.small_files import read_small_file
from tunenet_logs.terminal import one_line, short_name

_MAX_BYTES, _MAX_LINES, _MAX_DEPTH = 64_000, 200, 3
_SHAPE = "write lines such as joint/elbow.damping: [0, 5]"


def listed_parameters(texts: Sequence[str]) -> tuple[str, ...]:
    """Expand YAML files among addresses with ranges, in place.

    Raises:
        UsageError: A file cannot be read, or holds something else.
    """
    found: list[str] = []
    for text in texts:
        if text.endswith((".yaml", ".yml")):
            found += _of_file(Path(text))
        else:
            found.append(text)
    return tuple(found)


def _of_file(path: Path) -> Iterator[str]:
    for address, limits in _mapping(path).items():
        if limits is None:
            yield str(address)
            continue
        is_pair = isinstance(limits, list) and len(limits) == 2
        if not is_pair or not all(
            isinstance(one, int | float) and not isinstance(one, bool) for one in limits
        ):
            raise UsageError(f"{path}: {short_name(address)} has no [LOW, HIGH]", _SHAPE)
        try:
            low, high = map(float, limits)
        except OverflowError as error:
            what = f"{path}: {short_name(address)} has a limit that is too large"
            raise UsageError(what, _SHAPE) from error
        yield f"{address}={low!r}:{high!r}"


def _mapping(path: Path) -> dict[Any, Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

    try:
        data = read_small_file(path, _MAX_BYTES)
        depth = 0
        for event in YAML(typ="safe", pure=True).parse(data):
            depth += isinstance(event, CollectionStartEvent)
            depth -= isinstance(event, CollectionEndEvent)
            if depth > _MAX_DEPTH or isinstance(event, AliasEvent):  # few may stand for millions
                raise UsageError(f"{path}: has nested lists or aliases (*NAME)", _SHAPE)
        found = YAML(typ="safe", pure=True).load(data)
    except (OSError, LogError, ValueError, TypeError, RecursionError) as error:
        why = getattr(error, "strerror", None) or one_line(error)
        raise UsageError(f"{path}: cannot be read ({short_name(why)})", _SHAPE) from error
    except YAMLError as error:
        raise UsageError(f"{path}: is no YAML ({one_line(error)[:80]})", _SHAPE) from error
    if not isinstance(found, dict) or not 0 < len(found) <= _MAX_LINES:
        raise UsageError(f"{path}: holds no addresses", _SHAPE)
    return found
