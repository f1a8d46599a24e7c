"""Record a robot experiment, tune the simulator's physics to it, and review both.

```python
import tunenet_logs as tn

tuning = tn.tune("drop.mcap")
print(tuning.verdict, tuning.reason)
tn.review(tuning, "drop.rrd")
```

This is the front door: what stands in `__all__` is all that is promised, and lives in
`tunenet_logs.analysis.api`. It is fetched when it is first asked for, so that `import tunenet_logs`
itself costs nothing: every command passes here. What a log is lies behind it.
"""

__version__ = "0.1.0"
TYPE_CHECKING = False  # `typing` costs a tenth of a command's start
if TYPE_CHECKING:
    from tunenet_logs.analysis.api import (
        BALLS,
        Ball,
        Check,
        Comparison,
        CrossCheck,
        Curves,
        DropOrder,
        Episode,
        EpisodeInfo,
        Equivalent,
        Equivalents,
        Estimate,
        FilmOrder,
        Frame,
        LogError,
        Motion,
        NotFoundError,
        PayloadOrder,
        Provenance,
        ReadOptions,
        Rebound,
        Record,
        Reviewed,
        ShotOrder,
        Signal,
        SimulationFit,
        SoundShare,
        TuneNetError,
        TuneOptions,
        Tuning,
        Units,
        UsageError,
        WeightsError,
        compare,
        episode_of_joints,
        episode_of_positions,
        export,
        read_episode,
        read_tuning,
        report,
        review,
        review_campaign,
        save_arm_card,
        save_episode,
        save_tuning,
        simulate,
        tune,
        tune_all,
    )

__all__ = [
    "BALLS",
    "Ball",
    "Check",
    "Comparison",
    "CrossCheck",
    "Curves",
    "DropOrder",
    "Episode",
    "EpisodeInfo",
    "Equivalent",
    "Equivalents",
    "Estimate",
    "FilmOrder",
    "Frame",
    "LogError",
    "Motion",
    "NotFoundError",
    "PayloadOrder",
    "Provenance",
    "ReadOptions",
    "Rebound",
    "Record",
    "Reviewed",
    "ShotOrder",
    "Signal",
    "SimulationFit",
    "SoundShare",
    "TuneNetError",
    "TuneOptions",
    "Tuning",
    "Units",
    "UsageError",
    "WeightsError",
    "compare",
    "episode_of_joints",
    "episode_of_positions",
    "export",
    "read_episode",
    "read_tuning",
    "report",
    "review",
    "review_campaign",
    "save_arm_card",
    "save_episode",
    "save_tuning",
    "simulate",
    "tune",
    "tune_all",
]

if not TYPE_CHECKING:  # a type checker is to complain of names that are not there

    def __getattr__(name: str) -> object:
        """Fetch a public name when it is first asked for."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        found = getattr(import_module(f"{__name__}.analysis.api"), name)
        globals()[name] = found
        return found


def __dir__() -> list[str]:
    """What is there, fetched or not."""
    return sorted({*globals(), *__all__})
