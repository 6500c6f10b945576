"""The run of a network, and the checks, conversion and resizing of its outputs."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from runtime.base.errors import InferenceError
from runtime.contract.contract import NO_CLASS, Contract
from runtime.contract.heads import HEADS, Head, Unit
from runtime.contract.resize import RESIZE
from runtime.engine.anchoring import move_to_returns
from runtime.engine.prediction import Latency, Prediction, ms_since
from runtime.engine.preprocess import NetworkInput
from runtime.engine.session import describe_error

_ROUNDING = 1e-3  # share of a head's range by which rounding may exceed it


def run_batch(
    session: Any, heads: Sequence[str], frames: Sequence[NetworkInput], contract: Contract
) -> list[dict[str, NDArray[Any]]]:
    """Run frames of one network size as one batch.

    Returns:
        A dictionary for each frame: head -> array.

    Raises:
        InferenceError: if the session fails, or an output has another type or shape.
    """
    size, count = frames[0].network_size, len(frames)
    feed = {
        "rgb": _stack([frame.rgb for frame in frames]),
        "sparse_depth": _stack([frame.sparse_depth for frame in frames]),
    }
    try:
        outputs = dict(zip(heads, session.run(heads, feed), strict=True))
    except Exception as error:
        several = f"{count} frames" if count > 1 else "a frame"
        raise InferenceError(
            f"the session failed on {several} of {size[0]} x {size[1]}: {describe_error(error)}"
        ) from error
    for head, values in outputs.items():
        planes = (len(contract.classes),) if HEADS[head].per_class else ()
        expected = HEADS[head].dtype, (count, *planes, *size)
        if (values.dtype.name, values.shape) != expected:
            raise InferenceError(
                f"the model gave {head} as {values.dtype} {values.shape}, expected "
                f"{' '.join(map(str, expected))}: export it again with ssdnet-export"
            )
    return [{head: values[index] for head, values in outputs.items()} for index in range(count)]


def _stack(arrays: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """Stack arrays of one shape; a single one is not copied."""
    return arrays[0][np.newaxis] if len(arrays) == 1 else np.stack(arrays)


def to_prediction(
    outputs: Mapping[str, NDArray[Any]],
    frame: NetworkInput,
    contract: Contract,
    inference_ms: float,
    *,
    stamp: Any,
) -> Prediction:
    """Return the answers for a frame.

    Args:
        outputs: head -> array, for this frame.
        frame: the input of the network.
        contract: the contract of the model.
        inference_ms: time of the session.
        stamp: stamp of the frame.
    """
    started = time.perf_counter()
    faults = output_faults(outputs, contract)
    heads = at_frame_size(outputs, frame)
    latency_ms = frame.preprocess_ms, inference_ms, ms_since(started)
    return Prediction(
        heads=heads,
        frame_size=frame.frame_size,
        network_size=frame.network_size,
        latency=Latency(*latency_ms, total_ms=sum(latency_ms)),
        valid=not faults,
        degraded=frame.degraded + faults,
        cleaned=frame.cleaned,
        depth_returns=frame.depth_returns,
        range_m=frame.scale.range_m,
        stamp=stamp,
        contract=contract,
    )


def at_frame_size(
    outputs: Mapping[str, NDArray[Any]], frame: NetworkInput
) -> dict[str, NDArray[Any]]:
    """Return a frame's outputs, head -> array, in metres and at the frame's size.

    The depth is moved to the frame's own returns, see `move_to_returns`; the given arrays may be
    changed.
    """
    if frame.scale.factor != 1:
        for name, values in outputs.items():
            if HEADS[name].unit is Unit.METRES:
                values *= np.float32(1 / frame.scale.factor)
    if frame.network_size == frame.frame_size:
        return dict(outputs)
    if frame.full_size_returns is not None and "depth" in outputs:
        predicted = outputs["depth"], outputs.get("depth_uncertainty")
        move_to_returns(*predicted, frame.full_size_returns, range_m=frame.scale.range_m)
    answers = {}
    for name, values in outputs.items():
        head = HEADS[name]
        resize, size = RESIZE[head.resize], frame.frame_size
        planes = [resize(plane, size) for plane in (values if head.per_class else [values])]
        answers[name] = np.stack(planes) if head.per_class else planes[0]
    return answers


def output_faults(outputs: Mapping[str, NDArray[Any]], contract: Contract) -> tuple[str, ...]:
    """Return the reasons why outputs, head -> array of one frame, cannot be used; () if they can.

    The reasons are "HEAD_not_finite", "HEAD_out_of_range" and, for class ids, "HEAD_unknown_class".
    """
    faults = (_fault(HEADS[head], values, contract) for head, values in outputs.items())
    return tuple(fault for fault in faults if fault)


def _fault(head: Head, values: NDArray[Any], contract: Contract) -> str:
    low, high = values.min(), values.max()  # NaN and Inf propagate to them
    if head.unit is Unit.CLASS_ID:
        if high == NO_CLASS:
            return f"{head.name}_not_finite"
        return "" if high < len(contract.classes) else f"{head.name}_unknown_class"
    if not (np.isfinite(low) and np.isfinite(high)):
        return f"{head.name}_not_finite"
    least, most = head.bounds(contract.max_depth_m)
    margin = _ROUNDING * (most - least) if np.isfinite(most - least) else 0.0
    return "" if least - margin <= low and high <= most + margin else f"{head.name}_out_of_range"
