"""Conjugate gradients whose number of iterations does not grow with the number of unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from melp_warp.device.launch import clear, copy
from melp_warp.device.linear import ConjugateGradient, LinearOperator
from melp_warp.kernels import levels as kv
from melp_warp.kernels import linear as k
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
    """What a solver holds on one level: diagonal, residual and search direction."""

    def __init__(self, n: int, device):
        self.n = n
        arrays = (wp.zeros(n, dtype=wp.float32, device=device) for _ in range(6))
        self.held, self.stiff, self.fade, self.inverse, self.r, self.z = arrays


class MultilevelGradient(ConjugateGradient):
    """Conjugate gradients for scalars, preconditioned by D^-1 + P1 D1^-1 P1^T + P2 D2^-1 P2^T + ... over levels.

    Jacobi's D^-1 tells each unknown of its neighbours alone: a wave that spans the film takes as many iterations as it
    is long. Here each level adds what it sees at its own spacing (Bramble, Pasciak and Xu 1990). Only diagonals of the
    coarse levels are needed, no matrices: along a surface the stiffness of a level is the same as that of the finest.
    Towards where unknowns are held, by a rim or by their own diagonal, what coarse levels add fades out.

    The search starts from 0, and ends at sqrt((r, M r)/(b, M b)) below the tolerance, M the preconditioner: that is,
    as good as in the energy norm, the error itself.

    Args:
        operator: the matrix; unknowns at the points of the first of the levels.
        total: unknowns and boundary entries.
        tolerance, max_iterations: see `ConjugateGradient`.
        levels: from the finest on.
    """

    def __init__(self, operator: LinearOperator, total: int, tolerance, max_iterations, levels: list[Level]):
        super().__init__(operator, total, wp.float32, tolerance, max_iterations)
        self.levels = levels
        self._finest = _Part(self.n, self.device)
        self._finest.inverse, self._finest.r, self._finest.z = self.inverse, self.r, self.z
        self._parts = [self._finest, *(_Part(level.places, self.device) for level in levels)]

    def _body(self):
        a = self.operator.arrays
        clear(self.x)
        self._launch(k.invert_diagonal, a, [self.inverse])
        self._coarsen()
        self._launch(k.start_residual, [self.x, self.b, *a, self.inverse], [self.r, self.z, self.p])
        self._precondition()
        copy(self.p, self.z, count=self.n)
        self._dot(self.r, self.z, self.part_a)
        self._launch(k.start_scalars, [self.part_a, self.part_a, self.control, 0.0], [self.scalar, self.go], dim=1)
        self._repeat(self._iterate)

    def _coarsen(self):
        """Find the diagonals of all levels."""
        fine = self._finest
        self._launch(kv.split_diagonal_p, self.operator.arrays, [fine.held, fine.stiff, fine.fade])
        for level, fine, part in self._pairs():
            inputs = [level.down, level.down_weight, fine.held, fine.stiff, fine.fade]
            outputs = [part.held, part.stiff, part.fade, part.inverse]
            self._launch(kv.coarsen_diagonal_p, inputs, outputs, dim=part.n)

    def _precondition(self):
        """From D^-1 r to the sum over all levels."""
        pairs = self._pairs()
        for level, fine, part in pairs:
            inputs = [level.down, level.down_weight, fine.fade, fine.r, part.inverse]
            self._launch(kv.restrict_p, inputs, [part.r, part.z], dim=part.n)
        for level, fine, part in reversed(pairs):
            self._launch(kv.add_next_p, [level.up, level.up_weight, fine.fade, part.z], [fine.z], dim=fine.n)

    def _pairs(self) -> list[tuple[Level, _Part, _Part]]:
        """Each level with what the solver holds on its finer and its coarser side."""
        return list(zip(self.levels, self._parts[:-1], self._parts[1:], strict=True))
