"""Preview pictures: colours, geometry and layers against closed forms."""

from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from melp_warp import cli, optics
from melp_warp.errors import InputError
from melp_warp.frame import ParticleFrame
from melp_warp.mesh.surfaces import make_meshes, thin_out
from melp_warp.mesh.whole import make_whole
from melp_warp.preview.draw import FORMATS, Camera, contact_sheet, render, save_image
from melp_warp.preview.pictures import Cache
from melp_warp.preview.surface import Surface, borders
from melp_warp.shapes import Disc, Rectangle, Sphere
from melp_warp.study.mesh_validation import frame_of, problems_of, unsettled
from tests.foams import cluster

RADIUS = 0.1


def make_frame(points, normals, thickness, region=0):
    n = len(points)
    return ParticleFrame(
        points=np.asarray(points, dtype=np.float32),
        velocities=np.zeros((n, 3), dtype=np.float32),
        ids=np.arange(n),
        widths=np.full(n, 0.01, dtype=np.float32),
        normals=np.asarray(normals, dtype=np.float32),
        thickness=np.broadcast_to(np.asarray(thickness, dtype=np.float32), (n,)).copy(),
        region=np.broadcast_to(np.asarray(region, dtype=np.int32), (n,)).copy(),
        black_film=np.zeros(n, dtype=np.int32),
    )


def sphere(count=1500, thickness=300.0):
    s = Sphere(RADIUS).sample(count)
    return make_frame(s.points, s.normals, thickness)


def scattered_sphere(count=4000, thickness=300.0):
    """Points of no order, as far apart or as close as chance has it."""
    p = np.random.default_rng(5).normal(size=(count, 3))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    return make_frame(RADIUS * p, p, thickness)


def encode(linear):
    """Linear sRGB to bytes, negative channels moved into the gamut at constant luminance."""
    x = np.clip(optics.clip_to_gamut(linear), 0.0, 1.0)
    return 255.0 * np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1.0 / 2.4) - 0.055)


def white(frame, size=64, **options):
    return render(frame, size, size, environment="white", **options).astype(float)


def front(frame, **options):
    return Camera.fit(frame, direction=(0.0, 0.0, 1.0), **options)


@pytest.mark.parametrize("thickness", [10.0, 104.0, 250.0, 333.0, 640.0, 1210.0])
def test_flat_film_in_white_light_has_the_colour_of_the_optics(thickness):
    """One code value of rounding and half a one for the table (2 nm rows, bilinear)."""
    s = Rectangle(0.16, 0.09).sample(600)
    frame = make_frame(s.points, s.normals, thickness)
    image = white(frame, 33, camera=front(frame), exposure=5.0)
    expected = encode(5.0 * optics.interference_color(thickness, 1.0))
    assert np.abs(image[16, 16] - expected).max() <= 1.5


