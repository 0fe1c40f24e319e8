"""The wireless servers on real sockets, in a running world whose robots drive out of range and back.

A world is served from a thread of this process, five times faster than the clock; wall-clock limits are far
above what an idle machine needs.
"""

import dataclasses
import hashlib
import math
import re
import socket
import struct
import threading
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from tests.arenas import COURSE, FLAT
from tests.server.peers import wait_until
from tests.server.radio_servers import REACH, SHORT, client, crowded, drain, on_air, spread
from usarmjx.cli.app import app
from usarmjx.comms.links import antenna_offset
from usarmjx.models.robots import ROBOTS
from usarmjx.server.network.ports import bound_socket
from usarmjx.server.viewing.controls import ServedControls
from usarmjx.server.viewing.viewer_service import ViewerService
from usarmjx.server.wireless.sockets import log

LINES = (
    r"usarmjx: listening on 127\.0\.0\.1:\d+\n"
    r"usarmjx: wireless server on 127\.0\.0\.1:\d+\n"
    r"usarmjx: second wireless server on 127\.0\.0\.1:\d+\n"
    r"usarmjx: positions on 127\.0\.0\.1:\d+\n"
)


@pytest.fixture(scope="module")
def world():
    return crowded(FLAT, "P2AT", "ComStation")


@pytest.fixture
def radio(world):
    with on_air(world) as radio:
        yield radio


def antenna_distance(places, one, other):
    """Distance of the antennas of a P2AT or ComStation each [m]; both stand upright."""
    ends = []
    for name in (one, other):
        kind = "ComStation" if name.startswith("Base") else "P2AT"
        ends.append(np.add(places[name], antenna_offset(ROBOTS.get(kind))))
    return math.dist(*ends)


def formula(distance, walls=0):
    """The manual's formula and defaults (manual 3.2.4) [dBm]."""
    return -49.67 - 10 * 1.09 * math.log10(distance / 2) - min(walls, 5) * 6.625


# Starting


def test_the_ports_are_announced(world, capfd):
    with on_air(world) as radio:
        assert len({radio.port, *radio.ports.values()}) == 4
    assert re.match(LINES, capfd.readouterr().out)


@pytest.mark.parametrize("option", ["--wss-port", "--wss2-port", "--position-port"])
def test_a_taken_port_is_one_clear_line_and_exit_code_2(world, monkeypatch, option):
    monkeypatch.setattr("usarmjx.server.worlds.make.make_worlds", lambda *args, **kwargs: [world])
    with bound_socket("127.0.0.1", 0) as taken:
        taken.listen()
        number = taken.getsockname()[1]
        others = {"--port", "--wss-port", "--wss2-port", "--position-port"} - {option}
        words = ["serve", option, str(number), *(word for other in others for word in (other, "0"))]
        result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert re.fullmatch(rf"usarmjx: cannot listen on 127\.0\.0\.1:{number}: .*\n", result.stderr)
    assert result.stdout == ""


def asked_for(server):
    """The services of a server but the live page, which all have, and its controls."""
    return [one for one in server.services if not isinstance(one, (ViewerService, ServedControls))]


def test_the_ini_names_the_port_and_the_constants(world, monkeypatch, tmp_path):
    """Manual 3.2.4.2."""
    monkeypatch.setattr("usarmjx.server.worlds.make.make_worlds", lambda *args, **kwargs: [world])
    seen = {}
    monkeypatch.setattr(
        "usarmjx.server.runtime.loop.serve", lambda servers, *_: seen.update(services=asked_for(servers[0]))
    )
    ini = tmp_path / "USARComServer.ini"
    ini.write_text("[USARBotAPI.ComServer]\nListenPort=4567\n[USARBotAPI.ComConnection]\neCutoff=-70\n")
    words = ["serve", "--no-images", "--radio-ini", str(ini)]
    assert CliRunner().invoke(app, words).exit_code == 0
    (service,) = seen["services"]
    assert service._settings.wss_port == 4567
    assert service._radio.cutoff == -70.0
    assert CliRunner().invoke(app, [*words, "--wss-port", "4568"]).exit_code == 0
    assert seen["services"][0]._settings.wss_port == 4568
    assert CliRunner().invoke(app, ["serve", "--no-wireless", "--no-images"]).exit_code == 0
    assert seen["services"] == []


