"""Reports and descriptions against lines of the manual and lines captured from UT2004 servers.

A manual line is given as printed, with the corrections that captured lines or the manual's own
text ask for beside it: View in STA, 2 decimals for torques, 4 for a sensor's time, WheelBase.
"""

import math

import pytest

from usarmjx.base.errors import UsageError
from usarmjx.server.protocol import descriptions as d
from usarmjx.server.protocol import reports as r
from usarmjx.server.protocol.grammar import format_message, parse_message

ZERO = (0.0, 0.0, 0.0)
MANUAL_SCAN = (
    "2.2109,2.2075,2.2124,2.2122,2.2156,2.2166,2.2207,2.2283,2.2334,2.2392,2.2421,2.2533,2.2609,"
    "2.2696,2.2806,2.2894,2.3011,2.3104,2.3243,2.3409,2.3519,2.3708,2.3834,2.4032,2.4229,2.4429,"
    "2.4628,2.4853,2.5051,2.5282,2.5538,2.5837,2.6126,2.6425,2.6696,2.7012,1.3823,1.3642,1.3321,"
    "1.3025,1.2733,1.2457,1.2208,1.1951,1.1729,1.1522,1.1305,1.1109,1.0922,1.0741,1.0568,1.0412,"
    "1.0266,1.0110,0.9976,0.9845,0.9714,0.9592,0.9474,0.9377,0.9269,0.9170,0.9074,0.9001,0.8906,"
    "0.8835,0.8757,0.8680,0.8622,0.8556,0.8483,0.8440,0.8376,0.8331,0.8288,0.8248,0.8206,0.8070,"
    "0.8155,0.9298,1.0322,1.1549,1.3122,1.5795,1.7881,1.7952,1.7916,1.7913,1.7909,1.7891,1.7879,"
    "1.7878,1.7880,1.7898,1.7923,1.7960,1.8005,1.8023,1.8063,1.8131,1.8189,1.8236,1.8328,1.8395,"
    "1.8468,1.8541,1.8658,1.8740,1.8874,1.8990,1.9084,1.9234,1.9373,1.9507,1.9686,1.9843,1.9991,"
    "2.0188,2.0387,2.0568,2.0787,2.1020,2.1261,2.1519,2.1782,2.2026,2.2309,2.2636,2.1613,2.2169,"
    "2.2754,2.3380,2.4081,2.4626,2.5146,2.5325,2.5659,2.5955,2.6276,2.6645,1.5562,1.5928,1.6312,"
    "1.6698,1.7121,1.7554,1.8054,1.8507,1.9076,1.9653,2.0274,2.0935,2.1908,2.2722,2.3553,2.3809,"
    "4.5275,4.7421,4.9283,4.7977,4.6330,4.4815,4.3422,4.2114,4.0851,3.9718,3.8664,4.7144,4.6967,"
    "4.6828,4.6715,4.6571,4.6439,4.6354,4.6221,4.6157,4.6093,4.6163,4.6132,4.6037,4.5944"
)

