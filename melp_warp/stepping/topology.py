"""Changes of topology between steps: regions that pop, merge or appear.

They work on a state as `State.numpy` gives it, with the ids of the particles and the labels of the regions, and give a
state of other sizes back, from which the run is set up anew.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from melp_warp.measure.fits import squares
from melp_warp.stages.record import Swept
from melp_warp.stages.state import AMOUNT, GAS_SLOTS, GAUGE, VOLUME, State

AMOUNTS = ("mass", "surfactant")
"""What particles hold that adds up, besides what the scene declares."""

HEIRS = 128
"""Particles that share what one particle of a broken partition leaves."""


@dataclass
class Stored:
    """A foam's state on the host.

    Attributes:
        arrays: by name, as `State.numpy` names them.
        ids: "e" and "l": [n] int64.
        labels: the scene's number of each region.
        spilled: liquid that left with films that popped, kg.
        amounts: what particles hold that adds up.
        tears, left: films that are torn, and what left of what is declared, see `Course`.
        issued: how many numbers were given to particles of each set so far, see `Course`.
        swept: the record of L whose liquid rims and drops hold.
    """

    arrays: dict[str, np.ndarray]
    ids: dict[str, np.ndarray]
    labels: list[int] = field(default_factory=list)
    spilled: float = 0.0
    amounts: tuple[str, ...] = AMOUNTS
    tears: list[list[int]] = field(default_factory=list)
    left: dict[str, float] = field(default_factory=dict)
    issued: dict[str, int] = field(default_factory=dict)
    swept: Swept = field(default_factory=lambda: Swept({}))

    @classmethod
    def of(cls, state: State) -> Stored:
        """The state as it is now; what stages remember of it is of no use to another one."""
        stored = state.numpy()
        arrays = {k: a for k, a in stored.items() if not k.startswith(("memory.", "ids.", "swept."))}
        if "memory.area" in stored:
            arrays["memory.area"] = stored["memory.area"]  # found from the L at the start
        course, amounts = state.course, (*AMOUNTS, *state.carried)
        own = {"tears": [list(one) for one in course.tears], "left": dict(course.left), "issued": dict(course.issued)}
        own["swept"] = Swept({name: array.copy() for name, array in state.swept.items()})
        return cls(arrays, dict(state.ids), list(course.labels), course.spilled, amounts, **own)

    @property
    def kinds(self) -> str:
        """The particle sets there are, "e" or "el"."""
        return "el" if "l.x" in self.arrays else "e"

    @property
    def carriers(self) -> str:
        """The set that holds the liquid: "l" where there are L, else "e"."""
        return self.kinds[-1]

    @property
    def flag(self) -> str:
        """Name of the array that says of which of them a free rim has it; there is one where films may burst."""
        return {"l": "l.behind", "e": "e.swept"}[self.carriers]

    def there(self) -> np.ndarray:
        """[n] of which of them none has it."""
        taken = self.arrays.get(self.flag)
        return np.ones(len(self.arrays[f"{self.carriers}.mass"]), dtype=bool) if taken is None else taken == 0

    def issue(self, kind: str, count: int) -> np.ndarray:
        """[count] numbers for new particles of a set, which none has had before."""
        first = self.issued[kind]
        self.issued[kind] += count
        return np.arange(first, first + count)

    def leave(self, kind: str, chosen: np.ndarray) -> float:
        """Count what the particles `chosen` of a set hold among what left; their liquid, kg."""
        for name in self.left:
            self.left[name] += float(self.arrays[f"{kind}.{name}"][chosen].sum(dtype=np.float64))
        return float(self.arrays[f"{kind}.mass"][chosen].sum(dtype=np.float64))

    def select(self, kind: str, chosen: np.ndarray) -> None:
        """Keep the particles `chosen` (mask or indices) of one set, in that order."""
        for name in self.arrays:
            if name.startswith(f"{kind}."):
                self.arrays[name] = self.arrays[name][chosen]
        self.ids[kind] = self.ids[kind][chosen]

    def region(self, kind: str) -> np.ndarray:
        """[n] region of each particle."""
        return self.arrays[f"{kind}.region"]

    def drop_region(self, k: int) -> None:
        """Forget region k, whose particles are gone, and number those after it anew."""
        for name in ("gas", "motion"):
            self.arrays[name] = np.delete(self.arrays[name], k, axis=0)
        names = [f"{kind}.region" for kind in self.kinds] + ["f.region", "f.other"]
        for region in (self.arrays[name] for name in names if name in self.arrays):
            region[region > k] -= 1
        self.tears = [one for one in self.tears if self.labels[k] not in one]
        del self.labels[k]


def pop_region(stored: Stored, k: int, partner_l: np.ndarray | None) -> None:
    """Remove region k. Liquid on its partitions goes to the films beyond them, the rest is spilled.

    Args:
        stored: the state, changed in place.
        k: index of the region.
        partner_l: [n_l] region that each L's film is shared with, -1 for none; None without L.
    """
    if partner_l is not None:
        region, there = stored.region("l"), stored.there()
        shared = (region == k) & (partner_l >= 0) & there
        if "l.circulation" in stored.arrays:
            stored.arrays["l.circulation"][shared] *= -1.0  # about the normal of the other side
        for other in np.unique(partner_l[shared]):
            _hand_over(stored, "l", shared & (partner_l == other), (region == other) & there)
        stored.spilled += stored.leave("l", (region == k) & there & ~shared)
        stored.select("l", region != k)
    else:
        own = (stored.region("e")[: len(stored.arrays["e.mass"])] == k) & stored.there()
        stored.spilled += stored.leave("e", own)
    stored.select("e", stored.region("e") != k)
    stored.drop_region(k)


def merge_regions(stored: Stored, k: int, other: int, partition: dict[str, np.ndarray]) -> None:
    """Make regions k and `other` one, k, without the partition between them; its liquid goes to the film nearest.

    Args:
        stored: the state, changed in place.
        k: index of the region that stays.
        other: index of the one that goes.
        partition: "e" and "l": [n] mask of the particles of the partition.
    """
    for kind in stored.kinds:
        region = stored.region(kind)
        both = (region == k) | (region == other)
        region[both] = k
        gone = both & partition[kind]
        if kind == stored.carriers:
            there = stored.there()
            _hand_over(stored, kind, gone & there, both & ~gone & there)
        stored.select(kind, ~gone)
    for rims in (stored.arrays[name] for name in ("f.region", "f.other") if name in stored.arrays):
        rims[rims == other] = k
    gas = stored.arrays["gas"]
    volume = gas[[k, other], VOLUME]
    if gas[[k, other], AMOUNT].min() == 0.0:  # one is open to the outside
        gas[[k, other], AMOUNT] = 0.0
    gas[k, GAUGE] = np.average(gas[[k, other], GAUGE], weights=volume)
    gas[k, VOLUME], gas[k, AMOUNT] = volume.sum(), gas[[k, other], AMOUNT].sum()
    names = {stored.labels[other]: stored.labels[k]}
    tears = dict.fromkeys(tuple(names.get(label, label) for label in one) for one in stored.tears)
    stored.tears = [list(one) for one in tears if one[0] != one[1]]
    stored.drop_region(other)
    stored.select("e", np.argsort(stored.region("e"), kind="stable"))


def _hand_over(stored: Stored, kind: str, gone: np.ndarray, kept: np.ndarray) -> None:
    """Give momentum and what adds up of the particles that go to those nearest that stay, `HEIRS` to each."""
    arrays, names = stored.arrays, ("x", "u", "eta", "circulation", *stored.amounts)
    if not kept.any():
        stored.spilled += stored.leave(kind, gone)
    held = {name: arrays[f"{kind}.{name}"][gone] for name in names if f"{kind}.{name}" in arrays}
    give(arrays, kind, held, np.flatnonzero(kept))


def give(
    arrays: dict[str, np.ndarray], kind: str, held: dict[str, np.ndarray], targets: np.ndarray, heirs: int = HEIRS
) -> None:
    """Give what is held at some places to the particles nearest to them.

    Args:
        arrays: the state's, changed in place.
        kind: "e" or "l": the set of the particles that get it.
        held: [n, 3] "x" (m) and "u" (m/s); [n] "mass" (kg) and what else adds up. Without "u" the speeds stay.
        targets: indices of the particles that may get it.
        heirs: of these that share what is at one place.
    """
    if not len(held["x"]) or not len(targets):
        return
    x, mass, u = arrays[f"{kind}.x"], arrays[f"{kind}.mass"], arrays[f"{kind}.u"]
    heirs = min(heirs, len(targets))
    nearest = np.concatenate(
        [
            targets[np.argpartition(squares(part, x[targets]), heirs - 1, axis=1)[:, :heirs]]
            for part in np.array_split(held["x"], 1 + len(held["x"]) * len(targets) // 2_000_000)
        ]
    )
    had, momentum = mass.copy(), mass[:, None] * u[: len(mass)]
    if "u" in held:
        np.add.at(momentum, nearest, (held["mass"][:, None] * held["u"])[:, None] / heirs)
    for name in (name for name in held if name not in ("x", "u", "eta", "circulation")):
        np.add.at(arrays[f"{kind}.{name}"], nearest, held[name][:, None] / heirs)
    if "u" in held:
        met = np.unique(nearest)
        u[met] = momentum[met] / mass[met, None]
    if kind == "l":
        _stay_as_wide(arrays, held, nearest, had)


def _stay_as_wide(
    arrays: dict[str, np.ndarray], held: dict[str, np.ndarray], nearest: np.ndarray, had: np.ndarray
) -> None:
    """Let L that were given liquid keep their areas: they get thicker, and their vorticity is the mean by mass.

    Args:
        arrays: of the state, in which they have got it.
        held: what was given, see `give`; without "circulation" it had no vorticity.
        nearest: [n, HEIRS] indices of those that each gave to, in equal shares.
        had: [n_l] mass of each before, kg.
    """
    mass, eta, met = arrays["l.mass"], arrays["l.eta"], np.unique(nearest)
    circulation = arrays.get("l.circulation")
    if circulation is not None:  # vorticities over the density
        brought = np.zeros(len(mass))
        if "circulation" in held:
            np.add.at(brought, nearest, (held["circulation"] * held["eta"] / nearest.shape[1])[:, None])
        circulation[met] = had[met] * (circulation[met] + brought[met] / eta[met]) / mass[met]
    eta[met] *= mass[met] / had[met]


def add_region(
    stored: Stored,
    label: int,
    particles: dict[str, dict[str, np.ndarray]],
    gauge: float,
    velocity: tuple[float, float, float],
) -> None:
    """Append a region; its volume and amount of gas are filled in where the volume is measured.

    Args:
        stored: the state, changed in place.
        label: the scene's number of the region.
        particles: "e" and "l": arrays of the new particles by name; what is missing is 0.
        gauge: pressure over the atmosphere's, Pa.
        velocity: of the region as a whole, m/s.
    """
    k = len(stored.labels)
    for kind in stored.kinds:
        count = len(particles[kind]["x"])
        for name, array in stored.arrays.items():
            if name.startswith(f"{kind}."):
                new = np.zeros((count, *array.shape[1:]), dtype=array.dtype)
                new[...] = k if name.endswith(".region") else particles[kind].get(name[2:], new)
                stored.arrays[name] = np.concatenate([array, new])
        stored.ids[kind] = np.concatenate([stored.ids[kind], stored.issue(kind, count)])
    gas = np.zeros((1, len(GAS_SLOTS)))
    gas[0, GAUGE] = gauge
    stored.arrays["gas"] = np.concatenate([stored.arrays["gas"], gas])
    stored.arrays["motion"] = np.concatenate([stored.arrays["motion"], [velocity]])
    stored.labels.append(label)
