"""References beside every rate: C MuJoCo on all cores of the host, and MJX with nothing around it.

Physics is compared with `mujoco.rollout`, which steps many worlds in C++ threads, and with MJX's step mapped
over the worlds; rays, links and pictures with `mj_multiRay`. An entry that could not be measured says why.
"""

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import jax
import mujoco
import numpy as np
from mujoco import rollout

from benchmarks.scenes import bare_step, random_actuation, repeat_loop, start_qpos
from benchmarks.serving.load import make_hall
from benchmarks.tools import WARM_UP, rate_of, time_repeats
from usarmjx.base.errors import UsarmjxError
from usarmjx.base.process import cores
from usarmjx.engines import choose_engine
from usarmjx.engines.c.batch import CEngine
from usarmjx.sensors.rays.targets import Geoms
from usarmjx.sim.batch import Batch
from usarmjx.sim.calibration import build_calibrated
from usarmjx.sim.ray_geometry import moved_geom_poses
from usarmjx.sim.scene import Scene, build_scene

WORLDS_PER_CORE = 4
"""Worlds that `mujoco.rollout` steps for each core, so that none waits long for the last one."""
PHYSICS_NAMES = ("mujoco_rollout", "bare_mjx")
MJX = ("jax", "warp")
HALL_STEPS = 5
"""Control steps of a repeat in a hall."""
FULL = int(mujoco.mjtState.mjSTATE_FULLPHYSICS)
Bundle = tuple[int, np.ndarray, np.ndarray, int]
"""Number of a world, a start [m] (3,), unit vectors (rays, 3), a body that is looked through or -1."""


def missing(reason: str) -> dict[str, Any]:
    """Return the entry of a baseline that was not measured."""
    return {"missing": reason}


