"""The site and the notebooks of the folder docs; `python3 dev.py docs` makes them.

Pages link to files of the repository as they do on a forge: on the site such a file is a page of its own,
out of the search. Zensical builds the site from a folder of pages whose links lead there.
"""

import json
import posixpath
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parents[1]
FENCE = re.compile(r"(^```.*?^```)", re.MULTILINE | re.DOTALL)
NAMED = re.compile(r"^```(\w+) (\S+)$", re.MULTILINE)
LINK = re.compile(r"\]\(([^)#\s]+)")
CELL, NAME = re.compile(r"<td\b.*?</td>", re.DOTALL), re.compile(r"(?<=<code>)[^<]{25,}(?=</code>)")
BREAK = re.compile(r"(?:::|[/_])(?=\w)")
PAGES = {
    "CHANGELOG.md": "changes.md",
    "CONTRIBUTING.md": "contributing.md",
    "benchmarks/README.md": "benchmarks.md",
    "README.md": "index.md",
}
"""Where documents of other folders are on the site."""


def place_on_site(path: str) -> str:
    """Return the address on the site of a file of the repository, both from their roots."""
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    return PAGES.get(path) or f"source/{path}.md"


def targets(text: str, path: str) -> set[str]:
    """Return the files of the repository that a document at this path links to."""
    found = {link for part in FENCE.split(text)[::2] for link in LINK.findall(part)}
    folder = posixpath.dirname(path)
    return {posixpath.normpath(posixpath.join(folder, link)) for link in found if not re.match(r"\w+:", link)}


def as_on_site(text: str, path: str) -> str:
    """Return a document at this path of the repository with links and names of files as the site has them."""
    here = posixpath.dirname(place_on_site(path)) or "."

    def moved(match: re.Match[str]) -> str:
        if re.match(r"\w+:", match[1]):
            return match[0]
        target = posixpath.normpath(posixpath.join(posixpath.dirname(path), match[1]))
        return f"]({posixpath.relpath(place_on_site(target), here)}"

    parts = FENCE.split(text)
    parts[::2] = [LINK.sub(moved, part) for part in parts[::2]]
    parts[1::2] = [NAMED.sub(r'```\1 title="\2"', part, count=1) for part in parts[1::2]]
    return "".join(parts)


def source_page(path: str) -> str:
    """Return the page of a file of the repository, or of a folder: the names in it."""
    file = ROOT / path
    if file.is_dir():
        body = "\n".join(sorted(entry.name for entry in file.iterdir() if entry.name[0] not in "._"))
        language = "text"
    else:
        body, language = file.read_text(encoding="utf-8").rstrip(), file.suffix[1:]
    settings = "---\nsearch: {exclude: true}\nhide: [navigation]\n---\n"
    return f"{settings}\n# {path}\n\n````{language}\n{body}\n````\n"


def unlisted(nav: list[dict[str, Any] | str], there: set[str]) -> list[str]:
    """Return the pages of docs that the list of pages does not name, in order."""
    return sorted(there - set(re.findall(r"[\w/-]+\.md", json.dumps(nav))))


def configuration(pages: set[str]) -> str:
    """Return mkdocs.yml for staged pages: those of `pages` that it does not list come last in How to."""
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    nav = yaml.safe_load(text[text.index("\nnav:\n") :])["nav"]
    (how_to,) = (part["How to"] for part in nav if "How to" in part)
    how_to += unlisted(nav, pages)
    head = text[: text.index("\nnav:\n")].replace("paths: [.]", f"paths: [{json.dumps(str(ROOT))}]")
    return head + "\n" + yaml.safe_dump({"nav": nav})


def stage(folder: Path) -> None:
    """Write all pages of the site and its configuration into a folder, which is emptied before.

    Beside the pages of docs these are documents of other folders and the files that a page links to.
    """
    shutil.rmtree(folder, ignore_errors=True)
    docs = folder / "docs"
    shutil.copytree(ROOT / "docs", docs, ignore=shutil.ignore_patterns("*.md"))
    pages = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    waiting = [f"docs/{page}" for page in sorted(pages)] + [path for path in PAGES if path != "README.md"]
    contents: dict[str, str] = {}
    for path in waiting:
        text = (ROOT / path).read_text(encoding="utf-8")
        contents[place_on_site(path)] = as_on_site(text, path)
        for target in sorted(targets(text, path)):
            if not target.startswith("docs/") and target not in PAGES:
                contents.setdefault(place_on_site(target), source_page(target))
    for place, text in contents.items():
        (docs / place).parent.mkdir(parents=True, exist_ok=True)
        (docs / place).write_text(text, encoding="utf-8")
    (folder / "mkdocs.yml").write_text(configuration(pages), encoding="utf-8")


def breakable(html: str) -> str:
    """Let long names in tables be broken where a reader would break them."""
    return CELL.sub(lambda cell: NAME.sub(lambda code: BREAK.sub(r"\g<0><wbr>", code[0]), cell[0]), html)


def build(site: Path) -> None:
    """Build the site in a folder that does not exist yet, by way of staged pages; a warning is an error.

    Raises:
        SystemExit: The builder found a fault; its words are on the error stream.
    """
    folder = site.with_name("pages")
    stage(folder)
    command = [sys.executable, "-m", "zensical", "build", "--strict", "--config-file"]
    done = subprocess.run([*command, str(folder / "mkdocs.yml")], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{done.stdout}{done.stderr}")
    (folder / "site").rename(site)
    for page in site.rglob("*.html"):
        page.write_text(breakable(page.read_text(encoding="utf-8")), encoding="utf-8")


# Notebooks: a tutorial is a page whose blocks the tests execute, and the same as a notebook beside it.


def notebook(text: str) -> str:
    """Return a page as a notebook: python blocks and named files as code, output blocks as what it prints."""
    cells: list[dict[str, Any]] = []
    for part in FENCE.split(text):
        head, _, body = part.partition("\n")
        language, _, name = head.removeprefix("```").partition(" ")
        body = body.removesuffix("```").rstrip("\n")
        if head.startswith("```output"):
            cells[-1]["outputs"] = [{"name": "stdout", "output_type": "stream", "text": lines(body + "\n")}]
        elif head.startswith("```") and (name or language == "python"):
            code = f"%%writefile {name}\n{body}" if name else body
            cells.append({"cell_type": "code", "execution_count": None, "outputs": [], "source": lines(code)})
        elif head.startswith("```") and cells[-1]["cell_type"] == "markdown":
            cells[-1]["source"] += lines(f"\n\n{part}")
        elif part.strip():
            cells.append({"cell_type": "markdown", "source": lines(part.strip())})
    for number, cell in enumerate(cells):
        cell |= {"id": f"cell-{number}", "metadata": {}}
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def lines(text: str) -> list[str]:
    """Return the lines of a cell as notebooks keep them: each with its end but for the last one's."""
    return text.splitlines(keepends=True)


def tutorials() -> dict[Path, Path]:
    """Return the notebook of each tutorial."""
    return {page: page.with_suffix(".ipynb") for page in sorted((ROOT / "docs").glob("tutorial-*.md"))}


def main() -> None:
    """Write the notebooks and build the site."""
    for page, copy in tutorials().items():
        copy.write_text(notebook(page.read_text(encoding="utf-8")), encoding="utf-8")
    site = ROOT / "build" / "site"
    shutil.rmtree(site, ignore_errors=True)
    build(site)


if __name__ == "__main__":
    main()
