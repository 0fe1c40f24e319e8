"""What a name is on the wire (manual 9.2): printable ASCII without blanks."""

import re

_NAME = re.compile(r"[!-z|~]+")


def is_name(text: str) -> bool:
    """Return whether a text is one word of the characters 33 to 126, braces apart: those end a segment."""
    return _NAME.fullmatch(text) is not None
