"""Every scene script: its keys, what it builds, and how it is found."""

import dataclasses

import numpy as np
import pytest

from melp_warp.cluster import Cluster, Merge, e_spacing
from melp_warp.errors import InputError
from melp_warp.parameters import KEYS
from melp_warp.registry import load_scene, scene_names
from melp_warp.scene import Scene
from melp_warp.shapes import StarShaped, fibonacci_sphere

FOAMS = (
    *("cluster", "double_bubble", "foam_mountain", "foam_pops", "four_bubbles"),
    *("quadruple_bubble", "size_ratio", "triple_bubble"),
)
VORTICES = ("deforming_rectangle_2m", "giant_bubble_vortices", "leapfrog", "stirred_disc", "turbulent_film")
BURSTS = ("burst_pair", "film_burst")
SCENES = (
    *FOAMS,
    *VORTICES,
    *BURSTS,
    "drainage",
    "equilibrium",
    "giant_bubble",
    "oscillating_bubble",
    "taylor_vortices",
    "inflation",
)
COMMON = "thickness tension surfactant density gravity pressure air viscosity drag e_count l_per_e seed".split()
OWN = {
    "cluster": ["radius_low", "radius_high", "offset", "gap", "approach_speed", "merge_time"],
    "double_bubble": ["radius_1", "radius_2", "thickness_1", "thickness_2", "gap", "approach_speed", "exchange"],
    "foam_mountain": ["bubbles", "radius_low", "radius_high", "container", "tap_height", "interval", "speed"],
    "foam_pops": ["radius_low", "radius_high", "gap", "pop_time", "pop_interval", "pops", "breakup"],
    "four_bubbles": ["radius", "gap", "approach_speed", "tension_spread", "merge_time", "pop_time"],
    "quadruple_bubble": ["radius", "gap", "approach_speed"],
    "size_ratio": ["radius_1", "ratio", "gap", "approach_speed"],
    "triple_bubble": ["radius", "gap", "approach_speed"],
    "drainage": ["width", "height", "tilt", "noise"],
    "equilibrium": ["radius", "noise"],
    "burst_pair": ["width", "height", "separation", "hole", "puncture_time", "breakup", "slow_motion"],
    "inflation": ["radius", "growth", "growth_time", "noise"],
    "film_burst": ["width", "hole", "puncture_time", "breakup", "slow_motion", "rupture_thickness"],
    "giant_bubble": ["radius", "noise", "puncture_time"],
    "oscillating_bubble": ["radius", "mode", "amplitude"],
    "taylor_vortices": ["separation", "noise"],
    "leapfrog": ["core", "circulation", "spacing_inner", "spacing_outer"],
    "turbulent_film": ["width", "height", "whirls", "swirl"],
    "stirred_disc": ["radius", "swirl"],
    "deforming_rectangle_2m": ["width", "height", "contrast", "swing"],
    "giant_bubble_vortices": ["radius", "pairs", "core", "circulation"],
}


def build(name, **changes):
    script = load_scene(name)
    return script.build(script.parameters.values(changes))


def other(key, value):
    """A value that `key` takes and that is not `value`."""
    if key.choices:
        return next(choice for choice in key.choices if choice != value)
    if value is None:
        return 7 if key.whole else max(key.low, 1e-3)
    if key.whole:
        return value + 1 if value < key.high else value - 1
    near = value * 0.9 if value else min(key.high, 1e-7)
    return near if key.low <= near <= key.high else value * 1.1


def all_fields(scene):
    """What a scene comes to, in numbers: its settings, and its shape and initial fields at fixed points."""
    points = scene.shape.sample(400).points
    found = {f.name: getattr(scene, f.name) for f in dataclasses.fields(scene) if f.name != "shape"}
    found["air_model"] = type(found["air_model"])  # which has no numbers
    if isinstance(scene.shape, Cluster):
        found["cluster"] = scene.shape
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
    shared = [key for key in script.parameters if key in KEYS]
    assert all(script.parameters.keys[key] is KEYS[key] for key in shared)
    assert set(script.parameters) <= {*KEYS, *OWN[name], "tap_spacing"}


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
    if scene.velocity is not None and name != "deforming_rectangle_2m":  # which swings out of its plane
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
        if name in BURSTS and key == "layers":
            continue  # a single layer does not burst
        if key == "show" and script.parameters.defaults["carrier"] != "circulation":
            continue  # there is nothing to show
        changed = other(script.parameters.keys[key], base.get(key, value))
        text = "auto" if changed is None else str(changed)
        values = script.parameters.values(base | script.parameters.parse([f"{key}={text}"]))
        assert all_fields(script.build(values)) != plain, key


@pytest.mark.parametrize("name", SCENES)
def test_seed_repeats(name):
    assert all_fields(build(name, seed=3)) == all_fields(build(name, seed=3))


