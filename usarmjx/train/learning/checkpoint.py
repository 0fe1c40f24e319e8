"""Checkpoints: all that a run needs to go on as if it had never stopped.

`checkpoints/00000020/` holds the train state after 20 iterations (`learner`) and the rollout states of all
processes (`worlds`), both in orbax's format, lists of what each process put there with checksums, and
`meta.json`. It is written under another name and renamed when it is complete, so whatever has that name is
whole.
"""

import json
import logging
import os
import shutil
import zlib
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeGuard, cast

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.arrays import Array
from usarmjx.base.errors import UsageError, UsarmjxError, WriteError, extra
from usarmjx.base.files import PARTIAL, disk_fault, write_beside, writing
from usarmjx.train.envs.env import AgentGroup, Env
from usarmjx.train.learning.config import Config, differences, from_record
from usarmjx.train.learning.networks import LearnedPolicy, PolicyParams
from usarmjx.train.learning.processes import ProcessGroup, Tree
from usarmjx.train.learning.train_state import (
    Networks,
    TrainState,
    make_networks,
    make_train_state,
    policy_params,
)
from usarmjx.train.learning.trajectory import RolloutState

RECORD_FILE = "config.json"
CONFIG_FORMAT = 1
PACKAGES = ("jax", "jaxlib", "flax", "optax", "brax", "mujoco", "mujoco-mjx", "numpy")
MAY_CHANGE = ("steps", "keep", "checkpoint_every")
"""Settings that may be other ones when a run is resumed."""
FIXED = ("task", "engine", "overrides", "groups", "privileged_size", "episode_steps", "processes")


@dataclass(frozen=True)
class EnvArguments:
    """What an environment was made with; see `make`.

    Attributes:
        engine: As asked for.
        overrides: Fields of the task that were set otherwise, as typed: `config.parse_settings` reads them.
    """

    engine: str = "auto"
    overrides: dict[str, str] = field(default_factory=dict[str, str])


DEFAULT_ENV_ARGUMENTS = EnvArguments()


@dataclass(frozen=True, kw_only=True)
class RunRecord:
    """What a run was started with.

    Attributes:
        task: Name of the environment.
        engine: As asked for.
        overrides: Fields of the task that were set otherwise, as typed.
        groups: The agents.
        privileged_size: Numbers that only critics see.
        episode_steps: Steps of an episode at most.
        period: Simulated time of a step [s].
        processes: How many trained together.
        config: All settings.
        versions: Of the packages that results depend on.
        began_with: Run and checkpoint whose networks it began with, see `TrainedNetworks.origin`; None: with
            random ones.
    """

    task: str
    engine: str = "auto"
    overrides: dict[str, str] = field(default_factory=dict[str, str])
    groups: tuple[AgentGroup, ...]
    privileged_size: int
    episode_steps: int
    period: float
    processes: int
    config: Config
    versions: dict[str, str] = field(default_factory=dict[str, str])
    began_with: dict[str, Any] | None = None

    def save(self, folder: Path) -> None:
        """Write the record into a folder.

        Raises:
            WriteError: It cannot be written to.
        """
        text = json.dumps({"format": CONFIG_FORMAT, **asdict(self)}, indent=1)
        with write_beside(folder / RECORD_FILE) as fresh:
            fresh.write_text(text + "\n")

    def check_resumes(self, old: "RunRecord", folder: Path) -> None:
        """Refuse to go on with a run that was started as another one.

        Raises:
            UsageError: Says what differs.
        """
        changed = differences(old.config, self.config, but=MAY_CHANGE)
        for name in FIXED:
            before, now = _plain(getattr(old, name)), _plain(getattr(self, name))
            if before != now:
                changed.append(f"{name}: {before} -> {now}")
        if changed:
            raise UsageError(f"the run in {folder} was started otherwise: {'; '.join(changed)}")


def _plain(value: Any) -> Any:  # noqa: ANN401 - anything that JSON can hold
    """Return a value as it is after writing and reading."""
    if isinstance(value, tuple):
        items = cast(tuple[Any, ...], value)
        value = [asdict(one) if isinstance(one, AgentGroup) else one for one in items]
    return json.loads(json.dumps(value))


def make_record(
    env: Env, config: Config, processes: int, origin: EnvArguments = DEFAULT_ENV_ARGUMENTS
) -> RunRecord:
    """Return the record of a run."""
    return RunRecord(
        task=env.name,
        engine=origin.engine,
        overrides=origin.overrides,
        groups=tuple(AgentGroup(g.name, tuple(g.agents), g.obs_size, g.action_size) for g in env.groups),
        privileged_size=env.privileged_size,
        episode_steps=env.episode_steps,
        period=env.period,
        processes=processes,
        config=config,
        versions={name: version(name) for name in PACKAGES},
    )


