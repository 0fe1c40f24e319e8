"""Physics behind one interface: `warp`, `jax`, `c` and `planar` advance many copies of one model.

`ENGINES` lists them, `choose_engine` resolves `auto`, `make_engine` builds one; `usarmjx.Batch` does both.
`c` is C MuJoCo and the oracle of the others. Private: `base` has the interface and refuses what an engine
would ignore, `mjx` and `mjx_warp` touch MJX's private names for the one version that they check,
`cylinder_box` adds contacts that MJX lacks, `planar` is an engine without a solver. A new engine subclasses
`Engine`. Begin with `base.Engine`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.engines.base import ENGINES as ENGINES
    from usarmjx.engines.base import Engine as Engine
    from usarmjx.engines.base import Inputs as Inputs
    from usarmjx.engines.base import PhysicsState as PhysicsState
    from usarmjx.engines.base import choose_engine as choose_engine
    from usarmjx.engines.base import engine_class as engine_class
    from usarmjx.engines.base import make_engine as make_engine
    from usarmjx.engines.planar.responses import UncalibratedRobotError as UncalibratedRobotError
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.engines.base": (
                "ENGINES",
                "Engine",
                "Inputs",
                "PhysicsState",
                "choose_engine",
                "engine_class",
                "make_engine",
            ),
            "usarmjx.engines.planar.responses": ("UncalibratedRobotError",),
        },
    )
