"""Every method of depth completion by name."""

from collections.abc import Callable, Mapping

from runtime.completion.ip_basic import IPBasic, IPBasicMultiscale
from runtime.completion.method import CompletionMethod
from runtime.completion.mrf import MRF
from runtime.completion.nearest import Nearest
from runtime.completion.tgv import TGV
from runtime.errors import InputError

#: Name -> what makes the method with its default settings; a new one is a line here.
METHODS: Mapping[str, Callable[[], CompletionMethod]] = {
    "nearest": Nearest,
    "ip-basic": IPBasic,
    "ip-basic-multiscale": IPBasicMultiscale,
    "mrf": MRF,
    "tgv": TGV,
}


def create_method(name: str) -> CompletionMethod:
    """Make a method by name.

    Raises InputError for an unknown name, ProviderError where a package that it needs is missing.
    """
    if name not in METHODS:
        raise InputError(f"unknown method {name!r:.80}; known: {', '.join(METHODS)}")
    return METHODS[name]()
