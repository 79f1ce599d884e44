"""Free rims: films burst at the speed of Taylor and Culick, and nothing of their liquid is lost."""

import math

import numpy as np
import pytest

from melp_warp.bursting import Bursting, Puncture
from melp_warp.errors import InputError
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Cap, Rectangle, Sphere
from melp_warp.simulation import Simulation
from melp_warp.stepping.rims import RAYLEIGH, Rims, Thread

WIDTH, RADIUS = 0.1, 0.1


def culick(material, thickness=None):
    """Speed of a rim, m/s."""
    sigma = material.tension - material.rt * material.surfactant
    return math.sqrt(2.0 * sigma / (material.density * (thickness or material.thickness)))


def film(material, punctures, e_count=900, l_per_e=4, breakup=0.0, frames=10, cross=0.5, shape=None, **fields):
    """A film in which rims cross `cross` of its width in 10 frames."""
    shape = shape or Rectangle(WIDTH, WIDTH)
    fps = 10.0 * culick(material) / (cross * WIDTH)
    bursting = Bursting(punctures, breakup=breakup)
    return Scene("film", shape, e_count, l_per_e, material, bursting=bursting, fps=fps, frames=frames, **fields)


def bubble(e_count=700, l_per_e=4, breakup=0.0, air="none", **more):
    """A bubble that is punctured at its top, in 20 frames up to where a rim that runs around it comes to the bottom."""
    material = Material(thickness=425e-9)
    fps = 20.0 * culick(material) / (math.pi * RADIUS)
    bursting = Bursting((Puncture((0.0, RADIUS, 0.0), 0.0),), breakup=breakup)
    around = Surroundings(air=air)
    return Scene(
        "bubble", Sphere(RADIUS), e_count, l_per_e, material, around, bursting=bursting, fps=fps, frames=24, **more
    )


def liquid(simulation):
    """Liquid in the film, its rims, drops and the frame, kg."""
    line = simulation.diagnostics()
    held = line["mass"] + line["rim_mass"] + line["drop_mass"] + line["frame_mass"]
    return held + line.get("border_mass", 0.0)


def cut():
    """A puncture that cuts a film in two along y = 0."""
    return Puncture((-0.6 * WIDTH, 0.0, 0.0), 0.0, end=(0.6 * WIDTH, 0.0, 0.0))


def height(simulation):
    """Mean distance of rims from the middle of the film, m."""
    return float(np.abs(simulation.state.f.x.numpy()[:, 1]).mean())


def span(simulation):
    """Mean distance of rim points from the origin, m."""
    return float(np.linalg.norm(simulation.state.f.x.numpy(), axis=1).mean())


@pytest.mark.parametrize(
    ("thickness", "tension", "where"),
    [
        (300e-9, 0.0728, "hole"),
        (800e-9, 0.03, "hole"),
        (800e-9, 0.0728, "edge"),
        (300e-9, 0.03, "edge"),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in [(800e-9, 0.0728, "hole"), (300e-9, 0.03, "hole")]),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in [(300e-9, 0.0728, "edge"), (800e-9, 0.03, "edge")]),
    ],
)
def test_a_rim_runs_at_the_speed_of_taylor_and_culick(thickness, tension, where):
    """Constant over half of the film: 2 % between any two of six frames, and at each point of the rim."""
    material = Material(thickness=thickness, tension=tension)
    punctures = (Puncture((0.0, 0.0, 0.0), 0.0) if where == "hole" else cut(),)
    simulation, places = Simulation(film(material, punctures)), []
    measure = span if where == "hole" else height
    for _ in range(8):
        simulation.advance_frame()
        places.append(measure(simulation))
        speed = np.linalg.norm(simulation.state.f.u.numpy(), axis=1)
        assert speed == pytest.approx(culick(material), rel=0.02)
    np.testing.assert_allclose(np.diff(places) * simulation.scene.fps, culick(material), rtol=0.02)


