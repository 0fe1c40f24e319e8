"""Checkpoints: the state of a run from which training goes on as if it had never stopped.

`checkpoints/00000020/` holds the state after 20 iterations: `learner_0.npz` (the train state) and
`worlds_0.npz` (the rollout state) of process 0, those of other processes, and `meta.json`. The folder is
written under another name and renamed when it is complete, so a folder of that name is whole. Of several
seeds that train at once each has a train state, and all share the worlds, see `seed_runs`.
"""

import os
import shutil
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager, suppress
from functools import partial
from io import BufferedWriter
from pathlib import Path
from typing import Any, TypeGuard

import jax
import jax.numpy as jnp
import numpy as np

from usarmjx.base.backend import Array
from usarmjx.base.errors import SpecError, UsageError, WriteError
from usarmjx.base.files import PARTIAL_MARK, writing
from usarmjx.base.npz_file import NpzLimits, read_npz
from usarmjx.base.settings.json_file import kept_text, read_kept
from usarmjx.train.learning.config import RunRecord, load_record
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

FOLDER = "checkpoints"
FORMAT = 3
"""Format of checkpoints; raised whenever a field of a saved state is renamed, added or removed, because
arrays are found by these names. Formats 1 and 2 were orbax's."""
MOST_ARRAYS = 100_000
"""Most arrays of a part."""
SET = "seeds"
"""Field of `meta` of a checkpoint without worlds: the number of seeds that train together."""
FULL = "at full difficulty"
"""Kind of a score that was measured with all arenas in play, on fixed seeds."""


def _is_key(leaf: object) -> TypeGuard[jax.Array]:
    return isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jax.dtypes.prng_key)


def _arrays(tree: object) -> dict[str, np.ndarray]:
    """Return a tree's leaves by their path, as NumPy arrays; random keys as their numbers."""
    leaves = jax.tree.flatten_with_path(tree)[0]
    # NumPy has no dtype for typed random keys; their data are plain words.
    plain = [(path, jax.random.key_data(leaf) if _is_key(leaf) else leaf) for path, leaf in leaves]
    return {"".join(map(str, path)): np.asarray(leaf, order="C") for path, leaf in plain}


def _as_leaf(leaf: object, array: np.ndarray) -> Array:
    """Return an array as the kind of array that the leaf is."""
    if _is_key(leaf):
        random: Any = jax.random  # jax leaves the result of this without a type
        return random.wrap_key_data(jax.device_put(array), impl=jax.random.key_impl(leaf))
    # Unlike `jnp.asarray` it compiles no program for each shape.
    return jax.device_put(array) if isinstance(leaf, jax.Array) else array


@contextmanager
def _synced_file(path: Path) -> Generator[BufferedWriter]:
    """Open a file to write to; at the end it is on the disk, not only in the system's buffers."""
    with path.open("wb") as file:
        yield file
        file.flush()
        # A rename orders no writes: after a crash the renamed folder could hold empty files.
        os.fsync(file.fileno())


def write_part(folder: Path, name: str, tree: object, index: int = 0) -> None:
    """Write a part of a checkpoint, `learner` or `worlds`, of the process with this index."""
    with _synced_file(folder / f"{name}_{index}.npz") as file:
        np.savez(file, allow_pickle=False, **_arrays(tree))


def read_part(folder: Path, name: str, template: Tree, index: int = 0) -> Tree:
    """Return a part of a checkpoint.

    Args:
        folder: The checkpoint.
        name: `learner` or `worlds`.
        template: A tree of the same shapes; each leaf decides between NumPy's and JAX's arrays.
        index: Index of the process whose part it is.

    Raises:
        UsageError: The checkpoint is broken, or of another run.
    """
    path = folder / f"{name}_{index}.npz"
    try:
        # Its members are not packed, and each has a checksum, which is compared.
        found = read_npz(path, NpzLimits("checkpoint", arrays=MOST_ARRAYS), lambda _: "biufc")
    except Exception as error:  # damaged files make the reader raise errors of any kind
        raise UsageError(
            f"checkpoint {folder} is broken: {path.name} does not read; delete it: {error}"
        ) from error
    there, wanted = _specs(found), _specs(_arrays(template))
    # Lists, not sets: below, leaves and arrays are paired by position.
    if there != wanted:
        raise UsageError(f"checkpoint {folder} is of another run: {_first_difference(there, wanted)}")
    leaves, shape = jax.tree.flatten(template)
    pairs = zip(leaves, found.values(), strict=True)
    return jax.tree.unflatten(shape, [_as_leaf(leaf, array) for leaf, array in pairs])


