"""From a checkpoint to one verified, self-contained ONNX file of standard operators.

```python
from export import export_checkpoint

report = export_checkpoint("ckpt.pt", "model.onnx", size=(512, 1024))
```

`Precision` names the precisions of a file, `ExportReport` is what the function returns, and
`ExportError` is raised if a network cannot be exported. All names are loaded on first use (PEP
562), since they need PyTorch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from export.errors import ExportError as ExportError
    from export.exporter import ExportReport as ExportReport
    from export.exporter import export_checkpoint as export_checkpoint
    from export.precision import Precision as Precision

_MODULES = {
    "ExportError": "export.errors",
    "ExportReport": "export.exporter",
    "Precision": "export.precision",
    "export_checkpoint": "export.exporter",
}
__all__ = [*_MODULES]


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module(_MODULES[name]), name)
    return value
