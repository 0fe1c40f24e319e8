"""How fast cameras are: pictures of all robots of a batch, as policies would look at them.

Between two rounds of pictures the worlds are not stepped, but every robot's camera is zoomed a little, so
that no picture is the one before.
"""

import statistics
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.base.threads import cores
from usarmjx.bench.baselines import (
    WORLDS_PER_CORE,
    baseline_lines,
    check_word,
    missing,
    multiray_rate,
    posed,
)
from usarmjx.bench.peer import measure_mujoco_warp, with_camera
from usarmjx.bench.scene_figures import sizes
from usarmjx.bench.tools import append_record, rate_of, record_header, time_repeats
from usarmjx.cameras.light import daylight
from usarmjx.cameras.mounts import camera_index, cameras_of
from usarmjx.cameras.picture import check_size
from usarmjx.engines.base import PhysicsState
from usarmjx.sim.batch import Batch
from usarmjx.sim.batch_state import BatchState
from usarmjx.sim.scene import Scene, build_scene
from usarmjx.sim.views import build_render_scene, map_pictures, render_group
from usarmjx.sim.world import World

FOV_FACTOR = 0.99
"""By how much the field of view changes from one picture to the next."""


@dataclass(frozen=True, kw_only=True)
class CameraCase:
    """What to measure: `steps` pictures of every robot's main camera, `repeats` times.

    With `peer` also those of MuJoCo Warp's own renderer, of the first robot's camera in each world.
    """

    worlds: int
    robots: int = 1
    robot: str = "P2AT"
    arena: str = "yellow"
    width: int = 64
    height: int = 64
    engine: str = "auto"
    steps: int = 5
    repeats: int = 5
    seed: int = 0
    peer: bool = False


def _loop(case: CameraCase, batch: Batch, state: BatchState) -> Callable[[jax.Array], jax.Array]:
    """Return a function that takes pictures `steps` times, and sums them up so that all are needed."""
    index = camera_index(batch.scene.groups[0].robot)
    eye, size = (0, cameras_of(batch.scene.groups[0].robot)[index], index), (case.width, case.height)
    check_size(eye[1], *size)
    worlds, physics = state.worlds, batch.physics(state)

    # Everything is an argument: what a jitted function closes over is compiled in as constants.
    @jax.jit
    @jax.default_matmul_precision("highest")
    def run(total: jax.Array, worlds: World, physics: PhysicsState) -> jax.Array:
        def body(i: jax.Array, total: jax.Array) -> jax.Array:
            robots = worlds.groups[0]
            zoomed = worlds.replace(groups=(robots.replace(fov=robots.fov * FOV_FACTOR**i),))
            picture = map_pictures(
                lambda world, now: render_group(batch.scene, world, now, eye, size), zoomed, physics
            )
            depth = jnp.where(jnp.isfinite(picture.depth), picture.depth, 0.0)
            return total + picture.rgb.sum(dtype=jnp.float32) + depth.sum() + picture.segmentation.sum()

        return jax.lax.fori_loop(0, case.steps, body, total)

    return lambda total: run(total, worlds, physics)


def _scene_summary(scene: Scene, batch: Batch, state: BatchState) -> dict[str, Any]:
    """Return what there is to see in a world."""
    world, physics = jax.tree.map(lambda x: x[0], (state.worlds, batch.physics(state)))
    render_scene, _ = jax.jit(partial(build_render_scene, scene))(world, physics)
    materials: dict[str, int] = {}
    for material, block in zip(render_scene.geoms.materials, render_scene.geoms.blocks, strict=True):
        materials[material] = materials.get(material, 0) + len(block.owner)
    lit_by = "the sun" if float(daylight(render_scene.lights)) else f"{len(render_scene.lights.rgb)} lamps"
    return {"geoms": sum(materials.values()), "materials": materials, "lit_by": lit_by}


