"""The kinds of experiment, by name. A new one is one file here, and one line below."""

from __future__ import annotations

from analysis.tasks.base import Task
from analysis.tasks.drop import DropTask

TASKS: dict[str, Task] = {task.name: task for task in (DropTask(),)}
