"""Worlds and models of Gazebo (SDF) as arenas: fixed solids, loose objects, doors, lamps and start poses."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np

from usarmjx.base.errors import ArenaFileError
from usarmjx.models.compile.geoms import Inertia, add_geom, combine_inertias, described_in_arena
from usarmjx.models.files.content import Content, corners_of
from usarmjx.models.files.mesh_solids import SMALL, Use
from usarmjx.models.files.mjcf import Hinge, door_of
from usarmjx.models.files.mjcf_solids import Pose
from usarmjx.models.files.resources import Resources
from usarmjx.models.files.robot_source import listed, plain_name, unused_name
from usarmjx.models.files.sdf_solids import FIXTURE, GREY, SdfSolids, angles_of, at_of, colour_of, volume_of
from usarmjx.models.files.sdf_tree import (
    WORLD,
    SdfFiles,
    SdfJoint,
    SdfLink,
    SdfModel,
    all_models,
    drive_plugins,
    inverse,
    joint_end,
    joints_of,
    links_of,
    read_pose,
)
from usarmjx.models.files.xml_file import LinedElement, numbers_of
from usarmjx.models.types.arena import START_ELEVATION, Door, Light, LooseObject, StartPose
from usarmjx.models.types.shapes import BodyInertia, Rgba, Shape

DEFAULT_MASS = 1.0
"""Mass of a link without one [kg]: SDF's."""
MIN_MASS = 1e-3
"""Smallest mass of a loose object [kg]."""
BALANCE_TOLERANCE = 1e-6
"""Excess of a moment of inertia over the sum of the others that is taken for rounding, relative to it."""
MAX_SDF_LOOSE = 64
"""Largest number of loose objects; the heaviest others are fixed: each costs time of the solver."""
LOOSE_SURFACE = "loose"
HINGES = ("revolute", "hinge")
MODEL_CHILDREN = ("model", "include", "link", "joint", "frame", "pose", "static", "plugin", "name", "uri")
LINK_CHILDREN = ("pose", "inertial", "collision", "visual", "light")
SOLID_CHILDREN = ("pose", "geometry", "material", "transparency", "laser_retro", "cast_shadows")
SETTINGS = (
    *("scene", "physics", "gui", "gravity", "magnetic_field", "atmosphere", "wind", "audio"),
    *("self_collide", "enable_wind", "kinematic", "allow_auto_disable", "velocity_decay"),
    *("must_be_base_link", "surface", "max_contacts", "meta", "visibility_flags"),
)
"""Elements about the physics and pictures of Gazebo, which are ours here."""
WORLD_CHILDREN = ("model", "include", "light", "frame", "state", "plugin", "name", "spherical_coordinates")
MAX_BELOW = 1.0
"""Height above a point from which the ground under it is searched [m]."""


def sdf_content(path: Path, surface: str = "", *, resources: Resources | None = None) -> Content:
    """Return a world of Gazebo, or a model, for an arena, all joints at zero.

    Static models are fixed; others are loose objects with their links' masses, one for all links that joints
    hold together. A joint that turns about the vertical between something fixed and one upright box makes a
    door. A model with a drive's plugin is a robot and becomes a start pose. Point and spot lights are lamps
    unless a directional light makes it day. Collisions are touched; visuals are seen where a link has no
    collision. Friction is ours: see `surface_of`.

    Args:
        path: SDF file.
        surface: Surface of its fixed solids; empty: by their form.
        resources: Folders of models and meshes; None: those above the file and of the environment.

    Raises:
        ArenaFileError: An unreadable file, or one in which nothing stands; names it and the line.
    """
    return _SdfReader(path, surface, resources or Resources()).content()


