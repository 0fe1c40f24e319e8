"""Slip of skid-steered robots, as docs/robots.md lists it for each class."""

import pytest

import dev
from tests.rig import Rig, steady_spin
from usarmjx.models.drives import SkidSteer
from usarmjx.models.robots import ROBOTS

TOLERANCE, OF_HOPPING = 0.05, 0.15
"""Relative; the second of classes that slip by more than 2. Wheels hop in soft contacts: the last bit of a
torque changes a rate of some seconds by 4 % and a tenth."""
BELOW_THE_LIMIT = 0.3
"""Share of its top speed at which a P2DX turns slower than its controller allows."""
LIMITED = ("P2DX", "OmniP2DX")
NAMES = [name for name, spec in ROBOTS if isinstance(spec.drive, SkidSteer)]


def listed():
    """Slip by class in lower case, from the tables of the page with a column for it."""
    found, columns = {}, []
    for line in (dev.ROOT / "docs" / "robots.md").read_text("utf-8").splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")] if line.startswith("|") else []
        if not cells or cells[0] == "class":
            columns = cells
        elif "slip" in columns and (said := cells[columns.index("slip")].strip("-")):
            names, figures = cells[0].lower().split(", "), said.split(", ")
            found |= dict(zip(names, figures * (len(names) // len(figures)), strict=True))
    return {name: float(figure) for name, figure in found.items()}


def test_every_skid_steered_class_has_a_figure():
    assert set(listed()) == {name.lower() for name in NAMES}


@pytest.mark.every_run("Zerg", "UnitLoader", "Tarantula")
@pytest.mark.parametrize("name", NAMES)
def test_slip_is_as_listed(name):
    """The difference of both sides' speeds over the product of turning rate and WheelSeparation."""
    spec = ROBOTS.get(name)
    spin = spec.drive.max_spin * (BELOW_THE_LIMIT if name in LIMITED else 1.0)
    rates = [steady_spin(Rig(name).tell(Left=-one, Right=one), settle=3.0) / one for one in (spin, -spin)]
    slip = 2 * spec.wheel_radius / (spec.wheel_separation * sum(rates) / len(rates))
    said = listed()[name.lower()]
    assert slip == pytest.approx(said, rel=OF_HOPPING if said > 2 else TOLERANCE)
