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
from usarmjx.comms.mail import BYTES_PER_NUMBER, MailSettings
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sim.scene import Scene
from usarmjx.train.envs.actions import Orders
from usarmjx.train.envs.recipe import Arenas
from usarmjx.train.envs.task import Task, Verdict, View
from usarmjx.train.tasks.pitch import BLUE, GOAL_LINE, PITCH, REACH, SIDE_BOARD, YELLOW, goal_scored, player
from usarmjx.train.tasks.ranges import sectors
from usarmjx.train.tasks.soccer_knowledge import (
    LOWER,
    NUMBERS,
    UPPER,
    Look,
    Sight,
    letters,
    listen,
    look,
    nothing,
)
from usarmjx.train.tasks.soccer_play import play
from usarmjx.train.tasks.team_parts import local

WORDS = MailSettings(numbers=NUMBERS, capacity=2, budget=BYTES_PER_NUMBER * NUMBERS)
"""Room for one message to the mate with every action."""
SIDES = np.array([1.0, 1.0, -1.0, -1.0], np.float32)
"""Which goal the robots shoot at, by slot: 1 for the one at +x, the yellow one. Slots 0 and 1 are blue."""
MATES = np.array([1, 0, 3, 2])
"""Each robot's mate, by slot."""
PACE = 1.0
"""What an action of 1 is as a speed of the wheels [m/s]; they could do 1.8."""
FORGET, SILENT = 3.0, 1.0
"""Where the ball was, and what the mate wrote, are observed to be that old at most [s]."""
NEAR = 3.0
"""Places in a robot's axes are observed as shares of this [m]."""
GOAL = np.array([GOAL_LINE, 0.0], np.float32)
"""The middle of the goal line at which blue shoots [m]."""
OPPONENTS = ("self", "baseline", "still")


class SoccerMemory(struct.PyTreeNode, kw_only=True):
    """What the task remembers of an episode.

    Attributes:
        sight: What each robot knows (robots, ...).
        worth: How good the game stands for blue, see `Soccer` ().
        score: Goals of blue less those of yellow ().
        step: Actions so far ().
    """

    sight: Sight
    worth: jax.Array
    score: jax.Array
    step: jax.Array


