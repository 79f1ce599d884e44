"""Conjugate gradients, relaxed Jacobi and rational functions of the surface Laplacian, as replayed graphs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import warp as wp

from melp_warp.device.launch import Recorded, clear, copy, launch, repeat
from melp_warp.kernels import linear as k
from melp_warp.kernels.neighbors import Neighbors

CHUNKS = 64

ENTRIES = 256
"""Entries of an array that a CPU thread takes at once where a kernel looks at nothing else; a GPU thread takes one."""

CHANGE = 1e-6
"""Square of the least change, over x, that a solve `of_change` finds to its tolerance: less is near rounding."""
WORTHLESS = 0.5
"""Relative residual from which what a solve found is worth no more than nothing would be."""


def most_iterations(n: int, tolerance: float) -> int:
    """Iterations at which a solve for n unknowns on a surface is given up.

    Conjugate gradients need at most ln(2/tolerance)/2 times the root of the condition number, and on an even film that
    is below 0.15 n for the surface Laplacian (the longest wave against the shortest). Five times as many are left to
    uneven films, and 100 to small ones.
    """
    return 100 + math.ceil(math.sqrt(n) * math.log(2.0 / tolerance))


@dataclass(frozen=True)
class Account:
    """What became of a number of solves.

    Attributes:
        worst: the largest relative residual that one ended with; infinite where one is not finite.
        late: how many ended above the tolerance.
        solves: how many there were.
        most: the most iterations that one took.
        allowed: iterations at which they are given up.
        tolerance: relative residual at which they end.
    """

    worst: float
    late: int
    solves: int
    most: int
    allowed: int
    tolerance: float

    def __add__(self, other: Account) -> Account:
        """The account of both."""
        return Account(
            max(self.worst, other.worst),
            self.late + other.late,
            self.solves + other.solves,
            max(self.most, other.most),
            max(self.allowed, other.allowed),
            max(self.tolerance, other.tolerance),
        )

    @property
    def text(self) -> str:
        """The account in words."""
        return (
            f"{self.late} of {self.solves} solves end at a relative residual up to {self.worst:.2g} in place of"
            f" {self.tolerance:g}, after {self.most} iterations of at most {self.allowed} (max_iterations)"
        )


class LinearOperator:
    """(A x)_i = diag_i x_i + scale sum_j pair_ij (x_i - x_j), held as arrays that its owner fills.

    Attributes:
        diag: [n] float32.
        pair: [pairs] float32, symmetric, aligned with `rows`.
        scale: [1] float32.
        rows: neighbours; entries of index >= n are boundary.
    """

    def __init__(self, n: int, rows: Neighbors, device, pair: wp.array | None = None):
        self.n = n
        self.rows = rows
        self.device = device
        self.diag = wp.zeros(n, dtype=wp.float32, device=device)
        self.pair = pair if pair is not None else wp.zeros(rows.index.shape[0], dtype=wp.float32, device=device)
        self.scale = wp.ones(1, dtype=wp.float32, device=device)

    @property
    def arrays(self) -> list:
        """diag, pair, scale, rows: the arguments of the kernels."""
        return [self.diag, self.pair, self.scale, self.rows]


class Solver:
    """What the iterative solvers share: scalars, control and the counters read back for diagnostics.

    `max_iterations` of None is `most_iterations`.
    """

    def __init__(self, n: int, tolerance: float, max_iterations: int | None, device, stride: int = 1, dtype=wp.float32):
        max_iterations = most_iterations(n, tolerance) if max_iterations is None else max_iterations
        self.n, self.tolerance = n, tolerance
        self._typed = k.VECTORS if dtype is wp.vec3 else k.SCALARS
        self.device = device
        self.stride = stride  # iterations between two looks at the residual
        self.scalar = wp.zeros(8, dtype=wp.float32, device=device)
        self.watch = wp.zeros(4, dtype=wp.float32, device=device)
        self.go = wp.zeros(1, dtype=wp.int32, device=device)
        self._most = math.ceil(max_iterations / stride)
        self.control = wp.array([tolerance, self._most], dtype=wp.float32, device=device)
        self.part_a = wp.zeros(CHUNKS, dtype=wp.float32, device=device)
        self.part_b = wp.zeros(CHUNKS, dtype=wp.float32, device=device)
        self._entries = ENTRIES if not wp.get_device(device).is_cuda else 1
        self._run = Recorded(self._body, device, n)

    def _launch(self, kernel, inputs, outputs=(), dim=None):
        launch(self._typed.get(kernel, kernel), self.n if dim is None else dim, inputs, outputs, self.device)

    def _dot(self, a, b, partial):
        self._launch(k.dot_chunks, [a, b, self.n], [partial], dim=CHUNKS)

    def _over_entries(self, kernel, inputs, outputs):
        dim = math.ceil(self.n / self._entries)
        self._launch(kernel, [*inputs, self._entries], outputs, dim=dim)

    def _repeat(self, body) -> None:
        """Iterate, and take the solve into the account."""
        repeat(self.go, body, self._most)
        self._launch(k.watch_solve, [self.scalar], [self.watch], dim=1)

    def solve(self) -> None:
        """Run the solve; the solution is left in `x`."""
        self._run()

    def report(self, scalar: wp.array | None = None) -> tuple[int, float]:
        """Iterations and relative residual of the last solve (reads back: for diagnostics only).

        Args:
            scalar: a copy of `scalar` taken after an earlier solve; None for the last one.
        """
        s = (self.scalar if scalar is None else scalar).numpy().astype(np.float64)
        return self.stride * int(s[4]), float(np.sqrt(s[7] / s[5])) if s[5] > 0.0 else 0.0

    def account(self) -> Account:
        """What became of the solves since `forget` (reads back: between steps)."""
        worst, late, solves, most = self.watch.numpy().tolist()
        allowed = self.stride * self._most
        return Account(worst, int(late), int(solves), self.stride * int(most), allowed, self.tolerance)

    def forget(self) -> None:
        """Begin the account anew."""
        self.watch.zero_()


class ConjugateGradient(Solver):
    """Jacobi-preconditioned conjugate gradients, or the paper's relaxed Jacobi sweeps.

    Args:
        operator: the matrix.
        dtype: wp.float32 or wp.vec3 unknowns.
        tolerance: stop at sqrt((r, r/A_ii)/(b, b/A_ii)) below this.
        max_iterations: stop after this many, None for `most_iterations`; Jacobi sweeps come in pairs.
        jacobi: relaxation factor omega of Appendix B; None for conjugate gradients.
        of_change: stop where the residual is below `tolerance` of the first one: for a solve that changes x by little.
        x: array for the solution; None for one of its own.

    Attributes:
        b: [n] right-hand side, filled by the owner.
        x: [n + boundary] solution; start value in. Boundary entries stay as they are (0).
    """

    def __init__(
        self,
        operator,
        total,
        dtype,
        tolerance,
        max_iterations,
        jacobi: float | None = None,
        of_change: bool = False,
        x: wp.array | None = None,
    ):
        stride = 1 if jacobi is None else 2
        super().__init__(operator.n, tolerance, max_iterations, operator.device, stride, dtype)
        self.operator = operator
        self.jacobi = jacobi
        self.change = CHANGE if of_change else 0.0
        self.slack = 1.0
        self.b, self.r, self.z, self.q = (wp.zeros(self.n, dtype=dtype, device=self.device) for _ in range(4))
        self.p = wp.zeros(total, dtype=dtype, device=self.device)
        self.x = wp.zeros(total, dtype=dtype, device=self.device) if x is None else x
        self.inverse = wp.zeros(self.n, dtype=wp.float32, device=self.device)

    def _body(self):
        a = self.operator.arrays
        self._launch(k.invert_diagonal, a, [self.inverse])
        self._launch(k.start_residual, [self.x, self.b, *a, self.inverse], [self.r, self.z, self.p])
        self._start()
        self._dot(self.r, self.z, self.part_a)
        self._launch(k.weighted_chunks, [self.b, self.b, self.inverse, self.n], [self.part_b], dim=CHUNKS)
        reference = [self.part_a, self.part_b, self.control, self.change]
        self._launch(k.start_scalars, reference, [self.scalar, self.go], dim=1)
        self._repeat(self._iterate if self.jacobi is None else self._sweep)

    def _start(self):
        """Take from the first residual what the matrix has besides its operator."""

    def _iterate(self):
        self._apply()
        self._dot(self.p, self.q, self.part_a)
        self._launch(k.set_alpha, [self.part_a, self.go], [self.scalar], dim=1)
        moved = [self.x, self.r, self.z]
        self._over_entries(k.advance_solution, [self.scalar, self.p, self.q, self.inverse], moved)
        self._precondition()
        self._dot(self.r, self.z, self.part_a)
        self._launch(k.set_beta, [self.part_a, self.control, self.slack], [self.scalar, self.go], dim=1)
        self._stop()
        self._over_entries(k.advance_direction, [self.scalar, self.z], [self.p])

    def _apply(self):
        """q = A p."""
        self._launch(k.apply_operator, [self.p, *self.operator.arrays], [self.q])

    def _precondition(self):
        """From D^-1 r, which z is already, to what the search goes on from."""

    def _stop(self):
        """Decide whether to go on, where the preconditioned residual does not."""

    def _sweep(self):
        arguments = [self.b, *self.operator.arrays, self.inverse, self.jacobi]
        self._launch(k.sweep_jacobi, [self.x, *arguments], [self.r, self.z, self.p])
        self._launch(k.sweep_jacobi, [self.p, *arguments], [self.r, self.z, self.x])
        self._dot(self.r, self.z, self.part_a)
        self._launch(k.set_beta, [self.part_a, self.control, 1.0], [self.scalar, self.go], dim=1)


class GasConjugateGradient(ConjugateGradient):
    """Conjugate gradients for A + sum_g (k_g s_g s_g^T + p_g^T K_g p_g).

    The gas of each region resists the volume s_g.x it would lose, and the region as a whole, whose momentum changes by
    p_g.x, has more inertia than its particles. Preconditioned with D + sum_g k_g s_g s_g^T, inverted exactly: the gas
    is far stiffer than the film, and is so out of the way. The gas of regions that touch is solved for together,
    through A.

    Args:
        region: [n] region of each unknown.
        first: [regions + 1] first unknown of each region.
        parts: number of parts in which the regions' sums are taken.

    Attributes:
        sweep: [n] s, filled by the owner.
        stiff: [regions] k, filled by the owner.
        carried: [n] p, filled by the owner.
        rigid: [regions] K, filled by the owner.
        moments: [regions] (k s.x, K p.x) where `find_moments` was called.
    """

    def __init__(self, operator, tolerance, max_iterations, region: wp.array, first: wp.array, parts: int):
        n, device = operator.n, operator.device
        self.region, self.first = region, first
        self.sweep, self.scaled = (wp.zeros(n, dtype=wp.float32, device=device) for _ in range(2))
        self.carried = wp.zeros(n, dtype=wp.vec3, device=device)
        self.part = wp.zeros(parts, dtype=wp.float32, device=device)
        self._moment_part = wp.zeros(parts, dtype=wp.vec4, device=device)
        regions = first.shape[0] - 1
        self.rigid = wp.zeros(regions, dtype=wp.mat33, device=device)
        self.moments = wp.zeros(regions, dtype=wp.vec4, device=device)
        self.stiff, self.soft, self.weight = (wp.zeros(regions, dtype=wp.float32, device=device) for _ in range(3))
        super().__init__(operator, n, wp.float32, tolerance, max_iterations)

    def _body(self):
        a = self.operator.arrays
        clear(self.x)
        self._launch(k.invert_diagonal, a, [self.inverse])
        self._launch(k.scale_sweep_e, [self.sweep, self.inverse], [self.scaled])
        self._region_dot(self.scaled, self.sweep)
        self._by_region(k.soften_gas_r, [self.part, self.stiff], [self.soft])
        self._launch(k.start_residual, [self.x, self.b, *a, self.inverse], [self.r, self.z, self.p])
        self._precondition()
        copy(self.p, self.z)
        self._dot(self.r, self.z, self.part_a)
        self._launch(k.start_scalars, [self.part_a, self.part_a, self.control, 0.0], [self.scalar, self.go], dim=1)
        self._repeat(self._iterate)

    def _apply(self):
        super()._apply()
        self.find_moments(self.p)
        self._launch(k.add_moments_e, [self.moments, self.sweep, self.carried, self.region], [self.q])

    def find_moments(self, x: wp.array) -> None:
        """Set `moments` for x."""
        parts = self._moment_part
        arrays = [self.sweep, self.carried, x, self.first]
        self._launch(k.region_moment_chunks, arrays, [parts], dim=parts.shape[0])
        self._by_region(k.weigh_moments_r, [parts, self.stiff, self.rigid], [self.moments])

    def _precondition(self):
        """From D^-1 r to (D + k s s^T)^-1 r."""
        self._region_dot(self.scaled, self.r)
        self._by_region(k.weigh_gas_r, [self.part, self.soft], [self.weight])
        self._launch(k.add_gas_e, [self.weight, self.scaled, self.region], [self.z])

    def _region_dot(self, a, b):
        self._launch(k.region_dot_chunks, [a, b, self.first], [self.part], dim=self.part.shape[0])

    def _by_region(self, kernel, inputs, outputs):
        self._launch(kernel, inputs, outputs, dim=self.stiff.shape[0])


def upper_half(poles: np.ndarray, residues: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The p_k and g_k of Re sum_k g_k/(lambda + p_k) that are real, or stand for their conjugates too.

    Returns:
        Poles, residues, those of pairs taken twice, and which of them are pairs.
    """
    keep = poles.imag > -1e-9 * np.abs(poles)
    poles, residues = poles[keep], residues[keep]
    paired = poles.imag > 1e-9 * np.abs(poles)
    return poles, np.where(paired, 2.0 * residues, residues), paired


