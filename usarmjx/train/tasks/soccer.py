"""Two robots play soccer against two others."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from flax import struct
from flax.struct import PyTreeNode

from usarmjx.base.backend import Array
from usarmjx.base.errors import UsageError
from usarmjx.base.settings import Setting
from usarmjx.base.transforms import mat_from_angles
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import BYTES_PER_NUMBER, Inboxes, MessageSettings, OutgoingMessages
from usarmjx.models.arenas.soccer import BALL_RADIUS
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sim.actions import Actions
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.recipe import Arenas
from usarmjx.train.envs.task import StepResult, Task, TaskView, TimeLimit
from usarmjx.train.mapping.maps import to_robot_frame
from usarmjx.train.tasks.soccer_field import (
    BEAMS,
    BLUE,
    COVER,
    GOAL_LINE,
    LOWER_SCANNER_HEIGHT,
    SCANNER_RANGE,
    SIDE_BOARD,
    SOCCER_FIELD,
    UPPER_SCANNER_HEIGHT,
    YELLOW,
    beams,
    depth_inside,
    goal_scored,
    soccer_robot,
)
from usarmjx.train.tasks.soccer_play import soccer_action
from usarmjx.train.tasks.team import reduce_to_sectors

UPPER, LOWER = "IRScanner", "RangeScanner"
"""Types of the two scanners."""
MIN_RANGE_GAP = 0.15
"""Least difference of the ranges of the upper and the lower scanner at a ball [m]."""
FLOOR_MARGIN = 0.04
"""Hits that are no higher than this may be of the floor [m]."""
BOARD_MARGIN = 0.1
"""Distance from a board or a goal within which an echo may be of it [m]."""
VELOCITY_SMOOTHING = 0.4
"""Share of a new velocity of the ball in what is known of it."""
MAX_VELOCITY_GAP = 0.35
"""Velocities are estimated from two scans that are no farther apart [s]."""
MAX_BALL_SPEED = 2.0
"""Balls are no faster than this in each direction [m/s]."""
NEVER = -1e3
"""When what never happened did [s]."""
NUMBERS = 8
"""Of a message: the sender's x, y, yaw; the ball's x, y and its velocity; when it was seen."""


class SoccerBelief(PyTreeNode, kw_only=True):
    """Beliefs of each robot, in the world's axes.

    Attributes:
        pose: Pose: x, y [m] and yaw [rad] (robots, 3).
        others: Distance of another robot along each upper beam, `SCANNER_RANGE` for none [m] (robots,
            beams).
        ball: Last seen position of the ball, by the robot or its mate [m] (robots, 2).
        velocity: Its speed then [m/s] (robots, 2).
        ball_time: When that was [s] (robots,).
        mate_pose: Pose that its mate reported (robots, 3).
        mate_time: When it said so [s] (robots,).
    """

    pose: jax.Array
    others: jax.Array
    ball: jax.Array
    velocity: jax.Array
    ball_time: jax.Array
    mate_pose: jax.Array
    mate_time: jax.Array


def initial_belief(robots: int) -> SoccerBelief:
    """Return the belief of robots that have sensed nothing yet."""
    none, never = jnp.zeros((robots, 2)), jnp.full(robots, NEVER)
    pose = jnp.zeros((robots, 3))
    return SoccerBelief(
        pose=pose,
        others=jnp.full((robots, BEAMS), SCANNER_RANGE),
        ball=none,
        velocity=none,
        ball_time=never,
        mate_pose=pose,
        mate_time=never,
    )


def find_ball(pose: jax.Array, low: jax.Array, high: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Return where a robot sees the ball [m] (2,), and whether it does ().

    The ball is what the lower scanner meets and the upper one does not, within the boards. As the robot
    tilts when it brakes, only beams count that are then above the floor, and above the ball and below the
    top of robots.

    Args:
        pose: Pose of the robot: x, y, z [m], roll, pitch, yaw [rad] (6,).
        low: Ranges of the lower scanner [m] (beams,).
        high: Those of the upper one (beams,).
    """
    along = _directions(pose)
    rise, flat = low * along[:, 2], jnp.linalg.norm(along[:, :2], axis=-1)
    upper = UPPER_SCANNER_HEIGHT + rise
    # The lower beam clears the floor, the upper one passes over balls but meets the covers of robots.
    level = (LOWER_SCANNER_HEIGHT + rise > FLOOR_MARGIN) & (upper > 2 * BALL_RADIUS) & (upper < COVER[1])
    middle = pose[:2] + (low * flat + BALL_RADIUS)[:, None] * along[:, :2] / flat[:, None]
    met = (high > low + MIN_RANGE_GAP) & level & (depth_inside(middle) > BALL_RADIUS / 2)
    nearest = jnp.where(met, low, jnp.inf).min()
    # Beams that pass the ball's middle meet it first; those beside are on both sides.
    mine = met & (low < nearest + BALL_RADIUS)
    way = jnp.where(mine[:, None], along[:, :2], 0.0).sum(0)
    # Without a ball the direction is 0, and must not become NaN in the branch not taken.
    way = way / jnp.maximum(jnp.linalg.norm(way), 1e-6)
    return pose[:2] + (jnp.where(met.any(), nearest, 0.0) + BALL_RADIUS) * way, met.any()


