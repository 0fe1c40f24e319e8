"""What becomes of the light behind a camera's lens: exposure, noise, and how many rays make a pixel."""

from typing import NamedTuple

import numpy as np

from usarmjx.base import random
from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.sensors.settings import CameraSettings


class Imaging(NamedTuple):
    """How a camera makes a picture of what its rays see.

    Attributes:
        exposure: Factor on brightness.
        distortion: k1 and k2 of the lens; None: none (2,).
        noise: Standard deviation of each colour, of 255; None: none.
        supersampling: Rays along each side of a pixel.
    """

    exposure: float = 1.0
    distortion: np.ndarray | None = None
    noise: float | None = None
    supersampling: int = 1


PLAIN_IMAGING = Imaging()


def imaging_of(settings: CameraSettings) -> Imaging:
    """Return what settings make of pictures; what is not asked for costs nothing."""
    bend = np.array([settings.distortion_k1, settings.distortion_k2], np.float32)
    return Imaging(
        exposure=settings.exposure,
        distortion=bend if bend.any() else None,
        noise=settings.image_noise or None,
        supersampling=settings.supersampling,
    )


def levels(rgb: Array, noise: Array | None, seed: Array | int, slot: Array | int) -> Array:
    """Return colours in [0, 1] (..., 3) as numbers from 0 to 255, uint8, with noise if there is any.

    Args:
        rgb: The colours.
        noise: Its standard deviation, of 255 ().
        seed: Of the noise ().
        slot: Slot of the robot, whose noise is its own ().
    """
    bright = 255 * rgb
    if noise is not None:
        key = random.fold_in(random.fold_in(random.key(0), seed), slot)
        bright = xp.clip(bright + noise * random.normal(key, bright.shape), 0.0, 255.0)
    return xp.floor(bright + 0.5).astype(xp.uint8)


def smoothed(values: Array, times: int) -> Array:
    """Return the mean of each block of so many times so many values (rows, columns, ...) of a picture."""
    rows, columns = values.shape[0] // times, values.shape[1] // times
    return values.reshape(rows, times, columns, times, *values.shape[2:]).mean((1, 3))
