"""Received radio power: the Wall Attenuation Factor model (manual 3.2.4), and its settings.

    P(d) [dBm] = P(d0) - 10 n log10(d / d0) - min(nW, C) WAF

d is the distance between the antennas and nW the number of solids between them (`comms.walls`). The constants
come from USARComServer.ini (manual 3.2.4.2), whose sections and keys are read here.
"""

import logging
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from flax import struct

from usarmjx.base.backend import Array, xp
from usarmjx.base.errors import SpecError
from usarmjx.base.settings import NOT_NEGATIVE, Setting, validate
from usarmjx.models.ini.parse import IniFile, Line, as_bool, as_number, fail, read_ini

logger = logging.getLogger(__name__)

MIN_ANTENNA_DISTANCE = 1e-3
"""Lower bound of the distance between two antennas [m]: the formula diverges at 0."""
MAX_PORT = 65535
"""Highest TCP port."""
COM_SERVER, COM_CONNECTION, COM_LINK = (
    f"USARBotAPI.{part}" for part in ("ComServer", "ComConnection", "ComLink")
)
INI_KEYS = {
    COM_SERVER: {"ListenPort": "listen_port", "bDebug": "debug"},
    COM_CONNECTION: {
        "ePdo": "pdo",
        "eDo": "do",
        "eN": "n",
        "eCutoff": "cutoff",
        "eMaxObs": "max_obs",
        "eAttenFac": "atten_fac",
        "bDebug": "debug",
    },
    COM_LINK: {"bDebug": "debug"},
}
"""Sections and keys of USARComServer.ini, and their fields (manual 3.2.4.2)."""


@dataclass(frozen=True)
class RadioSettings:
    """Radio constants; the first eight are USARComServer.ini's (manual 3.2.4, 3.2.4.2).

    The defaults are the manual's, measured at International University Bremen; the manual names no port, and
    5874 is that of the later servers' ini. The fields after `debug` are extensions, off by default.

    Attributes:
        listen_port: TCP port of the wireless server; 0 picks a free one.
        pdo: Power received at the distance `do` [dBm].
        do: Reference distance [m].
        n: Path loss exponent (log factor): how fast power falls with distance.
        cutoff: Power from which on a link holds [dBm].
        max_obs: Most solids that weaken a link (C in the formula).
        atten_fac: Loss through each solid (WAF in the formula) [dB].
        debug: Let the wireless server log its work.
        period: Time between two evaluations of the links in a batch; 0: every control step [s].
        shadowing: Standard deviation of log-normal shadowing, drawn per pair and episode [dB].
        loss_band: Power above the cutoff within which messages get lost: all of them at the cutoff, none at
            the band's upper end, in proportion between [dB].

    Raises:
        SpecError: A value is not allowed; names the allowed ones.
    """

    listen_port: Annotated[int, Setting(ge=0, le=MAX_PORT, manual_key="ListenPort")] = 5874
    pdo: Annotated[float, Setting(manual_key="ePdo")] = -49.67
    do: Annotated[float, Setting(gt=0, manual_key="eDo")] = 2.0
    n: Annotated[float, Setting(ge=0, manual_key="eN")] = 1.09
    cutoff: Annotated[float, Setting(manual_key="eCutoff")] = -93.0
    max_obs: Annotated[int, Setting(ge=0, manual_key="eMaxObs")] = 5
    atten_fac: Annotated[float, Setting(ge=0, manual_key="eAttenFac")] = 6.625
    debug: Annotated[bool, Setting(manual_key="bDebug")] = False
    period: Annotated[float, NOT_NEGATIVE] = 0.0
    shadowing: Annotated[float, NOT_NEGATIVE] = 0.0
    loss_band: Annotated[float, NOT_NEGATIVE] = 0.0

    def __post_init__(self) -> None:
        """Check the settings."""
        validate(self)


