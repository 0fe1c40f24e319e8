"""JSON within limits, as plain data; and files with a checksum, which usarmjx keeps for itself.

The checksum is of the content, not of the bytes: a file may be formatted anew.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn, cast

from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.settings.files import MAX_FILE_BYTES, first_line, read_bytes
from usarmjx.base.settings.yaml_file import MAX_DIGITS

MOST_LINES_BYTES = 256_000_000
"""Largest file of JSON lines: hours of training write one."""
CHECKSUM = "checksum"
"""Key of the checksum."""


def parse_json(
    text: bytes | str,
    place: str,
    refusal: type[UsageError] = SpecError,
    *,
    line: int | None = None,
    finite: bool = False,
) -> Any:  # noqa: ANN401 - any data
    """Return the data of a JSON text.

    Args:
        text: The text.
        place: Its source, for messages.
        refusal: Class of the errors.
        line: Line of the source that the text is; None: the text is the whole source.
        finite: Refuse NaN and infinities, which are not JSON but which Python writes.

    Raises:
        UsageError: It is not JSON, is nested too deeply, or has a number that is too long; names the line.
    """
    where = place if line is None else f"{place}:{line}"

    def refuse(reason: str) -> NoReturn:
        raise refusal(f"{where}: is no JSON: {reason}")

    def whole(digits: str) -> int:
        # Before the conversion, whose time grows with the square of the digits.
        if len(digits) > MAX_DIGITS:
            refuse(f"a number of {len(digits)} characters; at most {MAX_DIGITS}")
        return int(digits)

    def constant(name: str) -> float:
        return refuse(f"{name} is no number") if finite else float(name)

    try:
        # Decoded here: `json.loads` would guess UTF-16 or UTF-32 from bytes.
        decoded = text if isinstance(text, str) else text.decode("utf-8")
        return json.loads(decoded, parse_int=whole, parse_constant=constant)
    except json.JSONDecodeError as error:
        at = f"{place}:{error.lineno if line is None else line}"
        raise refusal(f"{at}: is no JSON: {error.msg}, column {error.colno}") from error
    except UnicodeDecodeError as error:
        raise refusal(f"{where}: is no JSON: {first_line(error)}") from error
    except RecursionError as error:
        raise refusal(f"{where}: is nested too deeply") from error


def read_json(
    path: Path, refusal: type[UsageError] = SpecError, *, most: int = MAX_FILE_BYTES, finite: bool = False
) -> Any:  # noqa: ANN401 - any data
    """Return the data of a JSON file.

    Raises:
        UsageError: The file is missing, too large, or see `parse_json`.
    """
    return parse_json(read_bytes(path, most, refusal), str(path), refusal, finite=finite)


def read_json_lines(
    path: Path, refusal: type[UsageError] = SpecError, *, cut: bool = False
) -> list[tuple[str, dict[str, Any]]]:
    """Return the objects of a file of JSON lines, each after its file and line.

    Args:
        path: The file.
        refusal: Class of the errors.
        cut: Leave out a last line without an end, as a killed writer leaves it.

    Raises:
        UsageError: The file is missing or too large, or a line is no JSON object; names it.
    """
    found = list[tuple[str, dict[str, Any]]]()
    lines = read_bytes(path, MOST_LINES_BYTES, refusal).split(b"\n")
    last = lines.pop()  # empty, if the file is whole
    for number, line in enumerate(lines if cut or not last.strip() else [*lines, last], 1):
        if not line.strip():
            continue
        value = as_mapping(parse_json(line, str(path), refusal, line=number))
        if value is None:
            raise refusal(f"{path}:{number}: is no mapping of names to values")
        found.append((f"{path}:{number}", value))
    return found


def as_mapping(value: object) -> dict[str, Any] | None:
    """Return a value of JSON if it is a mapping, else None."""
    return cast("dict[str, Any]", value) if isinstance(value, dict) else None


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
    # Through JSON once: the file as it is read back must have the checksum of the content as it was given.
    plain = json.loads(json.dumps(content, default=str))
    text = json.dumps(plain, sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
