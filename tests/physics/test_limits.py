"""The extremes: each ends as docs/limits.md says, and random scenes never go on with numbers that cannot be."""

import numpy as np
import pytest

from melp_warp.cluster import Cluster, Pop
from melp_warp.errors import InputError, SimulationError
from melp_warp.material import Surroundings
from melp_warp.numerics import Numerics
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Sphere, fibonacci_sphere
from melp_warp.simulation import Simulation
from melp_warp.study import limits
from melp_warp.study.validation import small_giant

CASES = [
    pytest.param(case, id=f"{case.topic}: {case.setting}", marks=[pytest.mark.slow] if case.slow else [])
    for case in limits.MATRIX
]


@pytest.mark.parametrize("case", CASES)
def test_extreme(case):
    """Each ends as it must; `judge` itself fails on a state that cannot be."""
    verdict = limits.judge(case)
    assert verdict.outcome == case.expected, verdict.detail


@pytest.mark.parametrize("seed", range(8))
def test_random_scene(seed):
    """Finite with mass, surfactant and gas kept, or refused or stopped with a message."""
    verdict = limits.run_random(seed)
    assert verdict.outcome != limits.WRONG, verdict.detail


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8, 300))
def test_more_random_scenes(seed):
    """The same."""
    verdict = limits.run_random(seed)
    assert verdict.outcome != limits.WRONG, verdict.detail


def test_random_scenes_run_and_are_refused():
    """The sweep is worth something: over its seeds every kind of film runs, and the ranges of keys are covered."""
    drawn = [limits.random_scene(seed) for seed in range(300)]
    assert len({name for name, _ in drawn}) >= 9
    thickness = [o["thickness"] for _, o in drawn if "thickness" in o]
    assert min(thickness) < 5e-9 and max(thickness) > 2e-5


def test_a_film_far_from_the_origin_is_the_same_film():
    """1 km away, spacing 1 mm: in every bit but the origin, the bubble at the origin, since positions are its own."""

    def state(centre):
        simulation = Simulation(Scene("far", Sphere(0.01, centre), 1000, 4, dt=1.0 / 60.0))
        for _ in range(3):
            simulation.advance_frame()
        return simulation.state.numpy()

    near, far = state((0.0, 0.0, 0.0)), state((1000.0, -500.0, 250.0))
    np.testing.assert_allclose(far["origin"], [1000.0, -500.0, 250.0], atol=1e-4)
    offset = far["origin"] - [1000.0, -500.0, 250.0]
    np.testing.assert_allclose(far["e.x"] + offset, near["e.x"], atol=2e-7)
    assert far["gas"][0, 1] == pytest.approx(near["gas"][0, 1], rel=1e-4)


def test_solves_that_stop_early_are_noticed():
    """Eight iterations where 20 are needed: noticed and logged in every frame; with those left by default, nothing."""
    for given, late in (({"max_iterations": 8}, True), ({}, False)):
        simulation = Simulation(small_giant(300, 2, **given))
        for _ in range(2):
            simulation.advance_frame()
        membrane = simulation.diagnostics()["solvers"]["membrane"]
        assert membrane["solves"] == 8  # load and unit pressure, each corrected once, in two steps
        assert (membrane["unsolved"] > 0) == late == (membrane["worst"] > 1e-4)
        assert simulation.notices.of_frame == ({"membrane not solved": membrane["worst"]} if late else {})
    assert not simulation.notices


def test_worthless_solves_stop_the_run():
    """One iteration leaves a residual above 1: the run stops at its last good frame, naming stage, frame and solver."""
    simulation = Simulation(small_giant(300, 2, max_iterations=1))
    good = simulation.state.numpy()
    with pytest.raises(SimulationError, match=r"stage membrane, solver membrane: .* of at most 1 .*, at .* in frame 1"):
        simulation.advance_frame()
    for name, array in simulation.state.numpy().items():
        assert np.array_equal(array, good[name]), name


