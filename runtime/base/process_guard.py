"""Protection of objects that can be used only in the process that created them."""

import os

from runtime.base.errors import InferenceError, SSDNetError

_THREADS = "threads do not survive a fork"
# Reason for an object that holds files open.
SHARED_FILES = "after a fork both processes would read from one position in its files"


class ProcessGuard:
    """Remembers the process that made an object.

    Args:
        what: name of the object, for the error.
        why: the reason why the object cannot be used after a fork.
        error: type of the error that `check` raises.
    """

    def __init__(
        self, what: str, why: str = _THREADS, error: type[SSDNetError] = InferenceError
    ) -> None:
        self._what, self._why, self._error, self._process = what, why, error, os.getpid()

    @property
    def is_forked(self) -> bool:
        """Whether the present process is a fork of the one that created the object."""
        return os.getpid() != self._process

    def check(self) -> None:
        """Raise the error if the present process is a fork."""
        if self.is_forked:
            raise self._error(
                f"the {self._what} was created before this process was forked, and {self._why}: "
                f"create a {self._what} in each process"
            )
