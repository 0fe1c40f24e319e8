"""usarmjx: USARSim rebuilt as a GPU-batched simulator of multi-robot swarms.

`make` builds the environment of a task, `build_scene` and `Batch` step worlds without a task, `serve` lets
clients of the Gamebots protocol in, `load_policy` finds a trained policy, `evaluate` scores it, `sweep`
plays many configurations.
`TASKS`, `ROBOTS`, `ARENAS`, `SENSORS`, `POLICIES` and `ENGINES` list what exists: `usarmjx.TASKS.names()`.
Public are the names in `__all__` here and in the packages below (`usarmjx.models`, `.sensors`, `.train`, ...;
docs/api.md lists them); all other modules may change. Begin with docs/start.md, then docs/architecture.md.

Names load on first use. The import raises JAX's pool of threads, see `base.process`.
"""

from usarmjx.base import early_signals

if early_signals.is_command():  # before further imports, during which a signal would be a traceback
    early_signals.catch_signals()

from typing import TYPE_CHECKING

from usarmjx.base import process
from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.base.errors import ArenaFileError as ArenaFileError
    from usarmjx.base.errors import EngineError as EngineError
    from usarmjx.base.errors import MissingExtraError as MissingExtraError
    from usarmjx.base.errors import PeerError as PeerError
    from usarmjx.base.errors import SpecError as SpecError
    from usarmjx.base.errors import UnknownNameError as UnknownNameError
    from usarmjx.base.errors import UnsupportedFeatureError as UnsupportedFeatureError
    from usarmjx.base.errors import UsageError as UsageError
    from usarmjx.base.errors import UsarmjxError as UsarmjxError
    from usarmjx.base.errors import WriteError as WriteError
    from usarmjx.base.registry import Registry as Registry
    from usarmjx.comms.attenuation import RadioSettings as RadioSettings
    from usarmjx.comms.mail import MessageSettings as MessageSettings
    from usarmjx.engines.base import ENGINES as ENGINES
    from usarmjx.models.arenas import ARENAS as ARENAS
    from usarmjx.models.compile.physics import Physics as Physics
    from usarmjx.models.compile.randomization import DomainRandomization as DomainRandomization
    from usarmjx.models.robots import ROBOTS as ROBOTS
    from usarmjx.models.types.arena import ArenaSpec as ArenaSpec
    from usarmjx.models.types.robot import RobotSpec as RobotSpec
    from usarmjx.sensors.suite import SENSORS as SENSORS
    from usarmjx.server.runtime.background import Serving as Serving
    from usarmjx.server.runtime.background import serve as serve
    from usarmjx.sim.batch import Batch as Batch
    from usarmjx.sim.batch import BatchState as BatchState
    from usarmjx.sim.configure import configure as configure
    from usarmjx.sim.scene import RosterEntry as RosterEntry
    from usarmjx.sim.scene import Scene as Scene
    from usarmjx.sim.scene import build_scene as build_scene
    from usarmjx.sweeps.run import sweep as sweep
    from usarmjx.sweeps.workers import Workers as Workers
    from usarmjx.train.envs.env import Env as Env
    from usarmjx.train.envs.task import Policy as Policy
    from usarmjx.train.evaluation.evaluate import evaluate as evaluate
    from usarmjx.train.make import make as make
    from usarmjx.train.policies import POLICIES as POLICIES
    from usarmjx.train.policies.sources import PolicySource as PolicySource
    from usarmjx.train.policies.sources import load_policy as load_policy
    from usarmjx.train.tasks import TASKS as TASKS
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.base.errors": (
                "ArenaFileError",
                "EngineError",
                "MissingExtraError",
                "PeerError",
                "SpecError",
                "UnknownNameError",
                "UnsupportedFeatureError",
                "UsageError",
                "UsarmjxError",
                "WriteError",
            ),
            "usarmjx.base.registry": ("Registry",),
            "usarmjx.comms.attenuation": ("RadioSettings",),
            "usarmjx.comms.mail": ("MessageSettings",),
            "usarmjx.engines.base": ("ENGINES",),
            "usarmjx.models.arenas": ("ARENAS",),
            "usarmjx.models.compile.physics": ("Physics",),
            "usarmjx.models.compile.randomization": ("DomainRandomization",),
            "usarmjx.models.robots": ("ROBOTS",),
            "usarmjx.models.types.arena": ("ArenaSpec",),
            "usarmjx.models.types.robot": ("RobotSpec",),
            "usarmjx.sensors.suite": ("SENSORS",),
            "usarmjx.server.runtime.background": ("Serving", "serve"),
            "usarmjx.sim.batch": ("Batch", "BatchState"),
            "usarmjx.sim.configure": ("configure",),
            "usarmjx.sim.scene": ("RosterEntry", "Scene", "build_scene"),
            "usarmjx.sweeps.run": ("sweep",),
            "usarmjx.sweeps.workers": ("Workers",),
            "usarmjx.train.envs.env": ("Env",),
            "usarmjx.train.envs.task": ("Policy",),
            "usarmjx.train.evaluation.evaluate": ("evaluate",),
            "usarmjx.train.make": ("make",),
            "usarmjx.train.policies": ("POLICIES",),
            "usarmjx.train.policies.sources": ("PolicySource", "load_policy"),
            "usarmjx.train.tasks": ("TASKS",),
        },
        "__version__",
    )

__version__ = "0.1.0"

process.ensure_pool_size()
process.check_inherited_cache()
