"""Conjugate gradients whose number of iterations does not grow with the number of unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from melp_warp.device.launch import Recorded, clear, copy
from melp_warp.device.linear import CHUNKS, ConjugateGradient, LinearOperator, Solver, shares_of_error, upper_half
from melp_warp.kernels import levels as kv
from melp_warp.kernels import linear as k
from melp_warp.kernels import poles as kp
from melp_warp.kernels.neighbors import Neighbors


@dataclass(frozen=True)
class Level:
    """How a number of points is shared among the places of a coarser level (`melp_warp.stages.levels`).

    Attributes:
        n: points.
        places: of the coarser level; some may be empty.
        up: places near each point.
        up_weight: [pairs of `up`] shares, that of each point add up to 1.
        down: points near each place.
        down_weight: [pairs of `down`] the same shares.
    """

    n: int
    places: int
    up: Neighbors
    up_weight: wp.array
    down: Neighbors
    down_weight: wp.array


class _Part:
    """A diagonal on one level: what holds unknowns, what ties them, how coarser levels fade out, and its inverse."""

    def __init__(self, n: int, device):
        self.n = n
        arrays = (wp.zeros(n, dtype=wp.float32, device=device) for _ in range(4))
        self.held, self.stiff, self.fade, self.inverse = arrays


class _Diagonals:
    """Those of a matrix on all levels, found from its own."""

    def __init__(self, solver: Solver, operator: LinearOperator, levels: list[Level]):
        self._launch, self.operator, self.levels = solver._launch, operator, levels
        self.parts = [_Part(n, solver.device) for n in (operator.n, *(level.places for level in levels))]

    def find(self) -> None:
        """Find them for the matrix as it is."""
        fine = self.parts[0]
        self._launch(kv.split_diagonal_p, self.operator.arrays, [fine.held, fine.stiff, fine.fade])
        for level, fine, part in self.pairs():
            inputs = [level.down, level.down_weight, fine.held, fine.stiff, fine.fade]
            outputs = [part.held, part.stiff, part.fade, part.inverse]
            self._launch(kv.coarsen_diagonal_p, inputs, outputs, dim=part.n)

    def pairs(self) -> list[tuple[Level, _Part, _Part]]:
        """Each level with what is held on its finer and on its coarser side."""
        return list(zip(self.levels, self.parts[:-1], self.parts[1:], strict=True))


class MultilevelGradient(ConjugateGradient):
    """Conjugate gradients for scalars, preconditioned by D^-1 + P1 D1^-1 P1^T + P2 D2^-1 P2^T + ... over levels.

    Jacobi's D^-1 tells each unknown of its neighbours alone: a wave that spans the film takes as many iterations as it
    is long. Here each level adds what it sees at its own spacing (Bramble, Pasciak and Xu 1990). Only diagonals of the
    coarse levels are needed, no matrices: along a surface the stiffness of a level is the same as that of the finest.
    Towards where unknowns are held, by a rim or by their own diagonal, what coarse levels add fades out.

    The search starts from `x` and ends where `ConjugateGradient` does, at the same residual, measured by D^-1: each
    wave of it counts alike. By `energy` it starts from 0 and ends at sqrt((r, M r)/(b, M b)) below the tolerance, M the
    preconditioner: as good as in the energy norm, the error itself. The longer the waves of b are against the spacing,
    the more that leaves of the shortest.

    Args:
        operator: the matrix; unknowns at the points of the first of the levels.
        total: unknowns and boundary entries.
        tolerance, max_iterations, x: see `ConjugateGradient`.
        levels: from the finest on.
        energy: see above.
    """

    def __init__(
        self,
        operator: LinearOperator,
        total: int,
        tolerance,
        max_iterations,
        levels: list[Level],
        x: wp.array | None = None,
        energy: bool = False,
    ):
        super().__init__(operator, total, wp.float32, tolerance, max_iterations, x=x)
        self.energy = energy
        self.slack = 1.0 if energy else 0.0
        self._diagonals = _Diagonals(self, operator, levels)
        self._r = [self.r, *(self._zeros(level.places) for level in levels)]
        self._z = [self.z, *(self._zeros(level.places) for level in levels)]

    def _zeros(self, n: int) -> wp.array:
        return wp.zeros(n, dtype=wp.float32, device=self.device)

    def _body(self):
        a = self.operator.arrays
        if self.energy:
            clear(self.x)
        self._launch(k.invert_diagonal, a, [self.inverse])
        self._diagonals.find()
        self._launch(k.start_residual, [self.x, self.b, *a, self.inverse], [self.r, self.z, self.p])
        if self.energy:
            self._turn()
            self._start_at(self.part_a, self.part_a)
        else:
            self._dot(self.r, self.z, self.part_a)
            self._launch(k.weighted_chunks, [self.b, self.b, self.inverse, self.n], [self.part_b], dim=CHUNKS)
            self._start_at(self.part_a, self.part_b)
            self._turn()
            self._launch(k.set_product, [self.part_a], [self.scalar], dim=1)
        self._repeat(self._iterate)

    def _turn(self):
        """The first direction."""
        self._precondition()
        copy(self.p, self.z, count=self.n)
        self._dot(self.r, self.z, self.part_a)

    def _start_at(self, measured, reference):
        self._launch(k.start_scalars, [measured, reference, self.control, 0.0], [self.scalar, self.go], dim=1)

    def _stop(self):
        if not self.energy:
            self._launch(k.stop_at_limit, [self.part_b], [self.scalar, self.go], dim=1)

    def _precondition(self):
        """From D^-1 r to the sum over all levels."""
        if not self.energy:
            self._dot(self.r, self.z, self.part_b)
        steps = list(enumerate(self._diagonals.pairs()))
        for at, (level, fine, part) in steps:
            inputs = [level.down, level.down_weight, fine.fade, self._r[at], part.inverse]
            self._launch(kv.restrict_p, inputs, [self._r[at + 1], self._z[at + 1]], dim=part.n)
        for at, (level, fine, _) in reversed(steps):
            inputs = [level.up, level.up_weight, fine.fade, self._z[at + 1]]
            self._launch(kv.add_next_p, inputs, [self._z[at]], dim=fine.n)


class MultilevelRational(Solver):
    """x = f(-Laplacian) b for f(lambda) = Re sum_k g_k/(lambda + p_k), each pole by conjugate gradients over levels.

    (W + p_k A) y_k = A b for all poles at once, W the pairs of the Laplacian and A the areas, preconditioned as
    `MultilevelGradient`'s with a diagonal for each pole. What a coarse place stands for of A is taken whole, not its
    diagonal alone: where p outweighs the stiffness all levels are the same wave, of which the sum of them should see
    one. Complex systems are symmetric, not Hermitian: their conjugate gradients conjugate nothing (van der Vorst and
    Melissen 1990); the real part of the p_k of films is above 0.

    The search ends where sum_k |g_k| ((r, M r)_k/|p_k + low|)^1/2, which bounds the error in x, is below the tolerance
    times f(low) (A b, b)^1/2: as that of `RationalLaplacian`, in the norm of the error in place of the residual's.

    Attributes:
        b: [n] right-hand side, filled by the owner.
        x: [n] solution.
    """

    def __init__(self, n, total, pair, area, rows: Neighbors, tolerance, max_iterations, device, levels: list[Level]):
        super().__init__(n, tolerance, max_iterations, device)
        self.area = area
        self.operator = LinearOperator(n, rows, device, pair=pair)
        self._diagonals = _Diagonals(self, self.operator, levels)
        parts = self._diagonals.parts
        self.b, self.x = (wp.zeros(n, dtype=wp.float32, device=device) for _ in range(2))
        self._mass = [area, *(wp.zeros(part.n, dtype=wp.float32, device=device) for part in parts[1:])]
        self._r, self._z = ([self._eights(part.n) for part in parts] for _ in range(2))
        self._y, self._p = (self._eights(total) for _ in range(2))
        self._q = self._eights(n)
        self._same, self._across = (self._eights(CHUNKS) for _ in range(2))
        self._numbers = self._eights(4)
        self.lanes = kp.Lanes()
        for name in ("real", "cross", "paired", "tied", "load", "residue", "weight"):
            setattr(self.lanes, name, self._eights(1))
        self._improve = Recorded(self._again, device, n)

    def _eights(self, n: int) -> wp.array:
        return wp.zeros(n, dtype=k.vec8, device=self.device)

    def set_function(self, poles: np.ndarray, residues: np.ndarray, low: float) -> None:
        """As `RationalLaplacian.set_function`.

        Raises:
            ValueError: there are more than eight.
        """
        poles, residues, paired = upper_half(poles, residues)
        weight = shares_of_error(poles, residues, low) * np.sqrt(np.abs(poles + low))
        if len(poles) + paired.sum() > k.POLES:
            raise ValueError(f"no room for all of {poles}")
        lanes = {name: np.zeros(k.POLES) for name in ("cross", "paired", "load", "residue", "weight")}
        lanes |= {"real": np.full(k.POLES, np.abs(poles).max()), "tied": np.ones(k.POLES)}
        at = 0
        for one in np.argsort(~paired, kind="stable"):
            p, g, width = poles[one], residues[one], 1 + paired[one]
            both = slice(at, at + width)
            lanes["real"][both], lanes["tied"][both], lanes["paired"][both] = p.real, p.real > 0.0, paired[one]
            lanes["load"][at], lanes["weight"][at] = 1.0, weight[one]
            lanes["residue"][both] = [g.real, -g.imag][:width]
            lanes["cross"][both] = [-p.imag, p.imag][:width] if paired[one] else 0.0
            at += width
        for name, values in lanes.items():
            getattr(self.lanes, name).assign(values[None])

    def improve(self) -> None:
        """Solve again from where the last solve ended: for a `b` that has changed by little."""
        self._improve()

    def _body(self):
        self._launch(kp.load_lanes, [self.b, self.area, self.lanes], [self._r[0], self._y])
        self._search()

    def _again(self):
        inputs = [self.b, self._y, self.area, self.operator.pair, self.operator.rows, self.lanes]
        self._launch(kp.find_residual_lanes, inputs, [self._r[0]])
        self._search()

    def _search(self):
        self._diagonals.find()
        for at, (level, fine, part) in enumerate(self._diagonals.pairs()):
            inputs = [level.down, level.down_weight, fine.fade, self._mass[at]]
            self._launch(kp.coarsen_mass_p, inputs, [self._mass[at + 1]], dim=part.n)
        fine = self._diagonals.parts[0]
        self._launch(kp.divide_lanes, [self._r[0], fine.held, fine.stiff, self.area, self.lanes], [self._z[0]])
        self._precondition()
        copy(self._p, self._z[0], count=self.n)
        self._dot_lanes(self._r[0], self._z[0])
        self._launch(k.weighted_chunks, [self.b, self.b, self.area, self.n], [self.part_b], dim=CHUNKS)
        inputs = [self._same, self._across, self.part_b, self.control, self.lanes]
        self._launch(kp.start_lane_scalars, inputs, [self._numbers, self.scalar, self.go], dim=1)
        self._repeat(self._iterate)
        self._launch(kp.sum_lanes, [self._y, self.lanes], [self.x])

    def _iterate(self):
        fine = self._diagonals.parts[0]
        inputs = [self._p, self.area, self.operator.pair, self.operator.rows, self.lanes]
        self._launch(kp.apply_all_lanes, inputs, [self._q])
        self._dot_lanes(self._p, self._q)
        self._launch(kp.set_lane_steps, [self._same, self._across, self.lanes, self.go], [self._numbers], dim=1)
        inputs = [self._numbers, self._p, self._q, fine.held, fine.stiff, self.area, self.lanes]
        self._launch(kp.advance_lanes, inputs, [self._y, self._r[0], self._z[0]])
        self._precondition()
        self._dot_lanes(self._r[0], self._z[0])
        inputs = [self._same, self._across, self.control, self.lanes]
        self._launch(kp.set_lane_turns, inputs, [self._numbers, self.scalar, self.go], dim=1)
        self._launch(kp.turn_lanes, [self._numbers, self._z[0]], [self._p])

    def _dot_lanes(self, a, b):
        self._launch(kp.dot_lanes_chunks, [a, b, self.n], [self._same, self._across], dim=CHUNKS)

    def _precondition(self):
        """From D^-1 r to the sum over all levels."""
        steps = list(enumerate(self._diagonals.pairs()))
        for at, (level, fine, part) in steps:
            inputs = [level.down, level.down_weight, fine.fade, self._r[at], part.held, part.stiff, self._mass[at + 1]]
            self._launch(kp.restrict_lanes_p, [*inputs, self.lanes], [self._r[at + 1], self._z[at + 1]], dim=part.n)
        for at, (level, fine, _) in reversed(steps):
            inputs = [level.up, level.up_weight, fine.fade, self._z[at + 1]]
            self._launch(kp.add_next_lanes_p, inputs, [self._z[at]], dim=fine.n)
