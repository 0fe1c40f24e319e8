"""Objects that a world controller creates: boxes with the sizes of the later versions' classes.

    CONTROL {Type Create} {ClassName WCCrate11401} {Name box} {Location 1,2,-0.1} {Physics RigidBody}

The sizes are those in the names of the classes' meshes and in `boundary` of their files (USARPhysObj). The
public source does not state the sizes of the other classes.
"""

from dataclasses import dataclass

from usarmjx.base.errors import PeerError
from usarmjx.base.transforms import Vec3
from usarmjx.models.types.arena import LooseObject
from usarmjx.models.types.shapes import Shape
from usarmjx.server.protocol.grammar import clip

BASE_CLASS = "wcobject"
"""Class that all others extend, in lower case."""
SIZES: dict[str, Vec3] = {
    "WCCrate101223": (0.273, 0.204, 0.249),
    "WCCrate107227": (0.480, 0.288, 0.282),
    "WCCrate109533": (0.399, 0.129, 0.123),
    "WCCrate109775": (0.435, 0.288, 0.255),
    "WCCrate109785": (0.396, 0.132, 0.126),
    "WCCrate109786": (0.399, 0.132, 0.126),
    "WCCrate109788": (0.480, 0.321, 0.228),
    "WCCrate11204": (0.300, 0.210, 0.201),
    "WCCrate11210": (0.579, 0.261, 0.159),
    "WCCrate11252": (0.420, 0.330, 0.171),
    "WCCrate11254": (0.420, 0.330, 0.171),
    "WCCrate11292": (0.429, 0.330, 0.159),
    "WCCrate11293": (0.600, 0.159, 0.171),
    "WCCrate11343": (0.300, 0.210, 0.150),
    "WCCrate11346": (0.300, 0.210, 0.150),
    "WCCrate11350": (0.300, 0.210, 0.150),
    "WCCrate11365": (0.300, 0.210, 0.150),
    "WCCrate11401": (0.300, 0.210, 0.150),
    "WCCrate16788": (0.480, 0.288, 0.279),
    "WCCrate61696": (0.486, 0.243, 0.333),
    "WCCrate63340": (0.480, 0.321, 0.228),
    "WCCrate8729": (0.480, 0.318, 0.225),
    "WCCrate83797": (0.273, 0.132, 0.126),
    "WCCrate89710": (0.399, 0.198, 0.126),
    "WCPallet48x40": (1.220, 1.016, 0.100),
    "WCP3AT": (0.640, 0.512, 0.320),
}
"""Lengths of each class [m], origin in the middle. `boundary` of WCCrate109788 has a height of 0.248."""
MASS = 18.0
"""Mass of an object of any class, without a scale [kg]."""
MAX_OBJECTS = 64
"""Largest number of created objects in a world."""
SMALLEST, LARGEST = 0.01, 20.0
"""Smallest and largest length of an object [m]."""
FREE_PHYSICS = ("rigidbody", "falling", "ground")
"""Values of Physics, in lower case, with which an object falls; with others it hangs in its place."""
CARDBOARD = (0.72, 0.55, 0.36, 1.0)

_BY_LOWER_CASE = {name.lower(): size for name, size in SIZES.items()}


@dataclass(frozen=True)
class CreatedObject:
    """Class and permanence of a created object; its body is in the world.

    Attributes:
        class_name: Its class, in lower case.
        is_permanent: Whether it survives KillAll.
    """

    class_name: str
    is_permanent: bool = False

    def is_of(self, class_name: str) -> bool:
        """Return whether it is of a class, given in lower case, or of a class that extends that."""
        return class_name in ("", BASE_CLASS, self.class_name)


def class_of(name: str) -> str:
    """Return the name of a class without its package, in lower case."""
    return name.rpartition(".")[2].lower()


def make_object(class_name: str, name: str, at: Vec3, rotation: Vec3, scale: Vec3) -> LooseObject:
    """Return an object of a class.

    Args:
        class_name: The class, with or without its package, case ignored.
        name: Its name.
        at: Position of its middle, in the arena's axes [m].
        rotation: Roll, pitch and yaw in our axes [rad].
        scale: Factors of its lengths.

    Raises:
        PeerError: The class is not known, or the object is too small or too large.
    """
    if class_of(class_name) not in _BY_LOWER_CASE:
        known = ", ".join(SIZES)
        raise PeerError(f"no objects of class {clip(class_name)}; known: {known}")
    lengths = _BY_LOWER_CASE[class_of(class_name)]
    x, y, z = (length * factor for length, factor in zip(lengths, scale, strict=True))
    if not all(SMALLEST <= length <= LARGEST for length in (x, y, z)):
        raise PeerError(f"Scale makes a side shorter than {SMALLEST:g} m or longer than {LARGEST:g} m")
    # Equal density: the mass grows with the volume.
    mass = MASS * scale[0] * scale[1] * scale[2]
    half = (x / 2, y / 2, z / 2)
    box = Shape(kind="box", size=half, mass=mass, surface="loose", rgba=CARDBOARD)
    return LooseObject(name=name, at=at, rotation=rotation, shapes=(box,))
