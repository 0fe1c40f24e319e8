"""Stereo vision of a robot's section of an ini file (manual 3.2.6.2): it is the main camera's."""

from collections.abc import Mapping
from dataclasses import replace

from usarmjx.models.ini.items import WarningLog
from usarmjx.models.ini.parse import Line
from usarmjx.models.ini.read import Units, as_bool, as_vector, fail
from usarmjx.models.spec.robot import Options, RobotSpec
from usarmjx.models.spec.settings import field_name

STEREO_KEYS = ("isStereo", "stereoSpacing", "uuStereoSpacing")


def with_stereo(robot: RobotSpec, figures: Mapping[str, Line], units: Units, notes: WarningLog) -> RobotSpec:
    """Return a robot whose first camera has the eyes that its section gives it.

    As in the original, isStereo switches it on and the spacing is half the way between the eyes; of both
    spacings the one in metres counts.

    Raises:
        SpecError: A value of the wrong kind, or a spacing of 0; names file and line.
    """
    switch, metres, unreal = (figures.get(key.lower()) for key in STEREO_KEYS)
    told: dict[str, object] = {}
    if switch is not None:
        told["IsStereo"] = as_bool(switch, switch.value, "isStereo")
    if (line := metres or unreal) is not None:
        spacing = as_vector(line, line.value, line.key)
        if not any(spacing):
            fail(line, f"{line.key} is 0 along all axes", "half the distance of the eyes, as (Y=0.05)")
        if metres is None:
            spacing = replace(units, by_uu=True).position(spacing)
        told["StereoSpacing"] = tuple(zip("XYZ", spacing, strict=True))
    first = next((line for line in (switch, metres, unreal) if line is not None), None)
    if first is None:
        return robot
    if not robot.cameras:
        notes.add(first, f"{first.key} changes nothing: {robot.name} has no camera")
        return robot
    main, *others = robot.cameras
    kept: Options = tuple(
        (key, value) for key, value in main.options if field_name(key) not in map(field_name, told)
    )
    return replace(robot, cameras=(replace(main, options=(*kept, *told.items())), *others))
