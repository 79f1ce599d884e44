"""Free rims on the host: chains of points that come and go, meet, join and break into drops."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from melp_warp.measure.fits import spans, turned
from melp_warp.stages.record import Swept, nothing

FEWEST = 4
"""Points of the shortest rim; E of the smallest film."""

RAYLEIGH = 9.01
"""Length of a thread that becomes a drop, in its radii (the fastest of its waves)."""

SCATTER = 0.5
"""Spread of the velocity of drops, over the speed at which a thread pulls back."""

ROUND = 24
"""Points of a small hole."""

BEADS, MOST_BEADS = 8, 100
"""Beads in a spacing that a rim is stored as."""

STEADY = 0.87
"""Cosine of half the angle between points of a rim beyond which they hit each other."""

UNEVEN = 0.3
"""Relative spread of the growth at which points of a rim break, so that they do not break all at once."""

POINT = ("x", "u", "inertia", "mass", "surfactant", "normal", "flow", "film", "growth", "limit", "region", "other")
"""What the points of a rim hold besides their places in a chain."""

SUMS = ("inertia", "mass", "surfactant")
"""What of that adds up, as does what a scene declares."""

LINKS = ("after", "before")
"""Their places in a chain."""


def breaking_points(count: int, rng: np.random.Generator) -> np.ndarray:
    """Growth at which points break, over the scene's. [count]."""
    return 1.0 + UNEVEN * rng.uniform(-1.0, 1.0, count)


def names_of(arrays: Iterable[str]) -> list[str]:
    """What points hold besides their links, of the names of a state's arrays."""
    return [name[2:] for name in arrays if name.startswith("f.") and name[2:] not in LINKS]


