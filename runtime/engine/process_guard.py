"""Objects whose threads do not survive a fork: usable only in the process that created them."""

import os

from runtime.base.errors import InferenceError


class ProcessGuard:
    """Remembers the process that made an object; `what` names the object."""

    def __init__(self, what: str) -> None:
        self._what, self._process = what, os.getpid()

    @property
    def is_forked(self) -> bool:
        """Whether this is a child of that process."""
        return os.getpid() != self._process

    def check(self) -> None:
        """Raise InferenceError in a child."""
        if self.is_forked:
            raise InferenceError(
                f"the {self._what} was created before this process was forked, and threads do "
                f"not survive a fork: create a {self._what} in each process"
            )
