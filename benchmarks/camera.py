"""Speed of cameras: pictures of all robots of a batch, as policies would look at them.

Between two rounds of pictures the worlds are not stepped, but every robot's camera is zoomed a little, so
that no picture is the one before.
"""

import math
import statistics
import time
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any, cast

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

from benchmarks.baselines import WORLDS_PER_CORE, baseline_lines, missing, multiray_rate, posed
from benchmarks.cases import AllBaselineOptions, BaselineOptions, CameraCase
from benchmarks.scenes import sizes
from benchmarks.tools import rate_of, run_case, time_repeats
from usarmjx.base.errors import UsageError
from usarmjx.base.process import cores
from usarmjx.engines.base import PhysicsState
from usarmjx.sensors.cameras.mounts import Camera, camera_index, cameras_of
from usarmjx.sensors.cameras.picture import check_size
from usarmjx.sensors.cameras.shading import daylight
from usarmjx.sim.batch import Batch, BatchState
from usarmjx.sim.calibration import build_calibrated
from usarmjx.sim.scene import Scene, build_scene
from usarmjx.sim.views import build_render_scene, map_pictures, render_group
from usarmjx.sim.world import World

OUR_TO_MUJOCO = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Our cameras look along x with z up, MuJoCo's along -z with y up: the columns are its axes in ours."""


def with_camera(scene: Scene, camera: Camera, size: tuple[int, int]) -> mujoco.MjModel:
    """Return the scene's model with one of its first robot's cameras, and with a light above the robot.

    Args:
        scene: The scene.
        camera: A camera with one eye and without a mirror.
        size: Width and height of its pictures [pixels].

    Raises:
        UsageError: Another camera, which MuJoCo does not have.
    """
    if camera.lens != "pinhole" or len(camera.eye_offsets) > 1:
        raise UsageError(
            f"{camera.mount.name} has a mirror or two eyes; MuJoCo Warp's renderer needs a pinhole camera"
        )
    spec = scene.spec.copy()
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, (camera.mat @ OUR_TO_MUJOCO).ravel())
    upright = 2 * np.arctan(np.tan(camera.default_fov / 2) * size[1] / size[0])
    body = spec.body(f"r0/{scene.groups[0].plan.parts[camera.body]}")
    assert body is not None
    body.add_camera(pos=camera.pos, quat=quat, fovy=np.degrees(upright))
    body.add_light(pos=[0.0, 0.0, 3.0], dir=[0.0, 0.0, -1.0], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL)
    return spec.compile()


def _times_of(run: Callable[[], Any], repeats: int, wait: Callable[[], Any]) -> list[float]:
    """Return the wall time of each of some runs [s], from an idle device to an idle one."""
    times: list[float] = []
    for _ in range(repeats):
        wait()
        began = time.perf_counter()
        run()
        wait()
        times.append(time.perf_counter() - began)
    return times


def measure_mujoco_warp(
    model: mujoco.MjModel, qpos: np.ndarray, size: tuple[int, int], steps: int, repeats: int, shadows: bool
) -> dict[str, Any]:
    """Measure MuJoCo Warp's renderer: colours, depth and segmentation of the model's only camera.

    Before each round of pictures its tree of geoms is brought up to date, as it must be when something has
    moved. On a GPU the rounds are captured in a graph.

    Args:
        model: With one camera.
        qpos: Of all worlds (worlds, nq).
        size: Width and height [pixels].
        steps: Rounds of pictures per repeat.
        repeats: Repeats.
        shadows: Whether lights cast shadows.

    Returns:
        Frames per second (median), times [s], and the number of geoms.

    Raises:
        ImportError: warp-lang is not installed.
    """
    import warp as wp
    from mujoco.mjx.third_party import mujoco_warp as mjw

    worlds = len(qpos)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    on_device, moving = mjw.put_model(model), mjw.put_data(model, data, nworld=worlds)
    wp.copy(moving.qpos, wp.array(np.asarray(qpos, np.float32), dtype=float))
    mjw.kinematics(on_device, moving)
    mjw.camlight(on_device, moving)
    context = mjw.create_render_context(
        model, worlds, [size], render_rgb=True, render_depth=True, render_seg=True, use_shadows=shadows
    )

    def look() -> None:
        for _ in range(steps):
            mjw.refit_bvh(on_device, moving, context)
            mjw.render(on_device, moving, context)

    look()
    run: Any = look
    if wp.get_device().is_cuda:
        with wp.ScopedCapture() as capture:
            look()
        run = partial(wp.capture_launch, cast(wp.Graph, capture.graph))
    times = _times_of(run, repeats, wp.synchronize)
    depth = context.depth_data.numpy()
    return {
        "frames_per_s": worlds * steps / float(np.median(times)),
        "times_s": times,
        "geoms": model.ngeom,
        "shadows": shadows,
        "pixels_that_see_something": float((depth > 0).mean()),
    }


