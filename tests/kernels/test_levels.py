"""Ever coarser sets of points, and the solvers that they precondition, against their matrix and Jacobi's."""

from types import SimpleNamespace

import numpy as np
import pytest
import warp as wp

from melp_warp.device.linear import ConjugateGradient, LinearOperator, RationalLaplacian
from melp_warp.device.multilevel import MultilevelGradient, MultilevelRational
from melp_warp.kernels import neighbors as kn
from melp_warp.shapes import Jittered, Sphere
from melp_warp.stages import air
from melp_warp.stages.levels import APART, COARSER, Levels, levels_of
from melp_warp.stages.neighbors import NeighborList
from tests.helpers import dense_laplacian, make_stepper, pairs_of

SUPPORT = 3.0


def spiral(n):
    """[n, 3] places on a sphere and their spacing, m."""
    turn, z = np.arange(n) * np.pi * (3.0 - np.sqrt(5.0)), 1.0 - (2.0 * np.arange(n) + 1.0) / n
    r = np.sqrt(1.0 - z * z)
    return np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1), np.sqrt(4.0 * np.pi / n), n


def square(n):
    """The same for a jittered square, with a frame of further points around it, along which psi is 0."""
    cells, h = round(np.sqrt(n)), 1.0 / round(np.sqrt(n))
    ring = 4
    at = (np.arange(-ring, cells + ring) + 0.5) * h
    x, y = (a.ravel() for a in np.meshgrid(at, at, indexing="ij"))
    inside = (np.minimum(x, y) > 0.0) & (np.maximum(x, y) < 1.0)
    order = np.argsort(~inside, kind="stable")
    places = np.stack([x, y, 0.0 * x], axis=1)[order]
    places[:, :2] += 0.2 * h * np.random.default_rng(0).uniform(-1.0, 1.0, (len(x), 2))
    return places, h, int(inside.sum())


def system(made, device):
    """Film, operator of the surface Laplacian and levels of a set of points."""
    places, h, n = made
    r = SUPPORT * h
    x = wp.array(places.astype(np.float32), dtype=wp.vec3, device=device)
    grid = wp.HashGrid(64, 64, 64, device=device)
    grid.build(x, r)
    ee = NeighborList(grid, x, n, x, r, kn.SAME)
    operator = LinearOperator(n, ee.rows, device)
    i, k, j = pairs_of(ee.rows)
    distance = np.linalg.norm(places[i] - places[j], axis=1) / h
    pair = operator.pair.numpy()
    pair[k] = np.exp(-0.7 * distance**2)
    operator.pair.assign(pair)
    film = SimpleNamespace(device=device, n_e=n, r=r, spacing=h)
    region = wp.zeros(len(places), dtype=wp.int32, device=device)
    lists = SimpleNamespace(ee=ee, state=SimpleNamespace(memory=SimpleNamespace(x=x), e=SimpleNamespace(region=region)))
    return film, operator, Levels(film, lists), len(places)


def shares(level, rows, weight):
    """Dense [points, places] of one of its two halves."""
    i, k, j = pairs_of(rows)
    found = np.zeros((level.n, level.places))
    at = (i, j) if rows is level.up else (j, i)
    found[at] = weight.numpy()[k]
    return found


@pytest.mark.parametrize("shape", [spiral, square])
def test_levels_share_points_out(shape, device):
    """Shares of each point add up to 1, up and down are one matrix, and points of a level are as far apart as said."""
    _, _, made, _ = system(shape(1200), device)
    r = made._makers[0].r
    assert len(made.levels) > 1
    for level, maker in zip(made.levels, made._makers, strict=True):
        up = shares(level, level.up, level.up_weight)
        assert np.abs(up - shares(level, level.down, level.down_weight)).max() < 1e-6
        full = maker.region.numpy() >= 0
        assert np.abs(up[full].sum(axis=1) - 1.0).max() < 1e-5
        assert np.all(up[~full] == 0.0)
        x = maker.next_x.numpy()[maker.next_region.numpy() >= 0].astype(np.float64)
        apart = np.linalg.norm(x[:, None] - x[None], axis=2) + 10.0 * np.eye(len(x))
        assert apart.min() > 0.999 * APART * r
        assert maker.r == pytest.approx(r)
        r *= COARSER
        assert len(x) < 0.45 * np.count_nonzero(full)


def test_levels_are_made_anew_alike(device):
    """Made again for the same places they are the same to the bit."""
    _, _, made, _ = system(spiral(1500), device)
    before = [a.numpy().copy() for level in made.levels for a in (level.up.index, level.up_weight, level.down_weight)]
    made.build()
    after = [a.numpy() for level in made.levels for a in (level.up.index, level.up_weight, level.down_weight)]
    assert all(np.array_equal(a, b) for a, b in zip(before, after, strict=True))


