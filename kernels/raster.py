"""Preview of surface meshes: triangles seen through a pinhole, every film that a ray crosses, and thin lines.

Vertices are projected once. A sample of the picture looks at the triangles and lines of its tile, keeps what its ray
meets, nearest first, and composites films from the eye outwards. Neighbouring triangles ask the same question about the
edge between them, so that a ray meets exactly one of the two.

Vectors are in the camera's axes (x right, y up, z towards the eye), depth is along -z, m; thickness is in nanometres,
colours are linear sRGB. Places in the picture are in samples from its upper left.
"""

import warp as wp

from melp_warp.kernels.color import film_color
from melp_warp.kernels.render import (
    View,
    film_response,
    into_gamut,
    lamp_point,
    panel_light,
    pass_through,
    sample_place,
    sample_point,
    smooth,
    soft_box,
    studio_light,
)

wp.set_module_options({"enable_backward": False})

TILE = wp.constant(4)
MOST_HITS = wp.constant(20)
MOST_FILMS = wp.constant(8)

WHITE = wp.constant(0)
STUDIO = wp.constant(1)
PANEL = wp.constant(2)
SKY = wp.constant(3)

GLOW = wp.constant(0)
PLAIN = wp.constant(1)
AROUND = wp.constant(2)

BORDER = wp.constant(0)
WIRE = wp.constant(1)

hit_floats = wp.types.vector(length=20, dtype=wp.float32)
hit_ints = wp.types.vector(length=20, dtype=wp.int32)


@wp.struct
class Surface:
    """Meshes as they are seen.

    Attributes:
        place: [n] of vertices in the picture, samples.
        nearness: [n] 1/depth, 1/m; at most 0 behind the eye.
        normal: [n] outward unit normals.
        thickness: [n] nm.
        face: [f] corners.
        region: [f] region.
        touch: [regions] distance under which a sheet and that of another region are one film, m.
    """

    place: wp.array[wp.vec2]
    nearness: wp.array[wp.float32]
    normal: wp.array[wp.vec3]
    thickness: wp.array[wp.float32]
    face: wp.array[wp.vec3i]
    region: wp.array[wp.int32]
    touch: wp.array[wp.float32]


@wp.struct
class Lines:
    """Lines as they are seen: ends in the picture (samples), their 1/depth (1/m), radius (m) and `BORDER` or `WIRE`."""

    start: wp.array[wp.vec2]
    stop: wp.array[wp.vec2]
    near_start: wp.array[wp.float32]
    near_stop: wp.array[wp.float32]
    radius: wp.array[wp.float32]
    kind: wp.array[wp.int32]


@wp.struct
class Look:
    """How it is shown.

    Attributes:
        gain: on what films mirror.
        films: drawn behind one another at most.
        max_thickness: of the colour table, nm.
        ground: `GLOW`, `PLAIN` or `AROUND`.
        color: of the ground.
        dim: power of what a film lets through.
        world: whether the light is told in world axes rather than the camera's.
        scale: samples a unit of size over depth.
        thin: least radius of a line, samples.
        floors: number of floors.
        pool: middle of what is seen, from the target, m.
        reach: its size, m.
    """

    gain: wp.float32
    films: wp.int32
    max_thickness: wp.float32
    ground: wp.int32
    color: wp.vec3
    dim: wp.float32
    world: wp.int32
    scale: wp.float32
    thin: wp.float32
    floors: wp.int32
    pool: wp.vec3
    reach: wp.float32


# --- light -----------------------------------------------------------------------------------------------------------


