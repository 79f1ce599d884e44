"""L that clump are merged and as many are split where they thin out: density, sums, numbers and bits."""

import numpy as np
import pytest

from melp_warp import Carried, load_scene
from melp_warp.errors import InputError
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Sphere
from melp_warp.simulation import Simulation

WARMTH = Carried("warmth", "K", start=lambda x: 300.0 + 100.0 * x[:, 0], mean=True)


def f64(array):
    return array.numpy().astype(np.float64)


def whirl(x):
    """An uneven flow, m/s."""
    return np.stack([0.2 * np.sin(40.0 * x[:, 2]), 0.0 * x[:, 0], 0.2 * np.cos(30.0 * x[:, 0])], axis=1)


def clumped(shape, resampling=1.4):
    """L of a film drawn together towards x > 0, by hand."""
    thick = lambda x: 4e-7 * (1.0 + 0.2 * np.sin(60.0 * x[:, 0]))  # noqa: E731
    scene = Scene(
        "film",
        shape,
        400,
        8,
        thickness=thick,
        velocity=whirl,
        numerics=Numerics(resampling=resampling, carrier="circulation"),
        carried=(WARMTH,),
    )
    simulation = Simulation(scene)
    x = simulation.state.l.x.numpy()
    radius = np.linalg.norm(x, axis=1, keepdims=True)
    near = np.exp(-(((x[:, 0] - 0.02) / 0.015) ** 2)) * (shape.closed or radius[:, 0] < 0.045)
    x[:, 0] += 0.8 * near * (0.02 - x[:, 0])
    if shape.closed:
        x *= radius / np.linalg.norm(x, axis=1, keepdims=True)
    simulation.state.l.x.assign(x)
    simulation.stepper.lists.rebuild_l()
    return simulation


def sums(simulation):
    """Of all L: liquid, surfactant, circulation, warmth, area and momentum; and of their sizes."""
    lag, density = simulation.state.l, simulation.scene.material.density
    mass = f64(lag.mass)
    held = [mass, f64(lag.surfactant), f64(lag.circulation), f64(simulation.state.carried["warmth"])]
    held += [mass / (density * f64(lag.eta)), *(mass[:, None] * f64(lag.u)).T]
    return np.sum(held, axis=1), np.sum(np.abs(held), axis=1)


@pytest.mark.parametrize("shape", [Disc(0.05), Sphere(0.05)])
def test_l_come_to_stand_as_evenly_as_asked_for(shape):
    """From beyond the factor to within it in a few calls; their number, what they hold and momentum stay."""
    simulation = clumped(shape)
    follow = simulation.resampling
    start, before, issued = follow.density(), sums(simulation), set(simulation.state.ids["l"].tolist())
    assert start.max() > 1.5
    count = 0
    while follow.follow():
        count += 1
        assert count < 20
    assert follow.density().max() <= 1.4
    assert follow.density().min() >= 1.0 / 1.4
    (total, _), (was, size) = sums(simulation), before
    assert np.all(np.abs(total - was) <= 1e-6 * size)
    ids = simulation.state.ids["l"]
    assert len(ids) == len(np.unique(ids)) == len(issued)
    new = set(ids.tolist()) - issued
    assert new
    assert min(new) > max(issued)
    simulation.advance_frame()
    assert np.isfinite(f64(simulation.state.l.x)).all()


def test_l_that_do_not_clump_keep_their_bits():
    """As long as nothing is beyond the factor a run with it is the run without."""
    script, runs = load_scene("giant_bubble"), []
    for resampling in (None, 3.0):
        values = {"e_count": 300, "l_per_e": 4, "resampling": resampling}
        simulation = Simulation(script.build(script.parameters.values(values)))
        assert (simulation.resampling is None) == (resampling is None)
        for _ in range(3):
            simulation.advance_frame()
        runs.append(simulation.state.numpy())
    assert all(np.array_equal(runs[0][name], runs[1][name]) for name in runs[0])


def test_the_same_bits_from_a_checkpoint(tmp_path):
    """A foam whose L are resampled in frames before and after the checkpoint."""
    script = load_scene("double_bubble")
    scene = script.build(script.parameters.values({"e_count": 250, "l_per_e": 4, "resampling": 1.3}))
    simulation, path = Simulation(scene), tmp_path / "checkpoint.npz"
    for frame in range(8):
        if frame == 4:
            first = simulation.state.course.issued["l"]
            simulation.save_checkpoint(path)
        simulation.advance_frame()
    assert 250 * 4 < first < simulation.state.course.issued["l"]
    again = Simulation(scene, checkpoint=path)
    for _ in range(4):
        again.advance_frame()
    one, two = simulation.state.numpy(), again.state.numpy()
    assert [name for name in one if not np.array_equal(one[name], two[name])] == []


def test_resampling_that_cannot_be_is_refused():
    with pytest.raises(InputError, match="resampling"):
        Numerics(resampling=1.1)


def test_the_energy_budget_goes_on():
    """What moved before L change is counted once: the rest is within 2 % of what it is without."""
    scene = load_scene("giant_bubble")
    rest = []
    for resampling in (None, 1.4):
        given = {"e_count": 300, "l_per_e": 4, "resampling": resampling}
        simulation = Simulation(scene.build(scene.parameters.values(given)))
        first = simulation.state.ids["l"].max()
        for _ in range(6):
            simulation.advance_frame()
        rest.append(simulation.ledger.share)
    assert simulation.state.ids["l"].max() > first
    assert rest[1] < rest[0] + 0.02


def test_it_can_be_turned_on_and_off_during_a_run():
    scene = load_scene("giant_bubble")
    simulation = Simulation(scene.build(scene.parameters.values({"e_count": 300, "l_per_e": 4})))
    simulation.change(resampling=1.3)
    for _ in range(4):
        simulation.advance_frame()
    changed = simulation.state.ids["l"].copy()
    assert changed.max() >= 1200
    simulation.change(resampling=None)
    for _ in range(2):
        simulation.advance_frame()
    np.testing.assert_array_equal(simulation.state.ids["l"], changed)
