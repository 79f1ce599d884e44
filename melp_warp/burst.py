"""When films burst, and what the host does about it between steps: holes, rims that meet, drops, film that is gone.

Works on a state as `State.numpy` gives it and gives one of other sizes back, from which the run is set up anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from melp_warp.bursting import Puncture
from melp_warp.errors import InputError, SimulationError
from melp_warp.free_rim import REACH, RIM_CFL, SIGHT
from melp_warp.kernels import free_rim as kr
from melp_warp.launch import launch
from melp_warp.surgery import Stored

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation

POINTS = 0.5
"""Distance of the points of a rim, spacings: two E spacings hold four rows of L."""

TURN = 1.0
"""Way of a rim after which what is behind it is taken away, spacings."""

MEET = 2.2 * RIM_CFL
"""Distance at which rims that run at each other have met, spacings: they come no closer unseen."""

PIECE = 1.8
"""Distance within which E belong to one piece of film, and within which that has a rim, spacings."""

FRAME = 0.5
"""Distance from a frame at which a rim has come to it, spacings."""

FEWEST = 4
"""Points of the shortest rim; E of the smallest film."""

ROUND = 24
"""Points of a small hole."""

RAYLEIGH = 9.01
"""Length of a thread that becomes a drop, in its radii (the fastest of its waves)."""

STEADY = 0.87
"""Cosine of half the angle between points of a rim beyond which they hit each other."""

UNEVEN = 0.3
"""Relative spread of the growth at which points of a rim break, so that they do not break all at once."""

POINT = ("x", "u", "inertia", "mass", "surfactant", "normal", "flow", "film", "growth", "limit")
"""What the points of a rim hold besides their places in a chain."""

SUMS = ("inertia", "mass", "surfactant")
"""What of that adds up."""


class Burst:
    """The holes of one run; what is still to come is in the state, see `Course`."""

    def __init__(self, simulation: Simulation):
        self.scene = simulation.scene
        self._sim = simulation
        self._opened: int | None = None
        self._moved = False

    @property
    def pending(self) -> list[Puncture]:
        """Punctures to come, in order of time."""
        return list(self.scene.bursting.punctures[self._sim.state.course.punctured :])

    def following(self) -> float | None:
        """Time of the next puncture that is not due yet, s; None for none."""
        later = [one.time for one in self.pending if one.time > self._sim.time + 1e-12]
        return min(later, default=None)

    def longest_step(self) -> float:
        """Step in which the fastest rim runs `RIM_CFL` spacings, s."""
        sim = self._sim
        edge = sim.stepper.edge if sim.film.features.holed and not sim.gone else None
        speed = edge.fastest() if edge is not None else 0.0
        return RIM_CFL * sim.film.spacing / speed if speed > 0.0 else np.inf

    def begin(self) -> None:
        """Once the run is set up anew: the rim of a new hole takes what was there."""
        sim, first = self._sim, self._opened
        self._opened = None
        if first is not None:
            sim.stepper.edge.sweep()
            inertia = sim.state.f.inertia.numpy()
            inertia[first:] = sim.state.f.mass.numpy()[first:].mean()
            sim.state.f.inertia.assign(inertia)

    def after_step(self, dt: float) -> None:
        """Count how far the rims have run, and let drops fly."""
        sim = self._sim
        if sim.film.features.holed and not sim.gone:
            speed = sim.stepper.edge.fastest()
            if not np.isfinite(speed):
                raise SimulationError("stage rim: a point of a free rim is not finite")
            sim.state.course.run += dt * speed
            self._moved = True
        drops, air = sim.state.d, sim.scene.surroundings
        density = air.air_density if air.air != "none" else 0.0
        inputs = [drops.mass, sim.scene.material.density, density, sim.film.gravity, dt]
        launch(kr.fly_d, drops.x.shape[0], inputs, [drops.x, drops.u], sim.device)

    def due(self) -> Callable[[Stored], None] | None:
        """The change to carry out now, None for none."""
        sim = self._sim
        course = sim.state.course
        if sim.gone:
            return None
        waiting = self.pending
        if waiting and waiting[0].time <= sim.time + 1e-12:
            course.punctured += 1
            return self._puncture(waiting[0])
        thin = self._thinnest()
        if thin is not None:
            return self._puncture(Puncture(tuple(thin.tolist()), sim.time))
        if self._moved and (course.run >= TURN * sim.film.spacing or self._meeting()):
            self._moved = False  # once a step
            return self._tidy
        return None

    def _meeting(self) -> bool:
        """Whether rims have met since they were last put in order."""
        sim, rim = self._sim, self._sim.state.f
        stored = {f"f.{name}": getattr(rim, name).numpy() for name in (*POINT, "after", "before")}
        x = stored["f.x"]
        if sim.film.rim is not None and self._at_frame(x).any():
            return True
        return bool(Rims.of(stored).meet(MEET * sim.film.spacing).any())

    def _thinnest(self) -> np.ndarray | None:
        """Place of the thinnest film, where it is thinner than it holds. [3], m."""
        least = self.scene.bursting.rupture_thickness
        if least == 0.0:
            return None
        sim = self._sim
        sim.stepper.fields.update()
        eta = sim.stepper.fields.eta.numpy()[: sim.film.n_e]
        if sim.film.features.holed:
            e = sim.state.e
            far = (e.behind.numpy() == 0) & (sim.stepper.edge.edge.numpy()[:, 3] > REACH * sim.film.spacing)
            eta = np.where(far, eta, np.inf)
        i = int(np.argmin(eta))
        return sim.state.e.x.numpy()[i] + sim.state.origin if eta[i] < least else None

    # --- what is told ------------------------------------------------------------------------------------------------

    def diagnostics(self) -> dict:
        """What a line of the log says of holes: liquid (kg) by where it is, and the rims."""
        state = self._sim.state
        rim = state.f
        rims = Rims.of({f"f.{name}": getattr(rim, name).numpy() for name in (*POINT, "after", "before")})
        return {
            "rims": len(rims.chains),
            "rim_length": float(rims.halves().sum()) if rims.chains else 0.0,
            "rim_mass": float(rim.mass.numpy().sum()),
            "rim_speed": float(np.linalg.norm(rim.u.numpy(), axis=1).max(initial=0.0)),
            "drops": state.sizes["d"],
            "drop_mass": float(state.d.mass.numpy().sum(dtype=np.float64)),
            "frame_mass": state.course.rest,
        }

    def sums(self) -> np.ndarray:
        """The sums of `kernels.diagnostics.summarize_chunks` over the film that is there. [12]."""
        sim = self._sim
        e, lag, density = sim.state.e, sim.state.l, sim.scene.material.density
        if lag is None:
            there = e.swept.numpy() == 0
            parts = [e.mass, e.surfactant, e.u, e.u, sim.stepper.fields.eta]
        else:
            there = lag.behind.numpy() == 0
            parts = [lag.mass, lag.surfactant, lag.u, lag.v, lag.eta]
        mass, amount, u, v, eta = (a.numpy()[: len(there)][there].astype(np.float64) for a in parts)
        area = mass / (density * eta)
        speed = (v**2).sum(axis=1)
        low, high = (eta.min(), eta.max()) if len(eta) else (0.0, 0.0)
        return np.array(
            [
                *(mass.sum(), amount.sum(), *(mass[:, None] * u).sum(axis=0), 0.5 * (mass * speed).sum()),
                *(speed.max(initial=0.0), low, high, (area * eta).sum(), area.sum(), (area * eta**2).sum()),
            ]
        )

    # --- holes ------------------------------------------------------------------------------------------------------

    def _puncture(self, one: Puncture) -> Callable[[Stored], None] | None:
        """Make a hole."""
        sim = self._sim
        film, e = sim.film, sim.state.e
        n = film.n_e
        x = e.x.numpy()[:n].astype(np.float64)
        place = np.array(one.place) - sim.state.origin
        away = np.linalg.norm(x - place, axis=1)
        if film.features.holed:
            away = np.where(e.behind.numpy() == 0, away, np.inf)
        i = int(np.argmin(away))
        size = float(np.sqrt(sim.scene.shape.area))
        radius = film.spacing if one.radius is None else one.radius
        if not away[i] <= max(0.25 * size, film.spacing):
            where = ", ".join(f"{c:g}" for c in one.place)
            text = f"the puncture at {where} at {one.time:g} s is {away[i]:.3g} m off the film: nothing happens"
            sim.notices.note("puncture without effect", 1.0, text)
            return None
        if radius > 0.25 * size:
            raise InputError(f"radius of a puncture must be at most {0.25 * size:.3g} m for this film, got {radius:g}")
        normal = e.normal.numpy()[i].astype(np.float64)
        m = sim.scene.material
        sim.stepper.fields.update()
        gamma, eta = (float(a.numpy()[i]) for a in (sim.stepper.fields.gamma, sim.stepper.fields.eta))
        speed = np.sqrt(2.0 * (m.tension - film.slope * gamma) / (m.density * eta))
        centre = place - ((place - x[i]) @ normal) * normal
        if np.linalg.norm(centre - x[i]) > film.spacing:
            centre = x[i]
        end = centre if one.end is None else np.array(one.end) - sim.state.origin
        ring = _ring(centre, end, normal, radius, POINTS * film.spacing)
        nearest = np.concatenate([np.argmin(_squares(part, x), axis=1) for part in np.array_split(ring, len(ring))])
        normals = e.normal.numpy()[nearest].astype(np.float64)
        ring -= (((ring - x[nearest]) * normals).sum(axis=1, keepdims=True)) * normals
        flow = e.u.numpy()[nearest]
        seen = np.tile([gamma, eta], (len(ring), 1))
        return lambda stored: self._open(stored, ring, normals, flow, seen, speed)

    def _open(self, stored, ring, normals, flow, seen, speed) -> None:
        """Put a rim into the state; its liquid is what it finds behind it when it first looks."""
        arrays, k = stored.arrays, len(ring)
        old = len(arrays["f.x"])
        rng = np.random.default_rng([self.scene.seed, old, self._sim.state.course.punctured, k])
        new = {name: np.zeros((k, *arrays[f"f.{name}"].shape[1:])) for name in POINT}
        new |= {"x": ring, "normal": normals, "flow": flow, "film": seen, "limit": _limits(k, rng)}
        out = np.cross(np.roll(ring, -1, axis=0) - np.roll(ring, 1, axis=0), normals)
        new["u"] = flow + speed * out / np.linalg.norm(out, axis=1, keepdims=True)
        for name, values in new.items():
            was = arrays[f"f.{name}"]
            arrays[f"f.{name}"] = np.concatenate([was, values.astype(was.dtype)])
        index = np.arange(k)
        for name, step in (("after", 1), ("before", -1)):
            links = old + np.roll(index, -step)
            arrays[f"f.{name}"] = np.concatenate([arrays[f"f.{name}"], links.astype(np.int32)])
        self._opened = old

    # --- rims that run ----------------------------------------------------------------------------------------------

    def _tidy(self, stored: Stored) -> None:
        """Take away what rims have passed, break rims and join them, keep their points apart."""
        sim = self._sim
        spacing = sim.film.spacing
        moment = int(np.float64(sim.state.time).view(np.uint64))  # the same in a run that goes on from here
        rng = np.random.default_rng([self.scene.seed, moment, len(stored.arrays["f.x"])])
        rims = Rims.of(stored.arrays)
        self._break(stored, rims, rng)
        frame = self._at_frame(rims.point["x"])
        self._collect(stored, rims, frame)
        met = (rims.meet(MEET * spacing) | self._blind(stored, rims.point["x"])) & ~frame
        self._close(stored, rims, np.flatnonzero(met))
        ended = rims.cut(met | frame, met, POINTS * spacing)
        if met.any():
            ended += self._islands(stored, rims)
        self._spray(stored, ended)
        rims.even(POINTS * spacing, rng)
        rims.store(stored.arrays)
        sim.state.course.run = 0.0
        if not rims.chains or self._live(stored) < FEWEST:
            self._finish(stored, rims)
            return
        self._drop_film(stored)

    def _live(self, stored: Stored) -> int:
        return int((stored.arrays["e.behind"] == 0).sum())

    def _break(self, stored: Stored, rims: Rims, rng: np.random.Generator) -> None:
        """Let the points whose waves have grown break into drops, and go on empty."""
        limit = self.scene.bursting.breakup
        if limit == 0.0:
            return
        point = rims.point
        broken = (point["growth"] > limit * point["limit"]) & (point["mass"] > 0.0)
        if not broken.any():
            return
        for run in rims.runs(broken):
            self._spray(stored, [rims.thread(run)])
        for name in (*SUMS, "growth"):
            point[name][broken] = 0.0
        point["limit"][broken] = _limits(int(broken.sum()), rng)

    def _close(self, stored: Stored, rims: Rims, met: np.ndarray) -> None:
        """Give the film that is left between rims that have met to their points `met`."""
        if not len(met):
            return
        arrays, place = stored.arrays, rims.point["x"][met]
        kind, flag = ("l", "l.behind") if "l.x" in arrays else ("e", "e.swept")
        for name in {flag, "e.behind"}:
            which = name[0]
            there = np.flatnonzero(arrays[name] == 0)
            away = _distances(arrays[f"{which}.x"][there], place)
            between = there[away < 0.5 * MEET * self._sim.film.spacing]
            if name == flag and len(between):
                nearest = met[np.argmin(_squares(arrays[f"{kind}.x"][between], place), axis=1)]
                for what in ("mass", "surfactant"):
                    np.add.at(rims.point[what], nearest, arrays[f"{kind}.{what}"][between].astype(np.float64))
            arrays[name][between] = 1

    def _islands(self, stored: Stored, rims: Rims) -> list[Thread]:
        """The liquid of pieces of film that no rim is near any more: they are too small for one."""
        arrays, n, spacing = stored.arrays, self._sim.film.n_e, self._sim.film.spacing
        x, live = arrays["e.x"][:n], arrays["e.behind"] == 0
        rows = self._sim.stepper.lists.ee.rows
        start, stop, index = (a.numpy() for a in (rows.start, rows.stop, rows.index))
        count = stop - start
        i = np.repeat(np.arange(n), count)
        j = index[np.repeat(start, count) + np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count)]
        near = (j < n) & live[i]
        i, j = i[near], j[near]
        near = live[j] & (((x[i] - x[j]) ** 2).sum(axis=1) < (PIECE * spacing) ** 2)
        piece = _pieces(n, i[near], j[near])
        points = np.concatenate([rims.point["x"][chain.index] for chain in rims.chains] or [np.zeros((0, 3))])
        held = np.zeros(n, dtype=bool)
        if len(points):
            held[piece[live & (_distances(x, points) < PIECE * spacing)]] = True
        lost = live & ~held[piece]
        return [self._take(stored, lost & (piece == k)) for k in np.unique(piece[lost])]

    def _take(self, stored: Stored, lost: np.ndarray) -> Thread:
        """Take the film of the E of the mask `lost` [n_e] away; its liquid."""
        arrays = stored.arrays
        arrays["e.behind"][lost] = 1
        if "l.x" in arrays:
            kind, flag, there = "l", "l.behind", lost[self._sim.stepper.lists.le.home.numpy()]
        else:
            kind, flag, there = "e", "e.swept", lost
        there = there & (arrays[flag] == 0)
        arrays[flag][there] = 1
        x, u, mass, amount = (
            arrays[f"{kind}.{name}"][: len(there)][there].astype(np.float64)
            for name in ("x", "u", "mass", "surfactant")
        )
        return Thread(x, u, mass, amount, np.full(len(x), self._sim.film.spacing))

    def _blind(self, stored: Stored, x: np.ndarray) -> np.ndarray:
        """[n] whether points have no film before them any more."""
        there = stored.arrays["e.x"][: self._sim.film.n_e][stored.arrays["e.behind"] == 0]
        return _distances(x, there) > SIGHT * self._sim.film.spacing if len(there) else np.ones(len(x), dtype=bool)

    def _at_frame(self, x: np.ndarray) -> np.ndarray:
        """[n] whether points have come to the frame of an open film."""
        held = self._sim.film.rim
        if held is None or not len(x):
            return np.zeros(len(x), dtype=bool)
        anchors, outward = held.anchors.numpy(), held.outward.numpy()
        near = np.argmin(_squares(x, anchors), axis=1)
        beyond = ((x - anchors[near]) * outward[near]).sum(axis=1)
        return beyond > -FRAME * self._sim.film.spacing

    def _collect(self, stored: Stored, rims: Rims, frame: np.ndarray) -> None:
        """Leave to the frame what has come to it."""
        self._sim.state.course.rest += float(rims.point["mass"][frame].sum())
        for name in SUMS:
            rims.point[name][frame] = 0.0

    def _spray(self, stored: Stored, threads: list[Thread]) -> None:
        """Break threads of liquid into drops, as many as the fastest wave makes of them; sums are kept."""
        arrays, density = stored.arrays, self.scene.material.density
        made = [thread.drops(density) for thread in threads if thread.mass.sum() > 0.0]
        if not made:
            return
        first = int(stored.ids["d"].max(initial=-1)) + 1
        for name in ("x", "u", "mass", "surfactant"):
            new = np.concatenate([drops[name] for drops in made])
            was = arrays[f"d.{name}"]
            arrays[f"d.{name}"] = np.concatenate([was, new.astype(was.dtype)])
        count = len(arrays["d.x"]) - len(stored.ids["d"])
        stored.ids["d"] = np.concatenate([stored.ids["d"], np.arange(first, first + count)])

    def _drop_film(self, stored: Stored) -> None:
        """Take away the film that is far behind the rims."""
        film, arrays = self._sim.film, stored.arrays
        behind = np.flatnonzero(arrays["e.behind"] == 1)
        kept = np.ones(film.n_e, dtype=bool)
        if len(behind):
            away = _distances(arrays["e.x"][behind], arrays["f.x"])
            kept[behind[away > film.r + POINTS * film.spacing]] = False
        if kept.all():
            return
        if "l.x" in arrays:
            home = self._sim.stepper.lists.le.home.numpy()
            lost = ~kept[home] & (arrays["l.behind"] == 0)
            self._take_lost(stored, lost)
            stored.select("l", kept[home])
        keep_e(stored, kept)

    def _take_lost(self, stored: Stored, lost: np.ndarray) -> None:
        """Leave the liquid of L [n_l] without film to the frame, or without one to the rims nearest to them."""
        arrays = stored.arrays
        mass = arrays["l.mass"][lost].astype(np.float64)
        if self._sim.film.rim is not None:
            self._sim.state.course.rest += float(mass.sum())
        elif lost.any():
            nearest = np.argmin(_squares(arrays["l.x"][lost], arrays["f.x"]), axis=1)
            np.add.at(arrays["f.mass"], nearest, mass)
            np.add.at(arrays["f.surfactant"], nearest, arrays["l.surfactant"][lost].astype(np.float64))

    def _finish(self, stored: Stored, rims: Rims) -> None:
        """The last of the film and of its rims: into the frame where there is one, else into drops."""
        arrays = stored.arrays
        kind = "l" if "l.x" in arrays else "e"
        left = arrays[f"{kind}.{'behind' if kind == 'l' else 'swept'}"] == 0
        mass = arrays[f"{kind}.mass"][left].astype(np.float64)
        threads = [rims.thread(chain.index) for chain in rims.chains]
        if self._sim.film.rim is not None:
            self._sim.state.course.rest += float(mass.sum()) + float(sum(one.mass.sum() for one in threads))
        else:
            threads.append(self._take(stored, np.ones(len(arrays["e.mass"]), dtype=bool)))
            self._spray(stored, threads)
        for name in (*POINT, "after", "before"):
            arrays[f"f.{name}"] = arrays[f"f.{name}"][:0]
        if kind == "l":
            stored.select("l", np.zeros(len(left), dtype=bool))
        keep_e(stored, np.zeros(len(arrays["e.mass"]), dtype=bool))
        for name in [name for name in arrays if name.startswith("e.")]:
            arrays[name] = arrays[name][:0]
        arrays.pop("b.mirror", None)
        stored.drop_region(0)


def keep_e(stored: Stored, kept: np.ndarray) -> None:
    """Keep the E of the mask `kept` [n_e], and all boundary particles."""
    arrays, n = stored.arrays, len(kept)
    all_kept = np.concatenate([kept, np.ones(len(arrays["e.x"]) - n, dtype=bool)])
    for name, array in arrays.items():
        if name.startswith("e."):
            arrays[name] = array[all_kept if len(array) == len(all_kept) else kept]
    if "memory.area" in arrays:
        arrays["memory.area"] = arrays["memory.area"][kept]
    stored.ids["e"] = stored.ids["e"][kept]


def _ring(start: np.ndarray, end: np.ndarray, normal: np.ndarray, radius: float, length: float) -> np.ndarray:
    """Points around a line from start to end, counterclockwise as the normal sees it: a circle where both are one."""
    way = end - start
    way -= (way @ normal) * normal
    reach = float(np.linalg.norm(way))
    first = way / reach if reach > 0.0 else np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    half = max(ROUND, round(2.0 * np.pi * radius / length)) // 2
    angle = np.pi * ((np.arange(half) + 0.5) / half - 0.5)[:, None]
    cap = radius * (np.cos(angle) * first + np.sin(angle) * second)
    steps = ((np.arange(1, round(reach / length))) * length / max(reach, length))[:, None]
    side = radius * second
    parts = [end + cap, end + side - steps * way, start - cap, start - side + steps * way]
    return np.concatenate(parts)


def _pieces(n: int, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """[n] least index of those that each is connected with by pairs i, j, given both ways."""
    piece = np.arange(n)
    while True:
        least = piece.copy()
        np.minimum.at(least, i, piece[j])
        least = least[least]
        if np.array_equal(least, piece):
            return piece
        piece = least


def _squares(x: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Squared distances of x [n, 3] from points [m, 3]. [n, m]."""
    return ((x[:, None] - points[None]) ** 2).sum(axis=2)