@wp.func
def sky_light(d: wp.vec3) -> wp.vec3:
    """Radiance of a day outdoors from direction `d` in world axes: blue above, bright towards the horizon, a sun."""
    up = d[1]
    bright = wp.exp(-3.0 * wp.abs(up))
    sky = (0.25 + 0.75 * bright) * wp.vec3(0.62, 0.80, 1.10) + 0.25 * bright * wp.vec3(1.0, 0.95, 0.85)
    ground = (0.12 + 0.18 * bright) * wp.vec3(0.75, 0.80, 0.62)
    light = ground + smooth(-0.03, 0.05, up) * (sky - ground)
    sun = wp.dot(d, wp.normalize(wp.vec3(-0.55, 0.62, 0.56)))
    light += (6.0 * smooth(0.9965, 0.9985, sun) + 0.6 * smooth(0.90, 1.0, sun)) * wp.vec3(1.0, 0.94, 0.82)
    cloud = lamp_point(d, wp.normalize(wp.vec3(0.8, 0.45, 0.4)))
    return light + 0.7 * soft_box(cloud, 0.5, 0.12, 0.25) * wp.vec3(1.0, 1.0, 1.0)


@wp.func
def unfold(u: float, v: float) -> wp.vec3:
    """Direction of a point -1..1 of an octahedron that is laid flat."""
    z = 1.0 - wp.abs(u) - wp.abs(v)
    x = u
    y = v
    if z < 0.0:
        x = (1.0 - wp.abs(v)) * wp.where(u < 0.0, -1.0, 1.0)
        y = (1.0 - wp.abs(u)) * wp.where(v < 0.0, -1.0, 1.0)
    return wp.normalize(wp.vec3(x, y, z))


@wp.kernel
def bake_light(
    environment: int,
    # outputs
    light: wp.array2d[wp.vec3],
):
    """Radiance from all directions on a flat octahedron, [size, size]."""
    size = light.shape[0]
    row = wp.tid() / size
    column = wp.tid() % size
    d = unfold(2.0 * (float(column) + 0.5) / float(size) - 1.0, 2.0 * (float(row) + 0.5) / float(size) - 1.0)
    color = wp.vec3(1.0, 1.0, 1.0)
    if environment == STUDIO:
        color = studio_light(d)
    if environment == PANEL:
        color = panel_light(d)
    if environment == SKY:
        color = sky_light(d)
    light[row, column] = color


@wp.func
def light_from(light: wp.array2d[wp.vec3], d: wp.vec3) -> wp.vec3:
    """Radiance that arrives from direction `d`, bilinear."""
    size = light.shape[0]
    s = 1.0 / (wp.abs(d[0]) + wp.abs(d[1]) + wp.abs(d[2]))
    u = d[0] * s
    v = d[1] * s
    if d[2] < 0.0:
        u = (1.0 - wp.abs(d[1] * s)) * wp.where(d[0] < 0.0, -1.0, 1.0)
        v = (1.0 - wp.abs(d[0] * s)) * wp.where(d[1] < 0.0, -1.0, 1.0)
    x = wp.clamp(0.5 * (u + 1.0) * float(size) - 0.5, 0.0, float(size) - 1.0)
    y = wp.clamp(0.5 * (v + 1.0) * float(size) - 0.5, 0.0, float(size) - 1.0)
    i = wp.min(int(y), size - 2)
    j = wp.min(int(x), size - 2)
    a = y - float(i)
    b = x - float(j)
    low = (1.0 - b) * light[i, j] + b * light[i, j + 1]
    high = (1.0 - b) * light[i + 1, j] + b * light[i + 1, j + 1]
    return (1.0 - a) * low + a * high


@wp.func
def seen_from(view: View, look: Look, light: wp.array2d[wp.vec3], d: wp.vec3) -> wp.vec3:
    """Radiance from direction `d` in the camera's axes."""
    if look.world == 1:
        return light_from(light, d[0] * view.right + d[1] * view.up + d[2] * view.back)
    return light_from(light, d)


# --- projection ------------------------------------------------------------------------------------------------------


@wp.func
def to_axes(view: View, v: wp.vec3) -> wp.vec3:
    """A world vector in the camera's axes."""
    return wp.vec3(wp.dot(view.right, v), wp.dot(view.up, v), wp.dot(view.back, v))


