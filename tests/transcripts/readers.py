"""How controllers take lines apart: the rules of their parsers, as far as they decide what can be read."""

import re

BLANKS = " \t\r\n"


class ScalarReader:
    """MOAST's way, and that of NIST's node for ROS: keys behind braces, and values wherever they are.

    A key is the word behind the next `{`; one that is not followed by a blank ends the reading. A value is
    the next word between blanks, commas and braces, so that `{Name F1 Range 2.5}` and `{Name F1} {Range 2.5}`
    are the same to it.
    """

    def __init__(self, line: str) -> None:
        self.line, self.at = line, 0
        self.head = re.split(r"[ \t{]", line, maxsplit=1)[0]

    def key(self) -> str:
        """Return the next key, "" at the end."""
        start = self.line.find("{", self.at)
        found = re.compile(r"\{\s*([^\s,{}]+)(?=\s)").match(self.line, start) if start >= 0 else None
        self.at = found.end() if found else len(self.line)
        return found[1] if found else ""

    def value(self) -> str:
        """Return the next value."""
        found = re.compile(r"[\s,{}]*([^\s,}]+)").match(self.line, self.at)
        assert found, f"no value at {self.line[self.at :]!r}"
        self.at = found.end()
        return found[1]

    def expect(self, word: str) -> None:
        """Read a word that must stand next."""
        value = self.value()
        assert value.startswith(word), f"{value} instead of {word}"

    def reals(self, count: int) -> tuple[float, ...]:
        """Read so many numbers."""
        return tuple(float(self.value()) for _ in range(count))

    def all_reals(self) -> list[float]:
        """Read the numbers up to the end of the line."""
        return [float(word) for word in re.split(r"[\s,{}]+", self.line[self.at :]) if word]


def scalars(line: str, layout: dict[str, int | str]) -> dict[str, object]:
    """Read a line's keys with so many numbers each; "word" is one word, "rest" all numbers that follow."""
    reader, read = ScalarReader(line), {}
    while key := reader.key():
        kind = layout.get(key)
        if isinstance(kind, int):
            read[key] = reader.reals(kind)
        elif kind == "word":
            read[key] = reader.value()
        elif kind == "rest":
            read[key] = reader.all_reals()
    return read


def player_value(line: str, key: str) -> str:
    """Player's way: the word behind `{Key `, up to the next blank, less a brace at its end."""
    assert len(line) + 2 < 4096, "its buffer is full"
    start = line.index("{" + key) + 1 + len(key)
    word = line[line.index(" ", start) + 1 :].split(" ")[0]
    return word[:-1] if word.endswith("}") else word


def player_sonars(line: str, prefix: str) -> list[float]:
    """Return the ranges of an array of sonars that are called alike."""
    pieces = re.split(r"(?=\{Name )", line)
    found = (re.match(r"\{Name (\S+)\s+Range\s+(-?[\d.]+)", piece) for piece in pieces)
    return [float(match[2]) for match in found if match and match[1].startswith(prefix)]


def player_mounts(line: str) -> dict[str, tuple[tuple[float, ...], tuple[float, ...]]]:
    """Return where items are, read word by word: type, then name, location, orientation and mount of each."""
    words = iter(line.split()[3:])
    mounts = {}
    for word in words:
        assert word == "{Name"
        name, *fields = (next(words) for _ in range(7))
        assert fields[::2] == ["Location", "Orientation", "Mount"]
        mounts[name] = tuple(tuple(float(n) for n in text.split(",")) for text in fields[1:4:2])
    return mounts


def pyro_segments(line: str) -> list[dict[str, list[str]]]:
    """Pyro's way: pieces that end with a brace, their words in pairs, the second of each split at commas."""
    _, body = line.split(None, 1)
    segments = []
    for piece in body.split("}")[:-1]:
        words = piece.replace("{", "").split()
        assert len(words) % 2 == 0, f"it cannot read {piece!r}"
        segments.append({key: value.split(",") for key, value in zip(words[::2], words[1::2], strict=True)})
    return segments


def pyro_first(line: str, key: str) -> list[str]:
    """Return the values of the first piece that has a key."""
    return next((segment[key] for segment in pyro_segments(line) if key in segment), [])


def simpleui_texts(line: str, key: str) -> list[str]:
    """SimpleUI's way: what stands behind each `{Key `, up to the brace that ends it."""
    return [piece.partition("}")[0] for piece in line.split("{" + key + " ")[1:]]


def simpleui_sonars(line: str) -> dict[str, float]:
    """Return the ranges of the 32 sonars at most that it has room for: the number behind `Range` of each."""
    items = [text.split() for text in simpleui_texts(line, "Name")]
    assert len(items) <= 32
    return {words[0]: float(words[words.index("Range") + 1]) for words in items}


def controller_pieces(line: str) -> list[str]:
    """USARSimController's way: pieces between `} {` from the type on, known by their places."""
    start = line.index("{Type ") + len("{Type ")
    return line[start:].removesuffix("}").split("} {")


def controller_numbers(piece: str) -> list[float]:
    """Return the numbers between commas behind a piece's key."""
    return [float(text) for text in piece.split(" ")[1].split(",")]


def controller_state(line: str) -> dict[str, int]:
    """Return the numbers of a state that must be whole: the text behind each key, up to the next brace."""
    keys = ("LightIntensity", "Battery", "View")
    return {key: int(line[line.index(key) + len(key) + 1 :].split("}")[0]) for key in keys}
