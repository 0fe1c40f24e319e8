"""Imaging behind a camera's lens: exposure, noise and supersampling."""

from typing import NamedTuple

import numpy as np

from usarmjx.base import random
from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.sensors.settings import CameraSettings


class Imaging(NamedTuple):
    """Imaging parameters of a camera.

    Attributes:
        exposure: Factor on brightness.
        distortion: k1 and k2 of the lens; None: no distortion (2,).
        noise: Standard deviation of each colour, of 255; None: no noise.
        supersampling: Rays along each side of a pixel.
    """

    exposure: float = 1.0
    distortion: np.ndarray | None = None
    noise: float | None = None
    supersampling: int = 1


PLAIN_IMAGING = Imaging()
"""Imaging of an ideal camera."""


def imaging_of(settings: CameraSettings) -> Imaging:
    """Return the imaging parameters of settings; effects that are off are None and cost nothing."""
    bend = np.array([settings.distortion_k1, settings.distortion_k2], np.float32)
    return Imaging(
        exposure=settings.exposure,
        distortion=bend if bend.any() else None,
        noise=settings.image_noise or None,
        supersampling=settings.supersampling,
    )


def quantize(rgb: Array, noise: Array | None, seed: Array | int, slot: Array | int) -> Array:
    """Return colours in [0, 1] (..., 3) as uint8 levels, with noise if there is any.

    Args:
        rgb: Colours.
        noise: Standard deviation of the noise, of 255 ().
        seed: Seed of the noise ().
        slot: Slot of the robot, whose noise is its own ().
    """
    bright = 255 * rgb
    if noise is not None:
        key = random.fold_in(random.fold_in(random.key(0), seed), slot)
        bright = xp.clip(bright + noise * random.normal(key, bright.shape), 0.0, 255.0)
    return xp.floor(bright + 0.5).astype(xp.uint8)


def box_filter(values: Array, times: int) -> Array:
    """Return the mean of each block of `times` x `times` values of a picture (rows, columns, ...)."""
    rows, columns = values.shape[0] // times, values.shape[1] // times
    return values.reshape(rows, times, columns, times, *values.shape[2:]).mean((1, 3))
