"""What a sweep's file may say, which cells it stands for, and what is said of one that is wrong."""

import numpy as np
import pytest
import yaml

from usarmjx.base.errors import UnknownNameError, UsageError
from usarmjx.sweeps import play
from usarmjx.sweeps.resolve import base_task, resolve, signature_of
from usarmjx.sweeps.spec import BUNDLED, find_spec, load_spec, read_spec
from usarmjx.train.tasks.team import PERFECT_RADIO
from usarmjx.train.tasks.victim_search import VictimSearch


def cells(**given):
    return read_spec({"common": {"task": "explore-v1"}, **given}).cells


def test_lists_products_and_samples_are_all_combined():
    found = cells(
        list=[{"roster": {"P2AT": 2}}, {"roster": {"P2AT": 4}, "policy": "packaged"}],
        product={"arena": {"level": [0.4, 0.8]}, "seed": [0, 1, 2]},
        sample={"count": 5, "ranges": {"radio.cutoff": [-60.0, -40.0]}},
    )
    assert len(found) == 2 * 2 * 3 * 5
    assert {(cell["policy"], cell["roster"]["P2AT"]) for cell in found} == {("baseline", 2), ("packaged", 4)}
    assert {cell["arena.level"] for cell in found} == {0.4, 0.8}
    assert len({cell["radio.cutoff"] for cell in found}) == 5


@pytest.mark.parametrize("method", ["latin-hypercube", "random"])
def test_samples_lie_in_their_ranges_and_a_latin_hypercube_has_one_in_each_slice(method):
    sample = {"count": 40, "method": method, "seed": 3, "ranges": {"radio.n": [1.0, 3.0], "seed": [5, 8]}}
    found = cells(sample=sample)
    exponents = np.array([cell["radio.n"] for cell in found])
    assert ((exponents >= 1) & (exponents <= 3)).all()
    slices = np.sort(((exponents - 1) / 2 * 40).astype(int))
    assert (slices == np.arange(40)).all() == (method == "latin-hypercube")
    assert {cell["seed"] for cell in found} == {5, 6, 7, 8}, "both ends of whole numbers are among them"
    assert found == cells(sample=sample)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"produkt": {}}, "no setting 'produkt'; did you mean 'product'"),
        ({"product": {"radio.power": [1]}}, "no setting 'radio.power'; radio has: pdo, do, n, cutoff"),
        ({"product": {"speed": [1]}}, "no setting 'speed'; known: task, policy, episodes"),
        ({"product": {"seed": 3}}, "product: seed is 3, expected a list of values"),
        ({"common": {"task": "explore-v1", "episodes": 0}}, "episodes is 0, expected a whole number from 1"),
        ({"common": {}}, "a cell: task is nothing, expected a text"),
        (
            {"sample": {"count": 3, "method": "sobol", "ranges": {"seed": [0, 1]}}},
            "sample: method is 'sobol', expected one of latin-hypercube, random",
        ),
        (
            {"sample": {"count": 3, "ranges": {"radio.n": [3, 1]}}},
            r"radio.n is \[3, 1\], expected two numbers",
        ),
        ({"list": [{"seed": 1}], "product": {"seed": [1]}}, "seed is in two of list, product and sample"),
        (
            {"common": {"task": "explore-v1", "arena": {"level": 1}, "arena.level": 2}},
            "common has arena.level twice",
        ),
        ({"worlds": 0}, "worlds is 0, expected a whole number from 1"),
    ],
)
def test_what_is_wrong_is_named_with_what_is_allowed(given, said):
    with pytest.raises(UsageError, match=said):
        cells(**given)


def test_a_file_that_does_not_read_is_one_line(tmp_path):
    file = tmp_path / "bad.yaml"
    file.write_text("common:\n  task: [explore-v1\n")
    with pytest.raises(UsageError, match=r"bad.yaml:3: is no YAML") as caught:
        load_spec(file)
    assert "\n" not in str(caught.value)
    with pytest.raises(UnknownNameError, match="no bundled sweep; those are: robustness, teams, thousand"):
        find_spec("nonsense")


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"arena.kind": "cave"}, "arena.kind is 'cave', expected one of building"),
        ({"arena": "yellow", "arena.level": 0.5}, "not of generated arenas"),
        ({"arena.level": "high"}, "arena: level is 'high', expected a number from 0 to 1"),
        ({"radio.cutoff": "low"}, "radio.cutoff is 'low', expected a number"),
        ({"vary.friction": [1.5, 0.5]}, "friction is"),
        ({"vary.radio_cutoff": 3, "radio.cutoff": 4}, "radio.cutoff and vary.radio_cutoff are both given"),
        ({"roster": {"P2AT": 2, "Zerg": 1}}, "takes robots of one class"),
        ({"roster": {"P2AT": 0}}, "expected classes and their numbers"),
        ({"task": "victim-search-v1", "vary.latency": [0, 5]}, "latency does not go with ComStation"),
        ({"fields.velocity": 3}, "has no setting 'velocity'; it has"),
        ({"fields.price": "dear"}, "fields: price is 'dear', expected a number"),
        ({"policy": {"runs": "x"}}, "expected baseline, packaged, random, frontier, .*, a run's folder"),
        ({"policy": "nowhere.npz"}, "nowhere.npz is no folder of a run"),
        ({"policy": {"client": "x", "speed": 0}}, "speed is 0"),
        ({"task": "convoy", "policy": "packaged"}, "no policy for convoy comes with the package"),
    ],
)
def test_settings_that_stand_for_nothing_are_named(settings, said):
    (cell,) = read_spec({"common": {"task": "explore-v1", "episodes": 2, **settings}}).cells
    with pytest.raises(UsageError, match=said):
        resolve(cell)