def test_bdebug_makes_it_log(world, caplog):
    """Manual 3.2.4.2."""
    level = log.level
    try:
        for debug in (False, True):
            with on_air(world, dataclasses.replace(SHORT, debug=debug)) as radio:
                for i in (0, 1):
                    radio.robot(f"Base{i}", 0.5 * i)
                radio.link_a(radio.control_a("Base0", "Base1"), "Base0", "Base1")
            assert ("link between Base0 and Base1" in caplog.text) == debug
    finally:
        log.setLevel(level)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--radio-ini", "nowhere.ini"], "nowhere.ini"),
        (["--wireless-allow", "example.org"], "example.org: an IP address is expected"),
    ],
)
def test_a_wrong_radio_option_is_one_clear_line_and_exit_code_2(words, says):
    result = CliRunner().invoke(app, ["serve", *words])
    assert result.exit_code == 2
    assert result.stderr.startswith("usarmjx: ")
    assert says in result.stderr
    assert result.stderr.count("\n") == 1


# The signal


def test_all_three_services_agree_with_the_formula(radio):
    """Half a hundredth for the two decimals of dialect A, and as much for the places' four decimals."""
    radio.robot("Base", 0.0)
    radio.robot("R1", 2.0, 0.5, "P2AT").sta_times(10)  # it has settled on its wheels
    places = radio.places()
    assert places["Base"][:2] == pytest.approx((0.0, 0.0), abs=0.01)
    assert places["R1"][:2] == pytest.approx((2.0, 0.5), abs=0.05)
    expected = formula(antenna_distance(places, "Base", "R1"))
    assert radio.control_a("R1").strength("R1", "base") == pytest.approx(expected, abs=0.01)
    radio.control_b("Base")
    assert radio.control_b("R1").strength("Base") == pytest.approx(expected, abs=0.01)
    assert radio.ask_position("GETOBS {From R1} {To Base}").endswith("{ObstCount 0.00}")


def test_walls_count_in_all_three_services():
    """COURSE has one wall, at x = -2, from y = -2 to 2, 1 m high: antennas on masts look over it."""
    with on_air(crowded(COURSE, "ComStation")) as radio:
        radio.robot("Base1", -1.0)
        radio.robot("Base2", -3.0)
        walls = radio.ask_position("GETOBS {From Base1} {To Base2}")
        assert walls == "NUMOBS {From Base1} {To Base2} {ObstCount 0.00}"
        low = radio.ask_position("GETOBS {Start -1,0,-0.5} {End -3,0,-0.5}")
        assert low == "NUMOBS {Start -1,0,-0.5} {End -3,0,-0.5} {ObstCount 1.00}"
        assert radio.ask_position("GETOBS {Start -1,0,-1.5} {End -3,0,-1.5}").endswith("{ObstCount 0.00}")
        assert radio.control_a("Base1").strength("Base1", "Base2") == pytest.approx(formula(2.0), abs=0.01)


# Dialect A


def test_messages_cross_a_link_of_dialect_a_both_ways(radio):
    radio.robot("Base", 0.0)
    radio.robot("Base2", 1.0)
    near, far = radio.link_a(radio.control_a("Base", "Base2"), "Base2", "Base")
    near.send(b"hello;\r\n\0SEND 3 ")
    assert drain(far, 16) == b"hello;\r\n\0SEND 3 "
    far.send(b"")
    far.send(bytes(range(256)))
    assert drain(near, 256) == bytes(range(256))
    near._socket.sendall(b"CLOSE;")
    assert far.receive(60.0) == b""
    assert near.receive(60.0) == b""


def test_two_controllers_of_dialect_a_each_with_its_own_connection(radio):
    radio.robot("Base", 0.0)
    radio.robot("Base2", 1.0)
    one, two = radio.control_a("Base"), radio.control_a("Base2")
    door = radio.keep(one.listen("Base"))
    link = radio.keep(two.connect("Base2", "Base", door.port))
    link.send(b"hello")
    assert drain(radio.keep(door.accept(60.0)), 5) == b"hello"


WELL = 0.3  # dB; 20 cm here, so that a robot that rocks when it stops stays where it is


def drive_until(rover, spin, happens, what):
    """Drive straight on at so many rad/s until something happens, and stop."""
    rover.say(f"DRIVE {{Left {spin}}} {{Right {spin}}}")
    wait_until(happens, what)
    rover.say("DRIVE {Left 0} {Right 0}")


