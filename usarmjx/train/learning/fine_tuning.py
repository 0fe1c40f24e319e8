"""Fine-tuning: a new run that begins with the networks of another one, on any engine.

It takes over the weights of policies and critics, and the statistics that observations and returns are
normalised by; not the optimiser's moments, the learning rate, the worlds, and the number of steps.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from usarmjx.base.errors import UsageError
from usarmjx.train.envs.env import AgentGroup
from usarmjx.train.learning.checkpoint import Checkpoints, load_train_state
from usarmjx.train.learning.config import Config, RunRecord
from usarmjx.train.learning.ppo import initial_adaptive_rate
from usarmjx.train.learning.train_state import Networks, TrainState

SHAPE_SETTINGS = (
    *("hidden_sizes", "critic_hidden_sizes", "gru_size", "shared_policy", "network"),
    *("normalize_obs", "normalize_values"),
)
"""Settings that shape networks: those of the source are the defaults of the new run."""
EXPORTED_NOTE = (
    "an exported policy has neither critic nor statistics that could go on: name the folder of a run"
)


@dataclass(frozen=True, kw_only=True)
class TrainedNetworks:
    """Networks of a run's checkpoint, to begin another run with.

    Attributes:
        run: Folder of the run.
        record: Record of the run.
        networks: Their shapes.
        train_state: Their weights and statistics, beside what is not taken over.
        meta: Facts of the checkpoint, see `Checkpoints.meta`.
    """

    run: Path
    record: RunRecord
    networks: Networks
    train_state: TrainState
    meta: dict[str, Any]

    @property
    def settings(self) -> dict[str, Any]:
        """Default settings of a run that begins with these; it imitates no teacher."""
        return {**{name: getattr(self.record.config, name) for name in SHAPE_SETTINGS}, "imitation_steps": 0}

    @property
    def origin(self) -> dict[str, Any]:
        """Origin of the networks for the record of the new run, as JSON has it."""
        return {
            "run": str(self.run),
            "checkpoint": self.meta["iteration"],
            "agent_steps": self.meta["agent_steps"],
            "task": self.record.task,
            "engine": self.record.engine,
            "overrides": self.record.overrides,
        }

    def describe(self) -> str:
        """Return in a line where they come from."""
        return (
            f"begins with checkpoint {self.meta['iteration']} of {self.run}: {self.record.task} on engine "
            f"{self.record.engine}, {self.meta['agent_steps']:,} agent steps"
        )

    def check(self, networks: Networks) -> None:
        """Refuse networks that cannot begin as these are.

        Raises:
            UsageError: Names all that differs.
        """
        pairs = {
            "robots": (_agents(self.networks.groups), _agents(networks.groups)),
            "numbers that only critics see": (self.networks.privileged_size, networks.privileged_size),
            "hidden_sizes": (self.networks.policy.layers, networks.policy.layers),
            "critic_hidden_sizes": (self.networks.critic_layers, networks.critic_layers),
            "gru_size": (self.networks.policy.memory, networks.policy.memory),
            "shared_policy": (self.networks.shared, networks.shared),
            "network": (self.networks.policy.kind, networks.policy.kind),
        }
        if off := [f"{what}: {old} -> {new}" for what, (old, new) in pairs.items() if old != new]:
            raise UsageError(f"networks of {self.run} do not fit: {'; '.join(off)}")

    def begin(self, fresh: TrainState, config: Config) -> TrainState:
        """Return a train state before its first update, with these networks in it.

        Args:
            fresh: Train state of networks that passed `check`.
            config: Settings of the new run. An adaptive learning rate begins low, see
                `initial_adaptive_rate`: that of a random network would change a trained one by more than is
                wanted.
        """
        own, rate = self.train_state, fresh.learning_rate
        return fresh.replace(
            # After an imitation `begin_update` lowers the rate itself.
            learning_rate=rate if config.imitation_steps else initial_adaptive_rate(rate, config),
            params=own.params,
            obs_statistics=own.obs_statistics,
            privileged_statistics=own.privileged_statistics,
            return_statistics=own.return_statistics,
        )


def _agents(groups: tuple[AgentGroup, ...]) -> str:
    """Return the number of robots of each class and their sizes of observations and actions, as text."""
    return ", ".join(
        f"{len(one.agents)} {one.name} that see {one.obs_size} and do {one.action_size}" for one in groups
    )


def load_trained(run: str | Path, which: str = "best") -> TrainedNetworks:
    """Return the networks of a run.

    Args:
        run: Its folder.
        which: Checkpoint: `best`, `last`, or the number of an iteration.

    Raises:
        UsageError: No run but a policy's file or name, no such checkpoint, or a broken one.
    """
    run = Path(run)
    if not run.is_dir():
        raise UsageError(f"{run} is no folder of a run; {EXPORTED_NOTE}")
    networks, train_state, record = load_train_state(run, which)
    checkpoints = Checkpoints(run)
    return TrainedNetworks(
        run=run,
        record=record,
        networks=networks,
        train_state=train_state,
        meta=checkpoints.meta(checkpoints.find(which)),
    )


def check_source(checkpoints: Checkpoints, record: RunRecord, source: TrainedNetworks | None) -> None:
    """Check that a run that began with other networks has checkpoints, and that a new one has none.

    Raises:
        UsageError: Says what to do.
    """
    # A resumed run would silently go on from its own checkpoint, not from the source.
    if source is not None and checkpoints.all():
        raise UsageError(f"{checkpoints.run} has checkpoints already: choose another folder")
    if source is None and record.began_with is not None and not checkpoints.all():
        raise UsageError(
            f"the run in {checkpoints.run} was stopped before it had kept the networks that it was to begin "
            f"with, those of {record.began_with['run']}: delete the folder and start it again"
        )
