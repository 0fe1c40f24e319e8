"""The documentation as a site: built without a warning, complete, and without a request to another host."""

import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest

import dev
from tests.test_public_names import FACES, names_of, origin
from tools import documents

pytestmark = pytest.mark.tools

LOADS = {"script": "src", "img": "src", "iframe": "src", "source": "src", "link": "href", "video": "src"}
"""Elements that make a browser fetch what their attribute names."""


class Fetched(HTMLParser):
    """What a page makes a browser fetch, and the text of its styles."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag in LOADS and "canonical" not in (given.get("rel") or ""):
            self.addresses.append(given.get(LOADS[tag]) or "")
        self.addresses += re.findall(r"url\(([^)]*)\)", given.get("style") or "")

    def handle_data(self, data: str) -> None:
        if self.lasttag == "style":
            self.addresses += re.findall(r"(?:url\(|@import\s+[\"'])([^)\"']*)", data)


def foreign(page: str) -> list[str]:
    """Return what a page fetches from another host."""
    parser = Fetched()
    parser.feed(page)
    return [address for address in parser.addresses if re.match(r"[\"']?\s*(\w+:)?//", str(address))]


def page_names() -> list[str]:
    """Return the pages of the folder docs, without their suffix."""
    folder = dev.ROOT / "docs"
    return [path.relative_to(folder).with_suffix("").as_posix() for path in folder.rglob("*.md")]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("built") / "site"
    documents.build(folder)
    return folder


def test_names_in_tables_break_between_words():
    name = "tests/sim/test_drive.py::test_a_robot_against_a_wall"
    broken = documents.breakable(f"<p><code>{name}</code></p><td>see <code>{name}</code></td>")
    first, second = re.findall(r"<code>(.*?)</code>", broken)
    assert first == name
    pieces = second.split("<wbr>")
    assert "".join(pieces) == name
    assert pieces[:4] == ["tests/", "sim/", "test_", "drive.py::"]
    assert max(map(len, pieces)) < 12


def test_prompts_and_output_of_a_console_are_not_copied(site: Path):
    """The button takes what is seen while it copies; of a console that is what was typed."""
    style = (site / "assets" / "wide.css").read_text("utf-8")
    hidden = re.search(r"\[data-md-copying\] :is\(([^)]*)\) { display: none; }", style)
    assert hidden is not None
    classes = {name.strip(" .") for name in hidden[1].split(",")}
    (block,) = re.findall(r"<code>.*?</code>", (site / "start.html").read_text("utf-8"), re.S)[:1]
    marks = re.findall(r'<span class="(\w+)">(.*?)</span>', block)
    assert {text for kind, text in marks if kind in classes} == {"$ "}
    assert "data-md-copying" in "".join(
        p.read_text("utf-8") for p in site.glob("assets/javascripts/bundle*.js")
    )


def test_every_document_is_a_page(site: Path):
    pages = (
        path.relative_to(dev.ROOT / "docs").with_suffix("") for path in (dev.ROOT / "docs").rglob("*.md")
    )
    names = {path.as_posix() for path in pages} | {"contributing", "benchmarks"}
    assert sorted(name for name in names if not (site / f"{name}.html").is_file()) == []
    assert len(names) > 20


def test_every_page_is_in_the_list_of_pages(site: Path):
    start = (site / "index.html").read_text("utf-8")
    listed = {link.removeprefix("./") for link in re.findall(r'href="([^"]*)"', start)}
    assert [page for page in page_names() if f"{page}.html" not in listed] == []


def test_a_document_that_nobody_listed_is_listed_all_the_same():
    pages = {"index.md", "serving.md", "evidence/speed.md", "faq.md", "viewing.md"}
    assert documents.unlisted([{"How to": ["index.md", {"Serve": "serving.md"}]}], pages) == [
        "evidence/speed.md",
        "faq.md",
        "viewing.md",
    ]
    assert "- How to:" in documents.configuration({"zebra.md"}).split("zebra.md")[0]


def test_no_page_asks_another_host(site: Path):
    asked = {page.name: found for page in site.rglob("*.html") if (found := foreign(page.read_text("utf-8")))}
    assert asked == {}
    styles = "".join(path.read_text("utf-8") for path in site.rglob("*.css"))
    assert re.findall(r"@import[^;]*//|url\([\"']?(?:https?:)?//", styles) == []


def test_what_asks_another_host_is_found():
    page = """<link href="//fonts.example.org/a.css"><script src="https://example.org/x.js"></script>
        <img src="robots.png"><a href="https://example.org">far</a><style>p {background: url(http://e.org/b)}</style>"""
    assert len(foreign(page)) == 3


def test_no_block_of_code_is_left_as_text(site: Path):
    """A fence that Markdown does not understand shows its backticks."""
    pages = {page.name: page.read_text("utf-8") for page in site.glob("*.html")}
    assert [name for name, text in pages.items() if "```" in text] == []
    assert '<span class="filename">drive.py</span>' in pages["start.html"]


def test_links_inside_the_site_lead_somewhere(site: Path):
    """Also those that lead out of docs on a forge; the builder looks at anchors itself."""
    broken = {}
    for page in site.rglob("*.html"):
        links = re.findall(r"<a [^>]*href=\"([^\"#?]+)", page.read_text("utf-8"))
        near = [link for link in links if not re.match(r"\w+:", link)]
        if lost := {link for link in near if not (page.parent / link).exists()}:
            broken[page.name] = lost
    broken.pop("404.html", None)  # its links are absolute, for a server
    assert broken == {}


def test_search_knows_the_manuals_table_the_docstrings_and_all_options(site: Path):
    index = json.loads((site / "search.json").read_text("utf-8"))["items"]
    text = {entry["location"]: entry["text"] for entry in index}
    assert "GETSTARTPOSES" in text["conformance/5-running.html#start-poses"]
    assert "worlds" in text["api.html#usarmjx.Batch.reset"]
    assert "--viewer-port" in text["commands.html#usarmjx-serve"]
    assert not any(place.startswith("source/") for place in text)


def test_every_public_name_has_its_docstring_on_the_site(site: Path):
    page = (site / "api.html").read_text("utf-8")
    names = [(face, name) for face in FACES for name in names_of(face) if name != "__version__"]
    there = {origin(face, name) for face, name in names if f'id="{face}.{name}"' in page}
    assert [name for name in names if origin(*name) not in there] == []
    assert [
        name for name in names_of("usarmjx") if name[0] != "_" and f'id="usarmjx.{name}"' not in page
    ] == []


def test_search_works_without_a_server(site: Path):
    """From a file, the index comes as a script and a frame does the worker's work."""
    page = (site / "index.html").read_text("utf-8")
    assert 'src="./assets/iframe-worker.js"' in page
    assert (site / "search.js").is_file()


@pytest.mark.parametrize(
    ("path", "link", "there"),
    [
        ("docs/radio.md", "[x](../examples/radio_drive.py)", "[x](source/examples/radio_drive.py.md)"),
        ("docs/radio.md", "[x](../benchmarks/README.md#top)", "[x](benchmarks.md#top)"),
        (
            "docs/radio.md",
            "[x](serving.md#time) [y](https://e.org/a)",
            "[x](serving.md#time) [y](https://e.org/a)",
        ),
        ("CONTRIBUTING.md", "[x](docs/robots.md)", "[x](robots.md)"),
        ("benchmarks/README.md", "[x](../docs/training.md#results)", "[x](training.md#results)"),
        ("docs/a.md", "```text\n[x](../dev.py)\n```\n", "```text\n[x](../dev.py)\n```\n"),
        ("docs/a.md", "```ini a.ini\nx=1\n```\n", '```ini title="a.ini"\nx=1\n```\n'),
    ],
)
def test_pages_of_a_forge_become_those_of_the_site(path: str, link: str, there: str):
    assert documents.as_on_site(link, path) == there


# Notebooks


PAGE = """# Two and two

Begin with a file:

```ini a.ini
x=1
```

then add:

```python
print(2 + 2)
```

```output
4
```

```console
$ ls
```
"""


def test_a_page_as_a_notebook():
    cells = json.loads(documents.notebook(PAGE))["cells"]
    assert [cell["cell_type"] for cell in cells] == ["markdown", "code", "markdown", "code", "markdown"]
    assert cells[1]["source"] == ["%%writefile a.ini\n", "x=1"]
    assert cells[3]["source"] == ["print(2 + 2)"]
    assert cells[3]["outputs"] == [{"name": "stdout", "output_type": "stream", "text": ["4\n"]}]
    assert "".join(cells[4]["source"]).endswith("$ ls\n```")
    assert len({cell["id"] for cell in cells}) == 5


@pytest.mark.parametrize("page", documents.tutorials(), ids=lambda page: page.stem)
def test_the_notebook_of_a_tutorial_is_its_page(page: Path):
    """After a change: `python3 dev.py docs`. tests/test_docs.py executes the page."""
    text = page.read_text(encoding="utf-8")
    assert documents.tutorials()[page].read_text(encoding="utf-8") == documents.notebook(text)
    assert f"]({page.stem}.ipynb)" in text
