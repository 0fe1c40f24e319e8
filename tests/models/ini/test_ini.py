"""Ini files in, values out. The oracles are the manual's examples, and a writer that is its own inverse."""

import codecs
import contextlib
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usarmjx.base.errors import SpecError
from usarmjx.models.ini.parse import MAX_DEPTH, IniFile, Line, Reference, Section, Struct, parse_ini, read_ini

# Three readings of 50 000 characters take 0.02 s; one pattern that tries every split of them takes minutes.
LONG_LINES_SECONDS = 2.0

MANUAL = r"""
; manual 12.1.2, its line breaks mended
[USARBot.P2AT]
msgTimer=0.200000
bAbsoluteCamera=true
bMountByUU=True
Weight=14
Sensors=(ItemClass=class'USARBot.SonarSensor',ItemName="F1",Position=(X=7.6125,Y=-6.825,Z=0),Direction=(Y=0,Z=-16384,X=0))
Sensors=(ItemClass=class'USARBot.SonarSensor',ItemName="F8",Position=(X=7.6125,Y=6.825,Z=0),Direction=(Y=0,Z=16384,X=0))
Cameras=(ItemClass=class'USARBot.RobotCamera',ItemName="Camera",Parent="CameraTilt",Position=(Y=0,X=4.2,Z=-3.36),Direction=(Y=0,Z=0,X=0))

// manual 10.2.2
[USARBot.SonarSensor]
HiddenSensor=true
MaxRange=5.0
OutputCurve=(Points=((InVal=0.000000,OutVal=0.000000),(InVal=5.000000,OutVal=5.000000)))

[USARBot.Gripper] ; manual 11.1.2
LeftFinger=LeftFinger

[USARBot.RFIDReleaser]
  Weight=0,4
NumTags = 10

[USARBot.Lisa]
Wheels(0)=(Number=0,PowerType=Holo_Powered,SteerType=Holo_Steered,MaxSteerAngle=3.14);
Wheels(3)=(Number=3,PowerType=Not_Powered);

[Server]
Path=c:\ut2004
Location=4.5,1.9,1.8
"""


def values_of(*lines: str) -> list[object]:
    """Return the values that are left of these lines of a section."""
    return [line.value for line in parse_ini("\n".join(["[A]", *lines])).section("A").lines]


def same(one: object, other: object) -> bool:
    """Return whether values are equal in type too, which `==` does not tell of 1, 1.0 and True."""
    return repr(one) == repr(other)


def place(**axes: float) -> Struct:
    return Struct(tuple(axes.items()))


def test_the_manuals_robot_is_read():
    robot = parse_ini(MANUAL, "USARBot.ini").section("usarbot.p2at")
    assert same([robot.lines[at].value for at in range(4)], [0.2, True, True, 14])
    first, second = robot.get_all("SENSORS")
    mount = Struct(
        (
            ("ItemClass", Reference("class", "USARBot.SonarSensor")),
            ("ItemName", "F1"),
            ("Position", place(X=7.6125, Y=-6.825, Z=0)),
            ("Direction", place(Y=0, Z=-16384, X=0)),
        )
    )
    assert first == Line("Sensors", mount, "USARBot.ini", 8, None)
    assert isinstance(second.value, Struct)
    assert second.value.get("itemname") == "F8"
    assert second.value.get("Parent", "HARD") == "HARD"


def test_the_manuals_sensors_effecters_and_worlds_are_read():
    ini = parse_ini(MANUAL)
    points = (place(InVal=0.0, OutVal=0.0), place(InVal=5.0, OutVal=5.0))
    assert values_in(ini, "USARBot.SonarSensor") == [True, 5.0, Struct((("Points", points),))]
    assert values_in(ini, "USARBot.Gripper") == ["LeftFinger"]
    assert same(values_in(ini, "USARBot.RFIDReleaser"), [0.4, 10])
    assert values_in(ini, "Server") == ["c:\\ut2004", "4.5,1.9,1.8"]
    wheels = ini.section("USARBot.Lisa").get_all("wheels")
    assert [(wheel.key, wheel.index) for wheel in wheels] == [("Wheels", 0), ("Wheels", 3)]
    assert wheels[1].value == Struct((("Number", 3), ("PowerType", "Not_Powered")))


