"""Options that say who may connect: which servers they lead to, what is refused, when a warning is due."""

import ipaddress
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from tests.server.fake_radio import FakeRadio
from tests.server.still_world import StillWorld
from usarmjx.cli.app import app
from usarmjx.server.network.access import EVERYBODY, AccessRules
from usarmjx.server.viewing.controls import ServedControls

PORTS = ("--port", "0", "--viewer-port", "0")
MORE_PORTS = ("--wss-port", "0", "--wss2-port", "0", "--position-port", "0", "--image-port", "0")


@pytest.fixture
def serve(monkeypatch):
    """Run a command up to where clients would be served: the rules of all its servers, and the result."""

    def build(arena, **how):
        return [StillWorld() for _ in how["instances"]]

    def run(*words, env=None):
        found = []

        def rules_of(servers, *_):
            for server in servers:
                found.append(server.settings.access)
                listening = [one for one in server.services if not isinstance(one, ServedControls)]
                found.extend(service._settings.access for service in listening)

        monkeypatch.setattr("usarmjx.server.runtime.loop.serve", rules_of)
        return found, CliRunner().invoke(app, [*words], env=env)

    monkeypatch.setattr("usarmjx.server.worlds.make.make_worlds", build)
    monkeypatch.setattr("usarmjx.server.wireless.net.RadioChannel", lambda *_: FakeRadio(()))
    monkeypatch.setattr("usarmjx.cli.play._policy_worlds", lambda *_: ([StillWorld()], []))
    return run


COMMANDS = {
    "serve": (("serve", *PORTS, *MORE_PORTS), 4),
    "play": (("play", "wander", "--serve", *PORTS, *MORE_PORTS), 4),
}
"""Each command that serves, and how many servers a world of it has."""


@pytest.mark.parametrize("command", COMMANDS)
def test_all_servers_of_a_world_have_the_rules(serve, command, tmp_path):
    words, count = COMMANDS[command]
    found, result = serve(*words)
    assert result.exit_code == 0, result.output
    assert found == [EVERYBODY] * count
    told = ("--allow", "10.0.0.1/8,::1", "--allow", "192.0.2.7", "--connections-per-address", "3")
    networks = tuple(map(ipaddress.ip_network, ("10.0.0.0/8", "::1", "192.0.2.7")))
    found, _ = serve(*words, *told, "--token", "s3cret")
    assert found == [AccessRules(networks, "s3cret", 3)] * count
    (tmp_path / "token").write_text("from-file\n")
    for told, variable, token in (
        (("--token-file", str(tmp_path / "token")), {}, "from-file"),
        ((), {"USARMJX_TOKEN": "from-env"}, "from-env"),
        (("--token", "said"), {"USARMJX_TOKEN": "from-env"}, "said"),
    ):
        found, result = serve(*words, *told, env=variable)
        assert [rules.token for rules in found] == [token] * count, result.output


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("told", "says"),
    [
        (
            ("--allow", "10.0.0.0/99"),
            "--allow: '10.0.0.0/99' is no network; expected addresses or networks as ",
        ),
        (
            ("--token", "two words"),
            "--token or USARMJX_TOKEN: a token has 1 to 128 letters, digits and ._~+/=-",
        ),
        (("--token", ""), "--token or USARMJX_TOKEN: a token has"),
        (("--token-file", "/nowhere"), "--token-file: cannot read /nowhere: "),
        (("--token", "a", "--token-file", "b"), "give either --token (or USARMJX_TOKEN) or --token-file"),
    ],
)
def test_wrong_rules_are_one_clear_line(serve, command, told, says):
    found, result = serve(*COMMANDS[command][0], *told)
    assert (found, result.exit_code, result.stdout) == ([], 2, "")
    assert result.stderr.startswith(f"usarmjx: {says}")
    assert result.stderr.count("\n") == 1


@pytest.mark.parametrize("command", COMMANDS)
def test_a_host_that_others_reach_is_warned_of(serve, command):
    """Not where a list or a token keeps them out; but a token can be read on its way."""
    words = COMMANDS[command][0]
    for told, warns in (
        (("--host", "0.0.0.0"), True),
        (("--host", "::"), True),
        (("--host", "127.0.0.2"), False),
        (("--host", "localhost"), False),
        ((), False),
        (("--host", "0.0.0.0", "--allow", "10.0.0.0/8"), False),
    ):
        _, result = serve(*words, *told)
        assert result.exit_code == 0, result.output
        warnings = [line for line in result.stderr.splitlines() if line.startswith("usarmjx: warning:")]
        assert len(warnings) == warns, told
        assert all("may drive" in line and "--allow" in line and "--token" in line for line in warnings)
    _, result = serve(*words, "--host", "0.0.0.0", "--token", "s3cret")
    assert "usarmjx: warning: 0.0.0.0" in result.stderr
    assert "may drive" not in result.stderr
    assert "s3cret" not in result.output


def test_the_figures_have_the_rules_too():
    from usarmjx.server.runtime.metrics import MetricsServer

    rules = AccessRules(token="s3cret")
    server = SimpleNamespace(settings=SimpleNamespace(access=rules), services=[], title="")
    assert MetricsServer([server], 1.0, None)._gate.rules is rules
