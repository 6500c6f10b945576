"""The progress of a training on stderr: a bar in a terminal, lines in a log file."""

import sys
import time

from torch import Tensor
from tqdm import tqdm

#: Time between two lines of a log file [s].
LINE_INTERVAL_S = 30.0
#: Time between two losses beside the bar [s].
_BAR_INTERVAL_S = 1.0


class Progress:
    """Shows step, loss, rate, speed and time left, or nothing if not ``shown``."""

    def __init__(self, steps: int, step: int, *, shown: bool) -> None:
        self._bar = tqdm(
            total=steps,
            initial=step,
            desc="train",
            unit="step",
            disable=None if shown else True,  # None: without a terminal
        )
        self._shown, self._steps, self._first_step = shown, steps, step
        self._start_s = self._shown_s = time.monotonic()

    def update(self, step: int, loss: Tensor, rate: float) -> None:
        """Count a step; the loss is read from its device only when it is shown."""
        self._bar.update()
        now_s = time.monotonic()
        interval_s = LINE_INTERVAL_S if self._bar.disable else _BAR_INTERVAL_S
        if not self._shown or now_s - self._shown_s <= interval_s:
            return
        self._shown_s = now_s
        if not self._bar.disable:
            self._bar.set_postfix(loss=f"{loss.item():.3f}")
            return
        speed = (step - self._first_step) / (now_s - self._start_s)
        left = tqdm.format_interval((self._steps - step) / speed)
        tqdm.write(
            f"step {step} of {self._steps}, loss {loss.item():.3f}, learning rate {rate:.2g}, "
            f"{speed:.2f} steps/s, {left} left",
            file=sys.stderr,
        )

    def close(self) -> None:
        """Leave the bar as it is."""
        self._bar.close()
