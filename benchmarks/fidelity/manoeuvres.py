"""The manoeuvres: each is driven once and gives one number."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from benchmarks.fidelity.conditions import Conditions, SingleTrack
from benchmarks.fidelity.track import MAX_SPEED, Ground, Order, Orders, orders_of, touches_ground
from usarmjx.base.errors import EngineError
from usarmjx.models.compile.kinematic_tree import bounding_box
from usarmjx.models.compile.physics import Physics
from usarmjx.models.effecters import effecters_of
from usarmjx.models.effecters.standard import LEVER
from usarmjx.models.types.arena import LooseObject
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import Shape

MASSES = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0)
"""Of the blocks that are gripped [kg]."""
HALF = 0.03
"""Half the edge of a block [m]."""
WIDE = 2 * math.asin((HALF + 0.0005) / LEVER)
"""Angle to which a gripper opens, its fingers 1 mm farther apart than a block is wide [rad]."""
HELD = 2 * HALF
"""A block that has slipped by less is held [m]."""
AWAY = (3.0, 0.0, HALF)
"""Where a block lies until it is put between the fingers [m]."""


def flipper_lift(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Height gained when it stands on its flippers, after 8 s [m]."""
    assert orders.flippers is not None
    track = conditions.track(robot)
    track.run(1.0)
    low = track.pose()[0][2]
    track.move(orders.flippers)
    track.run(8.0)
    return float(track.pose()[0][2] - low)


class Grasp:
    """A robot whose gripper closes on a block that was put between its fingers.

    Args:
        physics: The settings.
        robot: The class.
        gripper: Index of its gripper.
        mass: Of the block [kg].
    """

    def __init__(self, physics: Physics, robot: RobotSpec, gripper: int, mass: float) -> None:
        shape = Shape(kind="box", size=(HALF, HALF, HALF), mass=mass, surface="loose")
        block = LooseObject(name="block", at=AWAY, shapes=(shape,))
        self.track = SingleTrack(physics, robot, Ground(loose=(block,)))
        self._hand = effecters_of(robot)[gripper]
        engine = self.track.world.engine
        self._block = engine.model.body("loose/block").id
        fingers = [self.track.body(name) for name in self._hand.joints]
        self._geoms = np.flatnonzero(np.isin(engine.model.geom_bodyid, fingers))
        self._operate(gripper, WIDE)
        self.track.run(2.0)
        start = engine.model.body_jntadr[self._block]
        place, rest = engine.model.jnt_qposadr[start], engine.model.jnt_dofadr[start]
        engine.data.qpos[place : place + 3] = engine.data.geom_xpos[self._geoms].mean(0)
        mujoco.mju_mat2Quat(engine.data.qpos[place + 3 : place + 7], engine.data.xmat[fingers[0]])
        engine.data.qvel[rest : rest + 6] = 0.0
        self._operate(gripper, 0.0)

    def _operate(self, gripper: int, angle: float) -> None:
        opened = self._hand.opcode("Open")
        assert opened is not None
        self.track.world.operate(0, gripper, opened, angle)

    @property
    def holds(self) -> bool:
        """Whether the block is between the fingers."""
        data = self.track.world.engine.data
        apart = data.xpos[self._block] - data.geom_xpos[self._geoms].mean(0)
        return bool(np.linalg.norm(apart) < HELD)


