"""A served policy that gets better: of a run that is still being trained, the newest checkpoint drives."""

import asyncio
import logging
import time
from pathlib import Path

from usarmjx.base.errors import UsageError
from usarmjx.server.worlds.policy_world import PolicyBatch
from usarmjx.train.learning.checkpoint import Checkpoints
from usarmjx.train.policies.sources import PolicySource, find_source

log = logging.getLogger(__name__)

INTERVAL = 2.0
"""A run's folder is looked into so often [s]."""


def newest(run: Path) -> str | None:
    """Return the name of a run's newest checkpoint; None: there is none yet."""
    try:
        return Checkpoints(run).find("last").name
    except UsageError:
        return None


def wait_for_run(run: Path, interval: float = INTERVAL) -> PolicySource:
    """Return the policy of a run's newest checkpoint, as soon as there is one.

    Raises:
        UsageError: There is one that cannot be read, and stays.
    """
    while True:
        found = newest(run)
        try:
            if found is not None:
                return find_source(str(run), "last")
        except UsageError:
            if newest(run) == found:  # else it was deleted for a newer one
                raise
        time.sleep(interval)


class PolicyFollower:
    """Lets the newest checkpoint of a run drive a served batch; a `net.Service`.

    It is read and compiled in a thread; the world goes on meanwhile.

    Args:
        shared: The batch.
        run: Folder of the run.
        interval: Time between two looks [s].
    """

    def __init__(self, shared: PolicyBatch, run: Path, interval: float = INTERVAL) -> None:
        self._shared, self._run, self._interval = shared, run, interval
        self._driving = newest(run)
        self._task: asyncio.Task[None] | None = None

    async def start(self) -> list[str]:
        """Begin to look."""
        self._task = asyncio.create_task(self._watch())
        return [f"the newest checkpoint of {self._run} drives"]

    async def _watch(self) -> None:
        while True:
            await asyncio.sleep(self._interval)
            found = newest(self._run)
            if found not in (None, self._driving):
                await self._take(found)

    async def _take(self, name: str | None) -> None:
        try:
            await asyncio.to_thread(self._load)
        except (UsageError, OSError) as error:  # it may have been deleted for a newer one
            log.warning("%s: %s", self._run, error)
            return
        self._driving = name
        log.info("checkpoint %s drives", name)

    def _load(self) -> None:
        self._shared.drive_by(find_source(str(self._run), "last").policy(self._shared.env))

    def tick(self) -> None:
        """Nothing to do."""

    def stop(self) -> None:
        """Look no more."""
        if self._task is not None:
            self._task.cancel()
