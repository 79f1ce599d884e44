"""E and L that come and go with the area of a film, so that E stay as far apart as they were at the start.

Between frames, where the E of a region stand further apart, or nearer to each other, than `Numerics.respacing` allows:
E are put into the widest gaps or taken out where they are densest, evened out on the surface that was there, and
given what that surface's E had at their places. L are split or merged (recount.py), so that as many belong to an E as
before. See docs/bursting.md.
"""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from melp_warp.device.launch import launch
from melp_warp.kernels import advance as ka
from melp_warp.kernels import neighbors as kn
from melp_warp.measure.fits import close_pairs
from melp_warp.stages.advance import LagrangianAdvance, Redistribution
from melp_warp.stages.film import Film
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.neighbors import GRID_CELLS, NeighborList
from melp_warp.stages.state import AREA, VOLUME, State
from melp_warp.stepping.breath import breathed
from melp_warp.stepping.parts import NORMAL_MOTIONS
from melp_warp.stepping.recount import count_l
from melp_warp.stepping.sampling import film_of, relax, spatial_order, state_of
from melp_warp.stepping.stepper import Stepper, make_stepper
from melp_warp.stepping.topology import Stored

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation

SIDE = 1.6
"""Longest side of a triangle of E in whose middle an E may be put, spacings: next to nearest E are 1.86 apart."""

HALVINGS = 12
"""Halvings in which the distance is found at which so many points are chosen."""

FIT, WIDTH, NEAREST = 6, 0.9, 1.5
"""Terms of a quadratic fit over a plane; width of the weight exp(-(d/width)^2) of the E around, and distance of those
that its value is not to leave, spacings."""

SAME, OFFSETS = 2e-7, 5
"""Relative change of a volume that is none, and how often a film is offset at the most to have it."""

PART = 4096
"""Points that are fitted at once."""

REST, NEAR = 1e-3, 1.04
"""Change of a region's area in a frame, relative, below which it is at rest, and the factor to which its E are held
then: as many as the area asks for within 8 %."""


def even_choice(x: np.ndarray, count: int, size: float, rng: np.random.Generator) -> np.ndarray:
    """Choose `count` of the points x [n, 3], first come first served, as far apart as so many can be. [count] indices.

    Args:
        x: m, the ones that are wanted most first.
        count: how many, at most n.
        size: m, no two can be as far apart as four times this.
        rng: of the few more that fit, those that go are random.
    """
    low, high = 0.0, 4.0 * size
    chosen = np.arange(len(x))
    for _ in range(HALVINGS):
        apart = 0.5 * (low + high)
        fit = _apart(x, apart)
        low, high = (apart, high) if len(fit) >= count else (low, apart)
        chosen = fit if len(fit) >= count else chosen
    return np.sort(rng.permutation(chosen)[:count])


def _apart(x: np.ndarray, least: float) -> np.ndarray:
    """Indices of points x [n, 3] of which no two are nearer than `least` (m); the first of two is taken."""
    parts = [(i[first], j[first]) for i, j in close_pairs(x, least) for first in [i < j]]
    i, j = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    free, taken = np.ones(len(x), dtype=bool), np.zeros(len(x), dtype=bool)
    while free.any():
        best = free.copy()
        best[j[free[i]]] = False
        taken |= best
        free &= ~best
        free[j[best[i]]] = False
        left = free[i] & free[j]
        i, j = i[left], j[left]
    return np.flatnonzero(taken)


def gaps(x: np.ndarray, spacing: float) -> np.ndarray:
    """Middles of the triangles of near points x [n, 3], the widest first. [m, 3], m."""
    parts = list(close_pairs(x, SIDE * spacing))
    i, j = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    order = np.lexsort((j, i))
    i, j = i[order], j[order]
    column = np.arange(len(i)) - np.searchsorted(i, i)
    near = np.full((len(x), int(column.max(initial=0)) + 1), -1)
    near[i, column] = j
    found = []
    for a in range(near.shape[1]):
        for b in range(a + 1, near.shape[1]):
            corner = np.stack([np.arange(len(x)), near[:, a], near[:, b]], axis=1)
            corner = corner[(corner[:, 2] >= 0) & (corner[:, 0] < corner[:, 1])]  # rows are in order
            side = x[corner[:, 1]] - x[corner[:, 2]]
            found.append(corner[(side**2).sum(axis=1) < (SIDE * spacing) ** 2])
    corners = np.concatenate(found)
    middle = x[corners].mean(axis=1)
    width = ((x[corners] - middle[:, None]) ** 2).sum(axis=2).min(axis=1)
    return middle[np.argsort(-width, kind="stable")]


