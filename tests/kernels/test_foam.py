"""Foams on the device: tension of stars, cover, contact, the gas in the solve, walls, what crosses."""

import numpy as np
import pytest
import warp as wp

from melp_warp.cluster import Bubble, Cluster, Wall
from melp_warp.errors import SimulationError
from melp_warp.kernels import line_forces as kl
from melp_warp.material import Surroundings
from melp_warp.stages.foam import make_contact
from melp_warp.stepping.sampling import make_film
from tests.helpers import fitted_order, make_stepper

R = 0.05


def pair(gap, **options):
    """Two equal bubbles, `gap` (m) apart."""
    return Cluster((Bubble((-R - gap / 2, 0.0, 0.0), R), Bubble((R + gap / 2, 0.0, 0.0), R)), **options)


def foam(shape, e_count, device, **options):
    """Film and stepper of a foam with the numerics of the scenes."""
    return make_stepper(shape, e_count, device, numerics={"redistribution": 1.0, "spread": 0.02}, **options)


def star_force(s):
    """[n_e, 3] sum_j w_ij (x_j - x_i), m, and the pairs it came from."""
    star, tie = s.geometry.star, s.geometry.tie.numpy()
    start, stop, index = star.start.numpy(), star.stop.numpy(), star.index.numpy()
    row = np.repeat(np.arange(len(start)), stop - start)
    slot = np.concatenate([np.arange(a, b) for a, b in zip(start, stop, strict=True)])
    x = s.state.e.x.numpy().astype(np.float64)
    force = np.zeros_like(x)
    np.add.at(force, row, tie[slot, None] * (x[index[slot]] - x[row]))
    return force, row, index[slot], tie[slot]


def test_star_force_is_the_curvature_of_a_sphere(device):
    """sum_j w_ij d_ij / a_i = -2/R n within 0.1 % at 1,000 E, second order in the mean; it adds up to nothing."""
    errors, sizes = [], (500, 1000, 2000)
    for count in sizes:
        _, s = foam(Cluster((Bubble((0.0, 0.0, 0.0), R),)), count, device)
        force, *_ = star_force(s)
        normal, area = s.state.e.normal.numpy(), s.geometry.area.numpy()
        kappa = np.sum(force * normal, axis=1) / area
        errors.append(abs(kappa.mean() * R / 2.0 + 1.0))
        assert np.abs(force.sum(axis=0)).max() < 1e-12 * np.abs(force).sum()
    assert errors[1] < 1e-3
    assert fitted_order(1.0 / np.sqrt(sizes), errors) > 1.9


def test_star_pairs_are_symmetric(device):
    """w_ij = w_ji to the bit, so that tension conserves momentum."""
    _, s = foam(pair(0.02), 600, device)
    _, row, column, tie = star_force(s)
    weights = dict(zip(zip(row.tolist(), column.tolist(), strict=True), tie.tolist(), strict=True))
    kept = {k: w for k, w in weights.items() if w > 0.0}
    assert len(kept) > 5 * 600
    assert all(kept[(i, j)] == kept[(j, i)] for i, j in kept)


def test_star_vectors_close(device):
    """Gradients of the volume: N.x/3 adds up to the volume of the polyhedron, N to nothing."""
    _, s = foam(Cluster((Bubble((0.3, 0.0, 0.0), R),)), 1000, device)
    vector = s.geometry.vector.numpy().astype(np.float64)
    x = s.state.e.x.numpy() - np.array([0.3, 0.0, 0.0])
    assert np.sum(vector * x) / 3.0 == pytest.approx(4.0 / 3.0 * np.pi * R**3, rel=7e-3)
    assert np.abs(vector.sum(axis=0)).max() < 3e-4 * np.abs(vector).sum()


