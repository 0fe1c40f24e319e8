"""A batch in a notebook: a small picture in three dimensions that turns and plays without a network."""

import base64
import hashlib
import json
from collections.abc import Sequence
from functools import cache
from html import escape
from importlib import resources
from typing import Any

import numpy as np

from usarmjx.base.errors import UsageError
from usarmjx.plots.films.raster import Solids, solids_of
from usarmjx.sim.batch import Batch, BatchState
from usarmjx.train.envs.env import Env
from usarmjx.train.envs.state import EnvState
from usarmjx.view.drawing import Drawing, FrameSource
from usarmjx.view.stage import grid_offsets
from usarmjx.view.training_page import BatchSource

MAX_WORLDS = 16
"""Largest number of worlds in a picture."""
HEIGHTS = (120, 2000)
"""Least and largest height of a picture [pixels]."""
PAGE = "notebook.html"
"""Page of the picture, beside this module."""
NO_FLOOR = -1e9
"""Height of a floor that is not there; the page draws none below -1e8 [m]."""
DATA = "/*DATA*/null"
"""Expression of that page that the worlds replace."""


class BatchView:
    """Worlds at some moments, as a picture that a notebook shows: drag to turn it, scroll to come closer.

    Args:
        source: The worlds.
        title: Text over the picture.
        height: Height of the picture [pixels].
    """

    def __init__(self, source: FrameSource, title: str, height: int = 420) -> None:
        self._source, self._title, self._height = source, title, height
        self._drawings = [source.drawing(world) for world in range(source.num_worlds)]
        self._solids = [_without_floor(solids_of(drawing)) for drawing in self._drawings]
        self._times: list[float] = []
        self._poses: list[list[np.ndarray]] = []

    def keep(self) -> None:
        """Keep the present moment of all worlds."""
        frames = [self._source.frame(world) for world in range(len(self._drawings))]
        self._times.append(float(frames[0].time))
        poses = [np.column_stack([frame.pos, frame.quat, frame.shown]) for frame in frames]
        # The page reads single precision, and positions of an arena need no more.
        self._poses.append([pose.astype(np.float32) for pose in poses])

    def __repr__(self) -> str:
        """Return a short line: the worlds and the moments."""
        return f"BatchView({self._title}, worlds={len(self._drawings)}, moments={len(self._times)})"

    def _repr_html_(self) -> str:
        # In a frame its scripts and styles are apart from the notebook's own.
        page = escape(self.page(), quote=True)
        return (
            f'<iframe srcdoc="{page}" style="width:100%;height:{self._height}px;border:0" '
            f'title="{escape(self._title, quote=True)}"></iframe>'
        )

    def page(self) -> str:
        """Return the picture as a page of its own, without addresses of other pages."""
        shapes: dict[str, Any] = {}
        worlds: list[dict[str, Any]] = []
        offsets = grid_offsets(self._drawings)
        for number, (drawing, solids) in enumerate(zip(self._drawings, self._solids, strict=True)):
            packed = _packed(solids)
            key = hashlib.blake2b(json.dumps(packed).encode(), digest_size=8).hexdigest()
            shapes[key] = packed  # most worlds look alike: each look is in the page once
            poses = np.stack([moment[number] for moment in self._poses])
            worlds.append(
                {
                    "shape": key,
                    "bodies": poses.shape[1],
                    "poses": _text(poses),
                    "offset": offsets[number].tolist(),
                    "ground": _ground(drawing),
                }
            )
        data = {"title": self._title, "times": self._times, "shapes": shapes, "worlds": worlds}
        # A name with "</script>" would end the script.
        return _page().replace(DATA, json.dumps(data).replace("<", "\\u003c"))


def view_batch(
    batch: Batch | Env,
    states: BatchState | EnvState | Sequence[BatchState] | Sequence[EnvState],
    worlds: Sequence[int] | None = None,
    height: int = 420,
) -> BatchView:
    """Return worlds of a batch or an environment as a picture in three dimensions for a notebook.

    Args:
        batch: The batch, or a task's environment.
        states: Its state, or several in order of time, which the picture plays.
        worlds: Numbers of the worlds; by default the first, at most nine.
        height: Height of the picture [pixels].

    Raises:
        UsageError: No state, no such world, more than 16 worlds, or a height beyond its limits.
    """
    steps = list(states) if isinstance(states, Sequence) else [states]
    inner = [one.batch if isinstance(one, EnvState) else one for one in steps]
    built = batch.batch if isinstance(batch, Env) else batch
    chosen = list(range(min(built.worlds, 9))) if worlds is None else [int(world) for world in worlds]
    if not inner:
        raise UsageError("no state to show: expected a state of the batch, or several in a list")
    if not 1 <= len(chosen) <= MAX_WORLDS:
        raise UsageError(f"{len(chosen)} worlds in one picture, expected 1 to {MAX_WORLDS}")
    if bad := [world for world in chosen if not 0 <= world < built.worlds]:
        raise UsageError(f"no world {bad[0]}: the batch has worlds 0 to {built.worlds - 1}")
    if not HEIGHTS[0] <= height <= HEIGHTS[1]:
        raise UsageError(f"height {height} pixels, expected {HEIGHTS[0]} to {HEIGHTS[1]}")
    source = BatchSource(built, inner[0], chosen)
    view = BatchView(source, f"{built.scene.arena.name}, {built.worlds} worlds", height)
    for state in inner:
        source.show(state)
        view.keep()
    return view


def _without_floor(solids: Solids) -> Solids:
    """Return solids without an unbounded floor, and sorted by body."""
    kept = np.flatnonzero(~solids.is_floor)
    # The page has a count of triangles for each body, so those of a body must follow each other.
    kept = kept[np.argsort(solids.body[kept], kind="stable")]
    return Solids(**{name: value[kept] for name, value in vars(solids).items()})


def _packed(solids: Solids) -> dict[str, Any]:
    """Return triangles as texts: corners [m], normals of 1/127, colours and opacities of 1/255, by body."""
    colour = np.concatenate([solids.rgb, 1.0 - solids.transparency[:, None]], 1)
    bodies, counts = np.unique(solids.body, return_counts=True)
    return {
        "corners": _text(solids.corners.astype(np.float32)),
        # A byte is enough for light, and a page stays in the notebook's file.
        "normals": _text(np.rint(solids.normals * 127).astype(np.int8)),
        "colours": _text(np.rint(np.clip(colour, 0, 1) * 255).astype(np.uint8)),
        "bodies": [[int(body), int(count)] for body, count in zip(bodies, counts, strict=True)],
    }


def _ground(drawing: Drawing) -> list[float]:
    """Return the rectangle of a floor: least and largest x, y, and the height [m]."""
    return [*map(float, drawing.extent.ravel()), float(drawing.floor) if drawing.has_floor else NO_FLOOR]


def _text(values: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(values).tobytes()).decode()


@cache
def _page() -> str:
    return resources.files("usarmjx.plots").joinpath(PAGE).read_text(encoding="utf-8")
