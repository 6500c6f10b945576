"""From a checkpoint to one verified, self-contained ONNX file of standard operators.

```python
from export import export_checkpoint

report = export_checkpoint("ckpt.pt", "model.onnx", size=(512, 1024))
```

The name is loaded on first use (PEP 562), since it needs PyTorch.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from export.exporter import export_checkpoint as export_checkpoint

__all__ = ["export_checkpoint"]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value = getattr(import_module("export.exporter"), name)
    return value
