"""Flow along flat films: Marangoni waves, surfactant, drag, viscosity, drainage, evening out."""

import math

import numpy as np
import pytest

from melp_warp.material import Material
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import Disc
from melp_warp.simulation import Simulation
from melp_warp.study import validation as v

TRANSFERS = {"carrier": "apic", "flip": 0.95}
"""L that carry vortices by their velocity alone: these tests are about what that loses."""


@pytest.mark.parametrize("l_order", [1, 2])
def test_marangoni_wave_speed(l_order):
    """c = sqrt(2 R T Gamma_0/m) within 2 %.

    Half a wave over 30 E: (k dx)^2 = 0.011, of which the kernel's smoothing takes 0.4; (omega dt)^2/3 = 0.2 % at T/80.
    Of backward Euler: a wave must lose no less than that loses, and at most a little more.
    """
    run = v.marangoni_wave(30, l_per_e=8, periods=1.0, l_order=l_order, flow="backward_euler")
    assert abs(run["error"]) < 0.02
    assert run["exact_damping"] - 0.01 < run["damping"] < run["exact_damping"] + 0.06


@pytest.mark.parametrize("count", [20, 40])
def test_midpoint_rule_keeps_a_wave(count):
    """With `flow=midpoint` a wave in steps of T/20 loses under 1 % a period, and is slower by (omega dt)^2/12.

    Backward Euler leaves 38 % at T/20 (`exact_damping`). The kernel's smoothing slows it by 0.3 to 0.4 (k dx)^2 more.
    """
    run = v.marangoni_wave(30, l_per_e=4, periods=1.0, steps_per_period=count, flow="midpoint", tolerance=1e-6)
    late = (2.0 * math.pi / count) ** 2 / 12.0
    assert abs(run["damping"]) < 0.006
    assert 0.2 < (-run["error"] - late) / run["k_dx"] ** 2 < 0.5


def test_midpoint_rule_is_of_second_order_in_the_step():
    """Frequencies in steps of T/12, T/24 and T/48 differ by 4 : 1, within 10 %."""
    runs = [
        v.marangoni_wave(20, 4, periods=1.0, steps_per_period=n, flow="midpoint", tolerance=1e-6) for n in (12, 24, 48)
    ]
    speed = [run["measured"] for run in runs]
    assert (speed[1] - speed[0]) / (speed[2] - speed[1]) == pytest.approx(4.0, rel=0.1)


def test_midpoint_rule_neither_feeds_nor_drains_a_vortex():
    """Energy after a turnover differs by under 2 % from that of backward Euler, whose losses straight paths make up."""
    kept = [
        v.taylor_vortex(24, 4, turns=1.0, flow=flow, **TRANSFERS)["measured"] for flow in ("backward_euler", "midpoint")
    ]
    assert kept[1] == pytest.approx(kept[0], abs=0.02)


def test_midpoint_rule_does_not_feed_a_shear_flow():
    """Nothing drives two vortices: their energy never rises, at steps that elastic waves do not resolve either."""
    pair = v.taylor_pair(
        duration=2.5,
        e_count=1600,
        l_per_e=4,
        width=3.0,
        height=3.0,
        vortex_speed=2.0,
        fps=32.0,
        dt=1.0 / 32.0,
        **TRANSFERS,
    )
    energy = pair["series"]["energy"]
    assert energy.max() == energy[0]
    assert energy[-1] > 0.85 * energy[0]


@pytest.mark.slow
def test_marangoni_wave_converges():
    """1.5 % at 20 E to half a wave, three times better at 40: second order."""
    errors = [v.marangoni_wave(n, l_per_e=16)["error"] for n in (20, 40, 80)]
    assert abs(errors[2]) < abs(errors[1]) < abs(errors[0]) < 0.02


def test_surfactant_evens_out_at_the_right_rate():
    """s^2 + (d/m) s + c^2 k^2 = 0, slow root, within 2 %: with drag, Marangoni flow is diffusion."""
    assert abs(v.surfactant_decay(28)["error"]) < 0.02


@pytest.mark.parametrize(
    "force",
    [
        pytest.param({"drag": 0.01}, id="drag"),
        pytest.param({"viscosity": 1e-4}, id="viscosity"),
    ],
)
def test_shear_flow_decays(force):
    """u_x = U cos(k y) of a film without surfactant decays at d/m and nu k^2, within 2 %; along free-slip rims.

    Backward Euler takes half of 1/50 off the rate, the kernel adds 0.4 (k dx)^2 = 0.7 % to the viscous one.
    """
    assert abs(v.shear_decay(**force, cells=24, l_per_e=4, count=50)["error"]) < 0.02


