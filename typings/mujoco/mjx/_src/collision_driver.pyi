# Private to MJX; engines/mjx.py says what for.
from typing import Any

from mujoco import MjModel
from mujoco.mjx import Model

def _numeric(m: MjModel | Model, name: str) -> int: ...
def _geom_groups(m: MjModel | Model) -> dict[Any, list[tuple[int, int, int]]]: ...
