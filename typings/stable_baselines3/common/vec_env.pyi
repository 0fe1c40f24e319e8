# A vector environment, as stable_baselines3 has it.
from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

class VecEnv(ABC):
    num_envs: int
    render_mode: str | None
    reset_infos: list[dict[str, Any]]
    _seeds: list[int | None]

    def __init__(self, num_envs: int, observation_space: Any, action_space: Any) -> None: ...
    def _reset_seeds(self) -> None: ...
    def _reset_options(self) -> None: ...
    def _get_indices(self, indices: int | Iterable[int] | None) -> Iterable[int]: ...
    @abstractmethod
    def reset(self) -> np.ndarray: ...
    @abstractmethod
    def step_async(self, actions: np.ndarray) -> None: ...
    @abstractmethod
    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]: ...
    @abstractmethod
    def close(self) -> None: ...
    @abstractmethod
    def get_attr(self, attr_name: str, indices: int | Iterable[int] | None = None) -> list[Any]: ...
    @abstractmethod
    def set_attr(self, attr_name: str, value: Any, indices: int | Iterable[int] | None = None) -> None: ...
    @abstractmethod
    def env_method(
        self,
        method_name: str,
        *args: Any,
        indices: int | Iterable[int] | None = None,
        **kwargs: Any,
    ) -> list[Any]: ...
    @abstractmethod
    def env_is_wrapped(
        self, wrapper_class: type[Any], indices: int | Iterable[int] | None = None
    ) -> Sequence[bool]: ...
