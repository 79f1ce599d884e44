"""Every scene script: its keys, what it builds, and how it is found."""

import dataclasses

import numpy as np
import pytest

from melp_warp.errors import InputError
from melp_warp.parameters import KEYS
from melp_warp.registry import load_scene, scene_names
from melp_warp.scene import Scene
from melp_warp.shapes import StarShaped, fibonacci_sphere

SCENES = ("drainage", "equilibrium", "giant_bubble", "oscillating_bubble", "taylor_vortices")
COMMON = "thickness tension surfactant density gravity pressure air viscosity drag e_count l_per_e seed".split()
OWN = {
    "drainage": ["width", "height", "tilt", "noise"],
    "equilibrium": ["radius", "noise"],
    "giant_bubble": ["radius", "noise"],
    "oscillating_bubble": ["radius", "mode", "amplitude"],
    "taylor_vortices": ["separation", "noise"],
}


def build(name, **changes):
    script = load_scene(name)
    return script.build(script.parameters.values(changes))


def other(key, value):
    """A value that `key` takes and that is not `value`."""
    if key.choices:
        return next(choice for choice in key.choices if choice != value)
    if value is None:
        return 1e-3
    if key.whole:
        return value + 1 if value < key.high else value - 1
    near = value * 0.9 if value else min(key.high, 1e-7)
    return near if key.low <= near <= key.high else value * 1.1


def all_fields(scene):
    """What a scene comes to, in numbers: its settings, and its shape and initial fields at fixed points."""
    points = scene.shape.sample(400).points
    found = {f.name: getattr(scene, f.name) for f in dataclasses.fields(scene) if f.name != "shape"}
    for name in ("thickness", "concentration", "velocity"):
        found[name] = None if found[name] is None else found[name](points).tobytes()
    return {**found, "points": points.tobytes()}


def test_these_are_the_scenes():
    assert scene_names() == sorted(SCENES)


@pytest.mark.parametrize("name", SCENES)
def test_describes_itself_and_has_its_keys(name):
    script = load_scene(name)
    assert script.name == name
    assert 20 < len(script.description) < 100
    assert set(COMMON + OWN[name]) <= set(script.parameters.defaults)
    assert all(script.parameters.keys[key] is KEYS[key] for key in script.parameters)


@pytest.mark.parametrize("name", SCENES)
def test_builds_sound_fields(name):
    scene = build(name)
    assert isinstance(scene, Scene)
    assert scene.name == name
    samples = scene.shape.sample(scene.e_count * max(1, scene.l_per_e))
    for field, columns in ((scene.thickness, ()), (scene.concentration, ()), (scene.velocity, (3,))):
        if field is not None:
            values = field(samples.points)
            assert values.shape == (len(samples.points), *columns)
            assert np.isfinite(values).all()
    if scene.thickness is not None:
        thickness = scene.thickness(samples.points)
        assert thickness.min() > 0.0
        assert thickness.mean() == pytest.approx(scene.material.thickness, rel=0.15)
    if scene.velocity is not None:
        flow = scene.velocity(samples.points)
        across = np.einsum("ij,ij->i", flow, samples.normals)
        assert np.abs(across).max() < 1e-6 * np.abs(flow).max()


@pytest.mark.parametrize("name", SCENES)
def test_every_key_can_be_set_and_changes_the_scene(name):
    script = load_scene(name)
    # scales of a noise that is off change nothing: turn it on
    base = {"noise": 0.2} if name == "drainage" else {}
    plain = all_fields(script.build(script.parameters.values(base)))
    for key, value in script.parameters.defaults.items():
        changed = other(script.parameters.keys[key], base.get(key, value))
        text = "auto" if changed is None else str(changed)
        values = script.parameters.values(base | script.parameters.parse([f"{key}={text}"]))
        if name == "oscillating_bubble" and key == "seed":
            continue  # nothing in the scene is random; the seed reaches the solver
        assert all_fields(script.build(values)) != plain, key


@pytest.mark.parametrize("name", SCENES)
def test_seed_repeats(name):
    assert all_fields(build(name, seed=3)) == all_fields(build(name, seed=3))


