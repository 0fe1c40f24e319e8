"""One tick of a world as pure functions, and many worlds at once.

`build_scene` compiles what is fixed, an arena with its robots; `Batch` steps copies of it, `SingleWorld` one
that clients share. Private: `world` is the state with the functions of a control step, `reset` starts it,
`control` and `actions` command robots; `operate`, `radio`, `ray_geometry` and `views` are parts of a tick. A
function that takes a `World` is traced: no branching on values, and random numbers come from the key of a
`world.Stream`. Only `batch` maps over worlds and compiles. Begin with `Batch`, then `world.compute_inputs`
and `world.observe`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.sim.actions import Actions as Actions
    from usarmjx.sim.actions import EffecterAction as EffecterAction
    from usarmjx.sim.actions import JointAction as JointAction
    from usarmjx.sim.batch import Annotator as Annotator
    from usarmjx.sim.batch import Batch as Batch
    from usarmjx.sim.batch import BatchState as BatchState
    from usarmjx.sim.batch import Readings as Readings
    from usarmjx.sim.batch import put_robot as put_robot
    from usarmjx.sim.calibration import calibrate as calibrate
    from usarmjx.sim.calibration import ensure_calibrated as ensure_calibrated
    from usarmjx.sim.control import CommandUpdate as CommandUpdate
    from usarmjx.sim.control import ControlMode as ControlMode
    from usarmjx.sim.operate import OperationResult as OperationResult
    from usarmjx.sim.scene import RosterEntry as RosterEntry
    from usarmjx.sim.scene import Scene as Scene
    from usarmjx.sim.scene import build_scene as build_scene
    from usarmjx.sim.single_world import SingleWorld as SingleWorld
    from usarmjx.sim.world import World as World
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.sim.actions": ("Actions", "EffecterAction", "JointAction"),
            "usarmjx.sim.batch": ("Annotator", "Batch", "BatchState", "Readings", "put_robot"),
            "usarmjx.sim.calibration": ("calibrate", "ensure_calibrated"),
            "usarmjx.sim.control": ("CommandUpdate", "ControlMode"),
            "usarmjx.sim.operate": ("OperationResult",),
            "usarmjx.sim.scene": ("RosterEntry", "Scene", "build_scene"),
            "usarmjx.sim.single_world": ("SingleWorld",),
            "usarmjx.sim.world": ("World",),
        },
    )