def find_others(pose: jax.Array, high: jax.Array) -> jax.Array:
    """Return how far away robots are along the upper beams, `SCANNER_RANGE` for none [m] (beams,).

    They are what is neither board nor goal.
    """
    along = _directions(pose)
    hit = pose[:2] + high[:, None] * along[:, :2]
    return jnp.where((high < SCANNER_RANGE) & (depth_inside(hit) > BOARD_MARGIN), high, SCANNER_RANGE)


def _directions(pose: jax.Array) -> jax.Array:
    """Return the directions of a scanner's beams in the world (beams, 3)."""
    angle = beams()
    lines = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    return jnp.asarray(lines) @ mat_from_angles(pose[3], pose[4], pose[5], jnp).T


class SoccerReadings(NamedTuple):
    """Readings of the robots' sensors.

    Attributes:
        pose: Poses: x, y, z [m], roll, pitch, yaw [rad] (robots, 6).
        low: Ranges of the lower scanners [m] (robots, beams).
        high: Those of the upper ones (robots, beams).
        fresh: Whether these are of now (robots,).
    """

    pose: jax.Array
    low: jax.Array
    high: jax.Array
    fresh: jax.Array


def update_from_sensors(belief: SoccerBelief, readings: SoccerReadings, time: Array) -> SoccerBelief:
    """Return the belief after the sensors' readings at a time [s] ()."""
    ball, there = jax.vmap(find_ball)(readings.pose, readings.low, readings.high)
    others = jax.vmap(find_others)(readings.pose, readings.high)
    there = there & readings.fresh
    gap = time - belief.ball_time
    # The gap may be 0 right after mail of this moment.
    moved = jnp.clip((ball - belief.ball) / jnp.maximum(gap, 1e-3)[:, None], -MAX_BALL_SPEED, MAX_BALL_SPEED)
    moved = (1 - VELOCITY_SMOOTHING) * belief.velocity + VELOCITY_SMOOTHING * moved
    # After a longer gap the ball may have bounced: no velocity is better than a wrong one.
    moved = jnp.where((gap < MAX_VELOCITY_GAP)[:, None], moved, 0.0)
    return belief.replace(
        # Of x, y, z, roll, pitch, yaw.
        pose=readings.pose[:, (0, 1, 5)],
        others=jnp.where(readings.fresh[:, None], others, belief.others),
        ball=jnp.where(there[:, None], ball, belief.ball),
        velocity=jnp.where(there[:, None], moved, belief.velocity),
        ball_time=jnp.where(there, time, belief.ball_time),
    )


