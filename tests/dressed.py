"""Robots whose solids are what they are drawn as: what their pictures are compared with."""

from dataclasses import replace

from usarmjx.models.types.robot import RobotSpec
from usarmjx.models.types.shapes import Shape


def _solid(looks: tuple[Shape, ...], shapes: tuple[Shape, ...]) -> tuple[Shape, ...]:
    return tuple(replace(shape, mass=0.1, surface="fixture") for shape in looks or shapes)


def dressed(robot: RobotSpec) -> RobotSpec:
    """The robot, of which sensors and contacts meet what pictures show; its masses are others."""

    def drawn(one):
        return replace(one, shapes=_solid(one.looks, one.shapes), looks=())

    parts = tuple(map(drawn, robot.parts))
    packages = (replace(package, links=tuple(map(drawn, package.links))) for package in robot.packages)
    chassis = _solid(robot.looks, robot.chassis)
    return replace(robot, chassis=chassis, looks=(), parts=parts, packages=tuple(packages))
