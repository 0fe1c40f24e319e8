"""A line of progress and other output on one terminal."""

import io

from usarmjx.base.progress import StatusLine, clear_status, is_status_shown


class Stream(io.StringIO):
    def __init__(self, terminal):
        super().__init__()
        self.isatty = lambda: terminal


def test_on_a_terminal_other_output_finds_an_empty_line():
    stream = Stream(terminal=True)
    line = StatusLine(stream)
    line.show("1 of 2")
    line.show("2 of 2")
    assert is_status_shown()
    clear_status()
    stream.write("compiling ... 13 s\n")
    clear_status()
    line.clear()
    assert not is_status_shown()
    assert stream.getvalue() == "\r\033[K1 of 2\r\033[K2 of 2\r\033[Kcompiling ... 13 s\n"


def test_in_a_file_each_text_is_a_line():
    stream = Stream(terminal=False)
    line = StatusLine(stream)
    line.show("1 of 2")
    assert not is_status_shown()
    clear_status()
    line.clear()
    assert stream.getvalue() == "1 of 2\n"
