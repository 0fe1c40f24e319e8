"""What strangers make libraries log: a line now and then, without tracebacks, and never a token."""

import logging
import sys

import pytest

from usarmjx.server.network.web_gate import as_current_http
from usarmjx.server.protocol.grammar import is_auth, redact
from usarmjx.server.runtime.logs import LibraryLimit, SecretFilter, limit_libraries


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("AUTH {Token s3cret}", "AUTH {Token ...}"),
        ("unknown: 'auth s3cret;'", "unknown: 'auth ...;'"),
        ("AUTH  {token s3cret", "AUTH  {token ..."),
        ("AUTH{Token s3cret}", "AUTH{Token ...}"),
        ("GET /metrics?a=1&token=s3cret&b=2 HTTP/1.0", "GET /metrics?a=1&token=...&b=2 HTTP/1.0"),
        ("b'GET /?TOKEN=s3cret'", "b'GET /?TOKEN=...'"),
        ("authors tokenize", "authors tokenize"),
    ],
)
def test_tokens_are_taken_out(text, shown):
    assert redact(text) == shown
    assert "s3cret" not in shown


@pytest.mark.parametrize("line", ["AUTH {Token a}", " auth a", "AUTH{Token a}", "AUTH", "AUTH\tx"])
def test_a_line_that_says_a_token(line):
    assert is_auth(line)


@pytest.mark.parametrize("line", ["", "AUTHOR x", "DRIVE {AUTH 1}", "AUT"])
def test_a_line_that_says_none(line):
    assert not is_auth(line)


def record_of(message, *args, error=None, level=logging.ERROR):
    info = None
    if error is not None:
        try:
            raise error
        except Exception:
            info = sys.exc_info()
    return logging.LogRecord("websockets.server", level, "file", 1, message, args, info)


def test_no_handler_writes_a_token():
    record = record_of("%s came", "GET /?token=s3cret", error=ValueError("GET /?token=s3cret HTTP/1.0"))
    assert SecretFilter().filter(record)
    text = logging.Formatter().format(record)
    assert "s3cret" not in text
    assert "token=... HTTP/1.0" in text


def test_lines_of_a_library_that_are_alike_are_one_in_ten_seconds():
    now = [0.0]
    limit = LibraryLimit(10.0, lambda: now[0])
    error = ValueError("a\nb")
    first = record_of("opening handshake failed", error=error)
    assert limit.filter(first)
    assert logging.Formatter().format(first) == "opening handshake failed: ValueError"
    assert sum(limit.filter(record_of("opening handshake failed", error=error)) for _ in range(1000)) == 0
    other = record_of("socket.accept() out of system resource\nsocket: <%s>", "x")
    assert limit.filter(other)
    assert other.getMessage() == "socket.accept() out of system resource"
    now[0] = 11.0
    again = record_of("opening handshake failed")
    assert limit.filter(again)
    assert again.getMessage() == "opening handshake failed (1000 more since the last such line)"
    assert limit.filter(record_of("server listening", level=logging.INFO))


def test_kinds_of_lines_are_bounded_too():
    """A text that a stranger chooses makes no kind of its own for ever."""
    limit = LibraryLimit(10.0, lambda: 0.0)
    assert sum(limit.filter(record_of(f"odd {number}")) for number in range(1000)) < 100


def test_libraries_are_limited_once():
    limit_libraries()
    limit_libraries()
    for name in ("asyncio", "websockets.server"):
        assert sum(isinstance(one, LibraryLimit) for one in logging.getLogger(name).filters) == 1


@pytest.mark.parametrize("end", [b"\r\n", b"\n"])
def test_only_the_version_of_the_first_line_is_changed(end):
    head = b"GET /x HTTP/1.0" + end + b"X: y HTTP/1.0" + end
    assert as_current_http(head) == b"GET /x HTTP/1.1" + end + b"X: y HTTP/1.0" + end
    assert as_current_http(b"GET /x HTTP/1.1\r\n") == b"GET /x HTTP/1.1\r\n"
    assert as_current_http(b"junk") == b"junk"
