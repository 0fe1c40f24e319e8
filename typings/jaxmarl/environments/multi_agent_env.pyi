# A multi-agent environment; the state is each environment's own.
from typing import Any

from jaxmarl.environments.spaces import Box

class MultiAgentEnv:
    num_agents: int
    agents: list[str]
    observation_spaces: dict[str, Box]
    action_spaces: dict[str, Box]

    def __init__(self, num_agents: int) -> None: ...
    def observation_space(self, agent: str) -> Box: ...
    def action_space(self, agent: str) -> Box: ...
    # reset, step, step_env and get_obs are left out: their state is a class of JaxMARL's own there.

def __getattr__(name: str) -> Any: ...
