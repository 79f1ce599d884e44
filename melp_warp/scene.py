"""What to simulate: a scene is a shape, its material, its surroundings, initial fields and numerics."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from melp_warp.bursting import Bursting
from melp_warp.carried import Carried
from melp_warp.cluster import Cluster
from melp_warp.errors import require
from melp_warp.keys import Key, at_least_zero, check_numbers, count, positive, quantity, word
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.particle_set import ParticleSet, check_sets
from melp_warp.scene_force import Force
from melp_warp.shapes import Shape
from melp_warp.stage import Stage, check_stages
from melp_warp.stages.air import AirModel, check_model

MOST_STEPS = 100_000
"""Steps that a frame may take."""

MOST_STEPS_AGAIN = 2000
"""Steps to which a frame that leaps is cut: one that wants more wants a smaller dt, or another scene."""

MOST_FRAMES = 999_999
"""Frames after the first: names of files have six digits."""

PointField = Callable[[np.ndarray], np.ndarray]
"""A field given by a function of points: [n, 3] (m) -> [n] or [n, 3], SI."""


SHOWN = ("nothing", "circulation")
"""What `Scene.show` may be."""


@dataclass(frozen=True)
class Scene:
    """Everything a run needs; checked when made.

    Attributes:
        name: short name, used in file names and messages.
        shape: the film's geometry, which samples the particles.
        e_count: as many as are wanted; the shape may round it, see `Shape.sample`.
        l_per_e: in a single layer it is always taken for 0.
        material: the liquid.
        surroundings: gravity, air, pressure.
        thickness: eta(x) in m; None for `material.thickness` everywhere.
        concentration: Gamma(x) in mol/m^2; None for `material.surfactant` everywhere.
        velocity: initial material velocity u(x) in m/s; None for rest.
        waves: shortest waves of the shape and of the fields where they are known, m, by the key that sets them. Fewer
            than five E spacings a wave are refused.
        numerics: discretisation choices.
        bursting: punctures, and what becomes of rims.
        forces: from outside, besides gravity: `Force`s, or Warp functions of place, time, velocity and thickness alone
            (docs/add-a-force.md).
        carried: what L carry besides liquid and surfactant (docs/carried.md).
        air_model: how much air moves along where `surroundings.air` says that it does (docs/air.md).
        stages: parts of the step of the scene's own, and
        sets: particles of its own, which these move (docs/stages.md).
        gas: (time in s, amount over that at the start) of a closed single film, times rising; in between linear. It is
            blown up or let out. Empty for the amount that it starts with.
        opening: area of a hole that is held open and through which gas leaves, m^2.
        slow_motion: how many times slower than usual time runs from frame to frame, from `slow_from` to `slow_until`.
        dt: None for a step set by `numerics.cfl`.
        show: "circulation" for a primvar of it, m^2/s; it changes nothing else.
        budget: whether the energy budget is kept (`melp_warp.stepping.budget`); it changes nothing else.
    """

    name: str
    shape: Shape
    # three supports' worth of the smallest support
    e_count: int = quantity(count("Eulerian particles", 12, 10_000_000))
    l_per_e: int = quantity(count("Lagrangian particles per Eulerian particle (0: none)", 0, 1000), 0)
    material: Material = field(default_factory=Material)
    surroundings: Surroundings = field(default_factory=Surroundings)
    thickness: PointField | None = None
    concentration: PointField | None = None
    velocity: PointField | None = None
    waves: Mapping[str, float] = field(default_factory=dict)
    numerics: Numerics = field(default_factory=Numerics)
    bursting: Bursting = field(default_factory=Bursting)
    forces: Sequence[Force] = ()
    carried: Sequence[Carried] = ()
    air_model: AirModel = field(default_factory=AirModel)
    stages: Sequence[type[Stage]] = ()
    sets: Sequence[ParticleSet] = ()
    frames: int = quantity(count("frames after the first", 0, MOST_FRAMES), 100)
    fps: float = quantity(positive("1/s", "frames per simulated second", 1e6), 60.0)
    dt: float | None = quantity(
        Key(
            "s", "largest time step (auto: set by cfl)", 0.0, 1.0, above=True, auto=True, spoken="ms", usual=(0.0, 0.2)
        ),
        None,
    )
    gas: Sequence[tuple[float, float]] = ()
    opening: float = quantity(
        at_least_zero("m^2", "area of an opening through which gas leaves (0: none)", 1.0, spoken="mm^2"),
        0.0,
    )
    slow_motion: float = quantity(
        Key("-", "factor by which frames are shorter in slow motion (1: none)", 1.0, 1e6), 1.0
    )
    slow_from: float = quantity(at_least_zero("s", "film time at which slow motion begins", 1e6, spoken="ms"), 0.0)
    slow_until: float | None = quantity(
        Key("s", "film time at which slow motion ends (auto: with the run)", 0.0, 1e6, auto=True, spoken="ms"), None
    )
    seed: int = quantity(count("seed of everything random", 0, 2**31 - 1), 0)
    show: str = quantity(word("what L carry that the cache shows besides", SHOWN), "nothing")
    budget: bool = True

    def __post_init__(self):
        check_numbers(self)
        object.__setattr__(self, "forces", tuple(map(Force.of, self.forces)))
        least = 1.0 / (self.fps * MOST_STEPS)
        allowed = f"at least {least:.3g} s, {MOST_STEPS:,} steps a frame"
        require(self.dt is None or self.dt >= least, "dt", self.dt, allowed)
        if self.numerics.layers == 1:
            object.__setattr__(self, "l_per_e", 0)
        self._check_carried()
        object.__setattr__(self, "stages", tuple(self.stages))
        object.__setattr__(self, "sets", tuple(self.sets))
        check_model(self.air_model)
        check_stages(self.stages)
        check_sets(self.sets)
        if self.bursts:
            self._check_bursting()
        self._check_gas()
        ends = self.slow_until is None or self.slow_until >= self.slow_from
        require(ends, "slow_until", self.slow_until, f"at least slow_from, {self.slow_from:g} s")
        closed = self.shape.closed
        require(closed or self.surroundings.lift == 0.0, "lift", self.surroundings.lift, "0 for an open film")
        if isinstance(self.shape, Cluster):
            self._check_foam()
        else:
            damping = self.surroundings.damping
            require(damping == 0.0, "damping", damping, "0 for a single film: it is of foams")

    @property
    def shown(self) -> dict[str, str]:
        """Names and units of what the cache shows of E and L besides what any has."""
        circulation = {"circulation": "m^2/s"} if self.show == "circulation" else {}
        return {one.name: one.unit for one in self.carried} | circulation

    def _check_carried(self) -> None:
        """Refuse what nothing carries."""
        object.__setattr__(self, "carried", tuple(self.carried))
        names = [getattr(one, "name", one) for one in self.carried]
        right = all(isinstance(one, Carried) for one in self.carried) and len(set(names)) == len(names)
        require(right, "carried", names, "Carried quantities, each name once")
        require(not names or self.l_per_e > 0, "carried", names, "none for a film without L: l_per_e at least 1")
        if self.show != "nothing":
            there = self.l_per_e > 0 and self.numerics.carrier == "circulation" and "circulation" not in names
            require(there, "show", self.show, "nothing where L do not carry it: carrier=circulation")

    def _check_gas(self) -> None:
        """Refuse gas that no film holds, or that does not say when how much there is."""
        object.__setattr__(self, "gas", tuple(tuple(map(float, frame)) for frame in self.gas))
        single = self.shape.closed and not isinstance(self.shape, Cluster)
        require(single or not self.gas, "gas", self.gas, "none but for a closed single film")
        require(single or self.opening == 0.0, "opening", self.opening, "0 but for a closed single film")
        require(not (self.gas and self.opening), "opening", self.opening, "0 where gas is given")
        times, amounts = ([frame[k] for frame in self.gas] for k in (0, 1))
        right = all(a < b for a, b in itertools.pairwise(times)) and all(map(math.isfinite, times))
        right = right and all(0.0 < a < 1e6 for a in amounts) and (not times or times[0] >= 0.0)
        require(right, "gas", self.gas, "times that rise from 0 s and amounts above 0")

    @property
    def bursts(self) -> bool:
        """Whether films may burst."""
        return self.bursting.possible or any(not event.delete for event in getattr(self.shape, "events", ()))

    @property
    def breathes(self) -> bool:
        """Whether gas comes or goes."""
        return bool(self.gas) or self.opening > 0.0

    @property
    def growth(self) -> float:
        """Number of particles at the most over that at the start, as far as it is known."""
        if isinstance(self.shape, Cluster):
            return self.shape.growth
        follows = self.numerics.respacing is not None
        return max([1.0, *(amount ** (2.0 / 3.0) for _, amount in self.gas)]) if follows else 1.0

    def film_time(self, frame: float) -> float:
        """Time at the end of a frame (0: the start), s; frames are shorter in slow motion."""
        shown = frame / self.fps
        if self.slow_motion == 1.0 or shown <= self.slow_from:
            return shown
        slow = (shown - self.slow_from) / self.slow_motion
        if self.slow_until is None or self.slow_from + slow <= self.slow_until:
            return self.slow_from + slow
        return shown - (self.slow_until - self.slow_from) * (self.slow_motion - 1.0)

    def tempo(self, frame: int) -> float:
        """Seconds of film time a second of what is shown, at a frame."""
        time = self.film_time(frame)
        slow = self.slow_from <= time and (self.slow_until is None or time < self.slow_until)
        return 1.0 / self.slow_motion if slow else 1.0

    def _check_bursting(self) -> None:
        """Refuse films that cannot burst, and holes that are too large."""
        layers = self.numerics.layers
        require(layers == 2, "layers", layers, "2 for a film that bursts")
        scheme = self.numerics.scheme
        require(scheme != "explicit", "scheme", scheme, "backward_euler or trapezoid for a film that bursts")
        most = 0.25 * math.sqrt(self.shape.area)
        for one in self.bursting.punctures:
            allowed = f"at most {most:.3g} m for this film"
            require(one.radius is None or one.radius <= most, "radius of a puncture", one.radius, allowed)

    def _check_foam(self) -> None:
        """Refuse what a foam has no use for, rather than leave it out in silence."""
        numerics, lift = self.numerics, self.surroundings.lift
        require(numerics.layers == 2, "layers", numerics.layers, "2 for a foam")
        require(numerics.scheme == "backward_euler", "scheme", numerics.scheme, "backward_euler for a foam")
        require(numerics.curvature == "mls", "curvature", numerics.curvature, "left at mls for a foam, which uses none")
        require(lift == 0.0, "lift", lift, "0 for a foam")
