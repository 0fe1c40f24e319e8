"""Several processes train together: one for each device, each with worlds of its own.

Only gradients and sums cross between processes; checkpoints are written by all of them to one folder, which
all hosts must share.
"""

import os
import socket
import sys
import threading
import traceback
from collections.abc import Generator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar, cast

import jax
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from usarmjx.base.errors import UsageError, UsarmjxError
from usarmjx.base.files import writing
from usarmjx.train.learning.launch import ProcessInfo, process_info

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None

LOCK_FILE = "trainer.lock"


@contextmanager
def run_lock(run: Path) -> Generator[None]:
    """Keep other trainers out of the folder of a run, which is there.

    The system holds the lock for this process, so none is left behind, however the process ends.

    Raises:
        UsageError: Another process trains there; names it.
        WriteError: The folder cannot be written to.
    """
    path = run / LOCK_FILE
    with writing(path):
        # Appending creates the file without emptying it: the holder's name in it is shown below.
        file = path.open("a+")
    with file:
        if not _lock(file.fileno()):
            # A file that was opened for appending is at its end.
            file.seek(0)
            who = file.read().strip() or "another process"
            raise UsageError(f"{who} trains in {run}: wait for its end, or choose another folder")
        with writing(path):
            file.truncate(0)
            file.write(f"process {os.getpid()} on {socket.gethostname()}\n")
            # At once: a second trainer reads the name while this one holds the lock.
            file.flush()
        # The lock ends when the file is closed, after the body.
        yield


def _lock(descriptor: int) -> bool:
    """Return whether this process holds the lock; true with a warning on systems without locks."""
    reason = "this system has no fcntl"
    if fcntl is not None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            return False
        except OSError as error:
            reason = str(error.strerror)
    sys.stderr.write(
        f"usarmjx: a second trainer in this folder would not be noticed, as it cannot be locked: {reason}\n"
    )
    return True


Tree = TypeVar("Tree")
"""Any tree of arrays."""
PROCESS_AXIS = "process"
"""Axis of the mesh of all processes."""


def initialize(environment: Mapping[str, str] | None = None) -> ProcessInfo:
    """Join the other processes, if there are any; before anything runs on a device.

    Raises:
        UsageError: The environment variables contradict each other, or JAX runs already.
    """
    info = process_info(os.environ if environment is None else environment)
    if info is None:
        return ProcessInfo(1, 0, 0)
    # A second call raises in JAX.
    if jax.distributed.is_initialized():
        return info
    # JAX has no collectives between CPU processes unless it is given an implementation.
    cast(Any, jax.config).update("jax_cpu_collectives_implementation", "gloo")
    arguments: dict[str, Any] = {"num_processes": info.count, "process_id": info.index}
    if info.coordinator:
        arguments["coordinator_address"] = info.coordinator
    try:
        jax.distributed.initialize(
            **arguments, local_device_ids=None if _device_is_chosen() else [info.local_index]
        )
    except (RuntimeError, ValueError) as error:
        raise UsageError(f"process {info.index} of {info.count} cannot join the others: {error}") from error
    return info


@contextmanager
def distributed_run() -> Generator[ProcessInfo, None, None]:
    """Join the other processes, and fail at once if this one fails: else they would wait for each other.

    JAX has each process wait for all others at its end, for minutes, while those wait for what this one
    was to add. So the process ends without goodbye, and `spawn`, or the launcher, ends the others.

    Raises:
        UsageError: See `initialize`.
    """
    info = initialize()
    # A daemon: the end of the process does not wait for the devices.
    threading.Thread(target=_start_devices, name="devices", daemon=True).start()
    try:
        yield info
    except BaseException as error:
        if info.count == 1:
            raise
        ours = isinstance(error, UsarmjxError)
        if ours:
            sys.stderr.write(f"usarmjx: {error}\n")
        else:
            traceback.print_exc()
        # The exit below flushes nothing.
        sys.stderr.flush()
        # `sys.exit` would run JAX's exit handlers, which wait for the other processes.
        os._exit(2 if ours else 1)


def _start_devices() -> None:
    """Let JAX start its devices while modules are imported and worlds built: a GPU takes seconds.

    Faults are left to the first caller that needs devices, as JAX tries again.
    """
    with suppress(Exception):
        jax.devices()


def _device_is_chosen() -> bool:
    """Return whether the device has been chosen already: a CPU, or the only GPU that is shown."""
    shown = os.environ.get("CUDA_VISIBLE_DEVICES")
    return os.environ.get("JAX_PLATFORMS") == "cpu" or (shown is not None and "," not in shown)


class ProcessGroup:
    """All processes, as the update sees them.

    Attributes:
        count: Number of processes.
        index: Index of this one.
        device: Device that this one computes on.
        mesh: One device of each.
    """

    def __init__(self) -> None:
        self.count, self.index = jax.process_count(), jax.process_index()
        firsts: dict[int, Any] = {}
        for device in jax.devices():
            # A process may see several devices; the mesh takes its first one.
            firsts.setdefault(device.process_index, device)
        self.device = firsts[self.index]
        self.mesh = Mesh(np.array([firsts[i] for i in range(self.count)]), (PROCESS_AXIS,))

    def device_put(self, tree: Tree) -> Tree:
        """Return a tree with its JAX arrays placed on this process's device; others stay as they are."""
        # Without weak types, so that the second iteration finds what the first one compiled.
        return jax.tree.map(
            lambda leaf: (
                jax.device_put(_without_weak_type(leaf), self.device) if isinstance(leaf, jax.Array) else leaf
            ),
            tree,
        )

    def to_global(self, tree: Tree, axis: int | None) -> Tree:
        """Return global arrays, of which this process has the local part `tree`.

        Args:
            tree: Arrays of this process.
            axis: Axis along which the local parts are joined; None: all processes have the same.
        """

        def global_array(leaf: jax.Array, spec: jax.ShapeDtypeStruct) -> jax.Array:
            # Copies nothing: the local part stays in its buffer.
            return jax.make_array_from_single_device_arrays(spec.shape, spec.sharding, [leaf])

        return jax.tree.map(global_array, tree, self.global_shapes(tree, axis))

    def global_shapes(self, tree: Tree, axis: int | None) -> Tree:
        """Return the shapes of `to_global`'s result; only shapes of the tree are read."""
        spec = PartitionSpec() if axis is None else PartitionSpec(*[None] * axis, PROCESS_AXIS)
        sharding = NamedSharding(self.mesh, spec)

        def global_shape(leaf: jax.Array) -> jax.ShapeDtypeStruct:
            shape = [n * self.count if i == axis else n for i, n in enumerate(leaf.shape)]
            return jax.ShapeDtypeStruct(tuple(shape), leaf.dtype, sharding=sharding)

        return jax.tree.map(global_shape, tree)

    @staticmethod
    def to_local(tree: Tree) -> Tree:
        """Return the local part of global arrays."""
        # The mesh has one device of each process, so the first part is all of it.
        return jax.tree.map(lambda leaf: leaf.addressable_data(0), tree)

    def barrier(self, name: str) -> None:
        """Wait for all others to come here."""
        if self.count > 1:
            multihost_utils.sync_global_devices(name)

    def everywhere(self, true: bool) -> bool:
        """Return whether something is true in all processes; each waits here for the others."""
        if self.count == 1:
            return true
        found: Any = multihost_utils.process_allgather(np.array([true]))
        return bool(np.all(found))


def _without_weak_type(leaf: jax.Array) -> jax.Array:
    return leaf.astype(leaf.dtype) if getattr(leaf, "weak_type", False) else leaf
