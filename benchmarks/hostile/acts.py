"""Attacks that need more than one connection: held connections, links by radio, datagrams."""

import contextlib
import os
import select
import socket
from collections.abc import Callable

from benchmarks.hostile.frames import init_line
from benchmarks.hostile.stage import HOST, PATIENCE, STEP, Stage

HELD = 250
ROS_DOMAIN = 77
DDS_PORTS = range(7400 + 250 * ROS_DOMAIN, 7400 + 250 * ROS_DOMAIN + 14)
"""RTPS: discovery and data of the first participants of a domain."""


def hold(kind: str) -> Callable[[Stage, int], None]:
    """Return an act that opens many connections to a port and replaces those that are closed."""

    def act(stage: Stage, number: int) -> None:
        del number
        held: list[socket.socket] = []
        try:
            while stage.runs:
                while len(held) < HELD and stage.runs:
                    held.append(stage.connect(kind))
                closed, _, _ = select.select(held, [], [], PATIENCE)
                for one in closed:
                    with contextlib.suppress(OSError):
                        if one.recv(STEP):
                            continue
                    one.close()
                    held.remove(one)
                stage.rest(0.05)
        finally:
            for one in held:
                one.close()

    return act


def dial(stage: Stage, number: int) -> None:
    """Let the wireless server connect to ports that do not listen, or do not answer."""
    with socket.socket() as silent, stage.connect("wireless-a") as link:
        silent.bind((HOST, 0))
        silent.listen(1)
        port = silent.getsockname()[1]
        names = f"D{number}", f"E{number}"
        stage.push(link, "".join(f"REGISTER {name} {HOST};" for name in names).encode())
        while stage.runs:
            talk = f"LISTEN {names[0]} {port};OPEN {names[1]} 1{number:03} {names[0]} {port};"
            stage.push(link, talk.encode())
            stage.drain(link)


def flood_link(stage: Stage, number: int) -> None:
    """Bring two robots, open a link between them, and send without a pause; their side never reads."""
    names = f"F{number}", f"G{number}"
    with contextlib.ExitStack() as open_ones:
        robots = [open_ones.enter_context(stage.connect("robots")) for _ in names]
        for robot, name in zip(robots, names, strict=True):
            stage.push(robot, init_line(name, 2 * number + names.index(name)))
        ears = [open_ones.enter_context(socket.create_server((HOST, 0))) for _ in names]
        ports = [ear.getsockname()[1] for ear in ears]
        control = open_ones.enter_context(stage.connect("wireless-a"))
        stage.rest(1.0)
        talk = [f"REGISTER {name} {HOST};" for name in names]
        talk += [f"LISTEN {names[0]} {ports[0]};", f"OPEN {names[1]} {ports[1]} {names[0]} {ports[0]};"]
        stage.push(control, "".join(talk).encode())
        calls: list[socket.socket] = []
        for ear in ears:
            ear.settimeout(1.0)
            calls.append(open_ones.enter_context(ear.accept()[0]))
        payload = b"SEND 60000 " + b"x" * 60000 + b";"
        while stage.runs:
            stage.push(calls[0], payload)
            for robot in robots:
                stage.drain(robot)


def page_storm(stage: Stage, number: int) -> None:
    """Open the live page as a browser does, again and again, by requests that follow each other at once."""
    del number
    request = f"GET / HTTP/1.1\r\nHost: {HOST}:{stage.ports['page']}\r\n\r\n".encode()
    with stage.connect("page") as link:
        while stage.runs:
            stage.push(link, request * 20)
            stage.drain(link)


def datagrams(stage: Stage, number: int) -> None:
    """Send random datagrams, half of them with the head of RTPS, to the ports of DDS."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        while stage.runs:
            for port in DDS_PORTS:
                with contextlib.suppress(ConnectionError):
                    link.sendto(
                        (b"RTPS\x02\x03\x01\x10" if number % 2 else b"") + os.urandom(400), (HOST, port)
                    )
            stage.rest(0.001)