def shares_of_error(poles: np.ndarray, residues: np.ndarray, low: float) -> np.ndarray:
    """Error of the sum that the residual of each pole makes at most, relative to the sum at the eigenvalue `low`."""
    weight = np.abs(residues) / np.abs(poles + low)
    return weight / abs(np.sum(residues / (low + poles)).real)


class RationalLaplacian(Solver):
    """x = f(-Laplacian) b for f(lambda) = Re sum_k g_k/(lambda + p_k), by multi-shift conjugate gradients.

    One Krylov sequence, that of the smallest real p_k, serves all poles. It cannot be preconditioned, and takes the
    more iterations the more unknowns there are (`multilevel.MultilevelRational` does not).

    Attributes:
        b: [n] right-hand side, filled by the owner.
        x: [n] solution.
    """

    def __init__(self, n, total, pair, area, rows: Neighbors, tolerance, max_iterations, device):
        super().__init__(n, tolerance, max_iterations, device)
        self.pair, self.area, self.rows = pair, area, rows
        self.b, self.r, self.q, self.y, self.x = (wp.zeros(n, dtype=wp.float32, device=device) for _ in range(5))
        self.p = wp.zeros(total, dtype=wp.float32, device=device)
        self.real, self.imag = (wp.zeros(n, dtype=k.vec8, device=device) for _ in range(2))
        self.diag = wp.zeros(n, dtype=wp.float32, device=device)
        self.scaled = wp.zeros(pair.shape[0], dtype=wp.float32, device=device)
        self.zeta = wp.zeros((4, k.POLES), dtype=wp.vec2, device=device)
        self.poles = k.Poles()
        self.poles.p, self.poles.g = (wp.zeros(k.POLES, dtype=wp.vec2, device=device) for _ in range(2))
        self.poles.weight = wp.zeros(k.POLES, dtype=wp.float32, device=device)

    def set_function(self, poles: np.ndarray, residues: np.ndarray, low: float) -> None:
        """Set p_k and g_k (complex; conjugate pairs whole) and the lowest eigenvalue that matters.

        Raises:
            ValueError: no pole is real and above 0, or there are more than eight.
        """
        poles, residues, paired = upper_half(poles, residues)
        seed = np.where(~paired & (poles.real > 0.0), poles.real, np.inf)
        if not np.isfinite(seed.min()) or len(poles) > k.POLES:
            raise ValueError(f"no usable poles among {poles}")
        order = np.argsort(seed, kind="stable")
        missing = k.POLES - len(poles)
        p = np.pad(poles[order], (0, missing), mode="edge")
        g = np.pad(residues[order], (0, missing))
        for array, values in ((self.poles.p, p), (self.poles.g, g)):
            array.assign(np.stack([values.real, values.imag], axis=1))
        self.poles.weight.assign(shares_of_error(p, g, low))

    def improve(self) -> None:
        """Solve again for another `b`."""
        self.solve()

    def _body(self):
        self._launch(k.scale_pairs, [self.area, self.pair, self.rows], [self.scaled, self.diag])
        self._launch(k.start_shifted, [self.b, self.area], [self.r, self.p, self.real, self.imag, self.y])
        self._launch(k.start_zeta, [], [self.zeta], dim=k.POLES)
        self._dot(self.r, self.r, self.part_a)
        self._launch(k.start_scalars, [self.part_a, self.part_a, self.control, 0.0], [self.scalar, self.go], dim=1)
        self._repeat(self._iterate)
        self._launch(k.unscale, [self.y, self.area], [self.x])

    def _iterate(self):
        self._launch(k.apply_shifted, [self.p, self.diag, self.scaled, self.poles, self.rows], [self.q])
        self._dot(self.p, self.q, self.part_a)
        self._launch(k.set_alpha, [self.part_a, self.go], [self.scalar], dim=1)
        self._launch(k.set_zeta, [self.scalar, self.poles], [self.zeta], dim=k.POLES)
        self._launch(k.advance_shifted, [self.scalar, self.zeta, self.q, self.real, self.imag], [self.y, self.r])
        self._dot(self.r, self.r, self.part_a)
        self._launch(k.set_beta, [self.part_a, self.control, 0.0], [self.scalar, self.go], dim=1)
        self._launch(k.set_turns, [self.scalar], [self.zeta], dim=k.POLES)
        self._launch(k.direct_shifted, [self.scalar, self.zeta, self.r], [self.p, self.real, self.imag])
        self._launch(k.stop_shifted, [self.zeta, self.poles], [self.scalar, self.go], dim=1)
