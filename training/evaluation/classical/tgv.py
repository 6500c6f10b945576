"""Completion by total generalised variation: planes that end where the image has edges.

Ferstl, Reinbacher, Ranftl, Ruether and Bischof, "Image Guided Depth Upsampling using Anisotropic
Total Generalized Variation", ICCV 2013. The depth u and its slope v, a vector for each pixel,
minimise

    smoothness * sum |T^(1/2) (grad u - v)| + slope_smoothness * sum |grad v|
        + data_weight * sum over returns (u - depth)^2

A plane in the depth map costs nothing. In the tensor T^(1/2) = e n n' + m m', n is the direction of
the image's gradient and m that along its edge; e = exp(-edge_sharpness * |gradient|^edge_exponent)
makes steps of the depth across edges cheap.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from runtime.contract.resize import move_returns, resize_image
from training.evaluation.classical.method import Depth
from training.evaluation.classical.nearest import Nearest

_COARSEST_SIDE = 24  # of the pyramid on which the iterations start
# For the symmetric tensor [[a, c], [c, b]], |a| + |c| is at most (1 + sqrt 2) / 2.
_TENSOR_NORM = 1.21


@dataclass(frozen=True)
class TGV:
    """Anisotropic total generalised variation with primal-dual iterations.

    The iterations are those of Chambolle and Pock 2011 with the step sizes of Pock and Chambolle
    2011, in float32. They start at the coarsest level of a pyramid with the nearest filling, and on
    each other level with the result of the coarser one, because a gap of many pixels would need
    thousands of iterations on the finest level alone. The depth lies between the smallest and the
    largest return. A single return fills the frame.

    Attributes:
        smoothness: cost of a step of the depth [1/m], alpha_1 of the paper.
        slope_smoothness: cost of a change of its slope [1/m], alpha_0.
        data_weight: weight of the squared error at returns [1/m^2]; all returns have the same.
        edge_sharpness: beta, for grey values in 0..1.
        edge_exponent: gamma, for the same values.
        iterations: number of iterations on each level of the pyramid.
    """

    smoothness: float = 0.1
    slope_smoothness: float = 0.1
    data_weight: float = 1.0
    edge_sharpness: float = 9.0
    edge_exponent: float = 0.85
    iterations: int = 150

    def complete(self, rgb: NDArray[np.uint8], sparse_depth: Depth) -> Depth:
        """See `CompletionMethod.complete`."""
        height, width = sparse_depth.shape
        half = -(-height // 2), -(-width // 2)
        if min(half) < _COARSEST_SIDE:
            start = Nearest().complete(rgb, sparse_depth)
        else:
            coarse = self.complete(resize_image(rgb, half), move_returns(sparse_depth, half))
            start = np.asarray(cv2.resize(coarse, (width, height)), dtype=np.float32)
        return self._minimise(start, edge_tensor(rgb, self), sparse_depth)

    def _minimise(
        self, start: NDArray[np.float32], tensor: NDArray[np.float32], sparse_depth: Depth
    ) -> Depth:
        """Iterate on one level from `start` (H, W); returns lie where `sparse_depth` is not 0."""
        measured = sparse_depth > 0
        low, high = sparse_depth[measured].min(), sparse_depth[measured].max()
        alpha_1, alpha_0 = self.smoothness, self.slope_smoothness
        # Inverse sums of the entries in each row and column of the operator.
        tensor_row = np.stack([abs(tensor[0]) + abs(tensor[2]), abs(tensor[1]) + abs(tensor[2])])
        step_p = (1 / (3 * alpha_1 * tensor_row)).astype(np.float32)
        step_q = 1 / (2 * alpha_0)
        step_u = 1 / (4 * _TENSOR_NORM * alpha_1)
        step_v = 1 / (_TENSOR_NORM * alpha_1 + 4 * alpha_0)
        pull = np.where(measured, np.float32(2 * self.data_weight * step_u), np.float32(0))
        inside = _has_successor(start.shape)

        u = u_bar = start
        v = v_bar = np.zeros((2, *start.shape), dtype=np.float32)
        p, q = np.zeros_like(v), np.zeros((2, *v.shape), dtype=np.float32)
        for _ in range(self.iterations):
            p += alpha_1 * step_p * _multiply(tensor, _gradient(u_bar) - inside * v_bar)
            p /= np.maximum(1, np.sqrt(np.square(p).sum(axis=0)))
            q += alpha_0 * step_q * _gradient(v_bar)
            q /= np.maximum(1, np.sqrt(np.square(q).sum(axis=(0, 1))))

            force = alpha_1 * _multiply(tensor, p)
            u_new = u - step_u * _gradient_adjoint(force)
            u_new = np.clip((u_new + pull * sparse_depth) / (1 + pull), low, high)
            v_new = v + step_v * (inside * force - alpha_0 * _gradient_adjoint(q))
            u_bar, v_bar = 2 * u_new - u, 2 * v_new - v
            u, v = u_new, v_new
        return u


def edge_tensor(rgb: NDArray[np.uint8], method: TGV) -> NDArray[np.float32]:
    """Return T^(1/2) of each pixel, symmetric: its entries xx, yy and xy as float32 (3, H, W)."""
    grey = np.divide(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), 255, dtype=np.float32)
    gradient = _gradient(grey)
    length = np.sqrt(np.square(gradient).sum(axis=0))
    x, y = gradient / np.maximum(length, 1e-6)  # (0, 0), which is isotropic, for a flat pixel
    across = 1 - np.exp(-method.edge_sharpness * length**method.edge_exponent)
    return np.stack([1 - across * x * x, 1 - across * y * y, -across * x * y])


def _gradient(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return forward differences along x and y, (2, ..., H, W), 0 at the last column or row."""
    gradient = np.zeros((2, *values.shape), dtype=np.float32)
    np.subtract(values[..., 1:], values[..., :-1], out=gradient[0][..., :-1])
    np.subtract(values[..., 1:, :], values[..., :-1, :], out=gradient[1][..., :-1, :])
    return gradient


def _gradient_adjoint(field: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the adjoint of `_gradient`, the negative divergence, (2, ..., H, W) to (..., H, W)."""
    sums = np.zeros(field.shape[1:], dtype=np.float32)
    sums[..., 1:] += field[0][..., :-1]
    sums[..., :-1] -= field[0][..., :-1]
    sums[..., 1:, :] += field[1][..., :-1, :]
    sums[..., :-1, :] -= field[1][..., :-1, :]
    return sums


def _multiply(tensor: NDArray[np.float32], field: NDArray[np.float32]) -> NDArray[np.float32]:
    """Multiply the symmetric tensor (3, H, W) with a vector field (2, H, W)."""
    xx, yy, xy = tensor
    return np.stack([xx * field[0] + xy * field[1], xy * field[0] + yy * field[1]])


def _has_successor(shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return 1 where `_gradient` has a difference, else 0, as v is free there: (2, H, W)."""
    inside = np.ones((2, *shape), dtype=np.float32)
    inside[0][:, -1] = 0
    inside[1][-1] = 0
    return inside
