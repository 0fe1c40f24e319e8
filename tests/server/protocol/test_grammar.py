"""Lines <-> messages, and the numbers in them."""

import math
import struct
from decimal import ROUND_DOWN, Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.server.protocol.grammar import (
    Message,
    check_word,
    clip,
    format_message,
    four_decimals,
    four_decimals_list,
    parse_message,
    to_bool,
    to_float,
    to_int,
    to_vector,
    two_decimals,
    two_decimals_list,
)

KINDS = st.from_regex(r"[A-Z][A-Z0-9_]{0,12}", fullmatch=True)
CHARACTERS = [chr(code) for code in range(256) if chr(code) not in " \t\r\n{}"]
KEYS = st.text(st.sampled_from(CHARACTERS), min_size=1, max_size=12)
VALUES = st.text(st.sampled_from([*CHARACTERS, " ", "\t"]), max_size=40).map(lambda text: text.strip(" \t"))
MESSAGES = st.builds(
    Message, KINDS, st.lists(st.tuples(KEYS, VALUES), max_size=6).map(lambda pairs: tuple(pairs))
)


@given(MESSAGES)
def test_format_then_parse_is_the_same_message(message):
    assert parse_message(format_message(message)) == message


@given(st.text(st.characters(max_codepoint=255), max_size=80))
def test_any_line_parses_or_is_the_peers_fault(line):
    try:
        message = parse_message(line)
    except PeerError:
        return
    assert parse_message(format_message(message)) == message


@given(st.text(st.sampled_from("AB {}1,.-"), max_size=30))
def test_any_braces_parse_or_are_the_peers_fault(line):
    try:
        message = parse_message("X" + line)
    except PeerError:
        return
    assert parse_message(format_message(message)) == message


LEFT_RIGHT = (("Left", "1.0"), ("Right", "-1.0"))


@pytest.mark.parametrize(
    "line",
    [
        pytest.param("DRIVE {Left 1.0} {Right -1.0}", id="manual 9.4"),
        pytest.param("Drive {Left 1.0} {Right -1.0}", id="MOAST's head"),
        pytest.param("drive {Left 1.0} {Right -1.0}", id="lower case head"),
        pytest.param("DRIVE {Left 1.0}{Right -1.0}", id="no space between segments"),
        pytest.param("DRIVE{Left 1.0} {Right -1.0}", id="no space after the head"),
        pytest.param("  DRIVE   {  Left   1.0 }   { Right -1.0  }  ", id="spaces everywhere"),
        pytest.param("DRIVE\t{Left\t1.0}\t{Right\t-1.0}", id="tabs"),
        pytest.param("DRIVE {Left 1.0} {Right -1.0", id="last brace missing, as from PYRO"),
        pytest.param("DRIVE {} {Left 1.0} { } {Right -1.0}", id="empty segments"),
        pytest.param("DRIVE please {Left 1.0} and {Right -1.0} now", id="text outside the braces"),
    ],
)
def test_sloppy_lines_mean_the_same(line):
    assert parse_message(line) == Message("DRIVE", LEFT_RIGHT)


def test_a_head_alone_is_a_message():
    assert parse_message("GETSTARTPOSES") == Message("GETSTARTPOSES", ())
    assert format_message(Message("GETSTARTPOSES")) == "GETSTARTPOSES"


def test_a_head_may_touch_its_first_brace():
    assert parse_message("Com1{A b}") == Message("COM1", (("A", "b"),))


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        ("", "no command word"),
        ("{Left 1.0}", "no command word"),
        ("} {Left 1.0}", "no command word"),
        ("1.0 {Left 1.0}", "no command word"),
        ("\xff\xfd\x01\x00 {Left 1.0}", "no command word"),
        ("DRIVE Left 1.0} {Right 1.0}", "before the first"),
        ("DRIVE {Left 1.0 {Right 1.0}", "opens inside"),
        ("DRIVE {Left 1.0}} {Right 1.0}", "second"),
        ("DRIVE {Left 1.0} Right 1.0}", "second"),
        ("DRIVE {Left 1.0}\r\nDRIVE {Left 2.0}", "line end"),
    ],
)
def test_lines_without_sense_say_why(line, reason):
    with pytest.raises(PeerError, match=reason):
        parse_message(line)


