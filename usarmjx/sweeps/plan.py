"""Which cells are played together: those that differ in data only share a group, and that one compilation.

Pure functions of what must be alike (`resolve.signature_of`) and of how many worlds a batch may have.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass

WORLDS_OF_C, WORLDS_ON_CPU, WORLDS_ON_GPU = 256, 1024, 8192
"""Worlds of a batch at most if nobody says otherwise: engine `c`, and the others by what JAX runs on."""

Signature = Mapping[str, Hashable]
"""What must be alike in a batch, by what people call it."""


@dataclass(frozen=True, kw_only=True)
class CellGroup:
    """Cells that differ in data only.

    Attributes:
        cells: Their numbers.
        batches: The same in batches, one after the other.
        size: Cells that a batch has room for: the last one's spare places repeat its last cell.
    """

    cells: tuple[int, ...]
    batches: tuple[tuple[int, ...], ...]
    size: int


@dataclass(frozen=True, kw_only=True)
class SweepPlan:
    """What is played together.

    Attributes:
        groups: The groups.
        differing: In what the groups differ, and in how many ways.
    """

    groups: tuple[CellGroup, ...]
    differing: dict[str, int]

    @property
    def batches(self) -> int:
        """How many batches there are."""
        return sum(len(group.batches) for group in self.groups)

    def as_text(self) -> str:
        """Return how many batches of how many cells there are, and why, in a line."""
        cells = sum(len(group.cells) for group in self.groups)
        if not self.groups:
            return "no cells to play"
        sizes = sorted({len(batch) for group in self.groups for batch in group.batches})
        each = f"{sizes[0]}" if len(sizes) == 1 else f"{sizes[0]} to {sizes[-1]}"
        said = f"{_many(cells, 'cell')} in {_many(self.batches, 'batch')} of {each}, "
        said += f"{_many(len(self.groups), 'compilation')}"
        if self.differing:
            parts = ", ".join(f"{what} ({count} kinds)" for what, count in self.differing.items())
            return f"{said}: what is compiled in differs in {parts}; all else is data"
        return f"{said}: the cells differ in data only"


def _many(count: int, what: str) -> str:
    plural = "es" if what.endswith("ch") else "s"
    return f"{count} {what}{'' if count == 1 else plural}"


def plan_batches(
    signatures: Sequence[Signature],
    episodes: Sequence[int],
    most_worlds: int,
    alone: Sequence[bool] | None = None,
) -> SweepPlan:
    """Return which cells are played together.

    Args:
        signatures: Of each cell (cells,).
        episodes: Of each cell, one world each; those of one signature have as many (cells,).
        most_worlds: Worlds that a batch has at most; a cell that has more is a batch of its own.
        alone: Which cells share a batch with no other (cells,); None: none of them.
    """
    together: dict[Hashable, list[int]] = {}
    for number, signature in enumerate(signatures):
        own = number if alone is not None and alone[number] else None
        together.setdefault((own, tuple(signature.items())), []).append(number)
    groups: list[CellGroup] = []
    for cells in together.values():
        room = max(1, most_worlds // episodes[cells[0]])
        count = -(-len(cells) // room)
        size = -(-len(cells) // count)  # as even as can be: few places are spare
        rows = tuple(tuple(cells[i : i + size]) for i in range(0, len(cells), size))
        groups.append(CellGroup(cells=tuple(cells), batches=rows, size=size))
    kinds = {name: len({row[name] for row in signatures}) for name in (signatures[0] if signatures else ())}
    return SweepPlan(
        groups=tuple(groups), differing={name: count for name, count in kinds.items() if count > 1}
    )
