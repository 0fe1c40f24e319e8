"""Policies written by hand, one for each task: what a trained one has to beat."""

from collections.abc import Callable

from usarmjx.base.registry import Registry
from usarmjx.train.baselines.climb import climber
from usarmjx.train.baselines.frontier import frontier
from usarmjx.train.baselines.goal import go_to_goal
from usarmjx.train.baselines.hover import inspector
from usarmjx.train.baselines.pursuit import pursuit
from usarmjx.train.baselines.relay import relay
from usarmjx.train.baselines.roam import roam
from usarmjx.train.baselines.soccer import players
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.policy import Policy

BASELINES: Registry[Callable[[Env], Policy]] = Registry("baseline")
BASELINES.add("drive-to-goal", go_to_goal)
BASELINES.add("wander", roam)
BASELINES.add("explore", frontier)
BASELINES.add("victim-search", frontier)
BASELINES.add("relay-chain", relay)
BASELINES.add("convoy", pursuit)
BASELINES.add("stairs", climber)
BASELINES.add("hover-inspect", inspector)
BASELINES.add("soccer", players)
