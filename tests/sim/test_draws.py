"""What a world draws: anew in each control step, episode and delivery, and the same again in the same one."""

import numpy as np

from tests.arenas import COURSE
from tests.lone import LoneWorld
from usarmjx.base import random
from usarmjx.base.backend import numpy_backend
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import MessageSettings
from usarmjx.models.arenas import ARENAS
from usarmjx.sim.radio import outgoing_messages, send
from usarmjx.sim.reset import init_world, reset
from usarmjx.sim.scene import build_scene

SENDINGS = 40


def test_noise_is_that_of_the_step_and_the_episode():
    world = LoneWorld(build_scene(COURSE, ["P2AT"]))
    sonar = world.scene.groups[0].suite.index("Sonar")

    def read(step, episode=0):
        world.world = world.world.replace(step=np.int32(step), episode=np.int32(episode))
        (readings,) = world.observe()
        return readings[sonar].value[0]

    first = read(1)
    assert (first < 5.0).any(), "it sees something: noise is on that"
    np.testing.assert_array_equal(read(1), first)
    for other in (read(2), read(1, episode=1)):
        assert (other != first).any()


def test_each_delivery_is_lost_or_not_by_itself():
    """Half of them on the way: of 40 fewer than 8 or more than 32 arrive once in ten thousand such tests."""
    mail = MessageSettings(numbers=1, capacity=2 * SENDINGS)
    world = LoneWorld(build_scene(COURSE, ["P2AT", "P2AT"], radio=RadioSettings(), mail=mail))
    links = world.links()
    half = links.replace(
        in_range=links.paired, delivery_probability=np.where(links.paired, 0.5, 0.0).astype(np.float32)
    )
    now = world.world.replace(links=half)
    with numpy_backend():
        told = outgoing_messages(world.scene, (), links.paired, np.zeros(1))
        for _ in range(SENDINGS):
            now = now.replace(mail=send(world.scene, now, told))
    assert now.mail.sent.tolist() == [SENDINGS] * 2
    arrived = now.mail.count
    assert ((arrived >= 8) & (arrived <= 32)).all()
    assert (arrived + now.mail.dropped.lost[::-1] == SENDINGS).all()


def test_start_poses_are_shuffled_anew_in_each_episode():
    scene = build_scene(ARENAS.get("yellow"), ["P2AT", "P2AT"])
    at = scene.groups[0].root_qposadr[:, :2]
    starts = {tuple(np.float32(start.at[:2]).tolist()) for start in scene.arena.starts}

    def orders():
        with numpy_backend():
            world, qpos = init_world(scene, random.key(3), np.int32(0), shuffle=True)
            yield tuple(map(tuple, qpos[at].tolist()))
            for _ in range(5):
                world, qpos = reset(scene, world, shuffle=True)
                yield tuple(map(tuple, qpos[at].tolist()))

    found = list(orders())
    assert list(orders()) == found
    assert len(set(found)) > 1
    assert all(one != other and {one, other} <= starts for one, other in found)