class WorldRadioSettings(struct.PyTreeNode, kw_only=True):
    """Radio constants that differ between worlds; see `RadioSettings`.

    Attributes:
        pdo: Power received at the reference distance [dBm] ().
        do: Reference distance [m].
        n: Path loss exponent ().
        cutoff: Lowest power at which a link holds [dBm] ().
        max_obs: Largest number of solids that count.
        atten_fac: Attenuation of each solid [dB] ().
        shadowing: As in `RadioSettings`.
        loss_band: As in `RadioSettings`.
    """

    pdo: Array
    do: float = struct.field(pytree_node=False)
    n: Array
    cutoff: Array
    max_obs: int = struct.field(pytree_node=False)
    atten_fac: Array
    shadowing: float = struct.field(pytree_node=False)
    loss_band: float = struct.field(pytree_node=False)


AnyRadioSettings = RadioSettings | WorldRadioSettings
"""Settings that the link functions accept."""


def radio_settings(source: Path | IniFile) -> RadioSettings:
    """Read USARComServer.ini; missing keys keep their defaults; a warning names other sections.

    `debug` is on if any of the three sections has bDebug=True.

    Args:
        source: The file, or its parsed content.

    Raises:
        SpecError: The file cannot be read, a section has an unknown key, or a value is not allowed; names
            file, line and allowed values.
    """
    file = source if isinstance(source, IniFile) else read_ini(source)
    known = {section.lower() for section in INI_KEYS}
    for section in file.sections:
        if section.lines and section.name.lower() not in known:
            line = section.lines[0]
            names = ", ".join(INI_KEYS)
            logger.warning(
                "%s:%d: [%s] is not of the radio; read are %s", line.file, line.line, section.name, names
            )
    values: dict[str, float | bool] = {}
    for section, keys in INI_KEYS.items():
        fields = {key.lower(): field for key, field in keys.items()}
        for line in file.section(section).lines:
            field = fields.get(line.key.lower())
            if field is None:
                fail(line, f"[{section}] has no key {line.key}", f"one of {', '.join(keys)}")
            # The debug switches of all three sections are one setting: any of them turns it on.
            values[field] = _read(line, field, values.get("debug", False))
    try:
        return RadioSettings(**values)  # type: ignore - each value was read as its field's kind
    except SpecError as error:
        raise SpecError(f"{file.path}: {error}") from error


def _read(line: Line, field: str, debug: object) -> float | bool:
    if field == "debug":
        return as_bool(line, line.value, line.key) or bool(debug)
    value = as_number(line, line.value, line.key)
    if field not in ("listen_port", "max_obs"):
        return value
    # The ini has numbers without a type: 5874.0 is a whole one.
    if value != int(value):
        fail(line, f"{line.key} is {line.value}", "a whole number")
    return int(value)


def received_power(settings: AnyRadioSettings, distance: Array, walls: Array) -> Array:
    """Return the received power [dBm] by the formula of manual 3.2.4.

    Below the reference distance the same formula applies, so that power rises above `pdo`; below 1 mm it is
    constant (`MIN_ANTENNA_DISTANCE`), so that coincident antennas receive a finite power. Differentiable in
    the distance, with slope 0 below 1 mm.

    Args:
        settings: The constants.
        distance: Distance between the antennas [m] (...).
        walls: Number of solids between them (...).
    """
    # maximum also makes the gradient 0, not infinite, at coincident antennas.
    apart = xp.maximum(xp.asarray(distance, xp.float32), MIN_ANTENNA_DISTANCE)
    fading = 10.0 * settings.n * xp.log10(apart / settings.do)
    return xp.asarray(settings.pdo - fading - xp.minimum(walls, settings.max_obs) * settings.atten_fac)


def link_range(settings: RadioSettings, walls: int) -> float:
    """Return the largest distance at which a link behind `walls` solids holds [m]; infinite if n is 0."""
    margin = settings.pdo - min(walls, settings.max_obs) * settings.atten_fac - settings.cutoff
    # Power does not fall with distance: the link holds everywhere or nowhere.
    if settings.n == 0:
        return math.inf if margin >= 0 else 0.0
    # The formula of manual 3.2.4, solved for the distance.
    return settings.do * 10 ** (margin / (10 * settings.n))
