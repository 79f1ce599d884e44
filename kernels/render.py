"""Preview renderer: curved splats seen through a pinhole, shaded as soap film under studio lights.

Each particle becomes a patch of a quadric that follows its normal and the curvature of its neighbourhood. A ray
through a sample of the picture meets the patches of its tile; meetings of one sheet are blended into one layer, the
layers are composited from the eye outwards.

Lengths are metres relative to the camera's target, angles are seen in the camera's axes (x right, y up, z towards the
eye), thickness is in nanometres, colours are linear sRGB.
"""

import warp as wp

from melp_warp.kernels.color import film_color

wp.set_module_options({"enable_backward": False})

MAX_LAYERS = wp.constant(12)
TILE = wp.constant(8)

WHITE = wp.constant(0)
STUDIO = wp.constant(1)
PANEL = wp.constant(2)

NO_OUTLINE = wp.constant(0)
RING = wp.constant(1)
FRAME = wp.constant(2)

FAR = wp.constant(1.0e30)

LOPSIDED = wp.constant(0.1)
"""Mean of a splat's neighbours over its radius from which on it may lie at an edge; 0.29 on a straight one."""

layer_floats = wp.types.vector(length=12, dtype=wp.float32)
layer_ints = wp.types.vector(length=12, dtype=wp.int32)
layer_vectors = wp.types.matrix(shape=(12, 3), dtype=wp.float32)


@wp.struct
class Splat:
    """A patch n.y = y.H.y/2, |y| < radius, about a particle; its thickness varies linearly. `edge`: 1 at an edge."""

    position: wp.vec3
    normal: wp.vec3
    curvature: wp.mat33
    gradient: wp.vec3
    radius: wp.float32
    thickness: wp.float32
    edge: wp.float32
    region: wp.int32


@wp.struct
class View:
    """Camera and picture: `slope_x`, `slope_y` are half the picture over its distance; the counts are in samples."""

    eye: wp.vec3
    right: wp.vec3
    up: wp.vec3
    back: wp.vec3
    slope_x: wp.float32
    slope_y: wp.float32
    columns: wp.int32
    rows: wp.int32
    tile_columns: wp.int32
    samples: wp.int32


@wp.struct
class Outline:
    """Wire that holds a flat film: circle (`half_x` its radius) or rectangle in the plane of `axis_x`, `axis_y`."""

    kind: wp.int32
    center: wp.vec3
    axis_x: wp.vec3
    axis_y: wp.vec3
    half_x: wp.float32
    half_y: wp.float32
    wire: wp.float32


@wp.struct
class Look:
    """How the film is shown: environment, gain on radiance, layers drawn, last thickness (nm) of the colour table."""

    environment: wp.int32
    gain: wp.float32
    layers: wp.int32
    max_thickness: wp.float32


# --- splats ----------------------------------------------------------------------------------------------------------


@wp.func
def same_sheet(a: wp.vec3, b: wp.vec3, region_a: int, region_b: int) -> bool:
    """Whether two neighbours with normals `a`, `b` lie on the same sheet of film."""
    return region_a == region_b and wp.dot(a, b) > 0.3


@wp.func
def crowd_radius(
    grid: wp.uint64,
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    region: wp.array[wp.int32],
    i: int,
    spacing: float,
    crowd: float,
) -> float:
    """Radius about particle `i` that holds about `crowd` particles of its sheet, found by counting, m."""
    radius = spacing * wp.sqrt(crowd / 3.14159)
    for _trial in range(5):
        count = float(0.0)
        for j in wp.hash_grid_query(grid, points[i], radius):
            if wp.length_sq(points[j] - points[i]) < radius * radius:
                if same_sheet(normals[i], normals[j], region[i], region[j]):
                    count += 1.0
        if count > 0.75 * crowd and count < 1.33 * crowd:
            return radius
        radius *= wp.clamp(wp.sqrt(crowd / wp.max(count, 1.0)), 0.6, 1.5)
        radius = wp.min(radius, 6.0 * spacing)
    return radius


