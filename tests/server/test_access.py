"""Lists of networks, tokens, and what a gate counts: without sockets."""

import asyncio
import hmac
import ipaddress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from usarmjx.base.errors import PeerError, UsageError
from usarmjx.server.network.access import (
    MAX_TOKEN_SIZE,
    AccessRules,
    check_token,
    parse_address,
    parse_networks,
    read_token,
    token_of,
)
from usarmjx.server.network.gate import LOG_INTERVAL, Gate


def allowed(texts, *addresses):
    rules = AccessRules(parse_networks(texts))
    return [rules.allows(parse_address(address)) for address in addresses]


def test_networks_and_addresses_of_both_kinds():
    texts = ["10.1.2.3/8, 192.0.2.7", "2001:db8::5/32"]
    inside = ("10.255.0.1", "192.0.2.7", "2001:db8:ffff::1", "::ffff:10.0.0.1")
    assert allowed(texts, *inside) == [True] * 4
    assert allowed(texts, "11.0.0.1", "192.0.2.8", "2001:db9::1", "127.0.0.1", "::1") == [False] * 5
    assert allowed(["fe80::/10"], "fe80::1%eth0") == [True], "with the name of an interface"
    assert allowed([], "203.0.113.1", "::1") == [True, True], "nobody is named: anybody"


@given(st.ip_addresses(), st.integers(0, 128))
def test_an_address_is_in_its_own_networks(address, bits):
    bits = min(bits, address.max_prefixlen)
    if getattr(address, "ipv4_mapped", None) is None:
        assert allowed([f"{address}/{bits}"], str(address)) == [True]
    network = ipaddress.ip_network(f"{address}/{address.max_prefixlen}")
    assert parse_networks([str(address)]) == (network,)


@pytest.mark.parametrize("text", ["10.0.0.0/33", "example.org", "", "10.0.0.1,,10.0.0.2", "10.0.0.0-9"])
def test_what_is_no_network_is_one_clear_line(text):
    with pytest.raises(UsageError) as error:
        parse_networks([text])
    wrong = text.split(",")[1] if "," in text else text
    assert str(error.value) == (
        f"--allow: {wrong!r} is no network; expected addresses or networks as 10.0.0.0/8,2001:db8::1"
    )


def test_a_token_is_one_that_lines_and_cookies_can_carry(tmp_path):
    assert check_token("aZ09._~+/=-", "--token") == "aZ09._~+/=-"
    for wrong in ("", "two words", "semi;colon", "bra{ce", "x" * (MAX_TOKEN_SIZE + 1), "käse"):
        with pytest.raises(UsageError, match="--token: a token has 1 to 128 letters, digits and ") as error:
            check_token(wrong, "--token")
        assert not wrong or wrong not in str(error.value)
    path = tmp_path / "token"
    path.write_text("\n s3cret \n")
    assert read_token(path) == "s3cret"
    path.write_text("a\nb\n")
    with pytest.raises(UsageError, match=f"--token-file {path}: a token has"):
        read_token(path)
    with pytest.raises(UsageError, match=f"--token-file: cannot read {tmp_path}: "):
        read_token(tmp_path)


def test_the_token_is_shown_by_no_rules():
    assert "s3cret" not in repr(AccessRules(token="s3cret"))


@pytest.mark.parametrize(
    "line",
    ["AUTH {Token s3cret}", "auth{token  s3cret }", "Auth s3cret", " AUTH  s3cret ", "AUTH {Token s3cret"],
)
def test_the_token_of_a_line(line):
    assert token_of(line) == "s3cret"


def test_other_lines_have_none():
    for line in ("AUTH", "AUTH {}", "AUTH {Key s3cret}", "AUTH a b", "AUTH {Token s3cret}}", "AUTH}"):
        assert token_of(line) == ""
    for line in ("", "INIT {Token s3cret}", "POST / HTTP/1.1", "AUTHENTICATE s3cret"):
        with pytest.raises(PeerError, match="not with AUTH"):
            token_of(line)


def test_the_wrong_token_takes_as_long_as_the_right_one(monkeypatch):
    """Neither tokens nor cookies are compared letter by letter up to the first that differs."""
    compared, compare = [], hmac.compare_digest
    monkeypatch.setattr(hmac, "compare_digest", lambda a, b: compared.append((a, b)) or compare(a, b))
    rules = AccessRules(token="s3cret")
    assert [rules.knows(token) for token in ("s3cret", "s3creT", "", "käse\ud800")] == [True] + 3 * [False]
    assert [rules.knows_cookie(cookie) for cookie in (rules.cookie, "s3cret")] == [True, False]
    assert len(compared) == 6
    assert not AccessRules().knows("")


def test_refusals_in_between_are_counted(caplog):
    now = [100.0]
    gate = Gate(AccessRules(), 1, "robots", lambda: now[0])
    for address in ("10.0.0.1", "10.0.0.2", "10.0.0.3"):
        gate.refuse(address, "it is late")
    now[0] += LOG_INTERVAL
    gate.refuse("10.0.0.4", "it is early")
    assert [record.getMessage() for record in caplog.records] == [
        "robots: 10.0.0.1 is refused: it is late",
        "robots: 10.0.0.4 is refused: it is early (2 more since the last such line)",
    ]


ADDRESSES = ("10.0.0.1", "::ffff:10.0.0.1", "10.0.0.2", "::1")


@given(st.lists(st.tuples(st.sampled_from(ADDRESSES), st.booleans())))
def test_a_gate_counts_what_is_open(moves):
    gate, here = Gate(AccessRules(per_address=2), 16, "robots"), []
    for address, comes in moves:
        alike = sum(parse_address(one) == parse_address(address) for one in here)
        if not comes:
            if here:
                gate.leave(here.pop())
        elif gate.enter(address):
            assert alike < 2 or address == "::1"
            here.append(address)
        else:
            assert alike == 2
    while here:
        gate.leave(here.pop())
    assert not gate._counts


def test_who_has_gone_already_does_not_come_in():
    assert not Gate(AccessRules(), 16, "robots").enter("")


@pytest.mark.parametrize(("room", "most"), [(1, 1), (2, 2), (4, 3), (8, 6), (16, 12), (64, 48)])
def test_an_address_has_three_quarters_of_the_room(room, most):
    gate = Gate(AccessRules(), room, "robots")
    assert [gate.enter("10.0.0.1") for _ in range(room + 1)] == [True] * most + [False] * (room + 1 - most)


def test_without_a_token_nothing_is_read():
    async def ask():
        return await Gate(AccessRules(), 1, "robots").is_known(None, None, b"\n")

    assert asyncio.run(ask())