CAPTURED = [
    pytest.param(
        r.nfo_greeting("DM-Factory_250"),
        "NFO {Gametype BotDeathMatch} {Level DM-Factory_250} {TimeLimit 0}",
        id="captured greeting",
    ),
    pytest.param(
        r.sta("GroundVehicle", r.RobotStatus(time=5609.4467, light=False, intensity=0, battery=1199)),
        "STA {Type GroundVehicle} {Time 5609.45} {FrontSteer 0.0000} {RearSteer 0.0000}"
        " {LightToggle False} {LightIntensity 0} {Battery 1199} {View -1}",
        id="captured STA",
    ),
    pytest.param(
        r.sta(
            "GroundVehicle",
            r.RobotStatus(
                time=1.0,
                joints=(("FRFlipper", -0.0006), ("FLFlipper", 0.25)),
                light=True,
                intensity=100,
                battery=3600,
                view=2,
            ),
        ),
        "STA {Type GroundVehicle} {Time 1.00} {FrontSteer 0.0000} {RearSteer 0.0000}"
        " {FRFlipper -0.0006} {FLFlipper 0.2500}"
        " {LightToggle True} {LightIntensity 100} {Battery 3600} {View 2}",
        id="captured STA of a robot with flippers, other values",
    ),
    pytest.param(
        r.missta(102.09, "CameraPanTilt", [(0, 9.0, 9.0), (1, 0.0, -20.0), (2, -0.16, -300.0)]),
        "MISSTA {Time 102.09} {Name CameraPanTilt} {Link 1} {Value 0.0000} {Torque -20.00}"
        " {Link 2} {Value -0.1600} {Torque -300.00}",
        id="captured MISSTA, without its link 0",
    ),
    pytest.param(
        r.sen_range("Sonar", 5608.85, [("F1", 2.5098), ("F8", 4.9978), ("R1", 5.0)]),
        "SEN {Time 5608.8500} {Type Sonar} {Name F1 Range 2.5098} {Name F8 Range 4.9978}"
        " {Name R1 Range 5.0000}",
        id="captured Sonar",
    ),
    pytest.param(
        r.sen_scanner(
            "RangeScanner", 5608.85, r.RangeScan("Scanner1", math.radians(1), math.pi, [11.3059, 20.0])
        ),
        "SEN {Time 5608.85} {Type RangeScanner} {Name Scanner1} {Resolution 0.0174} {FOV 3.1415}"
        " {Range 11.3059,20.0000}",
        id="captured RangeScanner",
    ),
    pytest.param(
        r.sen_odometry(44.5467, "Odometry", (0.2415, 0.0029, -0.5157)),
        "SEN {Time 44.5467} {Type Odometry} {Name Odometry} {Pose 0.2415,0.0029,-0.5157}",
        id="captured Odometry of a newer server",
    ),
    pytest.param(
        r.sen_ground_truth(1939.1141, "GroundTruth", (0.75, -7.28, -0.26), (0.0, 6.2832, 0.0)),
        "SEN {Time 1939.1141} {Type GroundTruth} {Name GroundTruth} {Location 0.75,-7.28,-0.26}"
        " {Orientation 0.00,6.28,0.00}",
        id="captured GroundTruth",
    ),
    pytest.param(
        r.sen_ins(None, "INS", (12.61, -2.68, 1.84), ZERO),
        "SEN {Type INS} {Name INS} {Location 12.61,-2.68,1.84} {Orientation 0.00,0.00,0.00}",
        id="captured INS",
    ),
    pytest.param(
        r.sen_encoder(None, [("ECLeft", 0), ("ECRight", -5)]),
        "SEN {Type Encoder} {Name ECLeft Tick 0} {Name ECRight Tick -5}",
        id="captured Encoder",
    ),
    pytest.param(
        r.sen_gps(None, "GPS", (39 + 8.0341 / 60, -77 - 13.0001 / 60), 11),
        "SEN {Type GPS} {Name GPS} {Latitude 39,8.0341,N} {Longitude 77,13.0001,W} {Fix 1} {Satellites 11}",
        id="captured GPS",
    ),
    pytest.param(
        r.sen_gps(None, "GPS", None, 3),
        "SEN {Type GPS} {Name GPS} {Fix 0} {Satellites 3}",
        id="GPS without a position, as GPSSensor.uc sends it",
    ),
    pytest.param(
        r.sen_touch(None, [("Touch", False)]),
        "SEN {Type Touch} {Name Touch Touch False}",
        id="captured Touch",
    ),
    pytest.param(
        d.geo_robot(
            d.RobotGeometry(
                kind="GroundVehicle",
                name="P2AT",
                dimensions=(0.5238, 0.4968, 0.2913),
                cog=ZERO,
                wheel_radius=0.13,
                wheel_separation=0.4712,
                wheel_base=0.2884,
            )
        ),
        "GEO {Type GroundVehicle} {Name P2AT} {Dimensions 0.5238,0.4968,0.2913}"
        " {COG 0.0000,0.0000,0.0000} {WheelRadius 0.1300} {WheelSeparation 0.4712}"
        " {WheelBase 0.2884}",
        id="captured GEO of a P2AT",
    ),
    pytest.param(
        d.geo_items(
            "Sonar",
            [
                ("F2", (0.185, -0.115, 0.0), (0.0, 0.0, -0.8727), "HARD"),
                ("F3", (0.22, -0.08, 0.0), (0.0, -0.0, -0.5236), "CameraPanTilt_Link2"),
            ],
        ),
        "GEO {Type Sonar}"
        " {Name F2 Location 0.1850,-0.1150,0.0000 Orientation 0.0000,0.0000,-0.8727 Mount HARD}"
        " {Name F3 Location 0.2200,-0.0800,0.0000 Orientation 0.0000,-0.0000,-0.5236"
        " Mount CameraPanTilt_Link2}",
        id="captured GEO of a Sonar, and a second item",
    ),
    pytest.param(
        d.conf_robot(
            d.RobotConfiguration(
                kind="GroundVehicle",
                name="P2AT",
                steering="SkidSteered",
                mass=14.0,
                max_speed=5.385,
                max_torque=60.0,
            )
        ),
        "CONF {Type GroundVehicle} {Name P2AT} {SteeringType SkidSteered} {Mass 14.0000}"
        " {MaxSpeed 5.3850} {MaxTorque 60.0000} {MaxFrontSteer 0.0000} {MaxRearSteer 0.0000}",
        id="captured CONF of a P2AT",
    ),
    pytest.param(
        d.conf_items(
            "Sonar",
            [
                [("Name", name), ("MaxRange", 5.0), ("MinRange", 0.1), ("BeamAngle", 0.3491)]
                for name in ("R8", "R7")
            ],
        ),
        "CONF {Type Sonar} {Name R8} {MaxRange 5.0000} {MinRange 0.1000} {BeamAngle 0.3491}"
        " {Name R7} {MaxRange 5.0000} {MinRange 0.1000} {BeamAngle 0.3491}",
        id="captured CONF of a Sonar, twice",
    ),
    pytest.param(
        d.conf_items(
            "RangeScanner",
            [
                [
                    ("Name", "Scanner1"),
                    ("Resolution", math.radians(1)),
                    ("Fov", math.pi),
                    ("Paning", True),
                    ("Tilting", False),
                ]
            ],
        ),
        "CONF {Type RangeScanner} {Name Scanner1} {Resolution 0.0174} {Fov 3.1415} {Paning True}"
        " {Tilting False}",
        id="captured CONF of a RangeScanner, without its ranges",
    ),
    pytest.param(
        d.conf_items("Odometry", [[("Name", "O"), ("ScanInterval", 0.2), ("EncoderResolution", 0.0099)]]),
        "CONF {Type Odometry} {Name O} {ScanInterval 0.2000} {EncoderResolution 0.0099}",
        id="captured CONF of an Odometry",
    ),
    pytest.param(
        d.conf_items("INS", [[("Name", "INS"), ("ScanInterval", 0.2)]]),
        "CONF {Type INS} {Name INS} {ScanInterval 0.20}",
        id="captured CONF of an INS",
    ),
    pytest.param(
        d.conf_items("GPS", [[("Name", "GPS"), ("ScanInterval", 0.2)]]),
        "CONF {Type GPS} {Name GPS} {ScanInterval 0.20}",
        id="captured CONF of a GPS",
    ),
    pytest.param(
        d.conf_items("groundtruth", [[("Name", "T"), ("ScanInterval", 0.05)]]),
        "CONF {Type groundtruth} {Name T} {ScanInterval 0.05}",
        id="captured CONF of a GroundTruth, asked for in lower case",
    ),
    pytest.param(d.geo_nothing("RFID"), "GEO {Type RFID}", id="captured GEO of nothing"),
    pytest.param(d.geo_nothing("Sonar", "F99"), "GEO {Type Sonar} {Name F99}", id="captured GEO of no name"),
    pytest.param(d.conf_nothing("Gripper"), "CONF {Type Gripper}", id="captured CONF of nothing"),
    pytest.param(
        d.conf_nothing("Sonar", "F99"),
        "CONF {Type Sonar} {Name F99}",
        id="captured CONF of no name",
    ),
]

