"""MJX, imported without its notes on the standard output that Warp is missing."""

from usarmjx.base.installation import without_notes

__all__ = ["collision_driver", "mjx"]

with without_notes():
    from mujoco import mjx
    from mujoco.mjx._src import collision_driver