def gripper_hold(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """The heaviest block that its gripper holds for 4 s [kg]; 0: none."""
    assert orders.gripper is not None
    heaviest = 0.0
    for mass in MASSES:
        grasp = Grasp(conditions.physics, robot, orders.gripper, mass)
        grasp.track.run(4.0)
        if not grasp.holds:
            break
        heaviest = mass
    return heaviest


BOARDS = (0.02, 0.04, 0.06, 0.08, 0.10, 0.13, 0.16, 0.20, 0.25)
"""Heights of boards that robots are driven at [m]."""
SLOPE = math.radians(15.0)
RAMP = Shape(
    kind="box",
    size=(20.0, 5.0, 0.1),
    at=(0.1 * math.sin(SLOPE), 0.0, -0.1 * math.cos(SLOPE)),
    rotation=(0.0, -SLOPE, 0.0),
)
GAP = 1.0
"""How far ahead of a robot a wall, a board, a block or half of the way to the other robot is [m]."""
LEAST_GAP = 0.05
"""From the robot to a wall beside its way, at the start [m]."""
SHARE = 0.4
"""Share of the straight order at which robots meet with things."""
LENGTH = 1.0
"""How much farther a robot may need to get onto a board [m]."""
BLOCK_MASS = 2.0
"""[kg]"""


def _ahead(robot: RobotSpec) -> float:
    """Return how far ahead of its middle a robot meets with something [m]."""
    return GAP + float(bounding_box(robot)[1][0])


def _slowly(orders: Orders) -> Order:
    return {key: SHARE * value for key, value in orders.straight.items()}


def top_speed(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Distance in 4 s from a standing start [m]."""
    track = conditions.track(robot)
    track.tell(orders.straight)
    track.run(4.0)
    return float(np.linalg.norm(track.pose()[0][:2]))


def spin(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Turn on the spot in 6 s [rad]."""
    assert orders.spin is not None
    track = conditions.track(robot)
    track.tell(orders.spin)
    return track.turn(6.0)


def arc(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Turn round a bend in 6 s [rad]."""
    assert orders.arc is not None
    track = conditions.track(robot)
    track.tell(orders.arc)
    return track.turn(6.0)


def ramp_hold(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Way that it creeps in 5 s on a slope of 15 degrees, from 1 s after it was put there [m]."""
    del orders
    track = conditions.track(robot, Ground((RAMP,), slope=SLOPE))
    track.run(1.0)
    before = track.pose()[0]
    track.run(5.0)
    return float(np.linalg.norm(track.pose()[0] - before))


def climb(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """The highest board that it gets onto [m]."""
    height = 0.0
    for board in BOARDS:
        x = _ahead(robot)
        step = Shape(kind="box", size=(10.0, 5.0, board / 2), at=(x + 10.0, 0.0, board / 2))
        track = conditions.track(robot, Ground((step,)))
        track.tell(_slowly(orders))
        track.run(3.0 * (x + LENGTH) / (SHARE * min(robot.drive.top_speed, MAX_SPEED)))
        if track.pose()[0][0] < x:
            break
        height = board
    return height


def wall(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Way in 5 s of driving straight at a wall [m]."""
    x = _ahead(robot)
    block = Shape(kind="box", size=(0.1, 10.0, 2.0), at=(x + 0.1, 0.0, 0.0))
    track = conditions.track(robot, Ground((block,)))
    track.tell(_slowly(orders))
    track.run(5.0)
    return float(track.pose()[0][0])


def oblique_wall(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Way in 5 s against a wall that stands 30 degrees from its way [m]."""
    x, angle, half = _ahead(robot), math.radians(30.0), 0.1
    # A car is so wide that the wall would be where it begins: its corner meets the wall first.
    front, side = bounding_box(robot)[1][:2]
    x = max(x, float(front) + (float(side) * math.cos(angle) + half + LEAST_GAP) / math.sin(angle))
    block = Shape(kind="box", size=(10.0, half, 2.0), at=(x, 0.0, 0.0), rotation=(0.0, 0.0, angle))
    track = conditions.track(robot, Ground((block,)))
    track.tell(_slowly(orders))
    track.run(5.0)
    return float(np.linalg.norm(track.pose()[0][:2]))


def head_on(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Distance of two robots that drive at each other for 5 s [m]."""
    x = _ahead(robot)
    track = conditions.track(robot, Ground(poses=((-x, 0.0, 0.0), (x, 0.0, math.pi))))
    for slot in (0, 1):
        track.tell(_slowly(orders), slot)
    track.run(5.0)
    return float(np.linalg.norm((track.pose(0)[0] - track.pose(1)[0])[:2]))


def push(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Way that a block of 2 kg is pushed in 5 s [m]."""
    x, half = _ahead(robot), 0.15
    shape = Shape(kind="box", size=(half, 0.4, half), mass=BLOCK_MASS)
    block = LooseObject(name="block", at=(x, 0.0, half), shapes=(shape,))
    track = conditions.track(robot, Ground(loose=(block,)))
    track.tell(_slowly(orders))
    track.run(5.0)
    return float(track.thing()[0] - x)


def speed(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Speed from 3 to 4 s after a standing start [m/s]."""
    track = conditions.track(robot)
    track.tell(orders.straight)
    track.run(3.0)
    before = track.pose()[0]
    track.run(1.0)
    return float(np.linalg.norm(track.pose()[0] - before))


def stop(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Way in the 2 s after the order to stand, which comes at top speed [m]."""
    track = conditions.track(robot)
    track.tell(orders.straight)
    track.run(4.0)
    before = track.pose()[0]
    track.tell(dict.fromkeys(orders.straight, 0.0))
    track.run(2.0)
    return float(np.linalg.norm(track.pose()[0] - before))


def turning_rate(conditions: Conditions, robot: RobotSpec, orders: Orders) -> float:
    """Rate of turn on the spot, from 2 to 5 s after standing still [rad/s]."""
    assert orders.spin is not None
    track = conditions.track(robot)
    track.tell(orders.spin)
    track.run(2.0)
    return track.turn(3.0) / 3.0


ENGINES = ("c", "jax", "warp", "planar")


@dataclass(frozen=True)
class Manoeuvre:
    """A manoeuvre.

    Attributes:
        measure: Drives it.
        unit: Of its number.
        least: A difference that counts for nothing, however small the number.
        ground: Whether it needs ground under the robot.
        needs: The one of `Orders` that it needs.
        engines: Engines that can do it: to `planar` things that lie loose are walls, and blocks are put
            between fingers in a single world only.
    """

    measure: Callable[[Conditions, RobotSpec, Orders], float]
    unit: str
    least: float
    ground: bool = True
    needs: str = "straight"
    engines: tuple[str, ...] = ENGINES

    def fits(self, robot: RobotSpec, orders: Orders | None) -> bool:
        """Return whether a class can be driven so."""
        return (
            orders is not None
            and (touches_ground(robot) or not self.ground)
            and getattr(orders, self.needs) is not None
        )


MANOEUVRES = {
    "top speed": Manoeuvre(top_speed, "m", 0.02, ground=False),
    "spin": Manoeuvre(spin, "rad", 0.05, ground=False, needs="spin"),
    "arc": Manoeuvre(arc, "rad", 0.05, ground=False, needs="arc"),
    "ramp hold": Manoeuvre(ramp_hold, "m", 0.02),
    "climb": Manoeuvre(climb, "m", 0.021),
    "wall": Manoeuvre(wall, "m", 0.02),
    "oblique wall": Manoeuvre(oblique_wall, "m", 0.05),
    "head-on": Manoeuvre(head_on, "m", 0.02),
    "push": Manoeuvre(push, "m", 0.05, engines=("c", "jax", "warp")),
    "flipper lift": Manoeuvre(flipper_lift, "m", 0.005, needs="flippers", engines=("c", "jax", "warp")),
    "gripper hold": Manoeuvre(gripper_hold, "kg", 0.1, needs="gripper", engines=("c",)),
}
"""Those of every card."""
SHEET_MANOEUVRES = {
    "speed": Manoeuvre(speed, "m/s", 0.01, ground=False),
    "stop": Manoeuvre(stop, "m", 0.02),
    "turning rate": Manoeuvre(turning_rate, "rad/s", 0.02, ground=False, needs="spin"),
}
"""Those beside which data sheets have figures, and the way to a stop: of cards of engines."""


def manoeuvres_on(engine: str) -> dict[str, Manoeuvre]:
    """Return the manoeuvres of a card of an engine; that of `c` has none beside data sheets."""
    if engine == "c":
        return MANOEUVRES
    return {name: one for name, one in (SHEET_MANOEUVRES | MANOEUVRES).items() if engine in one.engines}


def drive_all(
    conditions: Conditions, robot: RobotSpec, manoeuvres: Mapping[str, Manoeuvre] = MANOEUVRES
) -> dict[str, float]:
    """Return the numbers of all manoeuvres that fit a class; NaN where the physics went bad."""
    orders = orders_of(robot)
    if orders is None:
        return {}
    numbers: dict[str, float] = {}
    for name, manoeuvre in manoeuvres.items():
        if manoeuvre.fits(robot, orders):
            try:
                numbers[name] = manoeuvre.measure(conditions, robot, orders)
            except EngineError:
                numbers[name] = math.nan
    return numbers
