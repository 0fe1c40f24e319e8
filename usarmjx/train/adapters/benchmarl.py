"""BenchMARL: tasks that its experiments and benchmarks take, over `TorchWorlds`."""

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from usarmjx.base.errors import MissingExtraError
from usarmjx.train.adapters.agents import BINS

# Untyped here, as in `torchrl`. No extra of ours: it asks for an older TorchRL than the extra of that name.
try:
    TaskClass: Any = import_module("benchmarl.environments").TaskClass
except ModuleNotFoundError as error:
    raise MissingExtraError(
        f"this needs {error.name}: pip install benchmarl, in an environment without the extra torchrl"
    ) from error
from usarmjx.train.adapters.torchrl import TorchWorlds, specs
from usarmjx.train.make import make, make_task
from usarmjx.train.task_names import newest_name


class BenchmarlTask(TaskClass):
    """A task as BenchMARL's `TaskClass`: `Experiment(task=BenchmarlTask("relay-chain"), ...)`.

    Each class of robots is a group. Worlds are one batch; actions are continuous, or a grid for algorithms
    that choose. Centralised critics and mixers see the observations of all robots and what only critics may
    know. Algorithms take robots that are not alive (`Task.presence`) for ones that see nothing and get no
    reward.

    Args:
        name: Name of the task, as for `make`.
        config: Overrides of the task's fields, and `engine`, by default `auto`, and `bins`, the values of
            each action where actions are discrete.

    Raises:
        UnknownNameError: No such task, or a field that it does not have; lists those there are.
    """

    def __init__(self, name: str, config: Mapping[str, Any] | None = None) -> None:
        name, settings = newest_name(name), dict(config or {})
        # BenchMARL uses the name for files.
        filed = name.replace("/", "_").replace(":", "_")
        super().__init__(name=filed, config=settings)  # pyright: ignore[reportUnknownMemberType]
        self._task = name
        # Refuses wrong settings now, not when an experiment begins.
        self._worlds_settings()

    def _worlds_settings(self) -> tuple[str, int, dict[str, Any]]:
        """Return the engine, the values of discrete actions, and the overrides of the task."""
        # A copy: two names are taken out, which BenchMARL keeps in its own.
        fields = dict(self.config)
        engine, bins = fields.pop("engine", "auto"), fields.pop("bins", BINS)
        # Made only to be checked: the worlds make their own.
        make_task(self._task, **fields)
        return engine, bins, fields

    def get_env_fun(
        self,
        num_envs: int,
        continuous_actions: bool,
        seed: int | None,
        device: Any,  # noqa: ANN401 - as PyTorch takes it
    ) -> Callable[[], TorchWorlds]:
        """Return a function that makes the worlds.

        Args:
            num_envs: Number of worlds.
            continuous_actions: Whether actions are numbers from -1 to 1; else choices from a grid.
            seed: Of the first episode; None: 0.
            device: Device of the tensors.
        """

        def make_worlds() -> TorchWorlds:
            engine, bins, fields = self._worlds_settings()
            env = make(self._task, num_envs, engine, **fields)
            actions = "continuous" if continuous_actions else "discrete"
            return TorchWorlds(env, seed or 0, device, actions=actions, bins=bins, joint_state=True)

        return make_worlds

    def supports_continuous_actions(self) -> bool:
        """Return that there are such actions."""
        return True

    def supports_discrete_actions(self) -> bool:
        """Return that there are such actions."""
        return True

    def max_steps(self, env: Any) -> int:  # noqa: ANN401 - TorchWorlds in any wrappers
        """Return the steps of an episode at most."""
        return env.env.episode_steps

    def has_render(self, env: Any) -> bool:  # noqa: ANN401
        """Return that there are pictures: of the first world, from above."""
        return True

    def group_map(self, env: Any) -> dict[str, list[str]]:  # noqa: ANN401
        """Return the names of the robots by group."""
        return env.group_map

    def observation_spec(self, env: Any) -> Any:  # noqa: ANN401
        """Return what robots observe, by group."""
        known = env.full_observation_spec_unbatched
        parts = {
            group: specs.Composite(
                {"observation": known[group, "observation"].clone()}, shape=known[group].shape
            )
            for group in env.group_map
        }
        return specs.Composite(parts)

    def info_spec(self, env: Any) -> None:  # noqa: ANN401
        """Return nothing: infos are of worlds, and BenchMARL logs them by itself."""

    def state_spec(self, env: Any) -> Any:  # noqa: ANN401
        """Return what centralised critics see."""
        return specs.Composite({"state": env.full_observation_spec_unbatched["state"].clone()})

    def action_spec(self, env: Any) -> Any:  # noqa: ANN401
        """Return what robots may do, by group."""
        return env.full_action_spec_unbatched

    def action_mask_spec(self, env: Any) -> None:  # noqa: ANN401
        """Return nothing: all actions are allowed."""

    @staticmethod
    def env_name() -> str:
        """Return the name under which BenchMARL files results."""
        return "usarmjx"
