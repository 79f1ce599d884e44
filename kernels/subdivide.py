"""Surface meshes: triangles as curved patches, subdivided evenly, and the liquid of L spread over their vertices.

Vertices are counted: those of the coarse mesh, then `parts` - 1 on each edge from its lower end, then those within each
triangle row by row. Place (i, j) of a triangle is i/parts of the way to its second corner and j/parts to its third.
"""

import warp as wp

from melp_warp.kernels.mesh import Rings
from melp_warp.kernels.sph import tangential

wp.set_module_options({"enable_backward": False})


@wp.func
def fine_vertex(face: wp.vec3i, side: wp.vec3i, f: int, i: int, j: int, parts: int, n: int, edges: int) -> int:
    """Number of the vertex at place (i, j) of triangle f."""
    inner = parts - 1
    h = parts - i - j
    if i == 0 and j == 0:
        return face[0]
    if j == 0 and h == 0:
        return face[1]
    if i == 0 and h == 0:
        return face[2]
    if j == 0:
        return n + side[0] * inner + wp.where(face[0] < face[1], i, h) - 1
    if h == 0:
        return n + side[1] * inner + wp.where(face[1] < face[2], j, i) - 1
    if i == 0:
        return n + side[2] * inner + wp.where(face[2] < face[0], h, j) - 1
    # row j = 1, 2, ... holds parts - 1 - j of them
    row = (j - 1) * (parts - 1) - (j - 1) * j / 2
    return n + edges * inner + f * (inner * (inner - 1) / 2) + row + i - 1


@wp.func
def handle(a: wp.vec3, b: wp.vec3, normal: wp.vec3, bend: float) -> wp.vec3:
    """Control point beside a of the edge to b: a third of the way, in the plane at a, or straight where `bend` is 0."""
    return a + wp.lerp(b - a, tangential(b - a, normal), bend) / 3.0


@wp.func
def middle_normal(a: wp.vec3, b: wp.vec3, na: wp.vec3, nb: wp.vec3) -> wp.vec3:
    """Normal half way between two points: the mean of theirs, mirrored where the surface bends to and fro."""
    d = b - a
    both = na + nb
    return wp.normalize(both - 2.0 * wp.dot(d, both) / wp.max(wp.dot(d, d), 1.0e-30) * d)


@wp.kernel
def place_on_edges_v(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    eta: wp.array(dtype=float),
    edge: wp.array(dtype=wp.vec2i),
    bend: wp.array(dtype=float),
    parts: int,
    # outputs
    place: wp.array(dtype=wp.vec3),
    upward: wp.array(dtype=wp.vec3),
    speed: wp.array(dtype=wp.vec3),
    depth: wp.array(dtype=float),
):
    """Vertices on edges: on the cubic that leaves both ends at right angles to their normals. A thread an edge.

    Args:
        x: [n] corners, m.
        normal: [n] unit normals.
        u: [n] velocities, m/s.
        eta: [n] thickness, m.
        edge: [edges] ends.
        bend: [edges] 1, or 0 for an edge that stays straight.
        parts: parts of an edge.
        place: [fine] positions, m.
        upward: [fine] unit normals.
        speed: [fine] velocities, m/s.
        depth: [fine] thickness, m.
    """
    e = wp.tid()
    a = edge[e][0]
    b = edge[e][1]
    ha = handle(x[a], x[b], normal[a], bend[e])
    hb = handle(x[b], x[a], normal[b], bend[e])
    between = middle_normal(x[a], x[b], normal[a], normal[b])
    first = x.shape[0] + e * (parts - 1)
    for m in range(1, parts):
        t = float(m) / float(parts)
        s = 1.0 - t
        k = first + m - 1
        place[k] = s * s * s * x[a] + 3.0 * s * s * t * ha + 3.0 * s * t * t * hb + t * t * t * x[b]
        upward[k] = wp.normalize(s * s * normal[a] + s * t * between + t * t * normal[b])
        speed[k] = s * u[a] + t * u[b]
        depth[k] = s * eta[a] + t * eta[b]


