"""A sensor of one's own: a light meter under an overcast sky, made of ray casts.

    python examples/own_sensor.py
    python examples/own_sensor.py serve --arena yellow

The first command reads it in a batch: four robots, in the open, beside a wall, at the edge of a roof and
under it. With words behind it, the script is the command `usarmjx`, which then knows the sensor and the
robot below. A client spawns it with `INIT {ClassName USARBot.LightP2AT}` and hears

    SEN {Time 4.2000} {Type LightMeter} {Name Light} {Lux 8750.0000} {Direction 0.1244,-0.0310,-0.9917}

docs/own-sensor.md goes through this file.
"""

import math
import sys
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from usarmjx import ROBOTS, Batch, build_scene
from usarmjx.cli import main as run_command
from usarmjx.models import GLASS, POSITIVE, SKY, ArenaSpec, Mount, Shape, StartPose
from usarmjx.sensors import (
    SENSORS,
    NoisySensorSettings,
    OutputCurve,
    Quantity,
    Sensor,
    apply_output_curve,
    noisy,
    xp,
)

RAYS = 128


@dataclass(frozen=True)
class LightSettings(NoisySensorSettings):
    """The keys of `[USARBot.LightMeter]`: Daylight, OutputCurve; Noise and others that all sensors have."""

    with_time_stamp: bool = True
    scan_interval: float = 0.2  # s
    noise: float = 0.02
    daylight: Annotated[float, POSITIVE] = 10_000.0  # lx on the ground in the open
    output_curve: OutputCurve = ()


def dome() -> np.ndarray:
    """Return the directions of the rays about the x axis (rays, 3), each as bright as the others.

    Points spread evenly over a disc and lifted up to the hemisphere above it: that many go in each direction
    as a plate takes light from there.
    """
    k = np.arange(RAYS) + 0.5
    radius, around = np.sqrt(k / RAYS), math.pi * (3 - math.sqrt(5)) * k
    sides = (radius * np.cos(around), radius * np.sin(around))
    return np.stack([np.sqrt(1 - radius**2), *sides], -1).astype(np.float32)


@dataclass(frozen=True, eq=False)
class LightMeter(Sensor):
    """A plate that looks along its x axis; value: light [lx], and where it comes from on the robot (4,)."""

    kind = "LightMeter"
    settings_class = LightSettings
    transparent = frozenset({SKY, GLASS})
    quantities = (Quantity("Lux"), Quantity("Direction", "vector"))

    def rays(self, bodies):
        pos, mat = self.mount_poses(bodies)
        along = (mat[0] * dome()[:, None, :]).sum(-1)  # from the mount's axes to the world's
        return xp.broadcast_to(pos[0], along.shape), along

    def read(self, inputs, memory, key):
        bright = xp.isinf(inputs.hits.distance)  # the sky is where a ray meets nothing
        light = self.settings[0].daylight * bright.mean()
        told = apply_output_curve(noisy(key, light[None], self.settings), self.settings[0].output_curve)
        _, along = self.rays(inputs.bodies)
        way = (inputs.bodies.mat[0] * (along * bright[:, None]).sum(0)[:, None]).sum(0)  # on the chassis
        way = way / xp.maximum(xp.linalg.norm(way), 1e-6)  # no light comes from nowhere
        return memory, xp.concatenate([told, way])


SENSORS.add(LightMeter.kind, LightMeter)

# On the deck's left rear, looking up; the wire's axes: x forward, y right, z down [m, rad].
LIGHT = Mount(kind="LightMeter", name="Light", at=(-0.2, -0.15, -0.05), direction=(0.0, math.pi / 2, 0.0))
P2AT = ROBOTS.get("P2AT")
ROBOTS.add("LightP2AT", replace(P2AT, name="LightP2AT", sensors=(*P2AT.sensors, LIGHT)))

YARD = ArenaSpec(
    name="yard",
    starts=tuple(StartPose(tag=f"S{x}", at=(x, 0.0, 0.188)) for x in (-12.0, 0.0, 8.0, 12.0)),
    shapes=(
        Shape(kind="box", size=(1.5, 0.1, 1.0), at=(0.0, 0.6, 1.0), surface="wall"),
        Shape(kind="box", size=(4.0, 4.0, 0.1), at=(12.0, 0.0, 1.5), surface="wall"),
    ),
    extent=((-14.0, 16.0), (-4.0, 4.0)),
)
PLACES = ("in the open", "a wall on the left", "at the edge of a roof", "under it")


def main():
    batch = Batch(build_scene(YARD, ["LightP2AT"] * len(PLACES)), worlds=2, engine="c", seed=1)
    _, readings = batch.observe(batch.reset())
    light = readings[0][batch.scene.groups[0].suite.index("LightMeter")]
    for place, lux, x, y, z in zip(PLACES, *np.asarray(light.value[0]).T, strict=True):
        print(f"{place:22} {lux:6.0f} lx from {x:5.2f} {y:5.2f} {z:5.2f}")


if __name__ == "__main__":
    run_command() if sys.argv[1:] else main()