def load_record(folder: Path) -> RunRecord:
    """Return the record of a run.

    Raises:
        UsageError: There is none, or it does not read.
    """
    file = Path(folder) / RECORD_FILE
    if not file.is_file():
        raise UsageError(f"{folder} is no run: it has no {RECORD_FILE}")
    try:
        values = json.loads(file.read_text())
        if values.pop("format") != CONFIG_FORMAT:
            raise UsageError(f"{file} was written by another version of usarmjx")
        values["config"] = from_record(values["config"])
        groups: list[dict[str, Any]] = [{**one, "agents": tuple(one["agents"])} for one in values["groups"]]
        values["groups"] = tuple(AgentGroup(**one) for one in groups)
        return RunRecord(**values)
    except (json.JSONDecodeError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(f"{file} does not read: {error}") from error


with extra("train"):
    import orbax.checkpoint as ocp

FOLDER = "checkpoints"
FORMAT = 2
"""Raised whenever a field of what is kept is renamed, added or taken away: leaves are found by these
names."""
FULL = "at full difficulty"
"""The kind of a score that was measured with all arenas in play, on fixed seeds."""
ROOM_PER_ARRAY = 3072
"""What orbax writes of an array besides its numbers: 1 kB, and the rest of a block on the disk [bytes]."""


def _is_key(leaf: object) -> TypeGuard[jax.Array]:
    return isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _arrays(tree: object) -> dict[str, np.ndarray]:
    """Return a tree's leaves by their path, as NumPy arrays; random keys as their numbers."""
    leaves = jax.tree.flatten_with_path(tree)[0]
    plain = [(path, jax.random.key_data(leaf) if _is_key(leaf) else leaf) for path, leaf in leaves]
    return {"".join(map(str, path)): np.asarray(leaf) for path, leaf in plain}


def _described(arrays: dict[str, np.ndarray]) -> list[list[Any]]:
    return [[path, list(array.shape), str(array.dtype)] for path, array in arrays.items()]


def _checksum(array: np.ndarray) -> int:
    return zlib.crc32(np.ascontiguousarray(array).tobytes())


def _flat(array: np.ndarray) -> np.ndarray:
    """Return the same bits in a row, in a type that JAX has: it halves 64-bit numbers otherwise."""
    row = np.ascontiguousarray(array).reshape(-1)
    return row.view(np.uint32) if row.itemsize == 8 else row


def _write(folder: Path, name: str, tree: object, process_group: ProcessGroup) -> None:
    """Write what this process has of a tree; all processes do, into one array with a row of each."""
    arrays = _arrays(tree)
    rows = {f"{i:05d}": _flat(array)[None] for i, array in enumerate(arrays.values()) if array.size}
    with ocp.Checkpointer(ocp.PyTreeCheckpointHandler()) as saver:
        saver.save(
            (folder / name).absolute(), process_group.to_global(jax.device_put(rows, process_group.device), 0)
        )
    content = {"leaves": _described(arrays), "checksums": [_checksum(array) for array in arrays.values()]}
    with write_beside(folder / f"{name}_{process_group.index}.json") as file:
        file.write_text(json.dumps(content))


def _write_parts(folder: Path, parts: Mapping[str, object], process_group: ProcessGroup) -> None:
    """Write all parts.

    Raises:
        WriteError: A disk refused.
        UsarmjxError: It refused one of several processes; the others wait for what that one cannot write.
    """
    try:
        with _quiet():
            for name, tree in parts.items():
                _write(folder, name, tree, process_group)
    except Exception as error:  # the libraries below have errors of their own for a full disk
        reason = disk_fault(error) or (error.strerror if isinstance(error, OSError) else None)
        if reason is None:
            raise
        kind = WriteError if process_group.count == 1 else UsarmjxError
        raise kind(f"cannot write {folder}: {reason}") from error


@contextmanager
def _quiet() -> Generator[None]:
    """Keep orbax from logging, with traces, what it raises as well."""
    log, rule = logging.getLogger("absl"), _is_no_error
    log.addFilter(rule)
    try:
        yield
    finally:
        log.removeFilter(rule)


def _is_no_error(record: logging.LogRecord) -> bool:
    return record.levelno < logging.ERROR


def _reserve(file: Path, parts: Mapping[str, object]) -> None:
    """Take the room on the disk that these parts will need, so that nothing is begun that does not fit.

    Halfway several processes could not stop: some would wait for what others cannot write.
    """
    sizes = [array.nbytes for tree in parts.values() for array in _arrays(tree).values()]
    with file.open("wb") as room:
        if hasattr(os, "posix_fallocate"):  # not on macOS
            os.posix_fallocate(room.fileno(), 0, sum(sizes) + ROOM_PER_ARRAY * len(sizes))


def _read(folder: Path, name: str, wanted: dict[str, np.ndarray], index: int) -> list[np.ndarray]:
    """Return the arrays that a process put there; what has no elements was not written, and is as wanted."""
    as_numpy = {
        f"{i:05d}": ocp.RestoreArgs(restore_type=np.ndarray)
        for i, array in enumerate(wanted.values())
        if array.size
    }
    with ocp.Checkpointer(ocp.PyTreeCheckpointHandler()) as reader:
        path, how = (folder / name).absolute(), ocp.args.PyTreeRestore(restore_args=as_numpy)
        rows = reader.restore(path, args=how)
    return [
        np.array(rows[f"{i:05d}"][index]).view(array.dtype).reshape(array.shape) if array.size else array
        for i, array in enumerate(wanted.values())
    ]


def read_part(folder: Path, name: str, template: Tree, index: int = 0) -> Tree:
    """Return a part of a checkpoint.

    Args:
        folder: The checkpoint.
        name: `learner` or `worlds`.
        template: A tree of the same shapes; its leaves also say what is NumPy's and what is JAX's.
        index: Of the process whose part it is.

    Raises:
        UsageError: The checkpoint is broken, or of something else.
    """
    wanted = _arrays(template)
    try:
        content = json.loads((folder / f"{name}_{index}.json").read_text())
        there, checksums = content["leaves"], content["checksums"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise UsageError(
            f"checkpoint {folder} is broken: {name}_{index}.json does not read: {error}"
        ) from error
    if there != _described(wanted):
        raise UsageError(f"checkpoint {folder} is of another run: {_misfit(there, _described(wanted))}")
    try:
        found = _read(folder, name, wanted, index)
    except Exception as error:  # whatever a damaged file makes the reader do
        raise UsageError(
            f"checkpoint {folder} is broken: {name} does not read; delete it: {error}"
        ) from error
    for path, array, checksum in zip(wanted, found, checksums, strict=True):
        if _checksum(array) != checksum:
            raise UsageError(f"checkpoint {folder} is broken: {name}{path} has another checksum; delete it")
    leaves, shape = jax.tree.flatten(template)
    return jax.tree.unflatten(shape, [_like(leaf, one) for leaf, one in zip(leaves, found, strict=True)])


def _like(leaf: object, array: np.ndarray) -> Array:
    """Return an array as what the leaf is."""
    if _is_key(leaf):
        random: Any = jax.random  # jax leaves the result of this without a type
        return random.wrap_key_data(jnp.asarray(array), impl=jax.random.key_impl(leaf))
    return jnp.asarray(array) if isinstance(leaf, jax.Array) else np.array(array)


def _misfit(there: list[list[Any]], wanted: list[list[Any]]) -> str:
    for one, other in zip(there, wanted, strict=False):
        if one != other:
            return f"it holds {one}, expected {other}"
    return f"it holds {len(there)} arrays, expected {len(wanted)}"


class Checkpoints:
    """The checkpoints of a run.

    Args:
        run: Folder of the run.
        process_group: All processes; None: only this one, to read.
        keep: Latest ones that are kept; the best one is kept too.
    """

    def __init__(self, run: Path, process_group: ProcessGroup | None = None, keep: int = 1) -> None:
        self.run, self.folder = Path(run), Path(run) / FOLDER
        self.process_group, self.keep = process_group, keep

    def all(self) -> list[Path]:
        """Return all that are whole, the oldest first."""
        return sorted(p for p in self.folder.glob("*") if p.name.isdecimal() and p.is_dir())

    def find(self, which: str = "last") -> Path:
        """Return a checkpoint: `last`, `best`, or the number of an iteration.

        Raises:
            UsageError: No such one; lists those there are.
        """
        there = self.all()
        known = ", ".join(str(int(path.name)) for path in there) or "none"
        if which == "last" and there:
            return there[-1]
        if which == "best" and there:
            return max(there, key=self._rank)
        for path in there:
            if which.isdecimal() and int(path.name) == int(which):
                return path
        raise UsageError(
            f"no checkpoint {which!r} in {self.folder}; there are: {known}, besides last and best"
        )

    def meta(self, path: Path) -> dict[str, Any]:
        """Return what is said of a checkpoint: `iteration`, `agent_steps`, `score`, `processes`.

        Raises:
            UsageError: It is broken, or was written by another version.
        """
        try:
            meta = json.loads((path / "meta.json").read_text())
            if meta["format"] != FORMAT:
                raise UsageError(
                    f"checkpoint {path} was written by another version of usarmjx (format {meta['format']}, "
                    f"this one reads {FORMAT}): go on with that version; policies exported with it still load"
                )
            if meta["iteration"] != int(path.name):
                raise UsageError(f"checkpoint {path} is of iteration {meta['iteration']}: it was renamed")
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise UsageError(f"checkpoint {path} is broken: meta.json does not read: {error}") from error
        return meta

    def _rank(self, path: Path) -> tuple[bool, float, str]:
        """Return what checkpoints are compared by: those whose score is of full difficulty come first."""
        meta = self.meta(path)
        score = meta["score"]
        # Whoever wrote no kind had no curriculum, or did not look.
        return meta.get("kind") == FULL, float("-inf") if score is None else score, path.name

    def describe(self, which: str) -> str:
        """Return in a line which checkpoint that is, and why: for whoever plays it.

        Raises:
            UsageError: See `find` and `meta`.
        """
        path, there = self.find(which), self.all()
        meta = self.meta(path)
        score = "none" if meta["score"] is None else f"{meta['score']:.4g}"
        kind = meta.get("kind", "in training")
        why = {"best": f"the best by score {kind}", "last": "the last"}.get(which, "as asked for")
        others = ", ".join(str(int(one.name)) for one in there if one != path) or "no others"
        return (
            f"checkpoint {meta['iteration']} of {self.run}, {why}: {score} after {meta['agent_steps']:,} "
            f"agent steps (there are: {others})"
        )

    def save(
        self, iteration: int, train_state: TrainState, worlds: RolloutState, note: dict[str, Any]
    ) -> None:
        """Write a checkpoint, unless there is one of that iteration, and drop old ones; all processes do.

        Args:
            iteration: After which.
            train_state: The same in all processes.
            worlds: Of this process.
            note: For `meta`; must have `score`, a number or None, and may have `kind`, what score that is.

        Raises:
            WriteError: In all processes; nothing of it is left, and the earlier ones are whole.
            UsarmjxError: Only in this one of several processes, which cannot go on.
        """
        process_group, place = self.process_group or ProcessGroup(), self.folder / f"{iteration:08d}"
        if place.exists():
            return
        parts: dict[str, object] = {"learner": train_state, "worlds": worlds}
        meta = {"format": FORMAT, "iteration": iteration, "processes": process_group.count, **note}
        fresh = place.with_name(place.name + PARTIAL)
        room = fresh / f"room_{process_group.index}"
        steps = (
            partial(self._begin, fresh, process_group),
            partial(_reserve, room, parts),
            room.unlink,
            partial(_write_parts, fresh, parts, process_group),
            partial(self._finish, fresh, meta, process_group),
        )
        try:
            for step in steps:
                self._together(place, step, process_group)
        except WriteError:
            if process_group.index == 0:
                shutil.rmtree(fresh, ignore_errors=True)
            raise

    def _begin(self, fresh: Path, process_group: ProcessGroup) -> None:
        if process_group.index == 0:
            shutil.rmtree(fresh, ignore_errors=True)
            fresh.mkdir(parents=True)

    def _finish(self, fresh: Path, meta: Mapping[str, Any], process_group: ProcessGroup) -> None:
        if process_group.index == 0:
            with write_beside(fresh / "meta.json") as file:
                file.write_text(json.dumps(meta))
            fresh.rename(fresh.with_name(fresh.name.removesuffix(PARTIAL)))
            self._drop_old()

    @staticmethod
    def _together(path: Path, step: Callable[[], None], process_group: ProcessGroup) -> None:
        """Do something in each process; where it fails in one, it has failed in all."""
        fault = None
        try:
            with writing(path):
                step()
        except WriteError as error:
            fault = error
        if not process_group.everywhere(fault is None):
            raise fault or WriteError(f"cannot write {path}: another process could not")

    def _drop_old(self) -> None:
        there = self.all()
        kept = {*there[-self.keep :], max(there, key=self._rank)}
        for path in (*(p for p in there if p not in kept), *self.folder.glob(f"*{PARTIAL}")):
            gone = path.with_name(path.name + PARTIAL) if path.name.isdecimal() else path
            if gone != path:
                with suppress(OSError):  # the next time will do
                    path.rename(gone)  # so that a half deleted one is not taken for a checkpoint
            shutil.rmtree(gone, ignore_errors=True)


def load_train_state(run: Path, which: str = "best") -> tuple[Networks, TrainState, RunRecord]:
    """Return the networks of a run, all that was learned, and what the run was started with.

    Args:
        run: Folder of the run.
        which: `best`, `last`, or the number of an iteration.

    Raises:
        UsageError: No run, no such checkpoint, or a broken one.
    """
    record = load_record(run)
    checkpoints = Checkpoints(run)
    path = checkpoints.find(which)
    checkpoints.meta(path)  # refuses what another version wrote
    networks = make_networks(record.groups, record.privileged_size, record.config)
    return networks, read_part(path, "learner", make_train_state(networks, record.config)), record


def load_policy(run: Path, which: str = "best") -> tuple[LearnedPolicy, PolicyParams, RunRecord]:
    """Return the policy of a run; see `load_train_state`."""
    networks, train_state, record = load_train_state(run, which)
    return networks.policy, policy_params(train_state), record