MANUAL = [
    pytest.param(
        r.nfo_start_poses(
            [
                ("BlueGoal", (-2.55, -0.001, -0.19), (0.0, -0.03, -0.01)),
                ("MiddleField", (0.01, -0.0, -0.19), ZERO),
                ("YellowGoal", (2.57, -0.01, -0.19), (0.0, 0.0, 3.13)),
            ]
        ),
        "NFO {StartPoses 3} {BlueGoal -2.55,-0.00,-0.19 0.00,-0.03,-0.01"
        " MiddleField 0.01,-0.00,-0.19 0.00,0.00,0.00,0.00 YellowGoal 2.57,-0.01,-0.19"
        " 0.00,0.00,3.13}",
        {"0.00,0.00,0.00,0.00": "0.00,0.00,0.00"},  # four numbers: a slip
        id="manual 5.3.3",
    ),
    pytest.param(
        r.nfo_start_poses(
            [
                ("Start1", (-1.79, 0.7, -0.19), ZERO),
                ("Start2", (-4.1, 0.19, -1.21), ZERO),
                ("Start3", (-4.09, -1.79, -1.72), ZERO),
                ("Start4", (-0.96, -1.86, -2.24), (0.0, 0.11, 0.51)),
            ]
        ),
        "NFO {StartPoses 4} {Start1 -1.79,0.70,-0.19 0.00,0.00,0.00 Start2 -4.10,0.19,-1.21"
        " 0.00,0.00,0.00 Start3 -4.09,-1.79,-1.72 0.00,0.00,0.00 Start4 -0.96,-1.86,-2.24"
        " 0.00,0.11,0.51}",
        {},
        id="manual 5.3.6.1",
    ),
    pytest.param(r.nfo_start_poses([]), "NFO {StartPoses 0}", {}, id="manual 5.3.3 no poses"),
    pytest.param(
        r.sta("GroundVehicle", r.RobotStatus(time=62.01, light=False, intensity=0, battery=3564)),
        "STA {Type GroundVehicle} {Time 62.01} {FrontSteer 0.0000} {RearSteer 0.0000}"
        " {LightToggle False} {LightIntensity 0} {Battery 3564}",
        {"{Battery 3564}": "{Battery 3564} {View -1}"},
        id="manual 9.3 STA",
    ),
    pytest.param(
        r.missta(102.09, "CameraPanTilt", [(1, 0.0, -20.0), (2, -0.16, -20.0)]),
        "MISSTA {Time 102.09} {Name CameraPanTilt} {Link 1} {Value 0.0000} {Torque -20.0000}"
        " {Link 2} {Value -0.1600} {Torque -20.0000}",
        {"-20.0000": "-20.00"},
        id="manual 9.3 MISSTA",
    ),
    pytest.param(
        r.sen_range(
            "Sonar",
            45.14,
            zip(
                ["F1", "F2", "F3", "F4", "F5", "F6", "F7", "F8"],
                [4.4690, 1.9387, 1.9159, 1.6547, 0.8889, 0.7640, 1.1075, 2.0773],
                strict=True,
            ),
        ),
        "SEN {Time 45.14} {Type Sonar} {Name F1 Range 4.4690} {Name F2 Range 1.9387}"
        " {Name F3 Range 1.9159} {Name F4 Range 1.6547} {Name F5 Range 0.8889}"
        " {Name F6 Range 0.7640} {Name F7 Range 1.1075} {Name F8 Range 2.0773}",
        {"{Time 45.14}": "{Time 45.1400}"},
        id="manual 9.3 Sonar",
    ),
    pytest.param(
        r.sen_scanner(
            "RangeScanner",
            None,
            r.RangeScan(
                "Scanner1",
                math.radians(1),
                math.pi,
                [float(text) for text in MANUAL_SCAN.split(",")],
            ),
        ),
        "SEN {Type RangeScanner} {Name Scanner1} {Resolution 0.0174} {FOV 3.1415}"
        f" {{Range {MANUAL_SCAN}}}",
        {},
        id="manual 9.3 RangeScanner, 181 beams",
    ),
    pytest.param(
        r.sen_odometry(None, "Odometry", (0.2415, 0.0029, -0.5157)),
        "SEN {Type Odometry} {Name Odometry} {Pose 0.2415,0.0029,-0.5157}",
        {},
        id="manual 9.3 Odometry",
    ),
    pytest.param(
        r.sen_ins(None, "INS", (1.23, 2.23, 0.12), (4.57, 3.14, 1.507)),
        "SEN {Type INS} {Name INS} {Location 1.23, 2.23, 0.12} {Orientation 4.57, 3.14, 1.507}",
        {", ": ",", "1.507": "1.51"},  # 9.2 forbids the spaces
        id="manual 9.3 INS",
    ),
    pytest.param(
        r.sen_encoder(None, [("ECLeft", -61), ("ECRight", -282), ("ECTilt", 0), ("ECPan", 0)]),
        "SEN {Type Encoder} {Name ECLeft Tick -61} {Name ECRight Tick -282} {Name ECTilt Tick 0}"
        " {Name ECPan Tick 0}",
        {},
        id="manual 9.3 Encoder",
    ),
    pytest.param(
        r.sen_gps(None, "GPS1", (47 + 40.3323 / 60, -122 - 18.5977 / 60), 8),
        "SEN {Type GPS} {Name GPS1} {Latitude 47,40.3323,N} {Longitude 122,18.5977,W} {Fix 1} {Satellites 8}",
        {},
        id="manual 9.3 GPS",
    ),
    pytest.param(
        r.sen_touch(None, [("Front", True), ("Left", False), ("Right", False)]),
        "SEN {Type Touch} {Name Front Touch True} {Name Left Touch False} {Name Right Touch False}",
        {},
        id="manual 9.3 Touch",
    ),
    pytest.param(
        d.geo_robot(
            d.RobotGeometry(
                kind="GroundVehicle",
                name="ATRVJr",
                dimensions=(0.7744, 0.6318, 0.5754),
                cog=(0.0, 0.0, -0.1),
                wheel_radius=0.1922,
                wheel_separation=0.512,
                wheel_base=0.388,
            )
        ),
        "GEO {Type GroundVehicle} {Name ATRVJr} {Dimensions 0.7744,0.6318,0.5754}"
        " {COG 0.0000,0.0000,-0.1000} {WheelRadius 0.1922} {WheelSeparation 0.5120}"
        " {Wheelbase 0.3880}",
        {"Wheelbase": "WheelBase"},
        id="manual 9.3 GEO GroundVehicle",
    ),
    pytest.param(
        d.geo_robot(d.RobotGeometry("LeggedRobot", "ERS", (0.319, 0.18, 0.278), ZERO)),
        "GEO {Type LeggedRobot} {Name ERS} {Dimensions 0.3190,0.1800,0.2780} {COG 0.0000,0.0000,0.0000}",
        {},
        id="manual 9.3 GEO LeggedRobot",
    ),
    pytest.param(
        d.geo_robot(d.RobotGeometry("NauticVehicle", "Submarine", (6.5364, 1.1428, 1.9929), ZERO)),
        "GEO {Type NauticVehicle} {Name Submarine} {Dimensions 6.5364, 1.1428, 1.9929}"
        " {COG 0.0000,0.0000,0.0000}",
        {", ": ","},  # 9.2 forbids the spaces
        id="manual 9.3 GEO NauticVehicle",
    ),
    pytest.param(
        d.geo_robot(d.RobotGeometry("AerialVehicle", "AirRobot", (9.0082, 6.6897, 2.6128), ZERO)),
        "GEO {Type AerialVehicle} {Name AirRobot} {Dimensions 9.0082, 6.6897, 2.6128}"
        " {COG 0.0000,0.0000,0.0000}",
        {", ": ","},
        id="manual 9.3 GEO AerialVehicle",
    ),
    pytest.param(
        d.geo_items("Camera", [("Camera", (0.082, 0.0002, 0.0613), (0.0, -0.00001, 0.0), "CameraTilt")]),
        "GEO {Type Camera} {Name Camera Location 0.0820,0.0002,0.0613"
        " Orientation 0.0000,-0.0000,0.0000 Mount CameraTilt}",
        {},
        id="manual 9.3 GEO Camera",
    ),
    pytest.param(
        d.geo_mispkg(
            [
                (
                    "CameraPanTilt",
                    [
                        d.LinkGeometry(1, -1, (0.1239, 0.0, -0.2036), (math.pi, 0.0, 0.0)),
                        d.LinkGeometry(2, 1, (0.0, 0.0, 0.0599), (math.pi / 2, 0.0, 0.0)),
                    ],
                )
            ]
        ),
        "GEO {Type MisPkg} {Name CameraPanTilt} {Link 1} {ParentLink -1}"
        " {Location 0.1239,0.0000,-0.2036} {Orientation 3.1415,0.0000,0.0000} {Link 2}"
        " {ParentLink 1} {Location 0.0000,0.0000,0.0599} {Orientation 1.5707,0.0000,0.0000}",
        {},
        id="manual 9.3 GEO MisPkg",
    ),
    pytest.param(
        d.conf_robot(
            d.RobotConfiguration(
                kind="GroundVehicle",
                name="ATRVJr",
                steering="SkidSteered",
                mass=50.0,
                max_speed=2 * math.pi / 3,
                max_torque=60.0,
            )
        ),
        "CONF {Type GroundVehicle} {Name ATRVJr} {SteeringType SkidSteered} {Mass 50.0000}"
        " {MaxSpeed 2.0943} {MaxTorque 60.0000} {MaxFrontSteer 0.0000} {MaxRearSteer 0.0000}",
        {},
        id="manual 9.3 CONF GroundVehicle",
    ),
    pytest.param(
        d.conf_robot(d.RobotConfiguration("LeggedRobot", "QRIO", "TwoLegs", 50.0)),
        "CONF {Type LeggedRobot} {Name QRIO} {SteeringType TwoLegs} {Mass 50.0000}",
        {},
        id="manual 9.3 CONF LeggedRobot",
    ),
    pytest.param(
        d.conf_robot(d.RobotConfiguration("NauticVehicle", "Submarine", "Underwater", 50.0)),
        "CONF {Type NauticVehicle} {Name Submarine} {SteeringType Underwater}{Mass 50.0000}",
        {"}{": "} {"},
        id="manual 9.3 CONF NauticVehicle",
    ),
    pytest.param(
        d.conf_robot(d.RobotConfiguration("AerialVehicle", "AirRobot", "RotaryWing", 50.0)),
        "CONF {Type AerialVehicle} {Name AirRobot} {SteeringType RotaryWing} {Mass 50.0000}",
        {},
        id="manual 9.3 CONF AerialVehicle",
    ),
    pytest.param(
        d.conf_items(
            "Camera",
            [
                [
                    ("CameraDefFov", 0.8727),
                    ("CameraMinFov", 0.3491),
                    ("CameraMaxFov", 2 * math.pi / 3),
                    ("CameraFov", math.radians(50)),
                ]
            ],
        ),
        "CONF {Type Camera} {CameraDefFov 0.8727} {CameraMinFov 0.3491} {CameraMaxFov 2.0943}"
        " {CameraFov 0.8726}",
        {},
        id="manual 9.3 CONF Camera",
    ),
    pytest.param(
        d.conf_effecters([("Roller", [("Animate", 6.0, -6.0)])]),
        "CONF {Type Effecter} {Name Roller} {Opcode Animate} {MaxVal 6}{MinVal -6}",
        # 6.2: numbers have 4 decimals by default.
        {"{MaxVal 6}{": "{MaxVal 6.0000} {", "{MinVal -6}": "{MinVal -6.0000}"},
        id="manual 9.3 CONF Effecter",
    ),
    pytest.param(
        d.conf_mispkg(
            [
                (
                    "CameraPantilt",
                    [
                        d.LinkConfiguration(
                            link=link,
                            joint="Revolute",
                            max_speed=0.17,
                            max_torque=20.0,
                            min_range=low,
                            max_range=high,
                        )
                        for link, low, high in ((1, 1.0, 0.0), (2, -0.16, 0.4))
                    ],
                )
            ]
        ),
        "CONF {Type MisPkg} {Name CameraPantilt} {Link 1} {JointType Revolute} {MaxSpeed 0.17}"
        " {MaxTorque 20.00} {MinRange 1} {MaxRange 0} {Link 2} {JointType Revolute}"
        " {MaxSpeed 0.17} {MaxTorque 20} {MinRange -0.16} {MaxRange 0.40}",
        # Captured lines have 2 decimals in all of these, as this one has in some.
        {
            "{MinRange 1}": "{MinRange 1.00}",
            "{MaxRange 0}": "{MaxRange 0.00}",
            "{MaxTorque 20}": "{MaxTorque 20.00}",
        },
        id="manual 9.3 CONF MisPkg",
    ),
    pytest.param(
        r.res(61.2, "Odometry", "Odo1", "OK"),
        "RES {Time 61.20} {Type Odometry} {Name Odo1} {Status OK}",
        {},
        id="manual 9.3 RES",
    ),
    pytest.param(
        r.res_camera(426.76, [("Camera", math.pi / 4, "OK"), ("Camera2", math.pi / 4, "OK")]),
        "RES {Time 426.76} {Type Camera} {Name Camera} {FOV 0.7853} {Status OK} {Name Camera2} {FOV 0.7853}"
        " {Status OK}",
        {},
        id="manual 9.3 RES Camera",
    ),
    pytest.param(
        r.res_viewports(56.68, ("SingleView", "OK"), [("Camera", "OK"), *[("Disabled", "OK")] * 3]),
        "RES {Time 56.68} {Type Viewports} {Config SingleView} {Status OK} {Viewport1 Camera} {Status OK}"
        " {Viewport2 Disabled} {Status OK} {Viewport3 Disabled} {Status OK} {Viewport4 Disabled} {Status OK}",
        {},
        id="manual 9.3 RES Viewports",
    ),
]