class _SdfReader:
    """Models of a world, sorted into the parts of an arena.

    Args:
        path: The file.
        surface: Surface of fixed solids; empty: by their form.
        resources: Folders of models and meshes.
    """

    def __init__(self, path: Path, surface: str, resources: Resources) -> None:
        self._path = path
        self._files = SdfFiles(resources)
        self._solids = SdfSolids(self._files, surface)
        self._world = self._files.world(path)
        self._is_model = self._files.root(path).tag == "model"
        self._shapes: list[Shape] = []
        self._loose: list[tuple[float, LooseObject, str]] = []
        self._doors: list[Door] = []
        self._robots: list[tuple[SdfModel, Pose, LinedElement]] = []
        self._lights: list[Light] = []
        self._day = False
        self._dropped: dict[tuple[str, str], list[LinedElement]] = {}
        self._notes: list[str] = []
        self._names: set[str] = set()

    def content(self) -> Content:
        """Return the file's content."""
        world = self._world.element
        self._drop(world, WORLD_CHILDREN, "settings")
        self._drop_all(world.all("plugin"), "plugins")
        # Before models are added: it changes their poses.
        self._restore_state(world)
        for light in world.all("light"):
            self._add_light(light, read_pose(light.first("pose")))
        for model in self._world.models:
            self._add_model(model, self._world.pose_of_model(model))
        loose = self._chosen_loose()
        if not self._shapes and not loose and not self._doors and not self._solids.floors:
            robot = f" but the robot {self._robots[0][0].name!r}: load it as a robot" if self._robots else ""
            why = "".join(f"; {note}" for note in (*self._files.notes, *self._solids.notes)[:2])
            raise ArenaFileError(f"{self._path}: nothing stands in it{robot}{why}")
        gps = world.first("spherical_coordinates")
        if gps is not None:
            self._notes.append(
                f"{gps.place}: <spherical_coordinates> left out: x is east in Gazebo, north here; give `gps`"
            )
        starts = tuple(self._starts())
        if self._day and self._lights:
            self._notes.append(f"{self._path}: {len(self._lights)} lamps are left out: the sun shines")
        return Content(
            shapes=tuple(self._shapes),
            loose=loose,
            doors=tuple(self._doors),
            # A model alone says nothing about the ground; a world without a plane has none.
            floor=None if self._is_model else self._solids.floors > 0,
            starts=starts,
            lights=() if self._day else tuple(self._lights),
            warnings=(*self._files.notes, *self._notes, *self._solids.notes, *self._dropped_notes()),
        )

    def _drop(self, element: LinedElement, known: tuple[str, ...], where: str) -> None:
        """Note the children of an element that nobody reads."""
        for child in element.children():
            if child.tag not in known:
                self._dropped.setdefault((where, child.tag), []).append(child)

    def _drop_all(self, elements: list[LinedElement], where: str) -> None:
        for element in elements:
            self._dropped.setdefault((where, element.tag), []).append(element)

    def _dropped_notes(self) -> Iterator[str]:
        """Yield what is left out, a line for each kind, with the place of the first one."""
        settings = [found[0] for (_, tag), found in self._dropped.items() if tag in SETTINGS]
        if settings:
            tags = listed([*dict.fromkeys(one.tag for one in settings)], len(SETTINGS))
            yield f"{settings[0].place}: settings of Gazebo are left out: {tags}"
        for (where, tag), found in self._dropped.items():
            if tag in SETTINGS:
                continue
            names = [name for one in found if (name := one.get("name") or one.get("filename"))]
            said = f": {listed(names)}" if names else ""
            yield f"{found[0].place}: {len(found)} <{tag}> ({where}) left out{said}"

    def _restore_state(self, world: LinedElement) -> None:
        """Give models the poses of the first `<state>`, which Gazebo saves beside them."""
        state = world.first("state")
        if state is None:
            return
        models = {model.name: model for model in self._world.models}
        for saved in state.all("model"):
            model, pose = models.get(saved.get("name", "")), saved.first("pose")
            # Poses of the state count from the world, whatever frame the model's own pose counts from.
            if model is not None and pose is not None:
                model.pose, model.placement = pose, ""
            scale = saved.first("scale")
            # Gazebo saves a scale of 1 with every model: it is nothing to note.
            if scale is not None and (scale.text or "").split() not in (["1", "1", "1"], []):
                self._dropped.setdefault(("saved state", "scale"), []).append(scale)
        for tag in ("insertions", "deletions"):
            self._drop_all(state.all(tag), "saved state")

    def _add_model(self, model: SdfModel, pose: Pose) -> None:
        """Add a model that stands in the world."""
        # Before its links: a robot's solids must not stand in the arena where its start pose is.
        drive = next(drive_plugins(model), None)
        if drive is not None:
            self._robots.append((model, pose, drive))
            return
        frames = dict(links_of(model, pose))
        for inner in all_models(model):
            self._drop(inner.element, MODEL_CHILDREN, "in models")
            self._drop_all(inner.element.all("plugin"), "plugins")
        for found in frames.values():
            for light in found.link.all("light"):
                self._add_light(light, found.pose.then(found.model.placed(light.first("pose"))))
        if model.static:
            for found in frames.values():
                self._shapes += self._link_shapes(found, found.pose, "fixed")
            return
        self._add_moving(model, pose, frames)

    def _add_moving(self, model: SdfModel, pose: Pose, frames: dict[str, SdfLink]) -> None:
        """Add the links of a model that moves, joined by its joints."""
        owner = {name: name for name in frames}
        hinges: list[SdfJoint] = []
        fixed: set[str] = {name for name, found in frames.items() if found.model.static}
        for joint in joints_of(model, pose):
            parent, child = (joint_end(joint, end, frames) for end in ("parent", "child"))
            if child is None or (parent is None and joint.element.word("parent") != WORLD):
                self._notes.append(
                    f"{joint.element.place}: joint {joint.name!r} has an end that is no link: left out"
                )
            # Old worlds weld links by a hinge without play.
            elif joint.element.get("type") == "fixed" or joint.limits == (0.0, 0.0):
                _join(owner, fixed, parent, child)
            else:
                hinges.append(replace(joint, parent=parent or "", child=child))
        frames = self._without_doors(hinges, frames, owner, fixed)
        # Only now: joints that are held above may have tied more links to what is fixed.
        stuck = {_root(owner, name) for name in fixed}
        groups: dict[str, list[SdfLink]] = {}
        for name, found in frames.items():
            groups.setdefault(_root(owner, name), []).append(found)
        for root, links in groups.items():
            # A group without collisions would fall through the floor as a loose object.
            touched = any(found.link.first("collision") is not None for found in links)
            if root in stuck or not touched:
                for found in links:
                    self._shapes += self._link_shapes(found, found.pose, "fixed")
            else:
                self._add_loose(model, links)

    def _without_doors(
        self, hinges: list[SdfJoint], frames: dict[str, SdfLink], owner: dict[str, str], fixed: set[str]
    ) -> dict[str, SdfLink]:
        """Add doors that hang on something fixed, hold all other joints; return the links that are no doors.

        Args:
            hinges: Joints that move.
            frames: Links by name.
            owner: For each link, one that it is joined to; joints that are held add to it.
            fixed: Links that are joined to the world; joints that are held add to it.
        """
        waiting = [*hinges]
        # Anew in each round: a joint that is held fixes its child, on which others may hang.
        while (joint := next((one for one in waiting if _stands(one, owner, fixed)), None)) is not None:
            waiting.remove(joint)
            leaf = _hanging(joint, waiting, owner)
            door = self._door(joint, [found for name, found in frames.items() if _root(owner, name) in leaf])
            # A leaf that is tied to the world at another place cannot turn.
            if door is None or not leaf.isdisjoint(_root(owner, name) for name in fixed):
                self._hold(joint, owner, fixed)
                continue
            self._doors.append(door)
            frames = {name: found for name, found in frames.items() if _root(owner, name) not in leaf}
            for one in [one for one in waiting if _root(owner, one.child) in leaf]:
                self._hold(one, owner, fixed)
                waiting.remove(one)
        for joint in waiting:
            self._hold(joint, owner, fixed)
        return frames

    def _hold(self, joint: SdfJoint, owner: dict[str, str], fixed: set[str]) -> None:
        """Join the links of a joint at zero, with a note."""
        kind = joint.element.get("type")
        self._notes.append(f"{joint.element.place}: joint {joint.name!r} of type {kind!r} is held at zero")
        _join(owner, fixed, joint.parent or None, joint.child)

    def _add_loose(self, model: SdfModel, links: list[SdfLink]) -> None:
        """Add rigidly joined links as a loose object."""
        # The object's frame is that of its first link; all others are rigid against it.
        base = links[0].pose
        shapes: list[Shape] = []
        mass = 0.0
        for found in links:
            own = self._link_shapes(found, inverse(base).then(found.pose), "loose")
            weight = self._mass(found.link)
            # By volume, as if of one density: what is only seen weighs nothing.
            volumes = [volume_of(shape) if shape.surface != FIXTURE else 0.0 for shape in own]
            whole = sum(volumes)
            shapes += [
                replace(shape, mass=weight * volume / whole if whole else 0.0)
                for shape, volume in zip(own, volumes, strict=True)
            ]
            mass += weight
        held = sum(shape.mass for shape in shapes)
        if held <= 0:
            self._notes.append(
                f"{model.place}: model {model.path!r} has nothing that can be touched: left out"
            )
            return
        # Solids that are refused or only seen weigh too, on those that can be touched.
        shapes = [replace(shape, mass=shape.mass * max(mass, MIN_MASS) / held) for shape in shapes]
        name = self._free_name(model.path if len(links) == 1 else links[0].name)
        # The file's own inertia, where it states one: the solids' is that of an even density.
        inertia = self._inertia(links, base)
        if inertia is not None:
            shapes = [replace(shape, mass=0.0) for shape in shapes]
        thing = LooseObject(
            name=name, at=at_of(base), rotation=angles_of(base), shapes=tuple(shapes), inertia=inertia
        )
        self._loose.append((mass, thing, model.place))

    def _free_name(self, name: str) -> str:
        free = unused_name(name, self._names)
        self._names.add(free)
        return free

    def _mass(self, link: LinedElement) -> float:
        """Return the mass of a link [kg]."""
        mass = link.number("inertial/mass", DEFAULT_MASS)
        if mass < 0:
            raise link.error(f"link {link.get('name')!r} has a mass of {mass:g} kg")
        return mass

    def _inertia(self, links: list[SdfLink], base: Pose) -> BodyInertia | None:
        """Return the inertia of rigidly joined links about a frame; None: a link states none that holds."""
        parts: list[Inertia] = []
        for found in links:
            inertial = found.link.first("inertial")
            if inertial is None or inertial.first("inertia") is None:
                return None
            usual = {"ixx": 1.0, "iyy": 1.0, "izz": 1.0, "ixy": 0.0, "ixz": 0.0, "iyz": 0.0}
            xx, yy, zz, xy, xz, yz = (inertial.number(f"inertia/{key}", one) for key, one in usual.items())
            tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
            # The solver ends with an error of its own on numbers that are not finite.
            values = np.linalg.eigvalsh(tensor) if np.isfinite(tensor).all() else np.full(3, -1.0)
            mass = self._mass(found.link)
            # MuJoCo refuses moments of which one exceeds the sum of the others: no body has such.
            if values[0] <= 0 or values[2] > (values[0] + values[1]) * (1 + BALANCE_TOLERANCE) or mass <= 0:
                self._notes.append(
                    f"{inertial.place}: link {found.link.get('name')!r} has the inertia of no body: that of "
                    "its solids counts"
                )
                return None
            pose = inverse(base).then(found.pose).then(found.within(inertial))
            parts.append(Inertia(mass, pose.pos, pose.mat @ tensor @ pose.mat.T))
        return described_in_arena(combine_inertias(parts))

    def _link_shapes(self, found: SdfLink, pose: Pose, use: Use) -> list[Shape]:
        """Return a link's solids: its collisions, or what is seen of it if it has none."""
        link = found.link
        self._drop(link, LINK_CHILDREN, "in links")
        collisions, visuals = link.all("collision"), link.all("visual")
        for solid in (*collisions, *visuals):
            self._drop(solid, SOLID_CHILDREN, f"in <{solid.tag}>")
        colours = [colour for visual in visuals if (colour := colour_of(visual)) is not None]
        made: list[Shape] = []
        for solid in collisions or visuals:
            touched = solid.tag == "collision"
            # Collisions have no colour in SDF: they take that of the link's first visual.
            rgba: Rgba = (colours or [GREY])[0] if touched else colour_of(solid) or GREY
            # Without a surface fixed solids get one by their form, see `surface_of`.
            surface = "" if touched and use == "fixed" else LOOSE_SURFACE if touched else FIXTURE
            like = Shape(kind="box", surface=surface, rgba=rgba)
            made += self._solids.of(solid, pose.then(found.within(solid)), like, use if touched else "seen")
        return made

    def _door(self, joint: SdfJoint, links: list[SdfLink]) -> Door | None:
        """Return the door that a joint hangs on something fixed; None: it is none.

        Args:
            joint: Its hinge.
            links: All that hangs on the joint: a leaf, and perhaps handles.
        """
        leaf = next((found for found in links if found.name == joint.child), None)
        if joint.element.get("type") not in HINGES or leaf is None:
            return None
        like = Shape(kind="box", surface=LOOSE_SURFACE, rgba=GREY)
        solids = [
            (pose, shape)
            for found in links
            for solid in found.link.all("collision")
            for pose in [found.pose.then(found.within(solid))]
            for shape in self._solids.of(solid, pose, like, "loose")
        ]
        boxes = [one for one in solids if one[1].kind == "box"]
        if not boxes:
            return None
        # The leaf is the largest; handles are small.
        centre, box = max(boxes, key=lambda one: volume_of(one[1]))
        others = [shape for _, shape in solids if shape is not box]
        if any(np.ptp(corners_of(shape), axis=0).max() > SMALL for shape in others):
            return None
        if others:
            self._notes.append(
                f"{leaf.link.place}: {len(others)} solids on the door {leaf.name!r}, up to {SMALL:g} m long, "
                "are left out"
            )
        axis, limits = joint.axis, joint.limits
        hinge = Hinge(
            anchor=joint.frame.pos,
            # An axis of zeros stays one, which `door_of` refuses as not upright.
            axis=axis / max(float(np.linalg.norm(axis)), 1e-9),
            limits=limits if limits is not None and limits[0] < limits[1] else None,
            friction=max(joint.element.number("axis/dynamics/damping", 0.0), 0.0),
        )
        visuals = [colour for one in leaf.link.all("visual") if (colour := colour_of(one))]
        try:
            return door_of(
                self._free_name(leaf.name),
                centre,
                np.array(box.size),
                hinge,
                mass=max(sum(self._mass(found.link) for found in links), MIN_MASS),
                rgba=(visuals or [GREY])[0],
            )
        except ArenaFileError as error:
            self._notes.append(f"{joint.element.place}: {error}")
            return None

    def _chosen_loose(self) -> tuple[LooseObject, ...]:
        """Return the loose objects, and fix the heaviest ones if they are too many."""
        if len(self._loose) <= MAX_SDF_LOOSE:
            return tuple(thing for _, thing, _ in self._loose)
        # Robots are least likely to move the heaviest.
        order = sorted(range(len(self._loose)), key=lambda i: self._loose[i][0])
        kept = set(order[:MAX_SDF_LOOSE])
        fixed = [one for i, one in enumerate(self._loose) if i not in kept]
        names = listed([thing.name for _, thing, _ in fixed])
        self._notes.append(
            f"{fixed[0][2]}: of {len(self._loose)} loose models the {len(fixed)} heaviest are fixed, at most "
            f"{MAX_SDF_LOOSE} move: {names}"
        )
        for _, thing, _ in fixed:
            self._shapes += _fixed(thing)
        return tuple(thing for i, (_, thing, _) in enumerate(self._loose) if i in kept)

    def _add_light(self, light: LinedElement, pose: Pose) -> None:
        """Add a `<light>`: a lamp, or the sun."""
        if light.get("type") == "directional":
            self._day = True
            return
        found = light.first("diffuse")
        words = (found.text or "").split() if found is not None else ["1", "1", "1"]
        # Clipped below only: a colour above 1 makes a brighter lamp, see below.
        rgb = np.clip(numbers_of(found or light, " ".join(words[:3]), 3), 0.0, None)
        # At 1 m, to which our brightness refers, the three terms simply add up.
        dimming = sum(light.number(f"attenuation/{key}", usual) for key, usual in ATTENUATION)
        brightness = float(rgb.max()) * light.number("intensity", 1.0) / max(dimming, 1e-3)
        if brightness <= 0:
            return
        red, green, blue = (rgb / rgb.max()).tolist()
        self._lights.append(Light(at=at_of(pose), brightness=brightness, rgb=(red, green, blue)))

    def _starts(self) -> Iterator[StartPose]:
        """Yield a start pose for each robot."""
        tags: set[str] = set()
        for model, pose, drive in self._robots:
            tag = unused_name(plain_name(model.name) or "robot", tags)
            tags.add(tag)
            x, y, z = at_of(pose)
            ground = self._ground(x, y, z)
            self._notes.append(
                f"{model.place}: robot {model.path!r} ({drive.get('filename') or drive.get('name')}) becomes "
                f"the start pose {tag}"
            )
            yield StartPose(tag=tag, at=(x, y, ground + START_ELEVATION), yaw=angles_of(pose)[2])

    def _ground(self, x: float, y: float, z: float) -> float:
        """Return the height of the highest solid under a point, or of the floor [m]."""
        return ground_under(self._shapes, (x, y, z), floor=self._is_model or self._solids.floors > 0)


