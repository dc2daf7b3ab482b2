"""What errors of data and contrasts do to the medium of a slab that is fitted to them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from analysis.phase_function import Array
from analysis.slab_profiles import Problem

Orders = Callable[[float, float], list[Array]]


def gain(problem: Problem, orders: Orders, at: Array) -> Array:
    """Return what errors of data and contrasts do to (sigma_t, albedo, g, scale of white light).

    The scales are fitted along; errors are in units of their std, so that the rows' products are
    the covariance: (4, n_data + n_q).
    """

    def model(p: Array) -> Array:
        return problem.profiles(orders(p[0], p[2]), p[0], p[1])

    here = model(at)
    scales, _ = problem.scaled(here)
    n_q = problem.ratio.size
    nothing = np.zeros(n_q)
    columns = []

    def told(change: Array, of_contrast: Array) -> Array:
        return np.concatenate([(change / problem.std)[problem.use], of_contrast])

    for i, step in enumerate((1e-3 * at[0], 1e-4, 1e-3)):
        ahead, behind = at.copy(), at.copy()
        ahead[i] += step
        behind[i] -= step
        change = scales[: len(here), None] * (model(ahead) - model(behind)) / (2.0 * step)
        columns.append(told(change, nothing))
    off = scales[:-1] / (scales[-1] * problem.ratio * problem.ratio_std)
    for i, shape in enumerate(here):
        change = np.zeros_like(here)
        change[i] = shape
        of_contrast = np.where(np.arange(n_q) == i, off, 0.0) / scales[i]
        columns.append(told(change, of_contrast if i < n_q else -off / scales[-1]))
    if len(here) == n_q:
        columns.append(told(np.zeros_like(here), -off / scales[-1]))
    jacobian = np.array(columns)
    size = np.linalg.norm(jacobian, axis=1)  # scales are as large as the light is bright
    size[size == 0.0] = 1.0
    found = np.linalg.pinv((jacobian / size[:, None]).T, rcond=1e-10) / size[:, None]
    return np.asarray(found)[[0, 1, 2, 3 + n_q]]
