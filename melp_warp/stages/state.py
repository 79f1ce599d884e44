"""State: all that evolves, and so exactly what a checkpoint stores. Everything else follows from it and the scene."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from melp_warp.device.scalars import Reading
from melp_warp.features import Features
from melp_warp.kernels.budget import SLOTS
from melp_warp.stages.film import count_parts
from melp_warp.stages.record import NAMES, nothing

if TYPE_CHECKING:
    from melp_warp.carried import Carried
    from melp_warp.particle_set import ParticleSet
    from melp_warp.scene import Scene
    from melp_warp.stepping.ledger import Ledger

GAS_SLOTS = ("volume", "gauge_pressure", "amount", "increment", "area", "offset")
VOLUME, GAUGE, AMOUNT, INCREMENT, AREA, OFFSET = range(len(GAS_SLOTS))

BORDER_SLOTS = ("mass", "surfactant", "impulse_x", "impulse_y", "impulse_z", "energy_motion", "energy_height")


def _array(dtype, size: str | int, when: Callable[[Features], bool] | None = None, columns: int = 0):
    """Declare an array.

    Args:
        dtype: its type.
        size: the name of its length (`State.sizes`) or the length.
        when: the films that have it.
        columns: number of columns of one of two dimensions.
    """
    return field(default=None, metadata={"dtype": dtype, "size": size, "when": when, "columns": columns})


@dataclass
class EulerianState:
    """Eulerian particles; entries from `count` on are boundary particles of an open film.

    Attributes:
        x: [n] positions, m.
        normal: [n] outward unit normals.
        u: [n] material velocity, m/s.
        mass: [count] kg.
        surfactant: [count] amount on one interface, mol.
        region: [n] index of the region; E are stored region by region.
        behind: [count] 1 for E that a free rim has passed: they only continue the film beyond it. None without holes.
        swept: [count] 1 for E whose liquid a free rim has taken. None without holes, or with L, which hold the liquid.
        count: number of E.
    """

    x: wp.array = _array(wp.vec3, "n")
    normal: wp.array = _array(wp.vec3, "n")
    u: wp.array = _array(wp.vec3, "n")
    mass: wp.array = _array(wp.float32, "e")
    surfactant: wp.array = _array(wp.float32, "e")
    region: wp.array = _array(wp.int32, "n")
    behind: wp.array | None = _array(wp.int32, "e", lambda f: f.tears)
    swept: wp.array | None = _array(wp.int32, "e", lambda f: f.tears and not f.lagrangian)
    count: int = 0


@dataclass
class LagrangianState:
    """Lagrangian particles.

    Attributes:
        x: [n_l] positions, m.
        u: [n_l] carried velocity, m/s.
        v: [n_l] velocity at the particle, m/s.
        affine: [n_l] velocity gradient, 1/s.
        normal: [n_l] unit normals.
        mass: [n_l] kg.
        surfactant: [n_l] amount on one interface, mol.
        eta: [n_l] thickness, m.
        region: [n_l] index of the region.
        circulation: [n_l] n.curl_s u dA about the L's normal, m^2/s; None unless the carrier is "circulation".
        behind: [n_l] 1 for L whose liquid a free rim has taken. None without holes.
        count: number of L.
    """

    x: wp.array = _array(wp.vec3, "l")
    u: wp.array = _array(wp.vec3, "l")
    v: wp.array = _array(wp.vec3, "l")
    affine: wp.array = _array(wp.mat33, "l")
    normal: wp.array = _array(wp.vec3, "l")
    mass: wp.array = _array(wp.float32, "l")
    surfactant: wp.array = _array(wp.float32, "l")
    eta: wp.array = _array(wp.float32, "l")
    region: wp.array = _array(wp.int32, "l")
    circulation: wp.array | None = _array(wp.float32, "l", lambda f: f.circulation)
    behind: wp.array | None = _array(wp.int32, "l", lambda f: f.tears and f.lagrangian)
    count: int = 0


@dataclass
class BoundaryState:
    """Boundary particles of an open film, besides what `EulerianState` has of them.

    Attributes:
        mirror: [n_b] points of the film inside that they mirror, m.
    """

    mirror: wp.array = _array(wp.vec3, "b")


@dataclass
class FreeRimState:
    """Points of free rims, see `kernels.free_rim`.

    Attributes:
        x: [n_f] m.
        u: [n_f] velocity in the last step, m/s.
        inertia: [n_f] mass that its motion goes by, kg; `mass` but for the lumps in which that grows.
        mass: [n_f] kg.
        surfactant: [n_f] amount on one interface, mol.
        after, before: [n_f] indices of the neighbours, -1 for none.
        normal: [n_f] unit normals of the film ahead.
        flow: [n_f] its velocity, m/s.
        film: [n_f] its relative surfactant concentration and thickness (m).
        growth: [n_f] growth of the waves that break it into drops since it last broke, in growth times.
        limit: [n_f] growth at which it breaks next, over the scene's.
        region: [n_f] index of the region whose film it runs over.
        other: [n_f] where that film is a partition, the region on its other side; -1 for a film that is free.
        more: name -> [n_f] how much they hold of what the scene declares.
    """

    x: wp.array = _array(wp.vec3, "f")
    u: wp.array = _array(wp.vec3, "f")
    inertia: wp.array = _array(wp.float32, "f")
    mass: wp.array = _array(wp.float64, "f")
    surfactant: wp.array = _array(wp.float64, "f")
    after: wp.array = _array(wp.int32, "f")
    before: wp.array = _array(wp.int32, "f")
    normal: wp.array = _array(wp.vec3, "f")
    flow: wp.array = _array(wp.vec3, "f")
    film: wp.array = _array(wp.vec2, "f")
    growth: wp.array = _array(wp.float32, "f")
    limit: wp.array = _array(wp.float32, "f")
    region: wp.array = _array(wp.int32, "f")
    other: wp.array = _array(wp.int32, "f")
    more: dict[str, wp.array] = field(default_factory=dict)


@dataclass
class DropState:
    """Drops that rims have broken into.

    Attributes:
        x: [n_d] m.
        u: [n_d] m/s.
        mass: [n_d] kg.
        surfactant: [n_d] mol, on one interface of the film that it was.
        more: name -> [n_d] how much they hold of what the scene declares.
    """

    x: wp.array = _array(wp.vec3, "d")
    u: wp.array = _array(wp.vec3, "d")
    mass: wp.array = _array(wp.float32, "d")
    surfactant: wp.array = _array(wp.float32, "d")
    more: dict[str, wp.array] = field(default_factory=dict)


def _guesses(features: Features) -> bool:
    """Whether the solves of the normal motion start from the last solution."""
    return features.response == "film"


def _of_foams(features: Features) -> bool:
    """Whether regions touch."""
    return features.normal == "foam"


@dataclass
class Memory:
    """What stages remember from step to step. None where a film has no use for it.

    Lists live for several steps, and fits are those from before the volume was closed: with the positions at which
    they were made they can be made again, bit for bit.

    Attributes:
        x: [n] E when their lists were last built, m.
        mirror: [n_b] mirror points then, m.
        wide: [n] E when the wide lists were built from which the lists of L were last picked, m.
        x_e: [n] E when the lists of L were last built, m.
        x_l: [n_l] L then, before strays were put back, m.
        home: [n_l] homes of L before that, from which it looks for the new ones.
        travel: [6] how far particles have moved since, see `NeighborLists`, m.
        place: [n] E when the surface was last fitted, m.
        facing: [n] their normals before that.
        area: [n_e] control areas of a flat film, found from its first L, m^2.
        load: [n] last change of normal velocity, first guess of the next solve, m/s.
        unit: [n] the same for a unit of pressure, m/s/Pa.
        volume: [regions] volumes when the regions of a foam were set up, m^3.
        cover: [n_e] see `FoamMembrane`.
        sought: [n_e] force that is passed on late, see `kernels.lines.seek_normals_e`, N m^2.
        owed: [regions] momentum (kg m/s) that a foam owes its regions, and their covered area (m^2).
        spin: [regions] the same of angular momentum, kg m^2/s.
        part: [parts, SLOTS] energy budget of the step in progress, see `Budget`.
        lying: [parts, 9] where the liquid lies.
        book: [4, SLOTS] what the steps add up to.
        asked: [1] whether the step to come is to note what is stored.
    """

    x: wp.array = _array(wp.vec3, "n")
    mirror: wp.array = _array(wp.vec3, "b", lambda f: f.rim)
    wide: wp.array = _array(wp.vec3, "n", lambda f: f.lagrangian)
    x_e: wp.array = _array(wp.vec3, "n", lambda f: f.lagrangian)
    x_l: wp.array = _array(wp.vec3, "l", lambda f: f.lagrangian)
    home: wp.array = _array(wp.int32, "l", lambda f: f.lagrangian)
    travel: wp.array = _array(wp.float32, 6)
    place: wp.array = _array(wp.vec3, "n")
    facing: wp.array = _array(wp.vec3, "n")
    area: wp.array = _array(wp.float32, "e", lambda f: f.lagrangian and not f.moving)
    load: wp.array = _array(wp.float32, "n", _guesses)
    unit: wp.array = _array(wp.float32, "n", lambda f: _guesses(f) and f.closed)
    volume: wp.array = _array(wp.float64, "r", _of_foams)
    cover: wp.array = _array(wp.float32, "e", _of_foams)
    sought: wp.array = _array(wp.vec3, "e", _of_foams)
    owed: wp.array = _array(wp.vec4, "r", _of_foams)
    spin: wp.array = _array(wp.vec3, "r", _of_foams)
    part: wp.array = _array(wp.float64, "p", lambda f: f.budget, SLOTS)
    lying: wp.array = _array(wp.float64, "p", lambda f: f.budget, 9)
    book: wp.array = _array(wp.float64, 4, lambda f: f.budget, SLOTS)
    asked: wp.array = _array(wp.int32, 1, lambda f: f.budget)


@dataclass
class Course:
    """What the host carries from step to step: plain numbers.

    Attributes:
        limit: size that the last step was allowed, s; 0 before the first.
        cap: largest step after a leap, s; it doubles with each frame.
        reach: longest way of a particle in a step, m.
        speed: fastest wave and liquid at the start, m/s.
        layer_speed: fastest wave of a single layer when it was first asked for, m/s; None before.
        builds: times that the lists of E and of L were built; 0 where they are to be built where particles are now.
        clock: time that the lists have seen, s.
        crossed: time of the last exchange of liquid between films, s.
        mixed: time of the last exchange of L that mix, s.
        unmixed: way of the fastest particle since then, m.
        fresh: whether a foam has done no step since it was set up.
        paid: share of what it passes on late that a foam has passed on in the last step.
        labels: the scene's number of each region.
        spilled: liquid that left with films that popped, kg.
        pending: number of the scene's scripted events to come.
        unborn: the scene's numbers of the bubbles to come.
        punctured: number of the scene's punctures that have been made.
        holed: whether the film has holes, or has burst, or a film of the foam has.
        gas: amount of gas that a closed film started with, n R T, J.
        run: way of the fastest rim since film behind rims was last taken away, m.
        tears: [scene's number of the region, that on the other side of a partition or -1] of each film that is torn.
        torn: energy of the film that rims have torn, and what was lost of it as they took its liquid along, J.
        rest: liquid that a frame has collected where a rim came to it, and that left with drops out of sight, kg.
        left: name -> what went with that, or with films that popped, of what the scene declares.
        shown: [3] where exported positions are measured from, the same for the whole run, m.
        issued: how many numbers were given so far to E ("e"), L ("l") and drops ("d"): none is given twice.
        sprayed: how many drops there had been when the last frame began.
        spacing: E spacing at the start, m.
        areas: of the regions a frame ago, m^2, where E come and go with them; else none.
        ledger: the energy budget so far; None where the scene wants none.
    """

    limit: float = 0.0
    cap: float = math.inf
    reach: float = 0.0
    speed: float = 0.0
    layer_speed: float | None = None
    builds: list[int] = field(default_factory=lambda: [0, 0])
    clock: float = 0.0
    crossed: float = 0.0
    mixed: float = 0.0
    unmixed: float = 0.0
    fresh: bool = True
    paid: float = 0.0
    labels: list[int] = field(default_factory=lambda: [0])
    spilled: float = 0.0
    pending: int = 0
    unborn: list[int] = field(default_factory=list)
    punctured: int = 0
    holed: bool = False
    gas: float = 0.0
    run: float = 0.0
    tears: list[list[int]] = field(default_factory=list)
    torn: list[float] = field(default_factory=lambda: [0.0, 0.0])
    rest: float = 0.0
    left: dict[str, float] = field(default_factory=dict)
    shown: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])
    issued: dict[str, int] = field(default_factory=lambda: {"e": 0, "l": 0, "d": 0})
    sprayed: int = 0
    spacing: float = 0.0
    areas: list[float] = field(default_factory=list)
    ledger: Ledger | None = None


def _arrays(block) -> dict[str, wp.array]:
    named = {f.name: getattr(block, f.name) for f in fields(block) if "dtype" in f.metadata}
    named |= getattr(block, "more", {})
    return {name: array for name, array in named.items() if array is not None}


def allocate(kind, sizes: dict[str, int], device, features: Features | None = None, **counts):
    """Make a zeroed state block of arrays of these lengths, without those that a film has no use for."""
    made = {}
    for f in fields(kind):
        when = f.metadata.get("when")
        if "dtype" in f.metadata and (when is None or when(features)):
            size, columns = f.metadata["size"], f.metadata["columns"]
            shape = (sizes.get(size, size), *((columns,) if columns else ()))
            made[f.name] = wp.zeros(shape, dtype=f.metadata["dtype"], device=device)
    return kind(**made, **counts)


def allocate_beads(rims: int, drops: int, device, features: Features) -> tuple[FreeRimState, DropState]:
    """Make points of free rims and drops, zeroed, with room for what the scene declares."""
    made = allocate(FreeRimState, {"f": rims}, device), allocate(DropState, {"d": drops}, device)
    for block, dtype, count in zip(made, (wp.float64, wp.float32), (rims, drops), strict=True):
        block.more = {one.name: wp.zeros(count, dtype=dtype, device=device) for one in features.carried}
    return made


Declared = tuple[str, "str | int | None", tuple[int, ...], "Callable[[Features], bool] | None"]


def carried_arrays(carried: Sequence[Carried], collects: bool = True) -> list[tuple[str, bool]]:
    """Names of arrays of what L carry, and whether only films whose rim collects have them."""
    return [(f"{q.name}{end}", bool(end)) for q in carried for end in (("", "_rim") if collects else ("",))]


def _start(one: ParticleSet, device, origin: np.ndarray | None) -> dict[str, wp.array]:
    """The arrays of a scene's own particles as they start."""
    held = {"x": one.x - (0.0 if origin is None else origin), **one.arrays}
    kinds = {1: wp.float32, 2: wp.vec3}
    return {name: wp.array(array, dtype=kinds[array.ndim], device=device) for name, array in held.items()}


def _kind_of(dtype) -> tuple[str, tuple[int, ...]]:
    """Kind of number, "f" or "i", and columns of a Warp type."""
    scalar = np.dtype(wp.dtype_to_numpy(getattr(dtype, "_wp_scalar_type_", dtype))).kind
    return scalar, getattr(dtype, "_shape_", ())


def declared(scene: Scene | Features | None = None) -> dict[str, Declared]:
    """What `State.numpy` may hold by name: "f" or "i" for the type, length as declared, columns, the films with it.

    Args:
        scene: the scene, where it brings along arrays of its own.
    """
    blocks = {
        "e": (EulerianState, None),
        "l": (LagrangianState, lambda f: f.lagrangian),
        "b": (BoundaryState, lambda f: f.rim),
        "f": (FreeRimState, lambda f: f.bursts),
        "d": (DropState, lambda f: f.bursts),
        "memory": (Memory, None),
    }
    found: dict[str, Declared] = {
        "gas": ("f", "r", (len(GAS_SLOTS),), None),
        "motion": ("f", "r", (3,), None),
        "border": ("f", len(BORDER_SLOTS), (), lambda f: f.collects),
        "ids.e": ("i", "e", (), None),
        "ids.l": ("i", "l", (), None),
        "ids.d": ("i", "d", (), lambda f: f.bursts),
        **{f"swept.{name}": (np.dtype(kind).kind, "h", (), lambda f: f.bursts) for name, kind in NAMES.items()},
        "origin": ("f", 3, (), None),
        "time": ("f", None, (), None),
        "frame": ("i", None, (), None),
    }
    for name, rim in carried_arrays(scene.carried) if scene is not None else ():
        found[f"l.{name}"] = "f", "l", (), (lambda f: f.collects) if rim else None
    for one in scene.carried if scene is not None else ():
        for kind in "fd":
            found[f"{kind}.{one.name}"] = "f", kind, (), lambda f: f.bursts
    for one in scene.sets if scene is not None else ():
        for name, array in {"x": one.x, **one.arrays}.items():
            found[f"{one.name}.{name}"] = "f", one.count, array.shape[1:], None
    for stage in scene.stages if scene is not None else ():
        for key, (dtype, size) in stage.remembers.items():
            kind, columns = _kind_of(dtype)
            found[f"memory.{stage.name}.{key}"] = kind, size, columns, None
    for block, (kind, when) in blocks.items():
        for f in fields(kind):
            if "dtype" in f.metadata:
                scalar, columns = _kind_of(f.metadata["dtype"])
                columns = (f.metadata["columns"],) if f.metadata["columns"] else columns
                found[f"{block}.{f.name}"] = scalar, f.metadata["size"], columns, f.metadata["when"] or when
    return found


class State:
    """The state of a film.

    Args:
        e: Eulerian particles.
        l: Lagrangian particles, or None.
        b: boundary particles, or None.
        f, d: points of free rims and drops; None for none, as at the start.
        regions: number of regions.
        features: what the film needs, and so remembers.
        origin: see below.
        time: s.

    Attributes:
        e, l, b: the particles; f and d, points of free rims and drops, where the film may burst, else None.
        gas: [regions, 6] float64, see `GAS_SLOTS`: volume (m^3), gauge pressure (Pa), amount n0 R T (J), pressure
            increment of the last step (Pa), area (m^2), normal offset that closed the volume in the last step (m).
        motion: [regions] velocity of a closed film as a whole, m/s: it changes by outside forces alone.
        border: [7] float64, see `BORDER_SLOTS`: liquid (kg) and surfactant of one interface (mol) that the rim of an
            open film has collected, and what it has taken from the flow along the film of momentum (kg m/s) and,
            where a budget is kept, of energy (J), of motion and of height and surfactant; None without a rim or L.
        carried: name -> [n_l] how much L hold of what the scene declares, and NAME_rim, what the rim has from each.
        declared: what that is.
        sets: name -> name -> [n] arrays of the scene's own particles.
        remembered: what the scene's own stages remember, STAGE.NAME.
        memory: what stages remember.
        course: what the host remembers.
        seen: how far particles had moved after the last steps, as the host sees it; see `NeighborLists`.
        ids: "e" and "l": [n] int64 number of each particle, the same for the whole run.
        swept: which L's liquid free rims and drops hold, see `melp_warp.stages.record.Swept`; {} without.
        origin: [3] float64, m: where positions are measured from. They are float32, which resolves 1e-7 of a distance:
            of that from the film, not from the world's origin.
        time: s.
        frame: index of the last finished frame.
    """

    def __init__(
        self,
        e: EulerianState,
        l: LagrangianState | None,  # noqa: E741
        b: BoundaryState | None,
        regions: int,
        features: Features,
        origin: np.ndarray | None = None,
        time: float = 0.0,
        f: FreeRimState | None = None,
        d: DropState | None = None,
    ):
        device = e.x.device
        self.e, self.l, self.b = e, l, b
        names = [name for name, *_ in carried_arrays(features.carried, features.collects)] if l else []
        self.carried = {name: wp.zeros(l.count, dtype=wp.float32, device=device) for name in names}
        self.declared = features.carried
        self.sets = {one.name: _start(one, device, origin) for one in features.sets}
        self.f, self.d = f, d
        if features.bursts and f is None:
            self.f, self.d = allocate_beads(0, 0, device, features)
        self.gas = wp.zeros((regions, len(GAS_SLOTS)), dtype=wp.float64, device=device)
        self.motion = wp.zeros(regions, dtype=wp.vec3, device=device)
        self.border = wp.zeros(len(BORDER_SLOTS), dtype=wp.float64, device=device) if features.collects else None
        self.memory = allocate(Memory, self.sizes, device, features)
        self.remembered = {
            f"{stage.name}.{key}": wp.zeros(self.sizes.get(size, size), dtype=dtype, device=device)
            for stage in features.stages
            for key, (dtype, size) in stage.remembers.items()
        }
        self.course = Course(crossed=time, mixed=time, left={one.name: 0.0 for one in features.carried})
        self.seen = Reading(self.memory.travel)
        self.ids = {"e": np.arange(e.count), "l": np.arange(l.count if l else 0)}
        if features.bursts:
            self.ids["d"] = np.arange(self.d.x.shape[0])
        self.swept = nothing() if features.bursts else {}
        self.origin = np.zeros(3) if origin is None else origin
        self.time, self.frame = time, 0

    @property
    def sizes(self) -> dict[str, int]:
        """Numbers of E ("e"), E with boundary particles ("n"), these ("b"), L ("l"), regions ("r"), parts ("p")."""
        n, regions = self.e.x.shape[0], self.gas.shape[0]
        return {
            "e": self.e.count,
            "n": n,
            "b": n - self.e.count,
            "l": self.l.count if self.l else 0,
            "f": self.f.x.shape[0] if self.f else 0,
            "d": self.d.x.shape[0] if self.d else 0,
            "r": regions,
            "p": count_parts(regions),
        }

    def arrays(self) -> dict[str, wp.array]:
        """All arrays by name, in a fixed order."""
        blocks = {"e": self.e, "l": self.l, "b": self.b, "f": self.f, "d": self.d, "memory": self.memory}
        named = {
            f"{block}.{k}": a for block, held in blocks.items() if held is not None for k, a in _arrays(held).items()
        }
        named |= {f"l.{name}": array for name, array in self.carried.items()}
        named |= {f"{one}.{name}": array for one, held in self.sets.items() for name, array in held.items()}
        named |= {f"memory.{name}": array for name, array in self.remembered.items()}
        named |= {"gas": self.gas, "motion": self.motion}
        return named if self.border is None else named | {"border": self.border}

    def numpy(self) -> dict[str, np.ndarray]:
        """All arrays and the place in time and space as NumPy copies; `course` and `seen` are not among them."""
        stored = {name: a.numpy().copy() for name, a in self.arrays().items()}
        stored |= {f"ids.{kind}": ids.copy() for kind, ids in self.ids.items()}
        stored |= {f"swept.{name}": array.copy() for name, array in self.swept.items()}
        return stored | {"origin": self.origin.copy(), "time": np.array(self.time), "frame": np.array(self.frame)}

    def load(self, stored: dict[str, np.ndarray]) -> None:
        """Take the values of `numpy()` back, in place; what is not there stays as it is."""
        for name, array in self.arrays().items():
            if name in stored:
                array.assign(stored[name])
        self.ids = {kind: stored.get(f"ids.{kind}", ids) for kind, ids in self.ids.items()}
        self.swept = {name: stored.get(f"swept.{name}", array) for name, array in self.swept.items()}
        self.origin = state_origin(stored)
        self.time = float(stored["time"])
        self.frame = int(stored["frame"])

    @property
    def fresh(self) -> bool:
        """Whether nothing is remembered: lists and fits are to be made where particles are now."""
        return self.course.builds == [0, 0]

    def forget(self) -> None:
        """Remember nothing: for particles that were put elsewhere by hand."""
        keep = ("area", "volume", "part", "lying", "book", "asked")  # they say how the run was set up, and what it did
        for name, array in _arrays(self.memory).items():
            if name not in keep:
                array.zero_()
        self.seen.refill([])
        was = self.course
        self.course = Course(
            **{
                name: getattr(was, name)
                for name in (
                    *("reach", "speed", "labels", "spilled", "pending", "unborn", "shown", "ledger", "punctured"),
                    *("torn", "holed", "gas", "run", "rest", "left", "tears", "issued", "sprayed", "spacing", "areas"),
                )
            },
            crossed=self.time,
            mixed=self.time,
        )


def state_origin(stored: dict[str, np.ndarray]) -> np.ndarray:
    """Where the positions of a stored state are measured from; the world's origin where nothing is said. [3], m."""
    return np.array(stored.get("origin", np.zeros(3)), dtype=np.float64)


class Snapshot:
    """A copy of a state on its own device, made once and overwritten at each good frame."""

    def __init__(self, state: State):
        self.state = state
        self._copies = {name: wp.empty_like(a) for name, a in state.arrays().items()}
        self.save()

    def save(self) -> None:
        """Copy the state here."""
        state = self.state
        self._beads = state.f, state.d
        for name, array in state.arrays().items():
            if self._copies[name].shape != array.shape:
                self._copies[name] = wp.empty_like(array)
            wp.copy(self._copies[name], array)
        self._rest = (copy.deepcopy(state.course), state.seen.contents())
        self._scalars = (dict(state.ids), dict(state.swept), state.origin, state.time, state.frame)

    def restore(self) -> None:
        """Copy the saved state back."""
        state = self.state
        state.f, state.d = self._beads
        for name, array in state.arrays().items():
            wp.copy(array, self._copies[name])
        course, seen = self._rest
        state.course = copy.deepcopy(course)
        state.seen.refill(seen)
        ids, swept, state.origin, state.time, state.frame = self._scalars
        state.ids, state.swept = dict(ids), dict(swept)