@wp.kernel
def place_in_faces_v(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    u: wp.array(dtype=wp.vec3),
    eta: wp.array(dtype=float),
    face: wp.array(dtype=wp.vec3i),
    side: wp.array(dtype=wp.vec3i),
    bend: wp.array(dtype=float),
    parts: int,
    # outputs
    place: wp.array(dtype=wp.vec3),
    upward: wp.array(dtype=wp.vec3),
    speed: wp.array(dtype=wp.vec3),
    depth: wp.array(dtype=float),
    fine: wp.array(dtype=wp.vec3i),
):
    """Vertices within triangles, on the cubic patch over the three edges (a point-normal triangle), and all triangles.

    Args:
        x: [n] corners, m.
        normal: [n] unit normals.
        u: [n] velocities, m/s.
        eta: [n] thickness, m.
        face: [faces] corners.
        side: [faces] edges.
        bend: [edges] as for edges.
        parts: parts of an edge.
        place: [fine] positions, m.
        upward: [fine] unit normals.
        speed: [fine] velocities, m/s.
        depth: [fine] thickness, m.
        fine: [faces parts^2] corners of the small triangles.
    """
    f = wp.tid()
    corner = face[f]
    at = side[f]
    n = x.shape[0]
    edges = bend.shape[0]
    a = corner[0]
    b = corner[1]
    c = corner[2]
    ab = handle(x[a], x[b], normal[a], bend[at[0]])
    ac = handle(x[a], x[c], normal[a], bend[at[2]])
    ba = handle(x[b], x[a], normal[b], bend[at[0]])
    bc = handle(x[b], x[c], normal[b], bend[at[1]])
    ca = handle(x[c], x[a], normal[c], bend[at[2]])
    cb = handle(x[c], x[b], normal[c], bend[at[1]])
    mean = (ab + ac + ba + bc + ca + cb) / 6.0
    centre = mean + 0.5 * (mean - (x[a] + x[b] + x[c]) / 3.0)
    nab = middle_normal(x[a], x[b], normal[a], normal[b])
    nbc = middle_normal(x[b], x[c], normal[b], normal[c])
    nca = middle_normal(x[c], x[a], normal[c], normal[a])
    for j in range(1, parts - 1):
        for i in range(1, parts - j):
            s = float(i) / float(parts)
            t = float(j) / float(parts)
            r = 1.0 - s - t
            k = fine_vertex(corner, at, f, i, j, parts, n, edges)
            p = r * r * r * x[a] + s * s * s * x[b] + t * t * t * x[c]
            p += 3.0 * r * r * (s * ab + t * ac) + 3.0 * s * s * (r * ba + t * bc) + 3.0 * t * t * (r * ca + s * cb)
            place[k] = p + 6.0 * r * s * t * centre
            n2 = r * r * normal[a] + s * s * normal[b] + t * t * normal[c]
            upward[k] = wp.normalize(n2 + r * s * nab + s * t * nbc + t * r * nca)
            speed[k] = r * u[a] + s * u[b] + t * u[c]
            depth[k] = r * eta[a] + s * eta[b] + t * eta[c]
    k = f * parts * parts
    for j in range(parts):
        for i in range(parts - j):
            p0 = fine_vertex(corner, at, f, i, j, parts, n, edges)
            p1 = fine_vertex(corner, at, f, i + 1, j, parts, n, edges)
            p2 = fine_vertex(corner, at, f, i, j + 1, parts, n, edges)
            fine[k] = wp.vec3i(p0, p1, p2)
            k += 1
            if i + j < parts - 1:
                fine[k] = wp.vec3i(p1, fine_vertex(corner, at, f, i + 1, j + 1, parts, n, edges), p2)
                k += 1


@wp.kernel
def find_folded_v(
    place: wp.array(dtype=wp.vec3),
    upward: wp.array(dtype=wp.vec3),
    fine: wp.array(dtype=wp.vec3i),
    size: int,
    # outputs
    folded: wp.array(dtype=wp.int32),
):
    """How many small triangles of each triangle look inwards, against the normals of their corners. [faces].

    Args:
        place: [fine] positions, m.
        upward: [fine] unit normals.
        fine: [faces size] corners of the small triangles.
        size: small triangles of each.
        folded: [faces].
    """
    f = wp.tid()
    count = int(0)
    for k in range(f * size, (f + 1) * size):
        c = fine[k]
        face = wp.cross(place[c[1]] - place[c[0]], place[c[2]] - place[c[0]])
        if wp.dot(face, upward[c[0]] + upward[c[1]] + upward[c[2]]) < 0.0:
            count += 1
    folded[f] = count


