"""Write comments in the languages of the exported files.

Their text may be untrusted (a log's name, a reason): it must not end the comment, begin a new
line, or move the cursor of a terminal.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from tunenet_logs.terminal import one_line


def xml_comment(lines: Iterable[str], indent: str = "") -> str:
    """Format lines as one XML comment, printable, without the `--` that would end it."""
    body = "".join(f"{indent}  {_without_double_dashes(one_line(line))}\n" for line in lines)
    return f"{indent}<!--\n{body}{indent}-->"


def hash_comment(lines: Iterable[str], indent: str = "") -> str:
    """Format lines as `#` comments of Python, YAML and USD."""
    return "\n".join(f"{indent}# {one_line(line)}".rstrip() for line in lines)


def _without_double_dashes(line: str) -> str:
    return re.sub("-(?=-)", "- ", line)
