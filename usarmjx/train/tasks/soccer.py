"""Two robots play soccer against two others."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct

from usarmjx.base.errors import UsageError
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import BYTES_PER_NUMBER, MessageSettings
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sim.actions import Actions
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.recipe import Arenas
from usarmjx.train.envs.task import StepResult, Task, TaskView, TimeLimit
from usarmjx.train.tasks.ranges import reduce_to_sectors
from usarmjx.train.tasks.soccer_belief import (
    LOWER,
    NUMBERS,
    UPPER,
    SoccerBelief,
    SoccerReadings,
    compose_messages,
    initial_belief,
    update_from_mail,
    update_from_sensors,
)
from usarmjx.train.tasks.soccer_field import (
    BLUE,
    GOAL_LINE,
    SCANNER_RANGE,
    SIDE_BOARD,
    SOCCER_FIELD,
    YELLOW,
    goal_scored,
    soccer_robot,
)
from usarmjx.train.tasks.soccer_play import soccer_action
from usarmjx.train.tasks.team_parts import to_robot_frame

MAIL_SETTINGS = MessageSettings(numbers=NUMBERS, capacity=2, bytes_per_step=BYTES_PER_NUMBER * NUMBERS)
"""Room for one message to the mate with every action."""
SIDES = np.array([1.0, 1.0, -1.0, -1.0], np.float32)
"""Which goal the robots shoot at, by slot: 1 for the one at +x, the yellow one. Slots 0 and 1 are blue."""
MATES = np.array([1, 0, 3, 2])
"""Each robot's mate, by slot."""
SPEED_SCALE = 1.0
"""What an action of 1 is as a speed of the wheels [m/s]; they could do 1.8."""
BALL_AGE_SCALE, MATE_AGE_SCALE = 3.0, 1.0
"""Where the ball was, and what the mate sent, are observed to be that old at most [s]."""
POSITION_SCALE = 3.0
"""Positions in a robot's axes are observed as shares of this [m]."""
GOAL = np.array([GOAL_LINE, 0.0], np.float32)
"""The middle of the goal line at which blue shoots [m]."""
OPPONENTS = ("self", "baseline", "still")


class SoccerMemory(struct.PyTreeNode, kw_only=True):
    """What the task remembers of an episode.

    Attributes:
        belief: What each robot believes (robots, ...).
        potential: How well the game goes for blue, see `Soccer` ().
        score: Goals of blue less those of yellow ().
        step: Actions so far ().
    """

    belief: SoccerBelief
    potential: jax.Array
    score: jax.Array
    step: jax.Array


