"""The error that exporting adds to the family."""

from runtime.base.errors import SSDNetError


class ExportError(SSDNetError):
    """A network cannot be written as an ONNX file with the same answers."""
