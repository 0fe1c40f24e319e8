"""Layers of the page, by name: overlays of a world that can be shown and hidden.

A layer gets a drawing and then one frame after the other; `base` has the interface and the nodes of viser,
`bodies` the poses of sensors. To add one, write a `NodeLayer` and list it here.
"""

from usarmjx.base.registry import Registry
from usarmjx.view.layers.base import Layer
from usarmjx.view.layers.bodies import CameraLayer, SensorBodyLayer
from usarmjx.view.layers.echoes import InfraredLayer, LaserLayer, SonarLayer
from usarmjx.view.layers.light import HeadlightLayer, LampLayer, SkyLayer
from usarmjx.view.layers.maps import MapLayer
from usarmjx.view.layers.marks import (
    GridLayer,
    NameLayer,
    RfidLayer,
    RingLayer,
    TagLayer,
    TrailLayer,
    VictimHitLayer,
)
from usarmjx.view.layers.radio import RadioLayer

LAYERS: Registry[type[Layer]] = Registry("layer")
"""All layers; their switches stand in the order of their names."""

for _layer in (
    *(SkyLayer, GridLayer, NameLayer, RingLayer, TrailLayer),
    *(LaserLayer, SonarLayer, InfraredLayer, RfidLayer, VictimHitLayer, TagLayer),
    *(RadioLayer, MapLayer, CameraLayer, SensorBodyLayer, LampLayer, HeadlightLayer),
):
    LAYERS.add(_layer.name, _layer)
