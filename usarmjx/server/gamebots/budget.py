"""Budgets of clients' processing time: a client that has spent its budget waits, and the world steps on.

Budgets are of processor time and grow with the world's time, a bit in each control step. So neither a machine
that is busy with other things nor a world that falls behind lets clients take more of each step.
"""

import asyncio
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import TracebackType

from usarmjx.base.errors import PeerError
from usarmjx.server.network.loop_meter import LoopMeter

CLIENT_SHARE = 0.05
"""Growth of one client's budget [s per simulated second]."""
TOTAL_SHARE = 0.25
"""Share of a control step for all clients of a world together [s per simulated second]."""
JOIN_SHARE = 0.15
"""Share of a control step for joining and leaving, all clients together [s per simulated second]."""
SHARE_BESIDE_JOINS = 0.1
"""Share for all clients together while the time for joining is spent [s per simulated second].

A model is built in one piece, which takes as long as several control steps give. With the usual share beside
it, a neighbour would wait for the sum of both.
"""
BURST = 0.05
"""Largest saved budget of a silent client [s]."""
USE_DECAY = 0.98
"""Decay per control step of the use that decides whose turn is next."""
TURN_COST = 1e-5
"""Cost of a turn besides its work: reading, and waking the client's task [s]."""
INIT_COST = 0.02
"""Smallest cost of an INIT to its sender, whether it is accepted or not [s]."""


class BudgetPool:
    """Time of all clients of a world between two control steps, and the order of their turns.

    Args:
        period: Simulated time of a control step [s].
        share: Share of the time [s per simulated second].
        clock: Processor time of this thread [s].
        joins: Time for joining; while it is spent, the share is `SHARE_BESIDE_JOINS`.

    Attributes:
        clock: Processor time of this thread [s].
        growth: Growth of each client's budget in a control step [s].
        meter: Meter of the loop, which does not count turns.
        steps: Control steps so far.
    """

    def __init__(
        self,
        period: float,
        share: float = TOTAL_SHARE,
        clock: Callable[[], float] = time.thread_time,
        joins: "BudgetPool | None" = None,
    ) -> None:
        self.clock, self.growth, self.steps = clock, CLIENT_SHARE * period, 0
        self.meter: LoopMeter | None = None
        self._joins, self._share_beside_joins = joins, min(share, SHARE_BESIDE_JOINS) * period
        # From here on in seconds for each control step.
        self._share = self._left = share * period
        self._waiting: dict[ClientBudget, asyncio.Future[None]] = {}

    @property
    def is_spent(self) -> bool:
        """Whether nothing is left for any client in this control step."""
        return self._left <= 0.0

    def refill(self) -> None:
        """Begin a control step: an unspent rest of the last one is lost, a debt stays."""
        self.steps += 1
        beside = self._joins is not None and self._joins.is_spent
        share = self._share_beside_joins if beside else self._share
        self._left = share + min(0.0, self._left)
        self._wake_next()

    def spend(self, cost: float) -> None:
        """Subtract the cost of a turn [s], and wake the next client."""
        if self.meter is not None:
            self.meter.exclude(cost)
        self._left -= cost
        self._wake_next()

    @contextmanager
    def spending(self) -> Generator[None]:
        """Subtract the cost of the work within the context, which does not wait."""
        began = self.clock()
        try:
            yield
        finally:
            self.spend(self.clock() - began)

    async def wait(self, budget: "ClientBudget") -> None:
        """Wait until a client may have its turn.

        Raises:
            PeerError: Its wait is cancelled.
        """
        # A loop: between the wake-up and this task's run another client may have spent the step's time.
        while self.is_spent or budget.balance <= 0.0:
            self._waiting[budget] = asyncio.get_running_loop().create_future()
            try:
                await self._waiting[budget]
            except asyncio.CancelledError:
                # This waiter may hold the wake-up of this step: pass it on, or all sleep a step longer.
                self._wake_next()
                raise
            finally:
                # Also after a wake-up: a done future left here would count as a waiter that hangs for ever.
                del self._waiting[budget]

    def has_waiting(self, budget: "ClientBudget") -> bool:
        """Return whether a client waits for its turn."""
        return budget in self._waiting

    def dismiss(self, budget: "ClientBudget", reason: str) -> None:
        """Cancel a client's wait and turn; nothing if it does not wait."""
        # A done future has its turn already, and a second result would raise InvalidStateError.
        called = self._waiting.get(budget)
        if called is not None and not called.done():
            called.set_exception(PeerError(reason))

    def _wake_next(self) -> None:
        """Wake the client with the least recent use, so that a client with few requests hardly waits."""
        if self.is_spent:
            return
        # A client in debt is passed over: its wake-up would be wasted, and nobody else would get it.
        able = [one for one, called in self._waiting.items() if not called.done() and one.balance > 0.0]
        if able:
            self._waiting[min(able, key=lambda budget: budget.used)].set_result(None)


class ClientBudget:
    """Budget of one client. `async with budget:` around work without waiting is its turn, which it pays for.

    Args:
        pool: Time that it shares with the others.
    """

    def __init__(self, pool: BudgetPool) -> None:
        self._pool = pool
        self._balance, self._used, self._step, self._began = BURST, 0.0, pool.steps, 0.0

    @property
    def balance(self) -> float:
        """Rest of the budget; below zero the client waits [s]."""
        # Computed from the number of steps on demand, so that silent clients take no time in a step.
        return min(BURST, self._balance + (self._pool.steps - self._step) * self._pool.growth)

    @property
    def used(self) -> float:
        """Recent use of the client [s]."""
        return self._used * USE_DECAY ** (self._pool.steps - self._step)

    @property
    def is_waiting(self) -> bool:
        """Whether the client waits for its turn."""
        return self._pool.has_waiting(self)

    def charge(self, cost: float) -> None:
        """Subtract a price besides the cost of the work."""
        # Both properties read `_step`: it moves only after they are evaluated.
        self._balance, self._used = self.balance - cost, self.used + cost
        self._step = self._pool.steps

    def dismiss(self, reason: str) -> None:
        """Cancel the client's wait, if it waits: the awaited turn raises PeerError."""
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