def test_the_place_of_a_rim_converges():
    """A hole that opens from a point is at r = v t + r_0: the error falls with the spacing."""
    material, errors = Material(thickness=400e-9), []
    for e_count in (400, 900, 2025):
        simulation = Simulation(film(material, (Puncture((0.0, 0.0, 0.0), 0.0, 0.005),), e_count, 4))
        for _ in range(6):
            simulation.advance_frame()
        errors.append(abs(span(simulation) - 0.005 - culick(material) * simulation.time) / WIDTH)
    assert errors[0] < 5e-3
    assert errors[2] < 0.5 * errors[0]


def test_a_rim_slows_down_where_the_film_gets_thicker():
    """Across a step of thickness w^2 = v2^2 + (v1^2 - v2^2)(M1/M)^2, M1 the mass swept before it and M all."""
    thin, thick, step = 300e-9, 600e-9, 0.02
    material = Material(thickness=thin, surfactant=0.0)
    scene = film(
        material, (cut(),), 1600, 9, cross=0.5, thickness=lambda x: np.where(np.abs(x[:, 1]) < step, thin, thick)
    )
    simulation, seen = Simulation(scene), []
    for _ in range(9):
        simulation.advance_frame()
        y = height(simulation)
        middle = np.abs(simulation.state.f.x.numpy()[:, 0]) < 0.25 * WIDTH
        seen.append((y, np.linalg.norm(simulation.state.f.u.numpy()[middle], axis=1).mean()))
    v1, v2 = culick(material, thin), culick(material, thick)
    beyond = [(y, w) for y, w in seen if y > step + 1.5 * simulation.film.spacing]
    assert len(beyond) >= 3
    for y, w in beyond:
        before, whole = thin * step, thin * step + thick * (y - step)
        assert w == pytest.approx(math.sqrt(v2**2 + (v1**2 - v2**2) * (before / whole) ** 2), rel=0.03)


def test_the_momentum_of_a_rim_is_that_of_its_tension():
    """Half of a cut film: 2 sigma times the length of its edge times the time, 1 %; it starts at that of its liquid."""
    material = Material(thickness=400e-9)
    simulation = Simulation(film(material, (cut(),), l_per_e=16))
    sigma, seen = material.tension - material.rt * material.surfactant, []
    for _ in range(8):
        simulation.advance_frame()
        rim = simulation.state.f
        x = rim.x.numpy()
        part = (x[:, 1] > 0.0) & (np.abs(x[:, 0]) < 0.3 * WIDTH)
        length = part.sum() * np.ptp(x[part][:, 0]) / (part.sum() - 1)
        pull = (rim.mass.numpy() * rim.u.numpy()[:, 1])[part].sum() / length
        seen.append((simulation.time, pull))
    (began, first), (ended, last) = seen[1], seen[-1]
    assert last - first == pytest.approx(2.0 * sigma * (ended - began), rel=0.01)


def test_all_liquid_of_a_film_goes_to_its_frame():
    simulation = Simulation(film(Material(thickness=400e-9), (Puncture((0.01, 0.005, 0.0), 0.0),), frames=20))
    before = liquid(simulation)
    for _ in range(20):
        simulation.advance_frame()
        if not simulation.gone:
            assert liquid(simulation) == pytest.approx(before, rel=1e-5)
    line = simulation.diagnostics()
    assert simulation.gone and line["e_count"] == 0 and len(simulation.particles("l").points) == 0
    assert line["frame_mass"] + line["drop_mass"] == pytest.approx(before, rel=1e-5)


def test_what_a_frame_has_collected_before_stays_there():
    """A film under a thousand times its weight falls into its frame; then it is punctured."""
    scene = film(Material(thickness=400e-9), (), 400, 4)
    object.__setattr__(scene, "fps", 1000.0)
    object.__setattr__(scene, "surroundings", Surroundings(gravity=(0.0, -1000.0, 0.0)))
    object.__setattr__(scene, "bursting", Bursting((Puncture((0.0, 0.0, 0.0), 0.0025),), breakup=0.0))
    simulation = Simulation(scene)
    before = liquid(simulation)
    for _ in range(8):
        simulation.advance_frame()
        assert liquid(simulation) == pytest.approx(before, rel=1e-5)
    assert simulation.diagnostics()["border_mass"] > 0.01 * before


