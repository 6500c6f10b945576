"""The facts at the end of the report page."""

import sys
from collections.abc import Mapping
from typing import Any

from runtime.io.engine_facts import EngineFacts

_LIBRARIES = {"onnxruntime": "ONNX Runtime", "cv2": "OpenCV", "numpy": "NumPy"}


def collect_facts(
    engine: EngineFacts, heading: str, more: Mapping[str, Any]
) -> dict[str, dict[str, str]]:
    """Return heading -> name -> value: facts of model, engine and machine, and a further group."""
    model, provider, machine = engine.model, engine.provider, engine.machine
    canonical, first_ms = model.canonical_focal_px, engine.first_inference_ms
    nodes = provider.nodes or {}
    running = (
        name + (f" ({nodes[name]} nodes)" if name in nodes else "") for name in provider.running
    )
    groups: dict[str, Mapping[str, Any]] = {
        "Model": {
            "name": model.name,
            "file": model.path,
            "SHA-256": model.sha256,
            "answers": ", ".join(model.heads),
            "precision": model.precision,
            "depth range": f"{model.max_depth_m:g} m",
            "trained height": model.trained_height,
            "canonical focal length": canonical and f"{canonical:g} px",
        },
        heading: more,
        "Engine": {
            "requested": provider.asked,
            "runs on": ", ".join(running),
            "threads": provider.threads,
            "load": f"{engine.load_ms:.0f} ms",
            "first inference": first_ms and f"{first_ms:.1f} ms",
        },
        "Machine and versions": {
            "processor": machine.processor,
            "logical cores": machine.logical_cores,
            "system": machine.system,
            "ssdnet": engine.ssdnet,
            # Of the libraries that this process has loaded.
            **{
                title: getattr(sys.modules.get(name), "__version__", None)
                for name, title in _LIBRARIES.items()
            },
            "Python": machine.python,
        },
    }
    return {
        title: {name: str(value) for name, value in group.items() if value not in (None, "")}
        for title, group in groups.items()
    }