def load(n):
    b = np.random.default_rng(1).normal(size=n)
    return (b - b.mean()).astype(np.float32)


def solved(solver, b):
    solver.b.assign(b)
    solver.x.zero_()
    solver.solve()
    return solver.x.numpy()[: solver.n].astype(np.float64)


@pytest.mark.parametrize("shape", [spiral, square])
def test_preconditioner_is_symmetric_and_positive(shape, device):
    """(a, M b) = (b, M a) to rounding, and (a, M a) > 0."""
    _, operator, made, total = system(shape(1200), device)
    solver = MultilevelGradient(operator, total, 1e-4, None, made.levels, energy=True)
    solved(solver, load(solver.n))
    rng, out = np.random.default_rng(2), []
    for _ in range(2):
        r = rng.normal(size=solver.n).astype(np.float32)
        solver.r.assign(r)
        solver.z.assign(solver.inverse.numpy() * r)
        solver._precondition()
        out.append((r.astype(np.float64), solver.z.numpy().astype(np.float64)))
    (a, ma), (b, mb) = out
    assert abs(a @ mb - b @ ma) < 1e-5 * np.linalg.norm(a) * np.linalg.norm(mb)
    assert a @ ma > 0.0
    assert b @ mb > 0.0


@pytest.mark.parametrize("energy", [False, True])
@pytest.mark.parametrize("held", [0.0, 0.3])
@pytest.mark.parametrize("shape", [spiral, square])
def test_solution_is_that_of_jacobi(shape, held, energy, device):
    """Both find the same to their tolerance, with and without a diagonal of the unknowns' own, by either measure."""
    _, operator, made, total = system(shape(1500), device)
    operator.diag.fill_(held)
    plain = ConjugateGradient(operator, total, wp.float32, 1e-6, None)
    levels = MultilevelGradient(operator, total, 1e-6, None, made.levels, energy=energy)
    b = load(plain.n)
    x, y = (solved(solver, b) for solver in (plain, levels))
    if shape is spiral and held == 0.0:
        x, y = x - x.mean(), y - y.mean()
    assert np.abs(x - y).max() < 2e-4 * np.abs(x).max()
    assert levels.report()[0] < plain.report()[0] or held > 0.0


@pytest.mark.parametrize("energy", [False, True])
@pytest.mark.parametrize(("shape", "most"), [(spiral, 12), (square, 16)])
def test_iterations_do_not_grow_with_the_unknowns(shape, most, energy, device):
    """From 2,000 to 20,000 unknowns at most by half; those of Jacobi's about threefold, as the film's width in E."""
    taken = []
    for n in (2000, 20000):
        _, operator, made, total = system(shape(n), device)
        solvers = [
            ConjugateGradient(operator, total, wp.float32, 1e-4, None),
            MultilevelGradient(operator, total, 1e-4, None, made.levels, energy=energy),
        ]
        for solver in solvers:
            solved(solver, load(solver.n))
        taken.append([solver.report()[0] for solver in solvers])
    (plain, few), (plain_more, more) = taken
    assert plain_more > 2.0 * plain
    assert more <= 1.5 * few
    assert more <= most


def test_residual_is_measured_as_that_of_jacobi(device):
    """b - A x in float64 by D^-1 is what is reported, and within the tolerance; from there no iteration is needed."""
    _, operator, made, total = system(square(1500), device)
    operator.diag.fill_(0.3)
    solver = MultilevelGradient(operator, total, 1e-3, None, made.levels)
    b = load(solver.n)
    x = solved(solver, b)
    i, k, j = pairs_of(operator.rows)
    w, whole = operator.pair.numpy()[k].astype(np.float64), np.append(x, np.zeros(total - len(x)))
    ax, diagonal = 0.3 * x, np.full(len(x), 0.3)
    np.add.at(ax, i, w * (whole[i] - whole[j]))
    np.add.at(diagonal, i, w)
    residual = np.sqrt(np.sum((b - ax) ** 2 / diagonal) / np.sum(b.astype(np.float64) ** 2 / diagonal))
    iterations, reported = solver.report()
    assert iterations > 3
    assert reported < 1e-3
    assert residual == pytest.approx(reported, rel=1e-2)
    solver.solve()
    assert solver.report()[0] == 0


RHO, AREAL = 1.204, 4e-4


