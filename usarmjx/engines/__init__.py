"""Physics behind one interface: `warp`, `jax` and `c` advance many copies of the same model.

`base` has the interface and refuses what an engine would silently ignore; `c` is C MuJoCo and the oracle of
the others, `mjx` both of MJX's; `varied` and `short_boxes` are what differs between worlds, `cylinder_box`
the contacts that MJX-JAX lacks. Begin with `base.Engine`. Only `cylinder_box`, `mjx` and `warp_graphs` touch
MJX's private names, for the one version that they check; whether two engines agree is
`tests/engines/test_engines.py`'s to say.
"""

from usarmjx.engines.base import (
    ENGINES,
    Engine,
    Inputs,
    PhysicsState,
    choose_engine,
    engine_class,
    make_engine,
)

__all__ = ["ENGINES", "Engine", "Inputs", "PhysicsState", "choose_engine", "engine_class", "make_engine"]
