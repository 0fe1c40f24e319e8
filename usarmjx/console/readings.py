"""Messages as trees of names and values, and ranges as bars: what panes show of them."""

from collections.abc import Sequence

from usarmjx.server.protocol.grammar import Message, to_vector

NEAR, MIDDLE = 0.2, 0.5
"""Up to these shares of the longest distance a reading is near, or in the middle."""
COLORS = ("red", "yellow", "green")
"""Of what is near, in the middle, and far (manual 5.2.5.1: a color code)."""
LEVELS = "▁▂▃▄▅▆▇█"
MAX_VALUE = 60
"""A longer value is shown by its beginning [characters]."""

Branch = dict[str, dict[str, str]]
"""Fields by name of a sensor, or other part; those of none are under ""."""
Bar = tuple[str, str, str]
"""A name, what is drawn, and its colour."""


def title(message: Message) -> str:
    """Return what stands over a message's values: the type of sensor, or the mission package."""
    if message.kind == "SEN":
        return message.get("Type")
    return f"{message.kind} {message.get('Name')}".strip() if message.kind == "MISSTA" else message.kind


def branch(message: Message) -> Branch:
    """Return a message's values by the names in it."""
    found: Branch = {}
    name = ""
    for key, value in message.segments:
        words = value.split()
        if key.lower() == "name" and words:
            name = words[0]
            pairs = zip(words[1::2], words[2::2], strict=False)  # `{Name F1 Range 2.5}`
            found.setdefault(name, {}).update((field, brief(text)) for field, text in pairs)
        elif key.lower() not in ("type", "name") or message.kind != "SEN":
            fields = found.setdefault(name if key.lower() != "time" else "", {})
            fields[_free(fields, key)] = brief(value)
    return found


def _free(fields: dict[str, str], key: str) -> str:
    """Return a key that may come several times, told apart by numbers."""
    count = sum(known.split(" ")[0] == key for known in fields)
    return f"{key} {count + 1}" if count else key


def brief(value: str) -> str:
    """Return a value that fits into a line; of many numbers how many there are, and their extremes."""
    if len(value) <= MAX_VALUE:
        return value
    if value.count(",") > 3:
        numbers = to_vector(value)
        return f"{len(numbers)} numbers, {min(numbers):g} to {max(numbers):g}"
    return value[:MAX_VALUE] + "..."


def range_bars(message: Message, longest: float, width: int) -> list[Bar]:
    """Return the distances of a message as bars, none if it has none.

    Args:
        message: A message of sonars, infrareds or scanners.
        longest: The longest distance so far [m].
        width: Longest bar, without its number [characters].
    """
    whole = message.get("Range")
    if whole:  # a scan: from right to left on the wire
        ranges = to_vector(whole)[::-1]
        cells = [min(part) for part in _split(ranges, width) if part]
        drawn = "".join(LEVELS[min(int(len(LEVELS) * cell / longest), len(LEVELS) - 1)] for cell in cells)
        return [(message.get("Name"), drawn, _color(min(ranges), longest))]
    bars: list[Bar] = []
    for words in (value.split() for value in message.all("Name")):
        if len(words) == 3 and words[1].lower() == "range":
            (distance,) = to_vector(words[2])
            length = round(width * min(distance / longest, 1.0))
            bars.append((words[0], f"{'█' * length} {distance:.2f}", _color(distance, longest)))
    return bars


def longest_range(message: Message) -> float:
    """Return the longest distance in a message [m]; 0: there is none."""
    lists = [
        message.get("Range"),
        *(words.split()[-1] for words in message.all("Name") if " Range " in words),
    ]
    return max((number for text in lists for number in to_vector(text)), default=0.0)


def _split(values: Sequence[float], parts: int) -> list[Sequence[float]]:
    count = len(values)
    return (
        [values[i * count // parts : (i + 1) * count // parts] for i in range(parts)]
        if count > parts
        else [(value,) for value in values]
    )


def _color(distance: float, longest: float) -> str:
    share = distance / longest
    return COLORS[0 if share <= NEAR else 1 if share <= MIDDLE else 2]