ATTENUATION = (("constant", 1.0), ("linear", 0.0), ("quadratic", 0.0))


def _root(owner: dict[str, str], name: str) -> str:
    while owner[name] != name:
        name = owner[name]
    return name


def _stands(joint: SdfJoint, owner: dict[str, str], fixed: set[str]) -> bool:
    """Return whether a joint hangs on the world or on something fixed."""
    return not joint.parent or _root(owner, joint.parent) in {_root(owner, name) for name in fixed}


def _hanging(joint: SdfJoint, others: list[SdfJoint], owner: dict[str, str]) -> set[str]:
    """Return the groups of links that hang on a joint, by its child and by other joints."""
    leaf = {_root(owner, joint.child)}
    while True:
        more = {_root(owner, one.child) for one in others if _root(owner, one.parent) in leaf} - leaf
        if not more:
            return leaf
        leaf |= more


def _join(owner: dict[str, str], fixed: set[str], parent: str | None, child: str) -> None:
    """Join two links rigidly; without a parent, the child and the world."""
    if parent is None:
        fixed.add(child)
    else:
        owner[_root(owner, child)] = _root(owner, parent)


def _fixed(thing: LooseObject) -> Iterator[Shape]:
    """Yield the solids of a loose object as fixed ones."""
    from usarmjx.models.compile.reachability import shapes_in_arena
    from usarmjx.models.files.content import surface_of

    for own, placed in zip(thing.shapes, shapes_in_arena(thing), strict=True):
        shape = replace(own, at=placed.at, rotation=placed.rotation, mass=0.0)
        yield shape if shape.surface == FIXTURE else replace(shape, surface=surface_of(shape))


