"""Obstacles of known size, and robots that drive over them with or without the help of their joints."""

from usarmjx.models.spec import Shape

from tests.rig import Rig, PERIOD

NEAR = 1.0
"""x of the face of the first step [m]."""


def step(height, near=NEAR, depth=20.0):
    """Return a step up to a platform."""
    return Shape(
        kind="box", size=(depth / 2, 2.0, height / 2), at=(near + depth / 2, 0.0, height / 2), surface="ground"
    )


def stairs(count, rise, going, near=NEAR):
    """Return a flight of stairs with a platform on top, as boxes of one step each."""
    flight = [
        Shape(
            kind="box",
            size=(going / 2, 1.0, rise * (i + 1) / 2),
            at=(near + going * (i + 0.5), 0.0, rise * (i + 1) / 2),
            surface="ground",
        )
        for i in range(count - 1)
    ]
    return (*flight, step(rise * count, near + going * (count - 1)))


def drive_script(rig, speed, script, seconds):
    """Drive ahead while joints follow a script; return positions (n, 3) and uprightness (n,).

    Args:
        rig: A robot before an obstacle.
        speed: Of its wheels [rad/s].
        script: (time [s], {joint: angle [rad]}) in the order of time.
        seconds: How long.
    """
    rig.tell(Left=speed, Right=speed)
    script, pos, up = list(script), [], []
    for tick in range(round(seconds / PERIOD)):
        while script and script[0][0] <= tick * PERIOD:
            rig.move(script.pop(0)[1])
        rig.step()
        pos.append(rig.data.qpos[:3].copy())
        up.append(rig.up[0])
    return pos, up


def four(front, rear):
    """Return angles of front and rear flippers by joint."""
    return {"FRFlipper": front, "FLFlipper": front, "RRFlipper": rear, "RLFlipper": rear}
