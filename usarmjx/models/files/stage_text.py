"""World files of the Stage simulator as models with properties: includes, definitions and inheritance."""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from usarmjx.base.errors import ArenaFileError
from usarmjx.base.settings.files import read_bytes

MAX_STAGE_TOKENS = 500_000
"""Largest number of words of a file, its includes with it."""
MAX_STAGE_MODELS = 20_000
"""Largest number of models, those of definitions as often as they are used."""
MAX_STAGE_DEPTH = 50
"""Largest depth of models in models, of includes, and of definitions by others."""
TOKEN = re.compile(
    r"""(?P<space>[ \t\r\f\v,;]+|\#[^\n]*)|(?P<line>\n)|"(?P<string>[^"\n]*)"
    |(?P<number>[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)(?![A-Za-z_])
    |(?P<word>[A-Za-z_][\w.\-]*(?:\[\d+\][\w.\-]*)*)|(?P<sign>[()\[\]])""",
    re.VERBOSE,
)
Scalar = str | float
"""Word or number."""


@dataclass(frozen=True, kw_only=True)
class StageToken:
    """A word, number, text or bracket of a file.

    Attributes:
        kind: One of string, number, word, sign.
        text: Its text, without quotes.
        place: File and line.
    """

    kind: str
    text: str
    place: str

    def error(self, text: str) -> ArenaFileError:
        """Return an error about it."""
        return ArenaFileError(f"{self.place}: {text}")


@dataclass(frozen=True, kw_only=True)
class StageProperty:
    """Values of a property.

    Attributes:
        name: Its name.
        values: Its values: one, or those of a tuple.
        place: File and line.
        folder: Folder of its file: other files are named from there.
    """

    name: str
    values: tuple[Scalar, ...]
    place: str
    folder: Path


@dataclass(kw_only=True)
class StageModel:
    """A model with what it inherits.

    Attributes:
        kind: Stage's own type that it is.
        word: Word that makes it in the file.
        properties: Its properties by name, the last one of a name.
        children: Models on it, and blocks.
        place: File and line.
    """

    kind: str
    word: str
    place: str
    properties: dict[str, StageProperty] = field(default_factory=dict[str, StageProperty])
    children: "list[StageModel]" = field(default_factory=list["StageModel"])

    def error(self, text: str) -> ArenaFileError:
        """Return an error about it."""
        return ArenaFileError(f"{self.place}: {text}")

    def text(self, name: str, default: str = "") -> str:
        """Return the text of a property."""
        found = self.properties.get(name)
        return default if found is None else str(found.values[0])

    def numbers(self, name: str, counts: tuple[int, ...]) -> tuple[float, ...] | None:
        """Return the numbers of a property; None: it has none.

        Args:
            name: The property.
            counts: Allowed numbers of them.

        Raises:
            ArenaFileError: It has others, or another number of them.
        """
        found = self.properties.get(name)
        if found is None:
            return None
        numbers = [value for value in found.values if isinstance(value, float) and math.isfinite(value)]
        if len(numbers) != len(found.values) or len(numbers) not in counts:
            shown = " ".join(map(str, found.values[:8]))
            wanted = " or ".join(map(str, counts))
            raise ArenaFileError(f"{found.place}: {name} is {shown!r}, expected {wanted} numbers")
        return tuple(numbers)

    def number(self, name: str, default: float) -> float:
        """Return the number of a property."""
        found = self.numbers(name, (1,))
        return default if found is None else found[0]


@dataclass(frozen=True, kw_only=True)
class _Definition:
    """A `define`: its word, the type or word that it extends, and its body."""

    parent: str
    body: "_Body"


@dataclass(kw_only=True)
class _Body:
    """The content of brackets as written: properties, and models by their words."""

    properties: list[StageProperty] = field(default_factory=list[StageProperty])
    models: "list[tuple[StageToken, _Body]]" = field(default_factory=list["tuple[StageToken, _Body]"])


def read_stage(path: Path) -> StageModel:
    """Return the models of a world file; the root has the world's own properties.

    Raises:
        ArenaFileError: An unreadable file; names it and the line.
    """
    parser = _Parser(path)
    body = parser.body(0)
    root = StageModel(kind="world", word="world", place=str(path))
    root.properties = {one.name: one for one in body.properties}
    root.children = [parser.model(token, own, 1) for token, own in body.models]
    return root


