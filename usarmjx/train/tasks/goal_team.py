"""Common parts of tasks whose robots choose goals and work for a base, to which news have to get."""

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, ClassVar, Literal

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import get_rows, set_rows
from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE
from usarmjx.comms.mail import BYTES_PER_NUMBER, OutgoingMessages
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.actions import Actions
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.layout import NO_PICTURE, NO_VECTOR, ActionVector, ObservationLayout, Picture
from usarmjx.train.envs.presence import Presence, drawn_team, remaining_robots
from usarmjx.train.envs.task import StepResult, TaskView
from usarmjx.train.mapping.belief import SECTOR_COUNT, Belief, headers, update_base_contact
from usarmjx.train.mapping.maps import FREE, MARK, WALL, MapGrid, to_robot_frame, unpack
from usarmjx.train.mapping.planning import (
    WAY_SQUARES,
    Goals,
    find_goals,
    frontier_action,
    near_others,
    next_on_way,
    way_to,
    where_due,
)
from usarmjx.train.mapping.wavefront import frontier
from usarmjx.train.tasks import messages
from usarmjx.train.tasks.critic_features import OWN_WIDTH, TRUTH_WIDTH, coarse
from usarmjx.train.tasks.equip import base_station, mapping_robot
from usarmjx.train.tasks.goal_features import (
    CHANNELS,
    CONTACT_SCALE,
    FRONTIERS,
    GOAL_NUMBERS,
    GOALS,
    KNOWN_SCALE,
    LEVELS,
    MATE_AGE,
    MATE_NUMBERS,
    MATES,
    NEWS_SCALE,
    OBSERVATION_SIZE,
    OBSERVED_MATES,
    OWN_NUMBERS,
    TEAM_SCALE,
    TIME_SCALE,
    WIDTH,
    GoalView,
    Mates,
    chosen_goal,
    first_mates,
    goal_features,
    heard_of,
    map_pyramid,
    mate_features,
    nearest_mates,
    sector_features,
)
from usarmjx.train.tasks.goal_state import GoalState, KnownMaps, Progress
from usarmjx.train.tasks.learned_vectors import VectorState, beside_mates, vector_columns, vector_features
from usarmjx.train.tasks.team import (
    PROGRESS_SCALE,
    WAYPOINT_SCALE,
    TeamMemory,
    TeamTask,
    coverage,
    station_slot,
    true_pose_features,
)

HOLD = 2
"""Number of the goal to stay, of tasks that have it; else that of the second robot."""
RECENT_REPORT = 1.0
"""A robot whose beliefs had come to the base so short a time ago has nothing new for it [s]."""


