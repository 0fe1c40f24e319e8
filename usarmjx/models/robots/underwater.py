"""The Submarine (manual 12.9): a generic boat, not based on any real one.

The manual gives its size, areas, angles and propeller. Its mass is that of the water that an ellipsoid of its
size displaces, as it neither rises nor sinks; the CONF example's 50 kg is that of other robots.
"""

import math

from usarmjx.base.transforms import Vec3
from usarmjx.models.drives import Underwater
from usarmjx.models.drives.fluid import WATER_DENSITY, Hull
from usarmjx.models.robots.kit import (
    ALONG,
    BLACK,
    GLASS_BLACK,
    LAMP,
    POSE_SENSORS,
    STEEL,
    WHITE,
    ball,
    block,
    camera,
    drum,
    hull,
    pan_tilt,
    rod,
)
from usarmjx.models.types.robot import Mount, RobotSpec
from usarmjx.models.types.shapes import Rgba, Shape

NAVY: Rgba = (0.2, 0.25, 0.35, 1.0)
SAIL = ((0.65, 0.0), (0.3, 0.15), (0.3, -0.15), (-0.62, 0.0), (-0.2, 0.14), (-0.2, -0.14))
"""Corners of the sail, seen from above [m]."""
BRASS: Rgba = (0.72, 0.55, 0.25, 1.0)
RED: Rgba = (0.5, 0.1, 0.1, 1.0)
GREY: Rgba = (0.5, 0.5, 0.55, 1.0)

LENGTH, WIDTH, HEIGHT = 6.5364, 1.1428, 1.9929  # manual
RADII: Vec3 = (LENGTH / 2, WIDTH / 2, HEIGHT / 2)
MASS = float(round(WATER_DENSITY * 4 / 3 * math.pi * math.prod(RADII)))  # 7795 kg
HEAD_MASS = 0.5  # of kit.pan_tilt
RUDDER_AREA, PLANE_AREA, CHORD = 0.3378, 0.2152, 0.4  # manual; chosen chord
TUBE = WIDTH / 2  # radius of the pressure hull, which leaves the height to sail, keel and mast (chosen)
BOW, TAIL = (
    LENGTH / 2,
    LENGTH / 2 - CHORD,
)  # from the middle to the tips of the pressure hull; plates behind it
STERN = LENGTH / 2 - CHORD / 2  # where the plates' middle is
BALLAST, BALLAST_AT = 1000.0, 0.78  # in the keel (chosen)


def _plate(size: Vec3) -> Shape:
    return Shape(kind="box", size=size, at=(-STERN, 0.0, 0.0), surface="fixture", rgba=GREY)


def _visuals() -> tuple[Shape, ...]:
    """Return a boat with a rounded bow, a tail cone, sail, rudders and planes, propeller and keel."""
    top, half = -HEIGHT / 2, RUDDER_AREA / CHORD / 2
    return (
        ball((1.0, TUBE, TUBE), (BOW - 1.0, 0.0, 0.0), NAVY),
        drum(TUBE, 1.9, (0.4, 0.0, 0.0), NAVY, ALONG),
        ball((1.75, TUBE, TUBE), (-1.45, 0.0, 0.0), NAVY),
        drum(TUBE + 0.003, 0.03, (1.6, 0.0, 0.0), WHITE, ALONG),
        block((1.6, 0.08, 0.02), (0.2, 0.0, -TUBE), BLACK),
        # The sail with its planes and windows, the hatch, the mast and the periscope.
        hull([(x, y, z) for x, y in SAIL for z in (-0.5, -0.86)], NAVY),
        block((0.14, 0.42, 0.015), (0.1, 0.0, -0.7), GREY),
        block((0.09, 0.12, 0.03), (0.42, 0.0, -0.79), GLASS_BLACK),
        rod((-0.4, 0.0, -0.85), (-0.4, 0.0, top + 0.02), 0.02, GREY, blunt=True),
        rod((-0.3, 0.05, -0.85), (-0.3, 0.05, -0.95), 0.015, STEEL),
        # Stern: rudders, planes, propeller.
        *(block((CHORD / 2, 0.02, half / 2), (-STERN, 0.0, z * half / 2), GREY) for z in (-1.0, 1.0)),
        block((CHORD / 2, PLANE_AREA / CHORD / 2, 0.02), (-STERN, 0.0, 0.0), GREY),
        ball((0.14, 0.07, 0.07), (-LENGTH / 2 + 0.05, 0.0, 0.0), BRASS),
        *(
            block((0.012, 0.05, 0.3), (-LENGTH / 2 + 0.02, 0.0, 0.0), BRASS, (turn * math.pi / 3, 0.0, 0.0))
            for turn in range(3)
        ),
        # Keel, and in it the sonar that looks down.
        block((1.2, 0.1, HEIGHT / 2 - BALLAST_AT), (0.0, 0.0, BALLAST_AT), RED),
        drum(0.06, 0.02, (0.0, 0.0, HEIGHT / 2 - 0.015), BLACK),
        *(ball((0.03, 0.02, 0.02), (BOW - 0.25, y, 0.0), LAMP) for y in (-0.36, 0.36)),
    )


