"""Code of other packages that fails: an error that names it, instead of a traceback."""

import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from runtime.base.arguments import cut
from runtime.base.errors import InputError, SSDNetError
from training.base.stop_signal import StopRequested


def is_of_loader(error: BaseException) -> bool:
    """Whether PyTorch's loader of batches lost a worker, or waits for one in vain."""
    return isinstance(error, RuntimeError) and str(error).startswith("DataLoader")


@contextmanager
def named_errors(what: str, but: type[Exception] = SSDNetError) -> Iterator[None]:
    """Raise an exception of the block as an InputError: what failed, how, and on which line.

    Exceptions of this project, and of the type `but`, are raised as they are.
    """
    try:
        yield
    except (SSDNetError, StopRequested, but):
        raise
    except Exception as error:
        if is_of_loader(error):  # a signal handler raises it wherever the process is
            raise
        *_, place = traceback.extract_tb(error.__traceback__)
        text = f"{type(error).__name__}: {cut(str(error), 300)}".replace("\n", " ")
        line = f"{Path(place.filename).name}, line {place.lineno}"
        raise InputError(f"{what} failed with {text} ({line}): correct it") from error
