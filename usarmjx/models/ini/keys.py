"""What the sections and keys of USARBot.ini stand for, as tables: what is mapped elsewhere is not here."""

ITEM_CLASSES = {
    "SonarSensor": "Sonar",
    "IRSensor": "IR",
    "RangeScanner": "RangeScanner",
    "IRScanner": "IRScanner",
    "RangeScanner3D": "RangeScanner3D",
    "OdometrySensor": "Odometry",
    "GPSSensor": "GPS",
    "INS": "INS",
    "INSSensor": "INS",
    "INU": "INU",
    "INUSensor": "INU",
    "EncoderSensor": "Encoder",
    "TouchSensor": "Touch",
    "RFIDSensor": "RFID",
    "VictSensor": "VictSensor",
    "SoundSensor": "Sound",
    "HumanMotionSensor": "HumanMotion",
    "CO2Sensor": "CO2Sensor",
    "GroundTruth": "GroundTruth",
    "GroundTruthSensor": "GroundTruth",
    "RobotCamera": "Camera",
    "Gripper": "Gripper",
    "RFIDReleaser": "RFIDReleaser",
    "RollerTable": "RollerTable",
}
"""Class of an item (manual 10 and 11) and the type that the wire and `Mount.kind` know it by."""

UU_ANGLES = ("Resolution", "ScanFov")
"""Angles that the manual gives in whole Unreal units (10.3.2); a number with a point is in radians."""

OLD_PARTS = {"cameratilt": "CameraPanTilt_Link2", "camerapan": "CameraPanTilt_Link1"}
"""Part names from before V3.0, which the excerpt of manual 12.1.2 still has, and the captured ones."""

_LOOKS = "robots look as their solids do: there are no Unreal meshes and textures"
_SERVO = "servos go to their target at full speed and hold it as a spring does: no gap within which they slow"

KNOWN_IGNORED = {
    "StaticMesh": _LOOKS,
    "DrawScale": _LOOKS,
    "DrawScale3D": _LOOKS,
    "RobotSkins": _LOOKS,
    "KParams": "it names a Karma object inside an Unreal package; CenterOfMass (ours) moves the mass",
    "ConverterClass": "units and axes of the wire are fixed: metres, radians, z down",
    "HingePropGap": _SERVO,
    "SteerPropGap": _SERVO,
    "TireAdhesion": "contacts push and rub, and never pull: nothing sticks to anything",
    "TorqueCurve": "motors have one torque at all speeds",
    "SafeForce": "joints do not stall under overload",
    "ProtectTime": "joints do not stall under overload",
    "FlipTorque": "DRIVE {Flip} turns a robot with a torque that follows from its weight and length",
    "FlipTime": "DRIVE {Flip} lasts 3 s, the original's default, for every robot",
    "HeadLights": "every robot has one headlight, at its front",
    "CamTexActors": "an omnidirectional camera needs no second camera behind a texture",
    "logging_period": "usarmjx writes no position log of its own",
    "bDebug": "there is no Unreal log",
    "bBarCode": "it drew into the Unreal client's window",
    "bDisplayTeamBeacon": "it drew into the Unreal client's window",
}
"""Keys of a robot's section (manual 12.1.2, 14.4.2.3, KRobot.uc) that change nothing, and why."""

JOINT_IGNORED = {
    "DrawScale3D": _LOOKS,
}
"""The same for a part-joint pair (14.4.2.4)."""

ITEM_IGNORED = {"uuDirection": "it is the original's own note of Direction in Unreal units"}
"""The same for a mounted item (14.4.2.5)."""

_WHEELS = (
    "an INS has no wheels: the manual's 10.6.2 describes the key, which comes from 10.4.2, without showing it"
)
SETTINGS_IGNORED = {("INS", "righttire"): _WHEELS, ("INS", "lefttire"): _WHEELS}
"""The same for settings of a type of item, by type and key in lower case."""

SECTIONS_ELSEWHERE = ("USARBot.MultiView", "BotAPI.BotServer")
"""Sections that are not about robots and that something else reads: the image server, the Gamebots server."""

LINK_IGNORED = {
    name: "it refers to a class of an Unreal package; Location, Orientation and the limits are given directly"
    for name in ("LinkClass", "ParentMount", "SelfMount", "DrawScale3D")
}
"""Fields of the original's Links (KRobot.uc) that stand for what is given directly here."""
