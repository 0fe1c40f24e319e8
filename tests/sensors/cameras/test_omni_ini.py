"""The omnidirectional camera's packages from ini files (manual 10.15.2)."""

import mujoco
import numpy as np
import pytest

from usarmjx.base.registry import Registry
from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.ini.robots import load_robots
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import RobotSpec
from usarmjx.sensors.cameras.mounts import cameras_of
from usarmjx.sim.configure import settings_by_kind

# The manual's lines, joined; it has Z=0.09 where captures have z down, as our P2DX with this camera does.
MOUNT = """[USARBot.P2AT]
MisPkgs=(PkgName="{name}",Location=(Y=0.0,X=0.0,Z=0.0),PkgClass=Class'USARMisPkg.{name}')
Cameras=(ItemClass=class'USARBot.RobotCamera',ItemName="Camera",Parent="{name}_Link{link}",Position=(Y=0.0,X=0.0,Z=-0.09),Direction=(Y=1.5707964,Z=-3.1415927,X=0.0))
CamTexActors=(ItemClass=class'USARBot.USAREmitter',ItemName="OmniCamEmitter",Parent="{name}_Link{link}",Position=(Y=0.0,X=0.0,Z=0.0),Direction=(Y=0.0,Z=0.0,X=0.0))
"""
# A centre link more: between the last one, 3, and the top, 4; and one less.
TALLER = """[USARMisPkg.OmniCamPillar]
Links=(Number=1)
Links=(Number=2)
Links=(Number=3)
Links=(Number=5,Parent=3,Location=(X=0,Y=0,Z=-0.1),MinRange=0,MaxRange=0,Size=(X=0.04,Y=0.04,Z=0.1))
Links=(Number=4,Parent=5)
"""
LOWER = """[USARMisPkg.OmniCamPillar]
Links=(Number=1)
Links=(Number=2)
Links=(Number=4,Parent=2)
"""


@pytest.fixture
def load(tmp_path):
    def from_text(text: str) -> RobotSpec:
        path = tmp_path / "USARBot.ini"
        path.write_text(text)
        robots: Registry[RobotSpec] = Registry("robot")
        robots.add("P2AT", P2AT)
        return load_robots([path], robots, settings=settings_by_kind()).robots[0]

    return from_text


def posed(robot: RobotSpec) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The robot above an empty floor, its joints turned as far as they go."""
    spec = new_spec(ArenaSpec(name="empty", starts=(), extent=((-2, 2), (-2, 2))), Physics())
    add_robot(spec, robot, "r0/", (0.0, 0.0, 1.0))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[7:] = np.where(model.jnt_limited[1:], model.jnt_range[1:, 1], 0.5)
    mujoco.mj_kinematics(model, data)
    return model, data


def eye_height(robot: RobotSpec) -> float:
    """Height of the camera above the chassis origin [m]; it looks straight up."""
    _, data = posed(robot)
    camera = cameras_of(robot)[0]
    body = data.body(f"r0/{camera.mount.parent}")
    mat = body.xmat.reshape(3, 3)
    np.testing.assert_allclose((mat @ camera.mat)[:, 0], (0, 0, 1), atol=1e-6)
    return float((body.xpos + mat @ camera.pos)[2]) - 1.0


def test_base_and_mirror_are_fixed_to_each_other_and_the_camera_looks_up_between_them(load):
    robot = load(MOUNT.format(name="OmniCamera", link=1))
    (camera,) = cameras_of(robot)
    assert camera.lens == "omni"
    model, data = posed(robot)
    body = model.body("r0/OmniCamera_Link1").id
    base, mirror = (geom for geom in range(model.ngeom) if model.geom_bodyid[geom] == body)
    np.testing.assert_allclose(data.geom_xpos[mirror] - data.geom_xpos[base], (0, 0, 0.185), atol=1e-6)
    assert data.geom_xpos[base, 2] - 1.0 < eye_height(robot) < data.geom_xpos[mirror, 2] - 1.0
    np.testing.assert_allclose(data.xpos[body], (0, 0, 1), atol=1e-9)


def test_centre_links_make_the_pillar_higher_and_lower(load):
    mount = MOUNT.format(name="OmniCamPillar", link=4)
    middle, taller, lower = (eye_height(load(mount + links)) for links in ("", TALLER, LOWER))
    assert middle == pytest.approx(0.3 + 0.09, abs=1e-6), (
        "three links of 0.1 m under the top, then the camera"
    )
    assert taller - middle == pytest.approx(0.1, abs=1e-6)
    assert middle - lower == pytest.approx(0.1, abs=1e-6)