def resolved(**settings):
    (cell,) = read_spec({"common": {"task": "explore-v1", "episodes": 2, **settings}}).cells
    return resolve(cell)


def test_rosters_become_the_teams_of_tasks():
    assert resolved(roster={"Zerg": 3}).task.count == 3
    search = resolved(task="victim-search-v1", roster={"P2AT": 2, "kenaf": 1, "AirRobot": 1}).task
    assert isinstance(search, VictimSearch)
    assert (search.wheeled, search.tracked, search.flying) == (("P2AT",) * 2, ("kenaf",), ("AirRobot",))


@pytest.mark.parametrize("policy", ["oracle", {"baseline": "oracle"}])
def test_an_oracle_knows_the_building_and_hears_all_whatever_the_radio_of_its_cell(policy):
    said = {"radio.cutoff": -43.0, "vary.radio_n": [1.5, 2.5], "roster": {"P2AT": 2}, "episodes": 1}
    said |= {"fields.byte_rate": 64, "fields.talk": "base"}
    found, other = (
        resolve(read_spec({"common": {"task": "explore-v3", "policy": one, **said}}).cells[0])
        for one in (policy, "frontier")
    )
    assert (found.task.oracle, found.task.radio, found.ranges) == (True, PERFECT_RADIO, {})
    assert (found.task.count, found.labels) == (2, other.labels)
    assert (found.task.byte_rate, found.task.talk) == (None, "all")
    assert (other.task.oracle, other.task.byte_rate, other.task.talk) == (False, 64, "base")
    assert other.ranges == {"radio_cutoff": (-43.0, -43.0), "radio_n": (1.5, 2.5)}
    with pytest.raises(UsageError, match="only tasks whose robots choose goals have an oracle"):
        resolve(cells(common={"task": "explore-v2", "policy": policy})[0])


def test_episodes_go_through_the_levels_in_turn():
    many = resolved(episodes=6)
    assert len(many.arenas) == 6
    walls = [len(arena.shapes) for arena in many.arenas]
    assert walls[0] < walls[2]
    assert walls[3] < walls[5]
    assert many.arena_of(7) == many.arenas[1]
    assert (many.levels, many.strata) == (3, 3)
    assert resolved(episodes=5).strata == 1, "a level has less than two buildings"


def test_a_size_goes_before_the_sizes_of_the_task():
    def lengths(**said):
        return {arena.extent[0][1] for arena in resolved(task="explore-v2", episodes=9, **said).arenas}

    assert len(lengths()) == 3
    assert lengths(**{"arena.size": [5, 4]}) == {6.0}


def test_data_share_a_signature_and_what_is_compiled_in_does_not():
    def differs(**other):
        one, two = (resolved(**{"arena.level": 0.4, "split": "fresh", **own}) for own in ({}, other))
        mine, theirs = signature_of(one, "c"), signature_of(two, "c")
        return {name for name in mine if mine[name] != theirs[name]}

    assert differs(**{"arena.level": 0.9, "arena.seed": 4, "seed": 3}) == set()
    assert differs(roster={"P2AT": 3}) == {"team and fields of the task"}
    assert differs(physics="fast") == {"physics"}
    assert differs(policy="packaged") == {"policy"}
    assert differs(**{"arena.size": [9, 8]}) == {"arena"}
    said = {"radio.cutoff": -49.0, "vary.friction": [0.5, 1.5]}
    one, two = resolved(**said), resolved(**{"radio.cutoff": -60.0, "vary.friction": 1.0})
    assert signature_of(one, "c") == signature_of(two, "c")
    assert one.ranges == {"friction": (0.5, 1.5), "radio_cutoff": (-49.0, -49.0)}
    assert signature_of(resolved(**{"vary.latency": [0, 3]}), "c") != signature_of(
        resolved(**{"vary.latency": [0, 4]}), "c"
    )


def test_cells_that_differ_in_other_settings_share_their_base(monkeypatch):
    made = []
    monkeypatch.setattr(play, "base_task", lambda settings: made.append(settings) or base_task(settings))
    play.forget_resolved()
    axes = {"physics.timestep": [0.002, 0.004], "seed": [0, 1], "fields.haste": [0.5, 0.6]}
    found = cells(product=axes)
    assert [play.resolved(cell).task for cell in found] == [resolve(cell).task for cell in found]
    assert sorted(one["fields.haste"] for one in made) == [0.5, 0.6]
    play.forget_resolved()


@pytest.mark.parametrize("file", sorted(BUNDLED.glob("*.yaml")), ids=lambda file: file.stem)
def test_bundled_sweeps_stand_for_something(file):
    spec = load_spec(file, {"episodes": 1})
    assert spec.about
    assert len(spec.cells) == {"teams": 99, "robustness": 108, "thousand": 1000}[file.stem]
    assert len(yaml.safe_load(file.read_text())["common"]) >= 1
    shapes = {}
    for cell in (spec.cells[0], spec.cells[-1]):
        shapes[repr(signature_of(resolve(cell), "c"))] = cell
    assert len(shapes) == (1 if file.stem == "thousand" else 2)
    for cell in spec.cells:
        assert resolve(cell).settings is cell, "no setting is refused"
