"""Circulation carried by L: what is conserved, what makes it, and that it costs waves nothing."""

import numpy as np
import pytest

from melp_warp.cli import main
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Jittered, Rectangle, Sphere, displaced_sphere
from melp_warp.simulation import Simulation
from melp_warp.study import validation as v
from melp_warp.study import vortex_validation as vv
from melp_warp.usd.check import check_cache
from melp_warp.usd.reading import read_frame
from tests.helpers import make_stepper

CARRIED = Numerics(carrier="circulation")
WIDTH = 0.1


def f64(array):
    return array.numpy().astype(np.float64)


def solid(x):
    """Rotation about z at 1 rad/s, m/s."""
    return np.cross([0.0, 0.0, 1.0], x)


@pytest.mark.parametrize("shape", [Jittered(Sphere(0.05)), Jittered(Disc(0.05))])
def test_gather_conserves_and_is_the_sum_of_its_docstring(shape, device):
    """The sum over the E is that over the L within 1e-6; each E gets sum_L W(E, L) Omega_L/sum_E W(E, L)."""
    film, s = make_stepper(shape, 400, device, l_per_e=6, numerics={"carrier": "circulation"})
    lag, rows = s.state.l, s.lists.le.rows
    given = np.random.default_rng(0).uniform(0.5, 1.5, film.n_l)
    lag.circulation.assign(given.astype(np.float32))
    s.transfer.gather()
    s.circulation.gather()
    assert f64(s.circulation.carried).sum() == pytest.approx(given.sum(), rel=1e-6)
    start, stop, index, weight = (a.numpy() for a in (rows.start, rows.stop, rows.index, s.transfer.weight))
    expected = np.zeros(film.total)
    for i in range(film.n_l):
        part = slice(start[i], stop[i])
        expected[index[part]] += given[i] * weight[part] / weight[part].sum(dtype=np.float64)
    assert f64(s.circulation.blurred) == pytest.approx(expected[: film.n_e], rel=1e-4)


def test_what_the_weights_blur_is_taken_back(device):
    """Solid rotation on a sphere, omega = 2 z/R: blurred by 2 c r^2/R^2, then by less than a tenth of that."""
    film, s = make_stepper(Sphere(0.05), 1600, device, l_per_e=24, numerics={"carrier": "circulation"})
    lag = s.state.l
    area = 4.0 * np.pi * 0.05**2 / film.n_l
    lag.circulation.assign((area * f64(lag.x)[:, 2] / 0.05).astype(np.float32))
    s.transfer.gather()
    s.circulation.gather()
    share = s.state.e.x.numpy()[:, 2] / 0.05
    held = [
        np.sum(share * f64(a)) / np.sum(share**2 * f64(s.geometry.area))
        for a in (s.circulation.blurred, s.circulation.carried)
    ]
    blur = 2.0 * 0.026838292 * film.r**2 / 0.05**2
    assert 1.0 - held[0] == pytest.approx(blur, rel=0.1)
    assert abs(1.0 - held[1]) < 0.1 * blur


def test_restored_velocity_has_the_circulation_that_l_carry(device):
    """E at rest in a disc, L that carry a solid rotation: E turn at it within 1 %, a few spacings from the rim.

    psi = 0 on a round rim leaves the rotation as it is.
    """
    film, s = make_stepper(Disc(0.05), 1600, device, l_per_e=6, numerics={"carrier": "circulation"})
    s.state.l.circulation.fill_(2.0 * np.pi * 0.05**2 / film.n_l)
    s.transfer.gather()
    for _ in range(6):  # each leaves a hundredth, and what a gradient of a gradient sees less of
        s.circulation.restore()
    x, u = f64(s.state.e.x)[: film.n_e], f64(s.state.e.u)[: film.n_e]
    expected = np.cross(f64(s.state.e.normal)[: film.n_e], x)
    inner = np.linalg.norm(x, axis=1) < 0.035
    assert np.linalg.norm(u - expected, axis=1)[inner].max() < 0.01 * 0.05


def test_dye_drives_nothing():
    """A stirred disc, thickness uneven by 30 %: neither energy nor enstrophy rises by 2 % in 40 frames.

    Steps are many periods of an elastic wave long. A source by the surfactant that a step starts with, not by what its
    solve leaves, makes 30 times of both within ten frames.
    """
    script = load_scene("stirred_disc")
    simulation = Simulation(script.build(script.parameters.values({"e_count": 300, "l_per_e": 4})))
    simulation.advance_frame()
    start = simulation.diagnostics()
    for _ in range(40):
        simulation.advance_frame()
        now = simulation.diagnostics()
        assert now["kinetic_energy"] < 1.02 * start["kinetic_energy"]
        assert now["enstrophy"] < 1.02 * start["enstrophy"]