def _on_cpu(case: CameraCase, scene: Scene, batch: Batch, state: BatchState) -> dict[str, Any]:
    """Return the rate of `mj_multiRay` for the pixels of a robot's camera: no colours, one ray each."""
    robot, size = scene.groups[0].robot, (case.width, case.height)
    try:
        model = with_camera(scene, cameras_of(robot)[camera_index(robot)], size)
    except UsageError as error:
        return missing(str(error))
    count = min(case.worlds, WORLDS_PER_CORE * cores())
    datas = [posed(model, qpos) for qpos in np.asarray(batch.physics(state).qpos[:count], float)]
    edge = np.tan(np.radians(model.cam_fovy[0]) / 2) / case.height
    right, up = np.meshgrid(
        (2 * np.arange(case.width) + 1 - case.width) * edge,
        (case.height - 2 * np.arange(case.height) - 1) * edge,
    )
    pixels = np.stack([right, up, -np.ones_like(up)], -1).reshape(-1, 3)
    pixels /= np.linalg.norm(pixels, axis=-1, keepdims=True)
    body = int(model.cam_bodyid[0])
    bundles = [
        (world, data.cam_xpos[0], pixels @ data.cam_xmat[0].reshape(3, 3).T, body)
        for world, data in enumerate(datas)
    ]
    rate, _ = multiray_rate("pictures/s", datas, bundles, case.repeats, 1 / len(pixels))
    return {**rate, "worlds": count, "what": "depth and what is seen, one ray a pixel; no colours"}


def measure_camera(case: CameraCase, file: Path | None = None, note: str = "", baselines: str = "all") -> str:
    """Run a case, append its record to `file` as a JSON line, and return a summary for people.

    Args:
        case: What to measure.
        file: Of records.
        note: What a reader of the record must know.
        baselines: What is measured beside it, of `baselines.WORDS`.

    Raises:
        UnknownNameError: No such arena or robot, or a robot without a camera.
        SpecError: More robots than the arena has start poses.
        UsageError: A picture of that size cannot be taken; a peer is asked for, but warp-lang is missing.
    """
    check_word(baselines)
    header = record_header("camera", note=note)
    if case.peer and find_spec("warp") is None:
        raise UsageError("MuJoCo Warp's renderer needs warp-lang: pip install usarmjx[cuda]")
    scene = build_scene(case.arena, [case.robot] * case.robots)
    batch = Batch(scene, case.worlds, engine=case.engine, seed=case.seed)
    state = batch.reset()
    first, times, _ = time_repeats(_loop(case, batch, state), jnp.zeros(()), case.repeats)
    work = case.worlds * case.robots * case.steps
    record = {
        **header,
        "case": asdict(case),
        "in_the_picture": "colours with shadows, bricks and checkers, mirrors (once), glass, headlights; "
        "depth; segmentation",
        "scene": _scene_summary(scene, batch, state),
        "model": sizes(scene),
        "rates": {"pictures": rate_of("pictures/s", work, first, times)},
        "baselines": {
            "mj_multiray": missing("not asked for")
            if baselines == "none"
            else _on_cpu(case, scene, batch, state)
        },
        "frames_per_s": work / statistics.median(times),
        "pixels_per_s": work * case.width * case.height / statistics.median(times),
        "times_s": times,
        "compile_s": first - times[0],
        "peer": _peer(case, scene, batch, state) if case.peer else None,
    }
    append_record(record, file)
    return _summary(record)


def _peer(case: CameraCase, scene: Scene, batch: Batch, state: BatchState) -> list[dict[str, Any]]:
    """Return what MuJoCo Warp's renderer takes for the same, with and without shadows."""
    robot, size = scene.groups[0].robot, (case.width, case.height)
    model = with_camera(scene, cameras_of(robot)[camera_index(robot)], size)
    qpos = np.asarray(batch.physics(state).qpos)
    return [
        measure_mujoco_warp(model, qpos, size, case.steps, case.repeats, shadows) for shadows in (True, False)
    ]


def _summary(record: dict[str, Any]) -> str:
    case, scene = record["case"], record["scene"]
    peers = [
        f"MuJoCo Warp's {one['frames_per_s']:13,.1f} /s, {one['geoms']} geoms, "
        + ("with shadows" if one["shadows"] else "no shadows")
        for one in record["peer"] or ()
    ]
    return "\n".join(
        [
            f"{case['worlds']} worlds x {case['robots']} {case['robot']} in {case['arena']}, "
            f"{case['width']} x {case['height']} pixels on {record['device']}",
            f"pictures      {record['frames_per_s']:15,.1f} /s",
            f"pixels        {record['pixels_per_s']:15,.0f} /s",
            *baseline_lines(record),
            f"geoms         {scene['geoms']}, lit by {scene['lit_by']}",
            f"a picture     {record['in_the_picture']}",
            f"compile [s]   {record['compile_s']:.1f}",
            *peers,
        ]
    )