def update_from_mail(belief: SoccerBelief, mail: Inboxes) -> SoccerBelief:
    """Return the belief after robots read their mail: whoever saw the ball later is believed."""
    # Boxes hold the oldest first: the last valid place is the newest message.
    last, rows = jnp.maximum(mail.count - 1, 0), jnp.arange(len(belief.ball_time))
    payload, got = mail.payload[rows, last], mail.count > 0
    newer = got & (payload[:, 7] > belief.ball_time)
    return belief.replace(
        ball=jnp.where(newer[:, None], payload[:, 3:5], belief.ball),
        velocity=jnp.where(newer[:, None], payload[:, 5:7], belief.velocity),
        ball_time=jnp.where(newer, payload[:, 7], belief.ball_time),
        mate_pose=jnp.where(got[:, None], payload[:, :3], belief.mate_pose),
        mate_time=jnp.where(got, mail.time[rows, last], belief.mate_time),
    )


def compose_messages(belief: SoccerBelief, to: Array) -> OutgoingMessages:
    """Return the messages of robots to others (robots, robots)."""
    payload = jnp.concatenate([belief.pose, belief.ball, belief.velocity, belief.ball_time[:, None]], -1)
    length = jnp.full(len(payload), BYTES_PER_NUMBER * NUMBERS, jnp.int32)
    return OutgoingMessages(receivers=to, payload=payload, size_bytes=length)


MAIL_SETTINGS = MessageSettings(numbers=NUMBERS, capacity=2, bytes_per_step=BYTES_PER_NUMBER * NUMBERS)
"""Room for one message to the mate with every action."""
SIDES = np.array([1.0, 1.0, -1.0, -1.0], np.float32)
"""Which goal the robots shoot at, by slot: 1 for the one at +x, the yellow one. Slots 0 and 1 are blue."""
MATES = np.array([1, 0, 3, 2])
"""Each robot's mate, by slot."""
SPEED_SCALE = 1.0
"""Speed of the wheels at an action of 1 [m/s]; they could do 1.8."""
BALL_AGE_SCALE, MATE_AGE_SCALE = 3.0, 1.0
"""Largest observed ages of the ball's position and of the mate's mail [s]."""
POSITION_SCALE = 3.0
"""Positions in a robot's axes are observed as shares of this [m]."""
GOAL = np.array([GOAL_LINE, 0.0], np.float32)
"""The middle of the goal line at which blue shoots [m]."""
OPPONENTS = ("self", "baseline", "random", "still")