@dataclass(frozen=True, kw_only=True)
class Soccer(Task):
    """Get the ball into the other team's goal: two against two.

    Blue shoots at the goal at +x, yellow at the one at -x; everything is observed as blue would see it, for
    yellow after half a turn of the field. The ball lies on the centre spot; the robots' start poses are drawn
    from 12 on both halves.

    Observation, by the robot's own sensors and by what its mate sends ten times a second:
    - its position (1: 2.7 m along, 2 m across the field), sine and cosine of its heading;
    - in its own axes, x ahead and y left (1: 3 m): the goal to shoot at, its own goal, the ball where it or
      its mate saw it last;
    - the velocity of the ball then, in its axes (1: 1 m/s), and how long ago that is (1: 3 s or never);
    - where its mate said to be, in its axes (1: 3 m), and how long ago (1: 1 s or never);
    - which of the two it is: 0 or 1; the share of the time that is left;
    - the nearest robot in each of 19 sectors of its upper scanner, from right to left (1: 4 m or none).

    Action: speeds of the left and right wheels (1: 1 m/s).

    The potential of the game for blue is w = (a - b) / 2 + `approach` (d - c), all in metres: a is how far
    the ball is from the middle of blue's goal line, b how far from that of yellow's, c how far from blue's
    nearest robot, d how far from yellow's.

    Reward, the same for both robots of a team: of blue the gain of w in the step, and `bonus` for a goal of
    blue, -`bonus` for one of yellow; of yellow the negative of that. All rewards add up to 0.

    Score: 1 for a goal of blue, -1 for one of yellow, 0 for none. A goal is scored when the whole ball is in
    it; with that the episode ends. A mean of scores is goals less goals against per episode.

    Attributes:
        opponent: Who drives yellow: `self`, the agents, with the same policy as blue's; `baseline`, the
            policy written by hand; `still`, nobody. But for `self` only blue's robots are agents.
        bonus: Reward for a goal.
        approach: Reward per metre nearer to the ball.
    """

    about: ClassVar[str] = "Two robots play soccer against two others."
    needs_solver: ClassVar[str] = "a ball that is pushed"

    arena: Arenas = SOCCER_FIELD
    repeat: int = 5
    episode_steps: int = 400
    time_limit: TimeLimit = "end"
    radio: RadioSettings | None = field(default_factory=RadioSettings)
    mail: MessageSettings | None = MAIL_SETTINGS
    opponent: str = "self"
    bonus: float = 5.0
    approach: float = 0.2

    @cached_property
    def _robots(self) -> tuple[RobotSpec, ...]:
        if self.opponent not in OPPONENTS:
            raise UsageError(f"opponent {self.opponent}, expected one of {', '.join(OPPONENTS)}")
        other = BLUE if self.opponent == "self" else YELLOW
        return (soccer_robot(BLUE),) * 2 + (soccer_robot(other),) * 2

    @property
    def robots(self) -> tuple[RobotSpec, ...]:
        """Blue, then yellow; if both have the same policy, they are robots of one kind."""
        return self._robots

    def scene(self) -> Scene:
        """Return the scene.

        Raises:
            UsageError: An arena without a ball, or with other loose things.
        """
        scene = super().scene()
        if len(scene.arena.loose) != 1:
            raise UsageError(f"soccer in {scene.arena.name}: expected one loose object, the ball")
        return scene

    def agent_groups(self, scene: Scene) -> tuple[int, ...]:
        """Both teams, or blue."""
        return (0,)

    def action_sizes(self, scene: Scene) -> tuple[int, ...]:
        """Left and right."""
        return (2,)

    def act(self, view: TaskView, memory: SoccerMemory, actions: tuple[jax.Array, ...]) -> Actions:
        """Speeds of the wheels, and messages to the mates."""
        commanded = {0: actions[0]}
        if self.opponent == "baseline":
            commanded[1] = jax.vmap(soccer_action)(self.observations(view, memory)[2:])
        elif self.opponent == "still":
            commanded[1] = jnp.zeros((2, 2))
        drive: dict[int, dict[str, jax.Array]] = {}
        for group, speeds in commanded.items():
            spins = SPEED_SCALE * speeds / view.scene.groups[group].robot.wheel_radius
            drive[group] = {"Left": spins[:, 0], "Right": spins[:, 1]}
        to = jnp.asarray(np.arange(4) == MATES[:, None])
        return Actions(
            drive=drive, messages=None if view.world.mail is None else compose_messages(memory.belief, to)
        )

    def update_belief(self, view: TaskView, belief: SoccerBelief) -> SoccerBelief:
        """Return the belief after the robots read their mail and sensors."""
        if view.world.mail is not None:
            belief = update_from_mail(belief, view.mail)
        groups = range(len(view.scene.groups))

        def read(kind: str) -> jax.Array:
            return jnp.concatenate([view.sensor(group, kind) for group in groups])

        fresh = jnp.concatenate([view.is_fresh(g, LOWER) & view.is_fresh(g, UPPER) for g in groups])
        readings = SoccerReadings(pose=read("GroundTruth"), low=read(LOWER), high=read(UPPER), fresh=fresh)
        return update_from_sensors(belief, readings, view.time)

    def start(self, view: TaskView, key: jax.Array) -> SoccerMemory:
        """Robots believe what their first scans show."""
        del key
        return SoccerMemory(
            belief=self.update_belief(view, initial_belief(len(SIDES))),
            potential=self.potential(view),
            score=jnp.zeros(()),
            step=jnp.zeros((), jnp.int32),
        )

    def observe(self, view: TaskView, memory: SoccerMemory) -> tuple[jax.Array, ...]:
        """See `Soccer`."""
        return (self.observations(view, memory)[: len(view.scene.groups[0].slots)],)

    def observations(self, view: TaskView, memory: SoccerMemory) -> jax.Array:
        """Return what each robot sees, agent or not, by slot (robots, n)."""
        belief, sides = memory.belief, SIDES[:, None]
        goal = jnp.asarray(sides * GOAL)
        pose, robots = belief.pose, len(SIDES)
        heading = sides * jnp.stack([jnp.sin(pose[:, 2]), jnp.cos(pose[:, 2])], -1)
        # A velocity turns as a position does that is seen from the origin.
        turned = to_robot_frame(pose.at[:, :2].set(0.0), belief.velocity)
        ball, mate = (view.time - when for when in (belief.ball_time, belief.mate_time))
        known, met = belief.ball_time >= 0, belief.mate_time >= 0
        left = jnp.full((robots, 1), 1.0 - memory.step / self.episode_steps)
        rows = [
            sides * pose[:, :2] / np.array([GOAL_LINE, SIDE_BOARD], np.float32),
            heading,
            to_robot_frame(pose, goal) / POSITION_SCALE,
            to_robot_frame(pose, -goal) / POSITION_SCALE,
            jnp.where(known[:, None], to_robot_frame(pose, belief.ball) / POSITION_SCALE, 0.0),
            turned,
            jnp.minimum(ball / BALL_AGE_SCALE, 1.0)[:, None],
            jnp.where(met[:, None], to_robot_frame(pose, belief.mate_pose[:, :2]) / POSITION_SCALE, 0.0),
            jnp.minimum(mate / MATE_AGE_SCALE, 1.0)[:, None],
            np.arange(robots)[:, None] % 2.0,
            left,
            reduce_to_sectors(belief.others) / SCANNER_RANGE,
        ]
        return jnp.concatenate(rows, -1)

    def privileged(self, view: TaskView, memory: SoccerMemory) -> jax.Array:
        """Where the ball and the robots truly are, as shares of the field, and how fast [m/s]; time left."""
        ball, positions = self.true_positions(view)
        size = np.array([GOAL_LINE, SIDE_BOARD], np.float32)
        speed = jnp.concatenate([view.robots(t).linear[:, :2] for t in range(len(view.scene.groups))])
        left = 1.0 - memory.step / self.episode_steps
        rolls = view.physics.qvel[view.scene.loose_geoms.root_dof[0, :2]]
        parts = [ball / size, rolls, (positions / size).ravel(), speed.ravel(), left[None]]
        return jnp.concatenate(parts)

    def true_positions(self, view: TaskView) -> tuple[jax.Array, jax.Array]:
        """Return where the ball (2,) and the robots (robots, 2) truly are [m]."""
        ball = jnp.asarray(view.physics.qpos)[view.scene.loose_geoms.root_qposadr[0, :2]]
        groups = range(len(view.scene.groups))
        return ball, jnp.concatenate([view.robots(g).pos[:, :2] for g in groups])

    def potential(self, view: TaskView) -> jax.Array:
        """Return how well the game goes for blue, see `Soccer` [m] ()."""
        ball, positions = self.true_positions(view)
        to_goals = jnp.linalg.norm(ball + GOAL), jnp.linalg.norm(ball - GOAL)
        away = jnp.linalg.norm(positions - ball, axis=-1)
        nearest = away[2:].min() - away[:2].min()
        return (to_goals[0] - to_goals[1]) / 2 + self.approach * nearest

    def evaluate(self, view: TaskView, memory: SoccerMemory) -> StepResult:
        """Goals, and the gain of the potential."""
        ball, _ = self.true_positions(view)
        goal, potential = goal_scored(ball), self.potential(view)
        gain = potential - memory.potential + self.bonus * goal
        score = memory.score + goal
        memory = SoccerMemory(
            belief=self.update_belief(view, memory.belief),
            potential=potential,
            score=score,
            step=memory.step + 1,
        )
        agents = len(view.scene.groups[0].slots)
        return StepResult(
            memory=memory,
            reward=(gain * SIDES[:agents],),
            terminated=goal != 0,
            score=score,
            metrics={
                "ball": ball[0],
                "goals": jnp.abs(goal),
                "known": (
                    view.time - memory.belief.ball_time < 2 * self.repeat * view.scene.physics.period
                ).mean(),
            },
        )
