import ctypes
import platform

import pytest

from tests.conftest import resident
from usarmjx.base.process import return_freed_memory

PIECE, PIECES = 100_000, 600  # bytes: below what glibc gives back by itself, 60 MB together


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library keeps other memory")
def test_what_was_freed_goes_back_to_the_system():
    libc = ctypes.CDLL(None)
    libc.malloc.restype, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
    pieces = [libc.malloc(PIECE) for _ in range(PIECES)]
    for piece in pieces:
        ctypes.memset(piece, 1, PIECE)
    last = pieces.pop()  # keeps the heap from shrinking at its end
    for piece in pieces:
        libc.free(piece)
    before = resident()
    return_freed_memory()
    assert before - resident() > 0.8 * PIECE * PIECES
    libc.free(last)


def test_where_the_c_library_is_another_one_nothing_happens(monkeypatch):
    monkeypatch.setattr("usarmjx.base.process._trim", lambda: None)
    return_freed_memory()
