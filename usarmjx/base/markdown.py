"""Markdown tables."""

from collections.abc import Iterable, Iterator, Sequence


def table_lines(head: Sequence[object], rows: Iterable[Sequence[object]]) -> Iterator[str]:
    """Yield the lines of a Markdown table, each row as soon as it is available.

    Args:
        head: Column titles.
        rows: Cells (rows, columns); a vertical bar in a cell becomes a slash.
    """
    yield _line(head)
    yield "|" + "---|" * len(head)
    yield from map(_line, rows)


def markdown_table(head: Sequence[object], rows: Iterable[Sequence[object]]) -> str:
    """Return a Markdown table; see `table_lines`."""
    return "\n".join(table_lines(head, rows))


def _line(cells: Sequence[object]) -> str:
    return f"| {' | '.join(str(cell).replace('|', '/') for cell in cells)} |"