SUBMARINE = RobotSpec(
    name="Submarine",
    dimensions=(LENGTH, WIDTH, HEIGHT),
    mass=MASS,
    origin_height=HEIGHT / 2,
    chassis=(
        Shape(
            kind="capsule",
            size=(TUBE, (BOW + TAIL) / 2 - TUBE),
            at=((BOW - TAIL) / 2, 0.0, 0.0),
            rotation=(0.0, math.pi / 2, 0.0),
            surface="fixture",
            rgba=NAVY,
        ),
        # Contact boxes: length and sides, which carry all but the ballast; keel; sail.
        Shape(kind="box", size=(LENGTH / 2, 0.2, 0.2), rgba=NAVY),
        Shape(kind="box", size=(2.6, TUBE, 0.22), mass=MASS - BALLAST - HEAD_MASS, rgba=NAVY),
        Shape(
            kind="box",
            size=(1.2, 0.1, HEIGHT / 2 - BALLAST_AT),
            at=(0.0, 0.0, BALLAST_AT),
            mass=BALLAST,
            rgba=BLACK,
        ),
        Shape(kind="box", size=(0.6, 0.15, 0.2), at=(0.0, 0.0, -0.65), rgba=NAVY),
        Shape(
            kind="box",
            size=(0.02, 0.02, (HEIGHT / 2 - 0.85) / 2),
            at=(-0.4, 0.0, -(HEIGHT / 2 + 0.85) / 2),
            surface="fixture",
        ),
        _plate((CHORD / 2, 0.02, RUDDER_AREA / CHORD / 2)),
        _plate((CHORD / 2, PLANE_AREA / CHORD / 2, 0.02)),
    ),
    looks=_visuals(),
    drive=Underwater(
        hull=Hull(
            radii=RADII,
            density=WATER_DENSITY,
            mass=MASS,
            inertia=(1400.0, 16450.0, 16530.0),
            # Along it, with keel, sail and plates; across the flat side; up and down (chosen).
            drag=(0.15, 1.2, 0.5),
            cog_depth=BALLAST * BALLAST_AT / MASS,
        ),
        propeller_pitch=0.3048,
        max_spin=6.28,
        slip=0.1,  # chosen
        rudder_area=RUDDER_AREA,
        plane_area=PLANE_AREA,
        max_angle=0.4363,
        stern_arm=STERN,
        slope=math.pi,  # thin plates twice as wide as deep: 2 pi A / (A + 2)
    ),
    packages=(pan_tilt((0.0, 0.0, -0.85), tilt=(-math.pi / 4, math.pi / 4)),),
    sensors=(
        Mount(kind="Sonar", name="S1", at=(0.0, 0.0, HEIGHT / 2), direction=(0.0, -math.pi / 2, 0.0)),
        *(sensor for sensor in POSE_SENSORS if sensor.kind != "Odometry"),
    ),
    cameras=(camera(),),
    sources=(
        ("dimensions, areas, angles, propeller, sonar, camera's pan", "manual 12.9"),
        ("mass", "manual 12.9: of the water that its size displaces"),
        ("layout, drag, slip, tilt range", "chosen"),
    ),
)
