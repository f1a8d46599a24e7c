"""The errors that users see: each names the file or value, what is wrong, and the remedy."""

from typing import Self


class TuneNetError(Exception):
    """Root of every error this project raises on purpose; shown as one line, without traceback.

    Attributes:
        what: is wrong, and where.
        remedy: what to do about it, an order or "at the next drop: ..."; "" where `what` ends with
            it. It stands last in the line.

    Args:
        what: see there.
        remedy: see there.
    """

    exit_code = 1

    def __init__(self, what: object = "", remedy: str = "") -> None:
        self.what, self.remedy = str(what), remedy
        super().__init__(f"{what}; {remedy}" if remedy else self.what)

    def renamed(self, old: object, new: object) -> Self:
        """The same error with another name for what it is about, its remedy kept apart."""
        return type(self)(self.what.replace(str(old), str(new)), self.remedy)


COPY_AGAIN = "copy it again, or record again"
"""The remedy for a file that is not whole, or not what a recorder writes."""

EXPORT_AGAIN = "copy or export it again"
"""The remedy for a table or an export that is not whole."""

CHECK_DISK = "check its path, its permissions and its disk"
"""The remedy for a file that the system does not give."""


class UsageError(TuneNetError):
    """A value that was asked for makes no sense (exit code 2)."""

    exit_code = 2


class LogError(TuneNetError):
    """A log that cannot be read or written."""


class CameraError(TuneNetError):
    """A camera or video that cannot be recorded."""


class CameraAwayError(CameraError):
    """A network camera that is not there, or not yet: asked again, it may be."""


class MicrophoneError(TuneNetError):
    """A microphone that cannot be recorded."""


class TopicError(TuneNetError):
    """A live topic that cannot be recorded."""


class WeightsError(TuneNetError):
    """Network weights that are damaged, or meant for something else."""


class NotFoundError(TuneNetError):
    """A recording that does not show the experiment; the message is the reason to report."""
