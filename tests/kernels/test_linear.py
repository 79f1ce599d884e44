"""Solvers against dense linear algebra in float64."""

import numpy as np
import pytest
import warp as wp

from melp_warp.device.linear import ConjugateGradient, LinearOperator, RationalLaplacian, most_iterations
from melp_warp.kernels import linear as kl
from melp_warp.shapes import Disc, Sphere
from melp_warp.stages import air
from tests.helpers import dense_laplacian, make_rows, make_stepper, near, pairs_of

N = 300
BEYOND = 20


def system(device, scale=1.0, seed=0):
    """A random symmetric graph Laplacian with a positive diagonal, its last entries beyond the unknowns.

    Returns the operator and the dense matrix of (A x)_i = diag_i x_i + scale sum_j pair_ij (x_i - x_j), x = 0 beyond.
    """
    rng = np.random.default_rng(seed)
    x = rng.uniform(size=(N + BEYOND, 2))
    rows = make_rows(near(x, x, 0.12, same=True)[:N], device)
    c = rng.uniform(0.1, 2.0, size=(N + BEYOND, N + BEYOND))
    c = (c + c.T).astype(np.float32)
    operator = LinearOperator(N, rows, device)
    diag = rng.uniform(0.05, 0.2, N).astype(np.float32)
    i, k, j = pairs_of(rows)
    pair = operator.pair.numpy()
    pair[k] = c[i, j]
    operator.pair.assign(pair)
    operator.diag.assign(diag)
    operator.scale.fill_(scale)
    a = np.zeros((N, N + BEYOND))
    a[i, j] -= scale * c[i, j]
    np.add.at(a, (i, i), scale * c[i, j].astype(np.float64))
    a[np.arange(N), np.arange(N)] += diag
    return operator, a[:, :N]


def residual(a, x, b):
    """sqrt((r, r/A_ii)/(b, b/A_ii)), the solver's measure, from b - A x in float64."""
    r = b - a @ x
    inverse = (1.0 / np.diag(a)).reshape((-1,) + (1,) * (b.ndim - 1))
    return np.sqrt(np.sum(r * r * inverse) / np.sum(b * b * inverse))


def solve(solver, b, start=None):
    solver.b.assign(b.astype(np.float32))
    x = np.zeros_like(solver.x.numpy())
    if start is not None:
        x[:N] = start
    solver.x.assign(x)
    solver.solve()
    return solver.x.numpy()[:N].astype(np.float64)


def load(seed=5, width=None):
    shape = (N,) if width is None else (N, width)
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32).astype(np.float64)


def test_operator_is_its_matrix_and_symmetric(device):
    """A x equals the dense product and (x, A y) = (y, A x), to rounding (row sums of about 15 terms: 1e-5 relative)."""
    operator, a = system(device, scale=0.7)
    out = []
    for seed in (1, 2):
        x = np.zeros(N + BEYOND, dtype=np.float32)
        x[:N] = load(seed)
        y = wp.zeros(N, dtype=float, device=device)
        given = wp.array(x, dtype=float, device=device)
        wp.launch(kl.apply_operator, N, [given, *operator.arrays], [y], device=device)
        out.append((x[:N].astype(np.float64), y.numpy().astype(np.float64)))
        assert np.abs(out[-1][1] - a @ x[:N]).max() < 1e-5 * np.abs(a @ x[:N]).max()
    (x, ax), (y, ay) = out
    assert abs(x @ ay - y @ ax) < 1e-5 * np.linalg.norm(x) * np.linalg.norm(ay)


