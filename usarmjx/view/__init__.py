"""Worlds as they look: what recordings keep, and what the page in a browser shows.

A `Drawing` is what never changes, a `Frame` one moment, a `FrameSource` gives both, `ViewerPage` shows them;
`Capture` makes them of a world on any engine. `LAYERS` are switched on and off over a world. Private: `stage`
and `mesh` draw bodies, `layers` all over them, `viewpoint` follows robots, `robot_controls` and `user_panels`
are controls. A new layer is a subclass of `Layer` in `layers`. Begin with `drawing`, then `page`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.view.capture import Capture as Capture
    from usarmjx.view.drawing import Drawing as Drawing
    from usarmjx.view.drawing import DrawnBody as DrawnBody
    from usarmjx.view.drawing import DrawnMount as DrawnMount
    from usarmjx.view.drawing import DrawnRobot as DrawnRobot
    from usarmjx.view.drawing import DrawnShape as DrawnShape
    from usarmjx.view.drawing import DrawnTag as DrawnTag
    from usarmjx.view.drawing import Frame as Frame
    from usarmjx.view.drawing import FrameSource as FrameSource
    from usarmjx.view.drawing import RobotFrame as RobotFrame
    from usarmjx.view.layers import LAYERS as LAYERS
    from usarmjx.view.layers.base import Layer as Layer
    from usarmjx.view.page import ViewerPage as ViewerPage
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.view.capture": ("Capture",),
            "usarmjx.view.drawing": (
                "DrawnBody",
                "DrawnMount",
                "DrawnRobot",
                "DrawnShape",
                "DrawnTag",
                "Drawing",
                "Frame",
                "FrameSource",
                "RobotFrame",
            ),
            "usarmjx.view.layers": ("LAYERS",),
            "usarmjx.view.layers.base": ("Layer",),
            "usarmjx.view.page": ("ViewerPage",),
        },
    )