@dataclass(frozen=True, kw_only=True)
class GoalTeam(TeamTask):
    """A team that chooses goals, and a base that merges the maps that it receives.

    A base station stands at the first start pose. It takes part in the mail: it sends its map, and draws into
    it what it receives. Robots that meet copy each other's maps; so news come to the base with the robot that
    has them, over links of others, or with a robot that met their finder.

    Each robot has up to 19 goals: its base, the two nearest robots that it has heard of, and a frontier of
    each of the 16 nearest blocks of its map of 2.4 m.

    Action `goals`: a number for each goal; the robot takes the valid one with the greatest, every `hold`
    steps, and one given controller drives it there along the shortest way on its own map. Action `wheels`:
    speed and turn, as `TeamTask`; the way leads to the goal of the planner that brings news home.

    Observation, in the robot's axes: see `goal_features`. Its size depends neither on the team nor on the
    building. The last 19 numbers say which goals are valid. With `observed=map` a picture of the robot's
    whole map at three scales stands before them, see `goal_features`.

    Robots mail their whole map in every step. With `byte_rate` each sends one message every `hold` steps, of
    as much as its bytes pay for: to the base if that is in range, else to all, see `messages`. Action
    `goals+message`: 17 more numbers, one for each option of that message; the mask shows the options in the
    first half of the time between two choices of goals, and goals in the second. With `message_floats` there
    are 4 more options, to send a vector, and behind all choices its numbers; see `learned_vectors`.

    Critics see the truth, and what each robot knows of it: see `privileged`.

    Robots that touch something pay for their contacts. Besides its part of the points, each robot gets `hint`
    times 100 times the share of the building that it was the first to see; this is not part of the score.

    Attributes:
        robot: Class of the robots, or their description.
        count: Number of robots.
        actions: Kind of the actions, see above.
        hold: Steps for which a goal is kept.
        hint: Reward for squares that a robot explores.
        observed: Whether robots see their goals only, or also the picture of their map.
        least_robots: Least number of robots; each world draws its number, up to `count`, at each reset. 0:
            always `count`.
        oracle: Let the robots know the building: their ways lead through what they have not seen, and what
            the score wants is a frontier. A bound, not a method.
        byte_rate: Bytes a second that each robot may send, each receiver counted; None: any number.
        message_floats: Numbers of a vector that robots may send with `actions=goals+message`; 0: none.
    """

    reports: ClassVar[bool] = True
    decides: ClassVar[bool] = True
    news_kind: ClassVar[int] = FREE
    """Kind of the squares that are news."""
    holds: ClassVar[bool] = False
    """Whether robots may choose to stay, in place of the second robot."""
    news_worth: ClassVar[float] = 1.0
    """Squares that a square of news counts as, where robots observe how much they have."""
    base_first: ClassVar[bool] = True
    """Whether robots that do not choose their messages send to the base alone where it is in range."""

    episode_steps: int = 800
    haste: float = 0.5
    robot: str | RobotSpec = "P2AT"
    count: Annotated[int, AT_LEAST_ONE] = 4
    actions: Literal["goals", "goals+message", "wheels"] = "goals"
    hold: Annotated[int, AT_LEAST_ONE] = 8
    hint: Annotated[float, NOT_NEGATIVE] = 0.1
    observed: Literal["goals", "map"] = "goals"
    least_robots: Annotated[int, NOT_NEGATIVE] = 0
    oracle: bool = False
    byte_rate: Annotated[float, NOT_NEGATIVE] | None = None
    message_floats: Annotated[int, NOT_NEGATIVE] = 0

    def problem(self) -> str:
        """Return a conflict between settings."""
        if not self.advice:
            return "advice is false, but robots of this task see no advice"
        if self.observed == "map" and not self.discrete:
            return "observed is map, but with actions=wheels robots see no picture"
        if self.message_floats and not self.chooses_messages:
            return (
                f"message_floats is {self.message_floats}, but robots choose no messages: set "
                "actions=goals+message"
            )
        if self.parts and self.hold % 2:
            return f"hold is {self.hold}, but messages are sent half way between choices: an even number"
        wrong = self.least_robots > self.count
        return f"least_robots is {self.least_robots}, but the team has {self.count} robots" if wrong else ""

    @property
    def robots(self) -> tuple[RobotSpec, ...]:
        """The base, and the team."""
        return (base_station(), *(self.member(),) * self.count)

    def member(self) -> RobotSpec:
        """Return a robot of the team."""
        return mapping_robot(self.robot)

    @property
    def discrete(self) -> bool:
        """Goals are choices."""
        return self.actions != "wheels"

    @property
    def chooses_messages(self) -> bool:
        """Whether robots choose their messages."""
        return self.actions == "goals+message"

    @property
    def parts(self) -> bool:
        """Whether robots send parts of their maps, not all in every step."""
        return self.chooses_messages or self.byte_rate is not None

    @property
    def turn_length(self) -> int:
        """Steps for which goals are chosen, and then messages."""
        return self.hold // 2 if self.chooses_messages else 0

    @property
    def options(self) -> int:
        """Options of messages among the choices."""
        return messages.option_count(self.message_floats) * self.chooses_messages

    @property
    def vector(self) -> ActionVector:
        """Numbers of a message behind the choices, which count with the last options."""
        floats = self.message_floats
        return ActionVector(floats, messages.RECEIVERS) if floats else NO_VECTOR

    @property
    def sizes_of_messages(self) -> tuple[int, int]:
        """Numbers that choices of messages add to observations and to actions."""
        seen = self.options * (messages.OPTION_NUMBERS + 1)
        return seen + OBSERVED_MATES * vector_columns(self.message_floats), self.options + self.message_floats

    @property
    def action_size(self) -> int:
        """Numbers of an action: for each goal and option of a message, then a vector; or speed and turn."""
        return self.choices + self.message_floats if self.discrete else 2

    def action_sizes(self, scene: Scene) -> tuple[int, ...]:
        """As `action_size`, of each group."""
        return (self.action_size,) * len(self.agent_groups(scene))

    @property
    def choices(self) -> int:
        """Count of goals and options of messages that a robot chooses among."""
        return GOALS + self.options

    def layout(self, scene: Scene) -> ObservationLayout | None:
        """As `Task`: the robot, the others, the goals, and perhaps the picture."""
        del scene
        if not self.discrete:
            return None
        # Base, others, to stay and frontiers; then silence, letters and vectors: a network tells them apart
        # by these.
        kinds = (0, 1, 3, *(2,) * FRONTIERS) if self.holds else (0, *(1,) * MATES, *(2,) * FRONTIERS)
        silent = max(kinds) + 1
        sends = (silent, *(silent + 1,) * (messages.OPTIONS - 1)) if self.chooses_messages else ()
        sends += (silent + 2,) * self.vector.choices
        return ObservationLayout(
            own=OWN_NUMBERS + SECTOR_COUNT,
            others=(OBSERVED_MATES, MATE_NUMBERS + vector_columns(self.message_floats)),
            choices=(self.choices, GOAL_NUMBERS),
            kinds=(*kinds, *sends),
            picture=Picture(LEVELS, WIDTH, len(CHANNELS)) if self.pictures else NO_PICTURE,
        )

    @property
    def mate_goals(self) -> int:
        """Other robots among the goals."""
        return MATES - self.holds

    @property
    def pictures(self) -> bool:
        """Whether robots see pictures of their maps."""
        return self.observed == "map"

    def letter_size(self, scene: Scene) -> int:
        """As `TeamTask`, and a vector."""
        return super().letter_size(scene) + self.message_floats

    # Members of the team.

    def team(self, scene: Scene, key: jax.Array) -> jax.Array | None:
        """Those that the world draws."""
        if not self.least_robots:
            return None
        return drawn_team(scene, self.agents(scene), self.least_robots, key)

    def presence(self, view: TaskView, memory: TeamMemory) -> Presence | None:
        """Those that the world has drawn."""
        del memory
        if not self.least_robots:
            return None
        agents, nobody = self.agents(view.scene), np.zeros(view.scene.num_robots, int)
        return remaining_robots(view, agents, self.least_robots, nobody, self.repeat, 0.0)

    def working(self, view: TaskView, memory: TeamMemory) -> jax.Array | None:
        """As `TeamTask`: those that are alive."""
        presence = self.presence(view, memory)
        return None if presence is None else presence.alive

    # Beliefs of the robots, and their ways.

    def update_task_belief(self, view: TaskView, belief: Belief) -> Belief:
        """Look at the radio."""
        # Of parts of maps a link says nothing: `noticed` looks at what has been sent.
        if view.world.links is None or self.talk == "none" or self.parts:
            return belief
        return update_base_contact(belief, view.links.in_range, station_slot(view.scene), view.time)

    def mail_period(self, scene: Scene) -> float:
        """As `TeamTask`; nothing follows from the times of parts of maps."""
        return 0.0 if self.parts else super().mail_period(scene)

    def recent_age(self, scene: Scene) -> float:
        """As `TeamTask`; parts of maps come seldom, so what they say counts until the next ones."""
        return self.message_interval(scene) if self.parts else super().recent_age(scene)

    def message_interval(self, scene: Scene) -> float:
        """Return the time between two messages of parts of maps [s]."""
        return self.hold * self.repeat * scene.physics.period

    def plan(self, view: TaskView, belief: Belief) -> Belief:
        """Keep goals: they are chosen by `decide`."""
        del view
        return belief

    def known(self, view: TaskView, memory: TeamMemory) -> KnownMaps:
        """Return what goals and ways depend on."""
        belief = memory.belief
        return KnownMaps(
            squares=belief.squares,
            reachable=memory.reachable,
            targets=self.targets(view, memory) if self.oracle else self.pending(view, memory),
            pose=belief.pose,
            headers=belief.mate_headers,
            age=view.time - belief.heard_time,
            mates=nearest_mates(belief, station_slot(view.scene), view.time, self.mate_goals),
        )

    def targets(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares that are worth the way to one who knows all (i, j): by default all of them."""
        del view
        return memory.reachable

    def unfound(self, memory: TeamMemory) -> jax.Array:
        """Return the squares that a teacher who knows the building looks for, on nobody's map (i, j)."""
        return memory.reachable & ~(memory.belief.squares == FREE).any(0)

    def pending(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the known squares to which each robot has to go (robots, i, j): by default none."""
        del view
        return jnp.zeros_like(memory.belief.visited)

    def ends(self, known: KnownMaps) -> jax.Array:
        """Return the frontiers of each robot (robots, i, j)."""
        if self.oracle:
            return jnp.broadcast_to(known.targets, known.squares.shape)
        return jax.vmap(frontier)(known.squares)

    def find(self, scene: Scene, known: KnownMaps) -> Goals:
        """Return the goals of all robots, by slot (robots, GOALS, ...)."""
        grid, robots, base = self.arena_grid(scene), scene.num_robots, station_slot(scene)
        mates = known.mates
        heads = known.headers[np.arange(robots)[:, None], mates.slot]
        home = jnp.broadcast_to(known.pose[base, :2], (robots, 1, 2))
        # The order is that of the goals: base, others, to stay; frontiers follow.
        places = jnp.concatenate([home, heads[..., :2], *[known.pose[:, None, :2]] * self.holds], 1)
        facts = self.drivable(known), known.pose, self.ends(known), places, _blocked(grid, known)

        def one(
            squares: jax.Array, pose: jax.Array, ends: jax.Array, places: jax.Array, blocked: jax.Array
        ) -> Goals:
            return find_goals(grid, squares, pose, ends, places, blocked=blocked, count=FRONTIERS)

        goals = _of_agents(jax.vmap(one), self.agents(scene), robots, facts)
        always = jnp.ones((robots, FRONTIERS + self.holds), bool)
        real = jnp.concatenate([always[:, :1], mates.valid, always], 1)
        # The base is always a goal; without a way there a robot waits.
        return goals.replace(valid=(goals.valid & real).at[:, 0].set(True))

    def drivable(self, known: KnownMaps) -> jax.Array:
        """Return the maps that ways lead over; an oracle's is the building (robots, i, j)."""
        if not self.oracle:
            return known.squares
        truth = jnp.where(known.reachable, FREE, WALL).astype(jnp.uint8)
        return jnp.broadcast_to(truth, known.squares.shape)

    def decide(self, view: TaskView, memory: TeamMemory, actions: tuple[jax.Array, ...]) -> TeamMemory:
        """Take the robots' choices when these are due, and find ways there."""
        extra, scene = memory.extra, view.scene
        # All robots choose in the same steps, so the ways of a batch are computed at once.
        due = memory.step % self.hold == 0
        if self.discrete:
            wanted = jnp.zeros((scene.num_robots, GOALS))
            for group, action in zip(self.agent_groups(scene), actions, strict=True):
                wanted = set_rows(wanted, (scene.groups[group].slots, action[:, :GOALS]))
            # An invalid goal never wins, whatever a policy's noise says.
            choice = jnp.where(extra.goals.valid, wanted, -jnp.inf).argmax(-1)
        else:
            choice = chosen_goal(
                self.observations(view, memory)[:, -OBSERVATION_SIZE:], self.cell, report=True
            )
        chosen = jnp.where(due, choice, extra.chosen).astype(jnp.int32)
        goal = _picked(extra.goals.position, chosen)
        # A branch over the whole batch: ways are the dearest part of a step.
        way = where_due(partial(self.ways, scene), due, extra.way, self.known(view, memory), goal)
        memory = memory.replace(extra=extra.replace(chosen=chosen, way=way))
        return self.post(view, memory, actions) if self.parts else memory

    def ways(self, scene: Scene, known: KnownMaps, goal: jax.Array) -> jax.Array:
        """Return ways to goals (robots, 2), by slot (robots, WAY_SQUARES, 2)."""
        grid = self.arena_grid(scene)

        def one(squares: jax.Array, pose: jax.Array, goal: jax.Array, blocked: jax.Array) -> jax.Array:
            return way_to(grid, squares, pose, goal, blocked=blocked)

        facts = self.drivable(known), known.pose, goal, _blocked(grid, known)
        return _of_agents(jax.vmap(one), self.agents(scene), scene.num_robots, facts)

    def post(self, view: TaskView, memory: TeamMemory, actions: tuple[jax.Array, ...]) -> TeamMemory:
        """Take the robots' choices of messages when these are due, and fill them."""
        state, scene = self.message_state(memory), view.scene
        mates = nearest_mates(memory.belief, station_slot(scene), view.time, MATES)
        offered = self.message_choices(view, memory, mates)
        chosen = messages.given_option(offered.valid, base_first=self.sends_to_base_first)
        numbers = jnp.zeros((scene.num_robots, self.message_floats)) if self.message_floats else None
        if self.chooses_messages:
            for group, action in zip(self.agent_groups(scene), actions, strict=True):
                slots = scene.groups[group].slots
                wanted = jnp.where(
                    get_rows(offered.valid, slots), action[:, GOALS : self.choices], -jnp.inf
                ).argmax(-1)
                chosen = set_rows(chosen, (slots, wanted))
                if numbers is not None:
                    numbers = set_rows(numbers, (slots, action[:, self.choices :]))
        facts = state, offered, memory.belief.squares, chosen, numbers
        state = where_due(messages.posted, self.sends_now(memory), state, *facts)
        return memory.replace(extra=memory.extra.replace(messaging=state))

    @property
    def sends_to_base_first(self) -> bool:
        """Whether the fixed protocol sends to the base alone where it is in range: all would get less."""
        return self.base_first and self.byte_rate is not None

    def message_state(self, memory: TeamMemory) -> messages.MessageState:
        """Return the memory of messages, of a task whose robots send parts of maps."""
        state = memory.extra.messaging
        assert isinstance(state, messages.MessageState)
        return state

    def sends_now(self, memory: TeamMemory) -> jax.Array:
        """Return whether this step's action is that of messages ()."""
        return memory.step % self.hold == self.hold // 2

    def message_choices(self, view: TaskView, memory: TeamMemory, mates: Mates) -> messages.Choices:
        """Return the options of the robots' messages, of which some are to the nearest others."""
        scene, base = view.scene, station_slot(view.scene)
        allowed = _linked(view) & self.recipients(scene)
        budget = np.inf if self.byte_rate is None else self.byte_rate * self.message_interval(scene)
        return messages.choices(self.message_state(memory), allowed, base, mates, budget)

    def outgoing(self, view: TaskView, memory: TeamMemory) -> OutgoingMessages:
        """As `TeamTask`, or the messages that were posted in this step."""
        if not self.parts:
            return super().outgoing(view, memory)
        state = self.message_state(memory)
        return OutgoingMessages(
            receivers=state.receivers & self.sends_now(memory),
            payload=messages.letters(state, headers(memory.belief)),
            size_bytes=state.size,
        )

    def act(self, view: TaskView, memory: TeamMemory, actions: tuple[jax.Array, ...]) -> Actions:
        """As `TeamTask`; wheels turn as the controller wants if actions are goals."""
        memory = memory.replace(belief=self.followed(memory))
        if self.discrete:
            drive = frontier_action(self.controller_input(memory), self.episode_steps)
            actions = self.per_group(view.scene, drive)
        return super().act(view, memory, actions)

    def followed(self, memory: TeamMemory) -> Belief:
        """Return the belief with the next position on each robot's way, and where that leads."""
        belief, extra = memory.belief, memory.extra
        waypoint = jax.vmap(next_on_way)(extra.way, belief.pose[:, :2])
        # A way to where the robot stands has no direction; its own place is the waypoint.
        if self.holds:
            waypoint = jnp.where((extra.chosen == HOLD)[:, None], belief.pose[:, :2], waypoint)
        goal, length = (_picked(x, extra.chosen) for x in (extra.goals.position, extra.goals.length))
        return belief.replace(waypoint=waypoint, goal=goal, path_length=length)

    def controller_input(self, memory: TeamMemory) -> jax.Array:
        """Return what the controller of ways looks at, in the order of `TeamTask` (robots, n)."""
        belief = memory.belief
        moved = jnp.linalg.norm(belief.pose[:, :2] - belief.lagged_position, axis=-1)
        left = jnp.broadcast_to(1 - memory.step / self.episode_steps, moved.shape)
        rows = [
            to_robot_frame(belief.pose, belief.waypoint) / WAYPOINT_SCALE,
            # The three numbers of goal and length, which the controller does not read.
            jnp.zeros((len(moved), 3)),
            jnp.minimum(moved / PROGRESS_SCALE, 1.0)[:, None],
            sector_features(belief),
            left[:, None],
        ]
        return jnp.concatenate(rows, -1)

    # Evaluation.

    @abstractmethod
    def nothing(self, view: TaskView, memory: TeamMemory) -> Any:  # noqa: ANN401 - the task's own
        """Return the task's own memory at the start of an episode, see `GoalState`."""

    @abstractmethod
    def progress(self, view: TaskView, memory: TeamMemory, worth: jax.Array) -> Progress:
        """Return what a step has added to the score, contacts apart.

        Args:
            view: The world after it.
            memory: The memory, up to date but for score, goals and what is achieved.
            worth: Share of its points that a find pays now ().
        """

    def start(self, view: TaskView, key: jax.Array) -> TeamMemory:
        """Nothing is reported."""
        memory = super().start(view, key)
        memory = memory.replace(extra=self.first_state(view, memory))
        goals = self.find(view.scene, self.known(view, memory))
        memory = self.noticed(view, memory.replace(extra=memory.extra.replace(goals=goals)))
        if not self.pictures:
            return memory
        sent = self._sent(view, memory)
        picture = self.picture(view.scene, self.known(view, memory), sent)
        return memory.replace(extra=memory.extra.replace(sent=sent, picture=picture))

    def first_state(self, view: TaskView, memory: TeamMemory) -> GoalState:
        """Return the memory of reports at the start, without goals."""
        pose, robots = memory.belief.pose, view.scene.num_robots
        none = Goals(
            position=jnp.zeros((robots, GOALS, 2)),
            length=jnp.zeros((robots, GOALS)),
            gain=jnp.zeros((robots, GOALS)),
            valid=jnp.zeros((robots, GOALS), bool),
        )
        return GoalState(
            achieved=self.nothing(view, memory),
            reported=jnp.zeros(robots),
            shared=jnp.zeros((robots, robots)),
            goals=none,
            chosen=jnp.zeros(robots, jnp.int32),
            way=jnp.broadcast_to(pose[:, None, :2], (robots, WAY_SQUARES, 2)),
            messaging=messages.no_messages(
                robots, self.arena_grid(view.scene).packed_size, self.message_floats
            )
            if self.parts
            else (),
            bytes_sent=jnp.zeros(()),
        )

    def picture(self, scene: Scene, known: KnownMaps, sent: jax.Array) -> jax.Array:
        """Return the pictures of all robots' maps, by slot (robots, LEVELS, WIDTH, WIDTH, channels)."""
        grid, robots, base = self.arena_grid(scene), scene.num_robots, station_slot(scene)
        there = ~np.eye(robots, dtype=bool) & (np.arange(robots) != base)
        news = (known.squares == self.news_kind) & ~sent
        facts = known.squares, news, known.pose, known.headers[..., :2], (known.age < MATE_AGE) & there
        return _of_agents(jax.vmap(partial(map_pyramid, grid)), self.agents(scene), robots, facts)

    def _sent(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the squares of news on each robot's map when the base last had all of it (robots, i, j)."""
        belief, before = memory.belief, memory.extra.sent
        if self.parts:
            there = self.message_state(memory).known[:, station_slot(view.scene)]
            return jax.vmap(partial(unpack, shape=self.arena_grid(view.scene).shape))(there) == self.news_kind
        news = belief.squares == self.news_kind
        return jnp.where(
            # Kept until all of it has come: a part may be lost on the way.
            self.base_is_informed(view, belief)[:, None, None],
            news,
            False if isinstance(before, tuple) else before,
        )

    def noticed(self, view: TaskView, memory: TeamMemory) -> TeamMemory:
        """Return the memory with what the base and the others have got to know."""
        if self.parts:
            return self._noticed_parts(view, memory)
        belief, extra = memory.belief, memory.extra
        news = self.news(belief)
        reported = jnp.where(self.base_is_informed(view, belief), news, extra.reported)
        # Whole maps are sent in every step: a robot with a link has all by then.
        shared = jnp.where(_linked(view), news[:, None], extra.shared)
        return memory.replace(extra=extra.replace(reported=reported, shared=shared))

    def _noticed_parts(self, view: TaskView, memory: TeamMemory) -> TeamMemory:
        """As `noticed`, from the parts of maps that were sent and received."""
        belief, base, state = memory.belief, station_slot(view.scene), self.message_state(memory)
        if view.world.mail is not None:
            state = messages.heard(state, view.mail)
        what = "marks" if self.news_kind == MARK else "free"
        compare = partial(messages.compared, news=what, worth=self.news_worth)
        due = memory.step % (self.hold // 2) == 0  # before each choice
        state = where_due(compare, due, state, state, belief.squares)
        left = state.untold[:, base]
        # The base itself has all that is on its map.
        informed = (_linked(view)[:, base] & (left == 0.0)) | (np.arange(len(left)) == base)
        contact = jnp.where(due & informed, view.time, belief.base_contact_time)
        news = self.news(belief)
        extra = memory.extra.replace(
            messaging=state, reported=news - left, shared=news[:, None] - state.untold
        )
        return memory.replace(belief=belief.replace(base_contact_time=contact), extra=extra)

    def offered(self, view: TaskView, memory: TeamMemory) -> TeamMemory:
        """Return the memory with new goals, and pictures, where a choice is due."""
        due, known, scene = memory.step % self.hold == 0, self.known(view, memory), view.scene
        extra = memory.extra
        goals = where_due(partial(self.find, scene), due, extra.goals, known)
        if self.pictures:
            sent = self._sent(view, memory)
            picture = where_due(partial(self.picture, scene), due, extra.picture, known, sent)
            extra = extra.replace(sent=sent, picture=picture)
        return memory.replace(extra=extra.replace(goals=goals))

    def base_is_informed(self, view: TaskView, belief: Belief) -> jax.Array:
        """Return whether robots have no news for the base, as far as they know (robots,)."""
        return view.time - belief.base_contact_time < RECENT_REPORT

    def news(self, belief: Belief) -> jax.Array:
        """Return how much of what the base wants is on each robot's map [squares] (robots,)."""
        there = (belief.squares == self.news_kind).sum((1, 2)).astype(jnp.float32)
        return there * self.news_worth

    def evaluate(self, view: TaskView, memory: TeamMemory) -> StepResult:
        """Progress, and contacts."""
        steps, scene = self.episode_steps, view.scene
        worth = self.worth((steps - memory.step) / steps)  # this step's number is one more
        memory, credit, begun = self.advance(view, memory)
        memory = memory.replace(extra=memory.extra.replace(bytes_sent=self.bytes_so_far(view, memory)))
        # Before the score: news that came with this step count as reported in it.
        memory = self.noticed(view, memory)
        found = self.progress(view, memory, worth)
        # After it: goals depend on what was achieved.
        memory = self.offered(view, memory.replace(extra=memory.extra.replace(achieved=found.achieved)))
        contacts = self.price * begun
        memory = memory.replace(score=memory.score + found.points - contacts.sum())
        reward = found.reward + self.hint * 100.0 * credit - contacts
        # Steps that a staggered start skips took no time and sent nothing.
        seconds = jnp.maximum(memory.step - memory.skipped, 1) * self.repeat * scene.physics.period
        sent = {"bytes": memory.extra.bytes_sent / seconds}
        return StepResult(
            memory=memory,
            reward=self.per_group(scene, reward),
            terminated=jnp.zeros((), bool),
            score=memory.score,
            metrics={**self.metrics(memory), **found.metrics, **sent},
        )

    def bytes_so_far(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the bytes that a robot has sent so far, each receiver in range counted: mean ()."""
        agents, extra, working = self.agents(view.scene), memory.extra, self.working(view, memory)
        there = jnp.ones(len(agents)) if working is None else working[agents]
        # All robots may be out of action: a mean over none would be NaN.
        share = there / jnp.maximum(there.sum(), 1.0)
        if self.parts:
            return (self.message_state(memory).sent[agents] * share).sum()
        size = BYTES_PER_NUMBER * self.letter_size(view.scene)
        links = (_linked(view) & self.recipients(view.scene))[agents].sum(-1)
        return extra.bytes_sent + size * (links * share).sum()

    # Observations.

    def observations(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """See `goal_features`; with wheels, the way of `TeamTask` before it."""
        belief, extra, scene = memory.belief, memory.extra, view.scene
        base, robots = station_slot(scene), scene.num_robots
        linked = self.signals(view)
        free, news = (belief.squares == FREE).sum((1, 2)).astype(jnp.float32), self.news(belief)
        left = 1 - memory.step / self.episode_steps
        seconds = left * self.episode_steps * self.repeat * scene.physics.period
        moved = jnp.linalg.norm(belief.pose[:, :2] - belief.lagged_position, axis=-1)
        own = [
            jnp.broadcast_to(left, (robots,)),
            jnp.broadcast_to(seconds / TIME_SCALE, (robots,)),
            jnp.minimum(moved / PROGRESS_SCALE, 1.0),
            linked[:, base],
            jnp.minimum((view.time - belief.base_contact_time) / CONTACT_SCALE, 1.0),
            jnp.maximum(news - extra.reported, 0.0) / NEWS_SCALE,
            free / KNOWN_SCALE,
            heard_of(belief, base, view.time).sum(-1) / TEAM_SCALE,
        ]
        # Later scans may take free squares off a map again: news never fall below none.
        untold = jnp.maximum(news[:, None] - extra.shared, 0.0)
        # The base learns by any path, so all reports count, not those of this robot alone.
        untold = untold.at[:, base].set(jnp.maximum(news - extra.reported, 0.0))
        mates = nearest_mates(belief, base, view.time, OBSERVED_MATES)
        judged = GoalView(base, view.time, seconds, untold, first_mates(mates, self.mate_goals))
        rows = [
            jnp.stack([jnp.asarray(one, jnp.float32) for one in own], -1),
            sector_features(belief),
            self._others(view, memory, mates, mate_features(belief, mates, linked, judged)),
            goal_features(self.arena_grid(scene), belief, extra.goals, extra.chosen, judged),
        ]
        picture, mask = [extra.picture.reshape(robots, -1)] if self.pictures else [], [extra.goals.valid]
        if self.chooses_messages:
            near = first_mates(mates, MATES)
            offered, state = self.message_choices(view, memory, near), self.message_state(memory)
            rows.append(messages.option_features(state, offered, belief, linked, base, near))
            # Of the choice that comes next: messages up to half way, then goals.
            since = memory.step % self.hold
            sends = (since > 0) & (since <= self.hold // 2)
            mask = [extra.goals.valid & ~sends, offered.valid & sends]
        rows += [*picture, *mask]
        way = [] if self.discrete else [self.controller_input(memory.replace(belief=self.followed(memory)))]
        return jnp.concatenate([*way, *rows], -1).astype(jnp.float32)

    def _others(self, view: TaskView, memory: TeamMemory, mates: Mates, features: jax.Array) -> jax.Array:
        """Return what robots observe of others (robots, n): `mate_features`, and vectors if there are any."""
        if not self.message_floats:
            return features
        vectors = self.message_state(memory).vectors
        assert isinstance(vectors, VectorState)
        return beside_mates(features, vector_features(vectors, mates, view.time))

    def signals(self, view: TaskView) -> jax.Array:
        """Return what robots observe of links (robots, robots): by default whether there are any."""
        return _linked(view)

    def baseline_obs(
        self, scene: Scene, memory: TeamMemory, obs: tuple[jax.Array, ...]
    ) -> tuple[jax.Array, ...]:
        """As `Task`."""
        del scene, memory
        return obs

    @abstractmethod
    def wanted(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """Return the true map of what the score counts, for critics (i, j)."""

    def privileged(self, view: TaskView, memory: TeamMemory) -> jax.Array:
        """As `TeamTask`, and maps at a coarse scale: true ones, then what each robot's own shows to be free.

        The true ones are of the building, what is explored, and what the score counts.
        """
        facts = [coverage(memory), memory.step / self.episode_steps, memory.score / 100.0]
        truth = [memory.reachable, memory.explored, self.wanted(view, memory)]
        maps = [coarse(one, TRUTH_WIDTH).ravel() for one in truth]
        own = get_rows(memory.belief.squares, self.agents(view.scene)) == FREE
        maps.append(jax.vmap(partial(coarse, width=OWN_WIDTH))(own).ravel())
        return jnp.concatenate([jnp.stack(facts), *maps, true_pose_features(view)])


def _linked(view: TaskView) -> jax.Array:
    """Return which robots have links (robots, robots)."""
    robots = view.scene.num_robots
    return jnp.zeros((robots, robots), bool) if view.world.links is None else jnp.asarray(view.links.in_range)


def _picked(values: jax.Array, chosen: jax.Array) -> jax.Array:
    """Return the chosen row (robots,) of each robot's values (robots, n, ...)."""
    return values[jnp.arange(len(chosen)), chosen]


def _blocked(grid: MapGrid, known: KnownMaps) -> jax.Array:
    """Return the squares that others take, for each robot (robots, i, j)."""
    # A robot does not stand in its own way.
    own = jnp.eye(len(known.pose), dtype=bool)
    return jax.vmap(partial(near_others, grid))(known.headers, jnp.where(own, jnp.inf, known.age))


def _of_agents(
    run: Callable[..., Any],
    agents: np.ndarray,
    robots: int,
    facts: tuple[jax.Array, ...],
) -> Any:  # noqa: ANN401 - a PyTree
    """Return what a function computes of the agents' rows, and zeros for the others (robots, ...)."""
    # The base is no agent, and computing its goals would be as dear as a robot's.
    found = run(*(get_rows(one, agents) for one in facts))
    return jax.tree.map(lambda x: set_rows(jnp.zeros((robots, *x.shape[1:]), x.dtype), (agents, x)), found)
