"""Pictures of robots, drawn with the sensors' ray kernels: what is in the picture is what sensors see."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from usarmjx.models.arena_spec import ArenaSpec
from usarmjx.models.compose import Physics, add_robot, new_spec
from usarmjx.models.plan import body_plan
from usarmjx.models.robots import ROBOTS
from usarmjx.models.spec import RobotSpec
from usarmjx.sensors.raycast import KERNELS

SUN = np.array([0.45, 0.35, 0.82]) / np.linalg.norm([0.45, 0.35, 0.82])
AMBIENT, DIFFUSE = 0.45, 0.6
SKY = np.array([0.93, 0.95, 0.97], np.float32)
TILES = np.array([[0.86, 0.86, 0.84], [0.78, 0.78, 0.76]], np.float32)
"""Colours of the floor's checkers."""
NUDGE = 1e-3
"""Rays that find a surface's slope are turned by this much [rad]; shadow rays start this far off [m]."""
VIEW = (math.radians(-35.0), math.radians(22.0))
"""Azimuth and elevation from which robots are drawn: from their front right."""
FIELD = math.radians(32.0)
"""Field of view across a picture's height."""


@dataclass(frozen=True)
class Solids:
    """What can be seen: MuJoCo types (n,), poses (n, 3) and (n, 3, 3), sizes (n, 3), colours (n, 3)."""

    kind: np.ndarray
    pos: np.ndarray
    mat: np.ndarray
    size: np.ndarray
    rgb: np.ndarray


def solids_of(model: mujoco.MjModel, data: mujoco.MjData) -> Solids:
    """Return the geoms of a model in their present poses; kinematics must be current."""
    return Solids(
        kind=model.geom_type,
        pos=data.geom_xpos.astype(np.float32),
        mat=data.geom_xmat.reshape(-1, 3, 3).astype(np.float32),
        size=model.geom_size.astype(np.float32),
        rgb=model.geom_rgba[:, :3].astype(np.float32),
    )


def _reach(solids: Solids, start: jax.Array, along: jax.Array) -> jax.Array:
    """Return the distance of every ray (rays, 3) to every solid (solids, rays)."""
    rows = []
    for i, kind in enumerate(solids.kind):
        local, turned = (start - solids.pos[i]) @ solids.mat[i], along @ solids.mat[i]
        rows.append(KERNELS[int(kind)](local.T, turned.T, solids.size[i][:, None]))
    return jnp.stack(rows)


