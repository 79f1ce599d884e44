"""Bubbles of a foam that burst: a rim runs over the free film, or over a partition, up to the borders.

The sheet that a rim has passed goes on as if it were whole, unseen and with no liquid of its own, until all of it is
torn: then the region goes, and what it shared with its neighbours is theirs. Where the scene has air, its gas is
open to the outside from the start and leaves through the hole.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from melp_warp.bursting import Puncture
from melp_warp.cluster import Merge, Pop
from melp_warp.measure.fits import nearest_distance, squares
from melp_warp.stages.free_rim import SIGHT, FreeRim
from melp_warp.stages.state import AMOUNT, GAUGE, VOLUME, allocate_beads
from melp_warp.stepping.burst import Burst
from melp_warp.stepping.events import find_partition
from melp_warp.stepping.rims import Rims
from melp_warp.stepping.topology import Stored, give, merge_regions, pop_region

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation

SHARED = 0.5
"""Cover of an E above which its sheet is a partition, or lies on a wall."""

OUTSIDE, WALL = -1, -2
"""What is beyond the film at an E where it is no other region."""

CAVED_IN = 0.3
"""Share of its volume to which a bubble that bursts may fall in; then what is left of it breaks into drops at once."""


class FoamBurst(Burst):
    """The holes of one foam. Which films are torn is in the state, see `Course.tears`."""

    def __init__(self, simulation: Simulation):
        super().__init__(simulation)
        self._edge: FreeRim | None = None
        self._gave = False  # whether the change at hand has given liquid to the film

    @property
    def edge(self) -> FreeRim | None:
        """The rims as they run; None without any."""
        sim = self._sim
        state, stepper = sim.state, sim.stepper
        if sim.gone or state.sizes["f"] == 0:
            self._edge = None
        elif self._edge is None or self._edge.rim is not state.f or self._edge.lists is not stepper.lists:
            self._edge = FreeRim(sim.film, state, stepper.lists, stepper.fields)
        return self._edge

    @property
    def torn(self) -> bool:
        """Whether some of the film is behind rims."""
        return bool(self._sim.state.course.tears)

    def after_step(self, dt: float) -> None:
        """Let the rims run, gas leave and drops fly."""
        if self.edge is not None:
            self.edge.advance(dt)
        super().after_step(dt)

    def due(self) -> Callable[[Stored], None] | None:
        """The change to carry out now, None for none."""
        change = super().due()
        return change or self._done()

    # --- events of the scene ------------------------------------------------------------------------------------------

    def pop(self, event: Pop, k: int) -> Callable[[Stored], None] | None:
        """A hole in the free film of region k; None where it has none."""
        return self._hole_in(event, (k, OUTSIDE), self._sheet(k) & (self._beyond() == OUTSIDE))

    def merge(self, event: Merge, k: int, other: int) -> Callable[[Stored], None] | None:
        """A hole in the partition between two regions; None where they share too little."""
        return self._hole_in(event, (k, other), self._sheet(k) & (self._beyond() == other))

    def release(self, stored: Stored, k: int) -> None:
        """Let the rims on the free film of region k, which is about to go, be drops.

        Those on its partitions run on over the films beyond: these are free films now, and their bubbles are open.
        """
        arrays, label = stored.arrays, stored.labels[k]
        rims = self._recorded(stored)
        gone = (rims.point["region"] == k) & (rims.point["other"] < 0)
        if gone.any():
            self._spray(stored, rims.cut(gone, gone, 0.0))
            rims.store(arrays)
        region, other = arrays["f.region"], arrays["f.other"]
        turned = (region == k) & (other >= 0)  # seen from the other side from now on
        arrays["f.normal"][turned] *= -1.0
        stored.swept.turn(np.flatnonzero(turned))
        after, before = arrays["f.after"], arrays["f.before"]
        after[turned], before[turned] = before[turned], after[turned]
        region[turned] = other[turned]
        other[turned | (other == k)] = -1
        beyond = [[*(set(one) - {label}), -1] for one in stored.tears if label in one and -1 not in one]
        for one in beyond:
            self._let_out(arrays, stored.labels.index(one[0]))
            if one not in stored.tears:
                stored.tears.append(one)

    def release_between(self, stored: Stored, k: int, other: int, partition: dict[str, np.ndarray]) -> None:
        """Let the rims on a partition that is about to go leave their liquid to the film around.

        What is behind them is a part of the partition, unless there are other tears that it may belong to.
        """
        rims, arrays = self._recorded(stored), stored.arrays
        pair = (k, other)
        gone = np.isin(rims.point["region"], pair) & np.isin(rims.point["other"], pair)
        if gone.any():
            self._keep_inside(stored, rims, np.flatnonzero(gone))
            rims.cut(gone, np.zeros(len(gone), dtype=bool), 0.0)
            rims.store(arrays)
        labels = {stored.labels[k], stored.labels[other]}
        if any(labels & set(one) and labels != set(one) for one in stored.tears):
            return
        for kind, mask in partition.items():
            behind = arrays[f"{kind}.behind"] == 1
            mask[: len(behind)] |= behind & np.isin(arrays[f"{kind}.region"][: len(behind)], pair)

    def _hole_in(self, event: Pop | Merge, sides: tuple[int, int], film: np.ndarray) -> Callable | None:
        """A hole in the film of the E of a mask [n_e], at the event's place or farthest from the rest of the sheet."""
        x = self._sim.state.e.x.numpy()[: self._sim.film.n_e].astype(np.float64)
        where, rest = np.flatnonzero(film), np.flatnonzero(self._sheet(sides[0]) & ~film)
        if not len(where):
            return None
        if event.place is not None:
            away = -np.linalg.norm(x[where] + self._sim.state.origin - np.array(event.place), axis=1)
        else:
            away = nearest_distance(x[where], x[rest]) if len(rest) else x[where, 1]  # a lone bubble: at its top
        i = int(where[np.argmax(away)])
        place = tuple((x[i] + self._sim.state.origin).tolist())
        return self._hole(Puncture(place, event.time), i, sides)

    def _sheet(self, k: int) -> np.ndarray:
        """[n_e] E of region k that no rim has passed."""
        e = self._sim.state.e
        return (e.region.numpy()[: self._sim.film.n_e] == k) & (e.behind.numpy() == 0)

    def _beyond(self) -> np.ndarray:
        """[n_e] what is on the other side of the film at each E: a region, `OUTSIDE` or a `WALL` (reads back)."""
        membrane = self._sim.stepper.membrane
        partner = membrane.find_partners("e")
        return np.where(membrane.read_cover() > SHARED, np.where(partner >= 0, partner, WALL), OUTSIDE)

    # --- what is torn ------------------------------------------------------------------------------------------------

    def _sides(self, i: int) -> tuple[int, int] | None:
        beyond = int(self._beyond()[i])
        return None if beyond == WALL else (int(self._sim.state.e.region.numpy()[i]), beyond)

    def _film_thickness(self) -> np.ndarray:
        """A partition is as thick as its two sheets; what lies on a wall does not break."""
        own = super()._film_thickness()
        x, region, beyond = self._sim.state.e.x.numpy(), self._sim.state.e.region.numpy(), self._beyond()
        eta = own.astype(np.float64)
        eta[beyond == WALL] = np.inf
        for k in np.unique(beyond[beyond >= 0]):
            here, there = np.flatnonzero(beyond == k), np.flatnonzero(region == k)
            eta[here] += own[there[np.argmin(squares(x[here], x[there]), axis=1)]]
        return eta

    def _open(self, stored, ring, normals, flow, seen, speed, sides) -> None:
        super()._open(stored, ring, normals, flow, seen, speed, sides)
        tear = [stored.labels[sides[0]], stored.labels[sides[1]] if sides[1] >= 0 else -1]
        if tear not in stored.tears:
            stored.tears.append(tear)
        self._sim.state.course.holed = True  # from now on no energy budget is kept
        if sides[1] < 0:
            self._let_out(stored.arrays, sides[0])

    def put_back(self, stored: Stored) -> bool:
        """Put rims, drops and what is behind rims back, where nothing else has changed."""
        state = self._sim.state
        same = stored.labels == state.course.labels and stored.tears == state.course.tears
        if not same or self._gave:
            self._gave = False
            return False
        arrays, features = stored.arrays, self._sim.film.features
        state.f, state.d = allocate_beads(len(arrays["f.x"]), len(arrays["d.x"]), self._sim.device, features)
        for name, array in state.arrays().items():
            if name.startswith(("f.", "d.")):
                array.assign(arrays[name])
        for kind, name in itertools.product("el", ("behind", "swept")):
            array = getattr(getattr(state, kind), name, None)
            if array is not None:
                array.assign(arrays[f"{kind}.{name}"])
        state.ids["d"], state.swept = stored.ids["d"], stored.swept.held
        state.course.left = stored.left
        return True

    def _let_out(self, arrays: dict[str, np.ndarray], k: int) -> None:
        """Open region k to the outside; without air, which holds a film back, its gas holds its shape up to the end."""
        if self._sim.film.features.air:
            arrays["gas"][k, AMOUNT] = 0.0

    def _vented(self, gas: np.ndarray) -> list[int]:
        return np.flatnonzero((gas[:, AMOUNT] == 0.0) & (gas[:, GAUGE] != 0.0)).tolist()

    def _held(self, k: int, gas: np.ndarray) -> float:
        return gas[k, VOLUME]

    # --- rims that end at borders ------------------------------------------------------------------------------------

    def _live(self, arrays: dict[str, np.ndarray]) -> np.ndarray:
        """The free film of bubbles that burst."""
        region = arrays["e.region"][: self._sim.film.n_e]
        burst = [k for k, one in self._indices() if one < 0]
        return (arrays["e.behind"] == 0) & np.isin(region, burst) & (self._beyond() == OUTSIDE)

    def _indices(self) -> list[tuple[int, int]]:
        """The torn films by the indices of their regions."""
        labels = list(self._sim.film.labels)
        return [(labels.index(k), labels.index(j) if j >= 0 else -1) for k, j in self._sim.state.course.tears]

    def _ahead(self, rims: Rims, behind: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """For each point the nearest E of its film that no rim has passed, -1 for none, and its distance (m)."""
        film, e = self._sim.film, self._sim.state.e
        x, region = e.x.numpy()[: film.n_e].astype(np.float64), e.region.numpy()[: film.n_e]
        point = rims.point
        nearest, distance = np.full(len(point["x"]), -1), np.full(len(point["x"]), np.inf)
        for k in np.unique(point["region"]):
            here, there = np.flatnonzero(point["region"] == k), np.flatnonzero((region == k) & (behind == 0))
            if len(there):
                away = squares(point["x"][here], x[there])
                best = np.argmin(away, axis=1)
                nearest[here], distance[here] = there[best], np.sqrt(away[np.arange(len(here)), best])
        return nearest, distance

    def _blind(self, stored: Stored, rims: Rims) -> np.ndarray:
        return self._ahead(rims, stored.arrays["e.behind"])[1] > SIGHT * self._sim.film.spacing

    def _arrived(self, rims: Rims) -> np.ndarray:
        """[n] whether points have come to a border: the film before them has another region beyond it, or none."""
        nearest, _ = self._ahead(rims, self._sim.state.e.behind.numpy())
        return (nearest >= 0) & (self._beyond()[nearest] != rims.point["other"])

    def _collect(self, stored: Stored, rims: Rims, there: np.ndarray) -> None:
        """What comes to a border from outside breaks into drops, what comes from inside stays with the film around."""
        inside = rims.point["other"] >= 0
        self._spray(stored, rims.threads(rims.runs(there & ~inside)))
        self._keep_inside(stored, rims, np.flatnonzero(there & inside))
        for name in rims.sums:
            rims.point[name][there] = 0.0

    def _keep_inside(self, stored: Stored, rims: Rims, points: np.ndarray) -> None:
        """Give what points of rims on partitions hold to the film beyond the borders.

        There it comes to a stop: what it moved with becomes motion of both bubbles as a whole.
        """
        kind, there = stored.carriers, stored.there()
        arrays, point = stored.arrays, rims.point
        region = arrays[f"{kind}.region"][: len(there)]
        for k, j in {(int(point["region"][i]), int(point["other"][i])) for i in points}:
            own = points[(point["region"][points] == k) & (point["other"][points] == j)]
            held = {name: point[name][own] for name in ("x", "mass", *rims.held)}
            give(arrays, kind, held, np.flatnonzero(np.isin(region, (k, j)) & there))
            momentum = (point["mass"][own, None] * point["u"][own]).sum(axis=0)
            self._push(arrays, (k, j), momentum)
            self._gave = True
        stored.swept.leave(points)

    def _clear_up(self, stored: Stored, rims: Rims) -> None:
        """Nothing: what is behind the rims goes once all of its film is torn."""

    # --- films that are gone -----------------------------------------------------------------------------------------

    def _done(self) -> Callable[[Stored], None] | None:
        """The end of a film that no rim runs over any more; None for none."""
        if not self.torn:
            return None
        state = self._sim.state
        caved = state.gas.numpy()[:, VOLUME] < CAVED_IN * state.memory.volume.numpy()
        point = state.f
        left = set(zip(point.region.numpy().tolist(), point.other.numpy().tolist(), strict=True))
        for k, other in self._indices():
            if (k, other) not in left or (other < 0 and caved[k]):
                return self._end_bubble(k) if other < 0 else self._end_partition(k, other)
        return None

    def _end_bubble(self, k: int) -> Callable[[Stored], None]:
        """Region k is gone: its partitions are its neighbours', what else is left of its film becomes drops."""
        find_partners = self._sim.stepper.membrane.find_partners
        partner_e = find_partners("e")
        partner = find_partners("l") if self._sim.has_l else partner_e

        def change(stored: Stored) -> None:
            self.release(stored, k)
            self._hand_motion(stored, k, partner_e)
            arrays, kind, there = stored.arrays, stored.carriers, stored.there()
            region = arrays[f"{kind}.region"][: len(there)]
            own = (region == k) & there
            scraps = own & ~np.isin(partner, np.unique(region[there]))
            self._spray(stored, [self._liquid_of(stored, kind, scraps)])
            for name in ("mass", *stored.left):
                arrays[f"{kind}.{name}"][scraps] = 0.0
            if kind == "e":
                self._hand_across(stored, np.flatnonzero(own & ~scraps), partner)
                pop_region(stored, k, None)
                return
            shared = np.where(own & ~scraps, partner, -1)
            pop_region(stored, k, shared)

        return change

    def _end_partition(self, k: int, other: int) -> Callable[[Stored], None]:
        """The partition between two regions is gone: they are one."""
        partition = find_partition(self._sim, k, other)

        def change(stored: Stored) -> None:
            self.release_between(stored, k, other, partition)
            merge_regions(stored, k, other, partition)

        return change

    def _hand_motion(self, stored: Stored, k: int, partner: np.ndarray) -> None:
        """Give the momentum across its partitions of region k, with that of the air, to its neighbours as a whole.

        Once a bubble has lost its pressure those beside it push both sheets of a partition; what is left is one film.
        """
        stepper, arrays = self._sim.stepper, stored.arrays
        area, added = stepper.geometry.area.numpy().astype(np.float64), float(stepper.membrane.added.numpy()[k])
        n_e = len(area)
        region, normal = arrays["e.region"][:n_e], arrays["e.normal"][:n_e].astype(np.float64)
        across = (arrays["e.u"][:n_e] * normal).sum(axis=1) * (arrays["e.mass"] + added * area)
        for j in np.unique(partner[(region == k) & (partner >= 0)]):
            own = (region == k) & (partner == j)
            self._push(arrays, (int(j),), (across[own, None] * normal[own]).sum(axis=0))

    def _push(self, arrays: dict[str, np.ndarray], regions: tuple[int, ...], momentum: np.ndarray) -> None:
        """Give regions momentum [3], kg m/s, with which they move as one, air included (see `carry_motion_r`)."""
        air = self.scene.surroundings
        density = air.air_density if air.air != "none" else 0.0
        there = np.flatnonzero(np.isin(arrays["e.region"], regions))
        volume = arrays["gas"][list(regions), VOLUME].sum()
        gained = momentum / (arrays["e.mass"][there].sum(dtype=np.float64) + 1.5 * density * volume)
        normal = arrays["e.normal"][there]
        arrays["e.u"][there] += (normal @ gained)[:, None] * normal
        for name in (name for name in ("l.u", "l.v") if name in arrays):
            arrays[name][np.isin(arrays["l.region"], regions)] += gained

    def _hand_across(self, stored: Stored, index: np.ndarray, partner: np.ndarray) -> None:
        """Give the liquid of E of a sheet to those of the sheets on its other side."""
        arrays = stored.arrays
        for j in np.unique(partner[index]):
            own = index[partner[index] == j]
            held = {name: arrays[f"e.{name}"][own].astype(np.float64) for name in ("x", "u", "mass", "surfactant")}
            heirs = (arrays["e.region"][: len(partner)] == j) & stored.there()
            give(arrays, "e", held, np.flatnonzero(heirs), heirs=1)
            arrays["e.mass"][own] = 0.0