class SoccerMemory(struct.PyTreeNode, kw_only=True):
    """The task's memory of an episode.

    Attributes:
        belief: Beliefs of each robot (robots, ...).
        potential: Worth of the game for blue, see `Soccer` ().
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

    With a `discount` the gain is `discount` times the new w, less the old one, and w is 0 once the episode
    is over. Discounted by that, the gains of any episode add up to -w of its start, so they change nothing
    about which policy is best by sums so discounted (Ng, Harada and Russell 1999). Version 2 has 1: sums of
    an episode rank policies by goals alone. Learners that discount more profit from a w that stays high; from
    those that discount by the same a critic that knows w takes all gains back.

    Score: 1 for a goal of blue, -1 for one of yellow, 0 for none. A goal is scored when the whole ball is in
    it; with that the episode ends. A mean of scores is goals less goals against per episode.

    Attributes:
        opponent: Driver of yellow: `self`, the agents, with the policy of blue; `baseline`; `random`, wheel
            speeds drawn for each step; `still`, none. But for `self` only blue's robots are agents.
        bonus: Reward for a goal.
        approach: Reward per metre nearer to the ball.
        discount: Discount of the gain; None: 1, and w counts at the end of an episode, too.
    """

    about: ClassVar[str] = "Two robots play soccer against two others."
    reports_itself: ClassVar[bool] = True

    arena: Arenas = SOCCER_FIELD
    repeat: int = 5
    episode_steps: int = 400
    time_limit: TimeLimit = "end"
    radio: RadioSettings | None = field(default_factory=RadioSettings)
    mail: MessageSettings | None = MAIL_SETTINGS
    opponent: Annotated[str, Setting(choices=OPPONENTS)] = "self"
    bonus: float = 5.0
    approach: float = 0.2
    discount: Annotated[float | None, Setting(ge=0, le=1)] = None

    @cached_property
    def _robots(self) -> tuple[RobotSpec, ...]:
        if self.opponent not in OPPONENTS:
            raise UsageError(f"opponent {self.opponent}, expected one of {', '.join(OPPONENTS)}")
        # One group for both teams only if one policy drives them: groups share their policy.
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

    @property
    def rivals(self) -> tuple[int, ...]:
        """Yellow, if its robots are agents."""
        return (2, 3) if self.opponent == "self" else ()

    def action_sizes(self, scene: Scene) -> tuple[int, ...]:
        """Left and right."""
        return (2,)

    def act(self, view: TaskView, memory: SoccerMemory, actions: tuple[jax.Array, ...]) -> Actions:
        """Speeds of the wheels, and messages to the mates."""
        commanded = {0: actions[0]}
        if self.opponent == "baseline":
            commanded[1] = jax.vmap(soccer_action)(self.observations(view, memory)[2:])
        elif self.opponent == "random":
            # By the world's own key: its game is the same alone as in a batch.
            commanded[1] = jax.random.uniform(view.key, (2, 2), minval=-1.0, maxval=1.0)
        elif self.opponent == "still":
            commanded[1] = jnp.zeros((2, 2))
        drive: dict[int, dict[str, jax.Array]] = {}
        for group, speeds in commanded.items():
            # Wheels are commanded by their turning rate [rad/s].
            spins = SPEED_SCALE * speeds / view.scene.groups[group].robot.wheel_radius
            drive[group] = {"Left": spins[:, 0], "Right": spins[:, 1]}
        to = jnp.asarray(np.arange(4) == MATES[:, None])
        return Actions(
            drive=drive, messages=None if view.world.mail is None else compose_messages(memory.belief, to)
        )

    def update_belief(self, view: TaskView, belief: SoccerBelief) -> SoccerBelief:
        """Return the belief after the robots read their mail and sensors."""
        if view.world.mail is not None:
            # Mail first: sensors of this moment are newer than any message.
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

    def started_at(self, memory: SoccerMemory, steps: jax.Array) -> SoccerMemory:
        """See `Task`."""
        return memory.replace(step=steps)

    def observe(self, view: TaskView, memory: SoccerMemory) -> tuple[jax.Array, ...]:
        """See `Soccer`."""
        return (self.observations(view, memory)[: len(view.scene.groups[0].slots)],)

    def observations(self, view: TaskView, memory: SoccerMemory) -> jax.Array:
        """Return what each robot sees, agent or not, by slot (robots, n)."""
        belief, sides = memory.belief, SIDES[:, None]
        goal = jnp.asarray(sides * GOAL)
        pose, robots = belief.pose, len(SIDES)
        # Half a turn of the field changes the signs of both sine and cosine.
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
        """True positions of ball and robots, as shares of the field, and how fast [m/s]; time left."""
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

    def gain(self, before: jax.Array, after: jax.Array, over: jax.Array) -> jax.Array:
        """Return what a step that changes the potential brings blue, see `Soccer` ().

        Args:
            before: Potential before it.
            after: Potential after it.
            over: Whether the episode is over with it.
        """
        if self.discount is None:
            return after - before
        # Without the cut at the end the gains would not add up to -w of the start (Ng, Harada and Russell
        # 1999).
        return self.discount * jnp.where(over, 0.0, after) - before

    def evaluate(self, view: TaskView, memory: SoccerMemory) -> StepResult:
        """Goals, and the gain of the potential."""
        ball, _ = self.true_positions(view)
        goal, potential = goal_scored(ball), self.potential(view)
        # The step count is that before this action.
        over = (goal != 0) | (memory.step + 1 >= self.episode_steps)
        gain = self.gain(memory.potential, potential, over) + self.bonus * goal
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
                "scored": jnp.maximum(goal, 0.0),
                "known": (
                    view.time - memory.belief.ball_time < 2 * self.repeat * view.scene.physics.period
                ).mean(),
            },
        )
