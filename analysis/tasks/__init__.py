"""The experiments, by name. A new one is one file here, and one line below."""

from __future__ import annotations

from analysis.tasks.base import Task
from analysis.tasks.drop import DropTask
from analysis.tasks.drop_video import DropVideoTask
from tunenet_logs.episode import Episode

TASKS: dict[str, Task] = {task.name: task for task in (DropTask(), DropVideoTask())}


def task_for(kind: str, episode: Episode, topic: str | None) -> Task | None:
    """The first task of a kind that finds what it looks at; else the first, to say what it misses.

    None where there is no task of that kind.
    """
    tasks = [task for task in TASKS.values() if task.kind == kind]
    fitting = (task for task in tasks if task.fits(episode, topic))
    return next(fitting, tasks[0] if tasks else None)
