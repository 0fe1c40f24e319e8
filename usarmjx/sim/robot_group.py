"""The robots of one class in a scene, and where they are in its model."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np

from usarmjx.models.build.body_plan import KinematicTree, kinematic_tree_of
from usarmjx.models.build.layout import RobotIndex, index_robot
from usarmjx.models.effecters import Effecter, effecters_of
from usarmjx.models.spec.robot import RobotSpec
from usarmjx.sensors.suite import Suite, suite_of


@dataclass(frozen=True, eq=False)
class RobotGroup:
    """The robots of one class in a scene; arrays have a leading axis over them.

    Attributes:
        plan: Body plan of the class.
        suite: Its sensors.
        slots: Roster slots of the robots (n,).
        indices: Where each lies in the model.
    """

    plan: KinematicTree
    suite: Suite
    slots: np.ndarray
    indices: tuple[RobotIndex, ...]

    @property
    def robot(self) -> RobotSpec:
        """The robot class."""
        return self.plan.robot

    def part(self, members: np.ndarray) -> "RobotGroup":
        """Return a group of some of its robots (members,)."""
        return replace(
            self, slots=self.slots[members], indices=tuple(self.indices[int(i)] for i in members.tolist())
        )

    @property
    def effecters(self) -> tuple[Effecter, ...]:
        """The effecters of the class."""
        return effecters_of(self.robot)

    @property
    def releases(self) -> tuple[int, ...]:
        """What each effecter carries to release."""
        return tuple(effecter.initial_stock for effecter in self.effecters)

    @cached_property
    def root_qposadr(self) -> np.ndarray:
        """Qpos addresses of the free joints (n, 7)."""
        return np.array([index.root_qposadr + np.arange(7) for index in self.indices])

    @cached_property
    def root_dofadr(self) -> np.ndarray:
        """Qvel addresses of the free joints (n, 6)."""
        return np.array([index.root_dofadr + np.arange(6) for index in self.indices])

    @cached_property
    def qposadr(self) -> np.ndarray:
        """Qpos addresses of the joints (n, joints)."""
        return np.array([index.qposadr for index in self.indices], int)

    @cached_property
    def dofadr(self) -> np.ndarray:
        """Qvel addresses of the joints (n, joints)."""
        return np.array([index.dofadr for index in self.indices], int)

    @cached_property
    def actuator_ids(self) -> np.ndarray:
        """Ids of the actuators that pull (n, actuators)."""
        return np.array([index.actuator_ids for index in self.indices], int)

    @cached_property
    def actadr(self) -> np.ndarray:
        """Addresses of the actuators' activations (n, actuators)."""
        return np.array([index.actadr for index in self.indices], int)

    @cached_property
    def hold_actuator_ids(self) -> np.ndarray:
        """Ids of the actuators that hold the joints (n, actuators)."""
        return np.array([index.hold_actuator_ids for index in self.indices], int)

    @cached_property
    def chassis(self) -> np.ndarray:
        """Body ids of the chassis (n,)."""
        return np.array([index.body_ids[0] for index in self.indices])


def prefix_of(slot: int) -> str:
    """Return the prefix of the names of a slot's robot in the model."""
    return f"r{slot}/"


def robot_groups(model: mujoco.MjModel, robots: Mapping[int, RobotSpec]) -> tuple[RobotGroup, ...]:
    """Return the robots of a model, by slot, as groups by class."""
    slots: dict[RobotSpec, list[int]] = {}
    for slot, robot in robots.items():
        slots.setdefault(robot, []).append(slot)
    return tuple(
        RobotGroup(
            plan=kinematic_tree_of(robot),
            suite=suite_of(robot),
            slots=np.array(members),
            indices=tuple(index_robot(model, robot, prefix_of(slot)) for slot in members),
        )
        for robot, members in slots.items()
    )