@pytest.mark.parametrize(("message", "line"), CAPTURED)
def test_captured_lines(message, line):
    assert format_message(message) == line
    assert parse_message(line) == message


@pytest.mark.parametrize(("message", "printed", "corrections"), MANUAL)
def test_manual_lines(message, printed, corrections):
    line = printed
    for wrong, right in corrections.items():
        assert wrong in line
        line = line.replace(wrong, right)
    assert format_message(message) == line
    assert parse_message(line) == message


# The angles that manual 9.3 lists for each kind; it prints an example for the first kind only.
@pytest.mark.parametrize(
    ("kind", "angles"),
    [
        ("GroundVehicle", "{FrontSteer 0.5235} {RearSteer -0.2500} "),
        ("LeggedRobot", ""),
        ("NauticVehicle", "{SternPlaneAngle 0.1250} {RudderAngle -0.4363} "),
        ("AerialVehicle", ""),
    ],
)
def test_a_status_line_has_the_angles_of_its_kind(kind, angles):
    status = r.RobotStatus(
        time=62.01,
        light=True,
        intensity=100,
        battery=3564,
        front_steer=math.radians(30),
        rear_steer=-0.25,
        stern_plane=0.125,
        rudder=-0.4363,
        joints=(("FRFlipper", 1.5),),
    )
    assert format_message(r.sta(kind, status)) == (
        f"STA {{Type {kind}}} {{Time 62.01}} {angles}{{FRFlipper 1.5000}}"
        " {LightToggle True} {LightIntensity 100} {Battery 3564} {View -1}"
    )


