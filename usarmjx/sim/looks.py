"""How what is in a scene looks to cameras: the geoms of its model in their order, and its figures."""

from typing import Any

import numpy as np

from usarmjx.cameras.paint import (
    ROBOT_LABEL,
    GeomAppearance,
    bone_labels,
    labels_of,
    reflectances,
    transparencies,
)
from usarmjx.engines.c_figures import WornFigure
from usarmjx.engines.c_sight import Looks
from usarmjx.models.build.compose_arena import VICTIM_PREFIX
from usarmjx.models.build.materials import materials_of, textures_of
from usarmjx.models.build.victim_looks import victim_figure
from usarmjx.models.spec.textures import names_of
from usarmjx.sensors.rays.targets import GeomBlock
from usarmjx.sim.scene import Scene
from usarmjx.sim.visible import visible_water


def looks_of(scene: Scene) -> Looks:
    """Return how all geoms of a scene's model look, its water, and the figures of robots and victims."""
    model, water = scene.model, visible_water(scene)
    materials, label = materials_of(model, scene.arena), labels_of(model, scene.arena)
    figures = [*_robots(scene), *_victims(scene)]
    rgb = np.concatenate([np.zeros((0, 3)), *(one.figure.model.geom_rgba[:, :3] for one in figures)])
    worn = np.repeat([one.label for one in figures], [one.figure.model.ngeom for one in figures])
    plain = np.zeros(len(rgb), np.float32)
    made_of = np.array(materials, object)
    appearance = GeomAppearance(
        rgb=np.concatenate([model.geom_rgba[:, :3], np.asarray(water.rgb), rgb]).astype(np.float32),
        transparency=np.concatenate([transparencies(made_of), water.transparency, plain]),
        reflectance=np.concatenate([reflectances(np.concatenate([made_of, water.material])), plain]),
        label=np.concatenate([label, np.asarray(water.label), worn]).astype(np.int32),
        **_textures(scene, len(water.rgb) + len(rgb)),
    )
    replaced = np.zeros(model.ngeom, bool)
    for one in figures:
        replaced |= np.isin(np.arange(model.ngeom) if one.of_geoms else model.geom_bodyid, one.frames)
    boxes = GeomBlock(pos=water.pos, mat=water.mat, size=water.size, owner=water.owner)
    return Looks(appearance, materials, boxes, figures, np.flatnonzero(replaced))


def _textures(scene: Scene, others: int) -> dict[str, Any]:
    """Return what is on the model's geoms, and nothing on so many others, as fields of `GeomAppearance`."""
    code = np.concatenate([textures_of(scene.model, scene.arena), np.zeros(others, np.int32)])
    return {"texture": code, "textures": names_of(code)} if code.any() else {}


def _robots(scene: Scene) -> list[WornFigure]:
    return [
        WornFigure(group.plan.figure, np.array(index.body_ids), False, ROBOT_LABEL + int(slot), int(slot))
        for group in scene.groups
        for slot, index in zip(group.slots, group.indices, strict=True)
    ]


def _victims(scene: Scene) -> list[WornFigure]:
    """Return the figures of the victims, and of the false alarms."""
    table, found = scene.victims, list[WornFigure]()
    for owner in np.unique(table.owner).tolist():
        boxes = np.flatnonzero(table.owner == owner)
        geoms = np.array([scene.model.geom(f"{VICTIM_PREFIX}{box}").id for box in boxes])
        label = int(bone_labels(np.array(owner)))
        found.append(WornFigure(victim_figure(table, owner), geoms, True, label))
    return found
