"""Numbers of the worlds of a batch that are served: `all`, or numbers and ranges as `0,2-5`."""

from collections.abc import Sequence

from usarmjx.base.errors import UsageError


def parse_instances(text: str, worlds: int) -> tuple[int, ...]:
    """Return the numbers of the worlds in a text, ascending.

    Args:
        text: `all`, or numbers and ranges, as `0,2-5`.
        worlds: Worlds in the batch.

    Raises:
        UsageError: It is not of that form, or there is no such world.
    """
    if text.strip().lower() == "all":
        return tuple(range(worlds))
    numbers: set[int] = set()
    for part in (part.strip() for part in text.split(",")):
        first, dash, last = (end.strip() for end in part.partition("-"))
        last = last if dash else first
        if not (first.isdecimal() and last.isdecimal() and int(first) <= int(last)):
            raise UsageError(f"instances {text!r} are not of the form all or 0,2-5: {part!r}")
        # Before the range is made: one up to a huge number would fill the memory.
        check_instances((int(first), int(last)), worlds)
        numbers.update(range(int(first), int(last) + 1))
    return tuple(sorted(numbers))


def check_instances(instances: Sequence[int], worlds: int) -> None:
    """Refuse numbers of worlds that a batch does not have.

    Raises:
        UsageError: A number is out of range, or there is none.
    """
    if not instances:
        raise UsageError("no instance is to be served")
    for instance in instances:
        if not 0 <= instance < worlds:
            raise UsageError(f"instance {instance} is not among worlds 0 to {worlds - 1}")
