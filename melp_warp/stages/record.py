"""Which L became which drop: a record on the host of the L whose liquid free rims and drops hold.

A rim takes L one by one, and what it then holds is shared out along it: points come and go, and drops are cut from it.
The record follows that L by L. Each is with one point of a rim, at a place along what that stands for, and goes whole
where most of its liquid goes; with as many L as an E has the difference is a few of them at the ends of a drop.
"""

from __future__ import annotations

import numpy as np

NONE = -1
"""For an L that is in no drop, or with no point of a rim."""

NAMES = {"l": np.int64, "rim": np.int32, "along": np.float32, "drop": np.int64}
"""What is recorded of each: its number, the point of a rim that holds it, where along it, and the number of a drop."""


def nothing() -> dict[str, np.ndarray]:
    """A record of no L."""
    return {name: np.zeros(0, dtype) for name, dtype in NAMES.items()}


class Swept:
    """The record of a stored state.

    Attributes:
        held: "l": [n] numbers of the L; "rim": [n] indices of the points of rims that hold them; "along": [n] where,
            from -1/2, halfway to the point before, to 1/2; "drop": [n] numbers of the drops that do. -1 for none.
    """

    def __init__(self, held: dict[str, np.ndarray]):
        self.held = held

    def __getitem__(self, name: str) -> np.ndarray:
        return self.held[name]

    def enter(self, numbers: np.ndarray, rim: np.ndarray, along: np.ndarray) -> np.ndarray:
        """Record L that points of rims have taken, or none (-1); where they are in the record. [k]."""
        n, k = len(self["l"]), len(numbers)
        new = {"l": numbers, "rim": rim, "along": along, "drop": np.full(k, NONE)}
        self.held.update({name: np.append(self[name], new[name]).astype(dtype) for name, dtype in NAMES.items()})
        return np.arange(n, n + k)

    def of(self, points: np.ndarray) -> np.ndarray:
        """Where those are in the record that these points hold."""
        return np.flatnonzero(np.isin(self["rim"], points)) if len(self["l"]) else np.zeros(0, dtype=int)

    def join(self, a: int, b: int) -> None:
        """Point a takes up b, the next one."""
        rim, along = self["rim"], self["along"]
        first, second = rim == a, rim == b
        along[first] = 0.5 * along[first] - 0.25
        along[second] = 0.5 * along[second] + 0.25
        rim[second] = a

    def put_in(self, a: int, b: int, new: int) -> None:
        """A new point between a and b takes the quarters of both that are next to it."""
        rim, along = self["rim"], self["along"]
        first, second = rim == a, rim == b
        after, before = first & (along > 0.25), second & (along < -0.25)
        first, second = first & ~after, second & ~before
        along[after], along[before] = 2.0 * along[after] - 1.0, 2.0 * along[before] + 1.0
        along[first] = (along[first] + 0.5) / 0.75 - 0.5
        along[second] = (along[second] + 0.25) / 0.75 - 0.5
        rim[after | before] = new

    def turn(self, points: np.ndarray) -> None:
        """These points are in the other order along their rims from now on."""
        self["along"][self.of(points)] *= -1.0

    def renumber(self, order: np.ndarray, count: int) -> None:
        """Points are in another order, `order` of `count` as they were; what others held is with none."""
        place = np.full(count + 1, NONE)
        place[order] = np.arange(len(order))
        self.held["rim"] = place[self["rim"]].astype(np.int32)

    def become(self, which: np.ndarray, drops: np.ndarray) -> None:
        """L of the record `which` are in drops of these numbers now, each in one."""
        self["drop"][which], self["rim"][which] = drops, NONE

    def leave(self, points: np.ndarray) -> None:
        """What these points hold is no rim's any more: the frame's, or the film's again."""
        self.forget(np.isin(self["rim"], points))

    def dry(self, drops: np.ndarray) -> None:
        """Drops of these numbers are gone."""
        self.forget(np.isin(self["drop"], drops))

    def by_drop(self, first: int) -> dict[int, np.ndarray]:
        """Number of each drop from `first` on -> numbers of the L whose liquid it holds, ascending."""
        chosen = np.flatnonzero(self["drop"] >= first)
        order = chosen[np.lexsort((self["l"][chosen], self["drop"][chosen]))]
        drops, start = np.unique(self["drop"][order], return_index=True)
        return dict(zip(drops.tolist(), np.split(self["l"][order], start[1:]), strict=True)) if len(drops) else {}

    def forget(self, gone: np.ndarray) -> None:
        """Take L out of the record: [n] mask."""
        if gone.any():
            self.held.update({name: array[~gone] for name, array in self.held.items()})

    def forget_lost(self) -> None:
        """Take out those that neither a rim nor a drop holds: the frame has them, or the film again."""
        self.forget((self["rim"] < 0) & (self["drop"] < 0))