def test_a_rim_runs_around_a_bubble():
    """pi R/v from pole to pole where the shape stays: 3 %. All liquid is in drops then."""
    simulation, crossed = Simulation(bubble(2000, 4)), None
    before = liquid(simulation)
    start = simulation.film.spacing / RADIUS
    v = culick(simulation.scene.material)
    while not simulation.gone and simulation.frame < 24:
        simulation.advance_frame()
        y = simulation.state.f.x.numpy()[:, 1]
        if len(y) and simulation.frame <= 17:
            angle = np.arccos(y.mean() / RADIUS)
            assert angle == pytest.approx(start + v * simulation.time / RADIUS, rel=0.03)
            crossed = angle
    assert crossed > 2.5
    assert simulation.time == pytest.approx(math.pi * RADIUS / v, rel=0.06)  # a frame is 5 % of it
    assert simulation.diagnostics()["drop_mass"] == pytest.approx(before, rel=1e-5)


@pytest.mark.parametrize(("l_per_e", "air"), [(0, "none"), (4, "added_mass")])
def test_two_holes_meet(l_per_e, air):
    """Rims that meet are one from then on, and what they held there flies off in drops."""
    scene = bubble(700, l_per_e, 10.0, air)
    punctures = (Puncture((0.0, RADIUS, 0.0), 0.0), Puncture((RADIUS, 0.0, 0.0), 1e-3))
    object.__setattr__(scene, "bursting", Bursting(punctures, breakup=10.0))
    simulation, rims = Simulation(scene), []
    before = liquid(simulation)
    for _ in range(20):
        simulation.advance_frame()
        rims.append(simulation.diagnostics()["rims"])
        assert liquid(simulation) == pytest.approx(before, rel=1e-5)
    assert 2 in rims and rims[-1] == 0
    assert simulation.gone


def test_a_film_ruptures_where_it_is_thin():
    """By itself, at the place and not before."""
    scene = film(
        Material(thickness=400e-9, surfactant=0.0),
        (),
        thickness=lambda x: 400e-9 - 300e-9 * np.exp(-(((x - [0.02, 0.01, 0.0]) / 0.01) ** 2).sum(axis=1)),
    )
    whole = Simulation(scene)
    assert whole.burst is None
    object.__setattr__(scene, "bursting", Bursting(rupture_thickness=150e-9))
    simulation = Simulation(scene)
    simulation.advance_frame()
    assert np.linalg.norm(simulation.state.f.x.numpy().mean(axis=0) - [0.02, 0.01, 0.0]) < simulation.film.spacing


def test_drops_are_those_of_the_fastest_wave():
    """9.01 radii of the thread apart, of 1.89 radii; all sums are kept."""
    rng = np.random.default_rng(3)
    n, radius, length, density = 400, 5e-5, 0.3, 998.0
    part = length / n
    mass = np.full(n, density * math.pi * radius**2 * part)
    x = np.stack([(np.arange(n) + 0.5) * part, np.zeros(n), np.zeros(n)], axis=1)
    u = np.full((n, 3), 2.0)
    drops = Thread(x, u, mass, np.full(n, part), {"surfactant": 1e-3 * mass}).drops(density, 0.07, rng)
    count = length / (RAYLEIGH * radius)
    assert len(drops["mass"]) == pytest.approx(count, abs=0.5)
    size = np.cbrt(3.0 * drops["mass"] / (4.0 * math.pi * density))
    np.testing.assert_allclose(size, 1.891 * radius, rtol=0.01)
    assert drops["mass"].sum() == pytest.approx(mass.sum(), rel=1e-12)
    np.testing.assert_allclose(drops["mass"] @ drops["u"], mass @ u, rtol=1e-9)
    assert np.std(drops["u"]) == pytest.approx(0.5 * math.sqrt(0.07 / (density * radius)), rel=0.1)
    np.testing.assert_allclose(np.diff(drops["x"][:, 0])[1:-1], RAYLEIGH * radius, rtol=0.01)


