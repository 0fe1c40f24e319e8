"""The table of arguments, walked with every kind of nonsense."""

import pytest

from usarmjx.base.errors import PeerError
from usarmjx.base.settings import Parameters, Setting
from usarmjx.server.protocol.arguments import ANY_KEY, ARGUMENTS, ArgumentKind, read_parameters
from usarmjx.server.protocol.command_parsers import COMMANDS, parse_command
from usarmjx.server.protocol.grammar import parse_message

NONSENSE = ("abc", "1abc", "--1", "1.2.3", "0x10", "1;2", "one", ".", "1,2,x")
CONTEXT = {  # what a line needs beside the argument, to be a command
    "INIT": "{ClassName P2AT}",
    "DRIVE": "{Name Arm}",
    "MISPKG": "{Name Arm} {Link 1}",
    "CONTROL": "{Type AbsMove} {Name R1}",
}
NUMBERS = {
    ArgumentKind.NUMBER: ("1", "-.4", "3.", "1e-1"),
    ArgumentKind.TRUTH: ("True", "false", "1"),
}
EVERY = [(head, key) for head, arguments in ARGUMENTS.items() for key in arguments]


@pytest.mark.parametrize(("head", "key"), EVERY)
def test_every_argument_refuses_nonsense_and_says_what_it_may_be(head, key):
    argument = ARGUMENTS[head][key]
    name = "FRFlipper" if key == ANY_KEY else key
    for text in NONSENSE:
        line = f"{head} {{{name} {text}}} {CONTEXT.get(head, '')}"
        if key == "Link":
            line = f"{head} {{Name Arm}} {{Link {text}}}"
        with pytest.raises(PeerError, match=f"{name}.* is .*; expected {argument.kind.value}"):
            parse_command(parse_message(line))


VECTORS = [(head, key) for head, key in EVERY if ARGUMENTS[head][key].kind is ArgumentKind.VECTOR]


@pytest.mark.parametrize(("head", "key"), [*VECTORS, ("CONTROL", "Speed")])
@pytest.mark.parametrize("text", ["3", "3,1", "3 1", "3,1,1,1", "1,2,3,4,5,6", "3,,1"])
def test_a_vector_has_three_numbers(head, key, text):
    """An object would move to a place that nobody named, and KillAll would clear all of the arena."""
    context = "{Type Rotate} {Name R1}" if key == "Speed" else CONTEXT.get(head, "")
    with pytest.raises(PeerError, match=f"{key}.* is .*; expected (three )?numbers"):
        parse_command(parse_message(f"{head} {{{key} {text}}} {context}"))


@pytest.mark.parametrize(("head", "key"), EVERY)
def test_every_argument_takes_what_controllers_send(head, key):
    name = "FRFlipper" if key == ANY_KEY else key
    forms = NUMBERS.get(ARGUMENTS[head][key].kind, ("1,2,3", "1 2 3", "1, 2, 3"))
    for text in forms:
        line = f"{head} {{{name} {text}}} {CONTEXT.get(head, '')}"
        parse_command(parse_message(line.replace("{Link 1}", "") if key == "Link" else line))


def test_the_table_has_no_head_that_is_no_command():
    assert set(ARGUMENTS) <= set(COMMANDS.names())


def test_a_joint_is_not_moved_by_words():
    with pytest.raises(PeerError, match="expected 0 to 2 numbers"):
        parse_command(parse_message("SET {Type Joint} {Name Arm} {Opcode Angle} {Params far}"))


@pytest.mark.parametrize(
    ("text", "form", "values"),
    [
        ("", Parameters(), ()),
        ("1", Parameters(), (1.0,)),
        ("0.5", Parameters(1, 1), (0.5,)),
        ("1,2,3,4,5,6", Parameters(6, 6), (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
        ("1, 2, 3, 4 , 5 6", Parameters(6, 6), (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)),
        ("-1", Parameters(1, 1, Setting(ge=-1, le=1)), (-1.0,)),
    ],
)
def test_parameters_are_read(text, form, values):
    assert read_parameters(text, form) == values


@pytest.mark.parametrize(
    ("text", "form", "message"),
    [
        ("", Parameters(1, 1), "expected a number"),
        ("1 2", Parameters(1, 1), "expected a number"),
        ("x", Parameters(), "expected at most one number"),
        ("1,2,3,4,5", Parameters(6, 6), "expected 6 numbers"),
        ("1,2,3,,5,6", Parameters(6, 6), "expected 6 numbers"),
        ("a,b,c,d,e,f", Parameters(6, 6), "expected 6 numbers"),
        ("2", Parameters(1, 1, Setting(ge=-1, le=1, unit="rad")), r"a number from -1 to 1 \[rad\]"),
        ("nan", Parameters(1, 1), "not a finite number"),
    ],
)
def test_parameters_of_another_form_are_refused(text, form, message):
    with pytest.raises(PeerError, match=message):
        read_parameters(text, form)