def _limits(count: int, rng: np.random.Generator) -> np.ndarray:
    """Growth at which points break, over the scene's. [count]."""
    return 1.0 + UNEVEN * rng.uniform(-1.0, 1.0, count)


def _distances(x: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distance of each of x [n, 3] from the nearest of some points, m."""
    parts = np.array_split(x.astype(np.float64), 1 + len(x) * len(points) // 2_000_000)
    return np.concatenate([np.sqrt(_squares(p, points).min(axis=1)) for p in parts])


@dataclass
class Thread:
    """A thread of liquid: points in order with what each holds.

    Attributes:
        x: [n, 3] m.
        u: [n, 3] m/s.
        mass: [n] kg.
        surfactant: [n] mol.
        length: [n] share of the thread's length, m.
    """

    x: np.ndarray
    u: np.ndarray
    mass: np.ndarray
    surfactant: np.ndarray
    length: np.ndarray

    def drops(self, density: float) -> dict[str, np.ndarray]:
        """What the thread breaks into: drops as far apart as its fastest wave is long, which keep all sums."""
        mass, length = self.mass.sum(), self.length.sum()
        radius = np.sqrt(mass / (np.pi * density * length))
        count = max(1, round(length / (RAYLEIGH * radius)))
        along = np.cumsum(self.length) - 0.5 * self.length
        edges = np.concatenate([[0.0], np.cumsum(self.mass)]) / mass
        bounds = np.linspace(0.0, 1.0, count + 1)
        share = np.clip(
            np.minimum(bounds[1:, None], edges[None, 1:]) - np.maximum(bounds[:-1, None], edges[None, :-1]), 0.0, None
        )
        share *= mass / np.where(self.mass > 0.0, self.mass, 1.0)[None]  # [drops, points] part of what a point holds
        drop = share @ self.mass
        middle = (np.arange(count) + 0.5) / count * length
        x = np.stack([np.interp(middle, along, self.x[:, c]) for c in range(3)], axis=1)
        return {
            "x": x,
            "u": (share @ (self.mass[:, None] * self.u)) / drop[:, None],
            "mass": drop,
            "surfactant": share @ self.surfactant,
        }


@dataclass
class Chain:
    """A rim: indices of its points in order, and whether it is a loop; one that is not ends at a frame."""

    index: np.ndarray
    loop: bool


class Rims:
    """All rims, on the host.

    Attributes:
        point: what their points hold, by name.
        chains: their order.
    """

    def __init__(self, point: dict[str, np.ndarray], chains: list[Chain]):
        self.point, self.chains = point, chains

    @classmethod
    def of(cls, arrays: dict[str, np.ndarray]) -> Rims:
        """The rims of a stored state, in float64."""
        point = {name: arrays[f"f.{name}"].astype(np.float64) for name in POINT}
        after, before = arrays["f.after"], arrays["f.before"]
        left, chains = np.ones(len(after), dtype=bool), []
        for start in [*np.flatnonzero(before < 0).tolist(), *range(len(after))]:
            if left[start]:
                index, k = [], start
                while k >= 0 and left[k]:
                    left[k] = False
                    index.append(k)
                    k = int(after[k])
                chains.append(Chain(np.array(index), k >= 0))
        return cls(point, chains)

    def store(self, arrays: dict[str, np.ndarray]) -> None:
        """Put the rims into a stored state, chain by chain."""
        order = np.concatenate([chain.index for chain in self.chains] or [np.zeros(0, int)]).astype(int)
        for name in POINT:
            arrays[f"f.{name}"] = self.point[name][order].astype(arrays[f"f.{name}"].dtype)
        after, before, first = np.full(len(order), -1), np.full(len(order), -1), 0
        for chain in self.chains:
            k = first + np.arange(len(chain.index))
            after[k[:-1]], before[k[1:]] = k[1:], k[:-1]
            if chain.loop:
                after[k[-1]], before[k[0]] = k[0], k[-1]
            first += len(k)
        arrays["f.after"], arrays["f.before"] = after.astype(np.int32), before.astype(np.int32)

    def runs(self, chosen: np.ndarray) -> Iterator[np.ndarray]:
        """Indices of the points of a mask that follow each other, run by run."""
        for chain in self.chains:
            index = chain.index
            inside = chosen[index]
            if inside.all():
                yield index
                continue
            if chain.loop:
                turn = int(np.argmin(inside))
                index, inside = np.roll(index, -turn), np.roll(inside, -turn)
            edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
            for start, stop in zip(edges[::2], edges[1::2], strict=True):
                yield index[start:stop]

    def thread(self, index: np.ndarray) -> Thread:
        """The liquid of points that follow each other."""
        point, half = self.point, self.halves()
        return Thread(*(point[name][index] for name in ("x", "u", "mass", "surfactant")), half[index])

    def halves(self) -> np.ndarray:
        """[n] length of the rim that each point stands for, m."""
        half = np.zeros(len(self.point["x"]))
        for chain in self.chains:
            gap = self._gaps(chain)
            half[chain.index] += 0.5 * gap
            half[np.roll(chain.index, -1)] += 0.5 * gap
        return np.maximum(half, 1e-12)

    def _gaps(self, chain: Chain) -> np.ndarray:
        """[n] distance from each point of a chain to the next; 0 from the last of one that is no loop."""
        x = self.point["x"][chain.index]
        gap = np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1)
        if not chain.loop:
            gap[-1] = 0.0
        return gap

    def conormals(self) -> np.ndarray:
        """[n, 3] unit vectors from the hole into the film."""
        out = np.zeros_like(self.point["x"])
        for chain in self.chains:
            x = self.point["x"][chain.index]
            along = np.roll(x, -1, axis=0) - np.roll(x, 1, axis=0)
            if not chain.loop and len(x) > 1:
                along[0], along[-1] = x[1] - x[0], x[-1] - x[-2]
            across = np.cross(along, self.point["normal"][chain.index])
            out[chain.index] = across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)
        return out

    def meet(self, reach: float) -> np.ndarray:
        """[n] whether points have come within `reach` (m) of a rim that runs against them."""
        x, out = self.point["x"], self.conormals()
        met = np.zeros(len(x), dtype=bool)
        for part in np.array_split(np.arange(len(x)), 1 + len(x) ** 2 // 2_000_000):
            way = x[None] - x[part, None]
            near = (way**2).sum(axis=2) < reach**2
            against = out[part] @ out.T < -0.2
            ahead = (way * out[part, None]).sum(axis=2) > 0.0
            met[part] = (near & against & ahead).any(axis=1)
        return met

    def cut(self, gone: np.ndarray, liquid: np.ndarray, length: float) -> list[Thread]:
        """Take points out, and join the ends that are left of rims that met; what is too short goes, too.

        Args:
            gone: [n] mask of the points that go.
            liquid: [n] those of them that met another rim: the ends beside them are free to be joined.
            length: usual distance of points, m.

        Returns:
            The liquid of the points that went.
        """
        threads = [self.thread(run) for run in self.runs(liquid)]
        if not gone.any():
            return threads
        half = self.halves()
        runs, whole = [], []
        for chain in self.chains:
            if not gone[chain.index].any():
                whole.append(chain)
                continue
            index = chain.index
            inside = ~gone[index]
            if not inside.any():
                continue
            if chain.loop:
                turn = int(np.argmax(~inside))
                index, inside = np.roll(index, -turn), np.roll(inside, -turn)
            edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
            for start, stop in zip(edges[::2], edges[1::2], strict=True):
                free = [
                    (start > 0 or chain.loop) and bool(liquid[index[start - 1]]),
                    (stop < len(index) or chain.loop) and bool(liquid[index[stop % len(index)]]),
                ]
                runs.append((index[start:stop], *free))
        chains = [*whole, *self._join(runs, 8.0 * length)]
        self.chains = []
        for chain in chains:
            if len(chain.index) >= FEWEST or (not chain.loop and len(chain.index) > 1):
                self.chains.append(chain)
            else:
                point = self.point
                names = ("x", "u", "mass", "surfactant")
                threads.append(Thread(*(point[name][chain.index] for name in names), half[chain.index]))
        return threads

    def _join(self, runs: list[tuple[np.ndarray, bool, bool]], reach: float) -> list[Chain]:
        """Chains from runs of points: each free end goes on with the nearest free start."""
        x = self.point["x"]
        links = sorted(
            (float(np.linalg.norm(x[a[-1]] - x[b[0]])), i, j)
            for i, (a, _, open_end) in enumerate(runs)
            for j, (b, open_start, _) in enumerate(runs)
            if open_end and open_start
        )
        after: dict[int, int] = {}
        for distance, i, j in links:
            if distance < reach and i not in after and j not in after.values():
                after[i] = j
        starts = [j for j in range(len(runs)) if j not in after.values()]
        chains, left = [], set(range(len(runs)))
        for start in [*starts, *range(len(runs))]:
            parts, k = [], start
            while k in left:
                left.remove(k)
                parts.append(runs[k][0])
                k = after.get(k, -1)
            if parts:
                index = np.concatenate(parts)
                first, last = (
                    runs[start][1],
                    k == start or bool(np.linalg.norm(x[index[-1]] - x[index[0]]) < 2.0 * reach),
                )
                chains.append(Chain(index, k == start or (first and last)))
        return chains

    def even(self, length: float, rng: np.random.Generator) -> None:
        """Put points in where they are more than 1.5 `length` (m) apart, and join those nearer than half of it.

        Loops of fewer than `ROUND` points are finer, so that small holes are round.
        """
        for chain in self.chains:
            apart = min(length, self._gaps(chain).sum() / ROUND) if chain.loop else length
            self._join_near(chain, 0.5 * apart)
            self._put_in(chain, 1.5 * apart, rng)

    @staticmethod
    def _cubic(chain: Chain, where: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values halfway from the points `where` of a chain to the next ones, by the two on either side."""
        n, held = len(chain.index), values[chain.index]
        outer = [where - 1, where + 2]
        outer = [k % n for k in outer] if chain.loop else [np.clip(k, 0, n - 1) for k in outer]
        mean = 0.5 * (held[where] + held[(where + 1) % n])
        bent = 0.125 * (held[where] + held[(where + 1) % n] - held[outer[0]] - held[outer[1]])
        return mean + 0.5 * bent

    def _join_near(self, chain: Chain, least: float) -> None:
        """Make one of a point and the next, which gives what it holds to it, where they are too near.

        Of points that run together along a bent film it keeps the speed, not the sum of the vectors: what turns them is
        the film's shape.
        """
        index, k, out = chain.index.tolist(), 0, self.conormals()
        fewest = FEWEST if chain.loop else 2
        point = self.point
        while len(index) > fewest and k < len(index) - (not chain.loop):
            a, b = index[k], index[(k + 1) % len(index)]
            if np.linalg.norm(point["x"][b] - point["x"][a]) >= least:
                k += 1
                continue
            point["x"][a] = 0.5 * (point["x"][a] + point["x"][b])
            weight = max(point["inertia"][b], 1e-30) / max(point["inertia"][a] + point["inertia"][b], 2e-30)
            turned = max(float(np.linalg.norm((1.0 - weight) * out[a] + weight * out[b])), STEADY)
            point["u"][a] = ((1.0 - weight) * point["u"][a] + weight * point["u"][b]) / turned
            for name in SUMS:
                point[name][a] += point[name][b]
            point["growth"][a] = max(point["growth"][a], point["growth"][b])
            index.pop((k + 1) % len(index))
            k += 1
        chain.index = np.array(index)

    def _put_in(self, chain: Chain, most: float, rng: np.random.Generator) -> None:
        """New points halfway between those too far apart, each with a quarter of what its two neighbours hold.

        They lie on the curve through the four points around them and run as fast as these: of neighbours that run
        apart the mean is slower than either.
        """
        gap = self._gaps(chain)
        where = np.flatnonzero(gap > most)
        if not len(where):
            return
        point, a = self.point, chain.index[where]
        b = chain.index[(where + 1) % len(chain.index)]
        made = {name: 0.5 * (values[a] + values[b]) for name, values in point.items()}
        for name in ("x", "u"):
            made[name] = self._cubic(chain, where, point[name])
        made["limit"] = _limits(len(where), rng)
        shares = {name: 0.25 * values for name, values in ((n, point[n]) for n in SUMS)}
        for name in SUMS:
            made[name] = shares[name][a] + shares[name][b]
            for end in (a, b):
                np.subtract.at(point[name], end, shares[name][end])
        made["normal"] /= np.linalg.norm(made["normal"], axis=1, keepdims=True)
        new = len(point["x"]) + np.arange(len(where))
        for name, values in point.items():
            point[name] = np.concatenate([values, made[name]])
        chain.index = np.insert(chain.index, where + 1, new)
