"""Identity of buildings, and whether a policy was trained in them: by seed and by contents."""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from usarmjx.models.types.arena import ArenaSpec
from usarmjx.train.envs.recipe import GENERATED, TRAIN, GeneratedArenas, generator_seed, split_of

HASH_LENGTH = 12
"""Hexadecimal digits of a building's hash: 48 bits, so two of 10^4 share one by chance once in 5 million."""


def building_hash(arena: ArenaSpec) -> str:
    """Return a hash of an arena's contents: walls, victims, starts, all but its name and description."""
    # Names carry the seed and the level: two buildings with other names may have the same walls.
    text = repr(replace(arena, name="", about=""))
    return hashlib.sha256(text.encode()).hexdigest()[:HASH_LENGTH]


def building_label(arena: ArenaSpec) -> str:
    """Return the name of an arena and the hash of its contents, as `DM-building-10x8-7@0123456789ab`."""
    return f"{arena.name}@{building_hash(arena)}"


@dataclass(frozen=True, kw_only=True)
class Overlap:
    """Buildings that a policy was trained in, among those that it plays.

    Attributes:
        count: Buildings that it plays.
        seeds: Those from a seed of its training. Walls of one seed at two levels are nested.
        identical: Those with the same contents as one of its training.
        stream: Those of split `train`, from which a training that replaces its buildings draws; 0 if it
            keeps them.
    """

    count: int
    seeds: int
    identical: int
    stream: int

    def note(self, name: str) -> str:
        """Return a warning in a line; empty if the policy has seen none of the buildings.

        Args:
            name: Name of the policy.
        """
        if self.identical or self.seeds:
            found = f"{self.identical} of {self.count} buildings are those of its training"
            others = self.seeds - self.identical
            found += f", {others} more have a seed of its training" if others > 0 else ""
        elif self.stream:
            found = (
                f"{self.stream} of {self.count} buildings are of split train, from which its training draws"
            )
        else:
            return ""
        return f"{name}: {found}; scores of policies count on split test"


def overlap(trained: Sequence[str], played: Sequence[str], *, renewed: bool = False) -> Overlap:
    """Return which of the buildings that a policy plays it was trained in.

    Args:
        trained: Labels of the buildings of its training, see `building_label`.
        played: Labels of the buildings that it plays.
        renewed: Whether its training replaces its buildings by others of split `train`.
    """
    # Without None: arenas that were not generated have no seed, and would all count as trained in.
    seeds = {seed for label in trained if (seed := seed_of(label)) is not None}
    # From the right: a hash has no @, a name may have one.
    contents = {label.rpartition("@")[2] for label in trained}
    return Overlap(
        count=len(played),
        seeds=sum(seed_of(label) in seeds for label in played),
        identical=sum(label.rpartition("@")[2] in contents for label in played),
        # A training that keeps its buildings has seen no other ones of the split.
        stream=sum(split_of(_name(label)) == TRAIN for label in played) if renewed else 0,
    )


def _name(label: str) -> str:
    return label.rpartition("@")[0]


def seed_of(label: str) -> int | None:
    """Return the seed that the building of a label was generated from; None: it was not generated."""
    return generator_seed(_name(label))


def training_note(name: str, recipe: object, played: Iterable[str]) -> str:
    """Return a warning if a policy plays buildings of its training, in a line; empty if it plays none.

    Args:
        name: Name of the policy.
        recipe: Arenas of its training; anything but generated ones has no splits, and no warning.
        played: Labels of the buildings that it plays, see `building_label`; each counts once.
    """
    if not isinstance(recipe, GeneratedArenas):
        return ""
    # A dictionary keeps the order, so the same buildings always give the same note.
    there = list(dict.fromkeys(played))
    # Only buildings of one kind and size can be the same: others need no building of the training.
    forms = {_form(recipe.kind, size) for size in (*getattr(recipe, "sizes", ()), recipe.size)}
    alike = [label for label in there if _name(label).rpartition("-")[0].lower() in forms]
    if not alike:
        return ""
    found = overlap(_labels(recipe), alike, renewed=recipe.renewable)
    # Only buildings of a like form were compared, but the warning speaks of all that are played.
    return replace(found, count=len(there)).note(name)


def _form(kind: str, size: tuple[int, int]) -> str:
    """Return how names of arenas of a kind and size begin."""
    return f"{GENERATED}{kind}-{size[0]}x{size[1]}".lower()


# It generates the whole library of a training.
@lru_cache(maxsize=8)
def _labels(recipe: GeneratedArenas) -> tuple[str, ...]:
    return tuple(map(building_label, recipe.arenas()))
