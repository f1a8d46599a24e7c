"""Tune one log, or many."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Iterable
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Literal, Unpack

from analysis.record import Tuning
from analysis.tune_options import AnyPath, TuneOptions, ball_doubts, options_of
from tunenet_logs.episode import Episode
from tunenet_logs.errors import UsageError
from tunenet_logs.progress import Listener, heard_by
from tunenet_logs.terminal import Bar, Progress

if TYPE_CHECKING:
    import pandas as pd  # pyright: ignore[reportMissingTypeStubs] (it ships its own types)

    from analysis.selection import Options
    from recorders.simulators.base import Simulator

Reviewed = Literal["all", "none", "ok", "suspect", "rejected"]
"""Which logs get a review: all, none, or those of one verdict."""


def tune(
    source: AnyPath | Episode,
    *,
    simulator: Simulator | None = None,
    name: str = "episode",
    engine: str | None = None,
    progress: Listener | None = None,
    **options: Unpack[TuneOptions],
) -> Tuning:
    """Tune from one log, as `tunenet-tune` does; nothing is written.

    Args:
        source: A log's path, its address (`s3://...`), or an episode in memory.
        simulator: The user's own, with `parameters` and `rollout(values) -> Episode`, whose signals
            are named as the log's; None for the experiments, or the option `model`.
        name: Name of an episode in memory in the result.
        engine: "pybullet" or "mujoco"; None for the first that is installed. It is chosen for the
            whole process while this runs.
        progress: Called with the present stage in words, and its fraction done, from 0 to 1.
        **options: Those of the command; see `TuneOptions`.

    Returns:
        The tuning. It holds the episode's samples; its `record` does not: keep that of many logs. A
        log that cannot be read or tuned has the verdict "rejected".

    Raises:
        UsageError: An option is invalid, or fits no log.
        WeightsError: The weights are damaged, or of another network.
    """
    from analysis.provenance import provenance_of
    from analysis.result_files import log_sha256
    from analysis.tuning import tune_episode, tune_log
    from recorders.simulators.engines import simulated_by

    with simulated_by(engine), heard_by(progress):
        if isinstance(source, Episode):
            chosen = _with(simulator, options_of(options))
            tuning = tune_episode(source, chosen, Path(name))
            sha256 = ""
        else:
            with _here(source) as path:
                chosen = _with(simulator, options_of(options, [path]))
                tuning = tune_log(path, chosen)
                sha256 = ""
                with suppress(OSError):  # the tuning says why
                    sha256 = log_sha256(path)
    for doubt in ball_doubts(options, chosen.selection.ball):
        warnings.warn(doubt, stacklevel=2)
    return replace(tuning, provenance=provenance_of(tuning, sha256, chosen))


def _with(simulator: Simulator | None, options: Options) -> Options:
    """Add the user's own simulator to the options, if there is one."""
    if simulator is None:
        return options
    from analysis.sysid.source import GivenSimulator

    if options.source is not None or options.task is not None:
        raise UsageError("simulator does not go with model or task; leave them out")
    return replace(options, source=GivenSimulator(simulator))


@contextmanager
def _here(source: AnyPath) -> Generator[Path]:
    """Open the log as a local file; one at an address is copied and removed on exit."""
    from analysis.batch.found_logs import is_remote

    if not is_remote(str(source)):
        yield Path(source)
        return
    from analysis.batch.remote_logs import fetched, log_address

    with fetched(log_address(str(source))) as path:
        yield path


class _Counted:
    """Progress bar that calls a listener."""

    def __init__(self, listener: Listener, what: str, total: int) -> None:
        self._listener, self._what, self._total = listener, what, total
        self._done = 0

    def update(self, done: int, /) -> None:
        """Count `done` more items."""
        self._done += done
        self._listener(self._what, self._done / max(self._total, 1))

    def set_postfix_str(self, text: str, /, *, refresh: bool) -> None:
        """Show nothing."""


@dataclass(frozen=True, kw_only=True)
class _HeardByFunction(Progress):
    """Progress that is reported to a function instead of the terminal."""

    quiet: bool = True
    listener: Listener | None = None

    @contextmanager
    def stages(self, name: str) -> Generator[None]:  # noqa: ARG002 (one log has no need of it)
        """See `Progress.stages`."""
        with heard_by(self.listener):
            yield

    @contextmanager
    def bar(self, total: int | None, what: str, unit: str) -> Generator[Bar]:
        """See `Progress.bar`."""
        if self.listener is None:
            with super().bar(total, what, unit) as bar:
                yield bar
        else:
            yield _Counted(self.listener, what, total or 0)


def tune_all(
    logs: AnyPath | Iterable[AnyPath],
    folder: AnyPath,
    *,
    resume: bool = False,
    reviewed: Reviewed = "all",
    overwrite: bool = False,
    jobs: int | None = None,
    ray: str | None = None,
    engine: str | None = None,
    progress: Listener | None = None,
    **options: Unpack[TuneOptions],
) -> pd.DataFrame:
    """Tune many logs on all cores, as `tunenet-tune LOGS -o FOLDER` does.

    Args:
        logs: Files, folders (searched recursively), patterns such as "runs/**/*.mcap", addresses.
        folder: Folder of the results: a JSON and a review of each log, and the ledger.
        resume: Whether to skip logs that the ledger has, unchanged, under the same options.
        reviewed: Which logs get a review: "all", "none", or those of one verdict.
        overwrite: Whether results of other logs may be replaced.
        jobs: Number of processes; None for all cores.
        ray: A Ray cluster's HOST:PORT, "auto" or "local"; None for processes of this machine.
        engine: See `tune`.
        progress: See `tune`; the fraction is that of the logs.
        **options: Options of every log; see `TuneOptions`.

    Returns:
        The ledger, a row per log, with columns `log`, `verdict`, `reason`, each parameter with its
        interval, and more; see docs/scale.md.

    Raises:
        UsageError: An option is invalid, or a place holds no log.
        LogError: The results cannot be written.
    """
    from analysis.batch.found_logs import find_logs
    from analysis.batch.ledger import read_ledger
    from analysis.batch.one_log import Writing
    from analysis.batch.run import Order, run_batch
    from analysis.batch.summary import closing
    from recorders.simulators.engines import simulated_by

    named = [logs] if isinstance(logs, str | PathLike) else list(logs)
    places = [str(one) if "://" in str(one) else Path(one) for one in named]
    verdicts = {"all": Writing().reviewed, "none": frozenset[str]()}
    writing = Writing(overwrite, verdicts.get(reviewed, frozenset([reviewed])))
    found = find_logs(places)
    chosen = options_of(options, [one.log for one in found.logs if isinstance(one.log, Path)])
    order = Order(found.logs, chosen, writing, Path(folder), keeps_ledger=True, resumes=resume)
    stream = None
    if ray is not None:
        from analysis.batch.ray_cluster import on_ray
        from analysis.cluster import Cluster

        stream = partial(on_ray, Cluster(ray, jobs))
    with simulated_by(engine):
        batch = run_batch(
            order,
            _HeardByFunction(listener=progress),
            stream,
            jobs,
            after=partial(closing, order, None),
        )
    assert batch.ledger is not None
    return read_ledger(batch.ledger)
