"""Calibration of a camera: CameraInfo."""

import math

from usarmjx.sensors.cameras.mounts import Camera
from usarmjx.server.rosbridge.definitions import RosMessage, RosVersion
from usarmjx.server.rosbridge.motion import frame_name, optical_name


def has_info(camera: Camera) -> bool:
    """Return whether CameraInfo can describe a camera: one with one eye, and no mirror."""
    return camera.lens == "pinhole" and len(camera.eye_offsets) == 1


def camera_info(
    version: RosVersion, time: float, robot: str, camera: Camera, fov: float, size: tuple[int, int]
) -> RosMessage:
    """Return the CameraInfo of a camera.

    Args:
        version: Version of its field names.
        time: Simulated time [s].
        robot: Its robot's name, in frames.
        camera: The camera.
        fov: Its horizontal field of view now [rad].
        size: Width and height of its pictures [pixels].
    """
    name = optical_name(f"{robot}/{frame_name(camera.mount.name)}")
    bent = camera.imaging.distortion
    k1, k2 = (0.0, 0.0) if bent is None else (float(one) for one in bent)
    return pinhole_info(version, time, name, fov, size, (k1, k2))


def pinhole_info(
    version: RosVersion,
    time: float,
    frame: str,
    fov: float,
    size: tuple[int, int],
    distortion: tuple[float, float] = (0.0, 0.0),
) -> RosMessage:
    """Return the CameraInfo of a pinhole.

    Args:
        version: Version of its field names.
        time: Simulated time [s].
        frame: Name of the optical frame.
        fov: Its horizontal field of view [rad].
        size: Width and height of its pictures [pixels].
        distortion: k1 and k2 of a plumb bob.
    """
    width, height = size
    focal = width / 2 / math.tan(fov / 2)
    # ROS counts pixels by their centres: the first is 0, so the picture's centre is half a pixel short of
    # half its side.
    across, down = (width - 1) / 2, (height - 1) / 2
    lens = {
        "d": [*distortion, 0.0, 0.0, 0.0],
        "k": [focal, 0.0, across, 0.0, focal, down, 0.0, 0.0, 1.0],
        "r": [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        "p": [focal, 0.0, across, 0.0, 0.0, focal, down, 0.0, 0.0, 0.0, 1.0, 0.0],
    }
    if version == RosVersion.ROS1:
        lens = {name.upper(): values for name, values in lens.items()}
    return {
        "header": version.header(time, frame),
        "height": height,
        "width": width,
        "distortion_model": "plumb_bob",
        **lens,
        "binning_x": 0,
        "binning_y": 0,
        "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
    }
