"""Small tables: in Markdown, and of an object in a notebook."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape


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
    # A bar would end its cell.
    return f"| {' | '.join(str(cell).replace('|', '/') for cell in cells)} |"


def facts_line(kind: str, facts: Mapping[str, object]) -> str:
    """Return facts as the `repr` of an object, in one line."""
    return f"{kind}({', '.join(f'{name}={value}' for name, value in facts.items())})"


def facts_table(kind: str, facts: Mapping[str, object]) -> str:
    """Return facts as a table of HTML, without scripts and without addresses."""
    rows = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td style='text-align:left'>"
        f"{escape(str(value))}</td></tr>"
        for name, value in facts.items()
    )
    return f"<table><caption><b>{escape(kind)}</b></caption>{rows}</table>"
