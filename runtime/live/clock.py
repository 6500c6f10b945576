"""The clock that a stream waits by, so that a test can put another in its place."""

import threading
import time


class MonotonicClock:
    """Time that never goes back, from an arbitrary start."""

    def now_ns(self) -> int:
        """Nanoseconds since that start."""
        return time.monotonic_ns()

    def wait(self, changed: threading.Condition, timeout_ns: int | None) -> None:
        """Wait until `changed`, which is held, is notified or the time is over; None = for ever."""
        changed.wait(None if timeout_ns is None else max(timeout_ns, 0) / 1e9)
