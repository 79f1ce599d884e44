"""Mixing of what L hold, and the grain of pictures."""

import numpy as np
import pytest

from melp_warp import Carried
from melp_warp.cli import main
from melp_warp.material import Material
from melp_warp.measure.grain import grain
from melp_warp.numerics import Numerics
from melp_warp.program.report import read_grain
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Rectangle, Sphere
from melp_warp.simulation import Simulation
from melp_warp.study.validation import small_giant

WIDTH = 0.1


def f64(array):
    return array.numpy().astype(np.float64)


def grain_of(simulation):
    lag = simulation.state.l
    return grain(f64(lag.x), f64(lag.normal), f64(lag.eta), lag.region.numpy())


def test_grain_is_what_is_not_smooth():
    """Nothing of a quadratic; of noise its share, and the error of what 18 noisy values say besides."""
    points = Sphere(1.0).sample(2000).points
    noise = np.random.default_rng(0).normal(size=2000)
    region = np.zeros(2000, dtype=int)
    smooth = 1.0 + points[:, 0] + 0.3 * points[:, 1] ** 2
    assert grain(points, points, smooth, region) < 2e-3
    assert grain(points, points, smooth + 0.1 * smooth.std() * noise, region) == pytest.approx(0.12, abs=0.02)
    assert 1.0 < grain(points, points, noise, region) < 1.5
    assert grain(points, points, np.ones(2000), region) == 0.0


def stirred(mixing, frames=36):
    script = load_scene("turbulent_film")
    values = {"e_count": 600, "whirls": 2, "l_per_e": 8, "mixing": mixing}
    simulation = Simulation(script.build(script.parameters.values(values)))
    start = simulation.diagnostics()
    for _ in range(frames):
        simulation.advance_frame()
    return simulation, start, simulation.diagnostics()


def test_a_stirred_film_turns_even_not_grainy():
    """Liquid and surfactant stay; the grain is less than 8 %, where without it is more than 15 %."""
    plain, _, _ = stirred(0.0)
    mixed, start, end = stirred(2.0)
    assert grain_of(plain) > 0.15
    assert grain_of(mixed) < 0.03
    assert end["mass"] == pytest.approx(start["mass"], rel=1e-6)
    assert end["surfactant"] == pytest.approx(start["surfactant"], rel=1e-6)


def test_what_l_show_is_as_smooth_as_what_they_hold():
    """The thickness has the grain of liquid over surfactant, within 2 %: E add none of their noise."""
    simulation, _, _ = stirred(2.0)
    lag = simulation.state.l
    held = grain(f64(lag.x), f64(lag.normal), f64(lag.mass) / f64(lag.surfactant), lag.region.numpy())
    assert grain_of(simulation) == pytest.approx(held, rel=0.02)


def test_a_pass_keeps_momentum_and_areas():
    """To rounding, and it makes what differs differ less."""
    simulation, _, _ = stirred(1.0, frames=3)
    lag, mixing = simulation.state.l, simulation.stepper.mixing

    def sums():
        mass, u = f64(lag.mass), f64(lag.u)
        return mass.sum(), f64(lag.surfactant).sum(), (mass[:, None] * u).sum(axis=0), mass / f64(lag.eta)

    before, spread = sums(), f64(lag.eta).std()
    mixing._time.at(1.0)
    mixing.apply()
    after = sums()
    assert after[0] == pytest.approx(before[0], rel=1e-7)
    assert after[1] == pytest.approx(before[1], rel=1e-7)
    np.testing.assert_allclose(after[2], before[2], atol=1e-6 * np.sum(f64(lag.mass)) * np.abs(f64(lag.u)).max())
    assert after[3].sum() == pytest.approx(before[3].sum(), rel=1e-6)
    assert f64(lag.eta).std() < spread


