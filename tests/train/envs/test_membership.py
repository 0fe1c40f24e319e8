"""Buildings of a policy's training among those that it plays, by seed and by contents."""

from dataclasses import replace

import numpy as np
import pytest

from usarmjx.sweeps.resolve import resolve
from usarmjx.sweeps.spec import read_spec
from usarmjx.train.envs.membership import building_label, seed_of, training_note
from usarmjx.train.envs.recipe import SPLITS, GeneratedArenas, split_of
from usarmjx.train.make import make_task

TINY = GeneratedArenas(kind="maze", count=6, levels=(0.0, 1.0), size=(3, 3))


def labels(recipe):
    return [building_label(arena) for arena in recipe.arenas()]


def test_a_label_is_the_name_and_the_contents_of_a_building():
    first, other = TINY.arenas()[:2]
    renamed = replace(first, name="DM-maze-3x3-7", about="another")
    assert building_label(first).partition("@")[2] == building_label(renamed).partition("@")[2]
    assert building_label(first).partition("@")[2] != building_label(other).partition("@")[2]
    assert seed_of(building_label(renamed)) == 7
    assert seed_of(building_label(replace(first, name="yellow"))) is None


def test_every_seed_belongs_to_one_split():
    for name, split in SPLITS:
        seeds = split.seeds(3, 50)
        assert {split_of(f"DM-maze-3x3-{seed}") for seed in seeds} == {name}
        assert ((seeds >= split.start) & (seeds < split.end)).all()
    assert split_of("DM-Floor") is None
    again = SPLITS.get("fresh").seeds(3, 50)
    np.testing.assert_array_equal(again, SPLITS.get("fresh").seeds(3, 50))
    assert not set(again) & set(SPLITS.get("fresh").seeds(4, 50))


def test_buildings_of_the_training_are_named_and_those_of_test_are_not():
    note = training_note("mine", TINY, labels(TINY))
    assert (
        note == "mine: 12 of 12 buildings are those of its training; scores of policies count on split test"
    )
    test = replace(TINY, size=(4, 3)).of_split("test")
    assert training_note("mine", TINY, [building_label(test.arena(0, test.seeds()[0]))]) == ""
    assert training_note("mine", "yellow", labels(TINY)) == "", "it has no splits"
    # Buildings of one seed are nested: the same walls, and more of them.
    harder = replace(TINY, levels=(0.4, 0.9))
    assert "12 more have a seed of its training" in training_note("mine", TINY, labels(harder))


def test_a_building_with_another_seed_and_the_same_contents_is_found():
    first = TINY.arenas()[0]
    copy = building_label(replace(first, name="DM-maze-3x3-4000001000"))
    assert "1 of 1 buildings are those of its training" in training_note("mine", TINY, [copy])


def test_a_training_that_replaces_its_buildings_draws_from_all_of_train():
    others = labels(replace(TINY, seed=5))
    assert training_note("mine", TINY, others) == ""
    renewable = replace(TINY, renewable=True)
    assert "12 of 12 buildings are of split train" in training_note("mine", renewable, others)


@pytest.fixture(scope="module")
def trained():
    """The buildings in which the packaged policy of explore-v1 learned, by contents."""
    return {building_label(arena).partition("@")[2] for arena in make_task("explore-v1").arenas.arenas()}


@pytest.mark.parametrize(("split", "identical"), [(None, 0), ("train", 16), ("validation", 0), ("fresh", 0)])
def test_cells_of_a_sweep_play_held_out_buildings_unless_told(split, identical, trained):
    """At level 0.4 with seed 0, 16 of the 20 buildings of split train are those of the training."""
    given = {} if split is None else {"split": split}
    common = {"task": "explore-v1", "policy": "packaged", "arena.level": 0.4, **given}
    (cell,) = read_spec({"common": common}).cells
    found = resolve(cell)
    assert found.split == (split or "test")
    assert sum(label.partition("@")[2] in trained for label in found.buildings) == identical
    assert {split_of(label.partition("@")[0]) for label in found.buildings} == {found.split}
    assert bool(found.training_note) == (split == "train")
    if split == "train":
        expected = "packaged policy of explore-v1: 16 of 20 buildings are those of its training"
        assert expected in found.training_note