@wp.kernel
def find_home_l(
    grid: wp.uint64,
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    rings: Rings,
    point: wp.array(dtype=wp.vec3),
    side: wp.array(dtype=wp.vec3),
    own: wp.array(dtype=wp.int32),
    near: float,
    radius: float,
    # outputs
    home: wp.array(dtype=wp.int32),
):
    """The nearest vertex of the same sheet for each L; -1 where none is within `radius`.

    Args:
        grid: hash grid over x.
        x: [n] vertices, m.
        normal: [n] unit normals.
        region: [n] region.
        rings: the mesh.
        point: [n_l] L, m.
        side: [n_l] their unit normals.
        own: [n_l] their region.
        near: distance within which it is for all but a few, m.
        radius: m.
        home: [n_l].
    """
    k = wp.tid()
    p = point[k]
    best = int(-1)
    reach = near
    while best < 0 and reach > 0.0:
        least = reach * reach
        for j in wp.hash_grid_query(grid, p, reach):
            d = wp.length_sq(x[j] - p)
            if d < least and region[j] == own[k] and rings.count[j] > 0 and wp.dot(normal[j], side[k]) > 0.0:
                least = d
                best = j
        reach = wp.where(reach < radius, radius, 0.0)
    home[k] = best


@wp.kernel
def slope_faces_v(
    x: wp.array(dtype=wp.vec3),
    face: wp.array(dtype=wp.vec3i),
    # outputs
    slope: wp.array2d(dtype=wp.vec3),
):
    """Gradients [faces, 2] (1/m) of the first two barycentric coordinates of each triangle, along it."""
    f = wp.tid()
    a = x[face[f][0]]
    b = x[face[f][1]]
    c = x[face[f][2]]
    n = wp.cross(b - a, c - a)
    square = wp.max(wp.dot(n, n), 1.0e-30)
    slope[f, 0] = wp.cross(n, c - b) / square
    slope[f, 1] = wp.cross(n, a - c) / square


@wp.kernel
def find_face_l(
    x: wp.array(dtype=wp.vec3),
    rings: Rings,
    face_at: wp.array(dtype=wp.int32),
    face: wp.array(dtype=wp.vec3i),
    slope: wp.array2d(dtype=wp.vec3),
    point: wp.array(dtype=wp.vec3),
    home: wp.array(dtype=wp.int32),
    # outputs
    lies_in: wp.array(dtype=wp.int32),
    share: wp.array(dtype=wp.vec3),
):
    """The triangle that each L lies over, of those around its home, and its barycentric coordinates there.

    Args:
        x: [n] vertices, m.
        rings: the mesh.
        face_at: [entries of the rings] triangle of a vertex, its entry and the next one; -1 for none.
        face: [faces] corners.
        slope: [faces, 2] gradients of the first two coordinates, 1/m.
        point: [n_l] L, m.
        home: [n_l] nearest vertex, -1 for none.
        lies_in: [n_l] triangle, -1 for none.
        share: [n_l] coordinates with respect to its corners, none below 0.
    """
    k = wp.tid()
    i = home[k]
    lies_in[k] = -1
    if i >= 0:
        best = float(-1.0e30)
        p = point[k]
        w = wp.vec3(0.0, 0.0, 0.0)
        for m in range(rings.start[i], rings.start[i] + rings.count[i]):
            f = face_at[m]
            if f >= 0 and best < 0.0:
                u = wp.dot(slope[f, 0], p - x[face[f][1]])
                v = wp.dot(slope[f, 1], p - x[face[f][2]])
                least = wp.min(u, wp.min(v, 1.0 - u - v))
                if least > best:
                    best = least
                    lies_in[k] = f
                    w = wp.vec3(u, v, 1.0 - u - v)
        if lies_in[k] >= 0:
            w = wp.vec3(wp.max(w[0], 0.0), wp.max(w[1], 0.0), wp.max(w[2], 0.0))
            share[k] = w / (w[0] + w[1] + w[2])