@pytest.mark.parametrize("kind", ["LeggedRobot", "NauticVehicle", "AerialVehicle"])
def test_wheels_and_steering_limits_are_said_of_ground_vehicles_only(kind):
    geometry = d.geo_robot(d.RobotGeometry(kind, "X", (1.0, 2.0, 3.0), ZERO, 0.1, 0.2, 0.3))
    configuration = d.conf_robot(d.RobotConfiguration(kind, "X", "S", 1.0, 2.0, 3.0, 4.0, 5.0))
    assert [key for key, _ in geometry.segments] == ["Type", "Name", "Dimensions", "COG"]
    assert [key for key, _ in configuration.segments] == ["Type", "Name", "SteeringType", "Mass"]


def test_a_steered_ground_vehicle_tells_its_limits():
    limits = {"max_speed": 100.0, "max_torque": 60.0, "max_front_steer": 0.7, "max_rear_steer": 0.35}
    message = d.conf_robot(
        d.RobotConfiguration("GroundVehicle", "Hummer", "AckermanSteered", 3000.0, **limits)
    )
    assert format_message(message) == (
        "CONF {Type GroundVehicle} {Name Hummer} {SteeringType AckermanSteered} {Mass 3000.0000}"
        " {MaxSpeed 100.0000} {MaxTorque 60.0000} {MaxFrontSteer 0.7000} {MaxRearSteer 0.3500}"
    )


