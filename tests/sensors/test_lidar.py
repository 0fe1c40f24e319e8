"""A lidar against closed forms: a wall's ranges and intensities, echoes that are too weak, and dropouts."""

import math
from dataclasses import replace

import numpy as np
import pytest

from usarmjx.base import random
from usarmjx.base.backend import numpy_backend
from usarmjx.base.clock import clock_at
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.base import SensorInput
from usarmjx.sensors.rays.raycast import Hits
from usarmjx.sensors.suite import suite_of
from usarmjx.server.gamebots.sensors import configuration, sensor_report
from usarmjx.server.protocol.grammar import format_message

SMALL = {"VerticalFOV": 0.4, "VerticalResolution": 0.1, "HorizontalFOV": 1.6, "HorizontalResolution": 0.1}
ROWS, COLUMNS = 5, 17


def suite(**keys):
    mount = Mount(kind="Lidar", name="Top", options=options(**SMALL | keys))
    return suite_of(replace(P2AT, name="With lidar", sensors=(mount,)))


def scan(suite, distance, cosine, seed=0):
    """What it makes of hits (beams,)."""
    hits = Hits(distance=np.asarray(distance, np.float32), cosine=np.asarray(cosine, np.float32))
    with numpy_backend():
        inputs = SensorInput(clock=clock_at(0.0, 0.02), state=None, bodies=None, hits=hits)
        return suite.sensors[0].read(inputs, (), random.key(seed))[1]


def before_a_wall(suite, far):
    """Distances and cosines of its beams to a wall that it faces, by trigonometry."""
    down, left = np.meshgrid(-0.2 + 0.1 * np.arange(ROWS), -0.8 + 0.1 * np.arange(COLUMNS), indexing="ij")
    cosine = (np.cos(down) * np.cos(left)).ravel()
    return far / cosine, cosine


def test_intensities_are_reflectance_times_cosine_whatever_the_distance():
    own = suite(Reflectance=0.8)
    for far in (2.0, 20.0):
        ranges, echoes = scan(own, *before_a_wall(own, far))
        distance, cosine = before_a_wall(own, far)
        np.testing.assert_allclose(ranges, distance.reshape(ROWS, COLUMNS), rtol=1e-6)
        np.testing.assert_allclose(echoes, 0.8 * cosine.reshape(ROWS, COLUMNS), rtol=1e-6)


def test_its_rays_meet_the_wall_that_a_batch_casts_them_at(make_bench, make_arena):
    """The angles of incidence are asked for and come in the order of the beams."""
    bench = make_bench(replace(P2AT, name="Lidar bench", sensors=(
        Mount(kind="Lidar", name="Top", at=(0.0, 0.0, -3.0), options=options(**SMALL)),
    )))  # fmt: skip
    wall = ((5.5, 0.0, 3.0), (0.5, 60.0, 30.0), 0.0)
    ranges, echoes = bench.once("Lidar", "Top", at=(0.0, 0.0, 3.0), geoms=make_arena(boxes=[wall]))
    distance, cosine = before_a_wall(bench.suite, 5.0)
    np.testing.assert_allclose(ranges, distance.reshape(ROWS, COLUMNS), rtol=1e-5)
    np.testing.assert_allclose(echoes, 0.5 * cosine.reshape(ROWS, COLUMNS), rtol=1e-4)


@pytest.mark.parametrize(
    ("distance", "degrees"), [(30.0, 0.0), (60.0, 0.0), (30.0, 75.0), (30.0, 80.0), (0.2, 80.0)]
)
def test_an_echo_is_lost_when_too_little_comes_back(distance, degrees):
    """0.5 cos / d^2 against MinPower 1e-4: at 30 m up to 79.6 degrees from the normal, at most 70.7 m."""
    cosine = math.cos(math.radians(degrees))
    ranges, echoes = scan(
        suite(MinPower=1e-4), np.full(ROWS * COLUMNS, distance), np.full(ROWS * COLUMNS, cosine)
    )
    if 0.5 * cosine / max(distance, 1.0) ** 2 >= 1e-4:
        np.testing.assert_allclose(ranges, distance)
        np.testing.assert_allclose(echoes, 0.5 * cosine, rtol=1e-6)
    else:
        assert (ranges == 100.0).all()
        assert (echoes == 0.0).all()


def test_nothing_met_and_dropouts_are_max_range_with_no_intensity():
    ranges, echoes = scan(suite(), np.full(ROWS * COLUMNS, np.inf), np.zeros(ROWS * COLUMNS))
    assert (ranges == 100.0).all()
    assert (echoes == 0.0).all()
    own, share, draws = suite(Dropout=0.2, Noise=0.1, IntensityNoise=0.05), 0.2, 40
    told = np.array([scan(own, *before_a_wall(own, 4.0), seed=seed) for seed in range(draws)])
    lost = told[:, 0] == 100.0
    np.testing.assert_array_equal(lost, told[:, 1] == 0.0)
    # 3400 beams: the share is good to its deviation, sqrt(p (1 - p) / n); four times that.
    assert lost.mean() == pytest.approx(share, abs=4 * math.sqrt(share * (1 - share) / lost.size))
    assert lost.any((1, 2)).mean() > 0
    assert len({tuple(row.ravel()) for row in lost}) == draws, "others each time"
    distance, cosine = before_a_wall(own, 4.0)
    error = (told[:, 1] / (0.5 * cosine.reshape(ROWS, COLUMNS)) - 1)[~lost]
    assert error.std() == pytest.approx(0.05, rel=4 / math.sqrt(2 * error.size))
    away = (told[:, 0] / distance.reshape(ROWS, COLUMNS) - 1)[~lost]
    assert np.abs(away).max() <= 0.1001
    assert np.abs(away).max() > 0.09


def test_a_client_hears_ranges_and_intensities_row_by_row():
    tiny = {"VerticalFOV": 0.2, "VerticalResolution": 0.2, "HorizontalFOV": 0.5, "HorizontalResolution": 0.5}
    own = suite(**tiny)
    value = np.array([[[4.0, 4.1], [1.5, 100.0]], [[0.48, 0.46], [0.21, 0.0]]], np.float32)
    assert format_message(sensor_report(own.sensors[0], value, 62.01)) == (
        "SEN {Time 62.01} {Type Lidar} {Name Top} {Resolution 0.2000,0.5000} {FOV 0.2000,0.5000} "
        "{Range 4.0000,4.1000,1.5000,100.0000} {Intensity 0.4800,0.4600,0.2100,0.0000}"
    )
    (conf,) = configuration(own.plan.robot, own.sensors, [1.0] * len(P2AT.cameras), "Lidar", "")
    assert format_message(conf) == (
        "CONF {Type Lidar} {Name Top} {MaxRange 100.0000} {MinRange 0.1000} "
        "{Resolution 0.2000,0.5000} {FOV 0.2000,0.5000}"
    )
