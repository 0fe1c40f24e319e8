from collections.abc import Sequence
from typing import Self

import numpy as np
from mujoco import MjData, MjModel

class Rollout:
    def __init__(self, *, nthread: int | None = None) -> None: ...
    def __enter__(self) -> Self: ...
    def __exit__(self, *error: object) -> None: ...
    def rollout(
        self,
        model: MjModel | Sequence[MjModel],
        data: MjData | Sequence[MjData],
        initial_state: np.ndarray,
        control: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]: ...