ALL = AllBaselineOptions()
FOV_FACTOR = 0.99
"""By how much the field of view changes from one picture to the next."""


def _loop(case: CameraCase, batch: Batch, state: BatchState) -> Callable[[jax.Array], jax.Array]:
    """Return a function that takes pictures `steps` times, and sums them up so that all are needed."""
    index = camera_index(batch.scene.groups[0].robot)
    eye, size = (0, cameras_of(batch.scene.groups[0].robot)[index], index), case.pixels
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
    robot, size = scene.groups[0].robot, case.pixels
    try:
        model = with_camera(scene, cameras_of(robot)[camera_index(robot)], size)
    except UsageError as error:
        return missing(str(error))
    count = min(case.worlds, WORLDS_PER_CORE * cores())
    datas = [posed(model, qpos) for qpos in np.asarray(batch.physics(state).qpos[:count], float)]
    width, height = size
    edge = np.tan(np.radians(model.cam_fovy[0]) / 2) / height
    right, up = np.meshgrid(
        (2 * np.arange(width) + 1 - width) * edge, (height - 2 * np.arange(height) - 1) * edge
    )
    pixels = np.stack([right, up, -np.ones_like(up)], -1).reshape(-1, 3)
    pixels /= np.linalg.norm(pixels, axis=-1, keepdims=True)
    body = int(model.cam_bodyid[0])
    bundles = [
        (world, data.cam_xpos[0], pixels @ data.cam_xmat[0].reshape(3, 3).T, body)
        for world, data in enumerate(datas)
    ]
    rate, _ = multiray_rate("pictures/s", datas, bundles, case.repeats, 1 / len(pixels))
    return {**rate, "worlds": count, "what": "depth and segmentation, one ray a pixel; no colours"}


def measure_camera(case: CameraCase, options: BaselineOptions = ALL) -> str:
    """Measure a case, append its record, and return a summary for people.

    Raises:
        UnknownNameError: No such arena or robot, or a robot without a camera.
        SpecError: More robots than the arena has start poses.
        UsageError: A picture of that size cannot be taken; a peer is asked for, but warp-lang is missing.
    """
    return run_case("camera", options, lambda: _measure(case, options.baselines), _summary)


def _measure(case: CameraCase, baselines: str) -> dict[str, Any]:
    """Return the record of a case, without its header."""
    if case.peer and find_spec("warp") is None:
        raise UsageError("MuJoCo Warp's renderer needs warp-lang: pip install usarmjx[cuda]")
    recorded = case.as_record()
    scene = build_scene(case.arena, [recorded["robot"]] * recorded["robots"])
    batch = build_calibrated(lambda: Batch(scene, case.worlds, engine=case.engine, seed=case.seed))
    state = batch.reset()
    first, times, _ = time_repeats(_loop(case, batch, state), jnp.zeros(()), case.repeats)
    work = case.worlds * recorded["robots"] * case.steps
    return {
        "case": recorded,
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
        "pixels_per_s": work * math.prod(case.pixels) / statistics.median(times),
        "times_s": times,
        "compile_s": first - times[0],
        "peer": _peer(case, scene, batch, state) if case.peer else None,
    }


def _peer(case: CameraCase, scene: Scene, batch: Batch, state: BatchState) -> list[dict[str, Any]]:
    """Return what MuJoCo Warp's renderer takes for the same, with and without shadows."""
    robot, size = scene.groups[0].robot, case.pixels
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
