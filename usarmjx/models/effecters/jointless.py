"""Effecters without moving parts: the RFID releaser and the headlight (manual 11.2, 11.5)."""

from dataclasses import dataclass
from typing import Annotated

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.settings import NOT_NEGATIVE
from usarmjx.models.effecters.base import EFFECTERS, NOP, RESET, Effect, Effecter, EffecterSettings, Opcode

TAGS_REMAINING = Opcode("TagsRemaining")

RELEASE = Opcode("Release")

ACTIVATE = Opcode("Activate", 1.0, 0.0, 1.0)


@dataclass(frozen=True)
class ReleaserSettings(EffecterSettings):
    """Manual 11.2.2.

    Attributes:
        num_tags: Number of tags at the start.
    """

    num_tags: Annotated[int, NOT_NEGATIVE] = 10


@dataclass(frozen=True)
class RfidReleaser(Effecter):
    """Drops RFID tags, one by one, on the ground below it."""

    kind = "RFIDReleaser"
    settings_class = ReleaserSettings

    @property
    def opcodes(self) -> tuple[Opcode, ...]:
        """Reset reloads (manual 8); the others are those of manual 11.2.1."""
        return (RELEASE, TAGS_REMAINING, RESET, NOP)

    @property
    def initial_stock(self) -> int:
        """Number of tags at the start."""
        return self.settings.num_tags

    def effect(self, opcode: Opcode, value: Array, stock: Array) -> Effect:
        """Return the effect; a release without tags left is impossible."""
        del value
        if opcode == RELEASE:
            return Effect(stock=stock - 1, drops=True, possible=stock > 0)
        if opcode == TAGS_REMAINING:
            return Effect(reply_number=stock)
        return Effect(stock=xp.full_like(stock, self.initial_stock) if opcode == RESET else None)


@dataclass(frozen=True)
class Headlight(Effecter):
    """Switches the robot's headlight, as DRIVE {Light} does (manual 11.5 makes it an effecter)."""

    kind = "Headlight"

    @property
    def opcodes(self) -> tuple[Opcode, ...]:
        """Activate with 1 or without a value is on, with 0 off; Reset and NOP are off."""
        return (ACTIVATE, RESET, NOP)

    def effect(self, opcode: Opcode, value: Array, stock: Array) -> Effect:
        """Return on for values above 0.5."""
        del stock
        return Effect(light=value > 0.5 if opcode == ACTIVATE else xp.zeros_like(value, bool))


for _effecter in (RfidReleaser, Headlight):
    EFFECTERS.add(_effecter.kind, _effecter)