def _attempted(measure: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    try:
        return measure()
    except (UsarmjxError, NotImplementedError, ValueError) as error:
        return missing(str(error).splitlines()[0])


def physics_baselines(
    scene: Scene, worlds: int, steps: int, repeats: int, word: str = "all", bare: dict[str, Any] | None = None
) -> dict[str, Any]:
    """Measure a scene's physics on all cores by `mujoco.rollout`, and by MJX.

    Args:
        scene: The scene.
        worlds: Worlds of the batch of MJX.
        steps: Control steps in a repeat.
        repeats: Number of them.
        word: What is measured, of `cases.BASELINES`.
        bare: Measurements of MJX so far, as `rate_of` has it; None: nothing.
    """
    found: dict[str, Any] = {name: missing("not asked for") for name in PHYSICS_NAMES}
    if word != "none":
        found["mujoco_rollout"] = _attempted(partial(rollout_rate, scene, steps, repeats))
    if bare is not None:
        found["bare_mjx"] = bare
    elif word == "all":
        found["bare_mjx"] = _attempted(partial(mjx_rate, scene, worlds, steps, repeats))
    return found


def _c_models(scene: Scene, count: int) -> list[mujoco.MjModel]:
    """Return a model for each world; where arenas are data, worlds have those of a batch's first ones."""
    engine = CEngine(scene.spec, scene.physics, 1, scene.moved_geoms)
    if scene.moved_geoms is None:
        return [engine.model] * count
    batch = Batch(scene, count, engine="c")
    state = batch.reset()
    poses = jax.vmap(lambda world: moved_geom_poses(scene, world.arena_state, jax.numpy.zeros(())))(
        state.worlds
    )
    assert poses is not None
    assert engine.moved_body is not None
    models = [engine.model.__copy__() for _ in range(count)]
    for i, model in enumerate(models):
        size = None if poses.size is None else np.asarray(poses.size)[i]
        engine.moved_body.move(model, np.asarray(poses.pos)[i], np.asarray(poses.quat)[i], size, i)
    return models


def rollout_rate(scene: Scene, steps: int, repeats: int) -> dict[str, Any]:
    """Measure bare physics by `mujoco.rollout` on all cores.

    New random wheel speeds at each control step and servos that rest, as in the bare step of a batch; all
    robots begin at their start poses.
    """
    count = WORLDS_PER_CORE * cores()
    models, substeps = _c_models(scene, count), scene.physics.substeps
    model, data = models[0], mujoco.MjData(models[0])
    data.qpos[:] = start_qpos(scene)
    state = np.zeros((count, mujoco.mj_stateSize(model, FULL)))
    for row in state:
        mujoco.mj_getState(model, data, row, FULL)
    at_qpos, at_act = (
        slice(1, 1 + model.nq),
        slice(1 + model.nq + model.nv, 1 + model.nq + model.nv + model.na),
    )
    rest = np.tile(data.act, (count, 1))
    qpos = np.tile(data.qpos, (count, 1))
    orders = [
        np.asarray(random_actuation(scene, count, jax.random.key(i), qpos, rest)[0], float)
        for i in range(steps)
    ]
    servos = [(group.actadr, group.qposadr[:, group.plan.actuated]) for group in scene.groups]

    def run(pool: rollout.Rollout, state: np.ndarray) -> np.ndarray:
        for ctrl in orders:
            now = state[:, at_act]
            for act, joints in servos:
                now[:, act] = state[:, at_qpos][:, joints]
            control = np.repeat(ctrl[:, None], substeps, 1)
            state = pool.rollout(models, datas, state, control)[0][:, -1]
        return state

    datas, times = [mujoco.MjData(model) for _ in range(cores())], []
    with rollout.Rollout(nthread=cores()) as pool:
        for _ in range(repeats + WARM_UP):
            began = time.perf_counter()
            state = run(pool, state)
            times.append(time.perf_counter() - began)
    work = count * scene.num_robots * substeps * steps
    rate = rate_of("robot-steps/s", work, times[0], times[1:])
    return {**rate, "compile_s": 0.0, "cores": cores(), "worlds": count}


def mjx_rate(scene: Scene, worlds: int, steps: int, repeats: int) -> dict[str, Any]:
    """Measure MJX's step mapped over the worlds, with random wheel speeds and nothing else.

    Raises:
        UsarmjxError: MJX cannot run the scene.
    """
    engine = choose_engine("auto", "batch")
    batch = build_calibrated(lambda: Batch(scene, worlds, engine=engine, shuffle=True))
    state = batch.reset()
    body, given = bare_step(batch, jax.random.key(1), state)
    loop = repeat_loop(batch, body, steps, given)
    first, times, _ = time_repeats(loop, state.physics, repeats)
    work = worlds * scene.num_robots * scene.physics.substeps * steps
    return {**rate_of("robot-steps/s", work, first, times), "engine": engine, "worlds": worlds}


def hall_baselines(robot: str, robots: int, repeats: int, word: str) -> dict[str, Any]:
    """Measure the physics of robots in a hall, as a server's that is measured has them, on all cores."""
    found: dict[str, Any] = {name: missing("not asked for") for name in PHYSICS_NAMES}
    if word != "none":
        scene = build_scene(make_hall(robots), [robot] * robots)
        found = physics_baselines(scene, 1, HALL_STEPS, repeats, "cpu")
        found["bare_mjx"] = missing("a served world is one, which MJX is not for")
    return found


def model_of(geoms: Geoms) -> mujoco.MjModel:
    """Return a model with these geoms, which no body moves; body k + 1 has those that owner k has."""
    spec = mujoco.MjSpec()
    most = max(int(np.asarray(block.owner).max(initial=-1)) for block in geoms.blocks)
    bodies: list[Any] = [spec.worldbody, *(spec.worldbody.add_body() for _ in range(most + 1))]
    for kind, block in zip(geoms.kinds, geoms.blocks, strict=True):
        rows = (np.asarray(part, float) for part in (block.pos, block.mat, block.size))
        for pos, mat, size, owner in zip(*rows, np.asarray(block.owner), strict=True):
            quat = np.zeros(4)
            mujoco.mju_mat2Quat(quat, mat.ravel())
            # A plane of size 0 is unbounded; MuJoCo wants its third number, the grid's, to be positive.
            extent = size if kind != mujoco.mjtGeom.mjGEOM_PLANE else (0.0, 0.0, 1.0)
            bodies[int(owner) + 1].add_geom(type=mujoco.mjtGeom(int(kind)), pos=pos, quat=quat, size=extent)
    return spec.compile()


def multiray_rate(
    unit: str, worlds: Sequence[mujoco.MjData], bundles: Iterable[Bundle], repeats: int, per_ray: float = 1.0
) -> tuple[dict[str, Any], list[np.ndarray]]:
    """Measure `mj_multiRay` on all cores: the nearest geom of each ray, a call for each bundle.

    Args:
        unit: Of the rate.
        worlds: Data of each world, whose positions are computed.
        bundles: The rays, with the number of their world.
        repeats: Number of casts of all.
        per_ray: Units for each ray.

    Returns:
        The rate, and each bundle's distances [m], -1 where nothing is met.
    """
    work = list(bundles)
    # A call works in the memory of its data: no two at once in one world.
    places = [[i for i, bundle in enumerate(work) if bundle[0] == world] for world in range(len(worlds))]
    found = [np.zeros(0)] * len(work)

    def cast_all_of(world: int) -> None:
        for i in places[world]:
            found[i] = cast(work[i])

    def cast(bundle: Bundle) -> np.ndarray:
        world, start, along, body = bundle
        data, rays = worlds[world], len(along)
        distance, geom = np.zeros(rays), np.zeros(rays, np.int32)
        flat = np.ascontiguousarray(along, float).ravel()
        mujoco.mj_multiRay(
            data.model, data, np.asarray(start, float), flat, None, 1, body, geom, distance, None, rays, 1e10
        )
        return distance

    times = []
    with ThreadPoolExecutor(cores()) as pool:
        for _ in range(repeats + WARM_UP):
            began = time.perf_counter()
            list(pool.map(cast_all_of, range(len(worlds))))
            times.append(time.perf_counter() - began)
    units = per_ray * sum(len(along) for _, _, along, _ in work)
    rate = {**rate_of(unit, units, times[0], times[1:]), "compile_s": 0.0, "cores": cores()}
    return rate, found


def posed(model: mujoco.MjModel, qpos: np.ndarray | None = None) -> mujoco.MjData:
    """Return data with everything where positions (nq,) have it; None: those of the model."""
    data = mujoco.MjData(model)
    if qpos is not None:
        data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    return data


def baseline_lines(record: dict[str, Any]) -> list[str]:
    """Return a record's baselines for people, a line each."""
    lines = []
    for name, found in record["baselines"].items():
        said = found.get("missing") or f"{found['rate']:12,.0f} {found['unit']}"
        on = f", {found['cores']} cores" if "cores" in found else ""
        lines.append(f"{name.replace('mujoco_', ''):13} {said}{on}")
    return lines