def values_in(ini: IniFile, section: str) -> list[object]:
    return [line.value for line in ini.section(section).lines]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("-32768", -32768),
        ("+7", 7),
        ("0.2f", 0.2),
        (".5", 0.5),
        ("5.", 5.0),
        ("-3e2", -300.0),
        ("0,4", 0.4),
        ("-0,4", -0.4),
        ("1,2,3", "1,2,3"),
        ("TRUE", True),
        ("false", False),
        ("nan", "nan"),  # Unreal has no such numbers, nor Python's forms
        ("inf", "inf"),
        ("1_0", "1_0"),
        ("0x10", "0x10"),
        ("", ""),
        ("  Left Wheel  ", "Left Wheel"),
        ("a=b", "a=b"),
        ('"1"', "1"),
        ('"c:\\"', "c:\\"),
        ("'F1'", "F1"),
        ("StaticMesh'USARSim_Vehicles.P2AT'", Reference("StaticMesh", "USARSim_Vehicles.P2AT")),
        ("Class 'A.B'", Reference("Class", "A.B")),
        ("()", Struct(())),
        ("( X = 1 ,\tY = Left Wheel )", Struct((("X", 1), ("Y", "Left Wheel")))),
        ("(A=,B=0)", Struct((("A", ""), ("B", 0)))),
        ("(0,4)", (0, 4)),
        ('("DM-A","DM-B")', ("DM-A", "DM-B")),
        ("(class'A.B',((1)),())", (Reference("class", "A.B"), ((1,),), Struct(()))),
    ],
)
def test_a_value_means(text, value):
    assert same(values_of(f"Key={text}"), [value])


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("2.5  ;Maximum noise, in metres (don't", 2.5),
        ("0.349;", 0.349),
        ("; nothing", ""),
        ("(X=1); the end (", place(X=1)),
        ('"a;b" ; c', "a;b"),
        ('say "a;b" (c;d) ; e', 'say "a;b" (c;d)'),
        ('(X="a;b",Y=c;d)', Struct((("X", "a;b"), ("Y", "c;d")))),
        ("http://a.b/c", "http://a.b/c"),
    ],
)
def test_a_comment_ends_a_value_but_not_within_quotes_or_brackets(text, value):
    assert same(values_of(f"Key={text}"), [value])


def test_of_a_name_given_twice_the_last_counts():
    section = parse_ini("[A]\nWeight=1\nweight=2\nOther=3").section("a")
    assert [line.value for line in section.get_all("WEIGHT")] == [1, 2]
    last = section.last("weighT")
    assert last is not None
    assert last.value == 2
    assert section.last("Mass") is None
    assert Struct((("X", 1), ("x", 2))).get("X") == 2


def test_a_repeated_section_goes_on_and_a_missing_one_is_empty():
    ini = parse_ini("[A]\nX=1\n[B]\nX=2\n[a]\nX=3")
    assert [section.name for section in ini.sections] == ["A", "B", "a"]
    merged = ini.section("a")
    assert merged.name == "A"
    assert [(line.value, line.line) for line in merged.lines] == [(1, 2), (3, 6)]
    assert ini.section("C") == Section("C", ())


