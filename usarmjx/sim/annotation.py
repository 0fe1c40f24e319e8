"""Labels for the cameras of a batch's robots, pixel by pixel: instances, normals and optical flow."""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp

from usarmjx.base.backend import Array
from usarmjx.engines.base import PhysicsState
from usarmjx.models.compile.kinematic_tree import BodyPoses
from usarmjx.sensors.cameras.picture import Annotation, annotate, camera_viewpoint
from usarmjx.sensors.cameras.shading import RenderScene
from usarmjx.sim.batch import Batch, BatchState
from usarmjx.sim.scene import Scene
from usarmjx.sim.views import GroupCamera, build_render_scene, find_camera, map_pictures
from usarmjx.sim.world import World

Moment = tuple[World, PhysicsState]
"""Worlds, and where everything is in them."""
Member = tuple[BodyPoses, Array, Array]
"""Bodies of robots, their slots, and the fields of view of a camera [rad]."""


class Annotator:
    """Annotates what the cameras of a batch see; compiled once for each camera and size.

    Args:
        batch: The batch.
    """

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        exact = jax.default_matmul_precision("highest")(partial(_annotate_worlds, batch.scene))
        self._annotate: Callable[..., Annotation] = jax.jit(exact, static_argnums=(2, 3))

    def annotate(
        self,
        state: BatchState,
        group: int,
        camera: str | int | None = None,
        width: int = 64,
        height: int = 64,
        *,
        later: BatchState | None = None,
    ) -> Annotation:
        """Return the view of a camera of each of a group's robots (worlds, robots, ...).

        Args:
            state: The batch.
            group: Index into `scene.groups`.
            camera: Name or index of a camera of the class; None: the main one.
            width: Pixels along a row.
            height: Rows.
            later: The batch at the moment up to which the flow is; None: nothing moves.

        Raises:
            UnknownNameError: The robots have no such camera; lists those they have.
            UsageError: A picture of that size cannot be taken.
        """
        then, size = state if later is None else later, (width, height)
        moments = [(one.worlds, self._batch.physics(one)) for one in (state, then)]
        return self._annotate(*moments, find_camera(self._batch.scene, group, camera, size), size)


def _annotate_worlds(
    scene: Scene, now: Moment, then: Moment, group_camera: GroupCamera, size: tuple[int, int]
) -> Annotation:
    group, camera, camera_index = group_camera
    slots = jnp.asarray(scene.groups[group].slots)

    def build(moment: Moment) -> tuple[RenderScene, Member]:
        render_scene, bodies = build_render_scene(scene, *moment)
        return render_scene, (bodies[group], slots, moment[0].groups[group].fov[:, camera_index])

    def of_world(now: Moment, then: Moment) -> Annotation:
        (scene_now, members_now), (scene_later, members_later) = build(now), build(then)

        def of_robot(members_now: Member, members_later: Member) -> Annotation:
            views = [camera_viewpoint(camera, *member) for member in (members_now, members_later)]
            return annotate(scene_now, views[0], scene_later, views[1], *size)

        return map_pictures(of_robot, members_now, members_later)

    return map_pictures(of_world, now, then)