def test_rims_keep_what_they_hold_while_points_come_and_go():
    """A ring whose points are twice too far apart, or twice too near: sums to rounding, points even and on the ring."""
    for count in (15, 200):
        angle = 2.0 * np.pi * np.arange(count) / count
        x = np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)
        arrays = {f"f.{name}": np.ones(count) for name in ("inertia", "mass", "surfactant", "growth", "limit")}
        arrays |= {"f.x": x, "f.u": x.copy(), "f.normal": np.tile([0.0, 0.0, 1.0], (count, 1)), "f.flow": 0.0 * x}
        arrays |= {"f.film": np.ones((count, 2)), "f.region": np.zeros(count), "f.other": np.full(count, -1)}
        arrays["f.after"], arrays["f.before"] = np.roll(np.arange(count), -1), np.roll(np.arange(count), 1)
        rims = Rims.of(arrays)
        rims.even(0.1, np.random.default_rng(0))
        rims.store(arrays)
        assert arrays["f.mass"].sum() == pytest.approx(count, rel=1e-12)
        r = np.linalg.norm(arrays["f.x"], axis=1)
        np.testing.assert_allclose(r, 1.0, atol=2e-3)
        np.testing.assert_allclose(np.linalg.norm(arrays["f.u"], axis=1), 1.0, atol=0.02)
        gap = np.linalg.norm(np.diff(arrays["f.x"], axis=0), axis=1)
        assert gap.max() < 0.42 and gap.min() > 0.03


def test_gas_leaves_by_the_hole_where_there_is_air():
    """The root of the pressure falls as C A sqrt(rho_air/2) p_atm/V asks, with the hole as its rim has it: 1 %."""
    material = Material(thickness=425e-9)
    bursting = Bursting((Puncture((0.0, RADIUS, 0.0), 0.0, 1e-3),), breakup=0.0)
    scene = Scene(
        "bubble", Sphere(RADIUS), 900, 0, material, Surroundings(air="added_mass"), bursting=bursting, fps=2e4
    )
    simulation = Simulation(scene)
    root, around = math.sqrt(simulation.state.gas.numpy()[0, 1]), scene.surroundings
    for _ in range(4):
        simulation.advance_frame()
        x = simulation.state.f.x.numpy().astype(np.float64)
        radius = np.linalg.norm(x - x.mean(axis=0), axis=1).mean()
        rate = 0.6 * np.pi * radius**2 * around.pressure / (4.0 / 3.0 * np.pi * RADIUS**3)
        root -= rate / math.sqrt(2.0 * around.air_density) * 5e-5
        assert math.sqrt(simulation.state.gas.numpy()[0, 1]) == pytest.approx(root, rel=0.01)


def test_drops_fall():
    """Without air freely, with it at the terminal speed of a sphere of 0.1 mm (Schiller and Naumann): 1 %."""
    radius, nu, rho = 5e-5, 1.81e-5 / 1.2, 998.0

    def excess(u):
        reynolds = 2.0 * radius * u / nu
        return 6.0 * math.pi * 1.2 * nu * radius * u * (1.0 + 0.15 * reynolds**0.687) - 4.19 * radius**3 * rho * 9.81

    low, high = 0.0, 1.0
    for _ in range(40):
        low, high = (low, 0.5 * (low + high)) if excess(0.5 * (low + high)) > 0.0 else (0.5 * (low + high), high)
    scene = film(Material(thickness=400e-9), (Puncture((0.0, 0.0, 0.0), 0.0),), e_count=400)
    for air, seconds, speed in (("none", 0.1, 0.981), ("added_mass", 0.5, low)):
        around = Surroundings(gravity=(0.0, -9.81, 0.0), air=air)
        object.__setattr__(scene, "surroundings", around)
        simulation = Simulation(scene)
        while not simulation.gone:
            simulation.advance_frame()
        drops = simulation.state.d
        drops.mass.fill_(4.19 * radius**3 * scene.material.density)
        drops.u.zero_()
        for _ in range(200):
            simulation.step(seconds / 200)
        assert drops.u.numpy()[:, 1] == pytest.approx(-speed, rel=0.01)


