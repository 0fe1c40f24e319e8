"""A strict parser of both ages of the protocol, written from its rules and independent of the product's.

The manual's age (9.2): a type, then segments in braces after single blanks; a segment is words in pairs,
names and values. The later versions: one pair in a segment. In both, start poses are a list of tag, place and
angles.
"""

import re

MANUAL, LATER = "manual", "udk"
LINE = re.compile(r"([A-Z]+)((?: \{[^{}]+\})*)")
KEY = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
WORD = re.compile(r"[!-z|~]+")
NUMBER = re.compile(r"-?[0-9]+(?:\.[0-9]+)?")
COORDINATE = re.compile(r"[0-9]{1,3},[0-9]{1,2}\.[0-9]+,[NSEW]")
"""Degrees, minutes and direction of a GPS (10.13)."""
LISTS_OF_POINTS = {"Points": re.compile(r"(?:\[[^][]+\])+|[^;]+(?:;[^;]+)*")}
"""Keys of the later versions with points, in brackets or between semicolons."""
TYPES = {
    MANUAL: {"NFO", "STA", "SEN", "MISSTA", "GEO", "CONF", "RES", "DRIVE"},
    LATER: {"NFO", "STA", "SEN", "ASTA", "EFF", "GEO", "CONF", "RES"},
}


class NotStrictError(ValueError):
    """A line that no strict client can read."""


def parse(line, age=MANUAL):
    """Return the type of a line and the pairs of its segments; all values are words or lists of numbers."""
    match = LINE.fullmatch(line)
    if match is None:
        raise NotStrictError(f"no type with segments: {line}")
    head, body = match.groups()
    if head not in TYPES[age]:
        raise NotStrictError(f"{head} is no type of {age}")
    return head, [pair for text in re.findall(r"\{([^{}]+)\}", body) for pair in pairs_of(text, age)]


def pairs_of(text, age):
    """Return names and values of a segment."""
    words = text.split(" ")
    if any(WORD.fullmatch(word) is None for word in words):
        raise NotStrictError(f"more than a blank, or no word, in {{{text}}}")
    if len(words) % 3 == 0 and all(is_list(word, 3) for word in (*words[1::3], *words[2::3])):
        return [(tag, (place, angles)) for tag, place, angles in zip(*[iter(words)] * 3, strict=True)]
    if len(words) % 2 or (age == LATER and len(words) != 2):
        raise NotStrictError(f"{{{text}}} is no pair{'s' * (age == MANUAL)}")
    for key, value in zip(words[::2], words[1::2], strict=True):
        check(key, value)
    return list(zip(words[::2], words[1::2], strict=True))


def check(key, value):
    """Refuse a name that is none, and lists with gaps or numbers that are none."""
    if KEY.fullmatch(key) is None:
        raise NotStrictError(f"{key!r} is no name")
    if key in ("Latitude", "Longitude"):
        if COORDINATE.fullmatch(value) is None:
            raise NotStrictError(f"{key} is no coordinate: {value!r}")
        return
    if key in LISTS_OF_POINTS and LISTS_OF_POINTS[key].fullmatch(value):
        points = re.findall(r"[^][;]+", value)
        if not all(is_list(point, 3) for point in points):
            raise NotStrictError(f"{key} has a point that is none: {value!r}")
        return
    parts = value.split(",")
    if "" in parts or value.lower() in ("nan", "inf", "-inf", "none"):
        raise NotStrictError(f"{key} has the value {value!r}")
    if len(parts) > 1 and not is_list(value, len(parts)) and any(map(NUMBER.fullmatch, parts)):
        raise NotStrictError(f"{key} mixes numbers and words: {value!r}")


def is_list(word, count):
    """Return whether a word is `count` numbers with commas between them."""
    parts = word.split(",")
    return len(parts) == count and all(map(NUMBER.fullmatch, parts))