class Surface:
    """The surface of a film as its E have it, and what they hold, to be asked for at other points.

    Attributes:
        film, state: the film; `state` is to stay as it is.
    """

    def __init__(self, stepper: Stepper):
        self.film, self.state, self._stepper = stepper.film, stepper.state, stepper
        stepper.geometry.update()
        n, e = self.film.n_e, self.state.e
        self.x, self.normal, self.u = (a.numpy()[:n].astype(np.float64) for a in (e.x, e.normal, e.u))
        self.mass, self.surfactant = e.mass.numpy().astype(np.float64), e.surfactant.numpy().astype(np.float64)
        self.region, self.area = e.region.numpy()[:n], stepper.geometry.area.numpy().astype(np.float64)
        self.volume = self.state.gas.numpy()[:, VOLUME]
        self._grid = wp.HashGrid(GRID_CELLS, GRID_CELLS, GRID_CELLS, device=self.film.device)
        self._grid.build(e.x, self.film.r)

    def _rows(self, x: wp.array, region: wp.array, count: int) -> kn.Neighbors:
        """The E of the surface near points of these regions."""
        e, film = self.state.e, self.film
        both = (region, e.region) if film.regions > 1 else None
        return NeighborList(self._grid, x, count, e.x, film.r, kn.ALL, both).rows

    def take_up(self, x: wp.array, region: wp.array, count: int) -> None:
        """Put points onto the surface, in place."""
        film = self.film
        inputs = [self.state.e.x, self._stepper.geometry.surface, self._rows(x, region, count), film.r, film.n_e]
        launch(ka.project_l, count, inputs, [x], film.device)

    def at(self, x: wp.array, region: wp.array, count: int, values: np.ndarray) -> np.ndarray:
        """Values [n_e, k] of its E at points: by quadratic fits, and within those of the E around. [count, k]."""
        rows = self._rows(x, region, count)
        start, stop, index = (a.numpy() for a in (rows.start, rows.stop, rows.index))
        places, result = x.numpy()[:count].astype(np.float64), np.zeros((count, values.shape[1]))
        for part in np.array_split(np.arange(count), 1 + count // PART):
            column = np.arange((stop[part] - start[part]).max())
            place = np.minimum(start[part, None] + column, stop[part, None] - 1)
            there = (start[part, None] + column < stop[part, None]) & (index[place] < self.film.n_e)
            result[part] = self._fit(places[part], np.where(there, index[place], 0), there, values)
        return result

    def _fit(self, p: np.ndarray, near: np.ndarray, there: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Weighted quadratic fits about points p [m, 3] through values of the E `near` [m, k], where `there`."""
        way = (self.x[near] - p[:, None]) / self.film.spacing
        distance = np.linalg.norm(way, axis=2)
        first = np.argmin(np.where(there, distance, np.inf), axis=1)
        normal = self.normal[near[np.arange(len(p)), first]]
        one = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal), axis=1)])
        one /= np.linalg.norm(one, axis=1, keepdims=True)
        u, v = (np.einsum("mkj,mj->mk", way, axis) for axis in (one, np.cross(normal, one)))
        terms = np.stack([np.ones_like(u), u, v, u * u, u * v, v * v], axis=2)
        weight = np.where(there, np.exp(-((distance / WIDTH) ** 2)), 0.0)
        matrix = np.einsum("mk,mka,mkb->mab", weight, terms, terms) + 1e-9 * np.eye(FIT)
        held = values[near]
        right = np.einsum("mk,mka,mkc->mac", weight, terms, held)
        fitted = np.linalg.solve(matrix, right)[:, 0]
        close = (there & (distance < NEAREST))[..., None] | (np.arange(near.shape[1]) == first[:, None])[..., None]
        low = np.where(close, held, np.inf).min(axis=1)
        return np.clip(fitted, low, np.where(close, held, -np.inf).max(axis=1))


class Respacing:
    """The number of E of one run, as its areas change."""

    def __init__(self, simulation: Simulation):
        self._sim = simulation
        self._factor = simulation.scene.numerics.respacing

    def due(self) -> dict[int, int]:
        """Regions whose E are too far apart or too near to each other -> the number of E that they ought to have.

        None in flat films and single layers, nor while a film is torn: rims take E away.
        """
        sim = self._sim
        film, state = sim.film, sim.state
        features = film.features
        if not features.moving or features.carrier == "single_layer" or features.holed or state.course.tears:
            return {}
        target, then = state.course.spacing, np.array(state.course.areas)
        count = np.bincount(state.e.region.numpy()[: film.n_e], minlength=film.regions)
        area = state.gas.numpy()[:, AREA]
        growth = np.sqrt(area / count) / target
        resting = len(then) == len(area) and np.abs(area - then) < REST * area
        factor = np.where(resting, min(NEAR, self._factor), self._factor)
        state.course.areas = area.tolist()
        least = math.ceil(4.0 * math.pi * film.numerics.support**2)  # a sphere two supports across
        found = {}
        for k in np.flatnonzero((growth > factor) | (growth < 1.0 / factor)).tolist():
            wanted = max(round(area[k] / target**2), min(least, int(count[k])))
            if wanted != count[k]:
                found[k] = wanted
        return found

    def follow(self) -> bool:
        """Between frames: have as many E as the areas ask for; whether that are others than before."""
        wanted = self.due()
        if not wanted:
            return False
        sim = self._sim
        with sim.new_account("respacing"):
            surface, stored = Surface(sim.stepper), Stored.of(sim.state)
            rng = np.random.default_rng([sim.scene.seed, sim.state.frame, len(stored.ids["e"])])
            count = {k: int((surface.region == k).sum()) for k in wanted}
            for k, number in wanted.items():
                self._change_e(stored, surface, k, number, rng)
                if "l" in stored.kinds:
                    own = int(((stored.region("l") == k) & (stored.arrays["l.mass"] > 0.0)).sum())
                    count_l(stored, k, round(own * number / count[k]), sim.scene.material.density, rng)
            self._go_on(stored, surface)
        return True

    def _change_e(self, stored: Stored, surface: Surface, k: int, wanted: int, rng: np.random.Generator) -> None:
        """Put E into region k, or take some out, until there are `wanted`; their values are found later."""
        n = len(stored.arrays["e.mass"])
        own = np.flatnonzero(stored.region("e")[:n] == k)
        x, missing = stored.arrays["e.x"][own].astype(np.float64), wanted - len(own)
        spacing = math.sqrt(surface.area[surface.region == k].sum() / len(own))
        if missing < 0:
            density = self._sim.stepper.geometry.density.numpy()[surface.region == k]
            order = np.argsort(-density, kind="stable")
            gone = own[order[even_choice(x[order], -missing, spacing, rng)]]
            kept = np.delete(np.arange(n), gone)
            self._store(stored, kept, np.zeros((0, 3)), k)
            return
        middles = gaps(x, spacing)
        missing = min(missing, len(middles))
        self._store(stored, np.arange(n), middles[even_choice(middles, missing, spacing, rng)], k)

    def _store(self, stored: Stored, kept: np.ndarray, new: np.ndarray, k: int) -> None:
        """Keep some E and add `new` [m, 3] to region k, in spatial order, region by region."""
        arrays = stored.arrays
        n = len(arrays["e.mass"])
        x = np.concatenate([arrays["e.x"][kept], new])
        like = np.concatenate([kept, _nearest(new, arrays["e.x"][:n], stored.region("e")[:n] == k)])
        region = stored.region("e")[like]
        order = spatial_order(x, self._sim.state.course.spacing)
        order = order[np.argsort(region[order], kind="stable")]
        for name in [name for name in arrays if name.startswith("e.")]:
            array = arrays[name]
            values = x.astype(array.dtype) if name == "e.x" else array[like]
            arrays[name] = np.concatenate([values[order], array[n:]])
        stored.ids["e"] = np.concatenate([stored.ids["e"][kept], stored.issue("e", len(new))])[order]

    def _go_on(self, stored: Stored, surface: Surface) -> None:
        """Set the run up for what is stored: E evened out on the surface that was, with what was at their places."""
        sim = self._sim
        state = state_of(sim.scene, stored.arrays, len(stored.labels), sim.device)
        state.ids, state.swept, state.course = stored.ids, stored.swept.held, sim.state.course
        state.course.issued = stored.issued
        for name, array in state.remembered.items():
            if array.shape == sim.state.remembered[name].shape:
                wp.copy(array, sim.state.remembered[name])
        state.forget()
        n, e = len(stored.ids["e"]), state.e
        film = self._film(state)

        def put_back() -> None:
            surface.take_up(e.x, e.region, n)

        put_back()
        normal = NORMAL_MOTIONS[film.features.normal]
        lists = normal.lists(film, state)
        geometry = normal.geometry(film, state, lists)
        geometry.update()
        relax(Redistribution(film, state, lists, geometry), put_back)
        self._keep_volume(geometry, surface)
        if state.l is not None:
            lists.rebuild_l()
            LagrangianAdvance(film, state, lists, geometry).project()
        wall = sim.stepper.wall
        state.forget()
        sim.stepper = make_stepper(film, state)
        sim.stepper.wall = wall
        self._give_values(sim.stepper, surface)
        state.course.reach = sim._longest_way()

    def _film(self, state: State) -> Film:
        """The film around a state of other counts; a closed one is of the size and the spacing that it has now."""
        sim = self._sim
        was = sim.film
        film = film_of(sim.scene, state, was.spacing, was.room, was.radius)
        return breathed(film, state) if was.features.floats else film

    @staticmethod
    def _keep_volume(geometry: Geometry, surface: Surface) -> None:
        """Move E evenly along their normals until each region encloses what it did."""
        film, state = geometry.film, geometry.state
        e, n = state.e, film.n_e
        for _ in range(OFFSETS if film.features.closed else 0):
            gas = state.gas.numpy()
            lack = surface.volume - gas[:, VOLUME]
            if (np.abs(lack) < SAME * surface.volume).all():
                break
            x = e.x.numpy()
            x[:n] += (lack / gas[:, AREA])[e.region.numpy()[:n], None] * e.normal.numpy()[:n]
            e.x.assign(x)
            geometry.lists.rebuild_e()
            geometry.update()

    def _give_values(self, stepper: Stepper, surface: Surface) -> None:
        """Give E the velocity that the surface had at their places, and where there are no L its liquid."""
        film, state = stepper.film, stepper.state
        e, n = state.e, film.n_e
        speed = (surface.u * surface.normal).sum(axis=1)
        layer = np.stack([surface.mass, surface.surfactant], axis=1) / surface.area[:, None]
        found = surface.at(e.x, e.region, n, np.concatenate([surface.u, speed[:, None], layer], axis=1))
        region = e.region.numpy()[:n]
        parts = [(region == k, surface.region == k) for k in range(film.regions)]
        if state.l is None:
            held = found[:, 4:] * stepper.geometry.area.numpy()[:, None]
            for (own, was), (slot, before) in product(parts, enumerate((surface.mass, surface.surfactant))):
                held[own, slot] *= before[was].sum() / max(held[own, slot].sum(), 1e-300)
            e.mass.assign(held[:, 0])
            e.surfactant.assign(held[:, 1])
        else:
            stepper.transfer.gather()
        normal, mass = e.normal.numpy()[:n].astype(np.float64), e.mass.numpy().astype(np.float64)
        across = found[:, 3]
        for own, was in parts:
            lacks = ((surface.mass * speed)[was, None] * surface.normal[was]).sum(axis=0)
            lacks -= ((mass * across)[own, None] * normal[own]).sum(axis=0)
            outer = np.einsum("n,ni,nj->ij", mass[own], normal[own], normal[own])
            across[own] += normal[own] @ np.linalg.solve(outer, lacks)
        along = found[:, :3] - (found[:, :3] * normal).sum(axis=1, keepdims=True) * normal
        u = e.u.numpy()
        u[:n] = across[:, None] * normal + (along if state.l is not None else 0.0)
        e.u.assign(u)


def _nearest(points: np.ndarray, x: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Index of the nearest of x [n, 3] among its `own` (mask), for each point. [m]."""
    where = np.flatnonzero(own)
    if not len(points):
        return np.zeros(0, dtype=int)
    parts = np.array_split(points, 1 + len(points) * len(where) // 2_000_000)
    return where[np.concatenate([((p[:, None] - x[where]) ** 2).sum(axis=2).argmin(axis=1) for p in parts])]
