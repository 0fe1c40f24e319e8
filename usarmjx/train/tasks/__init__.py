"""The tasks, one module each; importing this registers them.

`drive_to_goal` is the smallest. `team` is the base of `explore`, `victim_search` and `relay_chain`; soccer is
in four modules: field, belief, play by hand, task. A task is a frozen dataclass: its fields are what `make`
and `--set` override, so their names stay. What it observes, rewards and scores stands in its docstring and in
docs/tasks.md; figures there hold for exactly these functions.
"""

from usarmjx.train.envs.task import TASKS
from usarmjx.train.tasks.convoy import Convoy
from usarmjx.train.tasks.drive_to_goal import DriveToGoal
from usarmjx.train.tasks.explore import Explore
from usarmjx.train.tasks.hover_inspect import HoverInspect
from usarmjx.train.tasks.relay_chain import RelayChain
from usarmjx.train.tasks.soccer import Soccer
from usarmjx.train.tasks.stairs import Stairs
from usarmjx.train.tasks.victim_search import VictimSearch
from usarmjx.train.tasks.wander import Wander

TASKS.add("drive-to-goal", DriveToGoal())
TASKS.add("wander", Wander())
TASKS.add("explore", Explore())
TASKS.add("victim-search", VictimSearch())
TASKS.add("relay-chain", RelayChain())
TASKS.add("convoy", Convoy())
TASKS.add("stairs", Stairs())
TASKS.add("hover-inspect", HoverInspect())
TASKS.add("soccer", Soccer())