@pytest.mark.parametrize(
    ("lines", "left"),
    [
        (["X=1", "+X=2", ".X=2", "X=3"], [1, 2, 2, 3]),
        (["X=1", "X=2", "X=1", "-x=1", "X=1"], [2, 1]),
        (["X=1", "X=1.0", "X=true", "Y=1", "-X=1"], [1.0, True, 1]),
        (["X=(A=1,B=2)", "-X=( A=1, B=2 ) ; the same"], []),
        (["X(0)=1", "X(1)=1", "X=1", "-X(1)=1"], [1, 1]),
        (["X=1", "-X=2", "!Y=all"], [1]),
        (["X=1", "X(0)=2", "Y=3", "!x=", "X=4"], [3, 4]),
        (["X(0)=1", "X[1]=2", "X=3", "!X(1)="], [1, 3]),
        (["X=1", "[B]", "X=1", "-X=1", "[a]", "X=2", "-X=1"], [2]),
        (["X=1", "[B]", "!X="], [1]),
    ],
)
def test_prefixes_add_remove_and_clear_within_their_section(lines, left):
    assert same(values_of(*lines), left)


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_line_numbers_count_every_kind_of_line(end):
    ini = parse_ini(end.join(["", "; one", "[A]", "", "// two", "\tX=1", ""]))
    assert ini.sections == (Section("A", (Line("X", 1, "<text>", 6, None),)),)


BROKEN = {
    "[A]\nX=(A=(B=1)": "2: the '(' in column 3 is never closed; expected a ')'",
    "[A]\nX=(": "2: the '(' in column 3 is never closed",
    "[A]\nX=call(me": "2: the '(' in column 7 is never closed",
    "[A]\nX=(A=1))": "2: ')' follows the value; expected the end of the line",
    "[A]\nX=1)": "2: the ')' in column 4 closes nothing",
    '[A]\n  X="F1': '2: the " in column 5 is never closed; expected another "',
    "[A]\nX=(A=class'B.C)": "2: the ' in column 11 is never closed",
    "[A]\nX=Don't": "2: the ' in column 6 is never closed; expected another ' (text with an apostrophe",
    '[A]\nX="F1" F2': "2: 'F2' follows the value",
    "[A]\nX=(A=1 B=2)": "2: '=2)' follows a value within brackets; expected ',' or ')'",
    '[A]\nX=(A="1"B)': "2: 'B)' follows a value within brackets; expected ',' or ')'",
    "[A]\nX=(A=1,)": "2: nothing stands before the ')' in column 8",
    "[A]\nX=(1,,2)": "2: nothing stands before the ',' in column 6",
    "[A]\nX=(1,A=2)": "2: some values within brackets have names and some have not",
    "[A]\nX=(MaxSt eerAngle=3.14)": "2: 'MaxSt eerAngle' is no name of a value",
    "[A]\nX=(a b'C')": "2: 'a b' stands before a quote; expected a kind",
    "[A]\nX=1e999": "2: '1e999' is too large for a number",
    "[A]\nX=" + "9" * 5000: "is too large for a number",
    "X=1\n[A]": "1: 'X=1' stands before the first section; expected a [Section] above it",
    "[A]\nX=1\nY": "3: 'Y' has no '='; expected key=value",
    "[A]\n!X": "2: '!X' has no '='",
    "[A]\n00,OutVal=5.0)))": "2: '00,OutVal' is no key; expected one word before the '='",
    "[A]\nX(0]=1": "2: 'X(0]' is no key",
    "[A]\n=1": "2: '' is no key",
    "[A": "1: '[A' is no section header; expected [Name]",
    "[ ]": "1: '[ ]' is no section header",
    "[A]]": "1: ']' follows the section header",
    "[USARBot.P2AT] msgTimer=0.2 Weight=14": "1: 'msgTimer=0.2 Weight=14' follows the section header; "
    "expected each key=value on a line of its own",
}


@pytest.mark.parametrize("text", BROKEN)
def test_a_broken_file_is_refused_with_file_line_and_what_was_expected(text):
    with pytest.raises(SpecError) as refusal:
        parse_ini(text, "robots.ini")
    assert str(refusal.value).startswith("robots.ini:")
    assert BROKEN[text] in str(refusal.value)
    assert len(str(refusal.value)) < 250  # whatever the file holds


def test_brackets_nest_to_the_limit_and_no_deeper():
    def nested(depth: int) -> str:
        return "(" * depth + "1" + ")" * depth

    (value,) = values_of("X=" + nested(MAX_DEPTH))
    for _ in range(MAX_DEPTH):
        assert isinstance(value, tuple)
        (value,) = value
    assert value == 1
    for depth in (MAX_DEPTH + 1, 100_000):
        with pytest.raises(
            SpecError, match=f"number {MAX_DEPTH + 1} within another; expected up to {MAX_DEPTH}"
        ):
            parse_ini("[A]\nX=" + nested(depth))


