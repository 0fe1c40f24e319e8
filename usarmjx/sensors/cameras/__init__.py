"""Cameras: pictures by ray casting, with depth and labels, for batches and for the image server alike.

A `Viewpoint` and the geoms of a world give a `Picture`; `Batch.render` and `usarmjx.sim.Annotator` take it.
The labels say what a pixel of `Picture.segmentation` shows, `INSTANCES` which one. Private: `mounts` finds
cameras of a robot class, `lenses` makes rays, `casters` finds what they meet, `shading` and `paint` colour
it, `Imaging` adds noise and exposure, `programs` compiles in the background. Begin with
`picture.render_picture`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.sensors.cameras.paint import ARENA_LABEL as ARENA_LABEL
    from usarmjx.sensors.cameras.paint import DOOR_LABEL as DOOR_LABEL
    from usarmjx.sensors.cameras.paint import FALSE_ALARM_LABEL as FALSE_ALARM_LABEL
    from usarmjx.sensors.cameras.paint import INSTANCES as INSTANCES
    from usarmjx.sensors.cameras.paint import LOOSE_LABEL as LOOSE_LABEL
    from usarmjx.sensors.cameras.paint import OUTSIDE_LABEL as OUTSIDE_LABEL
    from usarmjx.sensors.cameras.paint import ROBOT_LABEL as ROBOT_LABEL
    from usarmjx.sensors.cameras.paint import SKY_LABEL as SKY_LABEL
    from usarmjx.sensors.cameras.paint import VICTIM_LABEL as VICTIM_LABEL
    from usarmjx.sensors.cameras.paint import WATER_LABEL as WATER_LABEL
    from usarmjx.sensors.cameras.picture import Picture as Picture
    from usarmjx.sensors.cameras.picture import Viewpoint as Viewpoint
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.sensors.cameras.paint": (
                "ARENA_LABEL",
                "DOOR_LABEL",
                "FALSE_ALARM_LABEL",
                "INSTANCES",
                "LOOSE_LABEL",
                "OUTSIDE_LABEL",
                "ROBOT_LABEL",
                "SKY_LABEL",
                "VICTIM_LABEL",
                "WATER_LABEL",
            ),
            "usarmjx.sensors.cameras.picture": ("Picture", "Viewpoint"),
        },
    )
