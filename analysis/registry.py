"""The experiments, by name. A new one is one file here, and one line below."""

from __future__ import annotations

from analysis.drop.from_film import DropVideoTask
from analysis.drop.from_positions import DropTask
from analysis.experiment import Task
from analysis.payload.experiment import PayloadTask
from tunenet_logs.episode import Episode

TASKS: dict[str, Task] = {task.name: task for task in (DropTask(), DropVideoTask(), PayloadTask())}


KINDS: tuple[str, ...] = tuple(dict.fromkeys(task.kind for task in TASKS.values()))


def task_for(kind: str, episode: Episode, topic: str | None) -> Task | None:
    """The first task of a kind that finds what it looks at; else the first, to say what it misses.

    None where there is no task of that kind.
    """
    tasks = [task for task in TASKS.values() if task.kind == kind]
    fitting = (task for task in tasks if task.claim(episode, topic))
    return next(fitting, tasks[0] if tasks else None)


def kinds_of(episode: Episode, topic: str | None) -> tuple[str, ...]:
    """What an episode that does not say so may be: the kinds whose claim is the strongest."""
    claims = {
        kind: max(task.claim(episode, topic) for task in TASKS.values() if task.kind == kind)
        for kind in KINDS
    }
    best = max(claims.values())
    return tuple(kind for kind, claim in claims.items() if claim and claim == best)
