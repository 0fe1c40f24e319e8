"""Policies: tasks, environments over batches of worlds, baselines, training and evaluation.

A `Task` is data and pure functions of one world, an `Env` plays it in many, `train` is PPO,
`evaluate` says how good a policy is, `NumpyPolicy` runs an exported one. The packages `tasks`,
`baselines` and `adapters` (other libraries' interfaces) are faces of their own. Private: `envs`, `mapping`,
`learning`, `evaluation`, `policies`. A new task or baseline is one module beside the others. Fields of tasks,
`Config` and metrics are keys of files: keep their names. Begin with `envs/task.py`, then
`tasks/drive_to_goal.py`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.train.baselines import BASELINES as BASELINES
    from usarmjx.train.envs.env import Env as Env
    from usarmjx.train.envs.presence import Presence as Presence
    from usarmjx.train.envs.recipe import SPLITS as SPLITS
    from usarmjx.train.envs.recipe import GeneratedArenas as GeneratedArenas
    from usarmjx.train.envs.recipe import Split as Split
    from usarmjx.train.envs.recipe import open_floor as open_floor
    from usarmjx.train.envs.state import AgentGroup as AgentGroup
    from usarmjx.train.envs.state import EnvState as EnvState
    from usarmjx.train.envs.task import Policy as Policy
    from usarmjx.train.envs.task import StepResult as StepResult
    from usarmjx.train.envs.task import Task as Task
    from usarmjx.train.envs.task import TaskView as TaskView
    from usarmjx.train.envs.task import drive_all as drive_all
    from usarmjx.train.envs.task import drive_keys as drive_keys
    from usarmjx.train.evaluation.evaluate import Episodes as Episodes
    from usarmjx.train.evaluation.evaluate import Evaluation as Evaluation
    from usarmjx.train.evaluation.evaluate import evaluate as evaluate
    from usarmjx.train.evaluation.evaluate import evaluate_episodes as evaluate_episodes
    from usarmjx.train.learning.config import Config as Config
    from usarmjx.train.learning.seed_runs import train_seeds as train_seeds
    from usarmjx.train.learning.trainer import TrainResult as TrainResult
    from usarmjx.train.learning.trainer import train as train
    from usarmjx.train.make import make_task as make_task
    from usarmjx.train.policies import POLICIES as POLICIES
    from usarmjx.train.policies.export import export_run as export_run
    from usarmjx.train.policies.policy_file import NumpyPolicy as NumpyPolicy
    from usarmjx.train.policies.sources import PolicySource as PolicySource
    from usarmjx.train.policies.sources import load_policy as load_policy
    from usarmjx.train.tasks import TASKS as TASKS
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.train.baselines": ("BASELINES",),
            "usarmjx.train.envs.env": ("Env",),
            "usarmjx.train.envs.presence": ("Presence",),
            "usarmjx.train.envs.recipe": ("GeneratedArenas", "SPLITS", "Split", "open_floor"),
            "usarmjx.train.envs.state": ("AgentGroup", "EnvState"),
            "usarmjx.train.envs.task": (
                "Policy",
                "StepResult",
                "Task",
                "TaskView",
                "drive_all",
                "drive_keys",
            ),
            "usarmjx.train.evaluation.evaluate": ("Episodes", "Evaluation", "evaluate", "evaluate_episodes"),
            "usarmjx.train.learning.config": ("Config",),
            "usarmjx.train.learning.seed_runs": ("train_seeds",),
            "usarmjx.train.learning.trainer": ("TrainResult", "train"),
            "usarmjx.train.make": ("make_task",),
            "usarmjx.train.policies": ("POLICIES",),
            "usarmjx.train.policies.export": ("export_run",),
            "usarmjx.train.policies.policy_file": ("NumpyPolicy",),
            "usarmjx.train.policies.sources": ("PolicySource", "load_policy"),
            "usarmjx.train.tasks": ("TASKS",),
        },
    )
