"""State: exactly what a checkpoint stores. Everything else is rebuilt from it."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
import warp as wp

GAS_SLOTS = ("volume", "gauge_pressure", "amount", "increment", "area", "offset")

BORDER_SLOTS = ("mass", "surfactant", "impulse_x", "impulse_y", "impulse_z")


def _array(dtype):
    return field(metadata={"dtype": dtype})


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
        count: number of E.
    """

    x: wp.array = _array(wp.vec3)
    normal: wp.array = _array(wp.vec3)
    u: wp.array = _array(wp.vec3)
    mass: wp.array = _array(wp.float32)
    surfactant: wp.array = _array(wp.float32)
    region: wp.array = _array(wp.int32)
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
        count: number of L.
    """

    x: wp.array = _array(wp.vec3)
    u: wp.array = _array(wp.vec3)
    v: wp.array = _array(wp.vec3)
    affine: wp.array = _array(wp.mat33)
    normal: wp.array = _array(wp.vec3)
    mass: wp.array = _array(wp.float32)
    surfactant: wp.array = _array(wp.float32)
    eta: wp.array = _array(wp.float32)
    region: wp.array = _array(wp.int32)
    count: int = 0


def _arrays(block) -> dict[str, wp.array]:
    return {f.name: getattr(block, f.name) for f in fields(block) if "dtype" in f.metadata}


def allocate(kind, sizes: dict[str, int], default: int, device, **counts):
    """Make a zeroed state block; `sizes` overrides the length of single arrays."""
    made = {
        f.name: wp.zeros(sizes.get(f.name, default), dtype=f.metadata["dtype"], device=device)
        for f in fields(kind)
        if "dtype" in f.metadata
    }
    return kind(**made, **counts)


@dataclass
class State:
    """The state of a film.

    Attributes:
        e: Eulerian particles.
        l: Lagrangian particles, or None.
        gas: [regions, 6] float64, see `GAS_SLOTS`: volume (m^3), gauge pressure (Pa), amount n0 R T (J), pressure
            increment of the last step (Pa), area (m^2), normal offset that closed the volume in the last step (m).
        motion: [regions] velocity of a closed film as a whole, m/s: it changes by outside forces alone.
        border: [5] float64, see `BORDER_SLOTS`: liquid (kg) and surfactant of one interface (mol) that the rim of an
            open film has collected, and the momentum that it has taken from the flow along the film, kg m/s; None
            without a rim or without L.
        origin: [3] float64, m: where positions are measured from. They are float32, which resolves 1e-7 of a distance:
            of that from the film, not from the world's origin.
        time: s.
        frame: index of the last finished frame.
    """

    e: EulerianState
    l: LagrangianState | None  # noqa: E741
    gas: wp.array
    motion: wp.array
    border: wp.array | None = None
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    time: float = 0.0
    frame: int = 0

    def arrays(self) -> dict[str, wp.array]:
        """All arrays by name, in a fixed order."""
        named = {f"e.{k}": a for k, a in _arrays(self.e).items()}
        if self.l is not None:
            named |= {f"l.{k}": a for k, a in _arrays(self.l).items()}
        named |= {"gas": self.gas, "motion": self.motion}
        return named if self.border is None else named | {"border": self.border}

    def numpy(self) -> dict[str, np.ndarray]:
        """All arrays and scalars as NumPy copies, as a checkpoint stores them."""
        stored = {name: a.numpy().copy() for name, a in self.arrays().items()}
        return stored | {"origin": self.origin.copy(), "time": np.array(self.time), "frame": np.array(self.frame)}

    def load(self, stored: dict[str, np.ndarray]) -> None:
        """Take the values of `numpy()` back, in place."""
        for name, array in self.arrays().items():
            array.assign(stored[name])
        self.origin = state_origin(stored)
        self.time = float(stored["time"])
        self.frame = int(stored["frame"])


def state_origin(stored: dict[str, np.ndarray]) -> np.ndarray:
    """Where the positions of a stored state are measured from; the world's origin where nothing is said. [3], m."""
    return np.array(stored.get("origin", np.zeros(3)), dtype=np.float64)


class Snapshot:
    """A copy of a state on its own device, made once and overwritten at each good frame."""

    def __init__(self, state: State):
        self._copies = {name: wp.clone(a) for name, a in state.arrays().items()}
        self._scalars = (state.origin, state.time, state.frame)

    def save(self, state: State) -> None:
        """Copy the state here."""
        for name, array in state.arrays().items():
            wp.copy(self._copies[name], array)
        self._scalars = (state.origin, state.time, state.frame)

    def restore(self, state: State) -> None:
        """Copy the saved state back."""
        for name, array in state.arrays().items():
            wp.copy(array, self._copies[name])
        state.origin, state.time, state.frame = self._scalars