@pytest.mark.parametrize("shape", [Sphere(0.05), Disc(0.05, flat=False)])
def test_film_laplacian_is_symmetric(shape, device):
    """The pair weights of a film, a_i a_j 2|W'|/d, are equal both ways to rounding: it conserves and is SPD."""
    film, s = make_stepper(shape, 600, device)
    i, k, j = pairs_of(s.lists.ee.rows)
    inner = j < film.n_e
    dense = np.zeros((film.n_e, film.n_e))
    dense[i[inner], j[inner]] = s.geometry.weight.numpy()[k[inner]]
    assert np.abs(dense - dense.T).max() < 1e-6 * dense.max()
    assert dense.min() >= 0.0


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-5])
@pytest.mark.parametrize("start", [None, 1.0])
def test_conjugate_gradients_reach_the_true_residual(tolerance, start, device):
    """b - A x recomputed in float64 meets the tolerance; the recursive residual of float32 strays by 1e-6."""
    operator, a = system(device)
    b = load()
    solver = ConjugateGradient(operator, N + BEYOND, wp.float32, tolerance, 500)
    x = solve(solver, b, start)
    iterations, reported = solver.report()
    assert 0 < iterations < 500
    assert residual(a, x, b) < tolerance + 3e-6
    assert reported <= tolerance
    assert residual(a, x, b) == pytest.approx(reported, rel=0.05, abs=3e-6)


def test_error_is_that_of_the_residual(device):
    """|x - A^-1 b|_A <= sqrt(kappa) times the residual measure; here to 1e-3 of the solution at 1e-6."""
    operator, a = system(device)
    b = load()
    x = solve(ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-6, 1000), b)
    exact = np.linalg.solve(a, b)
    assert np.linalg.norm(x - exact) < 1e-3 * np.linalg.norm(exact)


def test_jacobi_converges_to_the_same(device):
    """Relaxed Jacobi sweeps reach the solution of conjugate gradients, in many more sweeps."""
    operator, a = system(device)
    b = load()
    cg = ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-5, 1000)
    jacobi = ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-5, 10000, jacobi=0.9)
    x, y = solve(cg, b), solve(jacobi, b)
    assert residual(a, y, b) < 1.1e-5
    assert np.linalg.norm(x - y) < 1e-3 * np.linalg.norm(x)
    assert jacobi.report()[0] > 3 * cg.report()[0]


def test_jacobi_sweep_is_appendix_b(device):
    """x <- x + omega D^-1 (b - A x), against NumPy; sweeps come in twos."""
    operator, a = system(device)
    b = load()
    solver = ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-7, 4, jacobi=0.2)
    x = solve(solver, b)
    expected = [np.zeros(N)]
    for _ in range(8):
        expected.append(expected[-1] + 0.2 / np.diag(a) * (b - a @ expected[-1]))
    errors = [np.abs(x - e).max() / np.abs(x).max() for e in expected]
    assert solver.report()[0] == 4
    assert min(errors) < 1e-5
    assert int(np.argmin(errors)) in (4, 8)


def test_vector_unknowns(device):
    """vec3 unknowns solve three systems at once, each as NumPy does."""
    operator, a = system(device)
    b = load(width=3)
    solver = ConjugateGradient(operator, N + BEYOND, wp.vec3, 1e-6, 1000)
    x = solve(solver, b)
    assert residual(a, x, b) < 5e-6
    exact = np.linalg.solve(a, b)
    assert np.abs(x - exact).max() < 1e-3 * np.abs(exact).max()


def test_scale_is_read_at_each_solve(device):
    """A recorded solve takes the matrix as it is now: scale and diagonal may change between replays."""
    operator, _ = system(device)
    solver = ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-5, 1000)
    b = load()
    for scale in (1.0, 1.0, 0.01):
        operator.scale.fill_(scale)
        _, a = system(device, scale)
        assert residual(a, solve(solver, b), b) < 1.5e-5


def test_zero_load(device):
    """b = 0 from x = 0 stops at once with x = 0; from elsewhere it goes to 0."""
    operator, _ = system(device)
    solver = ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-4, 300)
    assert np.all(solve(solver, np.zeros(N)) == 0.0)
    assert solver.report() == (0, 0.0)
    assert np.abs(solve(solver, np.zeros(N), 1.0)).max() < 1e-5


