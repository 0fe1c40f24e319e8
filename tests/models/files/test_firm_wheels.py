"""Light casters of a heavy robot do not sink, though MuJoCo makes contacts of light bodies soft."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from usarmjx.models.compile.compose import add_robot, new_spec
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.files.robot_drive import MAX_SINKING
from usarmjx.models.files.robot_file import load_robot
from usarmjx.models.types.arena import ArenaSpec
from usarmjx.models.types.robot import HOLD_SUFFIX

pytestmark = pytest.mark.oracle

WHEEL = """<link name="{name}"><inertial><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><geometry><sphere radius="{radius}"/></geometry></collision></link>
<joint name="{name}_joint" type="continuous"><parent link="{parent}"/><child link="{name}"/>
<origin xyz="{x} {y} {z}"/><axis xyz="0 1 0"/><limit effort="60" velocity="9"/></joint>
"""
FORK = """<link name="{name}"><inertial><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="{name}_joint" type="continuous"><parent link="base"/><child link="{name}"/>
<origin xyz="{x} {y} 0.05"/><axis xyz="0 0 1"/></joint>
"""
BASE = """<robot name="cart"><link name="base"><inertial><origin xyz="0 0 .2"/><mass value="90"/>
<inertia ixx="5" iyy="5" izz="5" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 .2"/><geometry><box size=".6 .4 .2"/></geometry></collision></link>
{wheels}{plugin}</robot>"""
PLUGIN = """<gazebo><plugin name="drive" filename="libgazebo_ros_diff_drive.so">
<left_joint>left_joint</left_joint><right_joint>right_joint</right_joint>
</plugin></gazebo>"""


def cart(tmp_path, mass):
    """A cart of 90 kg on four casters of a mass [kg], with two driven wheels 15 mm above the ground."""
    made = [
        WHEEL.format(name=name, parent="base", mass=2, i=0.02, radius=0.1, x=0, y=y, z=0.115)
        for name, y in (("left", 0.25), ("right", -0.25))
    ]
    for k, (x, y) in enumerate([(0.2, 0.1), (0.2, -0.1), (-0.2, 0.1), (-0.2, -0.1)]):
        made.append(FORK.format(name=f"fork{k}", mass=mass, i=mass * 1e-3, x=x, y=y))
        made.append(
            WHEEL.format(
                name=f"caster{k}", parent=f"fork{k}", mass=mass, i=mass * 1e-3, radius=0.05, x=-0.03, y=0, z=0
            )
        )
    path = tmp_path / "cart.urdf"
    path.write_text(BASE.format(wheels="".join(made), plugin=PLUGIN))
    return load_robot(path).robot


def sinking(robot):
    """How far the robot's origin sinks in a second on level ground [m]."""
    spec = new_spec(ArenaSpec(name="ground", starts=(), extent=((-2, 2), (-2, 2))), Physics())
    clearance = kinematic_tree_of(robot).clearance
    add_robot(spec, robot, "", (0.0, 0.0, clearance))
    model = spec.compile()
    data = mujoco.MjData(model)
    for actuator in range(model.nu):
        data.ctrl[actuator] = model.actuator(actuator).name.endswith(HOLD_SUFFIX)
    mujoco.mj_step(model, data, 200)
    return clearance - float(data.qpos[2])


def tyres(robot):
    return {part.name: part.shapes[0].tyre is not None for part in robot.parts if part.shapes}


def test_light_casters_get_firm_tyres_and_a_heavy_cart_stands(tmp_path):
    robot = cart(tmp_path, 0.05)
    firm = tyres(robot)
    assert {name for name, has in firm.items() if has} == {f"caster{k}_joint" for k in range(4)}
    assert 0.0 < sinking(robot) < 2 * MAX_SINKING  # two of six wheels bear nothing


def test_casters_that_do_not_sink_keep_the_usual_contact(tmp_path):
    robot = cart(tmp_path, 2.0)
    assert not any(tyres(robot).values())
    assert 0.0 < sinking(robot) < 2 * MAX_SINKING


def test_without_firm_tyres_the_cart_would_sink_as_deep_as_predicted(tmp_path):
    """(1 - d) d f w t^2 with MuJoCo's d of 0.95 and t of 0.02 s, in a run of the same robot without tyres."""
    robot = cart(tmp_path, 0.05)
    soft = replace(
        robot,
        parts=tuple(
            replace(part, shapes=tuple(replace(shape, tyre=None) for shape in part.shapes))
            for part in robot.parts
        ),
    )
    spec = new_spec(ArenaSpec(name="ground", starts=(), extent=((-2, 2), (-2, 2))), Physics())
    add_robot(spec, soft, "", (0.0, 0.0, 0.0))
    model = spec.compile()
    weight = model.body_invweight0[model.body("caster0_joint").id, 0]
    force = np.sum(model.body_mass) * 9.81 / 4
    assert sinking(soft) == pytest.approx(0.05 * 0.95 * force * weight * 0.02**2, rel=0.2)
    assert sinking(soft) > 5e-3