@pytest.mark.parametrize("count", [240, 60])
def test_a_taylor_green_eddy_decays_as_theory_says(count):
    """2 nu k^2 of 900 E in steps of 1/240 and 1/60 s, within 0.5 %: 0.26 % by the kernel's blur, 0.1 % by theta.

    Transfers take 2.5 % more in steps of 1/240 s, 0.6 % in steps of 1/60 s, and a tenth of that with `flip` 0.95: the
    whole is then within 1 %.
    """
    run = v.taylor_green(dt=1.0 / count, count=60 if count == 240 else 30, flip=0.95)
    assert abs(run["error"]) < 5e-3
    assert abs(run["error"] + run["lost"]) < 0.01


@pytest.mark.slow
def test_a_taylor_green_eddy_converges():
    """0.63, 0.32, 0.15 % at 15, 20, 30 E across: second order, until 0.1 % of theta in steps of 1/60 s is left."""
    errors = [-v.taylor_green(cells)["error"] for cells in (15, 20, 30, 60)]
    assert errors[0] > errors[1] > errors[2] > errors[3] > 0.0
    assert v.order_of([1.0 / 15, 1.0 / 20, 1.0 / 30], errors[:3]) > 1.7
    assert errors[3] < 2e-3


def test_midpoint_rule_decays_as_theory_says():
    """Drag in steps h = 1/5 of its time: log((1 + h/2)/(1 - h/2))/h = 1.003 times the rate, within 0.3 %.

    Backward Euler has log(1 + h)/h = 0.912 times.
    """
    rates = [
        v.shear_decay(drag=0.01, cells=24, l_per_e=4, count=5, flow=flow)["error"]
        for flow in ("midpoint", "backward_euler")
    ]
    assert rates[0] == pytest.approx(0.0034, abs=3e-3)
    assert rates[1] == pytest.approx(-0.0884, abs=3e-3)


def test_midpoint_rule_does_not_ring_in_long_steps():
    """Drag in steps of 20 of its times: what is left of a flow halves at least, in each step."""
    run = v.shear_decay(drag=0.2, cells=14, l_per_e=4, count=6, dt=20.0 * 4e-7 * 997.0 / 0.2, flow="midpoint")
    assert run["measured"] * run["dt"] == pytest.approx(math.log(2.0), rel=0.01)


def test_a_rim_feeds_no_flow():
    """Without viscosity or drag a flow along a free-slip rim keeps its speed or loses some: nothing drives it."""
    run = v.shear_decay(drag=1e-8, cells=14, l_per_e=4, count=200, dt=1e-3)
    assert -0.001 < run["measured"] * 200 * 1e-3 < 0.05


def test_drainage_reaches_the_exact_profile():
    """eta(z) = eta_0 (h/l) exp(-z/l)/(1 - exp(-h/l)), l = 2 R T Gamma_0/(rho g eta_0), within 2 % in L2: E and L."""
    run = v.drainage(300, 8)
    assert run["error"] < 0.02
    assert run["l_error"] < 0.02
    assert run["amplitude"] > 0.4
    assert run["final_speed"] < 1e-3
    assert run["measured"] == pytest.approx(run["exact"], rel=0.02)


def test_exact_drainage_profile_stays_at_rest():
    """Two seconds without drag: the profile stays within 2 %; what its sampling stirs is 2 % of the elastic speed.

    Backward Euler damps that, the midpoint rule keeps it, and adds nothing.
    """
    for flow, left in (("backward_euler", 0.1), ("midpoint", 1.0)):
        run = v.drainage(300, 8, duration=2.0, drag=0.0, at_rest=True, flow=flow)
        assert run["error"] < 0.02
        assert run["l_error"] < 0.02
        assert run["max_speed"] < 0.03 * v.elastic_speed(Material())
        assert run["final_speed"] < left * run["max_speed"]


@pytest.mark.slow
def test_drainage_at_full_resolution():
    """1,200 E and 19,200 L: 2 % with a wide margin."""
    for at_rest in (False, True):
        run = v.drainage(at_rest=at_rest, drag=0.0 if at_rest else 0.02)
        assert run["error"] < 0.005
        assert run["l_error"] < 0.02


def test_equilibrium_of_e():
    """The variance of eta_E falls 100-fold in 5 s and stays there; 300 E, 8 L each."""
    run = v.equilibrium(300, 8)
    assert run["measured"] > 100.0
    assert run["worst_of_last_second"] > 100.0