@pytest.mark.parametrize("limit", [1, 7])
def test_iteration_limit(limit, device):
    """The solve stops at the limit, and reports the residual it has."""
    operator, a = system(device)
    b = load()
    solver = ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-7, limit)
    x = solve(solver, b)
    iterations, reported = solver.report()
    assert iterations == limit
    assert residual(a, x, b) == pytest.approx(reported, rel=1e-3)


def test_account_of_several_solves(device):
    """The worst residual, how many ended above the tolerance, how many there were, the most iterations."""
    operator, a = system(device)
    solver = ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-4, 12)
    ends = []
    for start in (None, np.linalg.solve(a, load())):
        x = solve(solver, load(), start)
        ends.append((*solver.report(), residual(a, x, load())))
    (stopped, reported, true), (at_once, fine, _) = ends
    account = solver.account()
    assert (stopped, at_once) == (12, 0) and fine <= 1e-4
    assert (account.late, account.solves, account.most, account.allowed) == (1, 2, 12, 12)
    assert account.worst == pytest.approx(reported, rel=1e-6) == pytest.approx(true, rel=1e-3)
    assert account.worst > 1e-4
    solver.forget()
    assert (solver.account().worst, solver.account().solves) == (0.0, 0)


@pytest.mark.parametrize("size", [1e-12, 1e-17, 1e-22])
def test_load_that_float32_cannot_square(size, device):
    """A residual is never told as less than it is, down to loads whose squares float32 cannot hold (1e-44 here)."""
    operator, a = system(device)
    b = size * load()
    solver = ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-4, 8)
    x = solve(solver, b, 1.0)
    account = solver.account()
    assert account.late == 1
    assert account.worst >= 0.9 * min(residual(a, x, b), 1e6)


def test_not_finite_is_told(device):
    """A load that is not finite makes the worst residual infinite."""
    operator, _ = system(device)
    solver = ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-4, 50)
    b = load()
    b[7] = np.nan
    solve(solver, b)
    solve(solver, load())
    assert solver.account().worst == np.inf
    assert solver.account().late == 1


def test_iterations_that_are_left_grow_with_the_film():
    """As the root of the number of unknowns, as the condition of the surface Laplacian asks for."""
    assert most_iterations(160_000, 1e-4) - 100 == pytest.approx(10 * (most_iterations(1600, 1e-4) - 100), rel=0.01)
    assert most_iterations(1600, 1e-4) == 100 + 397


def test_same_bits_twice(device):
    """Sums are taken in a fixed order: the same system gives the same bits."""
    operator, _ = system(device)
    solver = ConjugateGradient(operator, N + BEYOND, wp.float32, 1e-5, 300)
    assert np.array_equal(solve(solver, load()), solve(solver, load()))


def sphere_laplacian(device):
    """A film's surface Laplacian on the unit sphere: stepper, areas, and D = -a^-1/2 (a_i a_j K_ij) a^-1/2 dense."""
    _, s = make_stepper(Sphere(1.0), N, device)
    return s, s.geometry.area.numpy().astype(np.float64), dense_laplacian(s)


def apply_function(d, area, f, b):
    """a^-1/2 f(D) a^1/2 b by eigen-decomposition."""
    values, vectors = np.linalg.eigh(0.5 * (d + d.T))
    root = np.sqrt(area)
    return (vectors @ (f(values) * (vectors.T @ (root * b)))) / root


def rational(s, tolerance, device):
    g = s.geometry
    return RationalLaplacian(s.film.n_e, s.film.total, g.weight, g.area, s.lists.ee.rows, tolerance, 300, device)


def test_film_laplacian_spectrum(device):
    """Lowest eigenvalues of the film's own Laplacian on the unit sphere are n(n + 1), 2n + 1 of each.

    A smoothed operator errs by (k r)^2 times a small number: bounds of 1, 3 and 6 % for n = 1, 2, 3 at r = 0.8 R.
    """
    _, _, d = sphere_laplacian(device)
    values = np.linalg.eigvalsh(0.5 * (d + d.T))
    assert abs(values[0]) < 1e-3
    first = 1
    for n, bound in ((1, 0.03), (2, 0.09), (3, 0.18)):
        band = values[first : first + 2 * n + 1]
        first += 2 * n + 1
        print(n, band / (n * (n + 1)))
        assert np.abs(band / (n * (n + 1)) - 1.0).max() < bound