@wp.func
def to_picture(view: View, p: wp.vec3) -> wp.vec3:
    """Place of a point in the picture, samples, and 1/depth, 1/m; that is 0 behind the eye."""
    y = to_axes(view, p - view.eye)
    if y[2] > -1.0e-6:
        return wp.vec3(0.0, 0.0, 0.0)
    near = -1.0 / y[2]
    column = 0.5 * (1.0 + y[0] * near / view.slope_x) * float(view.columns)
    row = 0.5 * (1.0 - y[1] * near / view.slope_y) * float(view.rows)
    return wp.vec3(column, row, near)


@wp.kernel
def project_v(
    view: View,
    points: wp.array[wp.vec3],
    normals: wp.array[wp.vec3],
    # outputs
    place: wp.array[wp.vec2],
    nearness: wp.array[wp.float32],
    normal: wp.array[wp.vec3],
):
    """Vertices as they are seen, all [n]: points (m, from the target) and normals to those of `Surface`."""
    i = wp.tid()
    p = to_picture(view, points[i])
    place[i] = wp.vec2(p[0], p[1])
    nearness[i] = p[2]
    normal[i] = to_axes(view, normals[i])


@wp.kernel
def project_lines(
    view: View,
    points: wp.array2d[wp.vec3],
    # outputs
    lines: Lines,
):
    """Ends of lines [n, 2] (m, from the target) as they are seen."""
    i = wp.tid()
    a = to_picture(view, points[i, 0])
    b = to_picture(view, points[i, 1])
    lines.start[i] = wp.vec2(a[0], a[1])
    lines.stop[i] = wp.vec2(b[0], b[1])
    lines.near_start[i] = a[2]
    lines.near_stop[i] = b[2]


@wp.func
def tiles_in(view: View, low: wp.vec2, high: wp.vec2) -> wp.vec4i:
    """First and last tile column, first and last tile row of a box in the picture; empty: 0 -1 0 -1."""
    columns = float(view.columns)
    rows = float(view.rows)
    if high[0] < 0.0 or low[0] > columns or high[1] < 0.0 or low[1] > rows:
        return wp.vec4i(0, -1, 0, -1)
    c0 = int(wp.max(low[0], 0.0)) / TILE
    c1 = wp.min(int(wp.min(high[0], columns)) / TILE, view.tile_columns - 1)
    r0 = int(wp.max(low[1], 0.0)) / TILE
    r1 = wp.min(int(wp.min(high[1], rows)) / TILE, (view.rows + TILE - 1) / TILE - 1)
    return wp.vec4i(c0, c1, r0, r1)


@wp.func
def line_radius(look: Look, lines: Lines, k: int, near: float) -> float:
    """Radius of a line in the picture, samples."""
    return wp.max(lines.radius[k] * near * look.scale, look.thin)


@wp.func
def tiles_of(view: View, look: Look, seen: Surface, lines: Lines, i: int) -> wp.vec4i:
    """Tiles that a triangle, or after the last one a line, can touch."""
    faces = seen.face.shape[0]
    if i < faces:
        f = seen.face[i]
        if wp.min(wp.min(seen.nearness[f[0]], seen.nearness[f[1]]), seen.nearness[f[2]]) <= 0.0:
            return wp.vec4i(0, -1, 0, -1)
        a = seen.place[f[0]]
        b = seen.place[f[1]]
        c = seen.place[f[2]]
        return tiles_in(view, wp.min(wp.min(a, b), c), wp.max(wp.max(a, b), c))
    k = i - faces
    if wp.min(lines.near_start[k], lines.near_stop[k]) <= 0.0:
        return wp.vec4i(0, -1, 0, -1)
    r = line_radius(look, lines, k, wp.max(lines.near_start[k], lines.near_stop[k]))
    margin = wp.vec2(r, r)
    return tiles_in(
        view, wp.min(lines.start[k], lines.stop[k]) - margin, wp.max(lines.start[k], lines.stop[k]) + margin
    )


