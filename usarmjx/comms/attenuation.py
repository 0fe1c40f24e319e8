"""How strongly one radio hears another: the manual's Wall Attenuation Factor model (manual 3.2.4).

    P(d) [dBm] = P(d0) - 10 n log10(d / d0) - min(nW, C) WAF

with d the distance between the antennas and nW the number of solids between them (`comms.walls`).
The constants come from USARComServer.ini (manual 3.2.4.2), whose sections and keys are read here.
"""

import math
from dataclasses import dataclass
from pathlib import Path

from flax import struct

from usarmjx.base.arrays import Array
from usarmjx.base.backend import xp
from usarmjx.base.errors import SpecError
from usarmjx.models.ini.parse import IniFile, Line, read_ini
from usarmjx.models.ini.read import as_bool, as_number, fail

MIN_ANTENNA_DISTANCE = 1e-3
"""Antennas that are closer than this are taken to be this far apart [m]: the formula has no end at 0."""
MAX_PORT = 65535


@dataclass(frozen=True)
class RadioSettings:
    """Constants of the radio; the first eight are USARComServer.ini's (manual 3.2.4, 3.2.4.2).

    The defaults are the manual's, measured at International University Bremen; the manual names no
    port, 5874 is that of the later servers' ini. What follows `debug` is ours, and off by default.

    Attributes:
        listen_port: ListenPort: TCP port of the wireless server; 0 picks a free one.
        pdo: ePdo: power received at the distance `do` [dBm].
        do: eDo: the reference distance [m].
        n: eN: the log factor, how fast power falls with distance.
        cutoff: eCutoff: a link holds from this power on [dBm].
        max_obs: eMaxObs: no more than this many solids weaken a link (C in the formula).
        atten_fac: eAttenFac: what each of them takes (WAF in the formula) [dB].
        debug: bDebug: whether the wireless server logs what it does.
        period: Time between two evaluations of the links in a batch; 0: every control step [s].
        shadowing: Standard deviation of log-normal shadowing, drawn per pair and episode [dB].
        loss_band: Over so much power above the cutoff messages get lost, all of them at the cutoff and
            none at its upper end, in proportion between [dB].

    Raises:
        SpecError: A value that is not allowed; says what is.
    """

    listen_port: int = 5874
    pdo: float = -49.67
    do: float = 2.0
    n: float = 1.09
    cutoff: float = -93.0
    max_obs: int = 5
    atten_fac: float = 6.625
    debug: bool = False
    period: float = 0.0
    shadowing: float = 0.0
    loss_band: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what makes no sense."""
        for name in ("pdo", "do", "n", "cutoff", "atten_fac", "period", "shadowing", "loss_band"):
            _check(self, name, math.isfinite(getattr(self, name)), "a finite number")
        whole = all(isinstance(getattr(self, name), int) for name in ("listen_port", "max_obs"))
        _check(self, "listen_port", whole and 0 <= self.listen_port <= MAX_PORT, f"0 to {MAX_PORT}")
        _check(self, "max_obs", whole and self.max_obs >= 0, "a whole number from 0")
        _check(self, "do", self.do > 0, "a distance above 0")
        for name in ("n", "atten_fac", "period", "shadowing", "loss_band"):
            _check(self, name, getattr(self, name) >= 0, "a number from 0")


class WorldRadioSettings(struct.PyTreeNode, kw_only=True):
    """Constants of one world's radios where they differ between worlds: see `RadioSettings`.

    Attributes:
        pdo: Power received at the reference distance [dBm] ().
        do: Reference distance [m].
        n: How fast power falls with distance ().
        cutoff: A link holds from this power on [dBm] ().
        max_obs: So many solids count.
        atten_fac: What each solid takes [dB] ().
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
"""What the functions of links take."""


def _check(settings: RadioSettings, name: str, fits: bool, allowed: str) -> None:
    if not fits:
        raise SpecError(f"radio: {name} is {getattr(settings, name)}, allowed is {allowed}")


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
"""Sections and keys of USARComServer.ini and the settings they stand for (manual 3.2.4.2)."""


def radio_settings(source: Path | IniFile) -> RadioSettings:
    """Read USARComServer.ini; what it does not say keeps its default, other sections are not looked at.

    `debug` is on if any of the three sections has bDebug=True.

    Args:
        source: The file, or what was read of it.

    Raises:
        SpecError: The file cannot be read, a section has a key that it does not know, or a value is not
            allowed; names file, line and what is allowed.
    """
    file = source if isinstance(source, IniFile) else read_ini(source)
    values: dict[str, float | bool] = {}
    for section, keys in INI_KEYS.items():
        fields = {key.lower(): field for key, field in keys.items()}
        for line in file.section(section).lines:
            field = fields.get(line.key.lower())
            if field is None:
                fail(line, f"[{section}] has no key {line.key}", f"one of {', '.join(keys)}")
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
    if value != int(value):
        fail(line, f"{line.key} is {line.value}", "a whole number")
    return int(value)


def received_power(settings: AnyRadioSettings, distance: Array, walls: Array) -> Array:
    """Return the power that arrives [dBm], by the formula of manual 3.2.4.

    Below the reference distance the same formula goes on, so that power rises above `pdo`; under 1 mm it
    rises no more (`MIN_ANTENNA_DISTANCE`), so that two antennas in one place hear each other with a finite
    power. Differentiable in the distance, with slope 0 under 1 mm.

    Args:
        settings: The constants.
        distance: Between the antennas [m] (...).
        walls: How many solids lie between them (...).
    """
    apart = xp.maximum(xp.asarray(distance, xp.float32), MIN_ANTENNA_DISTANCE)
    fading = 10.0 * settings.n * xp.log10(apart / settings.do)
    return xp.asarray(settings.pdo - fading - xp.minimum(walls, settings.max_obs) * settings.atten_fac)


def link_range(settings: RadioSettings, walls: int) -> float:
    """Return the distance up to which a link behind that many solids holds [m]; infinite if n is 0."""
    margin = settings.pdo - min(walls, settings.max_obs) * settings.atten_fac - settings.cutoff
    if settings.n == 0:
        return math.inf if margin >= 0 else 0.0
    return settings.do * 10 ** (margin / (10 * settings.n))