def _look(eye: np.ndarray, target: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return the directions of a picture's rays, row by row from the top (height * width, 3)."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    up = np.cross(right, forward)
    scale = 2 * math.tan(FIELD / 2) / height
    x = (np.arange(width) - (width - 1) / 2) * scale
    y = ((height - 1) / 2 - np.arange(height)) * scale
    rays = forward + x[None, :, None] * right + y[:, None, None] * up
    return (rays / np.linalg.norm(rays, axis=-1, keepdims=True)).reshape(-1, 3).astype(np.float32)


def draw(solids: Solids, eye: np.ndarray, target: np.ndarray, width: int, height: int) -> np.ndarray:
    """Return a picture (height, width, 3) with values in [0, 1]: sun, shadows and a checkered floor.

    Raises:
        KeyError: A geom type that rays cannot hit.
    """
    return np.asarray(
        _shade(solids, jnp.asarray(eye, jnp.float32), _look(eye, target, width, height))
    ).reshape(height, width, 3)


def _shade(solids: Solids, eye: jax.Array, rays: np.ndarray) -> jax.Array:
    start = jnp.broadcast_to(eye, rays.shape)
    reach = _reach(solids, start, jnp.asarray(rays))
    nearest, which = reach.min(0), reach.argmin(0)
    seen = jnp.isfinite(nearest)
    point = start + jnp.where(seen, nearest, 0.0)[:, None] * rays
    normal = _normals(solids, start, rays, which, point)
    lit = jnp.clip((normal * SUN).sum(-1), 0.0)
    beams = jnp.broadcast_to(jnp.asarray(SUN, jnp.float32), rays.shape)
    shadow = jnp.isfinite(_reach(solids, point + NUDGE * normal, beams)).any(0)
    rgb = jnp.asarray(solids.rgb)[which]
    checker = (jnp.floor(point[:, 0] * 2) + jnp.floor(point[:, 1] * 2)).astype(int) % 2
    floor = jnp.asarray(solids.kind)[which] == int(mujoco.mjtGeom.mjGEOM_PLANE)
    rgb = jnp.where(floor[:, None], jnp.asarray(TILES)[checker], rgb)
    bright = AMBIENT + DIFFUSE * lit * ~shadow
    return jnp.where(seen[:, None], jnp.clip(rgb * bright[:, None], 0, 1), SKY)


def _normals(
    solids: Solids, start: jax.Array, rays: np.ndarray, which: jax.Array, point: jax.Array
) -> jax.Array:
    """Return unit normals (rays, 3) from where two slightly turned rays meet the same surface."""
    side = np.cross(rays, [0.0, 0.0, 1.0])
    side /= np.maximum(np.linalg.norm(side, axis=-1, keepdims=True), 1e-9)
    edges = []
    for turn in (side, np.cross(side, rays)):
        along = rays + NUDGE * turn
        along /= np.linalg.norm(along, axis=-1, keepdims=True)
        reach = jnp.take_along_axis(_reach(solids, start, jnp.asarray(along)), which[None], 0)[0]
        edges.append(start + jnp.where(jnp.isfinite(reach), reach, 0.0)[:, None] * along - point)
    normal = jnp.cross(edges[0], edges[1])
    normal /= jnp.maximum(jnp.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return jnp.where((normal * rays).sum(-1, keepdims=True) > 0, -normal, normal)


def portrait(robot: RobotSpec, width: int = 480, height: int = 360) -> np.ndarray:
    """Return a picture (height, width, 3) of a robot on a floor, its joints at zero, filling the frame."""
    spec = new_spec(ArenaSpec(name="studio", starts=(), extent=((0, 0), (0, 0))), Physics())
    add_robot(spec, robot, "", (0.0, 0.0, body_plan(robot).clearance))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    solids = solids_of(model, data)
    own = solids.kind != int(mujoco.mjtGeom.mjGEOM_PLANE)
    radius = model.geom_rbound[own, None]
    low, high = (solids.pos[own] - radius).min(0), (solids.pos[own] + radius).max(0)
    middle, size = (
        (low + high) / 2,
        float(np.linalg.norm(np.minimum(high - low, 2 * np.array(robot.dimensions)))),
    )
    azimuth, elevation = VIEW
    back = np.array([math.cos(azimuth), math.sin(azimuth), math.tan(elevation)])
    eye = middle + back / np.linalg.norm(back) * size / (2 * math.tan(FIELD / 2)) * 1.15
    return draw(solids, eye, np.array([*middle[:2], robot.dimensions[2] / 2]), width, height)


def portraits(names: Sequence[str], path: Path, columns: int = 4) -> None:
    """Write a PNG with a picture of each robot and its name and size below.

    Raises:
        UnknownNameError: No such robot class.
    """
    robots = [ROBOTS.get(name) for name in names]
    rows = -(-len(robots) // columns)
    figure = Figure(figsize=(3.2 * columns, 2.75 * rows), dpi=80, facecolor="white", layout="constrained")
    FigureCanvasAgg(figure)
    for i, robot in enumerate(robots):
        axes = figure.add_subplot(rows, columns, i + 1)
        axes.imshow(portrait(robot))
        length, width, height = robot.dimensions
        axes.set_title(f"{robot.name}  {length:.2f} x {width:.2f} x {height:.2f} m", y=-0.13, fontsize=9)
        axes.set_axis_off()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="png")
