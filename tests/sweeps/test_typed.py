"""Settings of sweeps that are typed: read by their declarations, and kept as the data of files."""

import json

import pytest

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.base.settings import parse_assignments
from usarmjx.sweeps.resolve import typed_settings

TASKS = ["drive-to-goal"]


@pytest.mark.parametrize(
    ("pair", "name", "data"),
    [
        ("radius=1e-3", "fields.radius", 0.001),
        ("fields.radius=1", "fields.radius", 1),
        ("fields.shuffle=on", "fields.shuffle", True),
        ("ranges=IR", "fields.ranges", ["IR"]),
        ("episodes=5", "episodes", 5),
        ("policy={run: runs/x}", "policy", {"run": "runs/x"}),
        ("roster={P2AT: 2}", "roster", {"P2AT": 2}),
        ("physics=fast", "physics", "fast"),
        ("physics.timestep=1e-2", "physics.timestep", 0.01),
        ("arena.level=4e-1", "arena.level", 0.4),
        ("arena.level=1", "arena.level", 1),
        ("arena.size=[5, 4]", "arena.size", [5, 4]),
        ("vary.friction=0.5", "vary.friction", 0.5),
        ("vary.friction=[0.5, 15e-1]", "vary.friction", [0.5, 1.5]),
        ("radio.cutoff=-49", "radio.cutoff", -49),
    ],
)
def test_texts_become_the_data_of_files(pair, name, data):
    """As JSON, of which the key of a cell's result is a hash: 1 stays 1."""
    found = typed_settings(parse_assignments([pair]), TASKS)
    assert json.dumps(found) == json.dumps({name: data})


@pytest.mark.parametrize(
    ("pair", "words"),
    [
        ("radius=nan", "radius is 'nan', expected a number above 0"),
        ("radius=.nan", "radius is nan, expected a number above 0"),
        ("radius=-1", "radius is -1, expected a number above 0"),
        ("fields.haste=inf", "haste is 'inf', expected a number"),
        ("episodes=0", "episodes is 0, expected a whole number from 1"),
        ("episodes=many", "episodes is 'many', expected a whole number from 1"),
        ("episodes=2001-99-99", "episodes is '2001-99-99', expected a whole number from 1"),
        ("episodes=" + "9" * 5000, "episodes is '9+"),
        ("arena.level=2", "level is 2, expected a number from 0 to 1"),
        ("vary.friction=-1", "friction.* is -1, expected a number above 0"),
        ("radio.cutoff=low", "cutoff is 'low', expected a number"),
        ("physics.cone=round", "cone is 'round', expected one of elliptic, pyramidal"),
    ],
)
def test_texts_that_are_no_values_are_refused(pair, words):
    with pytest.raises(UsageError, match=rf"^--set: .*{words}"):
        typed_settings(parse_assignments([pair]), TASKS)


def test_unknown_names_list_settings_and_fields():
    with pytest.raises(UnknownNameError, match=r"no setting 'speed'; they have: task, .*radius"):
        typed_settings(parse_assignments(["speed=1"]), TASKS)
    with pytest.raises(UnknownNameError, match=r"'radio.power'; radio has: pdo, do"):
        typed_settings(parse_assignments(["radio.power=1"]), TASKS)