def test_a_link_of_dialect_a_breaks_at_the_first_send_without_a_signal(radio, world):
    radio.robot("Base", 0.0)
    rover = radio.robot("R1", 1.5, kind="P2AT")
    control = radio.control_a("Base", "R1")
    near, far = radio.link_a(control, "R1", "Base")
    near.send(b"near;")
    assert drain(far, 5) == b"near;"

    drive_until(rover, 5, lambda: control.strength("R1", "Base") < SHORT.cutoff - WELL, "the signal to fade")
    assert antenna_distance(radio.places(), "R1", "Base") >= REACH
    now = world.time
    wait_until(lambda: world.time > now + 2.0, "two seconds of the world's time")
    assert near.receive(0.0) is None, "nobody sends, nothing breaks"
    assert far.receive(0.0) is None
    near.send(b"lost")
    assert far.receive(60.0) == b"", "dropped, without notice"
    assert near.receive(60.0) == b""
    door = radio.keep(control.listen("Base"))
    with pytest.raises(client().RadioError, match="Cannot connect to Base"):
        control.connect("R1", "Base", door.port)

    drive_until(
        rover, -5, lambda: control.strength("R1", "Base") > SHORT.cutoff + WELL, "the signal to return"
    )
    assert antenna_distance(radio.places(), "R1", "Base") <= REACH
    near = radio.keep(control.connect("R1", "Base", door.port))
    near.send(b"back")
    assert drain(radio.keep(door.accept(60.0)), 4) == b"back"


def test_what_is_sent_on_the_way_out_arrives_up_to_some_message_and_no_further(radio):
    """No gap: all that was sent while in range, and nothing of what came after."""
    radio.robot("Base", 0.0)
    rover = radio.robot("R1", 2.0, kind="P2AT")
    near, far = radio.link_a(radio.control_a("Base", "R1"), "R1", "Base")
    rover.say("DRIVE {Left 5} {Right 5}")
    received, sent = b"", 0
    while (data := far.receive(0.0)) != b"":
        received += data or b""
        try:
            near.send(struct.pack(">I", sent))
            sent += 1
        except ConnectionError:
            pass
        time.sleep(0.001)
    count = len(received) // 4
    assert 10 < count < sent + 1
    assert received == b"".join(struct.pack(">I", number) for number in range(count))


# Dialect B


def test_a_pipe_of_dialect_b_closes_and_its_number_returns_with_the_signal(radio, world):
    radio.robot("Base", 0.0)
    rover = radio.robot("R1", 1.5, kind="P2AT")
    base, far_away = radio.control_b("Base"), radio.control_b("R1")
    near, far = radio.pipe_b(far_away, base, "Base")
    assert base.caller(far) == "R1"
    near.send(b"hello")
    assert drain(far, 5) == b"hello"
    number = near.peer_port()

    drive_until(rover, 5, lambda: far_away.strength("Base") < SHORT.cutoff - WELL, "the signal to fade")
    lost = world.time
    assert near.receive(60.0) == far.receive(60.0) == b""
    assert world.time - lost < 3.0, "it looks every simulated second; the rest is for a busy machine"
    with pytest.raises(client().RadioError, match="UnknownOrIllegalPort"):
        base.caller(near)
    with pytest.raises(ConnectionRefusedError):
        far_away.connect("Base")
    assert far_away.order("DNS", Robot="Base").value("Port") == str(number)

    drive_until(rover, -5, lambda: far_away.strength("Base") > SHORT.cutoff + WELL, "the signal to return")
    near, far = radio.pipe_b(far_away, base, "Base")
    assert near.peer_port() == number
    far.send(b"back")
    assert drain(near, 4) == b"back"


def test_a_closed_number_opens_by_itself(radio):
    """Nobody has to ask DNS again."""
    radio.robot("Base", 0.0)
    rover = radio.robot("R1", 4.0, kind="P2AT")
    radio.control_b("Base")
    number = int(radio.control_b("R1").order("DNS", Robot="Base").value("Port"))

    def answers():
        try:
            socket.create_connection(("127.0.0.1", number), 60.0).close()
        except ConnectionRefusedError:
            return False
        return True

    assert not answers()
    drive_until(rover, -5, answers, "the number to open")