@wp.kernel
def box_seen(
    view: View,
    look: Look,
    seen: Surface,
    lines: Lines,
    # outputs
    boxes: wp.array[wp.vec4i],
):
    """Tiles that each triangle and line touches, [faces + lines] as `tiles_in`."""
    i = wp.tid()
    boxes[i] = tiles_of(view, look, seen, lines, i)


# --- rays ------------------------------------------------------------------------------------------------------------


@wp.func
def side_of(seen: Surface, a: int, b: int, p: wp.vec2) -> float:
    """Twice the area of (a, b, p); the same number but for its sign if a and b change places."""
    i = wp.min(a, b)
    j = wp.max(a, b)
    s = seen.place[i]
    d = seen.place[j] - s
    area = d[0] * (p[1] - s[1]) - d[1] * (p[0] - s[0])
    return wp.where(a < b, area, -area)


@wp.func
def within(side: float, a: int, b: int, turn: float) -> bool:
    """Whether a point with this `side_of` an edge is in the triangle; one on the edge is in one of two."""
    return side * turn > 0.0 or (side == 0.0 and (a < b) == (turn > 0.0))


@wp.func
def film_normal(seen: Surface, f: wp.vec3i, u: float, v: float) -> wp.vec3:
    """Normal within a triangle."""
    n = (1.0 - u - v) * seen.normal[f[0]] + u * seen.normal[f[1]] + v * seen.normal[f[2]]
    return wp.normalize(n)


@wp.func
def film_depth(seen: Surface, f: wp.vec3i, u: float, v: float) -> float:
    """Thickness within a triangle, nm."""
    return (1.0 - u - v) * seen.thickness[f[0]] + u * seen.thickness[f[1]] + v * seen.thickness[f[2]]


@wp.func
def let_through(film: wp.vec3, power: float) -> wp.vec3:
    """Part of what lies behind a film that is seen through it."""
    through = pass_through(film)
    if power == 1.0:
        return through
    return wp.vec3(wp.pow(through[0], power), wp.pow(through[1], power), wp.pow(through[2], power))


@wp.func
def floor_light(
    view: View,
    look: Look,
    light: wp.array2d[wp.vec3],
    ray: wp.vec3,
    normal: wp.vec3,
    p: wp.vec3,
    ground: wp.vec3,
) -> wp.vec3:
    """Radiance of a floor, a smooth plate that mirrors a little, at a point `p` (m, from the target).

    It is lit in the middle and fades away from there into the ground behind everything.
    """
    n = to_axes(view, normal)
    cosine = wp.min(wp.abs(wp.dot(n, ray)), 1.0)
    mirrored = seen_from(view, look, light, ray - 2.0 * wp.dot(n, ray) * n)
    fresnel = 0.04 + 0.96 * wp.pow(1.0 - cosine, 5.0)
    away = wp.length(p - look.pool) / look.reach
    pool = wp.exp(-0.5 * away * away)
    color = pool * wp.vec3(0.045, 0.047, 0.052) + fresnel * pool * wp.min(mirrored, wp.vec3(1.0, 1.0, 1.0))
    fade = smooth(3.5, 0.8, away)
    if look.ground != GLOW:
        color = wp.cw_mul(ground, wp.vec3(0.82, 0.82, 0.82) + 0.1 * pool * wp.vec3(1.0, 1.0, 1.0))
    return fade * color + (1.0 - fade) * ground


@wp.func
def ground_light(view: View, look: Look, light: wp.array2d[wp.vec3], place: wp.vec2, ray: wp.vec3) -> wp.vec3:
    """What is behind everything."""
    x = place[0]
    y = place[1]
    if look.ground == PLAIN:
        return (1.0 - 0.12 * wp.min(x * x + y * y, 2.0)) * look.color
    if look.ground == AROUND:
        return seen_from(view, look, light, ray)
    glow = wp.exp(-0.9 * (x * x + (y + 0.15) * (y + 0.15)))
    return glow * wp.vec3(0.022, 0.026, 0.036) + wp.vec3(0.004, 0.0045, 0.006)


