"""The errors this project raises on purpose: one small family, each text says what to do."""


class SSDNetError(Exception):
    """Base of every error raised on purpose by this project."""


class ContractError(SSDNetError):
    """A model file is missing, damaged, foreign, or of a version this engine does not know."""


class InputError(SSDNetError):
    """An array, file or folder handed in is not what was asked for."""


class OutputError(SSDNetError):
    """A result cannot be written where it was asked to go."""


class ProviderError(SSDNetError):
    """The execution provider that was asked for is not what would run."""


class InferenceError(SSDNetError):
    """The inference session failed while running, or was used after it was closed."""


class CheckpointError(SSDNetError):
    """A training checkpoint is foreign, truncated, or newer than this code."""


class DatasetError(SSDNetError):
    """A data set folder or one of its files is not what its layout promises."""