@pytest.mark.parametrize("mode, e_count", [(12, 1148), (12, 1130), (4, 128), (4, 120)])
def test_waves_of_a_mode_need_five_spacings(mode, e_count):
    """2 pi R/n >= 5 sqrt(4 pi R^2/E) is E >= 25 n^2/pi: 1145.9 for n = 12, 127.3 for n = 4."""
    script = load_scene("oscillating_bubble")
    given = {"mode": mode, "e_count": e_count, "amplitude": 1e-3, "support": 2.0}
    scene = script.build(script.parameters.values(given))
    if e_count >= 25.0 * mode**2 / np.pi:
        assert not Simulation(scene).notices
        return
    with pytest.raises(InputError, match=rf"e_count must be at least 1\d+ for mode, .* got {e_count}"):
        Simulation(scene)


def rough(e_count, frequency):
    return small_giant(e_count, 0, displacement_octaves=1, displacement_frequency=frequency, displacement=0.03)


@pytest.mark.parametrize("e_count, frequency, seen", [(2000, 20.0, False), (2000, 40.0, True), (8000, 40.0, False)])
def test_an_unresolved_shape_is_noticed(e_count, frequency, seen):
    """Noise of 6.0, 2.7 and 5.4 spacings a cell: the volume is off by 0.04, 8 and 0.1 %, and the second is noticed."""
    simulation = Simulation(rough(e_count, frequency))
    shape = simulation.scene.shape
    volume = 4.0 / 3.0 * np.pi * np.mean(shape.radii(fibonacci_sphere(50000)) ** 3)
    assert (abs(simulation.diagnostics()["volume"] / volume - 1.0) > 2e-3) == seen
    assert (list(simulation.notices.of_frame) == ["shape unresolved"]) == seen


def test_gas_obeys_its_law_or_the_run_stops():
    """Waves of 2.1 spacings, half a radius high, lose over 5 % of the volume in a step: p V = n R T stops the run."""
    simulation = Simulation(
        Scene("spiky", limits.spiky(), 300, 0, numerics=Numerics(scheme="trapezoid"), fps=2500.0, dt=2e-4)
    )
    good = simulation.state.numpy()
    with pytest.raises(SimulationError, match=r"p V is -[\d.]+ % off n R T in region 0.* in frame 1"):
        simulation.advance_frame()
    assert np.array_equal(simulation.state.e.x.numpy(), good["e.x"])


def test_a_frame_that_leaps_is_done_again():
    """A dumbbell in steps of 1/60 s jumps too far; that frame is done again in smaller steps, from its start."""
    numerics = Numerics()
    simulation = Simulation(Scene("leap", limits.dumbbell(), 1000, 2, numerics=numerics, dt=1.0 / 60.0))
    seen = [simulation.diagnostics()]
    for frame in range(1, 4):
        simulation.advance_frame()
        assert simulation.time == pytest.approx(frame / 60.0)
        seen.append(simulation.diagnostics())
    assert max(now["substeps"] for now in seen) > 1
    assert seen[-1]["volume"] == pytest.approx(seen[0]["volume"], rel=1e-4)
    assert seen[-1]["surface_energy"] < seen[0]["surface_energy"]


def test_strays_on_a_film_at_rest():
    """One L off the film goes back to it, its liquid still there; many stop the run, though nothing moves."""
    simulation = Simulation(Scene("still", Disc(0.05), 300, 4, dt=1.0 / 60.0))
    mass = simulation.state.e.mass.numpy().sum()
    limits.stray(0.0)(simulation)
    simulation.advance_frame()
    assert np.linalg.norm(simulation.particles("l").points[0]) < 0.05
    assert simulation.state.e.mass.numpy().sum() == pytest.approx(mass, rel=1e-5)
    limits.stray(0.1)(simulation)
    with pytest.raises(SimulationError, match=r"stage neighbors: \d+ of \d+ L have no E within"):
        simulation.advance_frame()


def test_a_step_that_cfl_makes_too_small_stops_the_run():
    """More than 100,000 steps a frame are a run that never ends: it says so."""
    scene = Scene("fast", Disc(0.05), 300, 2, fps=0.01, dt=None)
    simulation = Simulation(scene)
    u = simulation.state.l.v.numpy()
    u[:] = [1e5, 0.0, 0.0]
    for array in (simulation.state.l.u, simulation.state.l.v):
        array.assign(u)
    with pytest.raises(SimulationError, match=r"more than 100,000 a frame|more than 0.3 of the film's radius"):
        simulation.advance_frame()
    limits.check_sound(simulation)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"dt": 1e-9}, "dt must be at least"),
        ({"surroundings": Surroundings(damping=1.0)}, "damping must be 0 for a single film"),
    ],
)
def test_refused_when_made(given, words):
    with pytest.raises(InputError, match=words):
        Scene("bad", Sphere(0.05), 600, **given)


