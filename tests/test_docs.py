"""The documents tell the truth: links lead somewhere, examples run, commands exist.

In a fenced block, ```python is executed (as doctests if it has prompts), ```console holds commands
after "$ " and ```bash nothing but commands. A block with a file's name behind its language, ```ini a.ini, is
that file in the folder where the page's examples run. ```output is what the ```python before it prints.
Anything else, ```text for instance, is not looked at.
"""

import contextlib
import doctest
import io
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from _pytest.mark.structures import ParameterSet
from typer.testing import CliRunner

import dev
import usarmjx
from tools import prose

FOLDERS = (".", "docs", "docs/conformance", "docs/evidence", "examples", "benchmarks")
DOCUMENTS = sorted({path for folder in FOLDERS for path in (dev.ROOT / folder).glob("*.md")})
FENCE = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```", re.MULTILINE | re.DOTALL)
NAMED = re.compile(r"^```\w+ (\S+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\(([^)#\s]+)[^)]*\)|(?:src|href)=\"([^\"#]+)")


def blocks(text: str, *languages: str) -> list[str]:
    """Return the fenced blocks of these languages, in order."""
    return [body for language, body in FENCE.findall(text) if language in languages]


def broken_links(text: str, folder: Path) -> list[str]:
    """Return the relative links to files that do not exist."""
    targets = [first or second for first, second in LINK.findall(FENCE.sub("", text))]
    relative = [target for target in targets if not re.match(r"\w+:", target)]
    return [target for target in relative if not (folder / target).exists()]


def commands(text: str) -> list[list[str]]:
    """Return the command lines of the console and bash blocks, split into words."""
    lines = [
        line.removeprefix("$ ")
        for body in blocks(text, "console")
        for line in body.splitlines()
        if line.startswith("$ ")
    ]
    lines += [line for body in blocks(text, "bash", "sh") for line in body.splitlines()]
    return [words for line in lines if (words := shlex.split(line, comments=True))]


def run_python(body: str, names: dict[str, object], document: str) -> None:
    """Execute a block; with prompts, compare what it shows."""
    if ">>>" not in body:
        exec(compile(body, document, "exec"), names)
        return
    test = doctest.DocTestParser().get_doctest(body, names, document, document, 0)
    runner = doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE)
    shown: list[str] = []
    failures = runner.run(test, out=shown.append, clear_globs=False).failed
    names.update(test.globs)
    assert not failures, "".join(shown)


def run_page(text: str, document: str) -> None:
    """Execute the python blocks of a page, and compare what they print with the output blocks."""
    names: dict[str, object] = {"__name__": Path(document).stem}
    printed = ""
    for language, body in FENCE.findall(text):
        if language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as screen:
                run_python(body, names, document)
            printed = screen.getvalue()
        elif language == "output":
            flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
            assert doctest.OutputChecker().check_output(body, printed, flags), (
                f"{document} prints:\n{printed}"
            )


def compile_examples(text: str, document: str) -> int:
    """Compile the Python blocks of a page without running them, and return how many there are.

    Raises:
        SyntaxError: A block is no program.
    """
    bodies = blocks(text, "python")
    for body in bodies:
        parts = doctest.DocTestParser().get_examples(body)
        compile("".join(part.source for part in parts) if parts else body, document, "exec")
    return len(bodies)


def command_problem(words: list[str]) -> str:
    """Return what is wrong with a command that names dev.py or usarmjx, else ""."""
    if words[:2] in (["python3", "dev.py"], ["python", "dev.py"]):
        verb = words[2] if len(words) > 2 else ""
        return "" if verb in (*dev.VERBS, "--help") else f"dev.py has no verb {verb!r}"
    if words[0] != "usarmjx":
        return ""
    from usarmjx.cli.app import app

    path = []  # the verb, and what it is a verb of
    for word in words[1:3]:
        if word.startswith("-") or ".py" in word:  # a task of a file of one's own is read for its help
            break
        path.append(word)
    # A wide terminal: a narrow one wraps and cuts the names of options.
    settings = {"COLUMNS": "200", "TERM": "dumb", "NO_COLOR": "1"}
    result = CliRunner().invoke(app, [*path, "--help"], env=settings)
    if result.exit_code:
        return f"usarmjx has no verb {path}: {result.output}"
    options = {word.split("=")[0] for word in words[1:] if word.startswith("--")}
    unknown = sorted(option for option in options if option not in result.output)
    return f"usarmjx {' '.join(path)} has no {unknown}" if unknown else ""


def name_of(path: Path) -> str:
    return str(path.relative_to(dev.ROOT))


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_links_lead_to_files(path: Path):
    assert broken_links(path.read_text(encoding="utf-8"), path.parent) == []


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder for what examples read; what they register leaves with them."""
    import usarmjx.sim.configure  # noqa: F401 - fills the registries before they are copied
    from usarmjx.models.arenas import ARENAS
    from usarmjx.models.effecters import EFFECTERS
    from usarmjx.models.robots import ROBOTS
    from usarmjx.sensors.base import SENSORS
    from usarmjx.train.baselines import BASELINES
    from usarmjx.train.tasks import TASKS

    for registry in (ROBOTS, EFFECTERS, SENSORS, ARENAS, BASELINES, TASKS):
        monkeypatch.setattr(registry, "_entries", dict(registry._entries))
        monkeypatch.setattr(registry, "_aliases", dict(registry._aliases))
    monkeypatch.chdir(tmp_path)
    return tmp_path


LONG = (
    "cameras",
    "radio",
    "robots",
    "sensors",
    "start",
    "stacks",
    "tutorial-sweep",
    "tutorial-task",
    "tutorial-watching",
)
"""Pages whose examples compile for five seconds and more: every run only reads them as programs."""


def long_ones_are_thorough(path: Path) -> ParameterSet:
    """A page; its examples run in `dev.py test --all` if they are long."""
    is_long = path.parent.name == "docs" and path.stem in LONG
    return pytest.param(path, marks=pytest.mark.thorough if is_long else (), id=name_of(path))


def test_python_examples_are_programs():
    """Examples import public names only: tests/test_public_names.py."""
    assert sum(compile_examples(path.read_text(encoding="utf-8"), name_of(path)) for path in DOCUMENTS) > 40


@pytest.mark.parametrize("path", [long_ones_are_thorough(path) for path in DOCUMENTS])
def test_python_examples_run(path: Path, workplace: Path):
    text = path.read_text(encoding="utf-8")
    for name, body in NAMED.findall(text):
        (workplace / name).write_text(body, encoding="utf-8")
    run_page(text, name_of(path))


@pytest.mark.parametrize("path", DOCUMENTS, ids=name_of)
def test_commands_exist(path: Path):
    lines = commands(path.read_text(encoding="utf-8"))
    assert [problem for words in lines if (problem := command_problem(words))] == []


# The checks above must be able to fail.

SAMPLE = """
See [here](here.md#part), [there](there.md "title"), [far](https://example.org/x.md), [top](#top)
and <img src="shot.png">.

```text
[not](a-link.md)
```

```console
$ python3 dev.py dance --fast  # a comment
not a command
```

```bash
python3 dev.py demo
```

```python
>>> 1 + 1
3
```
"""


def test_missing_targets_are_found(tmp_path: Path):
    (tmp_path / "here.md").touch()
    assert broken_links(SAMPLE, tmp_path) == ["there.md", "shot.png"]


def test_wrong_commands_are_found():
    lines = commands(SAMPLE)
    assert lines == [["python3", "dev.py", "dance", "--fast"], ["python3", "dev.py", "demo"]]
    assert [command_problem(words) for words in lines] == ["dev.py has no verb 'dance'", ""]


def test_wrong_examples_are_found():
    (body,) = blocks(SAMPLE, "python")
    with pytest.raises(AssertionError, match="Expected:"):
        run_python(body, {}, "sample")
    with pytest.raises(ZeroDivisionError):
        run_python("1 / 0", {}, "sample")


def test_what_is_no_program_is_found():
    assert compile_examples("```python\n>>> 1 +\\\n...  1\n2\n```\n", "sample") == 1
    for wrong in ("x = = 1", ">>> x = = 1"):
        with pytest.raises(SyntaxError):
            compile_examples(f"```python\n{wrong}\n```\n", "sample")


def test_wrong_output_is_found():
    page = "```python\nprint('a', 1 / 3)\n```\n\n```output\na 0.33...\n```\n"
    run_page(page, "sample")
    with pytest.raises(AssertionError, match=r"sample prints:\s+a 0\.33"):
        run_page(page.replace("a 0.33...", "a 0.34"), "sample")


def test_examples_of_a_document_share_names():
    names: dict[str, object] = {}
    run_python("x = 20", names, "sample")
    run_python(">>> y = x + 1\n>>> y\n21\n", names, "sample")
    run_python("assert y == 21", names, "sample")


def test_the_page_of_all_robots_is_the_generated_one():
    """After a change: `usarmjx list robots --markdown > docs/all-robots.md`, and `usarmjx portraits`."""
    from usarmjx.cli.catalogue import robots_table

    assert (dev.ROOT / "docs" / "all-robots.md").read_text() == robots_table() + "\n"


def test_the_first_controller_drives_up_to_a_wall(workplace: Path):
    """docs/start.md, word for word but for the port."""
    (script,) = re.findall(
        r"^```py drive.py\n(.*?)^```", (dev.ROOT / "docs/start.md").read_text(), re.M | re.S
    )
    assert script.count("port=3000") == script.count("{ahead:.2f}") == 1
    script = script.replace("{ahead:.2f}", "{ahead:.6f}")  # 0.496 would be printed as 0.50
    with usarmjx.serve("yellow", port=0, realtime_factor=4.0) as server:
        (workplace / "drive.py").write_text(script.replace("port=3000", f"port={server.port}"))
        done = subprocess.run([sys.executable, "drive.py"], capture_output=True, text=True, timeout=120)
    assert done.stderr == ""
    ahead = [float(line.split()[2]) for line in done.stdout.splitlines()]
    assert ahead[0] > 1.0
    assert ahead[-1] < 0.5 <= min(ahead[:-1])


def test_pages_are_short_and_plain():
    """`python -m tools.prose` prints the counts."""
    assert prose.faults(prose.pages()) == []


def test_long_pages_and_words_that_must_not_come_back_are_found():
    long = "One two three. " * 700 + "\n\n```console\n$ not counted\n```\n\n| in a | table |\n"
    page = prose.page_of(
        "training", long + "\n" + "word " * 2500 + "made by hand.\n\nWhat flies is an AirRobot.\n"
    )
    assert page.words == 2100 + 3 + 2500 + 3 + 5
    assert page.banned == ("by hand", "What flies is an AirRobot.")
    assert prose.faults([page]) == [
        "docs/training.md has 4,611 words, at most 2,000",
        "training: 'by hand' must not come back",
        "training: 'What flies is an AirRobot.' must not come back",
    ]
    assert "training: 2503.0 words" in prose.faults([prose.page_of("training", "word " * 2503 + ".")])[1]
    assert prose.page_of("faq", "**What is it?** A simulator. Where worlds end, others begin.").banned == ()


def test_docstrings_begin_with_the_thing_itself():
    program = (
        'A = 1\n"""How far it goes [m]."""\ndef ask():\n    """Where is it? Ask."""\nB = "What it is."\n'
    )
    assert prose.clauses(program) == [(2, "How far it goes [m].")]
    assert prose.docstring_faults() == []


def test_no_clause_stands_for_a_noun_in_messages_help_texts_and_headings():
    program = (
        '"""What it does."""\nsay("What to do?")\nsay(f"{n} rows, and what {n} are")\nsay("what")\n'
        'say("pick " "whoever comes")\nraise UsageError("say where to write")\n'
        'say("Where it is dark, wait.")\n'
    )
    found = prose.messages(program)
    assert [line for line, _ in found] == [3, 5, 6, 7]
    assert found[0] == (3, "{} rows, and what {} are")
    assert prose.messages('say("a page in a browser, where one can")\nHELP = "the robot that waits"\n') == []
    assert prose.message_faults() == []
    assert prose.help_faults() == []
    assert prose.heading_faults() == []


def test_cards_of_tasks_agree_with_the_tasks():
    """Each task has a card with its steps, its policies, and the sizes of what the policy sees and does."""
    from usarmjx.train.policies import POLICIES
    from usarmjx.train.policies.policy_file import read_arrays
    from usarmjx.train.tasks import TASKS

    def sections(page):
        text = (dev.ROOT / "docs" / page).read_text(encoding="utf-8")
        return dict(re.findall(r"^## ([\w-]+)\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL))

    cards, versions = sections("tasks.md"), sections("tasks-teams.md")
    assert {re.sub(r"-v\d$", "", name) for name in TASKS.names()} == set(cards)
    for name, task in TASKS:
        card = cards[re.sub(r"-v\d$", "", name)] + versions.get(name, "")
        policy = name in POLICIES.names()
        version = name[-1] if re.search(r"-v\d$", name) else "1"
        later = f"version {version}: {task.episode_steps}" in card
        assert later or f"| {task.episode_steps} steps of" in card, name
        assert policy <= ("| packaged policy | none" not in card), name
        if policy:
            for group in read_arrays(POLICIES.get(name))[0]["groups"]:
                sizes = f"| observation ({group['obs_size']}) |", f"| action ({group['action_size']}) |"
                assert all(size in card for size in sizes), name


def test_numbers_of_robots_and_arenas_on_the_first_pages_are_those_of_the_registries():
    from usarmjx.models.arenas import ARENAS
    from usarmjx.models.robots import ROBOTS

    words = {9: "Nine", 12: "Twelve", 13: "Thirteen", 14: "Fourteen"}
    pages = {
        name: (dev.ROOT / name).read_text("utf-8") for name in ("README.md", "docs/index.md", "docs/faq.md")
    }
    assert f"{len(ROBOTS.names())} classes of robots" in pages["README.md"]
    assert f"All {len(ROBOTS.names())} of the manual" in pages["docs/index.md"]
    for page in ("docs/index.md", "docs/faq.md"):
        assert f"{words[len(ARENAS.names())]} " in pages[page], page


def test_what_the_first_page_compares_stands_in_the_document_of_its_figures():
    figures = (dev.ROOT / "docs/performance.md").read_text(encoding="utf-8")
    readme = (
        (dev.ROOT / "README.md").read_text(encoding="utf-8").split("## Beside others")[1].split("\n## ")[0]
    )
    rows = [line for line in readme.splitlines() if line.startswith("|")]
    assert len(rows) > 5
    assert [row for row in rows if row not in figures] == []
