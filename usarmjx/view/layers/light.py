"""Light of a world: sun and sky, lamps, and the robots' headlights."""

import math

import numpy as np
import viser

from usarmjx.sensors.cameras.shading import (
    HEADLIGHT_BRIGHTNESS,
    SPOT_INNER_ANGLE,
    SPOT_OUTER_ANGLE,
    SUN_DIRECTION,
)
from usarmjx.view.drawing import Drawing, Frame
from usarmjx.view.layers.base import LineNode, NodeLayer, PointNode
from usarmjx.view.layers.bodies import mount_poses

WHITE_CANDELA = math.pi
"""Intensity of a point light in three.js that makes a white wall a metre away white."""
SUN_RGB, SUN_INTENSITY, INDOOR_SUN_INTENSITY = (255, 236, 206), 2.6, 1.3
"""Colour of the sun, and its intensity outdoors and indoors: rooms have no roofs, and shadows need a sun."""
WIDEST_SPOT, SPOT_HEIGHT, SPOT_MARGIN = 16.0, 4.0, 4.0
"""Sun as a spotlight: largest radius of the arena [m], distance in radii, and margin around the arena [m]."""
SKY_RGB, GROUND_RGB, SKY_INTENSITY, INDOOR_SKY_INTENSITY = (226, 232, 255), (255, 206, 178), 2.4, 1.9
ZENITH, HORIZON, HAZE = (126, 168, 214), (226, 230, 228), (214, 204, 188)
"""Colours of the background: at the top, halfway, and below."""
MOST_LAMPS, MOST_HEADLIGHTS, MOST_SHADOWS = 8, 8, 2
"""Most lamps and headlights that light the page, and most headlights with shadows.

Each takes time in the browser for every drawn surface.
"""
HEADLIGHT_REACH = 15.0
"""Range of headlights [m]."""
BULB_RADIUS, BULB_RGB = 0.08, (255, 246, 214)
BEAM_LENGTH = 2.5
"""Length of the lines along a headlight's cone [m]."""
BEAM_RGB = (255, 226, 120)


class SkyLayer(NodeLayer):
    """The sun with its shadows, light from the sky, and the background.

    An arena with lamps gets less of it, where no other world is shown beside it.
    """

    name = "Light"
    about = "warm sunlight with shadows, and a sky; without it all is lit evenly"
    shown_at_first = True

    def __init__(self) -> None:
        super().__init__()
        self._key: tuple[object, ...] = ()

    def begin(self, scene: viser.SceneApi, drawing: Drawing, prefix: str) -> None:
        """Start with a new drawing; if only robots have joined or left, the light stays."""
        lamps = np.asarray(drawing.lamp_rgb).tobytes()
        # By contents: each drawing is a new object, although its light is the same.
        key = id(scene), prefix, np.asarray(drawing.extent).tobytes(), drawing.floor, lamps, self.alone
        if self._top is None or key != self._key:
            super().begin(scene, drawing, prefix)
        self._key = key

    def draw(self, drawing: Drawing) -> None:
        """Light the arena."""
        low, high = np.asarray(drawing.extent, float).T
        self._middle = np.array([*(low + high) / 2, drawing.floor])
        # The circle around the arena's rectangle.
        self._radius = float(np.linalg.norm(high - low)) / 2 + SPOT_MARGIN
        self._indoors = self.alone and bool((np.asarray(drawing.lamp_rgb) > 0).any())
        if self._on:
            self._shine()

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Do nothing: the light is constant."""
        del drawing, frame

    def show(self, on: bool) -> None:
        """Switch between this light and viser's even default."""
        if self._top is not None and on != self._on:
            (self._shine if on else self._dim)()
        super().show(on)

    def end(self) -> None:
        """Restore viser's even light."""
        if self._top is not None and self._on:
            self._dim()
        super().end()

    def _shine(self) -> None:
        indoors = self._indoors
        # Viser's lights come on top of ours, and all would be white.
        self.scene.configure_default_lights(enabled=False)
        # An environment map comes late: a browser would compile all shaders anew and filter the map.
        # Without a graphics card that takes ten seconds and more.
        self.scene.configure_environment_map(None)
        self.scene.set_background_image(backdrop(ZENITH, HORIZON, HAZE), format="png")
        self.scene.add_light_hemisphere(
            f"{self.root}/sky",
            sky_color=SKY_RGB,
            ground_color=GROUND_RGB,
            intensity=INDOOR_SKY_INTENSITY if indoors else SKY_INTENSITY,
        )
        self._add_sun(INDOOR_SUN_INTENSITY if indoors else SUN_INTENSITY)

    def _add_sun(self, intensity: float) -> None:
        """Add the sun; over a small arena without neighbours it is a spotlight.

        The browser draws shadows of directional light near the camera only, and of a spotlight everywhere,
        but those are coarse if it is far away.
        """
        name, way = f"{self.root}/sun", np.array(SUN_DIRECTION) / np.linalg.norm(SUN_DIRECTION)
        if self._radius > WIDEST_SPOT or not self.alone:
            self.scene.add_light_directional(
                name, color=SUN_RGB, intensity=intensity, cast_shadow=True, position=SUN_DIRECTION
            )
            return
        x, y, z = (self._middle + SPOT_HEIGHT * self._radius * way).tolist()
        ahead, left, up = (-way).tolist()
        self.scene.add_light_spot(
            name,
            color=SUN_RGB,
            intensity=intensity,
            # The half angle of a circle of the arena's radius, seen from `SPOT_HEIGHT` radii away.
            angle=math.atan(1 / SPOT_HEIGHT),
            # Sunlight is as strong at the far side of the arena as at the near one.
            decay=0.0,
            cast_shadow=True,
            position=(x, y, z),
            direction=(ahead, left, up),
        )

    def _dim(self) -> None:
        for name in ("sky", "sun"):
            self.scene.remove_by_name(f"{self.root}/{name}")
        self.scene.configure_default_lights(enabled=True, cast_shadow=False)
        # Viser's own default.
        self.scene.configure_environment_map("warehouse")
        self.scene.set_background_image(None)