@pytest.mark.parametrize("name", ["closed", "flat", "auto"])
def test_a_checkpoint_goes_on_bit_for_bit(name, tmp_path):
    """A run that wrote a checkpoint and one that loads it end in the same bits; the written state is left as it was."""
    scene = {
        "closed": lambda: small_giant(300, 4),
        "auto": lambda: small_giant(300, 4, dt=None, air="none"),
        "flat": lambda: Scene("flat", Disc(0.05), 300, 4, velocity=lambda x: np.cross([0.0, 20.0, 0.0], x)),
    }[name]()
    first = Simulation(scene)
    for _ in range(3):
        first.advance_frame()
    before = first.state.numpy()
    first.save_checkpoint(tmp_path / "c.npz")
    with np.load(tmp_path / "c.npz") as stored:
        for key, value in before.items():
            np.testing.assert_array_equal(stored[key], value, err_msg=key)
    second = Simulation(scene)
    second.load_checkpoint(tmp_path / "c.npz")
    for _ in range(3):
        first.advance_frame()
        second.advance_frame()
    one, two = first.state.numpy(), second.state.numpy()
    for key in one:
        np.testing.assert_array_equal(one[key], two[key], err_msg=key)
    assert first.frame == second.frame == 6


def test_a_file_that_is_no_checkpoint(tmp_path):
    simulation = Simulation(Scene("x", Sphere(0.05), 300, 0))
    (tmp_path / "c.npz").write_text("nothing")
    for path in (tmp_path / "c.npz", tmp_path / "none.npz"):
        with pytest.raises(InputError, match="cannot be read"):
            simulation.load_checkpoint(path)


def test_midpoint_rule_goes_over_to_backward_euler():
    """1/2 up to 8 spacings a step of the shortest wave, so that what it resolves is not damped; towards 1 beyond."""
    simulation = Simulation(Scene("x", Sphere(0.05), 600, 0, numerics=Numerics(scheme="trapezoid")))
    membrane, dx = simulation.stepper.membrane, simulation.film.spacing
    wave = np.sqrt(2.0 * 0.0728 / (997.0 * 400e-9))
    for cfl, theta in ((4.0, 0.5), (7.9, 0.5), (16.0, 0.75), (80.0, 0.95)):
        membrane.prepare(cfl * dx / wave)
        assert membrane.theta == pytest.approx(theta, abs=2e-3)
        assert membrane.theta_whole == 0.5


def two_bubbles(*events: Pop) -> Scene:
    numerics = Numerics(cfl=0.5)
    shape = Cluster(limits.meeting(0.2, e_count=400), events=events)
    return Scene("two", shape, 400, 2, numerics=numerics, surroundings=Surroundings(damping=20.0, air="added_mass"))


def test_a_checkpoint_of_a_foam_goes_on_bit_for_bit(tmp_path):
    """As for one film, over a pop."""
    scene = two_bubbles(Pop(0.06, 0))
    first, second = Simulation(scene), Simulation(scene)
    for _ in range(2):
        first.advance_frame()
    first.save_checkpoint(tmp_path / "c.npz")
    second.load_checkpoint(tmp_path / "c.npz")
    for _ in range(3):
        first.advance_frame()
        second.advance_frame()
    assert first.film.labels == second.film.labels == (1,)
    one, two = first.state.numpy(), second.state.numpy()
    for key in one:
        np.testing.assert_array_equal(one[key], two[key], err_msg=key)


