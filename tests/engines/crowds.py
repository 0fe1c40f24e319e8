"""Random crowds of rectangles among solids, some of which overlap, for tests of how they are kept apart."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.engines.planar.footprints import Footprints
from usarmjx.engines.planar.neighbor_lists import NeighborList
from usarmjx.engines.planar.overlap import Outlines
from usarmjx.engines.planar.proposed_motion import ProposedMotion, SolidPlacement
from usarmjx.engines.planar.solids import FAR_AWAY, PlanSolids, pack_solids

SOLIDS = 8
"""Near each robot."""


def crowd(worlds: int, robots: int, seed: int = 0) -> dict[str, Any]:
    """Return the arguments of `separate_footprints`: footprints before and after, solids, motion, heights.

    Half of the solids stop nobody, of the others a third are discs; a tenth of the robots do not move, and a
    fifth are at another height. In the first world nobody meets anything.
    """
    rng = np.random.default_rng(seed)

    # By NumPy: JAX would compile a program for each operation and size.
    def draw(*shape: int) -> np.ndarray:
        return rng.random(shape).astype(np.float32)

    def single(chosen: np.ndarray, x: np.ndarray | float, y: np.ndarray | float) -> np.ndarray:
        return np.where(chosen, x, y).astype(np.float32)

    pos = draw(worlds, robots, 2) * (1.2 * robots**0.5 + 0.5)
    pos[0] = 100.0 * np.arange(2 * robots).reshape(robots, 2)
    low = single(draw(worlds, robots) < 0.2, 0.6, 0.0)
    before = Footprints(
        pos=pos,
        yaw=2 * np.pi * draw(worlds, robots),
        half=0.2 + 0.2 * draw(worlds, robots, 2),
        low=low,
        high=low + 0.5,
        step=np.zeros((worlds, robots), np.float32),
        mass=1.0 + 9.0 * draw(worlds, robots),
    )
    after = before.replace(
        pos=pos + 0.1 * (draw(worlds, robots, 2) - 0.5), yaw=before.yaw + 0.2 * (draw(worlds, robots) - 0.5)
    )
    shape = (SOLIDS, robots, worlds)
    disc, turn = draw(*shape) < 1 / 3, 2 * np.pi * draw(*shape)
    x, y = (pos[..., axis].T + 2 * (draw(*shape) - 0.5) for axis in range(2))
    nowhere = (draw(*shape) < 0.5) | (np.arange(worlds) == 0)
    solids = Outlines(
        x=single(nowhere, FAR_AWAY, x),
        y=y,
        cos=np.cos(turn),
        sin=np.sin(turn),
        length=single(disc, 0.0, 0.1 + 0.4 * draw(*shape)),
        width=single(disc, 0.0, 0.05 + 0.1 * draw(*shape)),
        radius=single(disc, 0.1 + 0.2 * draw(*shape), 0.0),
    )
    over = draw(worlds, robots, robots) < 0.1
    case = {
        "before": before,
        "after": after,
        "near": solids,
        "moves": draw(worlds, robots) < 0.9,
        "stacked": over | over.swapaxes(1, 2),
    }
    return {name: jax.tree.map(jnp.asarray, part) for name, part in case.items()}


def flat(case: dict[str, Any]) -> dict[str, Any]:
    """Return a crowd without discs: they are rectangles of no size."""
    return {**case, "near": case["near"]._replace(radius=jnp.zeros_like(case["near"].radius))}


def as_the_engine_has_it(case: dict[str, Any], *, discs: bool = True) -> tuple[ProposedMotion, NeighborList]:
    """Return a crowd as aims and what is around them: all its solids are at the height of all robots."""
    shape = case["moves"].shape
    near = Outlines(*(jnp.moveaxis(part, -1, 0) for part in case["near"]))
    flat, high = jnp.zeros_like(near.x), jnp.full_like(near.x, 1e3)
    solids = PlanSolids(
        outline=near, low=-high, top=high, slope_x=flat, slope_y=flat, highest=high, discs=discs
    )
    scene = SolidPlacement(loose=jnp.zeros((shape[0], 0)), geoms=jnp.zeros((shape[0], 0, 10)))
    around = NeighborList(
        at=jnp.zeros((*shape, 4)),
        room=jnp.zeros((*shape, 4)),
        omitted=jnp.zeros(shape, jnp.int32),
        obstacles=pack_solids(solids),
        ground_solids=pack_solids(solids),
        scene=scene,
        discs=discs,
    )
    limit, qpos = jnp.zeros((shape[0], 4, shape[1])), jnp.zeros((shape[0], 0))
    before, after, moves, stacked = (case[name] for name in ("before", "after", "moves", "stacked"))
    return ProposedMotion(before, after, moves, stacked, limit, scene, qpos, None), around
