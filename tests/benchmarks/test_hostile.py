"""Parts of the second hostile suite that need no server: its frames, its measuring, what it calls a fault."""

import json
import zlib
from pathlib import Path

import pytest
from websockets.frames import Frame, Opcode
from websockets.streams import StreamReader

from benchmarks.hostile import frames
from benchmarks.hostile.attacks import ATTACKS, DATAGRAMS, PORTS
from benchmarks.hostile.meter import GapMeter
from benchmarks.hostile.stage import Stage
from benchmarks.hostile.table import PORT_NAMES, read_records, worst_table

ROOT = Path(__file__).parents[2]
STA = "STA {{Type GroundVehicle}} {{Time {:.2f}}} {{Battery 3600}}\r\n"


def parsed(data, *, mask=True):
    """The frames in some bytes, as the library `websockets` reads them."""
    reader, found = StreamReader(), []
    reader.feed_data(data)
    reader.feed_eof()
    while not run(reader.at_eof()):
        found.append(run(Frame.parse(reader.read_exact, mask=mask)))
    return found


def run(steps):
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value


@pytest.mark.parametrize("size", [0, 1, 125, 126, 65535, 65536])
def test_a_frame_is_read_as_it_was_written(size):
    """Lengths at the borders of RFC 6455 5.2."""
    payload = bytes(i % 251 for i in range(size))
    (found,) = parsed(frames.websocket_frame(payload, frames.BINARY))
    assert (found.opcode, found.data, found.fin, found.rsv1) == (Opcode.BINARY, payload, True, False)
    (plain,) = parsed(frames.websocket_frame(payload, masked=False), mask=False)
    assert (plain.opcode, plain.data) == (Opcode.TEXT, payload)


def test_fragments_are_a_message_in_frames_of_a_byte():
    found = parsed(frames.byte_fragments(b"abc"))
    assert [one.data for one in found] == [b"a", b"b", b"c"]
    assert [one.opcode for one in found] == [Opcode.TEXT, Opcode.CONT, Opcode.CONT]
    assert [one.fin for one in found] == [False, False, True]


def test_a_length_may_be_a_lie_and_a_bomb_unpacks():
    assert frames.websocket_frame(b"", length=1 << 62)[2:10] == (1 << 62).to_bytes(8, "big")
    packed = frames.deflate_bomb(1 << 20)
    assert len(packed) < 2000
    assert zlib.decompressobj(-zlib.MAX_WBITS).decompress(packed + frames.SYNC) == b" " * (1 << 20)
    assert frames.websocket_frame(packed, compressed=True)[0] == 0b1100_0001  # FIN, RSV1, text
    assert json.loads(frames.wide_json(3)) == {"k0": 0.1, "k1": 1.1, "k2": 2.1}
    assert json.loads(frames.deep_json(3)) == [[[]]]


def test_the_meter_finds_the_longest_wait_and_its_processor_time():
    meter = GapMeter()
    meter.feed(b"NFO {Gametype BotDeathMatch}\r\n" + STA.format(1.0).encode(), 10.0, 1.0, 2.0)
    meter.feed(STA.format(1.2).encode(), 10.2, 1.02, 2.1)
    meter.feed(b"SEN {Type Sonar} {Name F1 Range 2.5}\r\n" + STA.format(1.4).encode()[:9], 11.2, 1.3, 2.2)
    meter.feed(STA.format(1.4).encode()[9:], 11.3, 1.31, 2.25)
    found = meter.finish(11.35, 1.32, 2.3)
    assert found["gap"] == pytest.approx(1.0)
    assert found["processor"] == pytest.approx(0.28)
    assert found["process"] == pytest.approx(0.1)
    assert (found["reports"], found["irregular"], found["damaged"], found["lost"]) == (4, 0, 0, 0)


def test_a_wait_that_lasts_counts_and_the_next_lap_goes_on_from_it():
    meter = GapMeter()
    meter.feed(STA.format(1.0).encode(), 10.0, 0.0, 0.0)
    assert meter.finish(13.0, 0.5, 0.6)["gap"] == pytest.approx(3.0)
    assert meter.finish(14.0, 0.7, 0.8)["processor"] == pytest.approx(0.7)


@pytest.mark.parametrize(
    ("line", "damaged", "irregular"),
    [
        (STA.format(1.2), 0, 0),
        (STA.format(1.4), 0, 1),
        (STA.format(1.0), 0, 1),
        (STA.format(1.2).replace("}", "", 1), 1, 0),
        ("TA {Time 1.2}}\r\n", 1, 0),
        ("RES {Time 1.2} {Type Camera} {Status OK}\r\n", 0, 0),
    ],
)
def test_a_line_that_is_no_message_and_a_time_out_of_order_count(line, damaged, irregular):
    meter = GapMeter()
    meter.feed((STA.format(1.0) + line).encode(), 1.0, 0.0, 0.0)
    found = meter.finish(1.0, 0.0, 0.0)
    assert (found["damaged"], found["irregular"]) == (damaged, irregular)


def test_every_port_has_attacks_of_its_own_and_names_differ():
    names = [one.name for one in ATTACKS]
    assert len(set(names)) == len(names) >= 60
    assert {one.port for one in ATTACKS} - {"", "any"} == set(PORTS)
    assert DATAGRAMS not in ATTACKS
    stage = Stage({port: 1 for port in PORTS}, until=0.0)
    for one in ATTACKS:
        assert one.act or one.sends or one.hello
        for build in filter(None, (one.hello, one.sends)):
            assert isinstance(build(stage, 3), bytes)


def test_the_page_on_security_has_the_table_of_the_published_run():
    records = read_records(ROOT / "benchmarks" / "results" / "attacks" / "hostile.jsonl")
    assert [record["attack"] for record in records] == [attack.name for attack in ATTACKS], "a whole run"
    assert len({record["commit"] for record in records}) == 1
    table = worst_table(records)
    page = (ROOT / "docs" / "security.md").read_text(encoding="utf-8")
    assert table in page
    for figure, words in (("gap", "worst wait is"), ("processor", "most processor time")):
        worst = max(records, key=lambda record, figure=figure: record[figure])
        assert f"{words} {worst[figure]:.2f} s, by `{worst['attack']}`" in page
    assert sum(int(row.split("|")[2]) for row in table.splitlines()[2:]) == len(ATTACKS)
    assert {attack.port for attack in (*ATTACKS, DATAGRAMS)} == PORT_NAMES.keys()