def test_giant_bubble_is_the_papers():
    scene = build("giant_bubble")
    samples = scene.shape.sample(20000)
    thickness = scene.thickness(samples.points) * 1e9
    assert 345 < thickness.min() < 365
    assert 485 < thickness.max() < 505
    radii = np.linalg.norm(samples.points, axis=1) / 0.1
    assert 0.7 < radii.min() < 0.85
    assert 1.12 < radii.max() < 1.3
    speed = np.linalg.norm(scene.velocity(samples.points), axis=1)
    assert np.sqrt(np.mean(speed**2)) == pytest.approx(0.1, rel=0.05)


@pytest.mark.parametrize("mode", [2, 3, 4])
def test_oscillating_bubble_keeps_the_volume_of_its_sphere(mode):
    shape = build("oscillating_bubble", mode=mode, amplitude=0.2).shape
    volume = 4.0 / 3.0 * np.pi * np.mean(shape.radii(fibonacci_sphere(30000)) ** 3)
    assert volume == pytest.approx(4.0 / 3.0 * np.pi * 0.05**3, rel=1e-6)
    directions = fibonacci_sphere(4000)
    legendre = np.polynomial.legendre.Legendre.basis(mode)(directions[:, 1])
    assert np.mean(shape.radii(directions) * legendre) * (2 * mode + 1) / 0.05 == pytest.approx(0.2, rel=0.1)


def test_equilibrium_holds_surfactant_in_proportion():
    scene = build("equilibrium")
    assert (scene.e_count, scene.e_count * scene.l_per_e) == (1050, 16800)
    points = scene.shape.sample(3000).points
    np.testing.assert_allclose(scene.concentration(points) / 1e-7, scene.thickness(points) / 400e-9, rtol=1e-12)
    assert scene.thickness(points).std() > 0.1 * 400e-9
    assert scene.frames / scene.fps == pytest.approx(5.0)


def test_taylor_vortices_have_the_published_vorticity():
    scene = build("taylor_vortices")
    x = np.stack(np.meshgrid(np.linspace(-1.2, 1.2, 41), np.linspace(-1.2, 1.2, 41)), axis=-1).reshape(-1, 2)
    x = np.column_stack([x, np.zeros(len(x))])
    along_x, along_y = 1e-5 * np.eye(3)[:2]
    dv_dx = (scene.velocity(x + along_x) - scene.velocity(x - along_x))[:, 1] / 2e-5
    du_dy = (scene.velocity(x + along_y) - scene.velocity(x - along_y))[:, 0] / 2e-5
    exact = np.zeros(len(x))
    for side in (-0.405, 0.405):
        s = ((x[:, 0] - side) ** 2 + x[:, 1] ** 2) / 0.3**2
        exact += (1.0 / 0.3) * (2.0 - s) * np.exp(0.5 * (1.0 - s))
    np.testing.assert_allclose(dv_dx - du_dy, exact, atol=1e-6 * np.abs(exact).max())


def test_drainage_starts_even():
    scene = build("drainage")
    points = scene.shape.sample(100).points
    np.testing.assert_array_equal(scene.thickness(points), 400e-9)


def test_a_scene_file_anywhere(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        '"""Mine."""\n'
        "from melp_warp.parameters import declare\n"
        "from melp_warp.shapes import Sphere\n"
        "PARAMETERS = declare(radius=0.02)\n"
        "def build(p):\n"
        "    return p.scene('mine', Sphere(p.radius))\n"
    )
    script = load_scene(str(path))
    assert (script.name, script.description) == ("mine", "Mine.")
    scene = script.build(script.parameters.values({"radius": 0.03}))
    assert isinstance(scene.shape, StarShaped)
    assert scene.shape.radius == 0.03


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1\n", "is not a scene"),
        ("def broken(:\n", "line 1, SyntaxError"),
        ("1 / 0\n", "ZeroDivisionError: division by zero"),
        ("import nothing_like_it\n", "ModuleNotFoundError"),
    ],
)
def test_a_file_that_is_no_scene(tmp_path, text, words):
    path = tmp_path / "bad.py"
    path.write_text(text)
    with pytest.raises(InputError, match=words):
        load_scene(str(path))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("giant_buble", "did you mean giant_bubble"),
        ("nonsense", "scenes are drainage, equilibrium"),
        ("no/such/file.py", "no such file"),
    ],
)
def test_unknown_scene(name, words):
    with pytest.raises(InputError, match=words):
        load_scene(name)
