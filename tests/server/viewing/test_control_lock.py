"""Who at the page may have its controls: this machine, who knows the token, or all if that is wanted."""

import pytest

from usarmjx.server.network.access import AccessRules
from usarmjx.server.viewing.controls import control_lock
from usarmjx.view.controls import ControlLock

ME, YOU = 1, 2


@pytest.mark.parametrize(
    ("address", "token", "wanted", "allowed"),
    [
        ("127.0.0.1", "", False, True),
        ("::1", "", False, True),
        ("0.0.0.0", "", False, False),
        ("192.168.1.4", "", False, False),
        ("fe80::1%eth0", "", False, False),
        ("0.0.0.0", "secret", False, True),
        ("0.0.0.0", "", True, True),
    ],
)
def test_strangers_only_watch_unless_the_operator_wants_more(address, token, wanted, allowed):
    lock = control_lock(address, AccessRules(token=token), wanted)
    assert lock.take(ME) == allowed
    assert lock.holder == (ME if allowed else None)


def test_the_first_who_asks_has_them_until_they_are_given_back():
    lock = ControlLock()
    assert lock.take(ME)
    assert not lock.take(YOU)
    assert not lock.leave(YOU), "nobody can give back what another has"
    assert lock.leave(ME)
    assert lock.take(YOU)
    assert lock.holder == YOU