def test_thickness_between_particles_is_interpolated():
    """A smooth profile seen through 1000 points: every row within 4 codes where colours change by hundreds."""
    width, height, size = 0.16, 0.09, 96

    def profile(y):
        return 180.0 + 420.0 * np.exp(-1.5 * (y / height + 0.5))

    s = Rectangle(width, height).sample(1000)
    frame = make_frame(s.points, s.normals, profile(s.points[:, 1]))
    camera = front(frame)
    image = white(frame, size, camera=camera, exposure=5.0)[:, size // 2]
    slope = np.tan(0.5 * np.radians(camera.fov))
    y = (1.0 - 2.0 * (np.arange(size) + 0.5) / size) * slope * camera.eye[2]
    inside = np.abs(y) < 0.45 * height
    cosine = camera.eye[2] / np.hypot(camera.eye[2], y)
    expected = encode(5.0 * optics.interference_color(profile(y), cosine))
    bright = inside[:, None] & (expected > 60.0)
    assert bright.sum() > 60
    assert np.abs(image - expected)[bright].max() <= 4.0


@pytest.mark.parametrize("count", [500, 4000])
def test_silhouette_of_a_sphere_is_its_projection(count):
    frame = sphere(count)
    size = 160
    camera = front(frame)
    covered = (white(frame, size, camera=camera, samples=3).max(axis=2) >= 188).sum()  # half covered
    distance = np.linalg.norm(np.subtract(camera.eye, camera.target))
    angle = np.arcsin(RADIUS / distance)
    expected = 0.5 * size * np.tan(angle) / np.tan(0.5 * np.radians(camera.fov))
    assert abs(np.sqrt(covered / np.pi) - expected) < 0.5


def test_front_and_back_walls_are_both_seen():
    """The eye sees R + (1 - R)^2 R through the middle of a bubble, R alone with one layer."""
    frame = sphere(thickness=311.0)
    camera = front(frame)
    r = optics.interference_color(311.0, 1.0)
    both = white(frame, 33, camera=camera, exposure=4.0)[16, 16]
    one = white(frame, 33, camera=camera, exposure=4.0, layers=1)[16, 16]
    assert np.abs(both - encode(4.0 * (r + (1.0 - r) ** 2 * r))).max() <= 2.0
    assert np.abs(one - encode(4.0 * r)).max() <= 2.0


def test_halves_of_a_shared_wall_make_one_film():
    s = Rectangle(0.1, 0.1).sample(400)
    points = np.concatenate([s.points, s.points + np.float64([0.0, 0.0, 1e-5])])
    normals = np.concatenate([s.normals, -s.normals])
    frame = make_frame(points, normals, 150.0, np.repeat([0, 1], len(s.points)))
    image = white(frame, 33, camera=front(frame), exposure=5.0)
    assert np.abs(image[16, 16] - encode(5.0 * optics.interference_color(300.0))).max() <= 1.5


def test_bubbles_apart_are_never_joined():
    """One bubble behind another looks the same whether or not they are one region."""
    s = Sphere(RADIUS).sample(1200)
    points = np.concatenate([s.points, s.points + np.float64([0.05, 0.0, -0.25])])
    normals = np.concatenate([s.normals, s.normals])
    one = make_frame(points, normals, 400.0)
    two = make_frame(points, normals, 400.0, np.repeat([0, 1], len(s.points)))
    camera = front(one)
    np.testing.assert_array_equal(white(one, camera=camera, layers=8), white(two, camera=camera, layers=8))


def test_scattered_points_leave_no_holes_and_no_dots():
    """Points of no order, with gaps of several spacings, give the picture of even points within 3 codes."""
    size = 128
    camera = front(sphere())
    even = white(sphere(4000), size, camera=camera, exposure=4.0)
    scattered = white(scattered_sphere(), size, camera=camera, exposure=4.0)
    y, x = np.mgrid[:size, :size] + 0.5 - 0.5 * size
    inside = np.hypot(x, y) < 0.96 * 0.5 * size / 1.18
    assert scattered.max(axis=2)[inside].min() > 60.0
    assert np.abs(scattered - even)[inside].max() <= 3.0


def test_particles_crowded_in_lines_leave_no_specks():
    """A flow draws particles into lines: ten times as many on one side of a line are no edge of the film."""
    size = 256
    p = scattered_sphere(60000).points / RADIUS
    stripe = np.sin(14.0 * p[:, 0]) * np.sin(14.0 * p[:, 1]) > 0.3
    kept = stripe | (np.arange(len(p)) % 10 == 0)
    camera = front(sphere())
    even = white(sphere(4000), size, camera=camera, exposure=4.0)
    lines = white(make_frame(RADIUS * p[kept], p[kept], 300.0), size, camera=camera, exposure=4.0)
    y, x = np.mgrid[:size, :size] + 0.5 - 0.5 * size
    inside = np.hypot(x, y) < 0.96 * 0.5 * size / 1.18
    assert np.abs(lines - even)[inside].max() <= 3.0


def test_film_ends_at_its_rim():
    s = Disc(0.05).sample(3000)
    frame = make_frame(s.points, s.normals, 300.0)
    camera = Camera.fit(frame, direction=(0.0, 1.0, 0.0))
    assert camera.outline.kind == "ring"
    assert abs(camera.outline.half_x - 0.05) < 0.001
    size = 128
    covered = (white(frame, size, camera=camera).max(axis=2) > 60).sum()
    slope = np.tan(0.5 * np.radians(camera.fov))
    radius = np.sqrt(covered / np.pi) * 2.0 * slope * camera.eye[1] / size
    assert abs(radius - 0.05) < 2.0 * np.sqrt(s.area[0])


def test_rectangle_gets_a_frame_and_flat_light():
    s = Rectangle(0.16, 0.09).sample(900)
    camera = Camera.fit(make_frame(s.points, s.normals, 300.0))
    assert camera.flat
    assert camera.outline.kind == "frame"
    assert sorted([camera.outline.half_x, camera.outline.half_y]) == pytest.approx([0.045, 0.08], rel=0.03)


def test_the_same_input_gives_the_same_picture():
    frame = scattered_sphere(1500, 420.0)
    first = render(frame, 80, 60)
    assert first.shape == (60, 80, 3)
    assert first.dtype == np.uint8
    np.testing.assert_array_equal(first, render(frame, 80, 60))


def test_place_does_not_matter():
    frame = sphere()
    moved = sphere()
    moved.points = moved.points + np.float32([8.0, -4.0, 2.0])
    difference = np.abs(white(frame) - white(moved))
    assert np.median(difference) <= 1.0
    assert difference.mean() < 1.0


def test_one_camera_shows_all_frames():
    small, large = sphere(), sphere()
    large.points = 2.0 * large.points
    camera = Camera.fit([small, large])
    assert camera == Camera.fit(frame for frame in (small, large))
    for frame in (small, large):
        edge = white(frame, 48, camera=camera)
        edge[1:-1, 1:-1] = 0.0
        assert edge.max() == 0.0


@pytest.mark.parametrize("count", [1, 2, 3, 20])
def test_few_points_are_drawn(count):
    s = Sphere(RADIUS).sample(count)
    assert white(make_frame(s.points, s.normals, 300.0), 32).max() > 40


def broken(**fields):
    frame = sphere(50)
    for name, value in fields.items():
        setattr(frame, name, value)
    return frame


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"points": np.zeros((0, 3), np.float32)}, "points"),
        ({"points": np.full((50, 3), np.nan, np.float32)}, "points"),
        ({"points": np.zeros((50, 2), np.float32)}, "points"),
        ({"normals": np.zeros((50, 3), np.float32)}, "normals"),
        ({"normals": np.ones((49, 3), np.float32)}, "normals"),
        ({"thickness": np.full(50, np.inf, np.float32)}, "thickness"),
        ({"thickness": np.full(50, -1.0, np.float32)}, "thickness"),
        ({"region": np.zeros(3, np.int32)}, "region"),
    ],
)
def test_bad_frames_are_refused(fields, field):
    with pytest.raises(InputError, match=rf"^{field} must be"):
        render(broken(**fields), 16, 16)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("width", 0),
        ("height", 2.5),
        ("layers", 13),
        ("samples", 0),
        ("exposure", -1.0),
        ("environment", "moon"),
        ("device", "abacus"),
        ("index", 1.0),
    ],
)
def test_bad_options_are_refused(field, value):
    with pytest.raises(InputError, match=rf"^{field} must be"):
        render(sphere(50), **{field: value})