@pytest.mark.parametrize("tolerance", [1e-3, 1e-5])
def test_rational_function_of_the_laplacian(tolerance, device):
    """Three real poles and a complex pair: x = a^-1/2 f(D) a^1/2 b against a dense eigen-decomposition.

    The seed is the smallest real pole; the error is measured against f at the lowest mode, as the solver's bound is.
    """
    s, area, d = sphere_laplacian(device)
    poles = np.array([40.0, 3.0, 300.0, 15.0 + 25.0j, 15.0 - 25.0j])
    residues = np.array([2.0, 0.5, 5.0, 0.4 - 0.3j, 0.4 + 0.3j])

    def f(lam):
        return np.sum(residues / (lam[:, None] + poles), axis=1).real

    solver = rational(s, tolerance, device)
    solver.set_function(poles, residues, 2.0)
    b = np.random.default_rng(3).normal(size=len(area))
    solver.b.assign(b.astype(np.float32))
    solver.solve()
    iterations, reported = solver.report()
    x = solver.x.numpy()
    exact = apply_function(d, area, f, b)
    assert reported <= tolerance
    assert (solver.account().late, solver.account().worst) == (0, pytest.approx(reported, rel=1e-5))
    root = np.sqrt(area)
    error = np.linalg.norm(root * (x - exact)) / (f(np.array([2.0]))[0] * np.linalg.norm(root * b))
    print(f"{iterations} iterations, error {error:.1e}")
    assert 0 < iterations < 300
    assert error < tolerance + 2e-6


def test_air_response_of_a_film(device):
    """1/((m + A) (1 - b lambda) + c lambda) as the solver applies it is the dense function within the fit's 0.25 %."""
    s, area, d = sphere_laplacian(device)
    m, c, rho = 4e-4, 2e-4, 1.204
    high = 4.0 * (np.pi / s.film.spacing) ** 2
    spread, blur = s.geometry.blur("sph"), s.geometry.blur("mls")
    poles, residues = air.response(m, c, *air.fit_poles(2.0, high, rho, 1.0, spread), blur)
    solver = rational(s, 1e-5, device)
    solver.set_function(poles, residues, 2.0)
    b = np.random.default_rng(4).normal(size=len(area))
    b -= np.sum(b * area) / area.sum()
    solver.b.assign(b.astype(np.float32))
    solver.solve()

    def f(lam):
        lam = np.maximum(lam, 1.0)
        mass = m + air.added_mass(lam * (1.0 + spread * (lam - 2.0)), rho, 1.0)
        return 1.0 / (mass * (1.0 - blur * lam) + c * lam)

    exact = apply_function(d, area, f, b)
    assert np.linalg.norm(solver.x.numpy() - exact) < 2.5e-3 * np.linalg.norm(exact)


def test_rational_of_zero(device):
    """b = 0 gives x = 0 without an iteration."""
    s, _, _ = sphere_laplacian(device)
    solver = rational(s, 1e-4, device)
    solver.set_function(np.array([1.0]), np.array([1.0]), 2.0)
    solver.solve()
    assert np.all(solver.x.numpy() == 0.0)
    assert solver.report()[0] == 0


def test_rational_refuses_what_it_cannot_do(device):
    """No real positive pole to start from, or too many poles: an error."""
    s, _, _ = sphere_laplacian(device)
    solver = rational(s, 1e-4, device)
    with pytest.raises(ValueError, match="no usable poles"):
        solver.set_function(np.array([1.0 + 2.0j, 1.0 - 2.0j]), np.array([1.0, 1.0]), 2.0)
    with pytest.raises(ValueError, match="no usable poles"):
        solver.set_function(np.arange(1.0, 10.0), np.ones(9), 2.0)
