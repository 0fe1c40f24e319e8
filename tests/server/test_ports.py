"""Which ports the servers of several worlds get, and that they are theirs before anything else happens."""

import socket

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usarmjx.base.errors import UsageError
from usarmjx.server.network.ports import LAST_PORT, bound_ports, bound_socket, count_up

HOST = "127.0.0.1"
OPTIONS = ("--port", "--wss-port", "--image-port", "--rosbridge-port")


def column(ports, option):
    return [own[option] for own in ports]


def test_each_kind_counts_up_from_its_own_port():
    ports = count_up({"--port": 3000, "--wss2-port": 50000}, 4)
    assert column(ports, "--port") == [3000, 3001, 3002, 3003]
    assert column(ports, "--wss2-port") == [50000, 50001, 50002, 50003]


def test_ports_of_another_kind_are_left_out():
    """Of kinds whose first ports are two apart."""
    ports = count_up({"--port": 3000, "--image-port": 5003, "--rosbridge-port": 5005}, 4)
    assert column(ports, "--port") == [3000, 3001, 3002, 3003]
    assert column(ports, "--image-port") == [5003, 5004, 5007, 5009]
    assert column(ports, "--rosbridge-port") == [5005, 5006, 5008, 5010]


def test_the_offset_moves_all_but_free_ports():
    ports = count_up({"--port": 3000, "--image-port": 0, "--wss-port": 5874}, 2, offset=100)
    assert ports == [
        {"--port": 3100, "--image-port": 0, "--wss-port": 5974},
        {"--port": 3101, "--image-port": 0, "--wss-port": 5975},
    ]


@given(
    st.lists(st.integers(1, 60), min_size=1, max_size=4, unique=True), st.integers(1, 20), st.integers(0, 9)
)
def test_no_port_is_given_twice_and_none_goes_down(first, worlds, offset):
    ports = count_up(dict(zip(OPTIONS, first, strict=False)), worlds, offset)
    given_out = [port for own in ports for port in own.values()]
    assert len(ports) == worlds
    assert len(set(given_out)) == len(given_out)
    assert list(ports[0].values()) == [port + offset for port in first]
    for option in ports[0]:
        assert column(ports, option) == sorted(column(ports, option))


@pytest.mark.parametrize(
    ("first", "worlds", "offset", "says"),
    [
        ({"--port": 3000, "--image-port": 3000}, 1, 0, "--port and --image-port both lead to port 3000"),
        ({"--wss2-port": 50000}, 1, 20000, "--wss2-port leads to port 70000; the last one is 65535"),
        ({"--port": LAST_PORT}, 2, 0, "--port leads to port 65536; the last one is 65535"),
    ],
)
def test_ports_that_cannot_be_are_refused_by_their_option(first, worlds, offset, says):
    with pytest.raises(UsageError, match=says):
        count_up(first, worlds, offset)


def test_bound_ports_refuse_others_and_guests_until_somebody_listens():
    with bound_ports(HOST, [{"--port": 0}, {"--port": 0}]) as bound:
        numbers = [own["--port"].getsockname()[1] for own in bound]
        assert len(set(numbers)) == 2
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection((HOST, numbers[0]))
        with socket.socket() as other, pytest.raises(OSError, match="in use"):
            other.bind((HOST, numbers[0]))
    with socket.create_server((HOST, numbers[0])):
        pass  # it is free again


def test_a_taken_port_is_refused_by_its_option_and_all_others_are_free_again():
    with bound_socket(HOST, 0) as first, socket.create_server((HOST, 0)) as taken:
        free, number = first.getsockname()[1], taken.getsockname()[1]
        first.close()
        says = rf"listen on {HOST}:{number}: .*in use \(--wss-port sets it, --port-offset moves all ports\)"
        with (
            pytest.raises(UsageError, match=says),
            bound_ports(HOST, [{"--port": free, "--wss-port": number}]),
        ):
            pass
        with socket.create_server((HOST, free)):
            pass


def test_an_address_that_is_not_ours_is_refused_by_its_option():
    with (
        pytest.raises(UsageError, match=r"cannot listen on 192\.0\.2\.1:0: .* \(--host sets the address\)"),
        bound_ports("192.0.2.1", [{"--port": 0}]),  # an address for documents
    ):
        pass


def test_localhost_is_where_usarsims_clients_look():
    with bound_socket("localhost", 0) as bound:
        assert bound.getsockname()[0] == HOST
