"""How the geoms of a scene's model look to cameras, in the model's order."""

import numpy as np

from usarmjx.cameras.paint import ROBOT_LABEL, GeomAppearance, labels_of, reflectances, transparencies
from usarmjx.engines.c_sight import Looks
from usarmjx.models.build.materials import materials_of
from usarmjx.sensors.rays.targets import GeomBlock
from usarmjx.sim.scene import Scene
from usarmjx.sim.visible import visible_water


def looks_of(scene: Scene) -> Looks:
    """Return how all geoms of a scene's model look, and its water."""
    model, water = scene.model, visible_water(scene)
    materials, label = materials_of(model, scene.arena), labels_of(model, scene.arena)
    for group in scene.groups:
        for slot, index in zip(group.slots, group.indices, strict=True):
            label[np.isin(model.geom_bodyid, index.body_ids)] = ROBOT_LABEL + slot
    made_of = np.array(materials, object)
    appearance = GeomAppearance(
        rgb=np.concatenate([model.geom_rgba[:, :3], np.asarray(water.rgb)]).astype(np.float32),
        transparency=np.concatenate([transparencies(made_of), water.transparency]),
        reflectance=reflectances(np.concatenate([made_of, water.material])),
        label=np.concatenate([label, np.asarray(water.label)]).astype(np.int32),
    )
    boxes = GeomBlock(pos=water.pos, mat=water.mat, size=water.size, owner=water.owner)
    return Looks(appearance=appearance, materials=materials, water=boxes)
