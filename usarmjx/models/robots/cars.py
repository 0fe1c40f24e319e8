"""The cars: Hummer, SnowStorm, Sedan and Cooper (manual 12.5 to 12.8).

The manual gives sizes and speeds of most; data sheets of the real cars, and choices, complete them. Sedan and
Cooper have the manual's 100 rad/s; its 134 km/h for them are those of the Hummer's bigger wheels.
"""

from usarmjx.models.robots.car_kit import Car, CarStyle, build_car
from usarmjx.models.robots.kit import (
    ALONG,
    JET_BLACK,
    SICK_YELLOW,
    SILVER,
    TYRE_BLACK,
    block,
    camera,
    drum,
    lens,
    pan_tilt,
    rod,
    sick,
    sick_housing,
    sick_lms200,
)
from usarmjx.models.types.robot import CHASSIS, Mount, options

HUMMER_LENGTH, HUMMER_WIDTH = 3.686, 1.799  # manual 12.5.1; the real one has 4.57 and 2.16
_HUMMER = Car(
    name="Hummer",
    dimensions=(HUMMER_LENGTH, HUMMER_WIDTH, 2.059),  # manual 12.5.1
    mass=2359.0,  # data sheet: M998, 5200 lb
    wheel_base=3.30 * HUMMER_LENGTH / 4.57,  # data sheet: 130 in; scaled
    track=1.82 * HUMMER_WIDTH / 2.16,  # data sheet: 71.6 in; scaled
    tyre=(0.3727, 0.26),  # manual 12.5.1; width data sheet (12.5 in), scaled
    unsprung=(55.0, 45.0),  # chosen: tyres with run-flat inserts, geared hubs
    floor=0.33,  # data sheet: 16 in, scaled
    beltline=1.10,  # chosen, as all below
    cog_height=0.62,
    front_weight_share=0.5,
    all_wheel=True,  # manual 12.5.1
    max_acceleration=5.0,
    rgba=(0.45, 0.45, 0.3, 1.0),
    look=CarStyle(
        cowl=0.4,
        roof=(0.3, -0.55),
        deck=-0.95,
        nose=0.08,
        tuck=0.1,
        pillars=(0.0, -0.45),
        lamps=True,
        grille=7,
        trim=(0.36, 0.36, 0.24, 1.0),
    ),
)
HUMMER_SCANNER = (1.3, 0.0, _HUMMER.origin - _HUMMER.beltline - 0.05)  # chosen: on the bonnet
HUMMER = build_car(
    _HUMMER,
    solids=(sick_housing(HUMMER_SCANNER),),
    looks=(
        *sick(HUMMER_SCANNER),
        *(
            block((0.3, 0.04, 0.02), (1.1, y, _HUMMER.origin - _HUMMER.beltline), JET_BLACK)
            for y in (-0.5, 0.5)
        ),
        rod((0.75, 0.92, -0.2), (0.75, 0.92, -1.2), 0.05, JET_BLACK),  # the snorkel
        rod((0.75, 0.0, -0.07), (0.58, 0.0, -0.98), 0.03, _HUMMER.rgba),  # two windscreens
        *(rod((1.86, y, 0.35), (1.86, y, -0.1), 0.03, JET_BLACK) for y in (-0.35, 0.35)),
        rod((1.86, -0.6, -0.1), (1.86, 0.6, -0.1), 0.03, JET_BLACK),
        drum(0.36, 0.12, (-1.9, 0.35, 0.1), TYRE_BLACK, ALONG),  # the spare wheel
        drum(0.2, 0.13, (-1.9, 0.35, 0.1), _HUMMER.rgba, ALONG),
        rod((-1.6, -0.8, -0.2), (-1.65, -0.8, -1.4), 0.012, JET_BLACK),
    ),
    packages=(pan_tilt((0.0, 0.0, -_HUMMER.origin)),),  # chosen: on the roof; pans all around
    sensors=(sick_lms200(HUMMER_SCANNER),),
    cameras=(camera(),),
    sources=(
        ("dimensions, wheel radius, top speed, wheels", "manual 12.5"),
        ("scanner, camera", "manual 12.5"),
        ("mass, wheel base, track", "data sheet"),
        ("layout", "chosen"),
    ),
)