@wp.kernel
def spread_liquid(
    face: wp.array(dtype=wp.vec3i),
    side: wp.array(dtype=wp.vec3i),
    n: int,
    edges: int,
    parts: int,
    lies_in: wp.array(dtype=wp.int32),
    share: wp.array(dtype=wp.vec3),
    volume: wp.array(dtype=float),
    area: wp.array(dtype=float),
    black: wp.array(dtype=float),
    # outputs
    sums: wp.array(dtype=wp.vec3),
):
    """Volume, area and black area of L, shared among the corners of the small triangle each lies in. A single thread.

    Args:
        face: [faces] corners.
        side: [faces] edges.
        n: number of coarse vertices.
        edges: number of edges.
        parts: parts of an edge.
        lies_in: [n_l] triangle, -1 for none.
        share: [n_l] barycentric coordinates.
        volume: [n_l] m^3.
        area: [n_l] m^2.
        black: [n_l] 1 for black film, else 0.
        sums: [fine] volume, area, black area, added to.
    """
    for k in range(lies_in.shape[0]):
        f = lies_in[k]
        if f >= 0:
            s = share[k][1] * float(parts)
            t = share[k][2] * float(parts)
            i = wp.clamp(int(s), 0, parts - 1)
            j = wp.clamp(int(t), 0, parts - 1 - i)
            s = wp.clamp(s - float(i), 0.0, 1.0)
            t = wp.clamp(t - float(j), 0.0, 1.0)
            p1 = fine_vertex(face[f], side[f], f, i + 1, j, parts, n, edges)
            p2 = fine_vertex(face[f], side[f], f, i, j + 1, parts, n, edges)
            p0 = int(0)
            r = 1.0 - s - t
            w1 = float(s)
            w2 = float(t)
            if r >= 0.0 or i + j == parts - 1:
                r = wp.max(r, 0.0)
                p0 = fine_vertex(face[f], side[f], f, i, j, parts, n, edges)
            else:
                r = -r
                w1 = 1.0 - t
                w2 = 1.0 - s
                p0 = fine_vertex(face[f], side[f], f, i + 1, j + 1, parts, n, edges)
            q = wp.vec3(volume[k], area[k], area[k] * black[k]) / (r + w1 + w2)
            sums[p0] = sums[p0] + r * q
            sums[p1] = sums[p1] + w1 * q
            sums[p2] = sums[p2] + w2 * q


@wp.kernel
def spread_sums(fine: wp.array(dtype=wp.vec3i), sums: wp.array(dtype=wp.vec3), wider: wp.array(dtype=wp.vec3)):
    """Sums of each vertex and of those around it. A single thread.

    Args:
        fine: [small triangles] corners.
        sums: [fine] per vertex.
        wider: [fine] 0 in.
    """
    for f in range(fine.shape[0]):
        c = fine[f]
        # each neighbour is in two triangles
        total = 0.5 * (sums[c[0]] + sums[c[1]] + sums[c[2]])
        for m in range(3):
            wider[c[m]] = wider[c[m]] + total


@wp.kernel
def spread_area(
    fine: wp.array(dtype=wp.vec3i),
    place: wp.array(dtype=wp.vec3),
    # outputs
    area: wp.array(dtype=float),
):
    """A third of the triangles around each vertex: the integral of what is 1 there and linear between. A single thread.

    Args:
        fine: [small triangles] corners.
        place: [fine] positions, m.
        area: [fine] m^2, 0 in.
    """
    for f in range(fine.shape[0]):
        c = fine[f]
        third = wp.length(wp.cross(place[c[1]] - place[c[0]], place[c[2]] - place[c[0]])) / 6.0
        for m in range(3):
            area[c[m]] = area[c[m]] + third


@wp.kernel
def mean_depth_v(
    sums: wp.array(dtype=wp.vec3),
    scale: float,
    # outputs
    depth: wp.array(dtype=float),
    black: wp.array(dtype=wp.int32),
):
    """Thickness: volume over area of the L around; vertices without L keep what lies between the E.

    Args:
        sums: [fine] volume (m^3), area (m^2) and black area.
        scale: least area that counts, m^2.
        depth: [fine] thickness, m.
        black: [fine] 1 where most of the area is black.
    """
    k = wp.tid()
    s = sums[k]
    if s[1] > scale:
        depth[k] = s[0] / s[1]
        black[k] = wp.where(2.0 * s[2] > s[1], 1, 0)
