# The parallel interface, as pettingzoo has it.
from typing import Any, Generic, TypeVar

import numpy as np
from gymnasium import spaces

_Agent = TypeVar("_Agent")
_Observation = TypeVar("_Observation")
_Action = TypeVar("_Action")

class ParallelEnv(Generic[_Agent, _Observation, _Action]):
    metadata: dict[str, Any]
    agents: list[_Agent]
    possible_agents: list[_Agent]
    observation_spaces: dict[_Agent, spaces.Space[Any]]
    action_spaces: dict[_Agent, spaces.Space[Any]]
    render_mode: str | None

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[_Agent, _Observation], dict[_Agent, dict[str, Any]]]: ...
    def step(
        self, actions: dict[_Agent, _Action]
    ) -> tuple[
        dict[_Agent, _Observation],
        dict[_Agent, float],
        dict[_Agent, bool],
        dict[_Agent, bool],
        dict[_Agent, dict[str, Any]],
    ]: ...
    def render(self) -> np.ndarray | str | list[Any] | None: ...
    def close(self) -> None: ...
    def state(self) -> np.ndarray: ...
    def observation_space(self, agent: _Agent) -> spaces.Space[Any]: ...
    def action_space(self, agent: _Agent) -> spaces.Space[Any]: ...

def __getattr__(name: str) -> Any: ...
