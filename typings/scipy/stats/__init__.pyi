# What confidence intervals need; everything else of scipy is read from where it is installed.
from typing import Any

import numpy as np

class _StudentT:
    def ppf(self, q: float, df: float) -> float: ...

t: _StudentT

def sem(a: np.ndarray) -> float: ...
def __getattr__(name: str) -> Any: ...