def backdrop(zenith: tuple[int, ...], horizon: tuple[int, ...], haze: tuple[int, ...]) -> np.ndarray:
    """Return a picture that blends from one colour at the top over a second to a third (height, 8, 3)."""
    height = 256
    down = np.linspace(0.0, 1.0, height)
    stops = (0.0, 0.55, 1.0)
    rgb = [np.interp(down, stops, channel) for channel in zip(zenith, horizon, haze, strict=True)]
    return np.repeat(np.stack(rgb, -1)[:, None], 8, 1).round().astype(np.uint8)


class LampLayer(NodeLayer):
    """The arena's lamps."""

    name = "Lamps"
    about = "the arena's lamps, and their light where no other world stands beside it"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Draw bulbs, and lights of the brightest."""
        rgb = np.asarray(drawing.lamp_rgb, float).reshape(-1, 3)
        pos = np.asarray(drawing.lamps, float).reshape(-1, 3)
        there = (rgb > 0).any(-1)
        rgb, pos = rgb[there], pos[there]
        PointNode(self.scene, f"{self.root}/bulbs", BULB_RADIUS).set(pos, np.tile(BULB_RGB, (len(pos), 1)))
        brightness = rgb.max(-1)
        if not self.alone:  # the neighbours' lamps would be dark: then none shines
            return
        # The brightest first, as each light takes time for every surface.
        for lamp in np.argsort(-brightness, kind="stable")[:MOST_LAMPS].tolist():
            # The colour is at full scale and the intensity has the brightness: 8 bits would clip a lamp
            # brighter than 1.
            red, green, blue = (255 * rgb[lamp] / brightness[lamp]).astype(int).tolist()
            self.scene.add_light_point(
                f"{self.root}/lamp{lamp}",
                color=(red, green, blue),
                intensity=WHITE_CANDELA * float(brightness[lamp]),
                position=tuple(pos[lamp].tolist()),
            )

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Do nothing: lamps are constant."""
        del drawing, frame


class HeadlightLayer(NodeLayer):
    """Headlights that are on."""

    name = "Headlights"
    about = "the headlights that are on: their light, and lines that show their cones"
    shown_at_first = True

    def draw(self, drawing: Drawing) -> None:
        """Prepare the nodes."""
        del drawing
        self._spots: list[viser.SpotLightHandle] = []
        self._beams = LineNode(self.scene, f"{self.root}/beams", width=1.5)

    def update(self, drawing: Drawing, frame: Frame) -> None:
        """Show the lights of the headlights that are on."""
        mounts = [
            light
            for slot, robot in frame.robots.items()
            if robot.light and (light := drawing.robots[slot].headlight) is not None
        ]
        poses = [mount_poses(frame, mount) for mount in mounts]
        self._beams.set(
            np.concatenate([np.zeros((0, 2, 3)), *(_edges(pos[0], mat[0]) for pos, mat in poses)]),
            np.array(BEAM_RGB),
        )
        for number, (pos, mat) in enumerate(poses[:MOST_HEADLIGHTS]):
            if number == len(self._spots):
                self._spots.append(self._spot(number))
            self._spots[number].position = pos[0]
            x, y, z = mat[0, :, 0].tolist()
            self._spots[number].direction = (x, y, z)
        for number, spot in enumerate(self._spots):
            spot.visible = number < len(poses)

    def _spot(self, number: int) -> viser.SpotLightHandle:
        return self.scene.add_light_spot(
            f"{self.root}/spot{number}",
            color=(255, 244, 214),
            intensity=WHITE_CANDELA * HEADLIGHT_BRIGHTNESS * 2,
            angle=SPOT_OUTER_ANGLE,
            # Of three.js: the share of the angle over which the light fades out at the rim.
            penumbra=1 - SPOT_INNER_ANGLE / SPOT_OUTER_ANGLE,
            distance=HEADLIGHT_REACH,
            cast_shadow=number < MOST_SHADOWS,
        )


def _edges(pos: np.ndarray, mat: np.ndarray) -> np.ndarray:
    """Return four lines along a headlight's cone (4, 2, 3)."""
    around = math.pi / 4 + math.pi / 2 * np.arange(4)
    out = math.sin(SPOT_INNER_ANGLE)
    ways = np.stack([np.full(4, math.cos(SPOT_INNER_ANGLE)), out * np.cos(around), out * np.sin(around)], -1)
    # The headlight shines along the mount's x axis.
    ends = pos + BEAM_LENGTH * ways @ mat.T
    return np.stack([np.broadcast_to(pos, ends.shape), ends], 1)
