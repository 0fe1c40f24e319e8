"""The interfaces of other libraries over `usarmjx.Env`; each needs its extra, as `rl`.

None of them computes anything: they hand the same numbers over under other names. Private: a module per
library, and `agents` with what they share. `tests/train/adapters` runs each library's own checkers. Begin
with `ParallelWorld`, the simplest.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.train.adapters.benchmarl import BenchmarlTask as BenchmarlTask
    from usarmjx.train.adapters.brax import BatchedRobots as BatchedRobots
    from usarmjx.train.adapters.gymnasium import TeamWorld as TeamWorld
    from usarmjx.train.adapters.gymnasium import VectorWorlds as VectorWorlds
    from usarmjx.train.adapters.gymnasium import register_ids as register_ids
    from usarmjx.train.adapters.jaxmarl import MultiAgentWorld as MultiAgentWorld
    from usarmjx.train.adapters.jaxmarl import register_worlds as register_worlds
    from usarmjx.train.adapters.pettingzoo import ParallelWorld as ParallelWorld
    from usarmjx.train.adapters.stable_baselines3 import BaselinesWorlds as BaselinesWorlds
    from usarmjx.train.adapters.torchrl import TorchWorlds as TorchWorlds
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.train.adapters.benchmarl": ("BenchmarlTask",),
            "usarmjx.train.adapters.brax": ("BatchedRobots",),
            "usarmjx.train.adapters.gymnasium": ("TeamWorld", "VectorWorlds", "register_ids"),
            "usarmjx.train.adapters.jaxmarl": ("MultiAgentWorld", "register_worlds"),
            "usarmjx.train.adapters.pettingzoo": ("ParallelWorld",),
            "usarmjx.train.adapters.stable_baselines3": ("BaselinesWorlds",),
            "usarmjx.train.adapters.torchrl": ("TorchWorlds",),
        },
    )
