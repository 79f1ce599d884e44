"""Preview pictures: colours, geometry and layers against closed forms."""

import numpy as np
import pytest
from PIL import Image

from melp_warp import optics
from melp_warp.errors import InputError
from melp_warp.frame import ParticleFrame
from melp_warp.preview import Camera, contact_sheet, render, save_png
from melp_warp.shapes import Disc, Rectangle, Sphere

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
    save_png(image, path)
    np.testing.assert_array_equal(np.asarray(Image.open(path)), image)
    assert [p.name for p in tmp_path.iterdir()] == ["film.png"]
    with pytest.raises(InputError, match=r"^image must be"):
        save_png(image.astype(float), path)


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
