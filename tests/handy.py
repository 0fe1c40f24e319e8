"""Robots with effecters, for tests: what no robot of the product has in so simple a form."""

from contextlib import contextmanager
from dataclasses import replace

import jax
import numpy as np

from usarmjx.base.backend import numpy_backend
from usarmjx.models.effecters import effecters_of, no_dropped_tags
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import LooseObject
from usarmjx.models.types.robot import Link, MissionPackage, Motor, Mount, options
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.operate import EffecterState, Operation, apply_operation

LIFT = MissionPackage(
    name="Lift",  # a slide in front of the robot: negative is up
    links=(
        Link(
            number=1,
            parent=-1,
            location=(0.30, 0.0, 0.23),
            orientation=(0.0, 0.0, 0.0),
            max_speed=0.2,
            max_torque=150.0,
            min_range=-0.25,
            max_range=0.0,
            joint="Prismatic",
            motor=Motor(max_speed=0.2, torque=150.0, stiffness=2000.0, damping=100.0, armature=1.0),
            shapes=(Shape(kind="box", size=(0.01, 0.04, 0.02), mass=0.5),),
        ),
    ),
)
GRIPPER = Mount(kind="Gripper", name="Gripper", parent="Lift_Link1", at=(0.01, 0.0, 0.0))
GRABBER = replace(
    P2AT,
    name="Grabber",
    packages=(*P2AT.packages, LIFT),
    sensors=tuple(mount for mount in P2AT.sensors if mount.kind in ("Odometry", "GroundTruth")),
    effecters=(GRIPPER,),
)
"""A P2AT with a gripper on a slide: its fingers are 3 cm above the ground, 0.33 to 0.43 m ahead."""

TAGGER = replace(
    GRABBER,
    name="Tagger",
    effecters=(
        Mount(kind="RFIDReleaser", name="Gun", at=(-0.3, 0.1, -0.1), options=options(NumTags=3)),
        Mount(kind="Headlight", name="Lamp", at=(0.2, 0.0, -0.1), direction=(0.0, 0.1, 0.0)),
        GRIPPER,
    ),
)
"""One with three tags, a lamp and the gripper."""


@contextmanager
def known(*robots):
    """Make robot classes known by name for a while."""
    for robot in robots:
        ROBOTS.add(robot.name, robot)
    try:
        yield
    finally:
        for robot in robots:
            del ROBOTS._entries[robot.name.lower()]


def block(at, half=(0.03, 0.03, 0.03), mass=0.3, name="block"):
    """A loose box that lies on the floor at (x, y), or at (x, y, z)."""
    x, y, z = at if len(at) == 3 else (*at, half[2])
    return LooseObject(
        name=name, at=(x, y, z), shapes=(Shape(kind="box", size=half, mass=mass, surface="loose"),)
    )


def operate(rig, name, opcode, value=0.0):
    """Let the robot of a rig operate an effecter without stock; return whether that was done."""
    effecter = next(e for e in effecters_of(rig.robot) if e.mount.name == name)
    with numpy_backend():
        load, outcome = apply_operation(
            Operation(rig.robot, effecter, effecter.opcode(opcode)),
            np.array([value]),
            EffecterState(
                command=jax.tree.map(lambda x: x[None], rig.commands[0]),
                stock=np.zeros(1, int),
                tags=no_dropped_tags(),
            ),
            mask=np.array([True]),
            ground=lambda: np.full((1, 3), np.inf),
        )
    rig.commands[0] = jax.tree.map(lambda x: np.array(x[0]), load.command)
    return bool(outcome.done[0])
