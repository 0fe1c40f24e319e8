"""The port of the live page: a usual one, another where that is taken, or none."""

import pytest

from usarmjx.base.errors import UsageError
from usarmjx.cli import viewer_options
from usarmjx.cli.viewer_options import viewer_settings, viewer_socket
from usarmjx.server.network.access import EVERYBODY
from usarmjx.server.network.ports import LAST_PORT, bound_socket

HOST = "127.0.0.1"


@pytest.fixture
def taken(monkeypatch):
    """A port that somebody has, which is the page's usual one."""
    with bound_socket(HOST, 0) as bound:
        bound.listen()
        number = bound.getsockname()[1]
        monkeypatch.setattr(viewer_options, "VIEWER_PORT", number)
        yield number


def port_of(port, offset=0, wanted=True):
    with viewer_socket(HOST, port, offset, wanted) as bound:
        return bound.getsockname()[1]


def test_where_the_usual_port_is_taken_a_free_one_serves(taken):
    assert port_of(None) not in (taken, 0)


def test_a_port_that_is_asked_for_and_taken_is_an_error(taken):
    with pytest.raises(UsageError, match=rf"127\.0\.0\.1:{taken}: .*--viewer-port"):
        port_of(taken)


def test_the_usual_port_moves_with_the_others_and_a_free_one_does_not(taken):
    with bound_socket(HOST, 0) as free:
        number = free.getsockname()[1]
    assert port_of(None, offset=number - taken) == number
    assert port_of(0, offset=LAST_PORT) > 0


def test_a_port_beyond_the_last_one_is_named():
    with pytest.raises(
        UsageError, match=f"--viewer-port leads to port {LAST_PORT + 5}; the last one is 65535"
    ):
        port_of(LAST_PORT, offset=5)


def test_who_wants_no_page_has_no_port():
    with viewer_socket(HOST, 8100, 0, False) as bound:
        assert bound is None


def test_names_of_the_server_are_checked_before_anything_is_built():
    assert viewer_settings(HOST, EVERYBODY, ["Sim.Example.org"]).names == ("sim.example.org",)
    with pytest.raises(UsageError, match="--allow-host"):
        viewer_settings(HOST, EVERYBODY, ["http://sim"])