@wp.func
def at_edge(
    grid: wp.uint64,
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    region: wp.array[wp.int32],
    i: int,
    a: wp.vec3,
    b: wp.vec3,
    reach: float,
) -> bool:
    """Whether the film ends beside particle `i`: five sectors of sixteen about it, in a row, are empty up to `reach`.

    Inside of a film, where particles are crowded on one side only, those of the other side are found farther away.
    """
    seen = wp.int32(0)
    for j in wp.hash_grid_query(grid, points[i], reach):
        d = points[j] - points[i]
        if j != i and wp.length_sq(d) < reach * reach and same_sheet(normals[i], normals[j], region[i], region[j]):
            turn = 0.5 + 0.5 * wp.atan2(wp.dot(b, d), wp.dot(a, d)) / 3.14159265
            seen |= 1 << wp.clamp(int(16.0 * turn), 0, 15)
    seen |= seen << 16
    empty = wp.int32(0)
    for sector in range(21):
        empty = wp.where((seen >> sector) & 1 == 1, 0, empty + 1)
        if empty == 5:
            return True
    return False


@wp.kernel
def fit_splats(
    grid: wp.uint64,
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    thickness: wp.array[wp.float32],
    region: wp.array[wp.int32],
    spacing: float,
    crowd: float,
    wired: bool,
    # outputs
    splats: wp.array[Splat],
):
    """Least squares over the neighbours: smoothed height and normal, shape operator, gradient of the thickness.

    In the particle's tangent plane the surface is z = z0 + s.x + x.H.x/2. The neighbours' normals, whose slopes are
    s + H.x, give s and H; their heights then give z0. Noise is smoothed, what is quadratic stays as it is.

    Args:
        grid: hash grid over `points`.
        points: [n] m.
        normals: [n] unit.
        thickness: [n] nm.
        region: [n] sheets of different regions are never blended.
        spacing: usual distance of neighbours, m.
        crowd: particles within a splat's radius; where they lie on one side it is larger, but not at an edge.
        wired: whether a wire says where the film ends; it has no other edge then.
        splats: [n].
    """
    i = wp.tid()
    n = normals[i]
    radius = crowd_radius(grid, points, normals, region, i, spacing, crowd)
    axis = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(n[0]) > 0.6:
        axis = wp.vec3(0.0, 1.0, 0.0)
    a = wp.normalize(wp.cross(n, axis))
    b = wp.cross(n, a)
    moment = wp.mat33(0.0)
    lean_a = wp.vec3(0.0)
    lean_b = wp.vec3(0.0)
    slope = wp.vec2(0.0)
    height = float(0.0)
    largest = float(0.0)
    for j in wp.hash_grid_query(grid, points[i], radius):
        d = points[j] - points[i]
        q = wp.length_sq(d) / (radius * radius)
        if q < 1.0 and same_sheet(n, normals[j], region[i], region[j]):
            w = (1.0 - q) * (1.0 - q)
            x = wp.vec3(1.0, wp.dot(a, d) / radius, wp.dot(b, d) / radius)
            facing = wp.dot(n, normals[j])
            rise = thickness[j] - thickness[i]
            moment += w * wp.outer(x, x)
            lean_a -= (w * wp.dot(a, normals[j]) / facing) * x
            lean_b -= (w * wp.dot(b, normals[j]) / facing) * x
            slope += w * rise * wp.vec2(x[1], x[2])
            height += w * wp.dot(n, d) / radius
            largest = wp.max(largest, wp.abs(rise))
    ridge = 1.0e-4 * (moment[1, 1] + moment[2, 2]) + 1.0e-6
    inverse = wp.inverse(moment + wp.diag(wp.vec3(0.0, ridge, ridge)))
    lean_a = inverse * lean_a
    lean_b = inverse * lean_b
    h = wp.vec3(lean_a[1], 0.5 * (lean_a[2] + lean_b[1]), lean_b[2])
    h *= 1.0 / wp.max(wp.sqrt(h[0] * h[0] + 2.0 * h[1] * h[1] + h[2] * h[2]), 1.0)
    height -= lean_a[0] * moment[0, 1] + lean_b[0] * moment[0, 2]
    height -= 0.5 * (h[0] * moment[1, 1] + 2.0 * h[1] * moment[1, 2] + h[2] * moment[2, 2])
    height = wp.clamp(height / moment[0, 0], -0.25, 0.25)
    level = wp.mat22(moment[1, 1] + ridge, moment[1, 2], moment[1, 2], moment[2, 2] + ridge)
    g = wp.inverse(level) * slope
    g *= wp.min(1.0, 2.0 * largest / (wp.length(g) + 1.0e-12)) / radius
    s = Splat()
    s.position = points[i] + height * radius * n
    s.normal = wp.normalize(n - lean_a[0] * a - lean_b[0] * b)
    s.curvature = (h[0] * wp.outer(a, a) + h[1] * (wp.outer(a, b) + wp.outer(b, a)) + h[2] * wp.outer(b, b)) / radius
    s.gradient = g[0] * a + g[1] * b
    s.radius = radius
    s.thickness = thickness[i]
    s.region = region[i]
    aside = wp.length(wp.vec2(moment[0, 1], moment[0, 2])) / moment[0, 0]
    if aside > LOPSIDED:
        if not wired and at_edge(grid, points, normals, region, i, a, b, 3.0 * radius):
            s.edge = 1.0
        else:
            s.radius = radius * (1.0 + 4.0 * (aside - LOPSIDED))
    splats[i] = s


