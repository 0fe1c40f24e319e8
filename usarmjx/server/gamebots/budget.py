"""What clients may take of a server's time: whoever has spent its budget waits, and the world steps on.

Budgets are of processor time and grow with the world's time, a bit in each control step. So neither a machine
that is busy with other things nor a world that falls behind lets clients take more of each step.
"""

import asyncio
import time
from collections.abc import Callable
from types import TracebackType

from usarmjx.base.errors import PeerError

CLIENT_SHARE = 0.05
"""A client's budget grows by so much of the time [s per simulated second]."""
TOTAL_SHARE = 0.25
"""All clients of a world together get so much of the time of a control step [s per simulated second]."""
JOIN_SHARE = 0.2
"""To join the world and to leave it may take so much of the time, for all who do [s per simulated second]."""
BURST = 0.05
"""A client that was silent has saved up so much [s]."""
MEMORY = 0.98
"""So much of what a client has used still counts a control step later, where the next one is chosen."""
TURN_COST = 1e-5
"""What a turn costs beside the work that is done in it: reading, and waking the client's task [s]."""
INIT_COST = 0.02
"""What an INIT costs its sender at least, whether it is accepted or not [s]."""


class BudgetPool:
    """The time that all clients of a world have between two control steps, and whose turn it is.

    Args:
        period: Simulated time of a control step [s].
        share: How much of the time that is [s per simulated second].
        clock: The processor time of this thread [s].

    Attributes:
        clock: The processor time of this thread [s].
        growth: What each client's budget grows by in a control step [s].
        steps: Control steps so far.
    """

    def __init__(
        self, period: float, share: float = TOTAL_SHARE, clock: Callable[[], float] = time.thread_time
    ) -> None:
        self.clock, self.growth, self.steps = clock, CLIENT_SHARE * period, 0
        self._share = self._left = share * period
        self._waiting: dict[ClientBudget, asyncio.Future[None]] = {}

    @property
    def is_spent(self) -> bool:
        """Whether there is nothing left for anybody in this control step."""
        return self._left <= 0.0

    def refill(self) -> None:
        """The world has made a control step. What was left of the last one is not saved up; a debt stays."""
        self.steps += 1
        self._left = self._share + min(0.0, self._left)
        self._call_next()

    def spend(self, cost: float) -> None:
        """Take what a turn has cost [s], and call the next client."""
        self._left -= cost
        self._call_next()

    async def wait(self, budget: "ClientBudget") -> None:
        """Wait until a client may have its turn.

        Raises:
            PeerError: It is told to wait no longer.
        """
        while self.is_spent or budget.balance <= 0.0:
            self._waiting[budget] = asyncio.get_running_loop().create_future()
            try:
                await self._waiting[budget]
            except asyncio.CancelledError:
                self._call_next()  # it may have been called already
                raise
            finally:
                del self._waiting[budget]

    def dismiss(self, budget: "ClientBudget", reason: str) -> None:
        """Let a client wait no longer, nor have its turn; nothing if it does not wait."""
        called = self._waiting.get(budget)
        if called is not None and not called.done():
            called.set_exception(PeerError(reason))

    def _call_next(self) -> None:
        """Call the client that has used least of late: who asks for little hardly waits."""
        if self.is_spent:
            return
        able = [one for one, called in self._waiting.items() if not called.done() and one.balance > 0.0]
        if able:
            self._waiting[min(able, key=lambda budget: budget.used)].set_result(None)


class ClientBudget:
    """One client's budget. `async with budget:` around work without waiting is its turn, which it pays for.

    Args:
        pool: What it shares with the others.
    """

    def __init__(self, pool: BudgetPool) -> None:
        self._pool = pool
        self._balance, self._used, self._step, self._began = BURST, 0.0, pool.steps, 0.0

    @property
    def balance(self) -> float:
        """What is left of it; below zero it waits [s]."""
        return min(BURST, self._balance + (self._pool.steps - self._step) * self._pool.growth)

    @property
    def used(self) -> float:
        """What the client has used of late [s]."""
        return self._used * MEMORY ** (self._pool.steps - self._step)

    def charge(self, cost: float) -> None:
        """Take a price beside what the work has cost [s]."""
        self._balance, self._used = self.balance - cost, self.used + cost
        self._step = self._pool.steps

    def dismiss(self, reason: str) -> None:
        """If the client waits, let it wait no longer: what it waits for raises PeerError."""
        self._pool.dismiss(self, reason)

    async def __aenter__(self) -> None:
        """Wait for the turn."""
        await self._pool.wait(self)
        self._began = self._pool.clock()

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Pay."""
        cost = self._pool.clock() - self._began + TURN_COST
        self.charge(cost)
        self._pool.spend(cost)
