"""A sweep as one HTML page that works without a network, and as a LaTeX table."""

# Matplotlib leaves the types of keywords open.
# pyright: reportUnknownMemberType=false

import io
import platform
from collections.abc import Sequence
from html import escape
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from usarmjx.base.estimates import Estimate
from usarmjx.base.files import atomic_write
from usarmjx.plots.style import figure_style
from usarmjx.sweeps.analysis import aggregates, overall_rows, policy_differences, tasks_of
from usarmjx.sweeps.figures import draw_sweep
from usarmjx.sweeps.report import report, without_residue
from usarmjx.sweeps.spec import BUNDLED, as_text
from usarmjx.sweeps.store import StoredSweep

PAGE_FILE, TABLE_FILE = "report.html", "report.tex"
MOST_BUILDINGS = 500
"""Buildings that a page lists."""
CSS = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222; }
h1 { font-size: 1.5em; } h2 { font-size: 1.15em; margin-top: 2em; }
table { border-collapse: collapse; font-size: 0.85em; margin: 0.7em 0; display: block; overflow-x: auto; }
th, td { padding: 0.15em 0.7em; text-align: left; border-bottom: 1px solid #ddd; white-space: nowrap; }
th { border-bottom: 2px solid #888; } figure { margin: 1em 0; } svg { max-width: 100%; height: auto; }
code, pre { background: #f4f4f4; padding: 0.1em 0.3em; } pre { padding: 0.7em; overflow-x: auto; }
p.warning { background: #fff3d6; padding: 0.4em 0.7em; }
"""


def write_report(found: StoredSweep, folder: Path) -> list[Path]:
    """Write a page and a LaTeX table into a sweep's folder, and return the files.

    Raises:
        UsageError: Nothing is finished.
        WriteError: A file cannot be written.
    """
    files = [folder / PAGE_FILE, folder / TABLE_FILE]
    for path, text in zip(files, (html_page(found, folder), latex_tables(found)), strict=True):
        with atomic_write(path) as fresh:
            fresh.write_text(text, encoding="utf-8")
    return files


def html_page(found: StoredSweep, folder: Path) -> str:
    """Return the page: design, results, figures, buildings, versions, and how to repeat it.

    Args:
        found: The sweep.
        folder: Its folder, for the commands.

    Raises:
        UsageError: Nothing is finished.
    """
    parts = [
        f"<h1>{escape(found.name)}</h1>",
        f"<p>{escape(found.about)}</p>",
        "<h2>Design</h2>",
        _table(("setting", "values"), _design(found)),
        "<h2>Results</h2>",
        *_blocks(report(found)),
        "<h2>Figures</h2>",
        *[f"<figure>{_svg(figure)}</figure>" for figure in draw_sweep(found)],
        "<h2>Buildings</h2>",
        *_buildings(found),
        "<h2>Versions</h2>",
        _table(("package", "version"), _versions(found)),
        "<h2>Repeat it</h2>",
        f"<pre>usarmjx sweep run {escape(_source(found))} --out {escape(str(folder))}\n"
        f"usarmjx sweep show {escape(str(folder))}\nusarmjx sweep report {escape(str(folder))}</pre>",
        f"<p>{len(found.keys)} cells; keys of their results are hashes of all that they read:</p>",
        f"<pre>{escape(' '.join(found.keys[:MOST_BUILDINGS]))}</pre>",
    ]
    head = f'<meta charset="utf-8"><title>{escape(found.name)}</title><style>{CSS}</style>'
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head>{head}</head><body>\n'
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def _source(found: StoredSweep) -> str:
    """Return the sweep as the command line names it: a bundled one, or its file."""
    return found.name if (BUNDLED / f"{found.name}.yaml").is_file() else f"{found.name}.yaml"


def _design(found: StoredSweep) -> list[tuple[str, str]]:
    rows: list[tuple[str, str]] = []
    names = dict.fromkeys(name for record in found.finished for name in record.settings)
    for name in names:
        if name in found.sampled:
            low, high = found.sampled[name]
            points = len({repr(record.settings.get(name)) for record in found.finished})
            rows.append((name, f"{points} points from {as_text(low)} to {as_text(high)}"))
            continue
        values = dict.fromkeys(as_text(record.settings.get(name, "as usual")) for record in found.finished)
        rows.append((name, ", ".join(values)))
    return rows


def _versions(found: StoredSweep) -> list[tuple[str, str]]:
    rows: dict[str, dict[str, None]] = {}
    for record in found.finished:
        for name, version in record.versions.items():
            rows.setdefault(name, {})[str(version)] = None
    listed = [(name, ", ".join(versions)) for name, versions in rows.items()]
    return [*listed, ("this page was made with Python", platform.python_version())]


def _buildings(found: StoredSweep) -> list[str]:
    """Return splits and buildings, with the hashes of their contents."""
    parts: list[str] = []
    for task in tasks_of(found):
        records = [record for record in found.finished if record.settings["task"] == task]
        splits = ", ".join(dict.fromkeys(record.split for record in records if record.split)) or "one arena"
        labels = list(dict.fromkeys(label for record in records for label in record.buildings))
        parts.append(f"<p>{escape(task)}: split {escape(splits)}, {len(labels)} buildings</p>")
        if labels:
            parts.append(f"<pre>{escape(' '.join(labels[:MOST_BUILDINGS]))}</pre>")
    return parts


def _blocks(text: str) -> list[str]:
    """Return lines and Markdown tables of a report as HTML."""
    parts: list[str] = []
    rows: list[list[str]] = []
    # The empty line ends a table that stands last.
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            rows.append([cell.strip() for cell in line.strip("|").split(" | ")])
            continue
        if rows:
            # Row 1 is the line of dashes below the head.
            parts.append(_table(rows[0], rows[2:]))
            rows = []
        if line:
            kind = ' class="warning"' if line.startswith(("warning:", "failed:")) else ""
            parts.append(f"<p{kind}>{escape(line)}</p>")
    return parts


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["<tr>" + "".join(f"<th>{escape(one)}</th>" for one in head) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{escape(one)}</td>" for one in row) + "</tr>" for row in rows]
    return "<table>" + "\n".join(lines) + "</table>"


def _svg(figure: Figure) -> str:
    """Return a figure as SVG that stands in a page."""
    target = io.StringIO()
    with figure_style():
        # Without a date: the same results give the same page.
        figure.savefig(target, format="svg", metadata={"Date": None})
    text = target.getvalue()
    # HTML has no place for the XML declaration before it.
    return text[text.index("<svg") :]


LATEX = {
    "&": r"\&",
    "%": r"\%",
    "_": r"\_",
    "#": r"\#",
    "$": r"\$",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
}


def latex_text(text: str) -> str:
    """Return text with the characters escaped that mean something to LaTeX."""
    return "".join(LATEX.get(one, r"\textbackslash{}" if one == "\\" else one) for one in text)


def _latex(found: Estimate) -> str:
    if not np.isfinite(found.value):
        return "--"
    if not np.isfinite(found.low):
        return f"{found.value:.3g}"
    return rf"{without_residue(found):.3g} ({found.low:.3g} to {found.high:.3g})"


def latex_tables(found: StoredSweep) -> str:
    """Return LaTeX tables: scores by task and method, differences, normalised scores; they need booktabs."""
    rows = [
        [
            latex_text(row.task),
            latex_text(row.policy),
            _latex(row.mean),
            _latex(row.middle),
            *(str(row.mean.drawn(name)) for name in ("buildings", "settings", "runs")),
        ]
        for row in overall_rows(found)
    ]
    head = [
        "task",
        "method",
        r"score, 95\,\% interval",
        "interquartile mean",
        "buildings",
        "settings",
        "runs",
    ]
    parts = [f"% {found.name}: needs \\usepackage{{booktabs}}", _tabular(head, rows, "llrrrrr")]
    differences = [
        [
            latex_text(row.task),
            latex_text(f"{row.first} less {row.second}"),
            _latex(row.gain),
            f"{row.p:.2g}",
            _latex(row.improvement),
        ]
        for row in policy_differences(found)
    ]
    if differences:
        names = [
            "task",
            "methods",
            r"difference, 95\,\% interval",
            "$p$ (Holm)",
            "probability of improvement",
        ]
        parts.append(_tabular(names, differences, "llrrr"))
    shares = [[latex_text(row.policy), _latex(row.mean), _latex(row.middle)] for row in aggregates(found)]
    if shares:
        parts.append(_tabular(["method", "normalised score", "interquartile mean"], shares, "lrr"))
    return "\n\n".join(parts) + "\n"


def _tabular(head: Sequence[str], rows: Sequence[Sequence[str]], columns: str) -> str:
    lines = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", " & ".join(head) + r" \\", r"\midrule"]
    lines += [" & ".join(row) + r" \\" for row in rows]
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}"])
