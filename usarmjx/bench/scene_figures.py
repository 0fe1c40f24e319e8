"""What a scene gives the solver to do, and what went wrong in its worlds: figures beside a rate."""

from typing import Any

import jax
import numpy as np

from usarmjx.sim.batch import Batch
from usarmjx.sim.batch_state import BatchState
from usarmjx.sim.scene import Scene


def spread_over_worlds(values: np.ndarray) -> dict[str, float]:
    """Return mean, 95th percentile and largest of numbers."""
    return {
        "mean": float(values.mean()),
        "p95": float(np.quantile(values, 0.95)),
        "most": float(values.max()),
    }


class SceneFigures:
    """Looks at a batch now and then, and says what its scene is.

    Args:
        batch: The batch.
    """

    def __init__(self, batch: Batch) -> None:
        self._batch = batch
        self._seen: dict[str, list[np.ndarray]] = {}

    def look(self, state: BatchState) -> None:
        """Take note of what the engine tells of the last physics step of all worlds."""
        solved = self._batch.engine.solved(state.physics)
        for name, values in {} if solved is None else solved._asdict().items():
            if values is not None:
                self._seen.setdefault(name, []).append(np.asarray(values, float))

    def result(self, state: BatchState) -> dict[str, Any]:
        """Return the scene's sizes, what the solver met, and how many worlds went bad."""
        faults = jax.tree.map(np.asarray, vars(state.worlds.faults))
        bad = faults["not_finite"] + faults["runaway"] > 0
        told = {name: None for name in ("contacts", "constraint_rows", "solver_iterations")}
        told |= {name: spread_over_worlds(np.concatenate(rows)) for name, rows in self._seen.items()}
        return {
            **sizes(self._batch.scene),
            **told,
            "overflow": int((faults["overflow"] > 0).sum()),
            "bad_worlds": int(bad.sum()),
        }


def sizes(scene: Scene) -> dict[str, int]:
    """Return how large a scene's model is."""
    model = scene.model
    touching = (model.geom_contype | model.geom_conaffinity) != 0
    return {
        "robots": scene.num_robots,
        "geoms": int(model.ngeom),
        "touching_geoms": int(touching.sum()),
        "bodies": int(model.nbody),
        "degrees_of_freedom": int(model.nv),
    }
