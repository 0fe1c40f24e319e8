"""Pictures of the cameras of a world's robots. Pure functions of one world."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import numpy as np

from usarmjx.base import random
from usarmjx.base.backend import Array, named_scope, xp
from usarmjx.engines.base import PhysicsState
from usarmjx.engines.c.camera_rays import AttachedVisual, GeomColors
from usarmjx.models.compile.compose import VICTIM_PREFIX, materials_of, textures_of
from usarmjx.models.compile.kinematic_tree import BodyPoses, forward_kinematics
from usarmjx.models.compile.visuals import victim_visual_model
from usarmjx.models.types.shapes import texture_names
from usarmjx.sensors.cameras.mounts import Camera, camera_index, cameras_of, headlight_of
from usarmjx.sensors.cameras.paint import (
    ROBOT_LABEL,
    GeomAppearance,
    bone_labels,
    labels_of,
    reflectances,
    transparencies,
)
from usarmjx.sensors.cameras.picture import Picture, camera_viewpoint, check_size, render_picture
from usarmjx.sensors.cameras.shading import SUN_DIRECTION, Headlights, PointLights, RenderScene, point_lights
from usarmjx.sensors.rays.targets import GeomBlock
from usarmjx.sim.ray_geometry import (
    camera_geoms,
    visible_arena,
    visible_doors,
    visible_loose,
    visible_robots,
    visible_water,
)
from usarmjx.sim.scene import Scene
from usarmjx.sim.world import Stream, World, clock_of, episode_key, powered, robot_states


def geom_colors_of(scene: Scene) -> GeomColors:
    """Return the colors of all geoms and the water of a scene, and the visuals of robots and victims."""
    model, water = scene.model, visible_water(scene)
    materials, label = materials_of(model, scene.arena), labels_of(model, scene.arena)
    visuals = [*_robot_visuals(scene), *_victim_visuals(scene)]
    # The empty array first: a scene may have no visuals.
    rgb = np.concatenate([np.zeros((0, 3)), *(one.figure.model.geom_rgba[:, :3] for one in visuals)])
    visual_labels = np.repeat([one.label for one in visuals], [one.figure.model.ngeom for one in visuals])
    opaque = np.zeros(len(rgb), np.float32)
    material_array = np.array(materials, object)
    appearance = GeomAppearance(
        rgb=np.concatenate([model.geom_rgba[:, :3], np.asarray(water.rgb), rgb]).astype(np.float32),
        transparency=np.concatenate([transparencies(material_array), water.transparency, opaque]),
        reflectance=np.concatenate([reflectances(np.concatenate([material_array, water.material])), opaque]),
        label=np.concatenate([label, np.asarray(water.label), visual_labels]).astype(np.int32),
        **_textures(scene, len(water.rgb) + len(rgb)),
    )
    replaced = np.zeros(model.ngeom, bool)
    for one in visuals:
        # Solids that visuals stand for are hidden from cameras, or both would be seen.
        replaced |= np.isin(np.arange(model.ngeom) if one.of_geoms else model.geom_bodyid, one.frames)
    boxes = GeomBlock(pos=water.pos, mat=water.mat, size=water.size, owner=water.owner)
    return GeomColors(appearance, materials, boxes, visuals, np.flatnonzero(replaced))


def _textures(scene: Scene, others: int) -> dict[str, Any]:
    """Return the textures of the model's geoms, and none for `others` more, as fields of `GeomAppearance`."""
    code = np.concatenate([textures_of(scene.model, scene.arena), np.zeros(others, np.int32)])
    return {"texture": code, "textures": texture_names(code)} if code.any() else {}


def _robot_visuals(scene: Scene) -> list[AttachedVisual]:
    return [
        AttachedVisual(
            group.plan.visuals, np.array(index.body_ids), False, ROBOT_LABEL + int(slot), int(slot)
        )
        for group in scene.groups
        for slot, index in zip(group.slots, group.indices, strict=True)
    ]


def _victim_visuals(scene: Scene) -> list[AttachedVisual]:
    """Return the figures of the victims, and of the false alarms."""
    table, found = scene.victims, list[AttachedVisual]()
    for owner in np.unique(table.owner).tolist():
        boxes = np.flatnonzero(table.owner == owner)
        geoms = np.array([scene.model.geom(f"{VICTIM_PREFIX}{box}").id for box in boxes])
        label = int(bone_labels(np.array(owner)))
        found.append(AttachedVisual(victim_visual_model(table, owner), geoms, True, label))
    return found


Result = TypeVar("Result")
GroupCamera = tuple[int, Camera, int]
"""Index of a group, one of its robots' cameras, and its index among them."""
CHECKER_SIZE = 0.5
"""Side of the floor's checkers [m]."""
PICTURE_KEY = 2**31 - 1
"""Number that stands for a robot's slot in keys that all cameras of a world share."""
UNBOUNDED_EXTENT = ((-np.inf, np.inf), (-np.inf, np.inf))