def test_get_ignores_case_and_takes_the_first():
    message = parse_message("MISPKG {name Arm} {Link 1} {link 2}")
    assert message.get("NAME") == "Arm"
    assert message.get("Link") == "1"
    assert message.all("LINK") == ("1", "2")
    assert message.get("Value") == ""
    assert message.all("Value") == ()


@pytest.mark.parametrize(
    "message",
    [
        Message("", ()),
        Message("TWO WORDS", ()),
        Message("SEN", (("", "x"),)),
        Message("SEN", (("Na me", "x"),)),
        Message("SEN", (("Name", "a}b"),)),
        Message("SEN", (("Name", "a{b"),)),
        Message("SEN", (("Name", "a\r\nDRIVE"),)),
        Message("SEN", (("Name", " a"),)),
    ],
)
def test_what_the_grammar_cannot_carry_is_our_fault(message):
    with pytest.raises(UsageError):
        format_message(message)


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1.5", 1.5),
        ("+1.5", 1.5),
        ("-1.5e2", -150.0),
        (".4", 0.4),
        ("-.4", -0.4),
        ("3.", 3.0),
        ("1.5rad", 1.5),
        ("1e", 1.0),
        ("1.2.3", 1.2),
        (" 7", 7.0),
        ("", 0.0),
        ("left", 0.0),
        (".", 0.0),
        ("-", 0.0),
        ("0x10", 0.0),
        ("٣", 0.0),  # a digit to Python, not to C
    ],
)
def test_numbers_are_read_as_atof_does(text, value):
    assert to_float(text) == value


@pytest.mark.parametrize(
    "text", ["nan", "NaN", "-nan(1)", "inf", "+INF", "-Infinity", "1e39", "1e999", "9" * 5000]
)
@pytest.mark.parametrize("read", [to_float, to_int, to_bool, to_vector])
def test_numbers_that_are_not_finite_are_refused(read, text):
    with pytest.raises(PeerError, match="not a finite number"):
        read(text)


@pytest.mark.parametrize("read", [to_float, to_int, to_bool])
@pytest.mark.parametrize("text", ["1,00", "-2,50", ",5", " 7,1"])
def test_a_decimal_comma_is_refused(read, text):
    """Cut at the comma, as atof does, it would be another number."""
    with pytest.raises(PeerError, match="decimal comma"):
        read(text)


def test_a_vector_with_decimal_commas_is_refused():
    with pytest.raises(PeerError, match="'1,50' has a decimal comma"):
        to_vector("1,50 2,00 -3,00")


@given(st.floats(min_value=-3.4e38, max_value=3.4e38))  # the original's floats have single precision
def test_python_floats_are_read_back(value):
    assert to_float(repr(value)) == value


@pytest.mark.parametrize(
    ("text", "value"), [("2", 2), ("0.5", 0), ("-1.9", -1), ("10", 10), ("x", 0), ("1e2", 100)]
)
def test_integers_are_cut(text, value):
    assert to_int(text) == value


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("True", True),
        ("true", True),
        ("TRUE", True),
        ("1", True),
        ("1.0", True),
        ("False", False),
        ("false", False),
        ("0", False),
        ("", False),
        ("yes", False),
    ],
)
def test_booleans(text, value):
    assert to_bool(text) is value