@wp.func
def line_light(
    view: View, look: Look, light: wp.array2d[wp.vec3], lines: Lines, k: int, off: float, ray: wp.vec3
) -> wp.vec3:
    """Radiance of a line, a thin rod of liquid or metal, at `off` (-1..1) across it."""
    along = wp.normalize(lines.stop[k] - lines.start[k] + wp.vec2(1.0e-6, 0.0))
    n = wp.vec3(-off * along[1], -off * along[0], wp.sqrt(wp.max(1.0 - off * off, 0.0)))
    mirrored = seen_from(view, look, light, ray - 2.0 * wp.dot(n, ray) * n)
    if lines.kind[k] == WIRE:
        return (0.05 * look.gain) * (mirrored + wp.vec3(0.25, 0.25, 0.25))
    return 0.42 * mirrored + wp.vec3(0.16, 0.17, 0.18)


@wp.func
def films_along(
    view: View,
    look: Look,
    seen: Surface,
    lines: Lines,
    members: wp.array[wp.int32],
    begin: int,
    end: int,
    table: wp.array2d[wp.vec3],
    light: wp.array2d[wp.vec3],
    p: wp.vec2,
    ray: wp.vec3,
    farthest: float,
    behind: wp.vec3,
) -> wp.vec3:
    """Radiance along a ray: of films and lines of its tile, `begin` to `end` of the list, and of what is `behind`."""
    used = wp.int32(0)
    depth = hit_floats()
    first_part = hit_floats()
    second_part = hit_floats()
    member = hit_ints()
    faces = seen.face.shape[0]
    for m in range(begin, end):
        k = members[m]
        z = float(0.0)
        u = float(0.0)
        v = float(0.0)
        if k < faces:
            f = seen.face[k]
            ab = side_of(seen, f[0], f[1], p)
            bc = side_of(seen, f[1], f[2], p)
            ca = side_of(seen, f[2], f[0], p)
            area = ab + bc + ca
            if within(ab, f[0], f[1], area) and within(bc, f[1], f[2], area) and within(ca, f[2], f[0], area):
                wa = bc * seen.nearness[f[0]]
                wb = ca * seen.nearness[f[1]]
                wc = ab * seen.nearness[f[2]]
                total = wa + wb + wc
                z = area / total
                u = wb / total
                v = wc / total
        else:
            line = k - faces
            d = lines.stop[line] - lines.start[line]
            t = wp.clamp(wp.dot(p - lines.start[line], d) / wp.max(wp.dot(d, d), 1.0e-12), 0.0, 1.0)
            near = (1.0 - t) * lines.near_start[line] + t * lines.near_stop[line]
            across = p - lines.start[line] - t * d
            r = line_radius(look, lines, line, near)
            if wp.length_sq(across) < r * r:
                z = 1.0 / near - 1.5 * r / (look.scale * near)
                u = wp.length(across) / r
                v = wp.where(d[0] * across[1] - d[1] * across[0] < 0.0, -1.0, 1.0)
        if z > 0.0 and z < farthest * 1.0001:
            at = wp.min(used, MOST_HITS - 1)
            if used < MOST_HITS or z < depth[at]:
                used = wp.min(used + 1, MOST_HITS)
                while at > 0 and depth[wp.max(at - 1, 0)] > z:
                    depth[at] = depth[at - 1]
                    first_part[at] = first_part[at - 1]
                    second_part[at] = second_part[at - 1]
                    member[at] = member[at - 1]
                    at -= 1
                depth[at] = z
                first_part[at] = u
                second_part[at] = v
                member[at] = k

    color = wp.vec3(0.0, 0.0, 0.0)
    through = wp.vec3(1.0, 1.0, 1.0)
    films = wp.int32(0)
    for k in range(used):
        if (
            member[k] >= faces
        ):  # the same border is told by each of the regions that meet there: the one that covers most
            best = k
            reach = depth[k] + 6.0 * line_radius(look, lines, member[k] - faces, 1.0 / depth[k]) * depth[k] / look.scale
            for m in range(k + 1, used):
                if member[m] >= faces and depth[m] < reach:
                    if first_part[m] < first_part[best]:
                        member[best] = -1
                        best = m
                    else:
                        member[m] = -1
            line = member[best] - faces
            shine = line_light(view, look, light, lines, line, first_part[best] * second_part[best], ray)
            member[best] = -1
            if lines.kind[line] == WIRE:
                color += wp.cw_mul(through, shine)
                through = wp.vec3(0.0, 0.0, 0.0)
            else:
                cover = smooth(1.0, 0.3, first_part[best])
                color += cover * wp.cw_mul(through, shine)
                through = (1.0 - 0.4 * cover) * through
        elif member[k] >= 0 and films < look.films:
            films += 1
            f = seen.face[member[k]]
            n = film_normal(seen, f, first_part[k], second_part[k])
            nm = wp.max(film_depth(seen, f, first_part[k], second_part[k]), 0.0)
            cosine = wp.dot(n, ray)
            film = film_color(table, look.max_thickness, nm, cosine)
            shine = wp.cw_mul(film, seen_from(view, look, light, ray - 2.0 * cosine * n))
            passed = let_through(film, look.dim)
            region = seen.region[member[k]]
            for m in range(k + 1, wp.min(k + 4, used)):
                if member[m] >= 0 and member[m] < faces and seen.region[member[m]] != region:
                    g = seen.face[member[m]]
                    n2 = film_normal(seen, g, first_part[m], second_part[m])
                    touch = wp.min(seen.touch[region], seen.touch[seen.region[member[m]]])
                    gap = (depth[m] - depth[k]) * wp.abs(cosine) / -ray[2]
                    if gap < touch and wp.dot(n, n2) < 0.0:
                        part = smooth(0.5 * touch, touch, gap)
                        nm2 = wp.max(film_depth(seen, g, first_part[m], second_part[m]), 0.0)
                        cosine2 = wp.dot(n2, ray)
                        film2 = film_color(table, look.max_thickness, nm2, cosine2)
                        shine2 = wp.cw_mul(film2, seen_from(view, look, light, ray - 2.0 * cosine2 * n2))
                        one = film_color(table, look.max_thickness, nm + nm2, cosine)
                        n3 = wp.normalize(n - n2)
                        whole = wp.cw_mul(one, seen_from(view, look, light, ray - 2.0 * wp.dot(n3, ray) * n3))
                        shine = part * (shine + wp.cw_mul(passed, shine2)) + (1.0 - part) * whole
                        both = wp.cw_mul(passed, let_through(film2, look.dim))
                        passed = part * both + (1.0 - part) * let_through(one, look.dim)
                        member[m] = -1
                        break
            color += look.gain * wp.cw_mul(through, shine)
            through = wp.cw_mul(through, passed)
    return color + wp.cw_mul(through, behind)