# --- tiles -----------------------------------------------------------------------------------------------------------


@wp.func
def tile_box(view: View, s: Splat) -> wp.vec4i:
    """First and last tile column, first and last tile row that the ball about a splat can touch; empty: 0 -1 0 -1."""
    y = s.position - view.eye
    near = -wp.dot(view.back, y) - s.radius
    far = near + 2.0 * s.radius
    if near <= 0.0:
        return wp.vec4i(0, -1, 0, -1)
    x0 = wp.dot(view.right, y) - s.radius
    x1 = x0 + 2.0 * s.radius
    y0 = wp.dot(view.up, y) - s.radius
    y1 = y0 + 2.0 * s.radius
    x0 = x0 / wp.where(x0 < 0.0, near, far) / view.slope_x
    x1 = x1 / wp.where(x1 > 0.0, near, far) / view.slope_x
    y0 = y0 / wp.where(y0 < 0.0, near, far) / view.slope_y
    y1 = y1 / wp.where(y1 > 0.0, near, far) / view.slope_y
    if x1 < -1.0 or x0 > 1.0 or y1 < -1.0 or y0 > 1.0:
        return wp.vec4i(0, -1, 0, -1)
    w = 0.5 * float(view.columns)
    h = 0.5 * float(view.rows)
    tile_rows = (view.rows + TILE - 1) / TILE
    c0 = wp.max(int((x0 + 1.0) * w - 1.0) / TILE, 0)
    c1 = wp.min(int((x1 + 1.0) * w + 1.0) / TILE, view.tile_columns - 1)
    r0 = wp.max(int((1.0 - y1) * h - 1.0) / TILE, 0)
    r1 = wp.min(int((1.0 - y0) * h + 1.0) / TILE, tile_rows - 1)
    return wp.vec4i(c0, c1, r0, r1)


@wp.kernel
def box_splats(
    view: View,
    splats: wp.array[Splat],
    # outputs
    boxes: wp.array[wp.vec4i],
):
    """Tiles that each splat touches, [n] as `tile_box`."""
    i = wp.tid()
    boxes[i] = tile_box(view, splats[i])


# --- light -----------------------------------------------------------------------------------------------------------


