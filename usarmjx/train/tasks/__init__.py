"""The tasks, one module each; importing this registers them.

`drive_to_goal` is the smallest. `team` is the base of `explore`, `victim_search` and `relay_chain`,
`goal_team` of their third versions; a bare name, as `explore`, is that of the newest version; soccer is
in four modules: field, belief, baseline, task. A task is a frozen dataclass: its fields are what `make`
and `--set` override, so their names stay. Its observations, rewards and scores are in its docstring and in
docs/tasks.md; figures there hold for exactly these functions.
"""

from dataclasses import replace

from usarmjx.train.envs.task import TASKS
from usarmjx.train.tasks.buildings import Buildings
from usarmjx.train.tasks.convoy import Convoy
from usarmjx.train.tasks.drive_to_goal import DriveToGoal
from usarmjx.train.tasks.explore import Explore
from usarmjx.train.tasks.goal_team import GoalTeam
from usarmjx.train.tasks.hover_inspect import HoverInspect
from usarmjx.train.tasks.relay_chain import RelayBase, RelayChain
from usarmjx.train.tasks.reporting_team import ExploreBase, SearchBase
from usarmjx.train.tasks.soccer import Soccer
from usarmjx.train.tasks.stairs import Stairs
from usarmjx.train.tasks.team import TeamTask, range_lines
from usarmjx.train.tasks.team_mind import Report, TeamMind
from usarmjx.train.tasks.victim_search import VictimSearch
from usarmjx.train.tasks.wander import Wander

__all__ = [
    "TASKS",
    "Buildings",
    "Convoy",
    "DriveToGoal",
    "Explore",
    "ExploreBase",
    "GoalTeam",
    "HoverInspect",
    "RelayBase",
    "RelayChain",
    "Report",
    "SearchBase",
    "Soccer",
    "Stairs",
    "TeamMind",
    "TeamTask",
    "VictimSearch",
    "Wander",
    "range_lines",
]

BUILDINGS_V2 = Buildings(sizes=((16, 12), (20, 14), (24, 16)), together=True, renewable=True)
SEARCHED_V2 = replace(BUILDINGS_V2, victims=6, reachable=1.0, near_victims=1)

BUILDINGS_V3 = Buildings(sizes=((12, 10), (20, 16), (32, 24)), together=True, renewable=True, spacing=2.4)
SEARCHED_V3 = replace(
    BUILDINGS_V3, sizes=((12, 10), (16, 14), (24, 18)), victims=8, reachable=1.0, near_victims=1
)

TASKS.add("explore-v1", Explore())
TASKS.add("explore-v2", Explore(arena=BUILDINGS_V2, episode_steps=400, haste=0.25))
TASKS.add("explore-v3", ExploreBase(arena=BUILDINGS_V3))
TASKS.add("victim-search-v1", VictimSearch())
TASKS.add(
    "victim-search-v2",
    VictimSearch(
        arena=SEARCHED_V2,
        episode_steps=600,
        haste=0.25,
        fence=True,
        return_speed=0.45,
        seek_home=True,
    ),
)
TASKS.add("victim-search-v3", SearchBase(arena=SEARCHED_V3))
TASKS.add("relay-chain-v1", RelayChain())
TASKS.add("relay-chain-v3", RelayBase(arena=BUILDINGS_V3))

TASKS.add("drive-to-goal", DriveToGoal())
TASKS.add("wander", Wander())
TASKS.add("convoy", Convoy())
TASKS.add("stairs", Stairs())
TASKS.add("hover-inspect", HoverInspect())
TASKS.add("soccer-v1", Soccer())
TASKS.add("soccer-v2", Soccer(bonus=10.0, approach=0.5, discount=1.0))
