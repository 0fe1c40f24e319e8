"""Robots and arenas as data, and their composition into one MuJoCo model. Nothing here knows worlds or time.

A robot is a `RobotSpec`, an arena an `ArenaSpec`, both of `Shape`s; values are frozen, so a change is a copy
by `dataclasses.replace`. `load_arena` and `robot_from_mjcf` read files, `check_arena` finds an arena's
faults. The packages `robots`, `arenas`, `drives`, `effecters`, `generate` and `roads` are faces of their own.
Private: `types` has the dataclasses, `compile` makes the MjModel, `files` and `ini` read, `check` checks. A
new robot or arena is one module beside the others. Begin with `models.robots.pioneer`, then
`compile.compose`.
"""

from typing import TYPE_CHECKING

from usarmjx.base.lazy import attach

if TYPE_CHECKING:
    from usarmjx.base.backend import fori_loop as fori_loop
    from usarmjx.base.backend import set_at as set_at
    from usarmjx.base.backend import vmap as vmap
    from usarmjx.base.backend import xp as xp
    from usarmjx.base.settings import NOT_NEGATIVE as NOT_NEGATIVE
    from usarmjx.base.settings import POSITIVE as POSITIVE
    from usarmjx.base.settings import SHARE as SHARE
    from usarmjx.base.settings import Setting as Setting
    from usarmjx.models.arenas import ARENAS as ARENAS
    from usarmjx.models.check import check_arena as check_arena
    from usarmjx.models.compile.kinematic_tree import KinematicTree as KinematicTree
    from usarmjx.models.compile.kinematic_tree import kinematic_tree_of as kinematic_tree_of
    from usarmjx.models.compile.kinematic_tree import with_measurements as with_measurements
    from usarmjx.models.compile.physics import Physics as Physics
    from usarmjx.models.compile.randomization import DomainRandomization as DomainRandomization
    from usarmjx.models.files.load import find_arena as find_arena
    from usarmjx.models.files.load import load_arena as load_arena
    from usarmjx.models.files.load import save_arena as save_arena
    from usarmjx.models.files.robot_file import LoadedRobot as LoadedRobot
    from usarmjx.models.files.robot_file import load_robot as load_robot
    from usarmjx.models.files.robot_file import robot_from_mjcf as robot_from_mjcf
    from usarmjx.models.ini.robots import LoadedRobots as LoadedRobots
    from usarmjx.models.ini.robots import load_robots as load_robots
    from usarmjx.models.robots import ROBOTS as ROBOTS
    from usarmjx.models.types.arena import ArenaSpec as ArenaSpec
    from usarmjx.models.types.arena import Door as Door
    from usarmjx.models.types.arena import FalseAlarm as FalseAlarm
    from usarmjx.models.types.arena import HelpSound as HelpSound
    from usarmjx.models.types.arena import Light as Light
    from usarmjx.models.types.arena import LooseObject as LooseObject
    from usarmjx.models.types.arena import SegmentMotion as SegmentMotion
    from usarmjx.models.types.arena import StartPose as StartPose
    from usarmjx.models.types.arena import Tag as Tag
    from usarmjx.models.types.arena import Victim as Victim
    from usarmjx.models.types.arena import Water as Water
    from usarmjx.models.types.robot import BodyInertia as BodyInertia
    from usarmjx.models.types.robot import Link as Link
    from usarmjx.models.types.robot import MissionPackage as MissionPackage
    from usarmjx.models.types.robot import Motor as Motor
    from usarmjx.models.types.robot import Mount as Mount
    from usarmjx.models.types.robot import Part as Part
    from usarmjx.models.types.robot import RobotSpec as RobotSpec
    from usarmjx.models.types.robot import Spring as Spring
    from usarmjx.models.types.robot import options as options
    from usarmjx.models.types.shapes import GLASS as GLASS
    from usarmjx.models.types.shapes import MATERIALS as MATERIALS
    from usarmjx.models.types.shapes import SKY as SKY
    from usarmjx.models.types.shapes import SURFACES as SURFACES
    from usarmjx.models.types.shapes import Conveyor as Conveyor
    from usarmjx.models.types.shapes import HeightField as HeightField
    from usarmjx.models.types.shapes import Mesh as Mesh
    from usarmjx.models.types.shapes import Shape as Shape
    from usarmjx.models.types.shapes import Surface as Surface
else:
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "usarmjx.base.backend": ("fori_loop", "set_at", "vmap", "xp"),
            "usarmjx.base.settings": ("NOT_NEGATIVE", "POSITIVE", "SHARE", "Setting"),
            "usarmjx.models.arenas": ("ARENAS",),
            "usarmjx.models.check": ("check_arena",),
            "usarmjx.models.compile.physics": ("Physics",),
            "usarmjx.models.compile.kinematic_tree": (
                "KinematicTree",
                "kinematic_tree_of",
                "with_measurements",
            ),
            "usarmjx.models.compile.randomization": ("DomainRandomization",),
            "usarmjx.models.files.load": ("find_arena", "load_arena", "save_arena"),
            "usarmjx.models.files.robot_file": ("LoadedRobot", "load_robot", "robot_from_mjcf"),
            "usarmjx.models.ini.robots": ("LoadedRobots", "load_robots"),
            "usarmjx.models.robots": ("ROBOTS",),
            "usarmjx.models.types.arena": (
                "ArenaSpec",
                "Door",
                "FalseAlarm",
                "HelpSound",
                "Light",
                "LooseObject",
                "SegmentMotion",
                "StartPose",
                "Tag",
                "Victim",
                "Water",
            ),
            "usarmjx.models.types.robot": (
                "BodyInertia",
                "Link",
                "MissionPackage",
                "Motor",
                "Mount",
                "Part",
                "RobotSpec",
                "Spring",
                "options",
            ),
            "usarmjx.models.types.shapes": (
                "GLASS",
                "MATERIALS",
                "SKY",
                "SURFACES",
                "Conveyor",
                "HeightField",
                "Mesh",
                "Shape",
                "Surface",
            ),
        },
    )