def test_bad_punctures_are_refused():
    for bad in ((0.0, 0.0), (0.0, float("nan"), 0.0)):
        with pytest.raises(InputError, match="puncture"):
            Puncture(bad, 0.0)
    with pytest.raises(InputError, match="time of a puncture must be at least 0 s"):
        Puncture((0.0, 0.0, 0.0), -1.0)
    for text in ("1,2,3", "1,2,3,4,5,6", "a,0,0,1"):
        with pytest.raises(InputError, match="--puncture must be x,y,z,t"):
            Puncture.parse(text)
    assert Puncture.parse("0.1,0,0,2e-3,0.01") == Puncture((0.1, 0.0, 0.0), 2e-3, 0.01)
    with pytest.raises(InputError, match="radius of a puncture must be at most"):
        Simulation(film(Material(), (Puncture((0.0, 0.0, 0.0), 0.0, 0.05),), e_count=400)).advance_frame()


def test_a_puncture_off_the_film_is_noticed_and_changes_nothing():
    scene = film(Material(), (Puncture((0.0, 0.0, 1.0), 0.0),), e_count=400)
    simulation = Simulation(scene)
    simulation.advance_frame()
    assert "puncture without effect" in simulation.notices.of_frame
    assert not simulation.film.features.holed


def test_a_cap_bursts():
    """A film that is held by a frame and bends: the rim runs along it to the frame."""
    material = Material(thickness=400e-9)
    scene = film(material, (Puncture((0.0, 1.0, 0.0), 0.0),), 600, 4, shape=Cap(0.05), cross=0.8, frames=24)
    object.__setattr__(scene, "bursting", Bursting((Puncture((0.0, 0.05, 0.0), 0.0),), breakup=0.0))
    simulation = Simulation(scene)
    before = liquid(simulation)
    while not simulation.gone and simulation.frame < 24:
        simulation.advance_frame()
        assert liquid(simulation) == pytest.approx(before, rel=1e-5)
    assert simulation.gone and simulation.diagnostics()["frame_mass"] > 0.9 * before


@pytest.mark.parametrize("time", [1e-10, 1e-3 + 1e-9, 1e-3 - 1e-11])
def test_a_puncture_may_come_right_after_another_moment(time):
    """At any time, however near to the start or to the end of a frame: the step up to it is short, and is taken."""
    scene = film(Material(), (Puncture((0.0, 0.0, 0.0), time),), e_count=400)
    object.__setattr__(scene, "fps", 1000.0)
    simulation = Simulation(scene)
    simulation.advance_frame()
    simulation.advance_frame()
    assert simulation.diagnostics()["rims"] == 1


def test_a_puncture_in_a_hole_makes_none():
    """Twice at the same place is one hole: the film there is gone. What is due with it is not put off."""
    places = [(0.0, 0.0, 0.0), (0.001, 0.0, 0.0), (0.0, 0.0, 1.0), (0.03, 0.03, 0.0)]
    simulation = Simulation(film(Material(), tuple(Puncture(place, 0.0) for place in places), e_count=400, cross=0.2))
    simulation._change_regions()
    assert simulation.diagnostics()["rims"] == 2 and not simulation.burst.pending
    simulation.advance_frame()
    assert simulation.diagnostics()["rims"] == 2


