"""`usarmjx serve`: which worlds its options mean, at which ports, and what it says before it builds them."""

import contextlib
import os
import re
import select
import socket
import subprocess
import sys
import time

import pytest
from typer.testing import CliRunner

import dev
from tests.server.fake_radio import FakeRadio
from tests.server.peers import PATIENCE
from tests.server.still_world import StillWorld
from usarmjx.cli.app import app
from usarmjx.server.network.ports import VIEWER_PORT

WORD_LIMIT = 10.0  # s: a second on an idle machine; JAX alone takes one more to import
ALONE = ("--no-wireless", "--no-images")


class Order:
    """What `serve` would have built and served."""

    def __init__(self):
        self.built, self.servers, self.rest = {}, [], ()


@pytest.fixture
def order(monkeypatch):
    """Run `serve` up to where clients would be served; return the `Order` and the result."""

    def ask(*options):
        order = Order()

        def build(arena, **how):
            order.built = {"arena": arena, **how}
            return [StillWorld() for _ in how["instances"]]

        def serve(servers, *rest):
            order.servers, order.rest = servers, rest

        monkeypatch.setattr("usarmjx.server.worlds.make.make_worlds", build)
        monkeypatch.setattr("usarmjx.server.runtime.loop.serve", serve)
        monkeypatch.setattr("usarmjx.server.wireless.net.RadioChannel", lambda *_: FakeRadio(()))
        return order, CliRunner().invoke(app, ["serve", *options])

    return ask


def free_ports(count):
    """The first of so many free ports in a row."""
    for first in range(20000, 30000, count):
        with contextlib.ExitStack() as stack, contextlib.suppress(OSError):
            for port in range(first, first + count):
                stack.enter_context(socket.create_server(("127.0.0.1", port)))
            return first
    raise AssertionError("no free ports")


# Which worlds


@pytest.mark.parametrize(
    ("options", "instances"),
    [
        ((), (0,)),
        (("--worlds", "4"), (0,)),
        (("--worlds", "4", "--instance", "3"), (3,)),
        (("--worlds", "4", "--instances", "all"), (0, 1, 2, 3)),
        (("--worlds", "16", "--instances", "0,2-5"), (0, 2, 3, 4, 5)),
    ],
)
def test_worlds_and_which_of_them_are_served(order, options, instances):
    made, result = order("--port", "0", *ALONE, *options)
    assert result.exit_code == 0, result.stderr
    assert made.built["instances"] == instances
    assert made.built["worlds"] == int(dict(zip(options[::2], options[1::2], strict=True)).get("--worlds", 1))
    assert len(made.servers) == len(instances)
    titles = [f"world {number}" for number in instances] if len(instances) > 1 else [""]
    assert [server.title for server in made.servers] == titles


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--instance", "0", "--instances", "all"), "give either --instance or --instances"),
        (("--worlds", "4", "--instances", "2-4"), "instance 4 is not among worlds 0 to 3"),
        (
            ("--worlds", "4", "--instances", "some"),
            "instances 'some' are not of the form all or 0,2-5: 'some'",
        ),
    ],
)
def test_worlds_that_cannot_be_served_are_refused(order, options, says):
    made, result = order("--port", "0", *ALONE, *options)
    assert (result.exit_code, result.stderr, made.built) == (2, f"usarmjx: {says}\n", {})


# Seats


@pytest.mark.parametrize(
    ("options", "robots", "connections"),
    [
        ((), 16, 16),
        (("--seats", "64"), 64, 64),
        (("--seats", "4"), 4, 16),
        (("--max-connections", "20"), 20, 20),
        (("--seats", "64", "--max-connections", "8"), 64, 8),
    ],
)
def test_seats_are_robots_and_each_takes_a_connection(order, options, robots, connections):
    made, _ = order("--port", "0", *ALONE, *options)
    assert made.built["max_robots"] == robots
    assert made.servers[0].settings.max_connections == connections


# Ports