def test_bad_cameras_are_refused():
    with pytest.raises(InputError, match=r"^eye must be"):
        Camera((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    with pytest.raises(InputError, match=r"^up must be"):
        Camera((0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    with pytest.raises(InputError, match=r"^frames must be"):
        Camera.fit([])
    with pytest.raises(InputError, match=r"^margin must be"):
        Camera.fit(sphere(50), margin=0.5)


def test_png_is_written_whole(tmp_path):
    image = np.arange(48, dtype=np.uint8).reshape(4, 4, 3)
    path = tmp_path / "film.png"
    path.write_text("old")
    save_image(image, path)
    np.testing.assert_array_equal(np.asarray(Image.open(path)), image)
    assert [p.name for p in tmp_path.iterdir()] == ["film.png"]
    with pytest.raises(InputError, match=r"^image must be"):
        save_image(image.astype(float), path)


def test_contact_sheet_sets_pictures_in_a_grid():
    images = [np.full((60, 80, 3), 40 * k, dtype=np.uint8) for k in range(5)]
    sheet = contact_sheet(images, [f"t = {k} s" for k in range(5)])
    assert sheet.shape == (2 * 62 + 2, 3 * 82 + 2, 3)
    np.testing.assert_array_equal(sheet[2:30, 84:164], images[1][:28])
    assert sheet[40:62, 2:60].max() > 150
    assert contact_sheet(images, columns=5).shape[0] == 64
    with pytest.raises(InputError, match=r"^labels must be"):
        contact_sheet(images, ["one"])
    with pytest.raises(InputError, match=r"^images must be"):
        contact_sheet([])
    with pytest.raises(InputError, match=r"^images must be"):
        contact_sheet([images[0], images[0][:5]])


def test_a_frame_without_particles_is_the_backdrop():
    """Black with light of 1 from everywhere; a camera is fitted to the frames that have particles."""
    frame = sphere()
    camera = Camera.fit([frame, ParticleFrame.empty()])
    assert camera == Camera.fit([frame])
    assert white(ParticleFrame.empty(), camera=camera).max() == 0.0
    assert white(frame, camera=camera).max() > 0.0
    with pytest.raises(InputError, match="points"):
        render(ParticleFrame.empty(), 64, 64)


# --- meshes ----------------------------------------------------------------------------------------------------------


def meshed(shape=None, count=1000, thickness=300.0, rims=()):
    few, many = unsettled(Sphere(RADIUS), count, 4, thickness=lambda x: thickness)
    if shape is not None:
        few, many = frame_of(shape.sample(count), thickness), frame_of(shape.sample(4 * count, 0.5), thickness)
    meshes, problems = make_meshes(few, many, rims)
    assert problems == []
    return meshes[0]


@pytest.mark.parametrize("thickness", [10.0, 104.0, 333.0, 640.0])
def test_a_flat_mesh_has_the_colour_of_the_optics(thickness):
    shape = Rectangle(0.16, 0.09)
    mesh = meshed(shape, 300, thickness, shape.edges())
    image = white(mesh, 33, camera=front(mesh), exposure=5.0)
    expected = encode(5.0 * optics.interference_color(thickness, 1.0))
    assert np.abs(image[16, 16] - expected).max() <= 1.5


def test_a_mesh_has_the_colour_of_the_true_angle():
    """Both walls of a bubble at every distance from its middle: R + (1 - R)^2 R at the angle of the ray."""
    mesh, size = meshed(count=2000, thickness=311.0), 129
    camera = front(mesh)
    image = white(mesh, size, camera=camera, exposure=2.0, samples=3)[64]
    slope = np.tan(0.5 * np.radians(camera.fov))
    x = np.abs(2.0 * (np.arange(size) + 0.5) / size - 1.0) * slope
    away = camera.eye[2]
    sine = away * x / np.sqrt(1.0 + x**2) / RADIUS  # of the angle between ray and normal, by the law of sines
    inside = sine < 0.9
    r = optics.interference_color(311.0, np.sqrt(1.0 - sine[inside] ** 2))
    assert inside.sum() > 90
    assert np.abs(image[inside] - encode(2.0 * (r + (1.0 - r) ** 2 * r))).max() <= 3.0


@pytest.mark.parametrize("count", [200, 3000])
def test_a_mesh_has_neither_holes_nor_seams(count):
    """Every ray through a bubble meets exactly two films, wherever edges and corners of triangles lie."""
    mesh, size = meshed(count=count, thickness=104.0), 257
    camera = front(mesh)
    image = white(mesh, size, camera=camera, exposure=4.0, samples=1)
    one = encode(4.0 * optics.interference_color(104.0, 1.0)).max()
    two = white(mesh, 33, camera=camera, exposure=4.0)[16, 16].max()
    y, x = np.mgrid[:size, :size] + 0.5 - 0.5 * size
    inside = image[np.hypot(x, y) < 0.6 * 0.5 * size / 1.18].max(axis=1)
    assert one < two - 20.0
    assert np.abs(inside - two).max() < 0.25 * (two - one)


def test_a_mesh_is_as_large_as_its_projection():
    mesh, size = meshed(count=200), 160
    camera = front(mesh)
    covered = (white(mesh, size, camera=camera, samples=3).max(axis=2) >= 188).sum()
    angle = np.arcsin(RADIUS / camera.eye[2])
    expected = 0.5 * size * np.tan(angle) / np.tan(0.5 * np.radians(camera.fov))
    assert abs(np.sqrt(covered / np.pi) - expected) < 0.5


def flat_pair(gap, lean=0.0, thickness=150.0):
    """Two squares back to back, of two regions, `gap` apart, the rear one leaning (rad)."""
    shape = Rectangle(0.1, 0.1)
    one = meshed(shape, 200, thickness, shape.edges())
    two = meshed(shape, 200, thickness, shape.edges())
    behind = gap + np.tan(lean) * np.maximum(two.points[:, :1], 0.0)
    two.points = two.points - np.float32([0.0, 0.0, 1.0]) * behind
    two.normals, two.faces = -two.normals, two.faces[:, ::-1].copy()
    return Surface({0: one, 1: two}, (), ())


def test_two_sheets_that_touch_are_one_film():
    """As thick as both; a fifth of the radius of a bubble of their area apart they are two."""
    radius = 0.1 / np.sqrt(4.0 * np.pi)
    film = flat_pair(1e-4)
    camera = front(film)
    image = white(film, 33, camera=camera, exposure=5.0)
    assert np.abs(image[16, 16] - encode(5.0 * optics.interference_color(300.0))).max() <= 1.5
    r = optics.interference_color(150.0)
    image = white(flat_pair(0.2 * radius), 33, camera=camera, exposure=5.0)
    assert np.abs(image[16, 16] - encode(5.0 * (r + (1.0 - r) ** 2 * r))).max() <= 2.0


def test_what_parts_does_so_smoothly():
    """No tear where two sheets part: along a row of pixels one film goes over into two."""
    film = flat_pair(1e-5, 0.02)
    row = white(film, 257, camera=front(film, fov=2.0), exposure=5.0)[64, 30:-30]
    r, whole = optics.interference_color(150.0), optics.interference_color(300.0)
    change = encode(5.0 * (r + (1.0 - r) ** 2 * r)) - encode(5.0 * whole)
    assert np.abs(row[0] - encode(5.0 * whole)).max() <= 2.0
    assert np.abs(row[-1] - row[0] - change).max() <= 4.0
    assert np.abs(change).max() > 40.0
    assert np.abs(np.diff(row, axis=0)).max() < 0.15 * np.abs(change).max()


def test_borders_run_where_films_meet():
    """Two half spheres on one disc have one border, the disc's circle."""
    meshes, _ = make_meshes(cluster(2, 1000))
    film = Surface(meshes)
    radii = film.radii()
    lines, width, _ = borders(film, radii)
    middle = 0.5 * (lines[:, 0] + lines[:, 1])
    center = middle.mean(axis=0)
    length = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    distance = np.linalg.norm(middle - center, axis=1)
    radius = np.average(distance, weights=length)
    assert np.sqrt(np.average((distance - radius) ** 2, weights=length)) < 0.03 * radius
    assert length.sum() / (2.0 * np.pi * radius) == pytest.approx(2.0, rel=0.1)  # each of the two bubbles tells it
    assert (width < 0.02 * radii.min()).all()
    alone, _, _ = borders(Surface({0: meshed()}), np.array([RADIUS]))
    assert len(alone) == 0


def test_one_mesh_of_a_foam_looks_as_its_regions_do():
    """Partitions are as thick as both sheets, borders are edges; away from these the two pictures are the same."""
    e = cluster(2, 1000)
    e.thickness[:] = 60.0  # thin: sharp corners have more area, so films are 1 % thinner, which colours of 500 nm show
    apart, whole = Surface(make_meshes(e)[0]), Surface.of_whole(make_whole(e)[0])
    camera = Camera.fit(e, direction=(0.3, 0.2, 1.0))
    one, two = (white(film, 96, camera=camera, exposure=4.0).astype(float) for film in (apart, whole))
    off = np.abs(one - two).max(axis=2)[one.max(axis=2) > 0.0]
    assert np.median(off) <= 3.0
    assert np.quantile(off, 0.8) <= 8.0
    lines, width, _ = borders(whole, whole.radii())
    length = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum()
    assert length == pytest.approx(2.0 * np.pi * np.sqrt(0.75), rel=0.03)
    assert (width > 0.0).all() and (width < 0.02).all()


def test_a_wire_hides_what_is_behind_it():
    shape = Disc(RADIUS)
    mesh = meshed(shape, 400, 300.0, shape.edges())
    film = Surface({0: mesh}, shape.edges())
    camera = Camera.fit(film)
    with_wire, without = (render(one, 200, 200, camera).astype(int) for one in (film, mesh))
    assert 200 < (np.abs(with_wire - without).max(axis=2) > 20).sum() < 4000


@pytest.mark.parametrize(
    ("background", "low", "high"), [("dark", 0, 25), ("light", 190, 240), ("#405060", 60, 100), ("around", 1, 255)]
)
def test_grounds(background, low, high):
    image = render(meshed(count=200), 64, 64, background=background)
    corner = image[2:6, 2:6].mean()
    assert low <= corner <= high
    if background == "#405060":
        middle = render(Surface({}), 33, 33, Camera((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)), background=background)[16, 16]
        assert np.abs(middle.astype(int) - [0x40, 0x50, 0x60]).max() <= 2


def test_a_picture_lights_the_film(tmp_path):
    """A light that is red on the left and blue on the right is seen so in the film."""
    picture = np.zeros((64, 128, 3), np.uint8)
    picture[:, :64, 0] = 255
    picture[:, 64:, 2] = 255
    path = tmp_path / "light.png"
    save_image(picture, path)
    mesh = meshed(count=500, thickness=104.0)
    image = render(mesh, 96, 96, front(mesh), environment=str(path), layers=1).astype(float)
    left, right = image[30:66, 20:40].mean(axis=(0, 1)), image[30:66, 56:76].mean(axis=(0, 1))
    assert left[0] > 1.5 * left[2]
    assert right[2] > 1.5 * right[0]


def test_a_floor_is_behind_and_hides_what_is_below():
    mesh = meshed(count=300)
    camera = front(mesh)
    middle = ((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    camera = Camera((0.0, 0.3, camera.eye[2]), camera.target, fov=camera.fov)
    with_floor, without = (render(Surface({0: mesh}, (), one), 96, 96, camera) for one in ((middle,), ()))
    np.testing.assert_array_equal(with_floor[24:40, 40:56] > 0, without[24:40, 40:56] > 0)
    assert with_floor[70:76, 40:56].astype(int).sum() < without[70:76, 40:56].astype(int).sum()


def test_pictures_of_meshes_are_the_same_each_time():
    mesh = meshed(count=300)
    np.testing.assert_array_equal(render(mesh, 80, 60), render(mesh, 80, 60))


@pytest.mark.parametrize(
    ("field", "value"), [("layers", 9), ("environment", "moon"), ("background", "#12"), ("background", "grey")]
)
def test_bad_options_of_meshes_are_refused(field, value):
    with pytest.raises(InputError, match=rf"^{field} must be"):
        render(meshed(count=100), 16, 16, **{field: value})


@pytest.mark.parametrize("l_per_e", [1, 4, 16])
def test_a_mesh_of_l_alone_is_closed(l_per_e):
    """As many of the L as there would be E, evenly spread, carry it, whatever the order of the L."""
    s = Sphere(RADIUS).sample(400 * l_per_e)
    p = s.points + np.random.default_rng(2).normal(scale=0.5 * np.sqrt(s.area[0]), size=s.points.shape)
    s.normals = p / np.linalg.norm(p, axis=1, keepdims=True)
    s.points = RADIUS * s.normals
    many = frame_of(s, 300.0)
    few = thin_out(many, l_per_e)
    assert 200 < len(few.points) < 600
    meshes, problems = make_meshes(few, many)
    assert problems == []
    assert problems_of(meshes[0]) == []


@pytest.mark.parametrize("ending", FORMATS)
def test_pictures_are_of_the_format_of_their_ending(ending, tmp_path):
    path = tmp_path / f"film{ending}"
    save_image(np.full((12, 16, 3), 90, np.uint8), path)
    with Image.open(path) as image:
        assert image.format == FORMATS[ending]
        assert image.size == (16, 12)


def test_an_unknown_format_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"picture must be a file ending in \.png"):
        save_image(np.zeros((4, 4, 3), np.uint8), tmp_path / "film.xyz")


def test_a_camera_goes_around():
    camera = Camera((0.0, 0.1, 1.0), (0.0, 0.0, 0.0))
    assert camera.turned(0.5 * np.pi).eye == pytest.approx((1.0, 0.1, 0.0))
    assert camera.turned(2.0 * np.pi).eye == pytest.approx(camera.eye)


@pytest.mark.slow
def test_a_foam_at_rest_does_not_flicker(tmp_path):
    """Pictures of the last frames of four bubbles that came to rest differ by less than 1 % of their brightness."""
    folder = tmp_path / "run"
    assert (
        cli.main(["run", "quadruple_bubble", "--mesh", "--quiet", "--out", str(folder), "--set", "e_count=1600"]) == 0
    )
    cache = Cache(folder)
    camera = cache.camera()
    images = [render(cache.film(frame), 320, 320, camera).astype(float) for frame in cache.frames[-4:]]
    for one, two in pairwise(images):
        assert np.abs(one - two).mean() < 0.01 * one.mean()