class _Parser:
    """Reader of a world file and its includes.

    Args:
        path: The file.
    """

    def __init__(self, path: Path) -> None:
        self._tokens = [*self._read(path, ())]
        self._next = 0
        self._definitions: dict[str, _Definition] = {}
        self._models = 0

    def _read(self, path: Path, above: tuple[Path, ...]) -> Iterator[StageToken]:
        """Yield the tokens of a file, with those of a file in the place of its `include`."""
        if path.resolve() in above or len(above) > MAX_STAGE_DEPTH:
            raise ArenaFileError(f"{path} includes itself")
        text = read_bytes(path, refusal=ArenaFileError).decode("latin-1")
        include: StageToken | None = None
        for token in _tokens(path, text):
            if include is not None:
                if token.kind != "string":
                    raise include.error(f"include {token.text!r}: expected a file name in quotes")
                file = path.parent / token.text
                if not file.is_file():
                    raise include.error(f"includes {token.text!r}, which is not there")
                yield from self._read(file, (*above, path.resolve()))
                include = None
            elif token.kind == "word" and token.text == "include":
                include = token
            else:
                yield token
        if include is not None:
            raise include.error("include: expected a file name in quotes")

    def _take(self) -> StageToken | None:
        if self._next > MAX_STAGE_TOKENS:
            raise self._tokens[self._next].error(f"more than {MAX_STAGE_TOKENS} words")
        token = self._tokens[self._next] if self._next < len(self._tokens) else None
        self._next += 1
        return token

    def _word(self, after: StageToken, what: str) -> StageToken:
        token = self._take()
        if token is None or token.kind != "word":
            raise after.error(f"{after.text}: expected {what}")
        return token

    def body(self, depth: int) -> _Body:
        """Read properties and models up to the closing bracket, or up to the end at depth 0."""
        found = _Body()
        while (token := self._take()) is not None:
            if token.text == ")" and token.kind == "sign" and depth:
                return found
            if token.kind != "word":
                raise token.error(f"{token.text!r} is neither a property nor a model")
            if token.text == "define" and not depth:
                name, parent = self._word(token, "a name"), self._word(token, "a type after the name")
                self._open(parent)
                self._definitions[name.text] = _Definition(parent=parent.text, body=self._inner(token, 1))
            elif self._peek() == "(":
                self._take()
                found.models.append((token, self._inner(token, depth + 1)))
            else:
                found.properties.append(self._property(token))
        if depth:
            raise self._tokens[-1].error("the file ends within brackets: `)` is missing")
        return found

    def _inner(self, owner: StageToken, depth: int) -> _Body:
        if depth > MAX_STAGE_DEPTH:
            raise owner.error(f"{owner.text} is nested {depth} deep; at most {MAX_STAGE_DEPTH}")
        return self.body(depth)

    def _peek(self) -> str:
        token = self._tokens[self._next] if self._next < len(self._tokens) else None
        return token.text if token is not None and token.kind == "sign" else ""

    def _open(self, after: StageToken) -> None:
        token = self._take()
        if token is None or token.text != "(" or token.kind != "sign":
            raise after.error(f"{after.text}: expected `(`")

    def _property(self, name: StageToken) -> StageProperty:
        first = self._take()
        if first is None or (first.text in ("(", ")", "]") and first.kind == "sign"):
            raise name.error(f"{name.text} has no value")
        values: list[Scalar] = []
        if first.kind == "sign":
            while (token := self._take()) is not None and token.text != "]":
                if token.kind == "sign":
                    raise token.error(f"{name.text}: {token.text!r} in brackets, expected words and numbers")
                values.append(_value(token))
            if token is None:
                raise name.error(f"{name.text}: `]` is missing")
        else:
            values.append(_value(first))
        if not values:
            raise name.error(f"{name.text} has no value")
        folder = Path(name.place.rpartition(":")[0]).parent
        return StageProperty(name=name.text, values=tuple(values), place=name.place, folder=folder)

    def model(self, token: StageToken, body: _Body, depth: int) -> StageModel:
        """Return a model with what its definitions state, the outermost first."""
        self._models += 1
        if self._models > MAX_STAGE_MODELS:
            raise token.error(f"more than {MAX_STAGE_MODELS} models")
        bodies, word, seen = [body], token.text, set[str]()
        while word in self._definitions and word not in seen:
            seen.add(word)
            bodies.insert(0, self._definitions[word].body)
            word = self._definitions[word].parent
        if depth > MAX_STAGE_DEPTH:
            raise token.error(f"{token.text} is nested {depth} deep; at most {MAX_STAGE_DEPTH}")
        made = StageModel(kind=word, word=token.text, place=token.place)
        for one in bodies:
            made.properties |= {known.name: known for known in one.properties}
        made.children = [self.model(child, own, depth + 1) for one in bodies for child, own in one.models]
        return made


def _tokens(path: Path, text: str) -> Iterator[StageToken]:
    line, at = 1, 0
    while at < len(text):
        found = TOKEN.match(text, at)
        if found is None:
            rest = text[at : at + 20].splitlines()[0]
            raise ArenaFileError(f"{path}:{line}: {rest!r} is no part of a world file")
        at = found.end()
        kind = found.lastgroup or ""
        if kind == "line":
            line += 1
        elif kind != "space":
            yield StageToken(kind=kind, text=found[kind], place=f"{path}:{line}")


def _value(token: StageToken) -> Scalar:
    return float(token.text) if token.kind == "number" else token.text
