"""The layers of the page, by name."""

from usarmjx.base.registry import Registry
from usarmjx.view.layers.base import Layer

LAYERS: Registry[type[Layer]] = Registry("layer")
"""All layers, in the order of their switches."""