def test_every_world_has_ports_of_its_own_for_everything(order):
    first = free_ports(40)
    options = ("--port", "--wss-port", "--wss2-port", "--position-port", "--image-port", "--rosbridge-port")
    # Pictures and rosbridge are two apart.
    offsets = dict(zip(options, (0, 5, 10, 15, 20, 22), strict=True))
    words = [word for option, offset in offsets.items() for word in (option, str(first + offset))]
    made, result = order("--worlds", "3", "--instances", "all", *words)
    assert result.exit_code == 0, result.stderr
    found = []
    for server in made.servers:
        radio, images, ros = server.services[:3]
        air = radio._settings
        found.append(
            [
                port - first
                for port in (
                    server.settings.port,
                    air.wss_port,
                    air.wss2_port,
                    air.position_port,
                    images._settings.port,
                    ros._settings.port,
                )
            ]
        )
    assert found == [[0, 5, 10, 15, 20, 22], [1, 6, 11, 16, 21, 23], [2, 7, 12, 17, 24, 25]]
    assert len({id(server.world) for server in made.servers}) == 3
    others = [service for server in made.servers for service in server.services[3:]]
    assert [type(service).__name__ for service in others] == [
        "ServedControls",
        "ViewerService",
    ]  # one for all
    assert len({id(radio._radio) for server in made.servers for radio in server.services[:1]}) == 3


def test_one_option_moves_all_ports(order):
    made, result = order("--port-offset", "12000", "--rosbridge-port", "5005")
    assert result.exit_code == 0, result.stderr
    (server,) = made.servers
    radio, images, ros, _, live_page = server.services
    assert live_page.port == VIEWER_PORT + 12000
    assert server.settings.port == 3000 + 12000
    air = radio._settings
    assert (air.wss_port, air.wss2_port, air.position_port) == (5874 + 12000, 50000 + 12000, 7435 + 12000)
    assert (images._settings.port, ros._settings.port) == (5003 + 12000, 5005 + 12000)


@pytest.mark.parametrize(
    "option", ["--port", "--wss-port", "--wss2-port", "--position-port", "--image-port", "--rosbridge-port"]
)
@pytest.mark.parametrize("world", [0, 1])
def test_a_taken_port_is_said_before_anything_is_built(order, option, world):
    first = free_ports(40)
    others = {"--port", "--wss-port", "--wss2-port", "--position-port", "--image-port"} - {option}
    with socket.create_server(("127.0.0.1", first + world)):
        words = ["--worlds", "2", "--instances", "all", option, str(first)]
        made, result = order(*words, *(word for other in others for word in (other, "0")))
    assert result.exit_code == 2
    says = rf"cannot listen on 127\.0\.0\.1:{first + world}: .* \({option} sets it, --port-offset moves all"
    assert re.fullmatch(rf"usarmjx: {says} ports\)\n", result.stderr)
    assert (result.stdout, made.built) == ("", {})


# Processes of their own


def usarmjx(*words):
    environment = {**os.environ, "JAX_PLATFORMS": "cpu"}
    code = "import atexit, sys; atexit.register(lambda: print('jax' in sys.modules)); "
    code += f"sys.argv = {['usarmjx', *words]!r}; from usarmjx.cli.app import app; app()"
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=dev.ROOT,
        env=environment,
    )


def test_a_taken_port_is_found_without_jax():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        process = usarmjx("serve", "--port", str(taken.getsockname()[1]))
        out, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 2
    assert err.count("\n") == 1
    assert out == "False\n"


@pytest.mark.alone
def test_the_first_word_comes_at_once_and_says_what_is_built():
    """Not on standard output, whose first line says where it listens; and to a pipe as to a terminal."""
    began = time.monotonic()
    with usarmjx("serve", "--port", "0", "--arena", "nowhere.yaml", "--worlds", "3", *ALONE) as process:
        assert select.select([process.stderr], [], [], WORD_LIMIT)[0]
        assert process.stderr.readline() == "usarmjx: building arena nowhere.yaml for 3 worlds ...\n"
        assert time.monotonic() - began < WORD_LIMIT
        assert process.stderr.read().startswith("usarmjx: nowhere.yaml: there is no such file")
        assert process.stdout.read() == "True\n"


def test_serving_waits_for_no_library_that_it_does_not_need():
    """SciPy and Pallas alone would take a quarter of the time until it listens."""
    code = (
        "import sys, usarmjx.server.runtime.loop, usarmjx.server.worlds.make, usarmjx.server.wireless.net\n"
    )
    code += "import usarmjx.server.pictures.image_server, usarmjx.server.viewing.viewer_service\n"
    code += "import usarmjx.server.viewing.controls, usarmjx.server.viewing.viewer_service\n"
    code += "print(sorted({name.partition('.')[0] for name in sys.modules}))\n"
    code += "print('jax.experimental.pallas' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=dev.ROOT, check=True
    )
    packages, pallas = done.stdout.splitlines()
    assert "'usarmjx'" in packages
    for name in ("scipy", "matplotlib", "trimesh", "websockets", "viser", "optax", "warp"):
        assert f"'{name}'" not in packages
    assert pallas == "False"
