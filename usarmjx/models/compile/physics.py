"""Solver and time settings of a scene, and the presets of the commands."""

from dataclasses import dataclass
from typing import Annotated, Literal

import mujoco

from usarmjx.base.registry import Registry
from usarmjx.base.settings import AT_LEAST_ONE, NOT_NEGATIVE, POSITIVE, validate

CONES = {"elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC, "pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL}
"""MuJoCo's friction cones by name."""


SOLVERS = {
    "auto": mujoco.mjtSolver.mjSOL_CG,
    "CG": mujoco.mjtSolver.mjSOL_CG,
    "Newton": mujoco.mjtSolver.mjSOL_NEWTON,
    "block": mujoco.mjtSolver.mjSOL_NEWTON,
}
"""MuJoCo's constraint solvers by name; `block` is our own of engine `warp`, and Newton elsewhere. `auto` is
`block` on engine `warp` with a GPU, and CG elsewhere."""

SLEEP_TOLERANCE = 0.005
"""Speed below which a loose object sleeps, in settings by name [m/s]."""


@dataclass(frozen=True)
class Physics:
    """Solver and time settings of a scene.

    The elliptic cone with friction impedance ratio 2 lets robots turn in place as rigid wheels do and
    hold slopes; on CPUs CG is as fast as Newton for few robots, far faster for many, and free of the batched
    Cholesky factorisation. docs/design.md tables the measurements.

    Attributes:
        timestep: Physics step [s].
        substeps: Physics steps per control step.
        iterations: Most iterations of the solver.
        ls_iterations: Most iterations of the line search.
        cone: Friction cone of the contacts.
        solver: MuJoCo's constraint solver. `block`, on engine `warp`: Newton's method for each group of
            robots and objects that touch each other, until it has converged; elsewhere Newton. `auto`:
            `block` on engine `warp` with a GPU for scenes that it covers, else CG.
        contacts_per_robot: Capacity of contact buffers per robot like the P2AT, on average over a world's
            robots; other robots count in proportion to their touching geoms.
        pairs_per_robot: Geom pairs of one kind that engine `jax` examines, likewise; the nearest by bounding
            spheres.
        sleep_tolerance: Speed below which a loose object sleeps on engine `warp` [m/s]: after half a second
            it has no contacts until something comes near. 0: none sleeps, as on the other engines.
    """

    timestep: Annotated[float, POSITIVE] = 0.005
    substeps: Annotated[int, AT_LEAST_ONE] = 4
    impratio: Annotated[float, POSITIVE] = 2.0
    iterations: Annotated[int, AT_LEAST_ONE] = 10
    ls_iterations: Annotated[int, AT_LEAST_ONE] = 10
    cone: Literal["elliptic", "pyramidal"] = "elliptic"
    solver: Literal["auto", "CG", "Newton", "block"] = "auto"
    contacts_per_robot: Annotated[int, AT_LEAST_ONE] = 16
    pairs_per_robot: Annotated[int, AT_LEAST_ONE] = 32
    sleep_tolerance: Annotated[float, NOT_NEGATIVE] = 0.0

    def __post_init__(self) -> None:
        """Check the settings.

        Raises:
            SpecError: A value that is not allowed; names the allowed ones.
        """
        validate(self)

    @property
    def period(self) -> float:
        """Control step [s]."""
        return self.timestep * self.substeps

    @property
    def rows_per_contact(self) -> int:
        """Constraint rows of a contact with sliding friction."""
        # MuJoCo's elliptic cone has a normal row and two tangential ones, the pyramidal one two for each
        # tangent.
        return 3 if self.cone == "elliptic" else 4

    @classmethod
    def fast(cls) -> "Physics":
        """Return settings for training and sweeps: several times as fast, and less exact.

        On `warp`, loose objects sleep as with `sleeping`.

        docs/evidence/physics-settings.md has the search for them, and docs/evidence/speed.md the behaviour of
        every robot class under them.
        """
        return cls(timestep=0.01, substeps=2, iterations=8, ls_iterations=5, sleep_tolerance=SLEEP_TOLERANCE)

    @classmethod
    def coarse(cls) -> "Physics":
        """Return settings for engine `planar` alone, which takes a control step of 50 ms in one step."""
        return cls(timestep=0.05, substeps=1)

    @classmethod
    def sleeping(cls) -> "Physics":
        """Return the reference settings, except that untouched loose objects sleep on `warp`."""
        return cls(sleep_tolerance=SLEEP_TOLERANCE)


PHYSICS: Registry[Physics] = Registry("physics")
"""Physics settings by name."""
PHYSICS.add("reference", Physics())
PHYSICS.add("fast", Physics.fast())
PHYSICS.add("coarse", Physics.coarse())
PHYSICS.add("sleeping", Physics.sleeping())
