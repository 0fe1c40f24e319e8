from typing import Any

mujoco_warp: Any
