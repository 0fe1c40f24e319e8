"""Objects in a notebook: a small table of what they are."""

from collections.abc import Mapping
from html import escape


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
