"""The thread of a stream. It ends with the stream, even if the stream is never closed."""

import threading
import time
import weakref
from typing import Protocol

from runtime.base.process_guard import ProcessGuard

_EXIT_S = 10.0  # time that the exit of the interpreter waits for a prediction


class MonotonicClock:
    """The clock of a stream, which tests replace: time that never goes back."""

    def now_ns(self) -> int:
        """Nanoseconds since an arbitrary start."""
        return time.monotonic_ns()

    def wait(self, changed: threading.Condition, timeout_ns: int | None) -> None:
        """Wait until `changed`, whose lock is held, is notified; None: without a limit."""
        changed.wait(None if timeout_ns is None else max(timeout_ns, 0) / 1e9)


class ThreadedStream(Protocol):
    """A stream with the methods that its thread calls, and nobody else."""

    def _step(self) -> bool:
        """Do the work that is ready; return False at the end of the stream."""

    def _idle_ns(self) -> int | None:
        """Return how long there is no work unless something changes; None: for ever.

        It is called with the lock held.
        """

    def _fail(self, failure: BaseException) -> None:
        """End the stream after an error of `_step`."""

    def _discard_all(self) -> None:
        """Drop all messages and close the stream. It is called with the lock held."""


def start_thread(
    stream: ThreadedStream, changed: threading.Condition, clock: MonotonicClock, guard: ProcessGuard
) -> threading.Thread:
    """Start the thread of a stream, which references the stream only while it works.

    A stream without other references is therefore collected, which ends the thread. The exit of the
    interpreter also ends the thread, because it must not happen during a prediction.
    """
    reference = weakref.ref(stream)

    def run() -> None:
        while True:
            stream = reference()
            try:
                if stream is None or not stream._step():
                    return
                with changed:
                    idle_ns = stream._idle_ns()
                    stream = None  # collected here, or while this waits
                    if idle_ns != 0 and reference() is not None:
                        clock.wait(changed, idle_ns)
            except BaseException as failure:
                if stream := stream or reference():
                    stream._fail(failure)
                return

    thread = threading.Thread(target=run, name="ssdnet-stream", daemon=True)
    thread.start()

    def end() -> None:
        if guard.is_forked:
            return
        with changed:
            stream = reference()
            if stream is not None:  # at exit
                stream._discard_all()
            changed.notify_all()
        if stream is not None:
            thread.join(_EXIT_S)

    weakref.finalize(stream, end)
    return thread