def test_what_each_l_carries_stays_on_a_ringing_bubble():
    """Kelvin: no force makes circulation where thickness and surfactant are even, however the film moves. 1e-4."""
    shape = displaced_sphere(0.05, lambda d: 0.05 * (1.5 * d[:, 1] ** 2 - 0.5))
    scene = Scene("ringing", shape, 600, 8, velocity=lambda x: 2.0 * solid(x), numerics=CARRIED, fps=2000.0)
    simulation = Simulation(scene)
    before = f64(simulation.state.l.circulation)
    for _ in range(40):
        simulation.advance_frame()
    change = f64(simulation.state.l.circulation) - before
    assert np.abs(before).max() > 0.0
    assert np.abs(change).max() < 1e-4 * np.abs(before).max()


def test_uneven_mass_makes_circulation():
    """d omega/dt = g (d eta/dx)/eta where surfactant holds a film up whose thickness grows across it, within 3 %."""
    assert vv.baroclinic()["error"] == pytest.approx(0.0, abs=0.03)


def eddies(**given):
    """Taylor-Green eddies, two by two, in a box that they slip along: numbers before and after, time, k."""
    k = 2.0 * np.pi / WIDTH

    def flow(x):
        a, b = k * (x[:, 0] + 0.5 * WIDTH), k * (x[:, 1] + 0.5 * WIDTH)
        return 1e-2 * np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b), 0.0 * a], axis=1)

    scene = Scene("eddies", Rectangle(WIDTH, WIDTH), 1600, 8, velocity=flow, numerics=CARRIED, fps=120.0, **given)
    simulation = Simulation(scene)
    start = simulation.diagnostics()
    for _ in range(24):
        simulation.advance_frame()
    return start, simulation.diagnostics(), simulation.time, k


def test_nothing_is_lost_where_nothing_acts():
    """Steady eddies of 20 E: enstrophy within 1 %, kinetic energy m U^2/4 besides, though transfers blur the start."""
    start, end, _, _ = eddies()
    assert end["enstrophy"] == pytest.approx(start["enstrophy"], rel=0.01)
    assert end["kinetic_energy"] == pytest.approx(0.25 * Material().areal_mass * WIDTH**2 * 1e-4, rel=0.01)


def test_viscosity_takes_what_theory_says():
    """Omega decays at 2 nu k^2, its square at twice that, within 2 %."""
    nu = 2e-4
    start, end, time, k = eddies(material=Material(viscosity=nu))
    still_start, still_end, _, _ = eddies()
    rate = -np.log(end["enstrophy"] / start["enstrophy"] * still_start["enstrophy"] / still_end["enstrophy"]) / time
    assert rate == pytest.approx(4.0 * nu * k**2, rel=0.02)


def test_drag_takes_what_theory_says():
    """Omega decays at drag/m, within 2 %."""
    m = Material()
    drag = 2.0 * m.areal_mass
    start, end, time, _ = eddies(surroundings=Surroundings(drag=drag))
    rate = -np.log(end["enstrophy"] / start["enstrophy"]) / time
    assert rate == pytest.approx(2.0 * drag / m.areal_mass, rel=0.02)


def test_a_vortex_lasts():
    """A Taylor vortex of 5 E to its radius, one turnover: energy, angular momentum and peak of vorticity kept.

    With APIC alone 94, 98 and 86 % are left.
    """
    run = v.taylor_vortex(40, l_per_e=8, turns=1.0, carrier="circulation")
    assert run["measured"] > 0.985
    assert run["angular_kept"] == pytest.approx(1.0, abs=0.002)
    assert run["peak_kept"] > 0.95


def test_an_even_flow_is_left_alone():
    """Without circulation waves are as with APIC: the thickness of a film that evens out within 1e-3 of its range."""
    script = load_scene("equilibrium")
    found = []
    for carrier in ("apic", "circulation"):
        values = script.parameters.values({"e_count": 600, "l_per_e": 4, "carrier": carrier})
        simulation = Simulation(script.build(values))
        first = simulation.diagnostics()["thickness_std"]
        for _ in range(20):
            simulation.advance_frame()
        found.append(simulation.diagnostics()["thickness_std"] / first)
    assert found[1] == pytest.approx(found[0], abs=2e-2)


def test_absent_where_it_is_not_asked_for():
    simulation = Simulation(Scene("plain", Sphere(0.05), 300, 4))
    assert simulation.stepper.circulation is None
    assert simulation.state.l.circulation is None
    assert "circulation" not in simulation.diagnostics()


@pytest.fixture(scope="module")
def quartet():
    return vv.leapfrog()