@dataclass(frozen=True, kw_only=True)
class Soccer(Task):
    """Get the ball into the other team's goal: two against two.

    Blue shoots at the goal at +x, yellow at the one at -x; everything is observed as blue would see it, for
    yellow after half a turn of the field. The ball lies on the centre spot; the robots' places are drawn from
    12 on both halves.

    Observation, by the robot's own sensors and by what its mate writes ten times a second:
    - its place (1: 2.7 m along, 2 m across the field), sine and cosine of its heading;
    - in its own axes, x ahead and y left (1: 3 m): the goal to shoot at, its own goal, the ball where it or
      its mate saw it last;
    - the velocity of the ball then, in its axes (1: 1 m/s), and how long ago that is (1: 3 s or never);
    - where its mate said to be, in its axes (1: 3 m), and how long ago (1: 1 s or never);
    - which of the two it is: 0 or 1; the share of the time that is left;
    - the nearest robot in each of 19 sectors of its upper scanner, from right to left (1: 4 m or none).

    Action: speeds of the left and right wheels (1: 1 m/s).

    The game stands for blue as w = (a - b) / 2 + `approach` (d - c), all in metres: a is how far the ball is
    from the middle of blue's goal line, b how far from that of yellow's, c how far from blue's nearest robot,
    d how far from yellow's.

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

    arena: Arenas = PITCH
    repeat: int = 5
    episode_steps: int = 400
    radio: RadioSettings | None = field(default_factory=RadioSettings)
    mail: MailSettings | None = WORDS
    opponent: str = "self"
    bonus: float = 5.0
    approach: float = 0.2

    @cached_property
    def robots(self) -> tuple[RobotSpec, ...]:
        """Blue, then yellow; if both have the same policy, they are robots of one kind."""
        if self.opponent not in OPPONENTS:
            raise UsageError(f"opponent {self.opponent}, expected one of {', '.join(OPPONENTS)}")
        other = BLUE if self.opponent == "self" else YELLOW
        return (player(BLUE),) * 2 + (player(other),) * 2

    def scene(self) -> Scene:
        """Return the scene.

        Raises:
            UsageError: An arena without a ball, or with other loose things.
        """
        scene = super().scene()
        if len(scene.arena.loose) != 1:
            raise UsageError(f"soccer in {scene.arena.name}: expected one loose object, the ball")
        return scene

    def groups(self, scene: Scene) -> tuple[int, ...]:
        """Both teams, or blue."""
        return (0,)

    def action_sizes(self, scene: Scene) -> tuple[int, ...]:
        """Left and right."""
        return (2,)

    def act(self, view: View, memory: SoccerMemory, actions: tuple[jax.Array, ...]) -> Orders:
        """Speeds of the wheels, and letters to the mates."""
        told = {0: actions[0]}
        if self.opponent == "baseline":
            told[1] = jax.vmap(play)(self.seen(view, memory)[2:])
        elif self.opponent == "still":
            told[1] = jnp.zeros((2, 2))
        drive = {}
        for team, speeds in told.items():
            spins = PACE * speeds / view.scene.teams[team].robot.wheel_radius
            drive[team] = {"Left": spins[:, 0], "Right": spins[:, 1]}
        to = jnp.asarray(np.arange(4) == MATES[:, None])
        return Orders(drive=drive, letters=None if view.world.mail is None else letters(memory.sight, to))

    def learn(self, view: View, sight: Sight) -> Sight:
        """Return what the robots know after they looked at their sensors and mail."""
        if view.world.mail is not None:
            sight = listen(sight, view.mail)
        teams = range(len(view.scene.teams))

        def told(kind: str) -> jax.Array:
            return jnp.concatenate([view.sensor(team, kind) for team in teams])

        fresh = jnp.concatenate([view.fresh(team, LOWER) & view.fresh(team, UPPER) for team in teams])
        seen = Look(pose=told("GroundTruth"), low=told(LOWER), high=told(UPPER), fresh=fresh)
        return look(sight, seen, view.time)

    def start(self, view: View, key: jax.Array) -> SoccerMemory:
        """Robots know what their first scans show."""
        del key
        return SoccerMemory(
            sight=self.learn(view, nothing(len(SIDES))),
            worth=self.worth(view),
            score=jnp.zeros(()),
            step=jnp.zeros((), jnp.int32),
        )

    def observe(self, view: View, memory: SoccerMemory) -> tuple[jax.Array, ...]:
        """See `Soccer`."""
        return (self.seen(view, memory)[: len(view.scene.teams[0].slots)],)

    def seen(self, view: View, memory: SoccerMemory) -> jax.Array:
        """Return what each robot sees, agent or not, by slot (robots, n)."""
        sight, sides = memory.sight, SIDES[:, None]
        goal = jnp.asarray(sides * GOAL)
        pose, robots = sight.pose, len(SIDES)
        heading = sides * jnp.stack([jnp.sin(pose[:, 2]), jnp.cos(pose[:, 2])], -1)
        # A velocity turns as a place does that is seen from the origin.
        turned = local(pose.at[:, :2].set(0.0), sight.velocity)
        ball, mate = (view.time - when for when in (sight.seen, sight.heard))
        known, met = sight.seen >= 0, sight.heard >= 0
        left = jnp.full((robots, 1), 1.0 - memory.step / self.episode_steps)
        rows = [
            sides * pose[:, :2] / np.array([GOAL_LINE, SIDE_BOARD], np.float32),
            heading,
            local(pose, goal) / NEAR,
            local(pose, -goal) / NEAR,
            jnp.where(known[:, None], local(pose, sight.ball) / NEAR, 0.0),
            turned,
            jnp.minimum(ball / FORGET, 1.0)[:, None],
            jnp.where(met[:, None], local(pose, sight.mate[:, :2]) / NEAR, 0.0),
            jnp.minimum(mate / SILENT, 1.0)[:, None],
            np.arange(robots)[:, None] % 2.0,
            left,
            sectors(sight.others) / REACH,
        ]
        return jnp.concatenate(rows, -1)

    def privileged(self, view: View, memory: SoccerMemory) -> jax.Array:
        """Where the ball and the robots truly are, as shares of the field, and how fast [m/s]; time left."""
        ball, places = self.truth(view)
        size = np.array([GOAL_LINE, SIDE_BOARD], np.float32)
        speed = jnp.concatenate([view.robots(t).linear[:, :2] for t in range(len(view.scene.teams))])
        left = 1.0 - memory.step / self.episode_steps
        rolls = view.physics.qvel[view.scene.loose_geoms.root_dof[0, :2]]
        parts = [ball / size, rolls, (places / size).ravel(), speed.ravel(), left[None]]
        return jnp.concatenate(parts)

    def truth(self, view: View) -> tuple[jax.Array, jax.Array]:
        """Return where the ball (2,) and the robots (robots, 2) truly are [m]."""
        ball = view.physics.qpos[view.scene.loose_geoms.root_qpos[0, :2]]
        teams = range(len(view.scene.teams))
        return ball, jnp.concatenate([view.robots(t).pos[:, :2] for t in teams])

    def worth(self, view: View) -> jax.Array:
        """Return how good the game stands for blue, see `Soccer` [m] ()."""
        ball, places = self.truth(view)
        to_goals = jnp.linalg.norm(ball + GOAL), jnp.linalg.norm(ball - GOAL)
        away = jnp.linalg.norm(places - ball, axis=-1)
        nearest = away[2:].min() - away[:2].min()
        return (to_goals[0] - to_goals[1]) / 2 + self.approach * nearest

    def judge(self, view: View, memory: SoccerMemory) -> Verdict:
        """Goals, and how the game stands."""
        ball, _ = self.truth(view)
        goal, worth = goal_scored(ball), self.worth(view)
        gain = worth - memory.worth + self.bonus * goal
        score = memory.score + goal
        memory = SoccerMemory(
            sight=self.learn(view, memory.sight), worth=worth, score=score, step=memory.step + 1
        )
        agents = len(view.scene.teams[0].slots)
        return Verdict(
            memory=memory,
            reward=(gain * SIDES[:agents],),
            terminated=goal != 0,
            score=score,
            metrics={
                "ball": ball[0],
                "goals": jnp.abs(goal),
                "known": (view.time - memory.sight.seen < 2 * self.repeat * view.scene.physics.period).mean(),
            },
        )
