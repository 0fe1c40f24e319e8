"""Baselines, one for each task, which a trained policy has to beat, or imitates at first.

Each is a function of one robot's observation, mapped over worlds and robots, and added to `BASELINES` below
by its task's name; `driving` and
`planners` have what several share. They see what a policy observes and nothing else. Their
scores are in docs/tasks.md: who changes one measures again. Begin with `climb.py`.
"""

from collections.abc import Callable

from usarmjx.base.registry import Registry
from usarmjx.train.baselines.climb import climb_policy
from usarmjx.train.baselines.driving import BugCarry, bug_action, bug_policy, initial_bug_carry, roam_policy
from usarmjx.train.baselines.hover import inspection_policy
from usarmjx.train.baselines.planners import (
    assignment_policy,
    chain_policy,
    courier_policy,
    frontier_policy,
    oracle_policy,
    relay_policy,
    rendezvous_policy,
    reporting_policy,
    silent_policy,
)
from usarmjx.train.baselines.pursuit import pursuit_policy
from usarmjx.train.baselines.soccer import soccer_policy
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.task import Policy

__all__ = [
    "BASELINES",
    "PLANNERS",
    "BugCarry",
    "assignment_policy",
    "bug_action",
    "bug_policy",
    "chain_policy",
    "climb_policy",
    "courier_policy",
    "frontier_policy",
    "initial_bug_carry",
    "inspection_policy",
    "oracle_policy",
    "pursuit_policy",
    "relay_policy",
    "rendezvous_policy",
    "reporting_policy",
    "roam_policy",
    "silent_policy",
    "soccer_policy",
]

BASELINES: Registry[Callable[[Env], Policy]] = Registry("baseline", versioned=True)
"""Baseline policies by the name of their task, as in `TASKS`: functions of its environment."""
BASELINES.add("drive-to-goal", bug_policy)
BASELINES.add("wander", roam_policy)
for version in (1, 2):
    BASELINES.add(f"explore-v{version}", frontier_policy)
    BASELINES.add(f"victim-search-v{version}", frontier_policy)
BASELINES.add("explore-v3", reporting_policy)
BASELINES.add("victim-search-v3", courier_policy)
BASELINES.add("relay-chain-v1", relay_policy)
BASELINES.add("relay-chain-v3", chain_policy)
PLANNERS: dict[str, Callable[[Env], Policy]] = {
    "frontier": silent_policy,
    "courier": courier_policy,
    "assignment": assignment_policy,
    "rendezvous": rendezvous_policy,
    "chain": chain_policy,
    "oracle": oracle_policy,
}
"""Planners of any task whose robots choose goals; `BASELINES` has them too, for a task that is named."""
for planner, policy in PLANNERS.items():
    BASELINES.add(planner, policy)
BASELINES.add("convoy", pursuit_policy)
BASELINES.add("stairs", climb_policy)
BASELINES.add("hover-inspect", inspection_policy)
for version in (1, 2):
    BASELINES.add(f"soccer-v{version}", soccer_policy)