def response(film, geometry, dt):
    """Poles and residues of a film of air and water in a step of dt, and the lowest eigenvalue."""
    low, high = 2.0 / film.radius**2, 4.0 * (np.pi / film.spacing) ** 2
    fitted = air.fit_poles(low, high, RHO, film.radius, geometry.blur("sph"))
    return (*air.response(AREAL, 0.14 * dt**2, *fitted, geometry.blur("mls")), low)


def solvers_of(s, tolerance, device):
    """The multi-shift solver of a film, and that by levels."""
    film, g = s.film, s.geometry
    arguments = [film.n_e, film.total, g.weight, g.area, s.lists.ee.rows, tolerance, None, device]
    return RationalLaplacian(*arguments), MultilevelRational(*arguments, levels_of(film, s.lists))


def smooth(s):
    """A load that is smooth, and rough by a tenth."""
    x = s.state.e.x.numpy()[: s.film.n_e] / s.film.radius
    return (x[:, 0] ** 3 - x[:, 1] * x[:, 2] + 0.1 * load(len(x))).astype(np.float32)


def relative(s, x, exact):
    root = np.sqrt(s.geometry.area.numpy().astype(np.float64))
    return np.linalg.norm(root * (x - exact)) / np.linalg.norm(root * exact)


@pytest.mark.parametrize("dt", [1e-6, 1e-4, 1e-3, 1e-2, 1e-1])
def test_poles_are_those_of_the_function(dt, device):
    """f(-lap_s) b of an uneven film in air against a dense eigen-decomposition in float64, within the tolerance.

    In short steps some poles are below 0, beyond the eigenvalues; in long ones two are complex.
    """
    _, s = make_stepper(Jittered(Sphere(0.1)), 400, device)
    poles, residues, low = response(s.film, s.geometry, dt)
    area = s.geometry.area.numpy().astype(np.float64)
    values, vectors = np.linalg.eigh(dense_laplacian(s))
    f = np.sum(residues / (values[:, None] + poles), axis=1).real
    solver = solvers_of(s, 1e-4, device)[1]
    solver.set_function(poles, residues, low)
    b = smooth(s)
    x = solved(solver, b)
    exact = vectors @ (f * (vectors.T @ (np.sqrt(area) * b))) / np.sqrt(area)
    iterations, residual = solver.report()
    print(f"dt {dt:g}: {iterations} iterations, bound {residual:.1e}, error {relative(s, x, exact):.1e}")
    assert iterations < 30
    assert residual < 1e-4
    assert relative(s, x, exact) < 1e-4


def test_a_changed_load_is_gone_on_from(device):
    """After a change of the load by 1 % the search goes on from its last result, and ends as near to the solution."""
    _, s = make_stepper(Sphere(0.1), 1500, device)
    plain, solver = solvers_of(s, 1e-4, device)
    plain.control.assign([1e-6, 1000.0])
    b = smooth(s)
    for one in (plain, solver):
        one.set_function(*response(s.film, s.geometry, 1.0 / 120.0))
    solved(solver, b)
    whole = solver.report()[0]
    b = b * (1.0 + 0.01 * load(len(b)))
    solver.b.assign(b)
    solver.improve()
    print(f"{whole} iterations, then {solver.report()[0]}")
    assert solver.report()[0] < 0.7 * whole
    assert relative(s, solver.x.numpy().astype(np.float64), solved(plain, b)) < 1e-4


@pytest.mark.parametrize("most", [8000, pytest.param(20000, marks=pytest.mark.slow)])
def test_iterations_for_the_air_do_not_grow(most, device):
    """From 2,000 E on at most by half; multi-shift conjugate gradients take as many times more as the film is wider."""
    taken = []
    for n in (2000, most):
        _, s = make_stepper(Sphere(0.1), n, device)
        solvers = solvers_of(s, 1e-4, device)
        b, found = smooth(s), []
        for solver in solvers:
            solver.set_function(*response(s.film, s.geometry, 1.0 / 120.0))
            found.append(solved(solver, b))
        taken.append([solver.report()[0] for solver in solvers])
        print(f"{n} E: {taken[-1]} iterations, apart by {relative(s, *found):.1e}")
        assert relative(s, *found) < 1e-4
    (plain, few), (plain_more, more) = taken
    assert plain_more > 0.8 * np.sqrt(most / 2000) * plain
    assert more <= 1.5 * few
    assert more <= 18


def test_no_load_takes_no_iteration(device):
    """b = 0 gives x = 0."""
    _, s = make_stepper(Sphere(0.1), 400, device)
    solver = solvers_of(s, 1e-4, device)[1]
    solver.set_function(*response(s.film, s.geometry, 1e-2))
    assert np.all(solved(solver, np.zeros(s.film.n_e, dtype=np.float32)) == 0.0)
    assert solver.report() == (0, 0.0)
