"""Vacuum grippers of a single world: they hold the loose object ahead of them as they met it.

The later versions' Vacuum.uc casts a ray of SuctionLength along the gripper's x axis and fixes what it meets
by a joint. An object that then moves by more than that length is let go, and the gripper is open.
"""

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from usarmjx.base.transforms import flip_vector, mat_from_angles
from usarmjx.engines.c.rays import CRayCaster
from usarmjx.engines.c.world import CWorld
from usarmjx.models.compile.compose import LOOSE_PREFIX, RobotIndex
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.effecters import Effecter
from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import SKY
from usarmjx.sensors.rays.raycast import RayQuery

Place = tuple[int, int]
"""Slot of a robot and index of its effecter."""


@dataclass(frozen=True)
class Hold:
    """An object that a vacuum holds.

    Attributes:
        name: The weld's name.
        base: Body that the vacuum is mounted on.
        thing: Body of the loose object.
        pos: Position of the object in the base's axes when it was met [m] (3,).
        reach: Largest movement from there [m].
    """

    name: str
    base: str
    thing: str
    pos: np.ndarray
    reach: float


class Suction:
    """Vacuums of a world that are closed, and what they hold.

    Args:
        engine: The world's physics.
        changed: Is called whenever the model has been compiled anew.
    """

    def __init__(self, engine: CWorld, changed: Callable[[], None]) -> None:
        self._engine, self._changed = engine, changed
        self._closed: dict[Place, Hold | None] = {}

    def is_closed(self, place: Place) -> bool:
        """Return whether a vacuum is closed, whether or not it holds anything."""
        return place in self._closed

    def close(
        self, place: Place, robot: RobotSpec, index: RobotIndex, effecter: Effecter, caster: CRayCaster
    ) -> None:
        """Close a vacuum; it holds the loose object ahead of it, if it has held nothing so far.

        Args:
            place: The vacuum's.
            robot: Its robot's class.
            index: Indices of its robot.
            effecter: The vacuum.
            caster: Casts rays in the present state.
        """
        # One that has closed on nothing may close again.
        if self._closed.get(place) is not None:
            return
        model, data = self._engine.model, self._engine.data
        base = index.body_ids[kinematic_tree_of(robot).parts.index(effecter.mount.parent)]
        thing, reach = self._ahead(caster, place[0], base, effecter), effecter.settings.suction_length
        if thing is None:
            # Closed on nothing: it reports so, and catches nothing that comes by until it is closed again.
            self._closed[place] = None
            return
        one, other = model.body(base).name, model.body(thing).name
        # In the part's axes, as `_is_lost` compares it.
        pos = data.xmat[base].reshape(3, 3).T @ (data.xpos[thing] - data.xpos[base])
        hold = Hold("vacuum {}/{}".format(*place), one, other, pos, reach)
        self._engine.weld(hold.name, one, other)
        self._closed[place] = hold
        self._changed()

    def _ahead(self, caster: CRayCaster, slot: int, base: int, effecter: Effecter) -> int | None:
        """Return the body of the loose object that is the first thing on the vacuum's axis; None: none is."""
        data, reach = self._engine.data, effecter.settings.suction_length
        mat = data.xmat[base].reshape(3, 3)
        start = data.xpos[base] + mat @ np.array(flip_vector(effecter.mount.at))
        # In USARSim's axes, as descriptions have it, and flipped as a vector in the next line.
        x, y, z = mat_from_angles(*effecter.mount.direction)[:, 0].tolist()
        along = mat @ np.array(flip_vector((x, y, z)))
        query = RayQuery(transparent=frozenset({SKY}), max_distance=reach)
        # Its own robot is left out: the ray may begin inside the gripper.
        (distance,), _, (geom,) = caster.hit_geoms(start[None], along[None], query, caster.geoms_of(slot))
        if distance > reach:
            return None
        thing = int(self._engine.model.geom_bodyid[geom])
        return thing if self._engine.model.body(thing).name.startswith(LOOSE_PREFIX) else None

    def open(self, places: Collection[Place]) -> None:
        """Open vacuums; what they hold falls."""
        held = [hold for place in places if (hold := self._closed.pop(place, None)) is not None]
        for hold in held:
            self._engine.unweld(hold.name)
        # Each weld is a compilation of the model: the scene is resolved once, after all of them.
        if held:
            self._changed()

    def of_robots(self, slots: Collection[int]) -> list[Place]:
        """Return the closed vacuums of some robots."""
        return [place for place in self._closed if place[0] in slots]

    def holding(self, things: Collection[str]) -> list[Place]:
        """Return the vacuums that hold one of some bodies."""
        return [place for place, hold in self._closed.items() if hold is not None and hold.thing in things]

    def lose(self) -> None:
        """Open the vacuums whose object has moved too far."""
        lost = [place for place, hold in self._closed.items() if hold is not None and self._is_lost(hold)]
        if lost:
            self.open(lost)

    def _is_lost(self, hold: Hold) -> bool:
        model, data = self._engine.model, self._engine.data
        base, thing = model.body(hold.base).id, model.body(hold.thing).id
        now = data.xmat[base].reshape(3, 3).T @ (data.xpos[thing] - data.xpos[base])
        # In the base's axes: a held object moves with the gripper, and only what it moves against it counts.
        return bool(np.linalg.norm(now - hold.pos) > hold.reach)