def _specs(arrays: dict[str, np.ndarray]) -> list[tuple[str, tuple[int, ...], str]]:
    return [(path, array.shape, str(array.dtype)) for path, array in arrays.items()]


def _first_difference(there: list[Any], wanted: list[Any]) -> str:
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
        # Names are padded with zeros, so their order is that of the iterations; partial folders are not
        # decimal.
        return sorted(p for p in self.folder.glob("*") if p.name.isdecimal() and p.is_dir())

    def find(self, which: str = "last") -> Path:
        """Return a checkpoint: `last`, `best`, or the number of an iteration.

        Raises:
            UsageError: No such one; lists those there are.
        """
        paths = self.all()
        numbers = ", ".join(str(int(path.name)) for path in paths) or "none"
        if which == "last" and paths:
            return paths[-1]
        if which == "best" and paths:
            return max(paths, key=self._rank)
        for path in paths:
            if which.isdecimal() and int(path.name) == int(which):
                return path
        raise UsageError(f"no checkpoint {which!r} in {self.folder}; known: {numbers}, besides last and best")

    def meta(self, path: Path) -> dict[str, Any]:
        """Return the facts of a checkpoint: `iteration`, `agent_steps`, `score`, `processes`.

        Raises:
            UsageError: It is broken, or was written by another version.
        """
        file = path / "meta.json"
        try:
            meta = read_kept(file, needs_checksum=False)
            if meta["format"] != FORMAT:
                raise UsageError(
                    f"checkpoint {path} was written by another version of usarmjx (format {meta['format']}, "
                    f"this one reads {FORMAT}): go on with that version; policies exported with it still load"
                )
            if meta["iteration"] != int(path.name):
                raise UsageError(f"checkpoint {path} is of iteration {meta['iteration']}: it was renamed")
            score = meta["score"]
            # True is an int in Python, but no score.
            known = score is None or (isinstance(score, int | float) and not isinstance(score, bool))
            if not known or not isinstance(meta["agent_steps"], int):
                raise TypeError("score and agent_steps are numbers")
        except (SpecError, KeyError, TypeError) as error:
            raise UsageError(f"checkpoint {path} is broken: meta.json does not read: {error}") from error
        return meta

    def _rank(self, path: Path) -> tuple[bool, float, str]:
        """Return the key of a checkpoint in comparisons: a score at full difficulty is above all others."""
        meta = self.meta(path)
        score = meta["score"]
        # Early checkpoints have no kind.
        # Of equal scores the later one wins, by its name.
        return meta.get("kind") == FULL, float("-inf") if score is None else score, path.name

    def describe(self, which: str) -> str:
        """Return a line that names a checkpoint, the reason for it, and the others.

        Raises:
            UsageError: See `find` and `meta`.
        """
        path, paths = self.find(which), self.all()
        meta = self.meta(path)
        score = "none" if meta["score"] is None else f"{meta['score']:.4g}"
        kind = meta.get("kind", "in training")
        reason = {"best": f"the best by score {kind}", "last": "the last"}.get(which, "as asked for")
        others = ", ".join(str(int(one.name)) for one in paths if one != path) or "none"
        return (
            f"checkpoint {meta['iteration']} of {self.run}, {reason}: {score} after {meta['agent_steps']:,} "
            f"agent steps (others: {others})"
        )

    def save(
        self, iteration: int, train_state: TrainState, worlds: RolloutState, note: dict[str, Any]
    ) -> None:
        """Write a checkpoint, unless there is one of that iteration, and drop old ones; all processes do.

        Args:
            iteration: After which.
            train_state: The same in all processes.
            worlds: State of this process's worlds.
            note: For `meta`; must have `score`, a number or None, and may have `kind`, the kind of the score.

        Raises:
            WriteError: In all processes; nothing of it is left, and the earlier ones are whole.
        """
        self.write(iteration, {"learner": train_state, "worlds": worlds}, note, keep=self.keep)

    def write(
        self, iteration: int, parts: Mapping[str, object], note: Mapping[str, Any], *, keep: int | None = None
    ) -> None:
        """Do as `save` does, with parts by name.

        Args:
            iteration: After which.
            parts: The parts.
            note: As for `save`.
            keep: Latest ones that are kept; None: all are.

        Raises:
            WriteError: As `save`.
        """
        process_group, path = self.process_group or ProcessGroup(), self.folder / f"{iteration:08d}"
        if path.exists():
            return
        meta = {"format": FORMAT, "iteration": iteration, "processes": process_group.count, **note}
        # In the same folder: a rename is atomic only within one file system.
        fresh = path.with_name(path.name + PARTIAL_MARK)
        steps = (
            partial(self._begin, fresh, process_group),
            partial(self._write, fresh, parts, process_group),
            partial(self._finish, fresh, meta, process_group, keep),
        )
        try:
            # Each step ends in a barrier: nobody writes into a folder that is not made, and the rename waits
            # for all.
            for step in steps:
                self._in_all_processes(path, step, process_group)
        except WriteError:
            if process_group.index == 0:
                shutil.rmtree(fresh, ignore_errors=True)
            raise

    def _begin(self, fresh: Path, process_group: ProcessGroup) -> None:
        if process_group.index == 0:
            # A trainer that was killed while it wrote may have left one.
            shutil.rmtree(fresh, ignore_errors=True)
            fresh.mkdir(parents=True)

    def _write(self, fresh: Path, parts: Mapping[str, object], process_group: ProcessGroup) -> None:
        for name, tree in parts.items():
            write_part(fresh, name, tree, process_group.index)

    def _finish(
        self, fresh: Path, meta: Mapping[str, Any], process_group: ProcessGroup, keep: int | None
    ) -> None:
        if process_group.index == 0:
            with _synced_file(fresh / "meta.json") as file:
                file.write(kept_text(meta, indent=None).encode())
            # Last of all: `all` takes a folder without the mark for a whole checkpoint.
            fresh.rename(fresh.with_name(fresh.name.removesuffix(PARTIAL_MARK)))
            if keep is not None:
                self.delete_old(keep)

    @staticmethod
    def _in_all_processes(path: Path, step: Callable[[], None], process_group: ProcessGroup) -> None:
        """Do something in each process; where it fails in one, it has failed in all."""
        fault = None
        try:
            with writing(path):
                step()
        except WriteError as error:
            fault = error
        # A process that raised by itself would leave the others waiting in their next collective.
        if not process_group.everywhere(fault is None):
            raise fault or WriteError(f"cannot write {path}: another process could not")

    def delete_old(self, keep: int) -> None:
        """Delete all but the latest ones, as many as are to be kept, and the best one."""
        paths = self.all()
        kept = {*paths[-keep:], max(paths, key=self._rank)}
        # Partial folders here are remains of a process that was killed: nobody writes one at this time.
        for path in (*(p for p in paths if p not in kept), *self.folder.glob(f"*{PARTIAL_MARK}")):
            _delete(path)

    def delete_after(self, iteration: int) -> None:
        """Delete those of later iterations."""
        for path in self.all():
            if int(path.name) > iteration:
                _delete(path)


def _delete(path: Path) -> None:
    doomed = path.with_name(path.name + PARTIAL_MARK) if path.name.isdecimal() else path
    if doomed != path:
        with suppress(OSError):  # the next time will do
            path.rename(doomed)  # a half deleted folder must not pass for a checkpoint
    # Remains have the mark of partial folders, so the next clean-up takes them away.
    shutil.rmtree(doomed, ignore_errors=True)


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
    # Only the shapes of the fresh state matter: all its arrays are replaced.
    return networks, read_part(path, "learner", make_train_state(networks, record.config)), record


def read_policy(run: Path, which: str = "best") -> tuple[LearnedPolicy, PolicyParams, RunRecord]:
    """Return the policy of a run; see `load_train_state`."""
    networks, train_state, record = load_train_state(run, which)
    return networks.policy, policy_params(train_state), record
