"""What the benchmarks of the step, of compilation and of memory have in common: a batch of a scene."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.engines import choose_engine
from usarmjx.models.build.compose import PHYSICS
from usarmjx.models.generate import generate_many
from usarmjx.models.generate.kinds import USUAL_STARTS
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.server.worlds.make import parse_roster
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import Scene, build_scene, start_height

CONTROL_STEP = 0.05
"""[s]"""
USUAL_SIZE, USUAL_TEAM = (8, 6), 16
"""Cells of a generated arena [1.2 m], and the largest team in it; larger ones have larger arenas."""
SAMPLE_ARENAS = 64
"""Generated arenas that a shared one is chosen from."""


@dataclass(frozen=True, kw_only=True)
class SceneCase:
    """Worlds of a scene, and their engine.

    Without `substeps`, control steps take 50 ms.

    With `generated` arenas, `arena` is the kind that is generated, and resets draw others of them. With 1 all
    worlds share one: the one with the most loose objects, and then solids, of `SAMPLE_ARENAS`, for a fair
    comparison, as a batch of many has room for the most of everything. They have `size` cells, or, if that is
    None, `cells_for` as many robots; and a start pose for each.
    """

    worlds: int
    roster: str = "P2AT"
    arena: str = "yellow"
    generated: int = 0
    size: tuple[int, int] | None = None
    engine: str = "auto"
    radio: bool = False
    physics: str = "reference"
    substeps: int | None = None
    seed: int = 0

    def resolved(self) -> dict[str, Any]:
        """Return the engine and the substeps that are meant.

        Raises:
            UnknownNameError: No such engine or physics.
        """
        timestep = PHYSICS.get(self.physics).timestep
        engine = choose_engine(self.engine, "batch")
        return {"engine": engine, "substeps": self.substeps or round(CONTROL_STEP / timestep)}

    def scene(self) -> Scene:
        """Build the scene.

        Raises:
            UsarmjxError: The roster or the arena cannot be built.
        """
        kept: dict[str, Any] = {"radio": RadioSettings()} if self.radio else {}
        physics = replace(PHYSICS.get(self.physics), substeps=self.resolved()["substeps"])
        return build_scene(self._arena(), parse_roster(self.roster), physics, **kept)

    def batch(self, scene: Scene) -> Batch:
        """Build the batch of a scene; resets draw start poses."""
        return Batch(scene, self.worlds, engine=self.resolved()["engine"], seed=self.seed, shuffle=True)

    def _arena(self) -> str | ArenaSpec | list[ArenaSpec]:
        """Return the arena, or all arenas; a single generated one is shared by all worlds."""
        if not self.generated:
            return self.arena
        if self.generated > 1:
            return self._generate(self.generated)
        sample = self._generate(SAMPLE_ARENAS)
        return max(sample, key=lambda arena: (len(arena.loose), len(arena.shapes)))

    def _generate(self, count: int) -> list[ArenaSpec]:
        robots = len(parse_roster(self.roster))
        size = cells_for(robots) if self.size is None else self.size
        starts = max(USUAL_STARTS, robots)
        return generate_many(self.arena, count, seed=self.seed, size=(size[0], size[1]), starts=starts)


def cells_for(robots: int) -> tuple[int, int]:
    """Return columns and rows of a generated arena in which a team has as much room as sixteen in 8 x 6."""
    if robots <= USUAL_TEAM:
        return USUAL_SIZE
    cells = robots * math.prod(USUAL_SIZE) / USUAL_TEAM
    columns = math.ceil(math.sqrt(cells * USUAL_SIZE[0] / USUAL_SIZE[1]))
    return columns, math.ceil(cells / columns)


def start_qpos(scene: Scene) -> np.ndarray:
    """Return positions with every robot at its start pose (nq,)."""
    qpos = np.array(scene.model.qpos0)
    for group in scene.groups:
        for slot, address in zip(group.slots, group.root_qposadr, strict=True):
            start = scene.arena.starts[slot]
            qpos[address[:3]] = (*start.at[:2], start_height(scene.arena, start, group.robot))
    return qpos
