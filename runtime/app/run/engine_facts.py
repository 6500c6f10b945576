"""What a report states about the model, the execution provider, and the machine."""

import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

import runtime
from runtime.command.machine import machine_facts
from runtime.engine.predictor import Predictor

_LIBRARIES = ("onnxruntime", "cv2", "numpy")  # libraries that a predictor loads


def engine_facts(predictor: Predictor) -> dict[str, Any]:
    """Return what a report states about a predictor and this machine, ready for JSON.

    Returns:
        "ssdnet", the version of this package; "model", the file and how it is run, with sizes as
        (height, width) and lengths in pixels; "provider", the requested provider, the providers of
        the session with the number of graph nodes that each runs, and the threads of inference;
        "machine", see `MachineFacts`; "libraries", the versions by import name; "load_ms", the time
        of reading and optimising the model; and "first_inference_ms". A value is None if it is
        unknown or does not exist.
    """
    contract, is_free_size = predictor.contract, predictor.model.size is None
    return {
        "ssdnet": runtime.__version__,
        "model": {
            "name": contract.model_name,
            "path": str(predictor.model.path),
            "sha256": predictor.model.sha256,
            "precision": contract.precision,
            "fixed_size": None if is_free_size else predictor.network_size(contract.native_size),
            "size_asked": predictor.size if is_free_size else None,
            "trained_height": contract.trained_height,
            "canonical_focal_px": contract.canonical_focal_px,
            "heads": predictor.heads,
            "max_depth_m": contract.max_depth_m,
        },
        "provider": {
            "asked": predictor.provider,
            "running": predictor.providers,
            "nodes": predictor.node_counts,
            "threads": predictor.threads,
        },
        "machine": asdict(machine_facts()),
        "libraries": {name: sys.modules[name].__version__ for name in _LIBRARIES},
        "load_ms": predictor.load_ms,
        "first_inference_ms": predictor.first_inference_ms,
    }


def running_providers(names: Sequence[str], nodes: Mapping[str, int]) -> list[str]:
    """The execution providers in use, with the number of nodes that each runs."""
    return [f"{name} {nodes[name]} nodes" for name in names if name in nodes]