def test_a_frame_that_fails_after_a_pop_goes_back_over_it(tmp_path, monkeypatch):
    """The state is then that of the last good frame, the popped bubble there again and its end still to come."""
    simulation = Simulation(two_bubbles(Pop(0.02, 0)))
    simulation.advance_frame()
    good, ids = simulation.state.numpy(), simulation.particles("e").ids
    step = simulation.step

    def fail_after_pop(dt):
        if len(simulation.film.labels) == 1:
            raise SimulationError("stage membrane: a fault")
        step(dt)

    monkeypatch.setattr(simulation, "step", fail_after_pop)
    with pytest.raises(SimulationError, match=r"a fault, at 0\.03333 s in frame 2"):
        simulation.advance_frame()
    assert simulation.film.labels == (0, 1)
    assert simulation.spilled == 0.0
    for key, value in simulation.state.numpy().items():
        np.testing.assert_array_equal(value, good[key], err_msg=key)
    np.testing.assert_array_equal(simulation.particles("e").ids, ids)
    simulation.save_checkpoint(tmp_path / "c.npz")
    fresh = Simulation(simulation.scene)
    fresh.load_checkpoint(tmp_path / "c.npz")
    fresh.advance_frame()
    assert fresh.film.labels == (1,)
    assert fresh.frame == 2


FAR_SCENE = """
from melp_warp.parameters import declare
from melp_warp.shapes import Sphere

PARAMETERS = declare(e_count=300, l_per_e=2, frames=2, dt=1.0 / 60.0, radius=0.01)


def build(p):
    return p.scene("far", Sphere(p.radius, (1000.0, 0.0, 0.25)))
"""


def test_a_cache_far_from_the_origin(tmp_path):
    """Points are the film's own, the prims are moved there in float64, the cache is sound, and one file too."""
    from melp_warp import cli
    from melp_warp.usd.check import check_cache
    from melp_warp.usd.forms import flatten
    from melp_warp.usd.layers import open_layer, origin_of
    from melp_warp.usd.reading import read_frame
    from melp_warp.usd.schema import frame_path

    path, out = tmp_path / "far.py", tmp_path / "out"
    path.write_text(FAR_SCENE)
    assert cli.main(["run", str(path), "--quiet", "--export", "both", "--out", str(out)]) == 0
    assert check_cache(out) == []
    for prim in ("Film", "FilmE"):
        frame = read_frame(out, 2, prim)
        np.testing.assert_allclose(frame.origin, (1000.0, 0.0, 0.25), atol=1e-4)
        assert np.abs(frame.points).max() < 0.0101
        middle = frame.points.mean(axis=0, dtype=np.float64) + frame.origin
        np.testing.assert_allclose(middle, (1000.0, 0.0, 0.25), atol=1e-4)
    flat = open_layer(flatten(out, tmp_path / "one.usdc"))
    assert origin_of(flat, "Film") == read_frame(out, 0).origin
    # a frame that says another place than the root is found
    layer = open_layer(frame_path(out, 1))
    layer.GetAttributeAtPath("/World/Film.xformOp:translate").default = (1.0, 2.0, 3.0)
    layer.Export(str(frame_path(out, 1)))
    assert any("origin" in problem for problem in check_cache(out))


def test_a_run_that_cannot_go_on_leaves_a_checkpoint_that_loads(tmp_path, capsys):
    """The explicit scheme blows up: exit code 1, one line, the last good state on disk, ready to go on."""
    from melp_warp import cli

    out = tmp_path / "out"
    settings = ["e_count=300", "l_per_e=2", "swirl=1.0", "scheme=explicit"]
    assert cli.main(["run", "giant_bubble", "--quiet", "--frames", "5", "--out", str(out), "--set", *settings]) == 1
    assert "checkpoint.npz" in capsys.readouterr().err
    simulation = Simulation(small_giant(300, 2, swirl=1.0))
    simulation.load_checkpoint(out / "checkpoint.npz", changed=True)
    limits.check_sound(simulation)
    simulation.advance_frame()
    limits.check_sound(simulation)


@pytest.mark.parametrize("key", ["scheme", "curvature", "lift"])
def test_a_foam_offers_no_key_that_it_ignores(key):
    from melp_warp.registry import load_scene

    parameters = load_scene("double_bubble").parameters
    assert key not in parameters.keys
    with pytest.raises(InputError, match=f"unknown key '{key}'"):
        parameters.parse([f"{key}=1"])


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"numerics": Numerics(scheme="explicit")}, "scheme must be backward_euler for a foam"),
        ({"numerics": Numerics(curvature="sph")}, "curvature must be left at mls for a foam"),
        ({"surroundings": Surroundings(lift=1.0)}, "lift must be 0 for a foam"),
    ],
)
def test_a_foam_refuses_what_it_ignores(given, words):
    with pytest.raises(InputError, match=words):
        Scene("foam", Cluster(limits.meeting(0.0)), 600, **given)
