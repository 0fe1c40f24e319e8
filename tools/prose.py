"""Counts of the documentation: words, length of sentences, and words that must not come back.

`python3 dev.py docs` runs it; `python -m tools.prose` prints a table of all pages. Generated pages, the
records of docs/evidence and the contract tables count apart. Docstrings of the package begin with a noun or a
verb; no clause stands for a noun in messages, help texts and headings.
"""

import ast
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GENERATED = (
    "all-robots",
    "all-sensors",
    "all-settings",
    "api",
    "commands",
    "leaderboard",
    "training-settings",
)
CONTRACTS = ("conformance/", "conformance-udk", "evidence/")
"""Begins of the names of pages that are tables: contracts and records."""
MAX_WORDS = 45_000
"""Of all hand-written pages together, with README and CONTRIBUTING."""
PAGE_WORDS = {"training": 2_000, "tasks": 2_000, "fidelity": 2_000, "design": 2_000, "serving": 2_000}
MAX_MEAN = 25.0
"""Words of a sentence, in the mean of a page."""
BANNED = (
    r"by[ -]hand",
    r"(?:is|are|was|were) told",
    r"so many",
    r"shipped",
    r"^(?:What|Who|Whoever)\b[^?]*$",
    r"^Where\b[^?,]*$",
)
"""Expressions that a rewrite removed: private words, and sentences whose subject is a clause."""

CLAUSE = re.compile(r"(?:What|Who|Whoever|Where|How|So (?:many|much|long|often))\b[^?]*$", re.DOTALL)
"""First sentence of a docstring that is a clause, where a noun with its unit belongs."""
NOUN_CLAUSE = re.compile(
    r"\b(?:what|who|whoever|whom)\b"
    r"|\bhow (?:far|many|much|long|often|fast|early|difficult|well|good|soon|old|to)\b"
    r"|\b(?:say|says|tell|tells|know|show|shows|name|names|see|to|of) where\b"
    r"|\bso (?:many|much)\b"
    r"|^(?:where|how)\b",
    re.IGNORECASE,
)
"""Clause in the place of a noun in a message or a help text; a question may have one."""
APART = ("usarmjx/view/", "usarmjx/server/viewing/")
"""Folders and pages of the live page, whose texts are not checked."""

FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
COMMENT = re.compile(r"<!-- ?(settings of|usarmjx bench report).*?<!-- end.*?-->", re.DOTALL)
LINK = re.compile(r"!?\[([^\]]*)\]\([^)]*\)")
WORD = re.compile(r"[A-Za-z0-9][\w'./%-]*")
SENTENCE = re.compile(r"(?<=[.!?:])\s+(?=[A-Z`\"])")


@dataclass(frozen=True)
class Page:
    """Counts of a page.

    Attributes:
        name: File without its suffix, below docs.
        words: Words of text and tables, without code.
        mean: Mean number of words of a sentence of running text; 0 without sentences.
        banned: Expressions of `BANNED` on it, as they stand there.
    """

    name: str
    words: int
    mean: float
    banned: tuple[str, ...]


def text_of(markdown: str) -> str:
    """Return a page without code, generated blocks and targets of links."""
    text = COMMENT.sub("", FENCE.sub("", markdown))
    return LINK.sub(r"\1", text)


def sentences(text: str) -> list[str]:
    """Return the sentences of the running text: no headings, no tables; an item of a list stands alone."""
    paragraphs = re.split(r"\n\s*\n|\n(?=[-*] )", text)
    prose = [" ".join(one.split()) for one in paragraphs if not re.match(r"\s*(#|\||<)", one)]
    return [sentence for one in prose for sentence in SENTENCE.split(one) if WORD.search(sentence)]


def page_of(name: str, markdown: str) -> Page:
    """Count a page."""
    text = text_of(markdown)
    parts = sentences(text)
    counts = [len(WORD.findall(part)) for part in parts]
    found = [match[0] for pattern in BANNED for part in parts for match in re.finditer(pattern, part)]
    mean = sum(counts) / len(counts) if counts else 0.0
    return Page(name, len(WORD.findall(text)), mean, tuple(found))


def pages() -> list[Page]:
    """Return the counts of all pages of docs, of README and of CONTRIBUTING."""
    docs = ROOT / "docs"
    named = {path.relative_to(docs).with_suffix("").as_posix(): path for path in sorted(docs.rglob("*.md"))}
    named |= {name: ROOT / f"{name}.md" for name in ("README", "CONTRIBUTING")}
    return [page_of(name, path.read_text(encoding="utf-8")) for name, path in named.items()]


def is_written(name: str) -> bool:
    """Return whether a page counts as hand-written text."""
    return name not in GENERATED and not name.startswith(CONTRACTS)