def ground_under(shapes: Sequence[Shape], at: tuple[float, float, float], *, floor: bool) -> float:
    """Return the height of the highest fixed solid under a point, or of the floor; else its own [m].

    Args:
        shapes: Fixed solids, of which those that nothing touches do not count.
        at: The point.
        floor: Whether there is a floor at height 0.
    """
    x, y, z = at
    # Few solids are compiled: all of a world would take long.
    near = [shape for shape in shapes if shape.surface != "fixture" and _covers(shape, x, y)]
    found = [0.0] if floor else []
    if near:
        spec = mujoco.MjSpec()
        for number, shape in enumerate(near):
            add_geom(spec, spec.worldbody, str(number), shape)
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        # From above: a model's origin may lie a little below the surface that it stands on.
        start = np.array([x, y, z + MAX_BELOW])
        geom = np.zeros(1, np.int32)
        # 1: fixed geoms count; -1: no body is left out.
        distance = mujoco.mj_ray(model, data, start, np.array([0.0, 0.0, -1.0]), None, 1, -1, geom, None)
        if geom[0] >= 0:
            found.append(float(start[2] - distance))
    # A floor more than a metre above the point is not under it: the point is in a cellar.
    return max((height for height in found if height <= z + MAX_BELOW), default=z)


def _covers(shape: Shape, x: float, y: float) -> bool:
    low, high = corners_of(shape)
    return bool(low[0] <= x <= high[0] and low[1] <= y <= high[1])
