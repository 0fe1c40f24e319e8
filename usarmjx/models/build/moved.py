"""Geoms of an arena that are data: placed anew in every control step, and differently in each world."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class MovedGeoms:
    """Which geoms of a model are data. All hang on the mocap body `arena`.

    Attributes:
        names: Their names in the model.
        max_half_length: The largest half length of each in any world [m] (geoms,).
        resized: Whether their sizes differ between worlds too; they are boxes then.
    """

    names: tuple[str, ...]
    max_half_length: np.ndarray
    resized: bool
