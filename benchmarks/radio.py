"""Speed of the radio: the links of all pairs of robots in many worlds, walls counted.

A link is an unordered pair of robots; its walls, power and events are computed once and written both ways
into its world's table. Robots move between two evaluations. Measured with walls of its own for every world,
and with one arena for all.
"""

import statistics
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks.baselines import (
    WORLDS_PER_CORE,
    baseline_lines,
    missing,
    model_of,
    multiray_rate,
    posed,
)
from benchmarks.cases import AllBaselineOptions, BaselineOptions, RadioCase
from benchmarks.tools import rate_of, run_case, time_repeats
from usarmjx.base.process import cores
from usarmjx.base.warp_functions import warp_in_use
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.links import Links, evaluate_links, no_links
from usarmjx.models.types.shapes import OPAQUE
from usarmjx.sensors.rays.targets import GeomBlock, Geoms

ARENA_SIDE = 20.0
"""Arenas are this long and wide [m]."""
MOVE_PER_EVALUATION = 0.02
"""Robots go this far between two evaluations [m]."""
ALL = AllBaselineOptions()


def random_walls(key: jax.Array, walls: int) -> Geoms:
    """Return an arena of upright boxes, 0.05 m to 0.3 m thick, 1 m to 4 m long, 0.6 m to 2 m high."""
    position, turn, size = jax.random.split(key, 3)
    low, high = jnp.array([0.025, 0.5, 0.3]), jnp.array([0.15, 2.0, 1.0])
    size = jax.random.uniform(size, (walls, 3), minval=low, maxval=high)
    at = jax.random.uniform(position, (walls, 2), minval=-ARENA_SIDE / 2, maxval=ARENA_SIDE / 2)
    yaw = jax.random.uniform(turn, (walls,), maxval=2 * jnp.pi)
    cos, sin, none, one = jnp.cos(yaw), jnp.sin(yaw), jnp.zeros(walls), jnp.ones(walls)
    mat = jnp.stack([cos, -sin, none, sin, cos, none, none, none, one], -1).reshape(walls, 3, 3)
    pos = jnp.concatenate([at, size[:, 2:]], -1)
    owner = jnp.full(walls, -1)
    block = GeomBlock(pos=pos, mat=mat, size=size, owner=owner)
    return Geoms(blocks=(block,), kinds=(int(mujoco.mjtGeom.mjGEOM_BOX),), materials=(OPAQUE,))


def _random_antennas(key: jax.Array, robots: int) -> tuple[jax.Array, jax.Array]:
    """Return positions 0.3 m to 1 m above the floor, and their moves between two evaluations [m]."""
    position, move = jax.random.split(key)
    low, high = (
        jnp.array([-ARENA_SIDE / 2, -ARENA_SIDE / 2, 0.3]),
        jnp.array([ARENA_SIDE / 2, ARENA_SIDE / 2, 1.0]),
    )
    level = jnp.array([MOVE_PER_EVALUATION, MOVE_PER_EVALUATION, 0.0])
    positions = jax.random.uniform(position, (robots, 3), minval=low, maxval=high)
    return positions, jax.random.uniform(move, (robots, 3), minval=-level, maxval=level)


def _loop(case: RadioCase, geoms: Geoms, *, shared: bool, key: jax.Array) -> Callable[[Links], Links]:
    """Return a function that evaluates the links of all worlds `steps` times."""
    numbers = jnp.arange(case.worlds)
    keys = jax.vmap(partial(jax.random.fold_in, key))(numbers)
    positions, moves = jax.vmap(partial(_random_antennas, robots=case.robots))(keys)
    in_use = jnp.ones((case.worlds, case.robots), bool)
    look = jax.vmap(
        partial(evaluate_links, RadioSettings()), in_axes=(None if shared else 0, (0, 0), 0, 0, None)
    )

    # Everything is an argument: what a jitted function closes over is compiled in as constants.
    @jax.jit
    def run(links: Links, geoms: Geoms, positions: jax.Array, moves: jax.Array) -> Links:
        def body(i: jax.Array, links: Links) -> Links:
            return look(geoms, (positions + i * moves, in_use), links, keys, i)

        return jax.lax.fori_loop(0, case.steps, body, links)

    return lambda links: run(links, geoms, positions, moves)