def faults(found: list[Page]) -> list[str]:
    """Return what is too long or uses a word that must not come back, a line each."""
    total = sum(page.words for page in found if is_written(page.name))
    lines = [f"hand-written pages have {total:,} words, at most {MAX_WORDS:,}"] if total > MAX_WORDS else []
    for page in found:
        most = PAGE_WORDS.get(page.name)
        if most is not None and page.words > most:
            lines.append(f"docs/{page.name}.md has {page.words:,} words, at most {most:,}")
        if is_written(page.name) and page.mean > MAX_MEAN:
            lines.append(f"{page.name}: {page.mean:.1f} words in the mean sentence, at most {MAX_MEAN:g}")
        if is_written(page.name):
            lines += [f"{page.name}: {words!r} must not come back" for words in page.banned]
    return lines


def clauses(program: str) -> list[tuple[int, str]]:
    """Return docstrings, and strings below constants, whose first sentence is a clause; with their lines."""
    found: list[tuple[int, str]] = []
    for node in ast.walk(ast.parse(program)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
            text = node.value.value
            first = re.split(r"(?<=[.!?])\s|\n\s*\n", text.strip())[0] if isinstance(text, str) else ""
            if CLAUSE.match(first):
                found.append((node.lineno, " ".join(first.split())))
    return found


def docstring_faults(package: Path = ROOT / "usarmjx") -> list[str]:
    """Return the docstrings of a package that begin with a clause, a line each."""
    return [
        f"{path.relative_to(package.parent)}:{line}: {text!r} is a clause, not a noun and its unit"
        for path in sorted(package.rglob("*.py"))
        for line, text in clauses(path.read_text(encoding="utf-8"))
    ]


def messages(program: str) -> list[tuple[int, str]]:
    """Return texts with a `NOUN_CLAUSE` in a program, but docstrings and single words; with their lines."""
    tree = ast.parse(program)
    parts = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    parts |= {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    found: list[tuple[int, str]] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant | ast.JoinedStr) and id(node) not in parts:
            text = " ".join(_literal(node).split())
            if " " in text and "?" not in text and NOUN_CLAUSE.search(text):
                found.append((node.lineno, text))
    return found


def _literal(node: ast.expr) -> str:
    """Return the text of a literal, with braces for values of a format."""
    if isinstance(node, ast.JoinedStr):
        return "".join(_literal(part) for part in node.values)
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    return "{}"


def message_faults(folders: Sequence[Path] = (ROOT / "usarmjx", ROOT / "benchmarks")) -> list[str]:
    """Return the texts of programs in which a clause stands for a noun, a line each."""
    found: list[str] = []
    for path in sorted(path for folder in folders for path in folder.rglob("*.py")):
        place = path.relative_to(ROOT).as_posix()
        if not place.startswith(APART):
            found += [
                f"{place}:{line}: {text[:120]!r} has a clause in the place of a noun"
                for line, text in messages(path.read_text(encoding="utf-8"))
            ]
    return found


def help_faults() -> list[str]:
    """Return the help texts of commands and options in which a clause stands for a noun, a line each."""
    from usarmjx.cli.app import app
    from usarmjx.cli.listing import commands_of

    found: list[str] = []
    for path, command in commands_of(app):
        helps = [("", command.help), *((one.name, getattr(one, "help", None)) for one in command.params)]
        found += [
            f"usarmjx {path} --help: {name or 'summary'} has a clause in the place of a noun: "
            f"{' '.join(text.split())[:120]!r}"
            for name, text in helps
            if text and NOUN_CLAUSE.search(" ".join(text.split()))
        ]
    return found


def heading_faults() -> list[str]:
    """Return the headings of written pages that are clauses and no questions, a line each."""
    docs = ROOT / "docs"
    paths = [*sorted(docs.rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
    found: list[str] = []
    for path in paths:
        text = FENCE.sub("", path.read_text(encoding="utf-8"))
        place = path.relative_to(ROOT).as_posix()
        heads = [] if place in APART else re.findall(r"^#+ (.*)$", text, re.MULTILINE)
        found += [f"{place}: heading {head!r} is a clause" for head in heads if CLAUSE.match(head)]
    return found


def main() -> None:
    """Print the counts; exit with 1 if a page is at fault."""
    found = pages()
    for page in sorted(found, key=lambda page: -page.words):
        kind = "" if is_written(page.name) else "  (apart)"
        print(f"{page.words:7,} {page.mean:5.1f} {len(page.banned):3}  {page.name}{kind}")
    print(f"{sum(page.words for page in found if is_written(page.name)):7,} words hand-written")
    clauses_found = [*docstring_faults(), *message_faults(), *help_faults(), *heading_faults()]
    if wrong := [*faults(found), *clauses_found]:
        sys.exit("\n".join(wrong))


if __name__ == "__main__":
    main()
