# The interface of an environment; brax leaves some of its arguments without types.
from abc import ABC, abstractmethod
from typing import Any

from flax import struct
from jax import Array

class State(struct.PyTreeNode):
    pipeline_state: Any
    obs: Any
    reward: Array
    done: Array
    metrics: dict[str, Array] = ...
    info: dict[str, Any] = ...

class Env(ABC):
    @abstractmethod
    def reset(self, rng: Array) -> State: ...
    @abstractmethod
    def step(self, state: State, action: Array) -> State: ...
    @property
    @abstractmethod
    def observation_size(self) -> Any: ...
    @property
    @abstractmethod
    def action_size(self) -> int: ...
    @property
    @abstractmethod
    def backend(self) -> str: ...
    @property
    def unwrapped(self) -> Env: ...

def __getattr__(name: str) -> Any: ...
