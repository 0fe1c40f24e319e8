"""usarmjx: USARSim rebuilt as a GPU-batched simulator of multi-robot swarms.

`make` gives a task's environment, `Batch` steps the worlds of a scene that `build_scene` made, `serve` lets
clients of the Gamebots protocol in, `load_policy` finds a trained policy, `sweep` plays many configurations.
`TASKS`, `ROBOTS`, `ARENAS`, `SENSORS`, `POLICIES` and `ENGINES` have what there is by name:
`usarmjx.TASKS.names()`. The other names here are types of their arguments and results. These names are
public; `usarmjx.client`, which needs only the standard library, is too. docs/architecture.md says where the
rest is, and follows a command, a range, an action and a radio link through it.

All of it is imported on first use. Importing this raises JAX's pool of threads, see `base.threads`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from usarmjx.base import process

if TYPE_CHECKING:
    from usarmjx.base.errors import EngineError as EngineError
    from usarmjx.base.errors import SpecError as SpecError
    from usarmjx.base.errors import UnknownNameError as UnknownNameError
    from usarmjx.base.errors import UsageError as UsageError
    from usarmjx.base.errors import UsarmjxError as UsarmjxError
    from usarmjx.base.registry import Registry as Registry
    from usarmjx.comms.attenuation import RadioSettings as RadioSettings
    from usarmjx.comms.mail import MessageSettings as MessageSettings
    from usarmjx.engines.base import ENGINES as ENGINES
    from usarmjx.models.arenas import ARENAS as ARENAS
    from usarmjx.models.compile.compose import Physics as Physics
    from usarmjx.models.compile.randomization import DomainRandomization as DomainRandomization
    from usarmjx.models.robots import ROBOTS as ROBOTS
    from usarmjx.models.types.arena import ArenaSpec as ArenaSpec
    from usarmjx.models.types.robot import RobotSpec as RobotSpec
    from usarmjx.sensors.suite import SENSORS as SENSORS
    from usarmjx.server.runtime.background import Serving as Serving
    from usarmjx.server.runtime.background import serve as serve
    from usarmjx.sim.batch import Batch as Batch
    from usarmjx.sim.batch import BatchState as BatchState
    from usarmjx.sim.scene import RosterEntry as RosterEntry
    from usarmjx.sim.scene import Scene as Scene
    from usarmjx.sim.scene import build_scene as build_scene
    from usarmjx.sweeps.run import sweep as sweep
    from usarmjx.sweeps.workers import Workers as Workers
    from usarmjx.train.envs.env import Env as Env
    from usarmjx.train.envs.task import Policy as Policy
    from usarmjx.train.make import make as make
    from usarmjx.train.policies import POLICIES as POLICIES
    from usarmjx.train.policies.sources import PolicySource as PolicySource
    from usarmjx.train.policies.sources import find_source as load_policy  # noqa: F401
    from usarmjx.train.tasks import TASKS as TASKS

__version__ = "0.1.0"

_WHERE = {
    "ARENAS": "usarmjx.models.arenas",
    "ArenaSpec": "usarmjx.models.types.arena",
    "Batch": "usarmjx.sim.batch",
    "BatchState": "usarmjx.sim.batch",
    "DomainRandomization": "usarmjx.models.compile.randomization",
    "ENGINES": "usarmjx.engines.base",
    "EngineError": "usarmjx.base.errors",
    "Env": "usarmjx.train.envs.env",
    "MessageSettings": "usarmjx.comms.mail",
    "POLICIES": "usarmjx.train.policies",
    "Physics": "usarmjx.models.compile.compose",
    "Policy": "usarmjx.train.envs.task",
    "PolicySource": "usarmjx.train.policies.sources",
    "ROBOTS": "usarmjx.models.robots",
    "RadioSettings": "usarmjx.comms.attenuation",
    "Registry": "usarmjx.base.registry",
    "RobotSpec": "usarmjx.models.types.robot",
    "RosterEntry": "usarmjx.sim.scene",
    "SENSORS": "usarmjx.sensors.suite",
    "Scene": "usarmjx.sim.scene",
    "Serving": "usarmjx.server.runtime.background",
    "SpecError": "usarmjx.base.errors",
    "TASKS": "usarmjx.train.tasks",
    "UnknownNameError": "usarmjx.base.errors",
    "UsageError": "usarmjx.base.errors",
    "UsarmjxError": "usarmjx.base.errors",
    "Workers": "usarmjx.sweeps.workers",
    "build_scene": "usarmjx.sim.scene",
    "load_policy": "usarmjx.train.policies.sources:find_source",
    "make": "usarmjx.train.make",
    "serve": "usarmjx.server.runtime.background",
    "sweep": "usarmjx.sweeps.run",
}
"""The module of each public name, and what it is called there if otherwise."""

__all__ = [*_WHERE, "__version__"]  # pyright: ignore[reportUnsupportedDunderAll]

process.ensure_pool_size()


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever has that name
    # On demand: whoever imports a small part of usarmjx does not wait for all of it.
    if name not in _WHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module, _, there = _WHERE[name].partition(":")
    return getattr(import_module(module), there or name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_WHERE})
