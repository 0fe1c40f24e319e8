"""Files that are nearly right: a valid one with bytes flipped, cut, doubled, or words in it that hurt."""

from hypothesis import strategies as st

NUMBERS = b"nan inf -1 0 1e309 -1e300 99999999999999999999 1e-320 0x1p9 1:59:59".split()
WORDS = [
    *NUMBERS,
    *(b"\x00", b"\xff\xfe", b"\xc3", b"\n", b"\r", b"\\\n", b" ", b"\t", b"- ", b": ", b"f 1 2 -9\n"),
    *b"< &a; ]]> <!-- ' \" (( ) [ { } = *a <<:*a /* */ # ; .. /dev/null true null vertex".split(),
    *(b"!!int x", b"!!timestamp 1", b"!!bool x", b"<<: *a", b"vertex 1 2\n"),
]
EDITS = ("flip", "cut", "double", "insert", "number")
edits = st.lists(
    st.tuples(st.sampled_from(EDITS), st.floats(0, 1), st.integers(0, 40), st.integers(1, 255)),
    min_size=1,
    max_size=4,
)


def mutate(whole: bytes, changes) -> bytes:
    """Carry out changes: kind, where, how many bytes, and a number whose meaning depends on the kind."""
    for kind, where, length, value in changes:
        start = int(where * len(whole))
        stop = start + length
        if kind == "flip":
            whole = whole[:start] + bytes(b ^ value for b in whole[start : start + 1]) + whole[start + 1 :]
        elif kind == "cut":
            whole = whole[:start] + (whole[stop:] if length else b"")
        elif kind == "double":
            whole = whole[:stop] + whole[start:stop] * (1 + value % 3) + whole[stop:]
        elif kind == "insert":
            whole = whole[:start] + WORDS[value % len(WORDS)] + whole[start:]
        else:  # the next number becomes another one
            first = next((i for i in range(start, len(whole)) if whole[i] in b"0123456789"), len(whole))
            last = next((i for i in range(first, len(whole)) if whole[i] not in b"0123456789."), len(whole))
            whole = whole[:first] + NUMBERS[value % len(NUMBERS)] + whole[last:]
    return whole