def test_l_in_a_crowd_give_no_more_than_they_have():
    """A quarter of the L at a tenth of their places, some a hundred times as thick: sums to rounding, all above 0."""
    simulation, _, _ = stirred(2.0, frames=2)
    lag, mixing = simulation.state.l, simulation.stepper.mixing
    rng = np.random.default_rng(1)
    x, mass, eta = (array.numpy() for array in (lag.x, lag.mass, lag.eta))
    crowd = rng.permutation(len(x))[: len(x) // 4]
    x[crowd] = x[crowd[: len(x) // 40]][rng.integers(0, len(x) // 40, len(crowd))]
    thick = rng.random(len(x)) < 0.1
    for values in (mass, eta):
        values[thick] *= 100.0
    for array, values in ((lag.x, x), (lag.mass, mass), (lag.eta, eta)):
        array.assign(values)
    u = simulation.state.e.u.numpy()
    u[:, 0] = 1e3 * simulation.state.e.x.numpy()[:, 1]
    simulation.state.e.u.assign(u)
    simulation.stepper.lists.rebuild_l()
    before = f64(lag.mass).sum(), f64(lag.surfactant).sum()
    mixing._time.at(1.0)
    mixing.apply()
    assert mixing._spent.numpy()[0] == 1
    assert f64(lag.mass).sum() == pytest.approx(before[0], rel=1e-6)
    assert f64(lag.surfactant).sum() == pytest.approx(before[1], rel=1e-6)
    assert lag.mass.numpy().min() > 0.0


@pytest.mark.parametrize("turn", [0.0, 2.0])
def test_nothing_mixes_where_nothing_shears(turn):
    """Of a wave of 4 L spacings less than 1 % is gone after 5 s, all over a film at rest and over one that turns.

    What an L holds changes by mixing alone.
    """
    shape, m, e_count, l_per_e = Disc(0.05), Material(), 300, 8
    number = 2.0 * np.pi / (4.0 * np.sqrt(shape.area / (e_count * l_per_e)))
    axis = shape.sample(10).normals[0]

    def thickness(x):
        return m.thickness * (1.0 + 0.01 * np.cos(number * x[:, 0]))

    def velocity(x):
        return turn * np.cross(axis, x)

    numerics = Numerics(mixing=2.0, carrier="circulation")
    scene = Scene("still", shape, e_count, l_per_e, numerics=numerics, thickness=thickness, velocity=velocity, fps=12.0)
    simulation = Simulation(scene)
    held, wave = f64(simulation.state.l.mass), f64(simulation.state.l.eta) / m.thickness - 1.0
    for _ in range(60):
        simulation.advance_frame()
    change = f64(simulation.state.l.mass) / held - 1.0
    assert abs(np.sum(change * wave)) < 0.01 * np.sum(wave**2)
    inner = np.sum(f64(simulation.state.l.x) ** 2, axis=1) < (0.8 * 0.05) ** 2
    assert np.all(change[inner] == 0.0)


def test_report_tells_the_grain_of_frames(tmp_path, capsys):
    """Of each frame up to eleven what `grain` finds in the simulation, to what the cache rounds."""
    folder = tmp_path / "run"
    options = ["e_count=300", "l_per_e=8", "whirls=2"]
    assert main(["run", "turbulent_film", "--set", *options, "--frames", "2", "--quiet", "--out", str(folder)]) == 0
    script = load_scene("turbulent_film")
    simulation = Simulation(script.build(script.parameters.values({"e_count": 300, "l_per_e": 8, "whirls": 2})))
    expected = [grain_of(simulation)]
    for _ in range(2):
        simulation.advance_frame()
        expected.append(grain_of(simulation))
    found = read_grain(folder)
    assert [frame for frame, _ in found] == [0, 1, 2]
    assert [amount for _, amount in found] == pytest.approx(expected, abs=2e-3)
    capsys.readouterr()
    main(["report", str(folder)])
    assert f"{100.0 * found[2][1]:.1f} % in frame 2" in capsys.readouterr().out


def test_absent_where_it_is_not_asked_for():
    simulation = Simulation(Scene("plain", Rectangle(WIDTH, WIDTH), 300, 4))
    assert simulation.stepper.mixing is None


def test_no_declared_amount_falls_below_zero():
    """Strips of dye in a flow of 2 m/s that shears them: none of them is left with less than nothing."""
    dye = Carried("dye", "kg/m^2", start=lambda x: 1e-6 * (np.sin(300.0 * x[:, 2]) > 0.0))
    flow = lambda x: np.stack([2.0 * np.sin(80.0 * x[:, 2]), 0.0 * x[:, 0], 0.0 * x[:, 0]], axis=1)  # noqa: E731
    numerics = Numerics(mixing=2.0, carrier="circulation")
    simulation = Simulation(Scene("dyed", Disc(0.05), 300, 8, velocity=flow, numerics=numerics, carried=(dye,)))
    held = simulation.state.carried["dye"]
    total = f64(held).sum()
    for _ in range(4):
        simulation.advance_frame()
        assert f64(held).min() >= 0.0
    assert f64(held).sum() == pytest.approx(total, rel=1e-5)


def test_a_violent_flow_leaves_no_l_without_liquid():
    """Whirls of 10 m/s crowd L: those that would give more than they have do not mix, nor those that lack theirs then.

    With one turn of that an L ended with less than none, and the energy budget with no number.
    """
    simulation = Simulation(small_giant(600, 4, swirl=10.0))
    start = simulation.diagnostics()["mass"]
    for _ in range(2):
        simulation.advance_frame()
        assert simulation.state.l.mass.numpy().min() > 0.0
    assert np.isfinite(simulation.state.memory.book.numpy()).all()
    assert simulation.diagnostics()["mass"] == pytest.approx(start, rel=1e-6)