@pytest.mark.parametrize(
    ("text", "vector"),
    [
        ("4.5,1.9,1.8", (4.5, 1.9, 1.8)),  # manual 9.4
        ("4.5, 1.9, 1.8", (4.5, 1.9, 1.8)),  # PYRO
        ("4.5 1.9 1.8", (4.5, 1.9, 1.8)),  # Player
        ("4.5 , 1.9 , 1.8", (4.5, 1.9, 1.8)),
        ("4.5   1.9\t1.8", (4.5, 1.9, 1.8)),
        ("0.00,0.00,0.00,0.00", (0.0, 0.0, 0.0, 0.0)),  # manual 5.3.3
        ("1,,3", (1.0, 0.0, 3.0)),
        ("7", (7.0,)),
        ("", ()),
    ],
)
def test_vectors(text, vector):
    assert to_vector(text) == vector


def float32(value):
    return struct.unpack("f", struct.pack("f", value))[0]


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (math.pi, "3.1415"),  # manual 9.3: FOV
        (math.pi / 2, "1.5707"),  # manual 9.3: Orientation
        (2 * math.pi / 3, "2.0943"),  # manual 9.3: MaxSpeed
        (math.radians(1.0), "0.0174"),  # manual 9.3: Resolution
        (0.29, "0.2900"),
        (1.0, "1.0000"),
        (4.35, "4.3500"),  # 4.35 * 10000 is below 43500 in binary
        (5608.85, "5608.8500"),
        (-0.5157, "-0.5157"),
        (-0.00001, "-0.0000"),
        (-0.0, "-0.0000"),
        (0.0, "0.0000"),
        (0.99999, "0.9999"),
        (-1.99999, "-1.9999"),
        (1e6, "1000000.0000"),
        (float32(0.13), "0.1300"),  # below 0.13
        (float32(19.7), "19.7000"),  # below 19.7
        (float32(math.pi), "3.1415"),
    ],
)
def test_four_decimals_are_cut_not_rounded(value, text):
    assert four_decimals(value) == text


@given(st.integers(-(10**9), 10**9))
def test_a_number_of_four_decimals_is_printed_as_itself(ten_thousandths):
    expected = Decimal(ten_thousandths).scaleb(-4)
    assert Decimal(four_decimals(ten_thousandths / 10_000)) == expected


@given(st.integers(-320_000, 320_000))
def test_a_float32_of_four_decimals_is_printed_as_itself_up_to_32(ten_thousandths):
    expected = Decimal(ten_thousandths).scaleb(-4)
    assert Decimal(four_decimals(float32(ten_thousandths / 10_000))) == expected


@given(st.floats(-1e6, 1e6))
def test_cutting_agrees_with_decimal_arithmetic_beyond_the_margin(value):
    exact = Decimal(value)
    cut = exact.quantize(Decimal("0.0001"), rounding=ROUND_DOWN)
    if abs(exact - cut) < Decimal("0.0000989"):  # else it may count as the next one
        assert Decimal(four_decimals(value)) == cut


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (5609.4467, "5609.45"),
        (62.01, "62.01"),
        (6.2832, "6.28"),
        (-0.001, "-0.00"),
        (300, "300.00"),
    ],
)
def test_two_decimals_are_rounded_as_captured(value, text):
    assert two_decimals(value) == text


@pytest.mark.parametrize("write", [four_decimals, two_decimals])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_cannot_be_reported(write, value):
    with pytest.raises(UsageError, match="cannot be reported"):
        write(value)


def test_lists_have_commas_only():
    assert four_decimals_list([1.0, -2.5]) == "1.0000,-2.5000"
    assert two_decimals_list([1.0, -2.5]) == "1.00,-2.50"
    assert four_decimals_list([]) == ""


@pytest.mark.parametrize("text", ["", "two words", "tab\there"])
def test_a_name_inside_a_segment_is_one_word(text):
    assert check_word("F1") == "F1"
    with pytest.raises(UsageError, match="one word"):
        check_word(text)


def test_text_for_the_log_is_short_and_on_one_line():
    assert clip("a\r\nb") == r"'a\r\nb'"
    assert len(clip("x" * 10_000)) < 80