def _on_cpu(case: RadioCase, walls: Geoms, key: jax.Array) -> dict[str, Any]:
    """Return the rate of `mj_multiRay` from each antenna to those after it: the first wall, no power."""
    count, datas, bundles = min(case.worlds, WORLDS_PER_CORE * cores()), [], []
    for world in range(count):
        datas.append(posed(model_of(jax.tree.map(lambda x, w=world: x[w], walls))))
        at = np.asarray(_random_antennas(jax.random.fold_in(key, world), case.robots)[0], float)
        for robot in range(case.robots - 1):
            along = at[robot + 1 :] - at[robot]
            bundles.append((world, at[robot], along / np.linalg.norm(along, axis=-1, keepdims=True), -1))
    rate, _ = multiray_rate("links/s", datas, bundles, case.repeats)
    return {**rate, "worlds": count, "what": "the first wall on the way, not their count; no power"}


def measure_radio(case: RadioCase, options: BaselineOptions = ALL) -> str:
    """Measure a case, append its record, and return a summary for people."""
    return run_case("radio", options, lambda: _measure(case, options.baselines), _summary)


def _measure(case: RadioCase, baselines: str) -> dict[str, Any]:
    """Return the record of a case, without its header."""
    key, robots = jax.random.key(case.seed), case.robots
    many = jax.vmap(partial(random_walls, walls=case.walls))(jax.random.split(key, case.worlds))
    one = jax.tree.map(lambda x: x[0], many)
    start = jax.vmap(lambda _: no_links(robots))(jnp.arange(case.worlds))
    own_first, own, links = time_repeats(_loop(case, many, shared=False, key=key), start, case.repeats)
    shared_first, shared, _ = time_repeats(_loop(case, one, shared=True, key=key), start, case.repeats)
    work = case.worlds * robots * (robots - 1) // 2 * case.steps
    paired = np.asarray(links.paired)
    return {
        "case": case.as_record(),
        "scene": {"robots": robots, "geoms": case.walls},
        "rates": {
            "own_walls": rate_of("links/s", work, own_first, own),
            "shared_walls": rate_of("links/s", work, shared_first, shared),
        },
        "baselines": {
            "mj_multiray": missing("not asked for") if baselines == "none" else _on_cpu(case, many, key)
        },
        "in_the_step": "of every unordered pair of robots the distance, the walls on the way (boxes, own for "
        "each world), the power, whether it holds and whether that changed; as a table both ways",
        "links_per_evaluation": work // case.steps,
        "links_per_s": work / statistics.median(own),
        "links_per_s_shared_walls": work / statistics.median(shared),
        "wall_tests_per_s": work * case.walls / statistics.median(own),
        "times_s": own,
        "shared_walls_times_s": shared,
        "counted_on": "warp" if warp_in_use() else "jax",
        "compile_s": {"own": own_first - own[0], "shared": shared_first - shared[0]},
        "mean_walls": float(np.asarray(links.walls)[paired].mean()) if paired.any() else 0.0,
        "most_walls": int(np.asarray(links.walls).max()),
    }


def _summary(record: dict[str, Any]) -> str:
    case, compiled = record["case"], record["compile_s"]
    return "\n".join(
        [
            f"{case['worlds']} worlds x {case['robots']} robots, {case['walls']} walls on {record['device']}",
            f"own walls     {record['links_per_s']:15,.0f} links/s, counted on {record['counted_on']}",
            f"shared walls  {record['links_per_s_shared_walls']:15,.0f} links/s",
            *baseline_lines(record),
            f"wall tests    {record['wall_tests_per_s']:15,.0f} /s, own walls",
            f"walls         {record['mean_walls']:.2f} on a link on average, {record['most_walls']} at most",
            f"a link        {record['in_the_step']}",
            f"compile [s]   own {compiled['own']:.1f}, shared {compiled['shared']:.1f}",
        ]
    )