@pytest.mark.parametrize("missing", ["WheelRadius", "WheelSeparation", "WheelBase"])
def test_a_ground_vehicle_must_have_wheels(missing):
    wheels = [None if key == missing else 0.1 for key in ("WheelRadius", "WheelSeparation", "WheelBase")]
    with pytest.raises(UsageError, match=f"'P2AT' needs a number for {missing}"):
        d.geo_robot(d.RobotGeometry("GroundVehicle", "P2AT", ZERO, ZERO, *wheels))


@pytest.mark.parametrize(
    "report",
    [
        lambda kind: r.sta(kind, r.RobotStatus(time=0.0, light=False, intensity=0, battery=0)),
        lambda kind: d.geo_robot(d.RobotGeometry(kind, "X", ZERO, ZERO)),
        lambda kind: d.conf_robot(d.RobotConfiguration(kind, "X", "S", 1.0)),
    ],
)
def test_an_unknown_kind_of_vehicle_is_our_fault(report):
    with pytest.raises(UsageError, match=r"'groundvehicle'; known: GroundVehicle, LeggedRobot"):
        report("groundvehicle")


def test_all_effecters_and_operations_come_in_one_line():
    roller, gripper = [("Animate", 6.0, -6.0), ("NOP", 0.0, 0.0)], [("Animate", math.pi / 2, 0.0)]
    assert format_message(d.conf_effecters([("Roller", roller), ("Gripper", gripper), ("Inert", [])])) == (
        "CONF {Type Effecter} {Name Roller} {Opcode Animate} {MaxVal 6.0000} {MinVal -6.0000}"
        " {Opcode NOP} {MaxVal 0.0000} {MinVal 0.0000}"
        " {Name Gripper} {Opcode Animate} {MaxVal 1.5707} {MinVal 0.0000} {Name Inert}"
    )


