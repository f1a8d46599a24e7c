"""Python interface: every command as a function, and the types that it takes and returns.

```python
import analysis.api as tunenet

tuning = tunenet.tune("drop.mcap")
print(tuning.verdict, tuning.reason)
print(tuning.to_frame())
tunenet.review(tuning, "drop.rrd")
```

Nothing here prints or exits. A log that cannot be tuned gives a tuning whose verdict is "rejected",
with the reason. Wrong options raise `UsageError`, unreadable or unwritable files `LogError`; both
are a `TuneNetError`.
"""

from analysis.api.episodes import (
    episode_of_joints,
    episode_of_positions,
    read_episode,
    save_episode,
    simulate,
)
from analysis.api.results import (
    compare,
    export,
    read_tuning,
    report,
    review,
    review_campaign,
    save_arm_card,
    save_tuning,
)
from analysis.api.tuning import Reviewed, tune, tune_all
from analysis.checks import Check, CrossCheck
from analysis.comparison import Comparison
from analysis.motion import (
    Curves,
    Equivalent,
    Equivalents,
    Motion,
    SimulationFit,
    SoundShare,
    Units,
)
from analysis.record import Estimate, Provenance, Rebound, Record, Tuning
from analysis.tune_options import TuneOptions
from recorders.filmed_drop import FilmOrder
from recorders.simulated_drop import DropOrder
from recorders.simulated_payload import PayloadOrder
from recorders.simulated_shot import ShotOrder
from recorders.simulators.balls import BALLS, Ball
from tunenet_logs.episode import Episode, EpisodeInfo, Frame, Signal
from tunenet_logs.errors import LogError, NotFoundError, TuneNetError, UsageError, WeightsError
from tunenet_logs.formats.read_options import ReadingOptions

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
    "ReadingOptions",
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
