"""JSON files that usarmjx keeps for itself: with a checksum of their content, so that no damage is believed.

The checksum is of the content, not of the bytes: a file may be formatted anew.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from usarmjx.base.errors import SpecError
from usarmjx.base.settings.files import MAX_FILE_BYTES
from usarmjx.base.settings.json_file import as_mapping, read_json

CHECKSUM = "checksum"
"""Key of the checksum."""


class NotWholeError(SpecError):
    """Kept file that is damaged, or that somebody has changed; the message names it."""


def kept_text(content: Mapping[str, Any], indent: int | None = 1) -> str:
    """Return the text of a kept file: its content, and the checksum of it."""
    text = json.dumps({**content, CHECKSUM: _checksum(content)}, indent=indent, default=str)
    return text + "\n"


def read_kept(path: Path, *, needs_checksum: bool = True, most: int = MAX_FILE_BYTES) -> dict[str, Any]:
    """Return the content of a kept file, without the checksum.

    Args:
        path: The file.
        needs_checksum: Refuse a file without one, as earlier versions wrote them.
        most: Largest size [bytes].

    Raises:
        SpecError: It is missing or is no JSON.
        NotWholeError: Its content has another checksum.
    """
    content = as_mapping(read_json(path, most=most))
    if content is None:
        raise NotWholeError(f"{path}: is no mapping of names to values")
    known = content.pop(CHECKSUM, None)
    if (known is not None or needs_checksum) and known != _checksum(content):
        raise NotWholeError(f"{path}: is not whole: its content has another checksum than it says")
    return content


def _checksum(content: Mapping[str, Any]) -> str:
    """Return the digest of what JSON makes of a content: lists of tuples, texts of numbers as keys."""
    plain = json.loads(json.dumps(content, default=str))
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
