"""TorchRL: all worlds as one `EnvBase`, whose tensors are the environment's own arrays, by DLPack."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.errors import UsageError, extra
from usarmjx.train.adapters.agents import BINS, Actions, action_grids, picture_of

# Untyped here: the extra is large, and checks of types run without it.
with extra("torchrl"):
    torch: Any = import_module("torch")
    EnvBase: Any = import_module("torchrl.envs").EnvBase
    specs: Any = import_module("torchrl.data")
    TensorDict: Any = import_module("tensordict").TensorDict

if TYPE_CHECKING:
    from usarmjx.train.envs.env import Env, EnvState


class TorchWorlds(EnvBase):
    """An environment as a `torchrl.envs.EnvBase` whose batch is its worlds: batch_size (worlds,).

    Robots of one class are a group, named like the class, as TorchRL has groups of agents: (group,
    "observation") (worlds, robots, obs_size), (group, "action") (worlds, robots, action_size), (group,
    "reward") (worlds, robots, 1), and in tasks with `Task.presence` (group, "mask") (worlds, robots), whose
    robots are alive. Of a world are `done`, `terminated`, `truncated` and `fault` (worlds, 1), `state`, which
    only critics may know (worlds, privileged_size), and `info` with the task's metrics and `score`
    (worlds, 1). A fault is truncated, not terminated.

    Worlds do not restart by themselves: TorchRL resets those that are done, and any others that it is asked
    to. A reset begins a world's next episode; the first one of all worlds after a new seed begins at its
    first.

    On the device of the environment's arrays no tensor is a copy. They must not be written to.

    Args:
        env: The environment.
        seed: Of the first episode.
        device: Device of the tensors; None: that of the environment's arrays.
        actions: `continuous`, or `discrete`: (group, "action") (worlds, robots) are numbers of points of the
            robot's `ActionGrid`.
        bins: Values of each action, where they are discrete.
        joint_state: Whether `state` begins with the observations of all robots, one after the other, group by
            group; then it is a copy.

    Raises:
        UsageError: Unknown actions, or too many of them.
    """

    def __init__(
        self,
        env: "Env",
        seed: int = 0,
        device: Any = None,  # noqa: ANN401 - as PyTorch takes it
        *,
        actions: Actions = "continuous",
        bins: int = BINS,
        joint_state: bool = False,
    ) -> None:
        grids = action_grids(env.groups, actions, bins)
        # Before the base class, which needs the device: where arrays are is known from a state only.
        start = env.reset(seed)
        arrays_at = torch.from_dlpack(start.reward[0]).device
        placed = arrays_at if device is None else device
        super().__init__(device=placed, batch_size=[env.worlds])  # pyright: ignore[reportUnknownMemberType]
        self.env, self._arrays_at, self._grids = env, arrays_at, grids
        self._joint_state = joint_state
        # A copy: on the CPU the tensor would share the memory of the grid's cached points.
        self._points = [torch.from_numpy(grid.points.copy()).to(arrays_at) for grid in grids or ()]
        self._start: EnvState | None = start
        self._state = start
        self._make_specs()

    @property
    def group_map(self) -> dict[str, list[str]]:
        """Names of the robots by group."""
        return {group.name: list(group.agents) for group in self.env.groups}

    def _make_specs(self) -> None:
        worlds, state = self.env.worlds, self._state

        def spec(kind: Any, *shape: int, **more: Any) -> Any:  # noqa: ANN401
            return kind(shape=(worlds, *shape), device=self.device, **more)

        def flag(*shape: int) -> Any:  # noqa: ANN401
            return spec(specs.Categorical, *shape, n=2, dtype=torch.bool)

        seen: dict[str, Any] = {"fault": flag(1)}
        info = {name: spec(specs.Unbounded, 1) for name in ("score", *state.metrics)}
        seen["info"] = specs.Composite(info, shape=(worlds,), device=self.device)
        if size := self._critics_state().shape[-1]:
            seen["state"] = spec(specs.Unbounded, size)
        acts, rewards = dict[str, Any](), dict[str, Any]()
        for g, group in enumerate(self.env.groups):
            robots = len(group.agents)

            # Bound as a default: a closure would see the loop's variable, not its value now.
            def grouped(entries: dict[str, Any], robots: int = robots) -> Any:  # noqa: ANN401
                return specs.Composite(entries, shape=(worlds, robots), device=self.device)

            parts = {"observation": spec(specs.Unbounded, robots, group.obs_size)}
            if state.alive is not None:
                parts["mask"] = flag(robots)
            seen[group.name] = grouped(parts)
            if self._grids is None:
                action = spec(specs.Bounded, robots, group.action_size, low=-1.0, high=1.0)
            else:
                action = spec(specs.Categorical, robots, n=self._grids[g].choices, dtype=torch.int64)
            acts[group.name] = grouped({"action": action})
            rewards[group.name] = grouped({"reward": spec(specs.Unbounded, robots, 1)})
        whole = {"shape": (worlds,), "device": self.device}
        self.observation_spec = specs.Composite(seen, **whole)
        self.action_spec = specs.Composite(acts, **whole)
        self.reward_spec = specs.Composite(rewards, **whole)
        ends = {name: flag(1) for name in ("done", "terminated", "truncated")}
        self.done_spec = specs.Composite(ends, **whole)

    def _tensor(self, array: Array) -> Any:  # noqa: ANN401
        """Return an array as a tensor."""
        # DLPack shares memory between JAX and PyTorch: no copy on the same device.
        return torch.from_dlpack(array).to(self.device)

    def _critics_state(self) -> Array:
        """Return what critics see of the present state (worlds, n)."""
        now = self._state
        if not self._joint_state:
            return now.privileged
        rows = [seen.reshape(self.env.worlds, -1) for seen in (*now.obs, now.privileged)]
        return jnp.concatenate(rows, -1)

    def _seen(self) -> Any:  # noqa: ANN401
        """Return what there is to see of the present state, a TensorDict (worlds,)."""
        now = self._state
        info = {name: self._tensor(value)[:, None] for name, value in now.metrics.items()}
        info["score"] = self._tensor(now.score)[:, None]
        seen: dict[str, Any] = {"info": TensorDict(info, batch_size=self.batch_size)}
        if (state := self._critics_state()).shape[-1]:
            seen["state"] = self._tensor(state)
        for g, group in enumerate(self.env.groups):
            parts = {"observation": self._tensor(now.obs[g])}
            if now.alive is not None:
                parts["mask"] = self._tensor(now.alive[g])
            seen[group.name] = TensorDict(parts, batch_size=[*self.batch_size, len(group.agents)])
        return TensorDict(seen, batch_size=self.batch_size, device=self.device)

    def _reset(self, tensordict: Any = None, **_: Any) -> Any:  # noqa: ANN401
        """Begin an episode in the worlds that `_reset` of a TensorDict marks; without one in all."""
        mask = None if tensordict is None else tensordict.get("_reset", None)
        if mask is None or bool(mask.all()):
            where = np.ones(self.env.worlds, bool)
            # The state made for the specs, or by a new seed, is a first episode that nobody has played.
            if self._start is not None:
                self._state, self._start = self._start, None
            else:
                self._state = self.env.restart(self._state, where)
        else:
            where = mask.reshape(-1).cpu().numpy()
            self._state = self.env.restart(self._state, where)
        seen = self._seen()
        # A reset of some worlds returns all; the others keep their ends.
        others = torch.from_numpy(~where).to(self.device)[:, None]
        for name, value in self._ends().items():
            seen[name] = value & others
        return seen

    def _ends(self) -> dict[str, Any]:
        """Return which worlds are at the end of their episode, and why."""
        done, late, bad = (
            self._tensor(one)[:, None] for one in (self._state.done, self._state.truncated, self._state.bad)
        )
        # A fault says nothing about the task, so it cuts the episode off.
        truncated = late | bad
        return {"done": done, "terminated": done & ~truncated, "truncated": truncated, "fault": bad}

    def _step(self, tensordict: Any) -> Any:  # noqa: ANN401
        """Let all robots act."""
        actions = [
            self._array(tensordict[group.name, "action"], g) for g, group in enumerate(self.env.groups)
        ]
        self._state, self._start = self.env.advance(self._state, tuple(actions)), None
        seen = self._seen()
        for g, group in enumerate(self.env.groups):
            # TorchRL's rewards have a last axis of one number.
            seen[group.name, "reward"] = self._tensor(self._state.reward[g])[..., None]
        return seen.update(self._ends())

    def _array(self, action: Any, g: int) -> Array:  # noqa: ANN401
        """Return a group's actions as an array (worlds, robots, action_size)."""
        # DLPack refuses tensors that need a gradient, and JAX wants contiguous ones of 32 bits.
        values = action.detach().to(self._arrays_at)
        if self._grids is not None:
            choices = self._grids[g].choices
            # PyTorch counts negative indices from the end, and on a GPU one too large ruins the whole CUDA
            # context.
            if bool(((values < 0) | (values >= choices)).any()):
                name = self.env.groups[g].name
                raise UsageError(f"discrete actions of {name}: allowed are 0 to {choices - 1}")
            values = self._points[g][values]
        return jnp.from_dlpack(values.to(torch.float32).contiguous())

    def _set_seed(self, seed: int | None) -> None:
        """Begin anew with the next reset of all worlds, from this seed; None: go on."""
        if seed is not None:
            self._start = self.env.reset(seed)

    def render(self, world: int = 0) -> np.ndarray:
        """Return a picture of a world from above (height, width, 3)."""
        return picture_of(self.env, self._state, world)