_SNOWSTORM = Car(
    name="SnowStorm",
    dimensions=(4.239, 1.720, 1.621),  # manual 12.6.1
    mass=1523.0,  # data sheet of the Jeep Cherokee XJ
    wheel_base=2.576,  # data sheet
    track=1.473,  # data sheet
    tyre=(0.352, 0.215),  # data sheet: 215/75 R15
    unsprung=(25.0, 40.0),  # chosen, as all below
    floor=0.21,
    beltline=0.98,
    cog_height=0.58,
    front_weight_share=0.53,
    all_wheel=True,  # chosen; manual 12.6.1: two or four wheel drive
    max_acceleration=5.0,
    rgba=(0.85, 0.85, 0.9, 1.0),
    look=CarStyle(
        cowl=0.38,
        roof=(0.2, -0.88),
        deck=-0.97,
        nose=0.06,
        tuck=0.1,
        pillars=(0.0, -0.35, -0.62),
        grille=7,
        trim=(0.2, 0.2, 0.22, 1.0),
    ),
)
SNOWSTORM_ROOF = -_SNOWSTORM.origin
SNOWSTORM_SCANNER = (0.75, 0.0, SNOWSTORM_ROOF - 0.05)  # chosen: on the front edge of the roof
HALF_STEREO_BASELINE = 0.06  # half the distance of a Bumblebee's lenses (data sheet: 12 cm)
SNOWSTORM = build_car(
    _SNOWSTORM,
    solids=(sick_housing(SNOWSTORM_SCANNER),),
    looks=(
        *sick(SNOWSTORM_SCANNER),
        *(rod((0.3, y, SNOWSTORM_ROOF), (-1.7, y, SNOWSTORM_ROOF), 0.03, JET_BLACK) for y in (-0.55, 0.55)),
        rod((0.8, -0.62, SNOWSTORM_ROOF), (0.8, 0.62, SNOWSTORM_ROOF), 0.025, JET_BLACK),
        *lens((0.9, -HALF_STEREO_BASELINE, SNOWSTORM_ROOF + 0.1), 0.02),
        *lens((0.9, HALF_STEREO_BASELINE, SNOWSTORM_ROOF + 0.1), 0.02),
        drum(0.08, 0.03, (-0.8, 0.0, SNOWSTORM_ROOF - 0.02), SICK_YELLOW),  # the GPS
        block((0.5, _SNOWSTORM.dimensions[1] / 2 + 0.003, 0.08), (-0.1, 0.0, 0.12), (0.15, 0.3, 0.6, 1.0)),
    ),
    sensors=(
        # The range of an outdoor LMS (data sheet); the fan is the sensor's own.
        Mount(kind="RangeScanner3D", name="Scanner1", at=SNOWSTORM_SCANNER, defaults=options(MaxRange=80.0)),
        Mount(kind="GPS", name="GPS", at=(-0.8, 0.0, SNOWSTORM_ROOF)),
    ),
    cameras=tuple(
        camera(name, at=(0.9, y, SNOWSTORM_ROOF + 0.1), parent=CHASSIS)
        for name, y in (("Camera", -HALF_STEREO_BASELINE), ("Camera2", HALF_STEREO_BASELINE))
    ),
    sources=(
        ("dimensions, wheels", "manual 12.6"),
        ("GPS, stereo camera, 3D scanner", "manual 12.6"),
        ("mass, wheel base, track, wheel radius", "data sheet"),
        ("top speed, layout", "chosen"),
    ),
)

SEDAN = build_car(
    Car(
        name="Sedan",
        dimensions=(4.2779, 1.7883, 1.3238),  # manual 12.7.1
        mass=1250.0,  # data sheet of the Nissan Primera P10, about
        wheel_base=2.55,  # data sheet
        track=1.47,  # data sheet
        tyre=(0.2820, 0.195),  # manual 12.7.1; width data sheet
        unsprung=(18.0, 33.0),  # chosen, as all below
        floor=0.15,
        beltline=0.85,
        cog_height=0.50,
        front_weight_share=0.6,
        all_wheel=False,  # manual 12.7.1
        max_acceleration=3.5,
        rgba=(0.3, 0.4, 0.6, 1.0),
        look=CarStyle(cowl=0.45, roof=(0.12, -0.4), deck=-0.68, nose=0.16, tuck=0.14, pillars=(-0.12,)),
    ),
    sources=(
        ("dimensions, wheel radius, top speed, wheels", "manual 12.7"),
        ("mass, wheel base, track", "data sheet"),
        ("layout", "chosen"),
    ),
)

COOPER = build_car(
    Car(
        name="Cooper",
        dimensions=(3.626, 1.688, 1.416),  # data sheet of the Mini Cooper R50, as the next four
        mass=1146.0,
        wheel_base=2.467,
        track=1.46,
        tyre=(0.304, 0.175),  # 175/65 R15
        unsprung=(18.0, 33.0),  # chosen, as all below
        floor=0.15,
        beltline=0.90,
        cog_height=0.52,
        front_weight_share=0.6,
        all_wheel=False,  # manual 12.8.1
        max_acceleration=3.5,
        rgba=(0.7, 0.15, 0.15, 1.0),
        look=CarStyle(
            cowl=0.42,
            roof=(0.2, -0.78),
            deck=-0.96,
            nose=0.12,
            tuck=0.12,
            pillars=(-0.25,),
            lamps=True,
            trim=SILVER,
        ),
    ),
    looks=tuple(
        block((0.42, 0.1, 0.006), (1.05, y, -0.155), (0.95, 0.95, 0.93, 1.0), (0.0, -0.11, 0.0))
        for y in (-0.3, 0.3)
    ),  # stripes on its bonnet
    sources=(
        ("top speed, wheels", "manual 12.8"),
        ("dimensions, mass, wheel base, track, wheel radius", "data sheet"),
        ("layout", "chosen"),
    ),
)
