"""The errors that this project raises on purpose; each message says what to do."""


class SSDNetError(Exception):
    """Base of every error raised on purpose by this project."""


class ContractError(SSDNetError):
    """A model file is missing, damaged, foreign, or of a version this engine does not know."""


class InputError(SSDNetError):
    """An array, file, folder or argument is invalid."""


class OutputError(SSDNetError):
    """A result cannot be written to the given place."""


class ProviderError(SSDNetError):
    """The requested execution provider cannot be used."""


class InferenceError(SSDNetError):
    """The inference session failed while running, or was used after it was closed."""


class CheckpointError(SSDNetError):
    """A training checkpoint is foreign, truncated, or newer than this code."""


class DatasetError(SSDNetError):
    """A data set folder or one of its files does not have the expected layout."""


def install_command(extras: str) -> str:
    """Return the command by which the README installs these extras."""
    return f'pip install -c constraints.txt ".[{extras}]" in a clone of ssdnet'


def import_remedy(error: ImportError, extras: str) -> str:
    """Return the remedy for a failed import of a package that belongs to these extras."""
    if isinstance(error, ModuleNotFoundError):
        return install_command(extras)
    return "it is installed but cannot be loaded, ssdnet-doctor examines it"
