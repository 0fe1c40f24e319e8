"""Start of several processes that train together: one for each device, each with worlds of its own."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from usarmjx.base.errors import UsageError

COORDINATOR, COUNT, INDEX, PARENT = (
    "USARMJX_COORDINATOR",
    "USARMJX_PROCESSES",
    "USARMJX_PROCESS",
    "USARMJX_PARENT",
)


# Launchers with their variables for the number of processes, the index of this one, and its index on its
# host. The first launcher is ours; torchrun's MASTER_ADDR and MASTER_PORT name the coordinator.
LAUNCHERS = (
    ("usarmjx", COUNT, INDEX, INDEX),
    ("torchrun", "WORLD_SIZE", "RANK", "LOCAL_RANK"),
    ("Slurm", "SLURM_NTASKS", "SLURM_PROCID", "SLURM_LOCALID"),
    ("Open MPI", "OMPI_COMM_WORLD_SIZE", "OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_LOCAL_RANK"),
)


@dataclass(frozen=True)
class ProcessInfo:
    """One of several processes.

    Attributes:
        count: Number of processes.
        index: Index of this one.
        local_index: Index on its host.
        coordinator: Address of the first one, as host:port; empty: jax finds it from the launcher.
    """

    count: int
    index: int
    local_index: int
    coordinator: str = ""


def process_info(environment: Mapping[str, str]) -> ProcessInfo | None:
    """Return this process among several, by the environment variables; None: the only one."""
    for name, count, index, local in LAUNCHERS:
        number = environment.get(count, "")
        # Launchers set these for a single process, too, which must not wait for a coordinator.
        if index in environment and number.isdecimal() and int(number) > 1:
            address = environment.get(COORDINATOR, "")
            if name == "torchrun":
                host, port = environment.get("MASTER_ADDR"), environment.get("MASTER_PORT")
                if not host or not port:
                    raise UsageError(f"{count} is {number}, but MASTER_ADDR or MASTER_PORT is not set")
                address = f"{host}:{port}"
            where = environment.get(local, environment[index])
            return ProcessInfo(int(number), int(environment[index]), int(where), address)
    return None


def spawn(processes: int, command: Sequence[str]) -> int:
    """Run a command in several processes on this host, and return the first exit code that is not 0.

    Each sees one GPU, if there are any. If one ends with a fault, the others are ended.

    Args:
        processes: Number of processes.
        command: Program and arguments, the same for all.
    """
    address = f"127.0.0.1:{_free_port()}"
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    gpus = visible.split(",") if visible else [str(i) for i in range(processes)]
    if visible and len(gpus) < processes:
        raise UsageError(f"{processes} processes, but CUDA_VISIBLE_DEVICES shows {len(gpus)} devices")
    running: list[subprocess.Popen[bytes]] = []
    try:
        for i in range(processes):
            ours = {COORDINATOR: address, COUNT: str(processes), INDEX: str(i), PARENT: str(os.getpid())}
            # JAX reserves memory on every GPU that it sees.
            environment = {**os.environ, **ours, "CUDA_VISIBLE_DEVICES": gpus[i]}
            running.append(subprocess.Popen(command, env=environment))
        return _wait(running)
    finally:
        _end(running)


def _wait(running: list[subprocess.Popen[bytes]]) -> int:
    while True:
        # None, of a process that still runs, is neither a fault nor an end.
        codes = [process.poll() for process in running]
        bad = [code for code in codes if code]
        if bad or all(code == 0 for code in codes):
            return bad[0] if bad else 0
        time.sleep(0.1)


def _end(running: list[subprocess.Popen[bytes]], timeout: float = 5.0) -> None:
    for process in running:
        if process.poll() is None:
            process.send_signal(signal.SIGTERM)
    # One deadline for all: each process with a time of its own would add them up.
    until = time.monotonic() + timeout
    for process in running:
        try:
            process.wait(max(0.1, until - time.monotonic()))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _free_port() -> int:
    with socket.socket() as probe:
        # Another program may take the port before the coordinator does: then the start fails with its
        # message.
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def check_parent() -> None:
    """End this process if `spawn` started it and has died: nothing else would stop it."""
    parent = os.environ.get(PARENT)
    if parent is not None and os.getppid() != int(parent):
        sys.exit("usarmjx: the process that started this one is gone")
