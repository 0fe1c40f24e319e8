import ctypes
import os
import platform
import subprocess
import sys

import pytest

from tests.conftest import resident
from usarmjx.base.process import MALLOC_VARIABLES, MAPPED_SIZE, limit_fragmentation, return_freed_memory

PIECE, PIECES = 100_000, 600  # bytes: below what glibc gives back by itself, 60 MB together
MAPPED = """
import ctypes, sys
from usarmjx.base.process import limit_fragmentation

class Info(ctypes.Structure):
    _fields_ = [(name, ctypes.c_size_t) for name in
                "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost".split()]

libc = ctypes.CDLL(None)
libc.mallinfo2.restype, libc.malloc.restype, libc.free.argtypes = Info, ctypes.c_void_p, [ctypes.c_void_p]
if sys.argv[1] == "limited":
    assert limit_fragmentation()
libc.free(libc.malloc(20_000_000))  # glibc's own threshold follows it
before = libc.mallinfo2()
libc.malloc(int(sys.argv[2]))
after = libc.mallinfo2()
print(after.hblks - before.hblks)
"""


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


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library has no such threshold")
@pytest.mark.parametrize(
    ("how", "size", "maps"),
    [("limited", MAPPED_SIZE, 1), ("limited", MAPPED_SIZE // 2, 0), ("as it is", MAPPED_SIZE, 0)],
)
def test_large_blocks_stay_out_of_the_heap_after_larger_ones_were_freed(how, size, maps):
    environment = {name: value for name, value in os.environ.items() if name not in MALLOC_VARIABLES}
    ran = subprocess.run(
        [sys.executable, "-c", MAPPED, how, str(size)],
        env=environment,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout) == maps


FAULTS = """
import ctypes, resource
from usarmjx.base.process import limit_fragmentation

libc = ctypes.CDLL(None)
libc.malloc.restype, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_void_p]
assert limit_fragmentation()
for number in range(101):
    blocks = [libc.malloc(200_000) for _ in range(5)]
    for block in blocks:
        ctypes.memset(block, 1, 200_000)
    for block in blocks:
        libc.free(block)
    if not number:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
BLOCK_PAGES = 5 * 200_000 // 4096


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="another C library has no such threshold")
def test_pages_of_arrays_that_are_freed_in_each_step_stay():
    environment = {name: value for name, value in os.environ.items() if name not in MALLOC_VARIABLES}
    ran = subprocess.run(
        [sys.executable, "-c", FAULTS], env=environment, capture_output=True, text=True, timeout=60
    )
    assert ran.returncode == 0, ran.stderr
    # A hundred rounds with fewer new pages than one round has.
    assert int(ran.stdout) < BLOCK_PAGES


@pytest.mark.parametrize("name", MALLOC_VARIABLES)
def test_settings_of_the_user_stay(name):
    assert not limit_fragmentation({name: "1"})