def find_camera(
    scene: Scene, group: int, camera: str | int | None, size: tuple[int, int] | None = None
) -> GroupCamera:
    """Return a camera of a group's robots.

    Args:
        scene: The scene.
        group: Index into `scene.groups`.
        camera: Name or index of a camera of the class; None: the main one.
        size: Width and height of the picture to take; None: any.

    Raises:
        UnknownNameError: The robots have no such camera; lists those they have.
        UsageError: A picture of that size cannot be taken.
    """
    robot = scene.groups[group].robot
    index = camera_index(robot, camera)
    found = cameras_of(robot)[index]
    if size is not None:
        check_size(found, *size)
    return group, found, index


@named_scope("render_scene")
def build_render_scene(
    scene: Scene, world: World, physics: PhysicsState
) -> tuple[RenderScene, tuple[BodyPoses, ...]]:
    """Return all that cameras see of a world, and where the robots' bodies are, by group."""
    bodies = tuple(forward_kinematics(group.plan, robot_states(group, physics)) for group in scene.groups)
    geoms, paint = camera_geoms(
        [
            *visible_arena(scene, world.arena_state, clock_of(scene, world), drawn=True),
            visible_loose(scene, physics),
            visible_doors(scene, physics),
            visible_water(scene),
            *visible_robots(scene, bodies, [state.active for state in world.groups], drawn=True),
        ]
    )
    if world.arena_state is None:
        lamps = point_lights(scene.arena.lights, scene.arena.floor)
    else:
        lamps = PointLights(pos=world.arena_state.lamps[:, :3], rgb=world.arena_state.lamps[:, 3:])
    sun = np.array(SUN_DIRECTION, np.float32)
    render_scene = RenderScene(
        geoms=geoms,
        appearance=paint,
        sun_direction=sun / np.linalg.norm(sun),
        lights=lamps,
        headlights=_headlights(scene, world, bodies),
        checker_size=np.asarray(CHECKER_SIZE, np.float32),
        checker_bounds=np.array(UNBOUNDED_EXTENT, np.float32),
        seed=_picture_seed(world),
    )
    return render_scene, bodies


def _picture_seed(world: World) -> Array:
    """Return the seed of the noise in pictures of this moment ()."""
    # Of the same stream as sensors, which fold in slots: a number that no slot has keeps both apart.
    key = random.fold_in(episode_key(world, Stream.SENSOR_NOISE), world.step)
    return random.randint(random.fold_in(key, PICTURE_KEY), 0, 2**31 - 1)


def _headlights(scene: Scene, world: World, bodies: tuple[BodyPoses, ...]) -> Headlights:
    """Return the headlights; those of robots without power are off."""
    pos: list[Array] = []
    along: list[Array] = []
    on: list[Array] = []
    for group, state, body in zip(scene.groups, world.groups, bodies, strict=True):
        lamp = headlight_of(group.robot)
        mat = body.mat[:, lamp.body]
        pos.append(body.pos[:, lamp.body] + mat @ lamp.pos)
        along.append(mat @ lamp.direction)
        on.append(state.command.light & powered(scene, world, group, state))
    # The empty array first: a scene may have no robots.
    slots = np.concatenate([np.zeros(0, int), *(group.slots for group in scene.groups)])
    return Headlights(
        pos=xp.concatenate([xp.zeros((0, 3)), *pos]),
        direction=xp.concatenate([xp.zeros((0, 3)), *along]),
        on=xp.concatenate([xp.zeros(0, bool), *on]),
        label=ROBOT_LABEL + slots,
    )


@named_scope("render")
def render_group(
    scene: Scene,
    world: World,
    physics: PhysicsState,
    group_camera: GroupCamera,
    size: tuple[int, int],
) -> Picture:
    """Return the picture of a camera of all robots of a group; leading axis over robots.

    Args:
        scene: The scene.
        world: The world.
        physics: State of the physics.
        group_camera: Group, camera, and the camera's index among those of its class; static.
        size: Width and height of a picture; static.
    """
    group, camera, place = group_camera
    render_scene, bodies = build_render_scene(scene, world, physics)
    members = bodies[group], xp.asarray(scene.groups[group].slots), world.groups[group].fov[:, place]
    return map_pictures(
        lambda *member: render_picture(render_scene, camera_viewpoint(camera, *member), *size), *members
    )


def render_scene_of_world(
    scene: Scene, worlds: World, physics: PhysicsState, world: int
) -> tuple[RenderScene, tuple[BodyPoses, ...]]:
    """Return `build_render_scene` of one of many worlds."""
    return build_render_scene(scene, *jax.tree.map(lambda x: x[world], (worlds, physics)))


def render_groups(
    scene: Scene, worlds: World, physics: PhysicsState, group_camera: GroupCamera, size: tuple[int, int]
) -> Picture:
    """Return `render_group` of all worlds (worlds, robots, ...)."""

    def one(world: World, physics: PhysicsState) -> Picture:
        return render_group(scene, world, physics, group_camera, size)

    return map_pictures(one, worlds, physics)


def map_pictures(function: Callable[..., Result], *values: Any) -> Result:  # noqa: ANN401 - PyTrees
    """Return a function's pictures, or what else it makes of them, for each row of some values.

    On a CPU one after the other: then what a picture does not need, as mirrors where none are in sight, is
    left out, which is three times as fast.
    """
    if jax.default_backend() == "cpu":

        def one(row: tuple[Any, ...]) -> Result:
            return function(*row)

        return jax.lax.map(one, values)
    return jax.vmap(function)(*values)
