"""Pictures of the same scene by the renderer of MuJoCo Warp, to compare ours with."""

import time
from functools import partial
from typing import Any, cast

import mujoco
import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.cameras.mounts import Camera
from usarmjx.sim.scene import Scene

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
    times = []
    for _ in range(repeats):
        wp.synchronize()
        began = time.perf_counter()
        run()
        wp.synchronize()
        times.append(time.perf_counter() - began)
    depth = context.depth_data.numpy()
    return {
        "frames_per_s": worlds * steps / float(np.median(times)),
        "times_s": times,
        "geoms": model.ngeom,
        "shadows": shadows,
        "pixels_that_see_something": float((depth > 0).mean()),
    }