@pytest.mark.slow
def test_equilibrium_at_full_resolution():
    """That of eta_L as well, for the scene's 1,050 E and 16,800 L: thickness mismatch up to 2 % is left alone."""
    run = v.equilibrium()
    assert run["measured"] > 100.0
    assert run["worst_of_last_second"] > 100.0
    assert run["l_measured"] > 100.0
    assert run["l_worst_of_last_second"] > 100.0


def test_eddies_fade_no_faster_than_theory():
    """An APIC transfer takes 1/2 (K sigma)^4 of an eddy's speed, to leading order, and should not take much more."""
    run = v.eddy_loss(32, eddies=2)
    assert run["measured"] < 1.3 * run["exact"]


def test_a_vortex_keeps_its_angular_momentum():
    """One turnover of a Taylor vortex of 5 E to its radius, four radii from the rim: angular momentum within 1 %.

    The path of an L is straight in a step, so r x u is kept by the motion and the torque-free forces alike. The
    energy, that nothing protects, stays to 85 %.
    """
    run = v.taylor_vortex(40, l_per_e=8, turns=1.0, **TRANSFERS)
    assert run["angular_kept"] == pytest.approx(1.0, abs=0.01)
    assert run["measured"] > 0.85


@pytest.mark.slow
def test_taylor_vortices_part():
    """0.81 m apart, beyond the critical distance, two vortices must part."""
    run = v.taylor_pair()
    assert run["error"] == 0.0


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="paths of second order give nothing back of what theta > 1/2 takes")
def test_second_order_paths_do_not_harm_vortices():
    """Order 2 of the L advance must not be worse than order 1."""
    first, second = (v.taylor_vortex(40, l_order=order, **TRANSFERS) for order in (1, 2))
    assert second["measured"] >= first["measured"]


def test_flip_takes_a_share_of_what_transfers_take():
    """With `flip` f eddies lose 1 - f of what they lose with APIC, to first order in the blur of a transfer.

    What is beyond that falls with the spacing: for eddies of 8 and 16 E 0.31 and 0.25 were measured for 0.2. On other
    processors, which round otherwise, the first is 0.30.
    """

    def ratio(cells):
        lost = {f: v.eddy_loss(cells=cells, l_per_e=8, count=30, flip=f)["measured"] for f in (0.0, 0.8)}
        print(f"{cells} E across: lost a step {lost[0.0]:.1e}, with flip 0.8 {lost[0.8]:.1e}")
        return lost[0.8] / lost[0.0]

    coarse, fine = ratio(16), ratio(32)
    assert 0.15 < fine < 0.3
    assert abs(fine - 0.2) < 0.6 * abs(coarse - 0.2)


@pytest.mark.parametrize("steps", [1, 3, 5])
def test_paths_of_neighbours_do_not_cross(steps):
    """A whiff of (steps - 1/2) 0.7/dt in its middle, in steps dt = 1/60 s by its scene: so many."""
    wave, width, rate = 200.0, 0.015, 0.7 * 60.0 * (steps - 0.5)

    def whiff(x):
        speed = rate / wave * np.sin(wave * x[:, 2]) * np.exp(-0.5 * np.sum(x**2, axis=1) / width**2)
        return speed[:, None] * [1.0, 0.0, 0.0]

    simulation = Simulation(Scene("whiff", Disc(0.05), 1200, 4, velocity=whiff, fps=60.0, dt=1.0 / 60.0))
    simulation.advance_frame()
    assert simulation.substeps == steps


@pytest.mark.slow
def test_liquid_does_not_clump_in_long_steps():
    """giant_bubble of 10,000 E in 30 frames a second, its own step as long: as even as in steps of 1/60 s.

    Without a bound on the step |grad u| dt grew to 5, and thickness at E to between 45 and 2,600 nm.
    """
    script = load_scene("giant_bubble")
    given = {"e_count": 10_000, "l_per_e": 1, "fps": 30, "dt": 1.0 / 30.0}
    simulation = Simulation(script.build(script.parameters.values(given)))
    for _ in range(50):
        simulation.advance_frame()
    e, n = simulation.state.e, simulation.film.n_e
    eta = e.mass.numpy()[:n] / simulation.stepper.geometry.area.numpy()[:n] / simulation.film.material.density
    assert 0.4 < eta.min() / eta.mean() and eta.max() / eta.mean() < 2.2
    assert eta.std() / eta.mean() < 0.17