def gaps(cluster, spacing):
    """Gap of each pair of bubbles that are there from the start, in spacings, and how fast it closes, m/s."""
    bubbles = [cluster.bubbles[k] for k in cluster.initial]
    first, second = np.triu_indices(len(bubbles), 1)
    centre, velocity = (np.array([getattr(b, name) for b in bubbles]) for name in ("centre", "velocity"))
    radius = np.array([b.radius for b in bubbles])
    apart = centre[second] - centre[first]
    distance = np.linalg.norm(apart, axis=1)
    closing = -np.einsum("ij,ij->i", velocity[second] - velocity[first], apart) / distance
    return (distance - radius[first] - radius[second]) / spacing, closing


@pytest.mark.parametrize(
    ("name", "pairs"),
    [("double_bubble", 1), ("size_ratio", 1), ("triple_bubble", 3), ("quadruple_bubble", 6), ("four_bubbles", 4)],
)
def test_bubbles_start_a_gap_apart_and_approach(name, pairs):
    scene = build(name, gap=1.5)
    gap, closing = gaps(scene.shape, e_spacing([b.radius for b in scene.shape.bubbles], scene.e_count))
    near = gap < 1.6
    assert near.sum() == pairs
    np.testing.assert_allclose(gap[near], 1.5, rtol=1e-6)
    assert closing.min() > 0.05


def test_double_bubble_has_thick_over_thin():
    above, below = build("double_bubble").shape.bubbles
    assert above.centre[1] > 0.0 > below.centre[1]
    assert (above.thickness, below.thickness) == (500e-9, 250e-9)


@pytest.mark.parametrize("ratio", [0.4, 0.5, 0.6, 0.7, 0.8, 0.9])
def test_size_ratio(ratio):
    first, second = build("size_ratio", ratio=ratio).shape.bubbles
    assert (first.radius, second.radius) == (0.05, pytest.approx(ratio * 0.05))


def test_four_bubbles_merge_on_the_right_and_pop():
    cluster = build("four_bubbles", merge_time=0.5, pop_time=0.7).shape
    merge, pop = cluster.events
    assert merge == Merge(0.5, 1, 2) and (pop.time, pop.region, pop.delete) == (0.7, 1, False)
    assert pop.place[0] == pytest.approx(pop.place[1]) and pop.place[0] > 0.1
    assert all(cluster.bubbles[k].centre[0] > 0.0 for k in (1, 2))
    tension = [b.tension for b in cluster.bubbles]
    assert (tension[0], tension[1]) == (tension[2], tension[3]) == (0.99, 1.01)
    assert build("four_bubbles", merge_time=None, pop_time=None).shape.events == ()


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
def test_cluster_is_one_in_twelve(seed):
    scene = build("cluster", seed=seed, merge_time=0.2)
    bubbles = scene.shape.bubbles
    gap, closing = gaps(scene.shape, e_spacing([b.radius for b in bubbles], scene.e_count))
    assert gap.min() == pytest.approx(0.5, rel=1e-6)
    assert closing.mean() > 0.1
    away = np.linalg.norm([b.centre for b in bubbles], axis=1)
    assert len(away) == 13
    assert np.argmin(away) == 0
    for name, low, high in (("radius", 0.0435, 0.06), ("thickness", 400e-9, 600e-9)):
        values = np.array([getattr(b, name) for b in bubbles])
        assert low <= values.min() < values.max() <= high
    assert scene.shape.events == (Merge(0.2, 0, 1),)


@pytest.mark.parametrize("bubbles", [1, 5, 15, 300])
def test_foam_mountain_pours_any_number(bubbles):
    cluster = build("foam_mountain", bubbles=bubbles).shape
    assert len(cluster.bubbles) == bubbles
    assert len(cluster.initial) == min(bubbles, 5)
    born = [b.born for b in cluster.bubbles]
    assert born == sorted(born)
    assert all(0.008 <= b.radius <= 0.012 and b.velocity[1] < 0.0 for b in cluster.bubbles)
    assert [wall.pops for wall in cluster.walls] == [False, True, True, True, True]


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("foam_mountain", {"tap_spacing": 0.01}, ["bubbles 0 and 1", "overlap"]),
        ("foam_mountain", {"tap_height": 0.005}, ["bubble 0", "wall 0"]),
        ("foam_mountain", {"container": 0.05}, ["inside wall"]),
    ],
)
def test_foams_that_cannot_start(name, changes, words):
    with pytest.raises(InputError) as error:
        build(name, **changes)
    for word in words:
        assert word in str(error.value)


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
    assert scene.frames / scene.fps == pytest.approx(0.3)


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
        ("def broken(:\n", "line 1: SyntaxError"),
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
        ("nonsense", "scenes are burst_pair, cluster, deforming"),
        ("no/such/file.py", "no such file"),
    ],
)
def test_unknown_scene(name, words):
    with pytest.raises(InputError, match=words):
        load_scene(name)