@pytest.mark.slow
def test_leapfrog(quartet):
    """The quartet of Tao et al. (2024) against spectral Euler: it passes at 2.3, 4.26, 5.83 s; vortices stay sharp.

    Up to 4 s they are within 0.1 m of where they belong.
    """
    assert quartet["passes"][:3] == pytest.approx([2.3, 4.26, 5.83], abs=0.15)
    assert quartet["places_off"] < 0.1
    assert quartet["peak_at_5"] > 22.0


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="0.984: E hold 0.975 of the energy of cores of 2.1 spacings from the start on")
def test_leapfrog_keeps_its_energy(quartet):
    assert quartet["energy_kept"] > 0.985


def test_a_bubble_that_turns_is_oblate():
    """Centrifugal force across the film, m w^2 s^2/R, s the distance to the axis, and tension that holds the liquid.

    2 sigma = c - m w^2 s^2/2 keeps liquid from flowing to the equator, and holds it in less there: by as much again.
    The second Legendre mode comes to rest at -m (w R)^2/(6 sigma) of R.
    """
    m, radius, spin = Material(surfactant=4e-6), 0.05, 20.0

    def concentration(x):
        s2 = np.sum(x[:, :2] ** 2, axis=1)
        return m.surfactant + 0.25 * m.areal_mass * spin**2 / m.rt * (s2 - 2.0 / 3.0 * radius**2)

    given = {"material": m, "velocity": lambda x: spin * solid(x), "concentration": concentration, "fps": 1000.0}
    simulation = Simulation(Scene("spin", Sphere(radius), 600, 8, **given))
    seen = []
    for _ in range(60):
        simulation.advance_frame()
        x = v.e_points(simulation) - v.e_points(simulation).mean(axis=0)
        height = x[:, 2] / np.linalg.norm(x, axis=1)
        seen.append(5.0 * np.mean((np.linalg.norm(x, axis=1) / radius - 1.0) * (1.5 * height**2 - 0.5)))
    exact = -m.areal_mass * (spin * radius) ** 2 / (6.0 * m.film_tension)
    assert np.mean(seen[-20:]) == pytest.approx(exact, rel=0.03)


def test_a_bubble_on_which_vortices_run_does_not_drive_itself():
    """A pair of vortices makes no momentum but for an error of first order; it runs at its speed within 2 %.

    Without the centrifugal force the bubble flies off at a quarter of the speed of the flow.
    """
    coarse, fine = (vv.sphere_pair(e_count, turns=0.2) for e_count in (500, 1000))
    assert fine["flown"] < min(0.04, 0.7 * coarse["flown"])
    assert fine["error"] == pytest.approx(0.0, abs=0.02)
    assert fine["apart"] == pytest.approx(1.0, abs=0.01)


def test_the_cache_shows_circulation_on_request(tmp_path):
    """A primvar of L and E, in m^2/s; where L carry none, or the film may burst, asking for it is refused."""
    folder, shown = tmp_path / "run", ["e_count=300", "l_per_e=4", "show=circulation"]
    options = ["--frames", "1", "--quiet", "--export", "both", "--out", str(folder)]
    assert main(["run", "stirred_disc", "--set", *shown, *options]) == 0
    values = {"e_count": 300, "l_per_e": 4, "show": "circulation"}
    script = load_scene("stirred_disc")
    simulation = Simulation(script.build(script.parameters.values(values)))
    simulation.advance_frame()
    film, sparse = read_frame(folder, 1), read_frame(folder, 1, "FilmE")
    held = f64(simulation.state.l.circulation)
    np.testing.assert_allclose(np.sort(film.carried["circulation"]), np.sort(held), atol=1e-6 * np.abs(held).max())
    assert sparse.carried["circulation"].sum() == pytest.approx(held.sum(), abs=1e-4 * np.abs(held).sum())
    assert check_cache(folder) == []
    assert main(["run", "equilibrium", "--set", "show=circulation", "--out", str(tmp_path / "none")]) == 2


def test_levels_are_the_same_after_a_checkpoint(tmp_path):
    """Their number follows that of the E: 140 E had one level in a run, and two after its checkpoint was read."""
    script = load_scene("giant_bubble")
    scene = script.build(script.parameters.values({"e_count": 140, "l_per_e": 2, "carrier": "circulation"}))
    whole = Simulation(scene)
    for _ in range(3):
        whole.advance_frame()
    whole.save_checkpoint(tmp_path / "checkpoint.npz")
    rest = Simulation(scene, checkpoint=tmp_path / "checkpoint.npz")
    for simulation in (whole, rest):
        simulation.advance_frame()
    assert whole.state.l.x.numpy().tobytes() == rest.state.l.x.numpy().tobytes()