def test_a_cut_may_end_far_beyond_the_frame():
    """It is as long as the film: one to 1 km away as one that ends just beyond the frame."""
    rims = []
    for end in (0.2, 1e3):
        simulation = Simulation(film(Material(), (Puncture((0.0, 0.0, 0.0), 0.0, end=(end, 0.0, 0.0)),), e_count=400))
        simulation.advance_frame()
        rims.append(simulation.diagnostics()["rim_length"])
    assert rims[0] == pytest.approx(rims[1], rel=0.02)


def test_liquid_that_mixes_is_that_of_the_film_alone():
    """L that a rim has passed exchange nothing: their liquid is counted in the rim."""
    material, numerics = Material(thickness=400e-9), Numerics(mixing=1.0)
    punctures = (Puncture((0.0, 0.05, 0.0), 0.0),)
    scene = film(material, punctures, 400, 4, shape=Cap(0.05), cross=0.8, numerics=numerics)
    simulation = Simulation(scene)
    before = liquid(simulation)
    for _ in range(9):
        simulation.advance_frame()
        assert liquid(simulation) == pytest.approx(before, rel=1e-6)


def test_circulation_is_restored_in_a_bubble_with_a_hole():
    """It has neither gas nor a frame: the stream function is known up to a constant, as on a whole one."""
    simulation = Simulation(bubble(400, 4, numerics=Numerics(carrier="circulation")))
    for _ in range(4):
        simulation.advance_frame()  # raises where the solve does not end
    assert simulation.diagnostics()["rims"] == 1


def test_a_rim_is_not_pushed_back_by_an_elastic_film():
    """Before it surfactant gets so dense that no tension is left: nothing pulls then, and waves stand still."""
    material = Material(thickness=400e-9, surfactant=2.5e-5)
    scene = film(material, (Puncture((0.0, 0.05, 0.0), 0.0),), 400, 1, shape=Cap(0.05), cross=0.8)
    simulation = Simulation(scene)
    for _ in range(4):
        simulation.advance_frame()
    rim = simulation.state.f
    assert rim.film.numpy()[:, 0].max() > material.tension / (material.rt * material.surfactant)
    assert np.isfinite(rim.growth.numpy()).all()


def test_half_of_the_energy_of_a_torn_film_is_lost():
    """2 sigma times the hole becomes motion of the rim and loss, half each: 0.2 %, motion 1 %, as L are lumps."""
    material, lines, hole = Material(thickness=400e-9), [], []
    simulation = Simulation(film(material, (Puncture((0.0, 0.0, 0.0), 0.0),)))
    for _ in range(8):
        simulation.advance_frame()
        lines.append(simulation.diagnostics())
        hole.append(math.pi * span(simulation) ** 2)
    torn, lost, moving = (lines[-1][name] - lines[0][name] for name in ("torn_energy", "torn_loss", "rim_energy"))
    sigma = 2.0 * (material.tension - material.rt * material.surfactant)
    assert torn == pytest.approx(sigma * (hole[-1] - hole[0]), rel=2e-3)
    assert lost == pytest.approx(0.5 * torn, rel=2e-3)
    assert moving == pytest.approx(0.5 * torn, rel=1e-2)
    assert lines[-1]["drop_energy"] == 0.0


def test_a_bubble_that_is_torn_gives_all_its_energy():
    """2 sigma 4 pi R^2 within 1 %; half of it is lost, the other half flies off with the drops, within 2 %."""
    scene = bubble(breakup=20.0)
    simulation = Simulation(scene)
    while not simulation.gone:
        simulation.advance_frame()
    line, m = simulation.diagnostics(), scene.material
    whole = 2.0 * (m.tension - m.rt * m.surfactant) * 4.0 * math.pi * RADIUS**2
    assert line["torn_energy"] == pytest.approx(whole, rel=0.01)
    assert line["torn_loss"] == pytest.approx(0.5 * whole, rel=0.02)
    assert line["rim_energy"] + line["drop_energy"] == pytest.approx(0.5 * whole, rel=0.03)