def test_all_packages_come_in_one_line():
    geometry = d.LinkGeometry(1, -1, ZERO, ZERO)
    message = d.geo_mispkg([("Arm", [geometry]), ("PanTilt", [geometry, geometry])])
    assert message.all("Name") == ("Arm", "PanTilt")
    assert [key for key, _ in message.segments].count("ParentLink") == 3
    assert format_message(d.conf_mispkg([("Arm", []), ("PanTilt", [])])) == (
        "CONF {Type MisPkg} {Name Arm} {Name PanTilt}"
    )


def test_a_scanner_line_fits_the_2048_characters_that_old_clients_hold():
    scan = r.RangeScan("Scanner1", math.radians(1), math.pi, [20.0] * 181)
    assert len(format_message(r.sen_scanner("RangeScanner", 99999.99, scan))) + 2 <= 2048


@pytest.mark.parametrize(
    ("latitude", "longitude", "place"),
    [
        (0.0, 0.0, "{Latitude 0,0.0000,N} {Longitude 0,0.0000,E}"),
        (-89.5, 179.75, "{Latitude 89,30.0000,S} {Longitude 179,45.0000,E}"),
        # A hair below a whole degree is that degree or 59.9999 minutes, never 60 minutes.
        (39 - 1e-12, -40 + 1e-12, "{Latitude 39,0.0000,N} {Longitude 40,0.0000,W}"),
        (39 - 1e-6, -40 + 1e-6, "{Latitude 38,59.9999,N} {Longitude 39,59.9999,W}"),
    ],
)
def test_gps_degrees_and_minutes(latitude, longitude, place):
    message = r.sen_gps(12.5, "G", (latitude, longitude), 12)
    assert (
        format_message(message)
        == f"SEN {{Time 12.5000}} {{Type GPS}} {{Name G}} {place} {{Fix 1}} {{Satellites 12}}"
    )


