"""ComStation, the immobile base station of the wireless simulation (manual 3.2.4.1)."""

from usarmjx.models.drives import NoDrive
from usarmjx.models.robots.kit import ALONG, BLACK, DARK, JET_BLACK, STEEL, WHITE, ball, block, drum, rod
from usarmjx.models.types.robot import Mount, RobotSpec
from usarmjx.models.types.shapes import Rgba, Shape

LAMPS: tuple[Rgba, ...] = ((0.9, 0.15, 0.1, 1.0), (0.98, 0.7, 0.1, 1.0), (0.2, 0.75, 0.25, 1.0))
GREY: Rgba = (0.6, 0.6, 0.65, 1.0)

COMSTATION = RobotSpec(
    name="ComStation",
    dimensions=(0.5, 0.5, 1.6),
    mass=40.0,
    origin_height=0.8,
    chassis=(
        Shape(kind="box", size=(0.25, 0.25, 0.3), at=(0.0, 0.0, 0.5), mass=40.0, rgba=GREY),
        Shape(
            kind="capsule", size=(0.02, 0.48), at=(0.0, 0.0, -0.3), surface="fixture", rgba=BLACK
        ),  # antenna
    ),
    looks=(
        block((0.25, 0.25, 0.27), (0.0, 0.0, 0.5), GREY),
        *(drum(0.03, 0.015, (x, y, 0.785), JET_BLACK) for x in (-0.2, 0.2) for y in (-0.2, 0.2)),
        block((0.255, 0.255, 0.012), (0.0, 0.0, 0.22), DARK),
        block((0.003, 0.2, 0.08), (0.25, 0.0, 0.35), JET_BLACK),
        block((0.002, 0.1, 0.06), (0.2525, -0.06, 0.35), (0.2, 0.7, 0.45, 1.0)),
        *(drum(0.012, 0.004, (0.252, 0.09 + 0.04 * k, 0.33), lamp, ALONG) for k, lamp in enumerate(LAMPS)),
        *(block((0.002, 0.18, 0.006), (0.25, 0.0, 0.52 + 0.035 * k), DARK) for k in range(5)),
        drum(0.06, 0.03, (0.0, 0.0, 0.19), DARK),
        rod((0.0, 0.0, 0.2), (0.0, 0.0, -0.75), 0.016, JET_BLACK, blunt=True),
        ball((0.03, 0.03, 0.03), (0.0, 0.0, -0.77), (0.8, 0.15, 0.1, 1.0)),
        *(rod((0.0, -0.16, z), (0.0, 0.16, z), 0.006, STEEL) for z in (-0.35, -0.5, -0.65)),
        drum(0.12, 0.012, (0.05, 0.0, -0.08), WHITE, (0.0, 1.3, 0.0)),
        rod((0.05, 0.0, -0.08), (0.14, 0.0, -0.1), 0.006, DARK),
    ),
    drive=NoDrive(),
    sensors=(Mount(kind="GroundTruth", name="GroundTruth"),),
    sources=(("all", "chosen; the manual names the class"),),
)
