"""Glass, mirrors, grid fenders and the sky: what rays pass (manual 10.2, 10.3, 14.1.2)."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params

from usarmjx.models.compile.compose import materials_of, new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.ray_geoms import FENDER_KIND, ray_primitives_of
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import ArenaSpec, LooseObject, StartPose
from usarmjx.models.types.robot import Mount, options
from usarmjx.models.types.shapes import FENDER, GLASS, MATERIALS, MIRROR, OPAQUE, SKY, Shape
from usarmjx.sensors.base import SENSORS
from usarmjx.sensors.rays.kernels import BAR_WIDTH, GRID_PITCH, RAY_KERNELS
from usarmjx.sensors.rays.raycast import RayQuery, cast_rays
from usarmjx.sensors.rays.targets import Geoms, make_geoms
from usarmjx.server.worlds.dynamic_world import DynamicWorld

RANGE_ATOL = 1e-4  # m: float32 over a room, the raycaster's own tolerance
NOSE = (0.24, 0.0, 0.0)
PANE, WALL = 1.0, 2.0  # m: where the faces of a pane and of the wall behind it are
fender = jax.jit(RAY_KERNELS[FENDER_KIND])


def mount(kind: str, **keys: object) -> Mount:
    return Mount(kind=kind, name=kind, at=NOSE, options=options(Noise=0.0, **keys))


SEEING = replace(
    P2AT,
    name="Seeing",
    sensors=(
        mount("Sonar"),
        mount("IR"),
        mount("RangeScanner", MaxRange=20.0, Resolution=0.1, ScanFov=0.2, ScanInterval=0.1),
        mount("IRScanner", MaxRange=20.0, Resolution=0.1, ScanFov=0.3, ScanInterval=0.1),
    ),
)


@pytest.fixture(scope="module")
def bench(make_bench):
    return make_bench(SEEING)


def room(material: str) -> Geoms:
    """A wide pane of a material ahead, 2 cm thick, and an opaque wall behind it."""
    boxes = [((PANE + 0.01, 0, 1), (0.01, 9, 1)), ((WALL + 0.1, 0, 1), (0.1, 9, 1))]
    pos, size = (jnp.array([box[k] for box in boxes], jnp.float32) for k in (0, 1))
    kinds = np.full(2, mujoco.mjtGeom.mjGEOM_BOX)
    return make_geoms(kinds, pos, jnp.tile(jnp.eye(3), (2, 1, 1)), size, jnp.full(2, -1), [material, OPAQUE])


@pytest.mark.parametrize("kind", ["Sonar", "IR", "RangeScanner", "IRScanner"])
@pytest.mark.parametrize("material", [OPAQUE, GLASS, MIRROR, SKY])
def test_what_each_range_sensor_passes(bench, kind, material):
    """Infrared passes glass (manual 10.2.1, 10.3.1), sound and a laser do not; the sky is nothing to any."""
    reading = np.ravel(bench.once(kind, kind, geoms=room(material)))
    ahead = reading[{"RangeScanner": 1, "IRScanner": 1}.get(kind, 0)]
    passed = material == SKY or (material == GLASS and kind in ("IR", "IRScanner"))
    angle = 0.05 if kind == "IRScanner" else 0.0  # its 3 beams are at -0.15, -0.05 and 0.05 rad
    expected = ((WALL if passed else PANE) - NOSE[0]) / math.cos(angle)
    assert ahead == pytest.approx(expected, abs=RANGE_ATOL)


def test_of_range_sensors_only_infrared_passes_glass_and_everything_passes_the_sky():
    classes = dict(SENSORS)
    assert all(
        SKY in sensor.transparent and sensor.transparent <= set(MATERIALS) for sensor in classes.values()
    )
    ranging = ("Sonar", "IR", "RangeScanner", "IRScanner", "RangeScanner3D", "Touch")
    assert [kind for kind in ranging if GLASS in SENSORS.get(kind).transparent] == ["IR", "IRScanner"]


def operations(program) -> list[str]:
    """Names of all operations of a jaxpr, those within others too."""
    names = []
    for equation in program.eqns:
        names.append(equation.primitive.name)
        for inner in jaxprs_in_params(equation.params):
            names += operations(inner)
    return names


def test_passed_materials_cost_nothing():
    """They are left out while tracing: the program has as many operations as that of a room without them."""
    rays = jnp.zeros((4, 3)), jnp.ones((4, 3))

    def program(geoms: Geoms, passes: frozenset[str]) -> list[str]:
        traced = jax.make_jaxpr(lambda *a: cast_rays(geoms, *a, RayQuery(transparent=passes)))(*rays)
        return operations(traced.jaxpr)

    full = room(GLASS)
    bare = Geoms(blocks=full.blocks[1:], kinds=full.kinds[1:], materials=full.materials[1:])
    assert full.materials == (GLASS, OPAQUE)
    assert program(full, frozenset({GLASS})) == program(bare, frozenset())
    assert program(full, frozenset()) != program(bare, frozenset())


HALF = np.array([0.01, 1.0, 0.5])


def at_fender(origins: np.ndarray, directions: np.ndarray, size: np.ndarray = HALF) -> np.ndarray:
    sizes = np.tile(size, (len(origins), 1))
    return np.asarray(fender(*(jnp.asarray(a.T, jnp.float32) for a in (origins, directions, sizes))))


@pytest.mark.parametrize("slanted", [False, True])
def test_the_share_of_rays_that_pass_is_that_of_the_holes(slanted):
    """Holes are (1 - bar / pitch)^2 of whole meshes; 5 standard deviations of so many draws."""
    n, rng = 20_000, np.random.default_rng(0)
    hole = (1 - BAR_WIDTH / GRID_PITCH) ** 2
    assert hole == pytest.approx(0.64)
    points = np.stack([np.full(n, -HALF[0]), rng.uniform(-1, 1, n), rng.uniform(-0.5, 0.5, n)], -1)
    directions = np.tile([1.0, 0.0, 0.0], (n, 1))
    if slanted:
        directions += np.concatenate([np.zeros((n, 1)), rng.uniform(-0.8, 0.8, (n, 2))], -1)
        directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    distance = at_fender(points - directions, directions)
    assert np.isinf(distance).mean() == pytest.approx(hole, abs=5 * math.sqrt(hole * (1 - hole) / n))
    np.testing.assert_allclose(distance[np.isfinite(distance)], 1.0, atol=RANGE_ATOL)


@pytest.mark.parametrize(
    ("y", "z", "passes"),
    [
        (0.025, 0.025, True),  # the middle of a hole
        (0.0, 0.025, False),  # a bar on end, through the middle of the face
        (0.025, 0.0, False),  # a level one
        (0.006, 0.044, True),  # 5 mm is half a bar: just beside both
        (0.004, 0.025, False),
        (0.046, 0.025, False),
        (-0.975, 0.475, True),
        (-0.951, 0.475, False),  # the bar at 0.95 m
    ],
)
def test_the_place_on_the_face_decides(y, z, passes):
    ahead, back = np.array([[1.0, 0, 0]]), np.array([[-1.0, 0, 0]])
    assert np.isinf(at_fender(np.array([[-2.0, y, z]]), ahead))[0] == passes
    assert np.isinf(at_fender(np.array([[2.0, y, z]]), back))[0] == passes
    # From inside, where it leaves.
    assert np.isinf(at_fender(np.array([[0.0, y, z]]), ahead))[0] == passes


def test_a_ray_that_enters_by_a_hole_passes_the_bars_behind():
    """It enters at y = 0.03 and would leave, 2 cm further, at y = 0.05, where there is a bar."""
    way = np.array([[1.0, 1.0, 0.0]]) / math.sqrt(2)
    start = np.array([[-0.01, 0.03, 0.02]]) - way
    assert np.isinf(at_fender(start, way))[0]
    assert at_fender(np.array([[-0.01, 0.05, 0.02]]) - way, way)[0] == pytest.approx(1.0, abs=RANGE_ATOL)


def test_narrow_sides_have_no_holes():
    """A panel of 2 cm seen from its side: nowhere is there room for a hole."""
    rng = np.random.default_rng(1)
    points = np.stack([rng.uniform(-0.01, 0.01, 200), np.full(200, -2.0), rng.uniform(-0.5, 0.5, 200)], -1)
    np.testing.assert_allclose(at_fender(points, np.tile([0.0, 1, 0], (200, 1))), 1.0, atol=RANGE_ATOL)


def test_rays_beside_a_fender_miss_it():
    points = np.array([[-1.0, 1.1, 0.0], [-1.0, 0.0, 0.6], [1.0, 0.0, 0.0]])
    assert np.isinf(at_fender(points, np.tile([1.0, 0, 0], (3, 1)))).all()


def test_the_same_ray_always_meets_the_same():
    rng = np.random.default_rng(2)
    points = np.stack([np.full(500, -2.0), rng.uniform(-1, 1, 500), rng.uniform(-0.5, 0.5, 500)], -1)
    ahead = np.tile([1.0, 0, 0], (500, 1))
    first = at_fender(points, ahead)
    np.testing.assert_array_equal(at_fender(points, ahead), first)
    order = rng.permutation(500)
    np.testing.assert_array_equal(at_fender(points[order], ahead), first[order])


PANES = ArenaSpec(
    name="panes",
    shapes=(
        Shape(kind="box", size=(0.01, 2, 1), at=(PANE + 0.01, 0, 1), material=GLASS, surface="wall"),
        Shape(kind="box", size=(0.1, 2, 1), at=(WALL + 0.1, 0, 1), surface="wall"),
        Shape(kind="box", size=(0.01, 2, 1), at=(-1.0, 0, 1), material=FENDER, surface="wall"),
        Shape(kind="box", size=(9, 9, 0.1), at=(0, 0, -5), material=SKY),
    ),
    loose=(
        LooseObject(
            name="tumbler",
            at=(0, 3, 0.1),
            shapes=(Shape(kind="box", size=(0.1, 0.1, 0.1), mass=1.0, material=GLASS, surface="loose"),),
        ),
    ),
    starts=(StartPose(tag="S", at=(0, 0, 0.188)),),
    extent=((-3, 3), (-3, 3)),
)


def test_materials_come_from_the_description_by_name():
    model = new_spec(PANES, Physics()).compile()
    found = dict(
        zip([model.geom(i).name for i in range(model.ngeom)], materials_of(model, PANES), strict=True)
    )
    assert found == {
        "floor": OPAQUE,
        "arena/0": GLASS,
        "arena/1": OPAQUE,
        "arena/2": FENDER,
        "arena/3": SKY,
        "loose/tumbler/0": GLASS,
    }
    pieces = ray_primitives_of(model, np.arange(model.ngeom), materials_of(model, PANES))
    assert (pieces.kind == FENDER_KIND).tolist() == [name == "arena/2" for name in found]


def test_a_served_robot_sees_through_glass_with_infrared_only():
    """Casts are shared by all sensors there: those that pass glass and the others are told apart."""
    world = DynamicWorld(PANES, Physics(), 0)
    two = replace(SEEING, name="SeeingTwice", sensors=SEEING.sensors[1:3])
    robot = world.spawn(two, "R", (0.0, 0.0, 0.3), (0.0, 0.0, 0.0))
    world.observe([robot])
    read = {kind: np.ravel(robot.pending[robot.suite.index(kind)]) for kind in ("IR", "RangeScanner")}
    assert read["IR"][0] == pytest.approx(WALL - NOSE[0], abs=RANGE_ATOL)
    assert read["RangeScanner"][1] == pytest.approx(PANE - NOSE[0], abs=RANGE_ATOL)
