"""What scenes declare that L carry: it goes where surfactant goes, and its sum stays."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from melp_warp import Carried, InputError, Scene, Simulation, Sphere, cli, load_scene, read_frame
from melp_warp.measure import measure_cache
from melp_warp.stepping.parts import kernel_files
from melp_warp.usd import apart
from melp_warp.usd.check import check_cache
from melp_warp.usd.reading import read_mesh, read_whole

TWIN = Carried("twin", "mol/m^2", start=1e-7)
WARMTH = Carried("warmth", "K", start=300.0, mean=True)
DYE = Carried("dye", "kg/m^2", start=lambda x: np.where(x.sum(axis=1) > 0.0, 1e-6, 0.0))


def at_once(made):
    """The scene with films that pop and merge at once, not by rims."""
    events = [replace(event, delete=True) for event in getattr(made.shape, "events", ())]
    return replace(made, shape=replace(made.shape, events=tuple(events))) if events else made


def scene(name, **numbers):
    made = load_scene(name).scene(**{"e_count": 250, "l_per_e": 3, **numbers})
    return replace(at_once(made), carried=(TWIN, WARMTH, DYE))


def after(made, frames):
    simulation = Simulation(made)
    for _ in range(frames):
        simulation.advance_frame()
    return simulation


SCENES = {
    "closed": lambda: scene("giant_bubble", e_count=300),
    "rim": lambda: scene("drainage", surfactant=1e-7),
    "mixing": lambda: scene("stirred_disc", mixing=1.0),
    "exchange": lambda: scene("double_bubble", exchange=20.0, gap=0.2),
    "merge": lambda: scene("four_bubbles", e_count=460, merge_time=0.02, pop_time=10.0, gap=0.2),
}


@pytest.mark.parametrize("name", SCENES)
def test_it_goes_where_surfactant_goes(device, name):
    """What starts as the surfactant stays it, L by L, to rounding; a mean that is even stays even; sums stay."""
    made = SCENES[name]()
    start = Simulation(made)
    before = start.diagnostics()["carried"]
    simulation = after(made, 4)
    state, told = simulation.state, simulation.diagnostics()
    held = state.l.surfactant.numpy() * (1e-7 / made.material.surfactant)
    assert state.carried["twin"].numpy() == pytest.approx(held, rel=1e-4, abs=float(1e-5 * held.mean()))
    for which in ("l", "e"):
        frame = simulation.particles(which)
        assert frame.carried["warmth"] == pytest.approx(300.0, rel=1e-4)
        assert frame.carried["dye"].min() >= 0.0
    for one, total in before.items():
        assert told["carried"][one] == pytest.approx(total, rel=1e-5)
    if name == "mixing":
        kept = Simulation(replace(made, numerics=replace(made.numerics, mixing=0.0)))
        assert not np.array_equal(state.carried["dye"].numpy(), kept.state.carried["dye"].numpy())


def test_a_rim_keeps_what_it_collects(device):
    """Without surfactant all liquid runs into the border, and what it carried with it."""
    made = scene("drainage", surfactant=0.0, frames=20)
    simulation = after(made, 12)
    gone = simulation.state.l.mass.numpy() == 0.0
    assert gone.any()
    assert np.all(simulation.state.carried["dye"].numpy()[gone] == 0.0)
    collected = simulation.state.carried["warmth_rim"].numpy().sum() / simulation.state.border.numpy()[0]
    assert collected == pytest.approx(300.0, rel=1e-4)


def test_what_pops_takes_its_own_along(device):
    """What is left is in proportion to the liquid that is left."""
    made = scene("four_bubbles", e_count=460, merge_time=10.0, pop_time=0.02, gap=0.2)
    start = Simulation(made).diagnostics()
    told = after(made, 3).diagnostics()
    assert told["mass"] < 0.99 * start["mass"]
    assert told["carried"]["warmth"] == pytest.approx(300.0 * told["mass"], rel=1e-5)


def test_the_rest_keeps_its_bits(device):
    """L carry more, and move as if they did not; without a declaration there is no array and no stage."""
    made = scene("double_bubble", exchange=20.0, gap=0.2)
    with_more, without = after(made, 3), after(replace(made, carried=()), 3)
    for name, array in without.state.numpy().items():
        assert np.array_equal(array, with_more.state.numpy()[name]), name
    assert without.stepper.carriage is None and without.state.carried == {}
    assert "carried" not in without.diagnostics() and "carried" not in kernel_files(without.film.features)


def test_what_e_gain_goes_to_l(device):
    """`give` hands out all of it: heat that E take up, say."""
    simulation = Simulation(scene("giant_bubble", e_count=300))
    carriage = simulation.stepper.carriage
    simulation.step(1e-3)
    before, gain = carriage.total("warmth"), simulation.film.zeros(simulation.film.n_e)
    gain.fill_(1e-6)
    simulation.stepper.transfer.gather()
    carriage.give("warmth", gain)
    assert carriage.total("warmth") - before == pytest.approx(1e-6 * simulation.film.n_e, rel=1e-3)


def test_a_run_goes_on(device, tmp_path):
    made = scene("giant_bubble", e_count=300)
    simulation = after(made, 1)
    simulation.save_checkpoint(tmp_path / "c.npz")
    simulation.advance_frame()
    again = Simulation(made, checkpoint=tmp_path / "c.npz")
    again.advance_frame()
    for name, array in simulation.state.numpy().items():
        assert np.array_equal(array, again.state.numpy()[name]), name
    with pytest.raises(InputError, match=r"carried\.0"):
        Simulation(replace(made, carried=()), checkpoint=tmp_path / "c.npz")


def test_it_is_written(device, tmp_path):
    """As a primvar with its unit, sound for the checker, and read back."""
    page = tmp_path / "dyed.py"
    page.write_text(
        "from melp_warp import Carried, Sphere, declare\n"
        "PARAMETERS = declare(radius=0.03, e_count=200, l_per_e=2, frames=1)\n"
        "def build(p):\n"
        "    dye = Carried('dye', 'kg/m^2', lambda x: 1.0 + 10.0 * x[:, 0])\n"
        "    return p.scene('dyed', Sphere(p.radius), carried=[dye])\n"
    )
    out = tmp_path / "out"
    assert cli.main(["run", str(page), "--out", str(out), "--quiet", "--export", "both", "--mesh"]) == 0
    assert check_cache(out) == []
    assert 'string dye = "kg/m^2"' in (out / "film.usda").read_text()
    for prim in ("Film", "FilmE"):
        frame = read_frame(out, 1, prim)
        assert frame.carried["dye"] == pytest.approx(1.0 + 10.0 * frame.points[:, 0], abs=0.03)
    assert cli.main(["run", str(page), "--out", str(out), "--quiet", "--resume", "--frames", "2"]) == 0
    assert cli.main(["mesh", str(out)]) == 0
    assert check_cache(out) == []


@pytest.mark.parametrize(
    ("declared", "told"),
    [
        ({"name": "mass", "unit": "kg"}, "must be a name that is not one of"),
        ({"name": "a b", "unit": "kg"}, "must be a name"),
        ({"name": "dye_rim", "unit": "kg"}, "must be a name"),
        ({"name": "dye", "unit": 1}, "unit of dye must be text"),
        ({"name": "dye", "unit": "kg", "start": float("nan")}, "start of dye must be a number"),
        ({"name": "dye", "unit": "kg", "start": "red"}, "start of dye must be a number"),
    ],
)
def test_wrong_declarations_are_refused(declared, told):
    with pytest.raises(InputError, match=told):
        Carried(**declared)


def test_scenes_that_carry_nothing_are_refused(device):
    bubble = Scene("bubble", Sphere(0.03), 200, 2)
    for wrong in ({"carried": (DYE, DYE)}, {"carried": (DYE,), "l_per_e": 0}, {"carried": ("dye",)}):
        with pytest.raises(InputError, match="carried must be"):
            replace(bubble, **wrong)
    with pytest.raises(InputError, match="start of dye"):
        Simulation(replace(bubble, carried=[Carried("dye", "-", lambda x: x)]))


def torn(name, **numbers):
    """A scene whose films burst by rims, with what L carry besides."""
    made = load_scene(name).scene(**numbers)
    return replace(made, carried=(TWIN, WARMTH, DYE))


TORN = {
    "film": (lambda: torn("film_burst", e_count=300, l_per_e=4, breakup=0.5, slow_motion=60.0), 12),
    "bubble": (lambda: torn("giant_bubble", e_count=300, l_per_e=4, puncture_time=0.0), 3),
    "foam": (lambda: torn("four_bubbles", e_count=460, l_per_e=2, merge_time=10.0, pop_time=0.0, gap=0.2), 6),
}


def held_by_all(state, name):
    """What film, rims and drops hold of "mass", "surfactant" or something declared; three numbers."""
    there = state.l.behind.numpy() == 0
    held = state.carried.get(name) if name in state.carried else getattr(state.l, name)
    beads = [block.more[name] if name in block.more else getattr(block, name) for block in (state.f, state.d)]
    return np.array([held.numpy()[there].sum(dtype=np.float64), *(b.numpy().sum(dtype=np.float64) for b in beads)])


@pytest.mark.parametrize("name", TORN)
def test_rims_sweep_it_up_and_drops_take_it(device, name):
    """Film, rims and drops hold of it what they hold of surfactant or liquid; the sum stays to rounding."""
    build, frames = TORN[name]
    made = build()
    simulation = Simulation(made)
    before, moved = simulation.diagnostics()["carried"], 0
    for _ in range(frames):
        simulation.advance_frame()
        told, state = simulation.diagnostics(), simulation.state
        left = told.get("carried_left", dict.fromkeys(before, 0.0))
        for one, total in before.items():
            assert told["carried"][one] + left[one] == pytest.approx(total, rel=2e-6), one
        mass, amount, twin, warmth = (held_by_all(state, n) for n in ("mass", "surfactant", "twin", "warmth"))
        moved = max(moved, mass[1:].sum() / mass.sum())
        assert warmth == pytest.approx(300.0 * mass, rel=1e-4, abs=1e-9 * warmth.sum())
        scale = 1e-7 / made.material.surfactant
        assert twin == pytest.approx(scale * amount, rel=1e-4, abs=1e-6 * twin.sum())
    assert moved > 0.05


def test_the_rest_of_what_bursts_keeps_its_bits(device):
    made = TORN["film"][0]()
    with_more, without = after(made, 4), after(replace(made, carried=()), 4)
    for name, array in without.state.numpy().items():
        assert np.array_equal(array, with_more.state.numpy()[name]), name
    assert without.state.f.more == {} and without.state.course.left == {}


def test_a_torn_run_goes_on(device, tmp_path):
    """From a checkpoint, and back from a frame that fails, with what rims and drops hold."""
    made = TORN["film"][0]()
    simulation = after(made, 3)
    simulation.save_checkpoint(tmp_path / "c.npz")
    simulation.advance_frame()
    again = Simulation(made, checkpoint=tmp_path / "c.npz")
    again.step_towards(again.time + 1e-3)
    again.back()
    again.advance_frame()
    for name, array in simulation.state.numpy().items():
        assert np.array_equal(array, again.state.numpy()[name]), name


def test_it_is_measured_meshed_and_shown(device, tmp_path, capsys):
    """Meshes have it, by name and in between what the L have; measure adds it up; a picture shows where it is."""
    page, out = tmp_path / "dyed.py", tmp_path / "out"
    page.write_text(
        "from melp_warp import Carried, Sphere, declare\n"
        "PARAMETERS = declare(radius=0.03, e_count=200, l_per_e=4, frames=0)\n"
        "def build(p):\n"
        "    dye = Carried('dye', 'kg/m^2', lambda x: 1.0 + 10.0 * x[:, 0])\n"
        "    return p.scene('dyed', Sphere(p.radius), carried=[dye])\n"
    )
    assert cli.main(["run", str(page), "--out", str(out), "--quiet", "--export", "both", "--mesh"]) == 0
    mesh = read_mesh(out, 0)
    assert mesh.carried["dye"] == pytest.approx(1.0 + 10.0 * mesh.points[:, 0], abs=0.04)
    assert apart.read_mesh(out, 0).carried["dye"] == pytest.approx(mesh.carried["dye"])
    found = measure_cache(out).carried[0]
    assert (found.name, found.unit, found.region) == ("dye", "kg/m^2", 0)
    assert found.total == pytest.approx(4.0 * np.pi * 0.03**2, rel=0.02)
    assert found.mean == pytest.approx(1.0, abs=0.01) and found.most == pytest.approx(1.3, abs=0.04)
    capsys.readouterr()
    picture = tmp_path / "dye.png"
    shot = ["preview", str(out), "--show", "dye", "--size", "64", "--samples", "1", "--out", str(picture)]
    assert cli.main([*shot, "--from", "0,0,1"]) == 0
    assert "dye: dark blue is" in capsys.readouterr().out
    pixels = np.asarray(Image.open(picture)).astype(int)
    left, middle, right = (pixels[32, column] for column in (14, 32, 49))
    assert left[0] < middle[0] < right[0] and right[2] < right[0]
    assert cli.main([*shot[:2], "--show", "salt"]) == 2
    assert "--show must be one of dye" in capsys.readouterr().err
    assert cli.main(["mesh", str(out), "--whole"]) == 0
    whole = read_whole(out, 0)
    at = whole.points[whole.faces.reshape(-1)]
    assert whole.carried["dye"] == pytest.approx(1.0 + 10.0 * at[:, 0], abs=0.04)
    assert check_cache(out) == []
