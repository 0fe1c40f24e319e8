"""ComStation, the base station of the wireless simulation (manual 3.2.4.1): it stands where it was put."""

from usarmjx.models.drives import NoDrive
from usarmjx.models.robots.kit import BLACK
from usarmjx.models.spec.robot import Mount, RobotSpec
from usarmjx.models.spec.shapes import Rgba, Shape

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
    drive=NoDrive(),
    sensors=(Mount(kind="GroundTruth", name="GroundTruth"),),
    sources=(("all", "chosen; the manual names the class"),),
)