@dataclass
class Thread:
    """A thread of liquid: points in order with what each holds.

    Attributes:
        x: [n, 3] m.
        u: [n, 3] m/s.
        mass: [n] kg.
        length: [n] share of the thread's length, m.
        held: name -> [n] surfactant (mol) and what the scene declares.
        whose: [m] where the L whose liquid it is are in the record, see `Swept`.
        place: [m] where along the thread they are, as a share of its mass, 0 to 1.
    """

    x: np.ndarray
    u: np.ndarray
    mass: np.ndarray
    length: np.ndarray
    held: dict[str, np.ndarray]
    whose: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    place: np.ndarray = field(default_factory=lambda: np.zeros(0))

    def drops(self, density: float, tension: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """What the thread breaks into: drops as far apart as its fastest wave is long, which keep all sums.

        Necks pull back at about sqrt(sigma/(rho a)) in whatever direction: the drops scatter, their momentum does not.
        """
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
        scatter = SCATTER * np.sqrt(tension / (density * radius)) * rng.normal(size=(count, 3))
        scatter -= (drop @ scatter) / mass
        return {
            "x": x,
            "u": (share @ (self.mass[:, None] * self.u)) / drop[:, None] + scatter,
            "mass": drop,
            **{name: share @ held for name, held in self.held.items()},
        }

    def cut_at(self, count: int) -> np.ndarray:
        """[m] which of `count` drops each of the L whose liquid it is goes to."""
        return np.clip((self.place * count).astype(int), 0, count - 1)


@dataclass
class Chain:
    """A rim: indices of its points in order, and whether it is a loop; one that is not ends at a frame."""

    index: np.ndarray
    loop: bool


class Rims:
    """All rims, on the host.

    Attributes:
        point: what their points hold, by name: `POINT` and what the scene declares.
        chains: their order.
        held: names of what their liquid holds that adds up, surfactant and what the scene declares.
        sums: the same with mass and inertia.
        swept: the record of the L whose liquid they hold.
    """

    def __init__(self, point: dict[str, np.ndarray], chains: list[Chain], swept: Swept):
        self.point, self.chains, self.swept = point, chains, swept
        more = [name for name in point if name not in POINT]
        self.held, self.sums = ("surfactant", *more), (*SUMS, *more)

    @classmethod
    def of(cls, arrays: dict[str, np.ndarray], swept: Swept | None = None) -> Rims:
        """The rims of a stored state, in float64, with its record."""
        point = {name: arrays[f"f.{name}"].astype(np.float64) for name in names_of(arrays)}
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
        return cls(point, chains, swept or Swept(nothing()))

    def store(self, arrays: dict[str, np.ndarray]) -> None:
        """Put the rims into a stored state, chain by chain, and number their points so."""
        order = np.concatenate([chain.index for chain in self.chains] or [np.zeros(0, int)]).astype(int)
        self.swept.renumber(order, len(self.point["x"]))
        for name in self.point:
            arrays[f"f.{name}"] = self.point[name][order].astype(arrays[f"f.{name}"].dtype)
        self.point = {name: values[order] for name, values in self.point.items()}
        after, before, first = np.full(len(order), -1), np.full(len(order), -1), 0
        for chain in self.chains:
            k = first + np.arange(len(chain.index))
            after[k[:-1]], before[k[1:]] = k[1:], k[:-1]
            if chain.loop:
                after[k[-1]], before[k[0]] = k[0], k[-1]
            chain.index, first = k, first + len(k)
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
                index, inside = turned(index, inside)
            for start, stop in spans(inside):
                yield index[start:stop]

    def threads(self, indices: Iterable[np.ndarray]) -> list[Thread]:
        """The liquid of points that follow each other, run by run."""
        half = self.halves()
        return [self._thread(index, half) for index in indices]

    def _thread(self, index: np.ndarray, half: np.ndarray) -> Thread:
        held = {name: self.point[name][index] for name in self.held}
        x, u, mass = (self.point[name][index] for name in ("x", "u", "mass"))
        whose, order = self.swept.of(index), np.argsort(index)
        at = order[np.searchsorted(index, self.swept["rim"][whose], sorter=order)]
        place = (np.cumsum(mass)[at] + (self.swept["along"][whose] - 0.5) * mass[at]) / max(mass.sum(), 1e-300)
        return Thread(x, u, mass, half[index], held, whose, place)

    def beads(self, chain: Chain, density: float, spacing: float) -> tuple[np.ndarray, ...]:
        """Places, velocities, widths and normals along a chain, a radius apart, at least `BEADS` in a spacing."""
        index = chain.index
        radius = np.sqrt(self.point["mass"][index] / (np.pi * density * self.halves()[index]))
        gap = self._gaps(chain)
        if not chain.loop:
            gap = gap[:-1]
        apart = min(spacing / BEADS, max(float(np.median(radius)), spacing / MOST_BEADS))
        along = np.concatenate([[0.0], np.cumsum(gap)])
        at = np.linspace(0.0, along[-1], max(2, round(along[-1] / apart)), endpoint=not chain.loop)
        turn = np.append(index, index[:1]) if chain.loop else index
        width = 2.0 * np.append(radius, radius[:1])[: len(turn)]
        held = [self.point["x"][turn], self.point["u"][turn], width[:, None], self.point["normal"][turn]]
        x, u, width, normal = (
            np.stack([np.interp(at, along, column) for column in values.T], axis=1) for values in held
        )
        return x, u, width[:, 0], normal / np.linalg.norm(normal, axis=1, keepdims=True)

    def halves(self) -> np.ndarray:
        """[n] length of the rim that each point stands for, m."""
        half = np.zeros(len(self.point["x"]))
        for chain in self.chains:
            gap = self._gaps(chain)
            half[chain.index] += 0.5 * gap
            half[np.roll(chain.index, -1)] += 0.5 * gap
        return np.maximum(half, 1e-12)

    def hole(self, chain: Chain) -> float:
        """Area of the hole within a loop, that of a fan of triangles, m^2; of a chain that is closed by its chord."""
        x = self.point["x"][chain.index] - self.point["x"][chain.index].mean(axis=0)
        return 0.5 * float(np.linalg.norm(np.cross(x, np.roll(x, -1, axis=0)).sum(axis=0)))

    def _gaps(self, chain: Chain) -> np.ndarray:
        """[n] distance from each point of a chain to the next; 0 from the last of one that is no loop."""
        x = self.point["x"][chain.index]
        gap = np.linalg.norm(np.roll(x, -1, axis=0) - x, axis=1)
        if not chain.loop:
            gap[-1] = 0.0
        return gap

    def conormals(self) -> np.ndarray:
        """[n, 3] unit vectors from the hole into the film."""
        across = np.cross(self.directions(), self.point["normal"])
        return across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30)

    def directions(self) -> np.ndarray:
        """[n, 3] from the point before to the point after, m; 0 for a point alone and where it is in no chain."""
        found = np.zeros_like(self.point["x"])
        for chain in self.chains:
            x = self.point["x"][chain.index]
            along = np.roll(x, -1, axis=0) - np.roll(x, 1, axis=0)
            if not chain.loop and len(x) > 1:
                along[0], along[-1] = x[1] - x[0], x[-1] - x[-2]
            found[chain.index] = along
        return found

    def meet(self, reach: float) -> np.ndarray:
        """[n] whether points have come within `reach` (m) of a rim that runs against them."""
        x, out = self.point["x"], self.conormals()
        met = np.zeros(len(x), dtype=bool)
        for part in np.array_split(np.arange(len(x)), 1 + len(x) ** 2 // 2_000_000):
            way = x[None] - x[part, None]
            near = (way**2).sum(axis=2) < reach**2
            against = out[part] @ out.T < -0.2
            ahead = (way * out[part, None]).sum(axis=2) > 0.0
            same = self.point["region"][part, None] == self.point["region"]
            met[part] = (near & against & ahead & same).any(axis=1)
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
        half = self.halves()
        threads = [self._thread(run, half) for run in self.runs(liquid)]
        if not gone.any():
            return threads
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
                index, inside = turned(index, inside)
            for start, stop in spans(inside):
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
                threads.append(self._thread(chain.index, half))
        return threads

    def _join(self, runs: list[tuple[np.ndarray, bool, bool]], reach: float) -> list[Chain]:
        """Chains from runs of points: each free end goes on with the nearest free start."""
        x = self.point["x"]
        links = sorted(
            (float(np.linalg.norm(x[a[-1]] - x[b[0]])), i, j)
            for i, (a, _, open_end) in enumerate(runs)
            for j, (b, open_start, _) in enumerate(runs)
            if open_end and open_start and self.point["region"][a[-1]] == self.point["region"][b[0]]
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
                near = bool(np.linalg.norm(x[index[-1]] - x[index[0]]) < 2.0 * reach)
                chains.append(Chain(index, k == start or (runs[start][1] and near)))
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
            for name in self.sums:
                point[name][a] += point[name][b]
            self.swept.join(a, b)
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
        made["limit"] = breaking_points(len(where), rng)
        shares = {name: 0.25 * values for name, values in ((n, point[n]) for n in self.sums)}
        for name in self.sums:
            made[name] = shares[name][a] + shares[name][b]
            for end in (a, b):
                np.subtract.at(point[name], end, shares[name][end])
        made["normal"] /= np.linalg.norm(made["normal"], axis=1, keepdims=True)
        new = len(point["x"]) + np.arange(len(where))
        for name, values in point.items():
            point[name] = np.concatenate([values, made[name]])
        for ends in zip(a.tolist(), b.tolist(), new.tolist(), strict=True):
            self.swept.put_in(*ends)
        chain.index = np.insert(chain.index, where + 1, new)
