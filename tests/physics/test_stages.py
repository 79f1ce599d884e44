"""Stages and particles that scenes bring along: what they may be, when they run, and what becomes of them."""

from dataclasses import replace

import numpy as np
import pytest
import warp as wp

from melp_warp import InputError, ParticleSet, Scene, Simulation, SimulationError, Sphere, Stage, load_scene
from melp_warp.numerics import Numerics
from melp_warp.stepping.checkpoint import check_sum
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
