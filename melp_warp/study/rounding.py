"""What single precision costs: stages done again in float64 NumPy at the same particles, and runs nudged by rounding.

The solver computes in float32, except sums over regions and the gas (float64), or in float64 (double.py). Each function
here evaluates one stage anew from the arrays that the device holds, in either precision, with none of its kernels.
"""

from __future__ import annotations

import numpy as np

from melp_warp.kernels.neighbors import Neighbors
from melp_warp.scene import Scene
from melp_warp.simulation import Simulation
from melp_warp.study.tradeoff import field_error
from melp_warp.study.validation import steps


def pairs(rows: Neighbors) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Row, column and place (in arrays aligned with the list) of every pair."""
    start, stop = rows.start.numpy().astype(np.int64), rows.stop.numpy().astype(np.int64)
    count = stop - start
    row = np.repeat(np.arange(len(start)), count)
    place = np.arange(len(row)) + np.repeat(start - (np.cumsum(count) - count), count)
    return row, rows.index.numpy()[place], place


def quintic(d: np.ndarray, r: float) -> np.ndarray:
    """The kernel W(d) of support r in float64, 1/m^2; see `kernels.sph.kernel_w`."""
    s = 3.0 * d / r
    terms = ((3.0, 1.0), (2.0, -6.0), (1.0, 15.0))
    return 0.004661441847 * (3.0 / r) ** 2 * sum(c * np.maximum(a - s, 0.0) ** 5 for a, c in terms)


def curvature_error(simulation: Simulation) -> float:
    """Rms difference of the MLS curvature (10), over chords, from the same fit in float64, relative to its rms."""
    film, geometry, e = simulation.film, simulation.stepper.geometry, simulation.state.e
    found = geometry.curvature(e.x).numpy().astype(np.float64)
    x, normal = e.x.numpy().astype(np.float64), e.normal.numpy().astype(np.float64)[: film.n_e]
    row, column, _ = pairs(geometry.lists.ee.rows)
    axis = np.where(np.abs(normal[:, 2:]) > 0.7, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    e1 = np.cross(axis, normal)
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    e2 = np.cross(normal, e1)
    d = (3.0 / film.r) * (x[column] - x[row])
    weight = quintic(np.linalg.norm(d, axis=1), 3.0)
    a, b, z = (np.sum(d * axis[row], axis=1) for axis in (e1, e2, normal))
    a, b = np.linalg.norm(d, axis=1) / np.hypot(a, b) * (a, b)
    basis = np.stack([a, b, a * a, a * b, b * b], axis=1)
    matrix, side = np.zeros((film.n_e, 5, 5)), np.zeros((film.n_e, 5))
    np.add.at(matrix, row, weight[:, None, None] * basis[:, :, None] * basis[:, None, :])
    np.add.at(side, row, (weight * z)[:, None] * basis)
    matrix += 1e-6 * np.trace(matrix, axis1=1, axis2=2)[:, None, None] * np.eye(5)
    c = np.linalg.solve(matrix, side[:, :, None])[:, :, 0].T
    g = 1.0 + c[0] ** 2 + c[1] ** 2
    top = (1.0 + c[1] ** 2) * 2.0 * c[2] - 2.0 * c[0] * c[1] * c[3] + (1.0 + c[0] ** 2) * 2.0 * c[4]
    return _rms(found, top / (g**1.5 * film.r / 3.0))


def transfer_error(simulation: Simulation) -> float:
    """Rms difference of the mass that E gather from L (6) from the same sums in float64, relative to its rms."""
    film, state = simulation.film, simulation.state
    simulation.stepper.transfer.gather()
    x_e, x_l = state.e.x.numpy().astype(np.float64), state.l.x.numpy().astype(np.float64)
    row, column, _ = pairs(simulation.stepper.lists.le.rows)
    own = column < film.n_e
    row, column = row[own], column[own]
    weight = quintic(np.linalg.norm(x_e[column] - x_l[row], axis=1), film.r)
    share = state.l.mass.numpy().astype(np.float64) / np.bincount(row, weight, film.n_l)
    return _rms(state.e.mass.numpy().astype(np.float64), np.bincount(column, weight * share[row], film.n_e))


def solver_error(simulation: Simulation, dt: float) -> tuple[float, float]:
    """How far the solution of (14) is from the exact one of the same equations, solved in float64.

    The equations are those of a step of dt (s) from the present state; the velocity of the E is changed by it.

    Returns:
        The rms difference, and the rms change of the solution in the step, both relative to the rms of the solution:
        a tolerance is worth something where the first is much the smaller.
    """
    stepper, n = simulation.stepper, simulation.film.n_e
    stepper.transfer.l_to_e()
    stepper.fields.update()
    stepper.forces.update()
    before = stepper.fields.gamma.numpy().astype(np.float64)
    stepper.tangential.solve(stepper.prepare(dt))
    solver = stepper.tangential.solver
    operator = solver.operator
    row, column, place = pairs(operator.rows)
    pair = operator.scale.numpy()[0] * operator.pair.numpy().astype(np.float64)[place]
    diagonal = operator.diag.numpy().astype(np.float64) + np.bincount(row, pair, n)
    own = column < n
    row, column, pair = row[own], column[own], pair[own]
    x, b = (a.numpy().astype(np.float64)[:n] for a in (solver.x, solver.b))

    def apply(y):
        return diagonal * y - np.bincount(row, pair * y[column], n)

    exact = _conjugate_gradient(apply, b, x, diagonal)
    return _rms(x, exact), _rms(before, exact)


def _conjugate_gradient(apply, b: np.ndarray, x: np.ndarray, diagonal: np.ndarray) -> np.ndarray:
    """Solve A x = b in float64 to rounding, from x."""
    r = b - apply(x)
    z = r / diagonal
    p, size, goal = z, r @ z, 1e-26 * (b @ (b / diagonal))
    for _ in range(1000):
        if size <= goal:
            break
        q = apply(p)
        alpha = size / (p @ q)
        x, r = x + alpha * p, r - alpha * q
        z = r / diagonal
        size, before = r @ z, size
        p = z + (size / before) * p
    return x


def nudged_difference(scene: Scene, count: int, dt: float, ulps: float = 1.0, seed: int = 0) -> float:
    """How far apart two runs are of which one has all its float32 state rounded anew, at random, before every step.

    Args:
        scene: what to run.
        count: steps.
        dt: s.
        ulps: each number is changed by up to so many units in its last place.
        seed: of the changes.

    Returns:
        `tradeoff.field_error` of one against the other: an estimate of what rounding does to a run.
    """
    rng = np.random.default_rng(seed)
    plain, nudged = (Simulation(scene) for _ in range(2))
    steps(plain, count, dt)
    for _ in range(count):
        for name, array in nudged.state.arrays().items():
            values = array.numpy()
            if values.dtype == np.float32 and name != "motion":
                values = values + ulps * np.spacing(values) * rng.uniform(-1.0, 1.0, values.shape)
                array.assign(values.astype(np.float32))
        steps(nudged, 1, dt)
    return field_error(nudged.particles("e"), plain.particles("e"))


def _rms(found: np.ndarray, exact: np.ndarray) -> float:
    """Rms difference relative to the rms."""
    return float(np.linalg.norm(found - exact) / np.linalg.norm(exact))
