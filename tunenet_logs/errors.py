"""Errors that users see: each names the file or value, what is wrong, and the remedy."""

from pathlib import Path
from typing import Self


class TuneNetError(Exception):
    """Root of every error this project raises on purpose; shown as one line, without traceback.

    `what` is wrong, and where; the `remedy`, an order, stands last: "" where `what` ends with it.
    """

    exit_code = 1

    def __init__(self, what: object = "", remedy: str = "") -> None:
        self.what, self.remedy = str(what), remedy
        super().__init__(f"{what}; {remedy}" if remedy else self.what)

    def renamed(self, old: object, new: object) -> Self:
        """Return the error with another name for its subject, its remedy kept apart."""
        return type(self)(self.what.replace(str(old), str(new)), self.remedy)


# The remedy for a file that is not whole, or not what a recorder writes.
COPY_AGAIN = "copy it again, or record again"
EXPORT_AGAIN = "copy or export it again"  # the remedy for a table or an export that is not whole
# The remedy for a file that the system does not give.
CHECK_DISK = "check its path, its permissions and its disk"


def pip_install(extra: str) -> str:
    """Return the command that installs an extra: of a clone in its folder, else by its name."""
    is_clone = (Path(__file__).resolve().parents[1] / "pyproject.toml").is_file()
    return f"pip install -e '.[{extra}]'" if is_clone else f"pip install 'tunenet-logs[{extra}]'"


class UsageError(TuneNetError):
    """Invalid value of an argument or option (exit code 2)."""

    exit_code = 2


class LogError(TuneNetError):
    """Log that cannot be read or written."""


class CameraError(TuneNetError):
    """Camera or video that cannot be recorded."""


class CameraAwayError(CameraError):
    """Network camera that does not answer, perhaps not yet: a retry may help."""


class MicrophoneError(TuneNetError):
    """Microphone that cannot be recorded."""


class TopicError(TuneNetError):
    """Live topic that cannot be recorded."""


class WeightsError(TuneNetError):
    """Network weights that are damaged, or meant for something else."""


class NotFoundError(TuneNetError):
    """Recording that does not show the experiment; the message is the reason to report."""