@pytest.mark.parametrize(
    "hostile",
    ["1" * 50_000 + "x", " " * 50_000 + "x", "(" + "a " * 25_000, "(" + "1," * 25_000, "(1," * 9_000],
)
def test_long_lines_take_no_long_time(hostile):
    start = time.perf_counter()
    for text in (f"[A]\nX={hostile}", f"[A]\n{hostile}=1", f"[{hostile}"):
        with contextlib.suppress(SpecError):
            parse_ini(text)
    assert time.perf_counter() - start < LONG_LINES_SECONDS


@pytest.mark.parametrize(
    "data",
    [
        '[A]\r\nX="Köln"'.encode(),
        codecs.BOM_UTF8 + '[A]\nX="Köln"'.encode(),
        '[A]\nX="Köln"'.encode("utf-16"),
        codecs.BOM_UTF16_BE + '[A]\nX="Köln"'.encode("utf-16-be"),
        '[A]\nX="Köln"'.encode("latin-1"),
    ],
    ids=["utf-8", "utf-8 with mark", "utf-16", "utf-16 big-endian", "latin-1"],
)
def test_files_are_read_in_their_encoding(tmp_path, data):
    path = tmp_path / "USARBot.ini"
    path.write_bytes(data)
    assert read_ini(path) == IniFile(str(path), (Section("A", (Line("X", "Köln", str(path), 2, None),)),))


def test_a_byte_order_mark_left_in_the_text_is_dropped():
    assert parse_ini("\ufeff[A]").section("A").name == "A"
    assert len(parse_ini("\ufeff[A]").sections) == 1


def test_files_that_cannot_be_read_are_named(tmp_path):
    with pytest.raises(SpecError, match=r"none\.ini: cannot be read: No such file"):
        read_ini(tmp_path / "none.ini")
    for mark, name in ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF8, "utf-8")):
        path = tmp_path / "odd.ini"
        path.write_bytes(mark + b"\xff")
        with pytest.raises(SpecError, match=rf"odd\.ini: is marked as {name}.* but is not"):
            read_ini(path)


NAMES = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
LEAVES = st.one_of(
    st.booleans(),
    st.integers(-(2**63), 2**63),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text(st.characters(exclude_characters='"\r\n'), max_size=12),
    st.builds(Reference, NAMES, st.text(st.characters(exclude_characters="'\r\n"), max_size=12)),
)
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.lists(inner, min_size=1, max_size=4).map(tuple),
        st.lists(st.tuples(NAMES, inner), max_size=4).map(lambda fields: Struct(tuple(fields))),
    ),
    max_leaves=20,
)
SPACE = st.sampled_from(["", " ", "\t "])


def written(value: object, space: str) -> str:
    """Write a value as Unreal would, with this much space wherever some may be."""
    if isinstance(value, str):
        return f'"{value}"'
    if isinstance(value, Reference):
        return f"{value.kind}'{value.name}'"
    if isinstance(value, Struct):
        items = [f"{name}{space}={space}{written(item, space)}" for name, item in value.fields]
    elif isinstance(value, tuple):
        items = [written(item, space) for item in value]
    else:
        return str(value)
    return f"({space}{f'{space},{space}'.join(items)}{space})"


@given(VALUES, SPACE)
def test_a_written_value_is_read_back_the_same(value, space):
    assert same(values_of(f"Key={space}{written(value, space)}{space};"), [value])


@given(st.text(st.sampled_from("aX1.,;'\"()=[]+-!/ \n"), max_size=40))
def test_any_text_is_read_or_refused(text):
    with contextlib.suppress(SpecError):  # any other error fails the test
        lines = parse_ini("[A]\n" + text).section("A").lines
        assert all(1 < line.line <= text.count("\n") + 2 for line in lines)