# Leaving


def test_a_robot_that_leaves_loses_its_links(radio):
    radio.robot("Base", 0.0)
    guest = radio.robot("Base2", 1.0)
    control = radio.control_a("Base", "Base2")
    near, far = radio.link_a(control, "Base2", "Base")
    guest.close()
    assert near.receive(60.0) == far.receive(60.0) == b""
    with pytest.raises(client().RadioError, match="Could not calculate signal strength"):
        control.strength("Base", "Base2")
    assert set(radio.places()) == {"Base"}
    radio.robot("Base2", 1.0)
    control.strength("Base", "Base2")


def test_a_robot_that_leaves_is_out_of_dialect_b(radio):
    radio.robot("Base", 0.0)
    guest = radio.robot("Base2", 1.0)
    base, other = radio.control_b("Base"), radio.control_b("Base2")
    near, far = radio.pipe_b(other, base, "Base")
    guest.close()
    assert near.receive(60.0) == far.receive(60.0) == b""
    assert other._socket.recv(1) == b"", "its control connection too"
    with pytest.raises(client().RadioError, match=r"Robot\.Does\.Not\.Exist"):
        base.strength("Base2")
    radio.robot("Base2", 1.0)
    radio.pipe_b(radio.control_b("Base2"), base, "Base")


def test_who_leaves_dialect_b_frees_his_name_and_numbers(radio):
    radio.robot("Base", 0.0)
    radio.robot("Base2", 1.0)
    base, other = radio.control_b("Base"), radio.control_b("Base2")
    near, far = radio.pipe_b(other, base, "Base")
    with pytest.raises(client().RadioError, match=r"Robot\.Alread\.Exists"):
        radio.control_b("Base2")
    number = near.peer_port()
    other.close()
    assert near.receive(60.0) == far.receive(60.0) == b""
    with pytest.raises(ConnectionRefusedError):
        socket.create_connection(("127.0.0.1", number), 60.0)
    radio.pipe_b(radio.control_b("Base2"), base, "Base")


# Many messages


def letters(seed, count):
    """Messages of random sizes, most small, each with its number, its length and its hash."""
    random = np.random.default_rng(seed)
    for number in range(count):
        body = random.bytes(int(10 ** random.uniform(0, 4)))
        head = struct.pack(">II", number, len(body))
        yield head + body + hashlib.sha256(head + body).digest()


def check_letters(link, count):
    """Read messages and compare number, length and hash; the link must not break off."""
    data = bytearray()

    def take(size):
        while len(data) < size:
            piece = link.receive(60.0)
            assert piece, "the link broke off"
            data.extend(piece)
        taken = bytes(data[:size])
        del data[:size]
        return taken

    for expected in range(count):
        head = take(8)
        number, length = struct.unpack(">II", head)
        assert number == expected
        assert hashlib.sha256(head + take(length)).digest() == take(32)
    assert not data


def post(link, seed, count):
    for letter in letters(seed, count):
        link.send(letter)


def test_ten_thousand_messages_arrive_whole_and_in_order(radio, record_property):
    """Four robots, all pairs, both ways at once, half in each dialect; 2.2 kB on average."""
    names = [f"Base{i}" for i in range(4)]
    for name, place in zip(names, spread(4), strict=True):
        radio.robot(name, *place)
    control = radio.control_a(*names)
    controls = {name: radio.control_b(name) for name in names}
    links = []
    for i, one in enumerate(names):
        for other in names[i + 1 :]:
            links.append(radio.link_a(control, one, other))
            links.append(radio.pipe_b(controls[one], controls[other], other))
    count, faults = 10_000 // (2 * len(links)) + 1, []

    def work(job, *args):
        try:
            job(*args)
        except BaseException as fault:  # an assertion in a thread is nobody's otherwise
            faults.append(fault)

    ends = [(a, b) for one, other in links for a, b in ((one, other), (other, one))]
    jobs = [(post, here, seed, count) for seed, (here, _) in enumerate(ends)]
    jobs += [(check_letters, there, count) for _, there in ends]
    threads = [threading.Thread(target=work, args=job) for job in jobs]
    began = time.monotonic()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    record_property("messages_per_s", 2 * len(links) * count / (time.monotonic() - began))
    assert not faults, faults[0]
    assert 2 * len(links) * count >= 10_000
