"""Stages and particles that scenes bring along: what they may be, when they run, and what becomes of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import warp as wp

from melp_warp import InputError, ParticleSet, Scene, Simulation, SimulationError, Sphere, Stage, load_scene
from melp_warp.features import Features
from melp_warp.numerics import Numerics
from melp_warp.stages.state import declared
from melp_warp.stepping.checkpoint import check_sum
from melp_warp.stepping.parts import CARRIERS, kernel_files, parts_of
from melp_warp.stepping.step import TABLE
from tests.physics.test_carried import at_once

BUBBLE = Scene("bubble", Sphere(0.03), 150, 2)
DUST = ParticleSet("Dust", np.zeros((5, 3)), 1e-3, {"u": np.ones((5, 3)), "age": np.arange(5)})


@wp.kernel(enable_backward=False)
def count(rows: wp.array(dtype=wp.int32)):
    """Count launches."""
    rows[0] = rows[0] + 1


class Counter(Stage):
    """Counts the steps."""

    name, after, remembers = (
        "counter",
        "advance_e",
        {"steps": (wp.int32, 1), "of_l": (wp.vec3, "l"), "turn": (wp.mat33, "e")},
    )

    def run(self):
        self.film.launch_one(count, [], [self.remembered("steps")])

    def check(self):
        if self.remembered("steps").numpy()[0] > 6:
            raise SimulationError("stage counter: seven are too many")


def steps_of(simulation):
    return int(simulation.state.remembered["counter.steps"].numpy()[0])


@pytest.mark.parametrize("after", [stage.name for stage in TABLE if stage.recorded])
def test_it_runs_once_a_step_wherever_it_is(device, after):
    """In the order of the table, on whole frames; its time is told."""
    simulation = Simulation(replace(BUBBLE, stages=[type("Other", (Counter,), {"after": after})]))
    for _ in range(3):
        simulation.step(1e-3)
    assert steps_of(simulation) == 3
    order = [stage.name for stage in simulation.stepper.stages]
    assert order.index("counter") == order.index(after) + 1
    assert simulation.stepper.wall["counter"] > 0.0


def test_what_it_remembers_goes_back_with_a_frame(device):
    """A frame that fails leaves no trace of it; the error names the stage."""
    simulation = Simulation(replace(BUBBLE, stages=[Counter], dt=1.0 / 240.0))
    simulation.advance_frame()
    assert steps_of(simulation) == 4
    with pytest.raises(SimulationError, match="seven are too many"):
        simulation.advance_frame()
    assert steps_of(simulation) == 4


def test_single_layers_and_foams(device):
    one = {"steps": (wp.int32, 1)}
    single = replace(BUBBLE, numerics=Numerics(layers=1))
    late, right = (type("Own", (Counter,), {"after": row, "remembers": one}) for row in ("e_to_l", "surfactant"))
    with pytest.raises(InputError, match="after of stage counter must be one of surfactant, membrane, advance_e"):
        Simulation(replace(single, stages=[late]))
    simulation = Simulation(replace(single, stages=[right]))
    simulation.step(1e-4)
    assert steps_of(simulation) == 1
    foam = replace(load_scene("double_bubble").scene(e_count=230, l_per_e=1), stages=[Counter], sets=[DUST])
    simulation = Simulation(foam)
    simulation.step(1e-3)
    assert steps_of(simulation) == 1
    assert simulation.state.remembered["counter.of_l"].shape[0] == simulation.film.n_l


def test_sets_outlive_changes_of_regions(device):
    """A bubble pops: dust stays as it is, what stages remember starts anew."""
    popping = at_once(load_scene("four_bubbles").scene(e_count=460, l_per_e=1, pop_time=0.01, gap=0.2))
    simulation = Simulation(replace(popping, stages=[type("Calm", (Counter,), {"check": Stage.check})], sets=[DUST]))
    regions = simulation.film.regions
    simulation.advance_frame()
    assert simulation.film.regions < regions
    assert simulation.state.sets["Dust"]["age"].numpy() == pytest.approx(np.arange(5))
    assert steps_of(simulation) < 10


def test_a_checkpoint_of_other_particles_is_of_another_scene(device, tmp_path):
    scene = replace(BUBBLE, stages=[Counter], sets=[DUST])
    Simulation(scene).save_checkpoint(tmp_path / "c.npz")
    check_sum(tmp_path / "c.npz")
    again = Simulation(scene, checkpoint=tmp_path / "c.npz")
    assert again.state.sets["Dust"]["u"].numpy() == pytest.approx(np.ones((5, 3)))
    for other in ({"sets": ()}, {"stages": ()}, {"sets": [replace(DUST, width=2e-3)]}):
        with pytest.raises(InputError, match="another scene"):
            Simulation(replace(scene, **other), checkpoint=tmp_path / "c.npz")


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ({"stages": [print]}, "classes derived from Stage"),
        ({"stages": [Counter, Counter]}, "each once"),
        ({"stages": [type("A", (Stage,), {"name": "membrane"})]}, "names of their own"),
        ({"stages": [type("A", (Stage,), {"name": "a", "after": "lunch"})]}, "after of stage a must be one of l_to_e"),
        ({"stages": [type("A", (Stage,), {"name": "a", "remembers": {"b": (wp.float32, "q")}})]}, "b of stage a"),
        ({"sets": [1]}, "sets must be ParticleSets"),
        ({"sets": [DUST, DUST]}, "each name once"),
    ],
)
def test_wrong_ones_are_refused(wrong, told):
    with pytest.raises(InputError, match=told):
        replace(BUBBLE, **wrong)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (("Film", np.zeros((2, 3)), 1.0), "name of a particle set"),
        (("Dust", np.zeros((2, 2)), 1.0), "x of Dust"),
        (("Dust", np.zeros((2, 3)), 0.0), "width of Dust"),
        (("Dust", np.zeros((2, 3)), 1.0, {"u": np.zeros((3, 3))}), "u of Dust"),
        (("Dust", np.full((2, 3), np.nan), 1.0), "x of Dust must be finite"),
    ],
)
def test_wrong_particles_are_refused(given, told):
    with pytest.raises(InputError, match=told):
        ParticleSet(*given)


def test_the_page_shows_the_table():
    """docs/stages.md has a row a stage: name, equations, needs, writes, velocity."""
    text = (Path(__file__).parents[2] / "docs" / "stages.md").read_text()
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line.startswith("| ")]
    own = [[s.name, s.equation, ", ".join(s.needs), ", ".join(s.writes), s.velocity] for s in TABLE]
    assert rows[1:] == own


@pytest.mark.parametrize("carrier", CARRIERS.values(), ids=lambda carrier: carrier.__name__)
def test_own_stages_have_the_form(carrier):
    """Each once, said what it does; its needs are parts that there are, what it writes is of the state."""
    names = [stage.name for stage in carrier.stages]
    assert len(set(names)) == len(names)
    parts, state = parts_of(Features.of(BUBBLE)), declared()
    for stage in carrier.stages:
        assert stage.__doc__ and set(stage.needs) <= set(parts) and set(stage.writes) <= set(state), stage
        assert stage.velocity or not any(name.startswith("e.") for name in stage.writes), stage


def test_a_stage_whose_needs_are_not_there_is_refused(device):
    needy = type("Needy", (Counter,), {"after": "membrane", "needs": ("tangential",), "remembers": {}})
    Simulation(replace(BUBBLE, stages=[needy]))
    with pytest.raises(InputError, match=r"needs of stage counter must be parts that there are here, got .'tangential"):
        Simulation(replace(BUBBLE, l_per_e=0, stages=[needy]))


@wp.kernel(enable_backward=False)
def spoil_e(u: wp.array(dtype=wp.vec3)):
    """Make a velocity infinite."""
    u[7] = wp.vec3(wp.inf)


class Spoiler(Stage):
    """Leaves a number that is not finite."""

    name, after, writes = "spoiler", "surfactant", ("e.u",)

    def run(self):
        self.film.launch_one(spoil_e, [], [self.state.e.u])


def test_what_a_stage_writes_is_looked_at(device):
    with pytest.raises(SimulationError, match="stage spoiler: E particle 7 is not finite"):
        Simulation(replace(BUBBLE, stages=[Spoiler])).advance_frame()


@pytest.mark.parametrize("name", ["oscillating_bubble", "giant_bubble", "leapfrog", "drainage", "double_bubble"])
def test_kernels_are_known_beforehand(device, name, monkeypatch):
    """What a run launches is in the files that its parts and stages declare, which are compiled side by side."""
    scene = load_scene(name).scene(e_count=500, frames=1)
    launched, plain = set(), wp.launch

    def launch(kernel, *args, **kwargs):
        launched.add(kernel.module.name)
        return plain(kernel, *args, **kwargs)

    monkeypatch.setattr(wp, "launch", launch)
    simulation = Simulation(scene)
    simulation.step(1e-4)
    prefix = "melp_warp.kernels."
    files = {module.removeprefix(prefix) for module in launched if module.startswith(prefix)}
    assert files and files <= set(kernel_files(simulation.film.features))


class Tally(Stage):
    """Counts its runs."""

    name, velocity, needs, writes = "tally", "the same", ("l_advance",), ("e.u",)

    def __init__(self, stepper):
        super().__init__(stepper)
        self.rows = self.film.zeros(1, wp.int32)

    def run(self):
        self.film.launch_one(count, [], [self.rows])

    def report(self):
        return {"tallied": int(self.rows.numpy()[0])}


def test_one_more_stage_is_a_class_and_a_line(device, monkeypatch):
    """In a carrier's list it runs, is timed, told and looked at; a film without its needs goes without it."""
    for name in ("none", "two_layers"):
        one_more = type("OneMore", (CARRIERS[name],), {"stages": (*CARRIERS[name].stages, Tally)})
        monkeypatch.setitem(CARRIERS, name, one_more)
    simulation = Simulation(replace(BUBBLE, dt=1.0 / 120.0))
    simulation.advance_frame()
    told = simulation.diagnostics()
    assert told["tallied"] == 2 and told["wall_ms"]["tally"] > 0.0
    assert "tally" not in Simulation(replace(BUBBLE, l_per_e=0)).stepper.wall
    with pytest.raises(InputError, match="names of their own"):
        replace(BUBBLE, stages=[type("Other", (Counter,), {"name": "tally"})])