@wp.kernel
def draw_surfaces(
    view: View,
    look: Look,
    seen: Surface,
    lines: Lines,
    begins: wp.array[wp.int32],
    ends: wp.array[wp.int32],
    members: wp.array[wp.int32],
    table: wp.array2d[wp.vec3],
    light: wp.array2d[wp.vec3],
    floor_point: wp.array[wp.vec3],
    floor_normal: wp.array[wp.vec3],
    first: int,
    # outputs
    image: wp.array2d[wp.vec3],
):
    """Radiance of each sample.

    A film of reflectance R mirrors the light and lets (1 - R)^2 of what lies behind it through: light crosses it on the
    way in and on the way out. Two sheets of different regions, back to back and nearer than they touch, are one film,
    as thick as both; where they part the two pictures blend.

    Args:
        view: camera.
        look: how it is shown.
        seen: meshes.
        lines: lines.
        begins: [tiles] first pair of each tile.
        ends: [tiles] one past the last pair.
        members: [pairs] triangles and lines of each tile.
        table: film colours.
        light: light from all directions.
        floor_point: [floors] m, from the target.
        floor_normal: [floors] into the room, world axes.
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
    begin = begins[tile]
    end = ends[tile]
    if begin == end and look.floors == 0 and look.ground != AROUND:
        image[row, column] = ground_light(view, look, light, place, wp.vec3(0.0, 0.0, -1.0))
        return
    ray = wp.normalize(wp.vec3(view.slope_x * place[0], view.slope_y * place[1], -1.0))
    behind = ground_light(view, look, light, place, ray)
    farthest = float(1.0e30)
    world = ray[0] * view.right + ray[1] * view.up + ray[2] * view.back
    for k in range(look.floors):
        slope = wp.dot(world, floor_normal[k])
        if slope < -1.0e-4:
            t = wp.dot(floor_point[k] - view.eye, floor_normal[k]) / slope
            if t > 0.0 and -t * ray[2] < farthest:
                farthest = -t * ray[2]
                behind = floor_light(view, look, light, ray, floor_normal[k], view.eye + t * world, behind)

    if begin < end:
        p = sample_point(column, row, view.samples)
        behind = films_along(view, look, seen, lines, members, begin, end, table, light, p, ray, farthest, behind)
    image[row, column] = behind


# --- picture ---------------------------------------------------------------------------------------------------------


@wp.kernel
def respond(
    plain: bool,
    first: int,
    # outputs
    samples: wp.array2d[wp.vec3],
):
    """What film makes of the radiance of each sample, in its place; cut at 1 where it is `plain`."""
    row = (first + wp.tid()) / samples.shape[1]
    column = (first + wp.tid()) % samples.shape[1]
    color = into_gamut(samples[row, column])
    if plain:
        samples[row, column] = wp.min(color, wp.vec3(1.0, 1.0, 1.0))
    else:
        samples[row, column] = film_response(color)


@wp.kernel
def average_glare(
    samples: wp.array2d[wp.vec3],
    size: int,
    first: int,
    # outputs
    means: wp.array2d[wp.vec3],
):
    """Mean of what exceeds 1, at most 4, in each block of `size` x `size` samples, [rows, columns].

    Args:
        samples: radiance.
        size: samples along a block's side.
        first: block of thread 0.
        means: [rows, columns] of blocks.
    """
    row = (first + wp.tid()) / means.shape[1]
    column = (first + wp.tid()) % means.shape[1]
    one = wp.vec3(1.0, 1.0, 1.0)
    sum = wp.vec3(0.0, 0.0, 0.0)
    r_end = wp.min((row + 1) * size, samples.shape[0])
    c_end = wp.min((column + 1) * size, samples.shape[1])
    for r in range(row * size, r_end):
        for c in range(column * size, c_end):
            if wp.max(samples[r, c]) > 1.0:
                over = into_gamut(samples[r, c]) - one
                sum += wp.min(wp.max(over, wp.vec3(0.0, 0.0, 0.0)), 4.0 * one)
    means[row, column] = sum / float((r_end - row * size) * (c_end - column * size))


@wp.func
def between_blocks(means: wp.array2d[wp.vec3], y: float, x: float) -> wp.vec3:
    """Bilinear in means of blocks, at a place in blocks."""
    y = wp.clamp(y - 0.5, 0.0, float(means.shape[0] - 1))
    x = wp.clamp(x - 0.5, 0.0, float(means.shape[1] - 1))
    i = wp.min(int(y), wp.max(means.shape[0] - 2, 0))
    j = wp.min(int(x), wp.max(means.shape[1] - 2, 0))
    k = wp.min(i + 1, means.shape[0] - 1)
    m = wp.min(j + 1, means.shape[1] - 1)
    a = y - float(i)
    b = x - float(j)
    low = (1.0 - b) * means[i, j] + b * means[i, m]
    high = (1.0 - b) * means[k, j] + b * means[k, m]
    return (1.0 - a) * low + a * high


@wp.func
def part_of(x: float) -> float:
    """What is behind the point of a number."""
    return x - wp.floor(x)


@wp.kernel
def develop(
    response: wp.array2d[wp.vec3],
    weights: wp.array2d[wp.float32],
    per_pixel: int,
    glow: wp.array2d[wp.vec3],
    block: float,
    plain: bool,
    first: int,
    # outputs
    picture: wp.array3d[wp.uint8],
):
    """Mean of the samples about each pixel with the glow over it, in sRGB; a fixed pattern keeps dark gradients smooth.

    Args:
        response: [rows per_pixel, columns per_pixel].
        weights: [k, k] of the samples about a pixel.
        per_pixel: samples along a pixel's side.
        glow: means of blocks, added.
        block: pixels along a block's side.
        plain: without glow and pattern, rounded.
        first: pixel of thread 0.
        picture: [rows, columns, 3] out.
    """
    row = (first + wp.tid()) / picture.shape[1]
    column = (first + wp.tid()) % picture.shape[1]
    sum = wp.vec3(0.0, 0.0, 0.0)
    total = float(0.0)
    reach = per_pixel / 2
    for a in range(weights.shape[0]):
        r = row * per_pixel - reach + a
        if r >= 0 and r < response.shape[0]:
            for b in range(weights.shape[1]):
                c = column * per_pixel - reach + b
                if c >= 0 and c < response.shape[1]:
                    sum += weights[a, b] * response[r, c]
                    total += weights[a, b]
    color = sum / total
    offset = float(0.5)
    if not plain:
        color += between_blocks(glow, (float(row) + 0.5) / block, (float(column) + 0.5) / block)
        offset = part_of(52.9829189 * part_of(0.06711056 * float(column) + 0.00583715 * float(row)))
    for k in range(3):
        x = wp.clamp(color[k], 0.0, 1.0)
        code = 12.92 * x
        if x > 0.0031308:
            code = 1.055 * wp.pow(x, 1.0 / 2.4) - 0.055
        picture[row, column, k] = wp.uint8(wp.clamp(255.0 * code + offset, 0.0, 255.0))


# --- borders ---------------------------------------------------------------------------------------------------------


@wp.kernel
def find_near_v(
    grid: wp.uint64,
    points: wp.array[wp.vec3],
    region: wp.array[wp.int32],
    meshes: wp.array[wp.uint64],
    radius: float,
    # outputs
    other: wp.array[wp.vec3i],
    gap: wp.array[wp.vec3],
):
    """The three other regions whose surfaces are nearest to each vertex, and how far they are.

    Args:
        grid: over `points`.
        points: [n] m.
        region: [n].
        meshes: [regions] triangles of each.
        radius: within which vertices of others are sought, m; half of it for their surfaces.
        other: [n] regions, -1 for none.
        gap: [n] distances, m; half the radius for none.
    """
    i = wp.tid()
    x = points[i]
    reach = 0.5 * radius
    found = wp.vec3i(-1, -1, -1)
    away = wp.vec3(reach, reach, reach)
    count = wp.int32(0)
    for j in wp.hash_grid_query(grid, x, radius):
        k = region[j]
        if k != region[i] and count < 3 and k != found[0] and k != found[1]:
            if wp.length_sq(points[j] - x) < radius * radius:
                query = wp.mesh_query_point_no_sign(meshes[k], x, reach)
                if query.result:
                    p = wp.mesh_eval_position(meshes[k], query.face, query.u, query.v)
                    away[count] = wp.length(p - x)
                found[count] = k
                count += 1
    other[i] = found
    gap[i] = away
