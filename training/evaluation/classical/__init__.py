"""Classical depth completion without training: what a network has to beat.

Each method is a file with a frozen dataclass of its settings. `METHODS` names all of them.
"""

from collections.abc import Callable

from runtime.base.arguments import shown
from runtime.base.errors import InputError
from training.evaluation.classical.ip_basic import IPBasic, IPBasicMultiscale
from training.evaluation.classical.linear import Linear
from training.evaluation.classical.method import CompletionMethod
from training.evaluation.classical.mrf import MRF
from training.evaluation.classical.nearest import Nearest
from training.evaluation.classical.planes import Planes
from training.evaluation.classical.tgv import TGV

__all__ = ["METHODS", "CompletionMethod", "create_method"]

# What makes each method with its default settings; a new method is a line here.
METHODS: dict[str, Callable[[], CompletionMethod]] = {
    "nearest": Nearest,
    "linear": Linear,
    "planes": Planes,
    "ip-basic": IPBasic,
    "ip-basic-multiscale": IPBasicMultiscale,
    "mrf": MRF,
    "tgv": TGV,
}


def create_method(name: str) -> CompletionMethod:
    """Make a method of `METHODS` with its default settings.

    Raises:
        InputError: if the name is unknown.
    """
    if name not in METHODS:
        raise InputError(f"unknown method {shown(name)}: give one of {', '.join(METHODS)}")
    return METHODS[name]()