def test_cover_says_where_two_sheets_are_one_film(device):
    """Two flat sheets a gap g apart: cover (1 - g/range)^2 sharpened at its ends; none beyond the range."""
    for gap, expected in ((1.0, 0.0), (0.5, (0.25 - 0.1) / 0.8), (0.0, 1.0)):
        film, s = foam(pair(2.0), 4000, device)
        x = s.state.e.x.numpy()
        region = s.state.e.region.numpy()
        flat, normal = np.zeros_like(x), np.zeros_like(x)
        side = np.where(region == 0, 1.0, -1.0)
        count = np.bincount(region)
        for g in range(2):
            wide = int(np.ceil(np.sqrt(count[g])))
            k = np.arange(count[g])
            flat[region == g, 1:] = film.spacing * np.stack([k % wide, k // wide], axis=1)
        flat[:, 0], normal[:, 0] = -0.5 * side * gap * film.spacing, side
        s.state.e.x.assign(flat.astype(np.float32))
        s.state.e.normal.assign(normal.astype(np.float32))
        s.geometry.share.fill_(film.spacing**2)
        s.lists.rebuild()
        s.membrane.find_contacts(s.state.e.x)
        inside = np.all((flat[:, 1:] > 4 * film.spacing) & (flat[:, 1:] < (wide - 5) * film.spacing), axis=1)
        assert s.membrane.cover.numpy()[inside] == pytest.approx(expected, abs=0.02)


def test_contact_forces_add_up_to_nothing(device):
    """What one bubble feels of the other is the opposite of what that feels, overlapping by a third of a spacing."""
    film, s = foam(pair(0.0), 1000, device)
    shift = np.where(s.state.e.region.numpy() == 0, 1.0, -1.0)[:, None] * np.array([0.17 * film.spacing, 0.0, 0.0])
    s.state.e.x.assign((s.state.e.x.numpy() + shift).astype(np.float32))
    s.lists.rebuild()
    s.geometry.update()
    s.membrane.solve(s.prepare(1e-3))
    force, region = s.membrane.force.numpy().astype(np.float64), s.state.e.region.numpy()
    # tension of a region adds up to nothing, so that what is left is contact
    push = force[region == 0].sum(axis=0)
    assert push[0] < 0.0
    assert np.abs(force.sum(axis=0)).max() < 1e-5 * np.abs(push[0])


def test_loads_have_the_net_force_of_contact(device):
    """Loads along the normals, with what gives back the rest, push each region as the pair forces at rest do."""
    _, s = foam(pair(0.0), 1000, device)
    m, e = s.membrane, s.state.e
    m.solve(s.prepare(1e-6))
    normal, region = e.normal.numpy().astype(np.float64), e.region.numpy()
    inertia = e.mass.numpy() + m.added.numpy()[region] * s.geometry.area.numpy()
    back = np.sum(m.missing.numpy()[region] * normal, axis=1) * inertia
    loads = (m.load.numpy() + back)[:, None] * normal
    rest = m._rest.numpy().astype(np.float64)
    for g in range(2):
        net = rest[region == g].sum(axis=0)
        assert loads[region == g].sum(axis=0) == pytest.approx(net, abs=1e-3 * np.abs(net).max())


def test_gas_solver_leaves_a_small_true_residual(device):
    """(A + sum_g (k s s^T + p^T K p)) x = b to the solver's tolerance, with gas 1e4 times stiffer than the film."""
    _, s = foam(pair(0.001), 600, device)
    m = s.membrane
    rng = np.random.default_rng(1)
    s.state.e.u.assign((s.state.e.normal.numpy() * rng.normal(size=(len(s.state.e.x), 1))).astype(np.float32))
    m.solve(s.prepare(1e-3))
    solver = m.response
    rows, pair_, diag = solver.operator.rows, solver.operator.pair.numpy(), solver.operator.diag.numpy()
    x, b, sweep = (a.numpy().astype(np.float64) for a in (solver.x, solver.b, solver.sweep))
    start, stop, index = rows.start.numpy(), rows.stop.numpy(), rows.index.numpy()
    y = diag * x
    for i in range(len(x)):
        k = slice(start[i], stop[i])
        y[i] += np.sum(pair_[k] * (x[i] - x[index[k]]))
    region, stiff = s.state.e.region.numpy(), solver.stiff.numpy().astype(np.float64)
    carried, rigid = solver.carried.numpy().astype(np.float64), solver.rigid.numpy().astype(np.float64)
    for g in range(2):
        mine = region == g
        y[mine] += stiff[g] * sweep[mine] * np.sum(sweep[mine] * x[mine])
        y[mine] += carried[mine] @ (rigid[g] @ (carried[mine].T @ x[mine]))
    assert np.linalg.norm(y - b) < 1e-4 * np.linalg.norm(b)


def test_too_many_contacts_stop_the_run(device):
    """A row that wants more than there is room for is not left out in silence."""
    _, s = foam(pair(0.001), 600, device)
    s.step(1e-4)
    s.check()
    s.membrane.wanted.fill_(10**6)
    with pytest.raises(SimulationError, match="list contact has 1000000 entries"):
        s.check()


def touching(device, carrier="apic", psi=240.0):
    """Two bubbles pressed flat against each other by a tenth of their radius, more surfactant on the right one."""

    def concentration(x):
        return np.where(x[:, 0] > 0.0, 1.5e-7, 1e-7)

    def swirl(x):
        return np.cross([0.3, 0.1, -0.2], x) + 0.05 * np.sin(x[:, [1, 2, 0]] / (0.2 * R))

    shape = Cluster((Bubble((-R, 0.0, 0.0), R), Bubble((R, 0.0, 0.0), R, thickness=600e-9)))
    numerics = {"exchange": psi, "carrier": carrier}
    film, s = make_stepper(shape, 600, device, 8, numerics, concentration=concentration, velocity=swirl)
    return film, s


def f64(array):
    return array.numpy().astype(np.float64)


def sums_of(lag):
    """Mass, surfactant and momentum of the L, and each one's area over rho."""
    mass = f64(lag.mass)
    return mass.sum(), f64(lag.surfactant).sum(), mass @ f64(lag.u), mass / f64(lag.eta)


@pytest.mark.parametrize("carrier", ["apic", "circulation"])
def test_exchange_conserves(device, carrier):
    """Liquid, surfactant and momentum stay to rounding, as do areas and regions; some crosses, the same every time."""
    found = []
    for _ in range(2):
        _, s = touching(device, carrier)
        lag = s.state.l
        before, mass, region = sums_of(lag), f64(lag.mass), lag.region.numpy().copy()
        s.exchange.apply(s.prepare(1.0 / 60.0))
        after = sums_of(lag)
        assert after[0] == pytest.approx(before[0], rel=1e-7)
        assert after[1] == pytest.approx(before[1], rel=1e-7)
        np.testing.assert_allclose(after[2], before[2], atol=1e-6 * mass.sum() * np.abs(f64(lag.u)).max())
        np.testing.assert_allclose(after[3], before[3], rtol=1e-6)
        crossed = mass[region == 1].sum() - f64(lag.mass)[region == 1].sum()
        assert crossed > 1e-3 * mass.sum()
        assert np.array_equal(lag.region.numpy(), region)
        found.append(lag.mass.numpy().copy())
    assert np.array_equal(*found)


def sheets(device, psi, spin=0.0):
    """Two flat sheets back to back, the right one with more surfactant; it turns at `spin` (1/s) about their axis.

    Returns:
        The stepper, and which E and which L are far from their sheets' edges.
    """
    numerics = {"exchange": psi, "carrier": "circulation"}
    film, s = make_stepper(pair(2.0), 1000, device, 4, numerics)
    state, inner = s.state, []
    for block, spacing in ((state.e, film.spacing), (state.l, 0.5 * film.spacing)):
        region = block.region.numpy()
        count = np.bincount(region)
        wide = int(np.sqrt(count[0]))
        k = np.concatenate([np.arange(n) for n in count])
        x = np.stack([np.zeros(len(k)), spacing * (k % wide - wide / 2), spacing * (k // wide - wide / 2)], axis=1)
        normal = np.where(region[:, None] == 0, 1.0, -1.0) * [1.0, 0.0, 0.0]
        block.x.assign(x.astype(np.float32))
        block.normal.assign(normal.astype(np.float32))
        inner.append(np.abs(x[:, 1:]).max(axis=1) < 0.5 * spacing * wide - 6.0 * film.spacing)
    lag = state.l
    right = lag.region.numpy() == 1
    lag.mass.fill_(float(lag.mass.numpy().mean()))
    lag.surfactant.assign((float(lag.surfactant.numpy().mean()) * np.where(right, 1.5, 1.0)).astype(np.float32))
    turning = right[:, None] * np.cross([spin, 0.0, 0.0], lag.x.numpy())
    lag.u.assign(turning.astype(np.float32))
    lag.affine.assign((right[:, None, None] * np.cross([spin, 0.0, 0.0], np.eye(3)).T).astype(np.float32))
    area = f64(lag.mass) / (film.material.density * f64(lag.eta))
    lag.circulation.assign((-2.0 * spin * right * area).astype(np.float32))
    s.geometry.area.fill_(film.spacing**2)
    s.lists.rebuild()
    return s, *inner


def test_liquid_crosses_at_the_rate_of_the_law(device):
    """(1 - exp(-2 psi t (1 - Gamma_across/Gamma)))/2 of it goes to where there is less surfactant, nothing comes."""
    for psi in (1.0, 100.0, 1e5):
        s, inner, _ = sheets(device, psi)
        s.exchange.apply(s.prepare(1.0 / 60.0))
        left, right = s.exchange._left.numpy(), s.state.e.region.numpy() == 1
        expected = 0.5 * (1.0 - np.exp(-2.0 * psi / 60.0 * (1.0 - 1.0 / 1.5)))
        assert left[inner & right] == pytest.approx(expected, rel=0.02)
        assert np.abs(left[inner & ~right]).max() < 1e-6 * expected


def test_what_crosses_brings_its_vorticity(device):
    """Seen from the other side: a sheet at rest gets of it what it gets of its mass; the other keeps its own."""
    spin = 0.5
    s, _, inner = sheets(device, 1e5, spin)
    lag = s.state.l
    right, mass, before = lag.region.numpy() == 1, f64(lag.mass), f64(lag.circulation)
    s.exchange.apply(s.prepare(1.0 / 60.0))
    area = f64(lag.mass) / (s.film.material.density * f64(lag.eta))
    share = 1.0 - mass / f64(lag.mass)
    got = inner & ~right
    assert share[got].mean() > 0.1
    omega = f64(lag.circulation) / area
    assert omega[got] == pytest.approx(2.0 * spin * share[got], rel=0.02)
    assert f64(lag.u)[got] == pytest.approx(share[got, None] * np.cross([spin, 0.0, 0.0], f64(lag.x)[got]), abs=2e-3)
    assert f64(lag.circulation)[inner & right] == pytest.approx(before[inner & right], rel=1e-6)


def test_wall_carries_a_bubble(device):
    """A bubble on a wetted wall clings to it: the E there are covered, and it does not fall through."""
    shape = Cluster((Bubble((0.0, R, 0.0), R),), (Wall((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),))
    surroundings = Surroundings(air="added_mass", damping=30.0, gravity=(0.0, -9.81, 0.0))
    film, s = foam(shape, 800, device, surroundings=surroundings)
    for _ in range(40):
        s.step(1.0 / 480.0)
        s.check()
    y, cover = s.state.e.x.numpy()[:, 1], s.membrane.cover.numpy()
    assert y.min() >= 0.0
    assert np.all(cover[y < 0.1 * film.spacing] > 0.5)
    assert np.sum(y < 0.3 * film.spacing) > 20


def test_clusters_are_bubbles_that_are_near_each_other(device):
    """A row of nine that touch, out of order, a pair, and one alone: each has the number of its first bubble."""
    order = [8, 0, 5, 2, 7, 4, 1, 6, 3]
    row = [Bubble((2.0 * R * k, 0.0, 0.0), R) for k in order]
    others = [Bubble((2.0 * R * k, 9.0 * R, 0.0), R) for k in (0, 1, 7)]
    _, s = foam(Cluster((*row, *others)), 12 * 130, device)
    s.membrane._find_clusters()
    assert s.membrane._cluster.numpy().tolist() == [0] * 9 + [9, 9, 11]


@pytest.mark.parametrize("count", [2, 5])
def test_what_a_cluster_is_owed_is_paid_in_full(device, count):
    """With a share of 1 its regions get the momentum that was gained, and the angular momentum about their middle.

    That of two bubbles about the line through them is left: moving them cannot give it.
    """
    rng = np.random.default_rng(count)
    owed = rng.normal(size=(count, 4)).astype(np.float32)
    owed[:, 3] = rng.uniform(1e-3, 2e-3, size=count)
    spin, place = (scale * rng.normal(size=(count, 3)).astype(np.float32) for scale in (0.05, R))
    whole = rng.uniform(1.0, 2.0, size=count).astype(np.float32)
    film, _ = foam(pair(0.0), 300, device)
    arrays = [wp.array(owed, dtype=wp.vec4, device=device)]
    arrays += [wp.array(a, dtype=wp.vec3, device=device) for a in (spin, place)]
    arrays += [wp.zeros(count, dtype=wp.int32, device=device), wp.array(whole, dtype=float, device=device)]
    arrays += [wp.zeros(count, dtype=wp.int32, device=device), make_contact(film)]
    arrays += [wp.ones(1, dtype=float, device=device)]
    recoil = wp.zeros(count, dtype=wp.vec3, device=device)
    wp.launch(kl.pay_debt_r, dim=count, inputs=arrays, outputs=[recoil], device=device)
    paid = whole[:, None] * recoil.numpy()
    middle = np.average(place, axis=0, weights=whole)
    expected = np.sum(spin + np.cross(place - middle, owed[:, :3]), axis=0)
    found = np.cross(place - middle, paid).sum(axis=0)
    if count == 2:
        axis = (place[1] - place[0]) / np.linalg.norm(place[1] - place[0])
        expected, found = (v - axis * (v @ axis) for v in (expected, found))
    assert paid.sum(axis=0) == pytest.approx(owed[:, :3].sum(axis=0), rel=1e-4, abs=1e-4)
    assert np.linalg.norm(found - expected) < 5e-3 * np.linalg.norm(expected)


def test_what_covers_a_sheet_twice_holds_it_once(device):
    """Where two bubbles and the floor meet, what counts of a sheet's hold on the others is what covers it once."""
    bubbles = (Bubble((-R, R, 0.0), R), Bubble((R, R, 0.0), R))
    surroundings = Surroundings(air="added_mass", damping=30.0)
    shape = Cluster(bubbles, (Wall((0.0, 0.0, 0.0), (0.0, 1.0, 0.0)),))
    film, s = foam(shape, 800, device, surroundings=surroundings)
    for _ in range(60):
        s.step(1.0 / 480.0)
    x, m = s.state.e.x.numpy(), s.membrane
    free, faced = m.free.numpy(), m._faced.numpy()
    partition = (faced == 1.0) & (x[:, 1] > 3.0 * film.spacing)
    floor = (x[:, 1] < 0.15 * film.spacing) & (faced == 0.0)
    assert partition.sum() > 20
    assert floor.sum() > 20
    assert np.all(free[partition] > 0.8)
    assert np.median(free[floor]) < 0.05


def test_single_region_sums_match_numpy(device):
    """Sums by region are those of NumPy over each region's E."""
    film, s = make_film_pair(device)
    u = s.state.e.normal.numpy() * np.arange(film.n_e)[:, None] / film.n_e
    s.state.e.u.assign(u.astype(np.float32))
    s.membrane._sweep()
    parts = s.membrane._swept.numpy().reshape(2, -1).sum(axis=1)
    normal, vector = s.state.e.normal.numpy().astype(np.float64), s.geometry.vector.numpy().astype(np.float64)
    each = np.sum(vector * normal, axis=1) * np.sum(s.state.e.u.numpy() * normal, axis=1)
    expected = np.bincount(s.state.e.region.numpy(), each)
    assert parts == pytest.approx(expected, rel=1e-5)
    assert np.array_equal(film.first.numpy(), np.concatenate([[0], np.cumsum(np.bincount(s.state.e.region.numpy()))]))


def make_film_pair(device):
    """Two bubbles of different size."""
    shape = Cluster((Bubble((-R, 0.0, 0.0), R), Bubble((0.6 * R, 0.0, 0.0), 0.6 * R)))
    return foam(shape, 700, device)


def test_one_launch_count_whatever_the_regions(device, monkeypatch):
    """Eight bubbles run no more launches a step than two."""
    from melp_warp.device import launch as launcher

    counts = []
    for n in (2, 8):
        monkeypatch.setattr(launcher, "THREADS", 1)  # one launch a kernel, which cores may split
        bubbles = tuple(Bubble((2.05 * R * k, 0.0, 0.0), R) for k in range(n))
        _, s = foam(Cluster(bubbles), 130 * n, device)
        s.step(1e-4)
        calls = []
        real = wp.launch
        monkeypatch.setattr(launcher.wp, "launch", lambda *a, **k: (calls.append(1), real(*a, **k))[1])  # noqa: B023
        s.step(1e-4)
        monkeypatch.undo()
        counts.append(len(calls))
    assert counts[1] <= counts[0]


def test_film_has_no_foam_where_there_is_one_bubble(device):
    """A lone film has neither stars nor lists of other regions."""
    from melp_warp.scene import Scene
    from melp_warp.shapes import Sphere

    _, s = make_film(Scene("one", Sphere(R), 300), device)
    assert s.lists.eo is None
    assert s.geometry.share is None and not hasattr(s.geometry, "tie")
