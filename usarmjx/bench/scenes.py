"""What the benchmarks of the step, of compilation and of memory have in common: a batch of a scene."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from usarmjx.comms.attenuation import RadioSettings
from usarmjx.engines import choose_engine
from usarmjx.models.build.compose import PHYSICS
from usarmjx.models.generate import generate_many
from usarmjx.models.spec.arena import ArenaSpec
from usarmjx.server.worlds.make import parse_roster
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import Scene, build_scene, start_height

CONTROL_STEP = 0.05
"""[s]"""
SAMPLE_ARENAS = 64
"""Generated arenas that a shared one is chosen from."""


@dataclass(frozen=True, kw_only=True)
class SceneCase:
    """Worlds of a scene, and their engine.

    Without `substeps`, control steps take 50 ms.

    With `generated` arenas, `arena` is the kind that is generated, and resets draw others of them. With 1 all
    worlds share one: the one with the most loose objects, and then solids, of `SAMPLE_ARENAS`, for a fair
    comparison, as a batch of many has room for the most of everything.
    """

    worlds: int
    roster: str = "P2AT"
    arena: str = "yellow"
    generated: int = 0
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
        engine = choose_engine(self.engine, "train")
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
            return generate_many(self.arena, self.generated, seed=self.seed)
        sample = generate_many(self.arena, SAMPLE_ARENAS, seed=self.seed)
        return max(sample, key=lambda arena: (len(arena.loose), len(arena.shapes)))


def start_qpos(scene: Scene) -> np.ndarray:
    """Return positions with every robot at its start pose (nq,)."""
    qpos = np.array(scene.model.qpos0)
    for group in scene.groups:
        for slot, address in zip(group.slots, group.root_qposadr, strict=True):
            start = scene.arena.starts[slot]
            qpos[address[:3]] = (*start.at[:2], start_height(scene.arena, start, group.robot))
    return qpos
