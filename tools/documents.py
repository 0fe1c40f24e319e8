"""What makes a site and notebooks of the folder docs; `python3 dev.py docs` runs it.

MkDocs calls the functions that begin with `on_`. Pages link to files of the repository as they do on a forge:
on the site such a file is a page of its own, out of the search.
"""

import json
import os
import posixpath
import re
import sys
from pathlib import Path
from typing import Any

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


def on_config(config: Any) -> Any:  # noqa: ANN401 - MkDocs' own
    """Put pages of which the list of pages does not know to the others that tell how."""
    named = set(re.findall(r"[\w/-]+\.md", json.dumps(config.nav)))
    (how_to,) = (part["How to"] for part in config.nav if "How to" in part)
    there = {path.relative_to(ROOT / "docs").as_posix() for path in (ROOT / "docs").rglob("*.md")}
    how_to += sorted(there - named)
    return config


def on_files(files: Any, config: Any) -> Any:  # noqa: ANN401 - MkDocs' own
    """Add pages for what the documents link to outside of docs."""
    from mkdocs.structure.files import File

    waiting = [f"docs/{file.src_uri}" for file in files.documentation_pages()]
    waiting += [path for path in PAGES if path != "README.md"]
    seen = set(waiting)
    for path in waiting:
        text = (ROOT / path).read_text(encoding="utf-8")
        if path in PAGES:
            files.append(File.generated(config, PAGES[path], content=as_on_site(text, path)))
        for target in sorted(targets(text, path) - seen):
            if not target.startswith("docs/") and target not in PAGES:
                seen.add(target)
                files.append(File.generated(config, place_on_site(target), content=source_page(target)))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:  # noqa: ANN401 - MkDocs' own
    """Turn links out of docs into links to the pages of these files."""
    if page.file.generated_by:
        return markdown
    return as_on_site(markdown, f"docs/{page.file.src_uri}")


def on_page_content(html: str, page: Any, config: Any, files: Any) -> str:  # noqa: ANN401 - MkDocs' own
    """Let long names in tables be broken where a reader would break them."""
    del page, config, files
    return CELL.sub(lambda cell: NAME.sub(lambda code: BREAK.sub(r"\g<0><wbr>", code[0]), cell[0]), html)


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
    """Write the notebooks and build the site; a warning is an error."""
    os.environ.setdefault("NO_MKDOCS_2_WARNING", "1")  # of the theme's makers, about their next product
    from mkdocs.__main__ import cli

    for page, copy in tutorials().items():
        copy.write_text(notebook(page.read_text(encoding="utf-8")), encoding="utf-8")
    cli(["build", "--strict", "--quiet", "--config-file", str(ROOT / "mkdocs.yml"), *sys.argv[1:]])


if __name__ == "__main__":
    main()
