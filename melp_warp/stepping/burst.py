"""When films burst, and what the host does about it between steps: holes, rims that meet, drops, film that is gone.

Works on a state as `State.numpy` gives it and gives one of other sizes back, from which the run is set up anew.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from melp_warp.bursting import Puncture
from melp_warp.device.launch import launch
from melp_warp.errors import SimulationError
from melp_warp.frame import CurveFrame, ParticleFrame, beads
from melp_warp.kernels import free_rim as kr
from melp_warp.measure.fits import connected, nearest_distance, squares
from melp_warp.stages.free_rim import REACH, RIM_CFL, SIGHT, FreeRim
from melp_warp.stages.record import NONE, Swept
from melp_warp.stages.state import AMOUNT, GAUGE
from melp_warp.stepping.breath import flow_through
from melp_warp.stepping.rims import FEWEST, LINKS, ROUND, Rims, Thread, breaking_points, names_of
from melp_warp.stepping.topology import Stored

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


class Burst:
    """The holes of one run; what is still to come is in the state, see `Course`."""

    def __init__(self, simulation: Simulation):
        self.scene = simulation.scene
        self._sim = simulation
        self._opened: int | None = None
        self._moved = False

    @property
    def edge(self) -> FreeRim | None:
        """The rims as they run; None without any."""
        sim = self._sim
        return sim.stepper.edge if sim.film.features.holed and not sim.gone else None

    @property
    def torn(self) -> bool:
        """Whether some of the film is behind rims."""
        return self._sim.film.features.holed

    @property
    def _rims(self) -> Rims:
        """The rims as they are now (reads back)."""
        arrays = self._sim.state.arrays()
        return Rims.of({name: array.numpy() for name, array in arrays.items() if name.startswith("f.")})

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
        sim, edge = self._sim, self.edge
        speed = edge.fastest() if edge is not None else 0.0
        return RIM_CFL * sim.film.spacing / speed if speed > 0.0 else np.inf

    def begin(self) -> None:
        """After a change: the rim of a new hole takes what was there."""
        sim, first = self._sim, self._opened
        self._opened = None
        if first is not None:
            self.edge.sweep()
            inertia = sim.state.f.inertia.numpy()
            inertia[first:] = sim.state.f.mass.numpy()[first:].mean()
            sim.state.f.inertia.assign(inertia)

    def after_step(self, dt: float) -> None:
        """Count how far the rims have run, and let drops fly."""
        sim, edge = self._sim, self.edge
        if edge is not None:
            speed = edge.fastest()
            if not np.isfinite(speed):
                raise SimulationError("stage rim: a point of a free rim is not finite")
            sim.state.course.run += dt * speed
            self._book(dt)
            self._moved = True
            if sim.scene.surroundings.air != "none":
                self._vent(dt)
        drops, air = sim.state.d, sim.scene.surroundings
        density = air.air_density if air.air != "none" else 0.0
        inputs = [drops.mass, sim.scene.material.density, density, sim.film.gravity_at(sim.time - 0.5 * dt), dt]
        launch(kr.fly_d, drops.x.shape[0], inputs, [drops.x, drops.u], sim.device)

    def _book(self, dt: float) -> None:
        """Add up what a step of dt (s) tore of the film, and what of that was lost as rims took its liquid along.

        A rim that runs at V over a film that moves at u tears 2 sigma (V - u).n ds in a second. What it takes comes to
        its speed at once, which loses rho eta/2 |V - u|^2 (V - u).n ds: half of that where it runs as Taylor and
        Culick say. The other half is its motion.
        """
        sim, rims = self._sim, self._rims
        point, film = rims.point, sim.film
        ahead = point["u"] - point["flow"]
        point["x"] = point["x"] - 0.5 * dt * point["u"]  # as long as it was halfway
        swept = dt * rims.halves() * np.maximum((ahead * rims.conormals()).sum(axis=1), 0.0)
        gamma, eta = point["film"].T
        sheets = 1.0 + (point["other"] >= 0)
        sigma = film.tension.numpy()[point["region"].astype(int)] - film.slope * gamma
        course = sim.state.course
        lost = 0.5 * film.material.density * eta * (ahead**2).sum(axis=1) * swept
        course.torn = [course.torn[0] + float((2.0 * sheets * sigma * swept).sum()), course.torn[1] + float(lost.sum())]

    def _fallen(self) -> np.ndarray:
        """[n_d] whether drops have come to a wall."""
        sim = self._sim
        walls = getattr(self.scene.shape, "walls", ())
        if not walls or not sim.state.sizes["d"]:
            return np.zeros(0, dtype=bool)
        x = sim.state.d.x.numpy() + sim.state.origin
        return np.any([(x - np.array(wall.point)) @ np.array(wall.normal) < 0.0 for wall in walls], axis=0)

    def _leave(self, stored: Stored, drops: np.ndarray) -> None:
        """Let the drops of a mask leave by the walls that they have come to."""
        self._sim.state.course.rest += stored.leave("d", drops)
        stored.swept.dry(stored.ids["d"][drops])
        for name in [name for name in stored.arrays if name.startswith("d.")]:
            stored.arrays[name] = stored.arrays[name][~drops]
        stored.ids["d"] = stored.ids["d"][~drops]

    def _vent(self, dt: float) -> None:
        """Let gas leave by the holes for a step of dt (s), `flow_through`, at the volume that it had.

        The root of the pressure falls evenly, by half of what flows at 1 Pa: to nothing in a thousandth of a second or
        less. What is left then holds nothing up.
        """
        state, around = self._sim.state, self.scene.surroundings
        gas, rims = state.gas.numpy(), None
        for k in self._vented(gas):
            rims = rims or self._rims
            hole = sum(rims.hole(chain) for chain in rims.chains if rims.point["region"][chain.index[0]] == k)
            fall = 0.5 * dt * around.pressure / self._held(k, gas) * flow_through(hole, 1.0, around.air_density)
            gauge = gas[k, GAUGE]
            gas[k, GAUGE] = np.sign(gauge) * max(np.sqrt(abs(gauge)) - fall, 0.0) ** 2
        if rims is not None:
            state.gas.assign(gas)

    def _vented(self, gas: np.ndarray) -> list[int]:
        """Regions with a hole that are still above the pressure outside."""
        return [0] if self.scene.shape.closed and gas[0, GAUGE] != 0.0 else []

    def _held(self, k: int, gas: np.ndarray) -> float:
        """Volume of a region's gas when it was punctured, m^3."""
        return gas[k, AMOUNT] / self.scene.surroundings.pressure

    def due(self) -> Callable[[Stored], None] | None:
        """The change to carry out now, None for none."""
        sim = self._sim
        course = sim.state.course
        if (drops := self._fallen()).any():
            return lambda stored: self._leave(stored, drops)
        if sim.gone:
            return None
        while (waiting := self.pending) and waiting[0].time <= sim.time + 1e-12:
            course.punctured += 1
            if (change := self._puncture(waiting[0])) is not None:
                return change
        thin = self._thinnest()
        if thin is not None:
            return self._puncture(Puncture(tuple(thin.tolist()), sim.time))
        if self._moved and (course.run >= TURN * sim.film.spacing or self._meeting()):
            self._moved = False  # once a step
            return self._tidy
        return None

    def put_back(self, _: Stored) -> bool:
        """Take a change over into the state as it is; False where all is to be set up anew, as for single films."""
        return False

    def _meeting(self) -> bool:
        """Whether rims have met, or come to an end of the film, since they were last put in order."""
        rims = self._rims
        return bool(self._arrived(rims).any() or rims.meet(MEET * self._sim.film.spacing).any())

    def _thinnest(self) -> np.ndarray | None:
        """Place of the thinnest film, where it is thinner than it holds. [3], m."""
        least = self.scene.bursting.rupture_thickness
        if least == 0.0:
            return None
        sim = self._sim
        sim.stepper.fields.update()
        eta = self._film_thickness()
        if self.edge is not None:
            far = (sim.state.e.behind.numpy() == 0) & (self.edge.edge.numpy()[:, 3] > REACH * sim.film.spacing)
            eta = np.where(far, eta, np.inf)
        i = int(np.argmin(eta))
        return sim.state.e.x.numpy()[i] + sim.state.origin if eta[i] < least else None

    def _film_thickness(self) -> np.ndarray:
        """[n_e] thickness of the film at each E, m."""
        return self._sim.stepper.fields.eta.numpy()[: self._sim.film.n_e]

    # --- what is told ------------------------------------------------------------------------------------------------

    def diagnostics(self) -> dict:
        """What a line of the log says of holes: liquid (kg) by where it is, and the rims."""
        state = self._sim.state
        rim, rims = state.f, self._rims
        there = {"e": state.e.behind, "l": state.l.behind if state.l else None} if self.edge is not None else {}
        count = {f"{kind}_count": int((a.numpy() == 0).sum()) for kind, a in there.items() if a is not None}
        area = {}
        if self.edge is not None:
            own = self._sim.stepper.geometry.area.numpy()
            area["area"] = float(own[state.e.behind.numpy() == 0].sum(dtype=np.float64))
        return {
            **count,
            **area,
            "rims": len(rims.chains),
            "rim_length": float(rims.halves().sum()) if rims.chains else 0.0,
            "rim_mass": float(rim.mass.numpy().sum()),
            "rim_speed": float(np.linalg.norm(rim.u.numpy(), axis=1).max(initial=0.0)),
            "rim_energy": _kinetic(rim.mass, rim.u),
            "torn_energy": state.course.torn[0],
            "torn_loss": state.course.torn[1],
            "drops": state.sizes["d"],
            "drop_mass": float(state.d.mass.numpy().sum(dtype=np.float64)),
            "drop_energy": _kinetic(state.d.mass, state.d.u),
            "frame_mass": state.course.rest,
            **({"new_drops": self._new_drops()} if self._sim.has_l else {}),
        }

    def sources(self) -> dict[int, np.ndarray]:
        """Number of each drop that there is -> numbers of the L whose liquid it holds, ascending."""
        swept = self._sim.state.swept
        return Swept(swept).by_drop(0) if swept else {}

    def _new_drops(self) -> dict[str, list[int]]:
        """The same of the drops of the last frame alone, as JSON can say it."""
        new = Swept(self._sim.state.swept).by_drop(self._sim.state.course.sprayed)
        return {str(drop): own.tolist() for drop, own in new.items()}

    def particles(self, which: str) -> ParticleFrame:
        """The free rims ("rims"), as beads that lie close enough to be threads, or the drops ("drops").

        `thickness` is the diameter, and `region` of rims the number of the rim; beads are in order along it, and of one
        that is closed the last lies near the first.
        """
        sim = self._sim
        shift = sim.state.origin - sim.origin
        if which == "drops":
            drops = sim.state.d
            x, u, mass = (a.numpy().astype(np.float64) for a in (drops.x, drops.u, drops.mass))
            width = 2.0 * np.cbrt(3.0 * mass / (4.0 * np.pi * self.scene.material.density))
            return beads(x + shift, u, width, np.tile([0.0, 1.0, 0.0], (len(x), 1)), sim.origin, sim.state.ids["d"])
        rims = self._rims
        parts = [rims.beads(chain, self.scene.material.density, sim.film.spacing) for chain in rims.chains]
        if not parts:
            return ParticleFrame.empty(tuple(sim.origin.tolist()))
        x, u, width, normal = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        frame = beads(x + shift, u, width, normal, sim.origin, np.arange(len(x)))
        frame.region = np.repeat(np.arange(len(parts), dtype=np.int32), [len(part[0]) for part in parts])
        return frame

    def curves(self) -> CurveFrame:
        """The free rims as curves, through the same points as the beads; a closed one ends where it begins."""
        sim, rims = self._sim, self._rims
        parts = []
        for chain in rims.chains:
            columns = rims.beads(chain, self.scene.material.density, sim.film.spacing)[:3]
            parts.append([np.concatenate([c, c[:1]]) if chain.loop else c for c in columns])
        parts = parts or [[np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)]]
        x, u, width = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        counts = np.array([len(part[0]) for part in parts if len(part[0])], dtype=np.int32)
        x = x + (sim.state.origin - sim.origin)
        x, u, width = (values.astype(np.float32) for values in (x, u, width))
        return CurveFrame(x, u, counts, width, tuple(sim.origin.tolist()))

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
        """Make a hole; None, with a notice, where there is no film for one."""
        sim = self._sim
        film, e = sim.film, sim.state.e
        x = e.x.numpy()[: film.n_e].astype(np.float64)
        away = np.linalg.norm(x - (np.array(one.place) - sim.state.origin), axis=1)
        if e.behind is not None:
            behind = e.behind.numpy() == 1
            if one.end is None and behind[np.argmin(away)]:
                return self._without_effect(one, "in a hole")
            away = np.where(behind, np.inf, away)
        i = int(np.argmin(away))
        size = float(np.sqrt(sim.scene.shape.area))
        if not away[i] <= max(0.25 * size, film.spacing):
            return self._without_effect(one, f"{away[i]:.3g} m off the film")
        sides = self._sides(i)
        return self._hole(one, i, sides) if sides else self._without_effect(one, "where the film lies on a wall")

    def _sides(self, i: int) -> tuple[int, int] | None:
        """Region of the film at E i, and that beyond it where it is a partition, else -1; None on a wall."""
        return (0, -1)

    def _hole(self, one: Puncture, i: int, sides: tuple[int, int]) -> Callable[[Stored], None]:
        """Make a hole at E i, in the film between two regions."""
        sim = self._sim
        film, e, m = sim.film, sim.state.e, sim.scene.material
        x = e.x.numpy()[: film.n_e].astype(np.float64)
        place = np.array(one.place) - sim.state.origin
        radius = film.spacing if one.radius is None else one.radius
        normal = e.normal.numpy()[i].astype(np.float64)
        sim.stepper.fields.update()
        gamma, eta = (float(a.numpy()[i]) for a in (sim.stepper.fields.gamma, sim.stepper.fields.eta))
        eta *= 1.0 if sides[1] < 0 else 2.0  # a partition has two sheets
        tension = float(film.tension.numpy()[sides[0]])
        speed = np.sqrt(2.0 * max(tension - film.slope * gamma, 0.0) / (m.density * eta))
        centre = place - ((place - x[i]) @ normal) * normal
        if np.linalg.norm(centre - x[i]) > film.spacing:
            centre = x[i]
        end = centre if one.end is None else np.array(one.end) - sim.state.origin
        farthest = float(np.linalg.norm(x - centre, axis=1).max()) + 2.0 * film.r
        end = centre + (end - centre) * min(1.0, farthest / max(float(np.linalg.norm(end - centre)), 1e-30))
        ring = _ring(centre, end, normal, radius, POINTS * film.spacing)
        own = np.flatnonzero(e.region.numpy()[: film.n_e] == sides[0])
        nearest = np.concatenate([np.argmin(squares(part, x[own]), axis=1) for part in np.array_split(ring, len(ring))])
        nearest = own[nearest]
        normals = e.normal.numpy()[nearest].astype(np.float64)
        ring -= (((ring - x[nearest]) * normals).sum(axis=1, keepdims=True)) * normals
        flow = e.u.numpy()[nearest]
        seen = np.tile([gamma, eta], (len(ring), 1))
        return lambda stored: self._open(stored, ring, normals, flow, seen, speed, sides)

    def _without_effect(self, one: Puncture, why: str) -> None:
        """Note a puncture that makes no hole."""
        where = ", ".join(f"{c:g}" for c in one.place)
        text = f"the puncture at {where} at {one.time:g} s is {why}: nothing happens"
        self._sim.notices.note("puncture without effect", 1.0, text)

    def _open(self, stored, ring, normals, flow, seen, speed, sides) -> None:
        """Put a rim into the state; its liquid is what it finds behind it when it first looks."""
        arrays, k = stored.arrays, len(ring)
        old = len(arrays["f.x"])
        rng = np.random.default_rng([self.scene.seed, old, self._sim.state.course.punctured, k])
        new = {name: np.zeros((k, *arrays[f"f.{name}"].shape[1:])) for name in names_of(arrays)}
        new |= {"region": np.full(k, sides[0]), "other": np.full(k, sides[1])}
        new |= {"x": ring, "normal": normals, "flow": flow, "film": seen, "limit": breaking_points(k, rng)}
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
        rims = self._recorded(stored)
        self._break(stored, rims, rng)
        there = self._arrived(rims)
        self._collect(stored, rims, there)
        met = (rims.meet(MEET * spacing) | self._blind(stored, rims)) & ~there
        self._close(stored, rims, np.flatnonzero(met))
        self._record(stored, rims)
        ended = rims.cut(met | there, met, POINTS * spacing)
        if met.any():
            ended += self._islands(stored, rims)
        self._spray(stored, ended)
        rims.even(POINTS * spacing, rng)
        rims.store(stored.arrays)
        stored.swept.forget_lost()
        sim.state.course.run = 0.0
        self._clear_up(stored, rims)

    def _recorded(self, stored: Stored) -> Rims:
        """The rims of a state, with the L that they have swept up by now in its record."""
        rims = Rims.of(stored.arrays, stored.swept)
        self._record(stored, rims)
        return rims

    def _record(self, stored: Stored, rims: Rims) -> None:
        """Record L that rims have taken since the last time: each is with the nearest point that runs over its film."""
        arrays = stored.arrays
        if stored.carriers == "e" or not len(arrays["f.x"]):
            return
        new = (arrays["l.behind"] == 1) & (arrays["l.mass"] > 0.0) & ~np.isin(stored.ids["l"], stored.swept["l"])
        sides, way, half = (rims.point["region"], rims.point["other"]), rims.directions(), rims.halves()
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-30)
        for k in np.unique(arrays["l.region"][new]):
            own = np.flatnonzero(new & (arrays["l.region"] == k))
            points = np.flatnonzero((sides[0] == k) | (sides[1] == k))
            if not len(points):
                continue
            x, place = arrays["l.x"][own].astype(np.float64), rims.point["x"][points]
            parts = np.array_split(np.arange(len(own)), 1 + len(own) * len(points) // 2_000_000)
            nearest = points[np.concatenate([np.argmin(squares(x[part], place), axis=1) for part in parts])]
            along = ((x - rims.point["x"][nearest]) * way[nearest]).sum(axis=1) / half[nearest]
            stored.swept.enter(stored.ids["l"][own], nearest, np.clip(along, -0.5, 0.5))

    def _clear_up(self, stored: Stored, rims: Rims) -> None:
        """Take away what the rims have left."""
        if not rims.chains or (stored.arrays["e.behind"] == 0).sum() < FEWEST:
            self._finish(stored, rims)
            return
        self._drop_film(stored)

    def _break(self, stored: Stored, rims: Rims, rng: np.random.Generator) -> None:
        """Let the points whose waves have grown break into drops, and go on empty."""
        limit = self.scene.bursting.breakup
        if limit == 0.0:
            return
        point = rims.point
        broken = (point["growth"] > limit * point["limit"]) & (point["mass"] > 0.0)
        if not broken.any():
            return
        for thread in rims.threads(rims.runs(broken)):
            self._spray(stored, [thread])
        for name in (*rims.sums, "growth"):
            point[name][broken] = 0.0
        point["limit"][broken] = breaking_points(int(broken.sum()), rng)

    def _close(self, stored: Stored, rims: Rims, met: np.ndarray) -> None:
        """Give the film that is left between rims that have met to their points `met`."""
        if not len(met):
            return
        arrays, place = stored.arrays, rims.point["x"][met]
        kind, flag = stored.carriers, stored.flag
        sides = [rims.point[name][met] for name in ("region", "other")]
        for name in (flag, "e.behind"):
            which = name[0]
            own = np.isin(arrays[f"{which}.region"][: len(arrays[name])], sides)
            there = np.flatnonzero((arrays[name] == 0) & own)
            away = nearest_distance(arrays[f"{which}.x"][there], place)
            between = there[away < 0.5 * MEET * self._sim.film.spacing]
            if name == flag and len(between):
                nearest = met[np.argmin(squares(arrays[f"{kind}.x"][between], place), axis=1)]
                for what in ("mass", *rims.held):
                    np.add.at(rims.point[what], nearest, arrays[f"{kind}.{what}"][between].astype(np.float64))
            arrays[name][between] = 1

    def _islands(self, stored: Stored, rims: Rims) -> list[Thread]:
        """The liquid of pieces of film that no rim is near any more: they are too small for one."""
        arrays, n, spacing = stored.arrays, self._sim.film.n_e, self._sim.film.spacing
        x, live = arrays["e.x"][:n], self._live(arrays)
        rows = self._sim.stepper.lists.ee.rows
        start, stop, index = (a.numpy() for a in (rows.start, rows.stop, rows.index))
        count = stop - start
        i = np.repeat(np.arange(n), count)
        j = index[np.repeat(start, count) + np.arange(len(i)) - np.repeat(np.cumsum(count) - count, count)]
        near = (j < n) & live[i]
        i, j = i[near], j[near]
        near = live[j] & (((x[i] - x[j]) ** 2).sum(axis=1) < (PIECE * spacing) ** 2)
        piece = connected(n, i[near], j[near])
        points = np.concatenate([rims.point["x"][chain.index] for chain in rims.chains] or [np.zeros((0, 3))])
        held = np.zeros(n, dtype=bool)
        if len(points):
            held[piece[live & (nearest_distance(x, points) < PIECE * spacing)]] = True
        lost = live & ~held[piece]
        return [self._take(stored, lost & (piece == k)) for k in np.unique(piece[lost])]

    def _take(self, stored: Stored, lost: np.ndarray) -> Thread:
        """Take the film of the E of the mask `lost` [n_e] away; its liquid."""
        arrays = stored.arrays
        arrays["e.behind"][lost] = 1
        kind, flag = stored.carriers, stored.flag
        there = lost[self._sim.stepper.lists.le.home.numpy()] if kind == "l" else lost
        there = there & (arrays[flag] == 0)
        arrays[flag][there] = 1
        return self._liquid_of(stored, kind, there)

    def _liquid_of(self, stored: Stored, kind: str, chosen: np.ndarray) -> Thread:
        """The liquid of the particles of a mask, as a thread."""
        names = ("x", "u", "mass", "surfactant", *stored.left)
        held = {name: stored.arrays[f"{kind}.{name}"][: len(chosen)][chosen].astype(np.float64) for name in names}
        x, u, mass = (held.pop(name) for name in ("x", "u", "mass"))
        thread = Thread(x, u, mass, np.full(len(x), self._sim.film.spacing), held)
        if kind == "l":
            thread.whose = stored.swept.enter(stored.ids["l"][chosen], np.full(len(x), NONE), np.zeros(len(x)))
            thread.place = (np.cumsum(mass) - 0.5 * mass) / max(mass.sum(), 1e-300)
        return thread

    def _live(self, arrays: dict[str, np.ndarray]) -> np.ndarray:
        """[n_e] the film that a rim will pass."""
        return arrays["e.behind"] == 0

    def _blind(self, stored: Stored, rims: Rims) -> np.ndarray:
        """[n] whether points have no film before them any more."""
        there = stored.arrays["e.x"][: self._sim.film.n_e][stored.arrays["e.behind"] == 0]
        return nearest_distance(rims.point["x"], there) > SIGHT * self._sim.film.spacing

    def _arrived(self, rims: Rims) -> np.ndarray:
        """[n] whether points have come to the frame of an open film."""
        held, x = self._sim.film.rim, rims.point["x"]
        if held is None or not len(x):
            return np.zeros(len(x), dtype=bool)
        anchors, outward = held.anchors.numpy(), held.outward.numpy()
        near = np.argmin(squares(x, anchors), axis=1)
        beyond = ((x - anchors[near]) * outward[near]).sum(axis=1)
        return beyond > -FRAME * self._sim.film.spacing

    def _collect(self, stored: Stored, rims: Rims, there: np.ndarray) -> None:
        """Leave to the frame what has come to it, the points `there` (mask)."""
        stored.swept.leave(np.flatnonzero(there))
        self._sim.state.course.rest += float(rims.point["mass"][there].sum())
        for name in stored.left:
            stored.left[name] += float(rims.point[name][there].sum())
        for name in rims.sums:
            rims.point[name][there] = 0.0

    def _spray(self, stored: Stored, threads: list[Thread]) -> None:
        """Break threads of liquid into drops, as many as the fastest wave makes of them; sums are kept."""
        arrays, m = stored.arrays, self.scene.material
        rng = np.random.default_rng([self.scene.seed, len(arrays["d.x"]), len(threads)])
        threads = [thread for thread in threads if thread.mass.sum() > 0.0]
        made = [thread.drops(m.density, m.film_tension, rng) for thread in threads]
        if not made:
            return
        for name in made[0]:
            new = np.concatenate([drops[name] for drops in made])
            was = arrays[f"d.{name}"]
            arrays[f"d.{name}"] = np.concatenate([was, new.astype(was.dtype)])
        numbers = stored.issue("d", len(arrays["d.x"]) - len(stored.ids["d"]))
        stored.ids["d"] = np.concatenate([stored.ids["d"], numbers])
        for thread, drops in zip(threads, made, strict=True):
            own, numbers = np.split(numbers, [len(drops["mass"])])
            stored.swept.become(thread.whose, own[thread.cut_at(len(own))])

    def _drop_film(self, stored: Stored) -> None:
        """Take away the film that is far behind the rims."""
        film, arrays = self._sim.film, stored.arrays
        behind = np.flatnonzero(arrays["e.behind"] == 1)
        kept = np.ones(film.n_e, dtype=bool)
        if len(behind):
            away = nearest_distance(arrays["e.x"][behind], arrays["f.x"])
            kept[behind[away > film.r + POINTS * film.spacing]] = False
        if kept.all():
            return
        if "l.x" in arrays:
            home = self._sim.stepper.lists.le.home.numpy()
            lost = ~kept[home] & (arrays["l.behind"] == 0)
            self._take_lost(stored, lost)
            self._keep_collected(stored, ~kept[home])
            stored.select("l", kept[home])
        keep_e(stored, kept)

    @staticmethod
    def _keep_collected(stored: Stored, gone: np.ndarray) -> None:
        """Count among what left what the frame has collected, L by L, from L that go."""
        for name in stored.left:
            collected = stored.arrays.get(f"l.{name}_rim")
            if collected is not None:
                stored.left[name] += float(collected[gone].sum(dtype=np.float64))

    def _take_lost(self, stored: Stored, lost: np.ndarray) -> None:
        """Leave the liquid of L [n_l] without film to the frame, or without one to the rims nearest to them."""
        arrays = stored.arrays
        mass = arrays["l.mass"][lost].astype(np.float64)
        if self._sim.film.rim is not None:
            self._sim.state.course.rest += float(mass.sum())
            stored.leave("l", lost)
        elif lost.any():
            nearest = np.argmin(squares(arrays["l.x"][lost], arrays["f.x"]), axis=1)
            for name in ("mass", "surfactant", *stored.left):
                np.add.at(arrays[f"f.{name}"], nearest, arrays[f"l.{name}"][lost].astype(np.float64))
            stored.swept.enter(stored.ids["l"][lost], nearest, np.zeros(len(nearest)))

    def _finish(self, stored: Stored, rims: Rims) -> None:
        """The last of the film and of its rims: into the frame where there is one, else into drops."""
        arrays = stored.arrays
        kind, left = stored.carriers, stored.there()
        mass = arrays[f"{kind}.mass"][left].astype(np.float64)
        threads = rims.threads(chain.index for chain in rims.chains)
        if self._sim.film.rim is not None:
            self._sim.state.course.rest += float(mass.sum()) + float(sum(one.mass.sum() for one in threads))
            stored.leave(kind, left)
            stored.swept.leave(np.arange(len(arrays["f.x"])))
            for name in stored.left:
                stored.left[name] += float(sum(one.held[name].sum() for one in threads))
        else:
            threads.append(self._take(stored, np.ones(len(arrays["e.mass"]), dtype=bool)))
            self._spray(stored, threads)
        for name in (*names_of(arrays), *LINKS):
            arrays[f"f.{name}"] = arrays[f"f.{name}"][:0]
        if kind == "l":
            self._keep_collected(stored, np.ones(len(left), dtype=bool))
            stored.select("l", np.zeros(len(left), dtype=bool))
        keep_e(stored, np.zeros(len(arrays["e.mass"]), dtype=bool))
        for name in [name for name in arrays if name.startswith("e.")]:
            arrays[name] = arrays[name][:0]
        arrays.pop("b.mirror", None)
        stored.drop_region(0)


def _kinetic(mass: wp.array, u: wp.array) -> float:
    """Energy of what moves, J (reads back)."""
    return 0.5 * float((mass.numpy() * (u.numpy().astype(np.float64) ** 2).sum(axis=1)).sum())


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