@wp.func
def smooth(low: float, high: float, x: float) -> float:
    """0 below `low`, 1 above `high`, smooth between."""
    t = wp.clamp((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def lamp_point(direction: wp.vec3, center: wp.vec3) -> wp.vec3:
    """Where `direction` meets the plane of a lamp towards the unit vector `center`: across, up, 1 if in front."""
    side = wp.normalize(wp.cross(wp.vec3(0.0, 1.0, 0.0), center))
    top = wp.cross(center, side)
    z = wp.dot(direction, center)
    if z < 0.05:
        return wp.vec3(0.0, 0.0, 0.0)
    return wp.vec3(wp.dot(direction, side) / z, wp.dot(direction, top) / z, 1.0)


@wp.func
def soft_box(p: wp.vec3, half_x: float, half_y: float, edge: float) -> float:
    """Brightness of a lamp of the given half sizes whose border falls off over `edge`."""
    x = 1.0 - smooth(half_x - edge, half_x + edge, wp.abs(p[0]))
    y = 1.0 - smooth(half_y - edge, half_y + edge, wp.abs(p[1]))
    return p[2] * x * y


@wp.func
def studio_light(d: wp.vec3) -> wp.vec3:
    """Radiance from direction `d`: a ring of soft light about a dark camera, window upper left, soft boxes."""
    ring = smooth(1.0, 0.1, d[2]) * smooth(-0.95, 0.15, d[2])
    tilt = 0.55 + 0.45 * smooth(-0.9, 0.9, 0.8 * d[1] - 0.45 * d[0])
    rim = smooth(-0.8, -1.0, d[2])
    light = (0.05 + 0.44 * ring * tilt + 0.07 * rim) * wp.vec3(0.95, 0.98, 1.05)
    window = lamp_point(d, wp.normalize(wp.vec3(-0.62, 0.55, 0.56)))
    bars = smooth(0.008, 0.026, wp.abs(window[0])) * smooth(0.008, 0.026, wp.abs(window[1] - 0.06))
    sky = 1.9 + 1.4 * smooth(-0.46, 0.46, window[1])
    light += (sky * bars * soft_box(window, 0.34, 0.46, 0.035)) * wp.vec3(0.97, 0.99, 1.03)
    strip = lamp_point(d, wp.normalize(wp.vec3(0.94, 0.10, 0.30)))
    light += (1.1 * soft_box(strip, 0.15, 0.8, 0.10)) * wp.vec3(1.03, 0.99, 0.94)
    over = lamp_point(d, wp.normalize(wp.vec3(0.18, 0.97, 0.10)))
    light += (0.9 * soft_box(over, 0.55, 0.3, 0.25)) * wp.vec3(1.0, 0.99, 0.97)
    return light


@wp.func
def panel_light(d: wp.vec3) -> wp.vec3:
    """Radiance from direction `d` of a large diffuser that a flat film, seen by the default camera, mirrors."""
    panel = lamp_point(d, wp.normalize(wp.vec3(-0.44, 0.25, 0.86)))
    return (0.12 + 0.95 * soft_box(panel, 0.34, 0.32, 0.24)) * wp.vec3(1.0, 1.0, 1.0)


@wp.func
def light_from(environment: int, d: wp.vec3) -> wp.vec3:
    """Radiance that arrives from direction `d` (camera axes)."""
    if environment == WHITE:
        return wp.vec3(1.0, 1.0, 1.0)
    if environment == PANEL:
        return panel_light(d)
    return studio_light(d)


@wp.func
def backdrop(environment: int, x: float, y: float) -> wp.vec3:
    """Colour behind the film at picture coordinates -1..1; black in the white environment."""
    if environment == WHITE:
        return wp.vec3(0.0, 0.0, 0.0)
    glow = wp.exp(-0.9 * (x * x + (y + 0.15) * (y + 0.15)))
    return glow * wp.vec3(0.022, 0.026, 0.036) + wp.vec3(0.004, 0.0045, 0.006)


# --- rays ------------------------------------------------------------------------------------------------------------


@wp.func
def sample_point(column: int, row: int, per_pixel: int) -> wp.vec2:
    """Where a sample lies, in samples from the upper left: a grid in each pixel, rotated against stair steps."""
    sub_x = (float(column % per_pixel) + 0.5) / float(per_pixel) - 0.5
    sub_y = (float(row % per_pixel) + 0.5) / float(per_pixel) - 0.5
    return wp.vec2(float(column) + 0.5 + sub_y, float(row) + 0.5 - sub_x)


@wp.func
def sample_place(view: View, column: int, row: int) -> wp.vec2:
    """Picture coordinates (-1..1, y up) of a sample."""
    p = sample_point(column, row, view.samples)
    return wp.vec2(2.0 * p[0] / float(view.columns) - 1.0, 1.0 - 2.0 * p[1] / float(view.rows))


@wp.func
def meet(s: Splat, start: wp.vec3, ray: wp.vec3) -> wp.vec2:
    """Distances from `start` (relative to the splat) to where the ray enters and leaves its quadric; FAR for none."""
    bend = s.curvature * ray
    a = -0.5 * wp.dot(ray, bend)
    b = wp.dot(s.normal, ray) - wp.dot(start, bend)
    c = wp.dot(s.normal, start) - 0.5 * wp.dot(start, s.curvature * start)
    root = b * b - 4.0 * a * c
    enter = FAR
    leave = FAR
    if root >= 0.0:
        if b <= 0.0:
            q = wp.sqrt(root) - b
            if q > 0.0:
                enter = 2.0 * c / q
            if wp.abs(a) * s.radius > 1.0e-6:
                leave = 0.5 * q / a
        else:
            q = -wp.sqrt(root) - b
            leave = 2.0 * c / q
            if wp.abs(a) * s.radius > 1.0e-6:
                enter = 0.5 * q / a
    return wp.vec2(enter, leave)


@wp.func
def outline_distance(outline: Outline, p: wp.vec3) -> float:
    """Distance in the outline's plane from its line, negative inside, m."""
    x = wp.dot(outline.axis_x, p - outline.center)
    y = wp.dot(outline.axis_y, p - outline.center)
    if outline.kind == RING:
        return wp.sqrt(x * x + y * y) - outline.half_x
    dx = wp.abs(x) - outline.half_x
    dy = wp.abs(y) - outline.half_y
    outside = wp.length(wp.vec2(wp.max(dx, 0.0), wp.max(dy, 0.0)))
    return outside + wp.min(wp.max(dx, dy), 0.0)


@wp.func
def to_view(view: View, v: wp.vec3) -> wp.vec3:
    """A world vector in the camera's axes."""
    return wp.vec3(wp.dot(view.right, v), wp.dot(view.up, v), wp.dot(view.back, v))


@wp.func
def pass_through(film: wp.vec3) -> wp.vec3:
    """Part of the light behind a film that crosses it twice, (1 - R)^2."""
    one = wp.vec3(1.0, 1.0, 1.0)
    rest = one - wp.max(wp.min(film, one), wp.vec3(0.0, 0.0, 0.0))
    return wp.cw_mul(rest, rest)


@wp.func
def compose(
    view: View,
    look: Look,
    table: wp.array2d[wp.vec3],
    ray: wp.vec3,
    behind: wp.vec3,
    cover: float,
    used: int,
    weight: layer_floats,
    distance: layer_floats,
    thickness: layer_floats,
    size: layer_floats,
    crowd: layer_floats,
    edge: layer_floats,
    region: layer_ints,
    normal: layer_vectors,
    shift: layer_vectors,
) -> wp.vec3:
    """Radiance of a sample from its layers (sums not yet divided by `weight`), nearest first, over `behind`.

    Two layers of different regions that touch, back to back, are the halves of one film: their thicknesses add up. A
    film ends where its splats lie on one side: `shift` over `crowd`, 0 inside and 0.3 half a spacing beyond the last
    particle, is large; only splats at an `edge` tell, for inside they may be sparse on one side. `cover` fades all
    layers.
    """
    color = wp.vec3(0.0, 0.0, 0.0)
    through = wp.vec3(1.0, 1.0, 1.0)
    place = layer_floats()
    for k in range(used):
        place[k] = distance[k] / weight[k]
    for _turn in range(used):
        k = wp.int32(0)
        other = wp.int32(-1)
        for m in range(1, used):
            if place[m] < place[k]:
                k = m
        t = place[k]
        if t < FAR:
            place[k] = FAR
            n = wp.normalize(wp.vec3(normal[k, 0], normal[k, 1], normal[k, 2]))
            cosine = wp.dot(n, ray)
            nm = wp.max(thickness[k] / weight[k], 0.0)
            for m in range(used):
                gap = place[m] - t
                if region[m] != region[k] and gap < size[k] and gap * wp.abs(cosine) < 0.2 * size[k]:
                    if normal[m, 0] * n[0] + normal[m, 1] * n[1] + normal[m, 2] * n[2] < 0.0:
                        other = m
            if other >= 0:
                place[other] = FAR
                nm += wp.max(thickness[other] / weight[other], 0.0)
            mirrored = to_view(view, ray - 2.0 * cosine * n)
            off = wp.length(wp.vec3(shift[k, 0], shift[k, 1], shift[k, 2])) / crowd[k]
            fade = smooth(0.4, 0.62, off) * edge[k] / weight[k]
            film = cover * (1.0 - fade) * film_color(table, look.max_thickness, nm, cosine)
            color += wp.cw_mul(through, wp.cw_mul(film, light_from(look.environment, mirrored)))
            through = wp.cw_mul(through, pass_through(film))
    return look.gain * color + wp.cw_mul(through, behind)


@wp.func
def wire_light(outline: Outline, view: View, look: Look, p: wp.vec3, d: float) -> wp.vec3:
    """Radiance of the wire, a thin metal rod, seen at signed distance `d` from its centre line."""
    u = wp.clamp(d / outline.wire, -1.0, 1.0)
    step = 0.01 * outline.wire
    gx = outline_distance(outline, p + step * outline.axis_x) - d
    gy = outline_distance(outline, p + step * outline.axis_y) - d
    out = wp.normalize(gx * outline.axis_x + gy * outline.axis_y)
    n = u * to_view(view, out) + wp.vec3(0.0, 0.0, wp.sqrt(1.0 - u * u))
    light = studio_light(wp.vec3(2.0 * n[2] * n[0], 2.0 * n[2] * n[1], 2.0 * n[2] * n[2] - 1.0))
    return (0.05 * look.gain) * (light + wp.vec3(0.25, 0.25, 0.25))


@wp.kernel
def draw_samples(
    view: View,
    look: Look,
    outline: Outline,
    splats: wp.array[Splat],
    begins: wp.array[wp.int32],
    ends: wp.array[wp.int32],
    members: wp.array[wp.int32],
    table: wp.array2d[wp.vec3],
    first: int,
    # outputs
    image: wp.array2d[wp.vec3],
):
    """Radiance of each sample.

    A meeting of weight (1 - |y|^2/radius^2)^10 joins the layer of its region and facing whose mean distance is nearer
    than the splat's radius, or opens a new one. A layer reflects R and lets (1 - R)^2 of what lies behind it come to
    the eye: once on the way in, once on the way out.

    Args:
        view: camera.
        look: environment, gain, layers.
        outline: wire frame; film is drawn inside of it only, and everywhere inside.
        splats: [n] ordered by distance from the eye.
        begins: [tiles] first pair of each tile.
        ends: [tiles] one past the last pair.
        members: [pairs] splats of each tile, in order.
        table: film colours.
        first: sample of thread 0; samples are counted tile by tile.
        image: [rows, columns] out.
    """
    i = first + wp.tid()
    tile = i / (TILE * TILE)
    column = (tile % view.tile_columns) * TILE + i % TILE
    row = (tile / view.tile_columns) * TILE + (i / TILE) % TILE
    if column >= view.columns or row >= view.rows:
        return
    place = sample_place(view, column, row)
    ray = wp.normalize(view.slope_x * place[0] * view.right + view.slope_y * place[1] * view.up - view.back)

    used = wp.int32(0)
    weight = layer_floats()
    distance = layer_floats()
    thickness = layer_floats()
    size = layer_floats()
    crowd = layer_floats()
    edge = layer_floats()
    shift = layer_vectors()
    side = layer_ints()
    region = layer_ints()
    normal = layer_vectors()
    for k in range(begins[tile], ends[tile]):
        s = splats[members[k]]
        away = s.position - view.eye
        reach = wp.dot(away, ray)
        start = reach * ray - away
        if wp.length_sq(start) < s.radius * s.radius:
            roots = meet(s, start, ray)
            for facing in range(2):
                y = start + roots[facing] * ray
                q = wp.length_sq(y) / (s.radius * s.radius)
                if q < 1.0:
                    t = reach + roots[facing]
                    layer = wp.int32(0)
                    while layer < used:
                        if side[layer] == facing and region[layer] == s.region:
                            if wp.abs(t - distance[layer] / weight[layer]) < s.radius:
                                break
                        layer += 1
                    if layer < look.layers:
                        if layer == used:
                            used += 1
                            side[layer] = facing
                            size[layer] = s.radius
                            region[layer] = s.region
                        w = (1.0 - q) * (1.0 - q)
                        crowd[layer] += w * s.radius
                        shift[layer, 0] += w * y[0]
                        shift[layer, 1] += w * y[1]
                        shift[layer, 2] += w * y[2]
                        w *= w * w * w * w
                        w += 1.0e-12
                        m = w * (s.normal - s.curvature * y)
                        weight[layer] += w
                        edge[layer] += w * s.edge
                        distance[layer] += w * t
                        thickness[layer] += w * (s.thickness + wp.dot(s.gradient, y))
                        normal[layer, 0] += m[0]
                        normal[layer, 1] += m[1]
                        normal[layer, 2] += m[2]
    behind = backdrop(look.environment, place[0], place[1])
    cover = float(1.0)
    rod = float(1.0)
    p = wp.vec3(0.0, 0.0, 0.0)
    if outline.kind != NO_OUTLINE:
        plane = wp.cross(outline.axis_x, outline.axis_y)
        reach = wp.dot(outline.center - view.eye, plane) / wp.dot(ray, plane)
        p = view.eye + reach * ray
        rod = outline_distance(outline, p)
        if rod > 0.0:
            cover = 0.0
        if wp.abs(rod) < outline.wire:
            image[row, column] = wire_light(outline, view, look, p, rod)
            return
    image[row, column] = compose(
        view,
        look,
        table,
        ray,
        behind,
        cover,
        used,
        weight,
        distance,
        thickness,
        size,
        crowd,
        edge,
        region,
        normal,
        shift,
    )


# --- picture ---------------------------------------------------------------------------------------------------------


@wp.func
def into_gamut(color: wp.vec3) -> wp.vec3:
    """Make negative channels zero by moving the colour towards the grey of its luminance."""
    low = wp.min(color)
    if low >= 0.0:
        return color
    grey = wp.max(0.2126 * color[0] + 0.7152 * color[1] + 0.0722 * color[2], 0.0)
    keep = grey / (grey - low)
    return wp.vec3(grey, grey, grey) * (1.0 - keep) + keep * color


@wp.func
def film_response(color: wp.vec3) -> wp.vec3:
    """Response of photographic film (ACES fit of K. Narkowicz); dyes mix a little, so bright colours go to white."""
    grey = (color[0] + color[1] + color[2]) / 3.0
    x = 0.62 * (0.91 * color + 0.09 * wp.vec3(grey, grey, grey))
    top = wp.cw_mul(x, 2.51 * x + wp.vec3(0.03, 0.03, 0.03))
    return wp.cw_div(top, wp.cw_mul(x, 2.43 * x + wp.vec3(0.59, 0.59, 0.59)) + wp.vec3(0.14, 0.14, 0.14))
