"""Memory of RFID tags over the wire: the manual's commands and answers (10.9.5 to 10.9.7)."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usarmjx.models.arenas import ARENAS
from usarmjx.models.types.arena import Tag
from usarmjx.server.gamebots.victims import MAX_TAG_TEXT, access_tag, initial_tag_texts
from usarmjx.server.protocol.command_parsers import parse_command
from usarmjx.server.protocol.commands import Set
from usarmjx.server.protocol.grammar import format_message, parse_message

NEAR = {118, 1001}


def told(line, texts):
    command = parse_command(parse_message(line))
    assert isinstance(command, Set)
    return format_message(access_tag(command, 5609.4467, texts, NEAR.__contains__))


def test_reading_tells_id_and_memory():
    texts = {1001: "two victims"}
    for number, memory in ((1001, "two victims"), (118, "0")):
        assert told(f"SET {{Type RFID}} {{Name RFID}} {{Opcode Read}} {{Params {number}}}", texts) == (
            f"RES {{Time 5609.45}} {{Type RFID}} {{Name RFID}} {{Status OK}} {{ID {number}}} {{Mem {memory}}}"
        )


def test_writing_and_erasing():
    """Erased by writing "0", or nothing (10.9.7)."""
    texts, done = {}, "RES {Time 5609.45} {Type RFID} {Name RFID} {Status OK}"
    assert told("SET {Type RFID} {Name RFID} {Opcode Write} {Params 118 here lies Bob}", texts) == done
    assert texts == {118: "here lies Bob"}
    assert (
        told("SET {Type RFID} {Name RFID} {Opcode write} {Params 118Bob}", texts) == done
    )  # without a space
    assert texts == {118: "Bob"}
    assert told("SET {Type RFID} {Name RFID} {Opcode Write} {Params 118 0}", texts) == done
    assert texts == {118: ""}
    texts[118] = "again"
    assert told("SET {Type RFID} {Name RFID} {Opcode Write} {Params 118}", texts) == done
    assert texts == {118: ""}


@pytest.mark.parametrize(
    "rest",
    [
        "{Opcode Read} {Params 5}",  # out of range
        "{Opcode Write} {Params 5 text}",
        "{Opcode Read}",
        "{Opcode Read} {Params Bob}",
        "{Opcode Read} {Params -1}",
        "{Opcode Burn} {Params 118}",
        "{Params 118}",
        f"{{Opcode Write}} {{Params 118 {'x' * (MAX_TAG_TEXT + 1)}}}",
        f"{{Opcode Read}} {{Params {'9' * 4000}}}",
    ],
)
def test_what_cannot_be_done_fails_and_changes_nothing(rest):
    texts = {118: "kept"}
    failed = "RES {Time 5609.45} {Type RFID} {Name RFID} {Status Failed}"
    assert told(f"SET {{Type RFID}} {{Name RFID}} {rest}", texts) == failed
    assert texts == {118: "kept"}


@settings(deadline=None)
@given(st.text(st.characters(codec="utf-8", exclude_characters="{}\r\n"), max_size=300))
def test_any_text_that_a_line_can_carry_is_read_back_as_it_was_written(text):
    texts = {}
    parsed = parse_command(
        parse_message(f"SET {{Type RFID}} {{Name R}} {{Opcode Write}} {{Params 118 {text}}}")
    )
    answer = access_tag(parsed, 1.0, texts, NEAR.__contains__)
    read = access_tag(Set("RFID", "R", "Read", "118"), 1.0, texts, NEAR.__contains__)
    line = format_message(read)
    if answer.get("Status") == "OK":
        assert parse_message(line).get("Mem") == (texts[118] or "0")
    else:
        assert texts == {}


def test_an_arenas_tags_start_with_what_is_written_on_them():
    yellow = ARENAS.get("yellow")
    tags = (Tag(at=(0, 0, 0), memory="room 1"), Tag(at=(1, 0, 0), id=2000))
    assert initial_tag_texts(yellow.__class__(**{**vars(yellow), "tags": tags})) == {1001: "room 1", 2000: ""}
