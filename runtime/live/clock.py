"""The clock of a stream, which tests replace."""

import threading
import time


class MonotonicClock:
    """Time that never goes back, from an arbitrary start."""

    def now_ns(self) -> int:
        """Nanoseconds since that start."""
        return time.monotonic_ns()

    def wait(self, changed: threading.Condition, timeout_ns: int | None) -> None:
        """Wait until `changed`, whose lock is held, is notified; None = without a limit."""
        changed.wait(None if timeout_ns is None else max(timeout_ns, 0) / 1e9)