@pytest.mark.parametrize("name", ["", "two words", "a\ttab", "R\u00e4der", "bell\x07", "del\x7f", "a}", "{a"])
@pytest.mark.parametrize(
    "report",
    [
        lambda name: r.nfo_start_poses([(name, ZERO, ZERO)]),
        lambda name: r.sen_range("Sonar", None, [(name, 1.0)]),
        lambda name: r.sen_encoder(None, [(name, 1)]),
        lambda name: r.sen_touch(None, [(name, True)]),
        lambda name: d.geo_items("Sonar", [(name, ZERO, ZERO, "HARD")]),
        lambda name: d.geo_items("Sonar", [("F1", ZERO, ZERO, name)]),
    ],
)
def test_names_that_would_shift_the_pairs_after_them_are_refused(report, name):
    with pytest.raises(UsageError, match="one word"):
        report(name)


def test_a_name_may_be_of_all_other_printable_characters():
    """Manual 9.2: ASCII 33 to 126, of which braces end a segment."""
    name = "".join(chr(code) for code in range(33, 127) if chr(code) not in "{}")
    line = format_message(r.sen_range("Sonar", None, [(name, 1.0)]))
    assert line == f"SEN {{Type Sonar}} {{Name {name} Range 1.0000}}"
    assert parse_message(line).get("Name") == f"{name} Range 1.0000"


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_reading_that_is_not_finite_is_our_fault(value):
    with pytest.raises(UsageError, match="cannot be reported"):
        r.sen_range("Sonar", 1.0, [("F1", value)])
    with pytest.raises(UsageError, match="cannot be reported"):
        r.sta("NauticVehicle", r.RobotStatus(1.0, False, 0, 0, rudder=value))
    with pytest.raises(UsageError, match="cannot be reported"):
        r.sen_ins(None, "INS", (0.0, value, 0.0), ZERO)
