from collections.abc import Callable

import numpy as np

class OptimizeResult:
    x: np.ndarray
    cost: float
    nfev: int

def least_squares(
    fun: Callable[[np.ndarray], np.ndarray],
    x0: np.ndarray,
    jac: Callable[[np.ndarray], np.ndarray],
    bounds: tuple[np.ndarray, np.ndarray],
    *,
    loss: str,
    f_scale: float,
    x_scale: np.ndarray,
    max_nfev: int,
) -> OptimizeResult: ...
