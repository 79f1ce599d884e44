"""Numbers that change between frames: from Python, `Simulation.change`."""

import numpy as np
import pytest

import melp_warp
from melp_warp import InputError, Scene, Simulation, Sphere, Surroundings

DOWN = (0.0, -9.81, 0.0)


def falling():
    """A bubble that falls in vacuo."""
    return Simulation(Scene("falling", Sphere(0.05), 300, surroundings=Surroundings(gravity=DOWN), dt=1.0 / 60.0))


def test_the_same_numbers_change_nothing():
    """To the bit: what the stages keep follows from the state."""
    plain, changed = falling(), falling()
    for _ in range(3):
        plain.advance_frame()
        changed.change(gravity=DOWN, dt=1.0 / 60.0, tension=plain.scene.material.tension)
        changed.advance_frame()
    one, two = plain.state.numpy(), changed.state.numpy()
    assert all(np.array_equal(one[key], two[key]) for key in one)


def test_another_gravity_acts_from_the_next_frame_on():
    """A third of it is normal to the sphere, on average; E have that part alone."""
    simulation = falling()
    for gravity in (DOWN, (1.62, 0.0, 0.0)):
        simulation.change(gravity=gravity)
        before = simulation.state.e.u.numpy().mean(axis=0)
        simulation.advance_frame()
        gained = 60.0 * (simulation.state.e.u.numpy().mean(axis=0) - before)
        np.testing.assert_allclose(gained, np.array(gravity) / 3.0, atol=2e-3 * np.linalg.norm(gravity))
    assert simulation.scene.surroundings.gravity == (1.62, 0.0, 0.0)


@pytest.mark.parametrize(
    ("numbers", "words"),
    [
        ({"thickness": 1e-6}, "a number that changes during a run must be one of affinity, .*, got 'thickness'"),
        ({"wings": 2}, "got 'wings'"),
        ({"drag": -1.0}, "drag must be a number from 0"),
        ({"dt": 1e-9}, "dt must be at least"),
        ({"air": "added_mass"}, "air cannot change so during a run, which was begun with other parts: .*'air'"),
        ({"gravity": (0.0, -1.0, 0.0), "cfl": 100.0}, "cfl must be a number from 0.01 to 10 spacings, got 100"),
    ],
)
def test_what_cannot_change_says_so_and_changes_nothing(numbers, words):
    simulation = falling()
    scene, stepper = simulation.scene, simulation.stepper
    with pytest.raises(InputError, match=words):
        simulation.change(**numbers)
    assert simulation.scene is scene and simulation.stepper is stepper


def test_a_scene_cannot_be_replaced():
    simulation = falling()
    with pytest.raises(InputError, match="a scene cannot be replaced during a run"):
        simulation.scene = simulation.scene


def test_a_changed_run_goes_on_from_a_checkpoint(tmp_path):
    simulation = falling()
    simulation.change(gravity=(1.62, 0.0, 0.0))
    simulation.advance_frame()
    simulation.save_checkpoint(tmp_path / "c.npz")
    later = Simulation(simulation.scene, checkpoint=tmp_path / "c.npz")
    for one in (simulation, later):
        one.advance_frame()
    one, two = simulation.state.numpy(), later.state.numpy()
    assert all(np.array_equal(one[key], two[key]) for key in one)


def test_whatever_is_exported_is_there():
    for name in melp_warp.__all__:
        assert getattr(melp_warp, name).__name__ == name
    with pytest.raises(AttributeError, match="melp_warp has no 'nothing'"):
        _ = melp_warp.nothing
