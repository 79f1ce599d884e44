"""Surface meshes from E: rings of neighbours made consistent, closed and triangulated.

A mesh is kept as a ring for each vertex: its neighbours, counterclockwise seen from outside. As long as every pair is
in both rings, the rings describe a closed oriented surface, whatever is in them: the face to the left of i -> j goes on
from j to the entry before i in the ring of j. What is left to do is to make all faces triangles.
"""

import warp as wp

from melp_warp.kernels.native import cut_cell
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.kernels.sph import tangent_basis

wp.set_module_options({"enable_backward": False})

FACING = wp.constant(-0.2)
"""Least cosine between the normals of two E of one sheet: beyond it they lie on the two sides of something thin."""

FLAT = wp.constant(1.0e-6)
"""Cotangents that sum to less below 0 belong to four points on a circle: either diagonal will do."""

NUDGE = wp.constant(1.0e-3)
"""Largest nudge over the reach."""

TURN = wp.constant(6.283185307179586)
"""All around, rad."""

PASSES = wp.constant(12)
"""Most rounds of flips around a place that was closed."""


@wp.struct
class Rings:
    """Ring i holds index[start[i]] to index[start[i] + count[i] - 1] and has room for room[i] entries."""

    start: wp.array(dtype=wp.int32)
    count: wp.array(dtype=wp.int32)
    room: wp.array(dtype=wp.int32)
    index: wp.array(dtype=wp.int32)


@wp.func
def place_in(rings: Rings, i: int, j: int) -> int:
    """Place of j in the ring of i, -1 where it is not there."""
    first = rings.start[i]
    for k in range(rings.count[i]):
        if rings.index[first + k] == j:
            return k
    return -1


@wp.func
def entry_after(rings: Rings, i: int, k: int) -> int:
    """The neighbour that follows place k in the ring of i."""
    n = k + 1
    if n == rings.count[i]:
        n = 0
    return rings.index[rings.start[i] + n]


@wp.func
def entry_before(rings: Rings, i: int, k: int) -> int:
    """The neighbour that comes before place k in the ring of i."""
    n = k - 1
    if n < 0:
        n = rings.count[i] - 1
    return rings.index[rings.start[i] + n]


@wp.func
def corner_after(rings: Rings, i: int, j: int) -> int:
    """The corner that follows i -> j around the face on its left; -1 where j does not know i."""
    k = place_in(rings, j, i)
    if k < 0:
        return -1
    return entry_before(rings, j, k)


@wp.func
def put_after(rings: Rings, i: int, j: int, v: int):
    """Put v into the ring of i, after j."""
    first = rings.start[i]
    k = rings.count[i]
    while k > 0 and rings.index[first + k - 1] != j:
        rings.index[first + k] = rings.index[first + k - 1]
        k -= 1
    rings.index[first + k] = v
    rings.count[i] = rings.count[i] + 1


@wp.func
def put_before(rings: Rings, i: int, j: int, v: int):
    """Put v into the ring of i, before j."""
    put_after(rings, i, entry_before(rings, i, place_in(rings, i, j)), v)


@wp.func
def take_out(rings: Rings, i: int, v: int):
    """Take v out of the ring of i."""
    first = rings.start[i]
    k = place_in(rings, i, v)
    rings.count[i] = rings.count[i] - 1
    while k < rings.count[i]:
        rings.index[first + k] = rings.index[first + k + 1]
        k += 1


@wp.func
def has_room(rings: Rings, i: int) -> bool:
    """Whether one more fits into the ring of i."""
    return rings.count[i] < rings.room[i]


@wp.func
def upright(x: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), a: int, b: int, c: int) -> float:
    """Cosine between a triangle and the normals of its corners: below 0 it is flipped."""
    face = wp.cross(x[b] - x[a], x[c] - x[a])
    return wp.dot(wp.normalize(face), wp.normalize(normal[a] + normal[b] + normal[c]))


@wp.func
def cotangent(p: wp.vec3, a: wp.vec3, b: wp.vec3) -> float:
    """Cotangent of the angle at p between a and b."""
    u = a - p
    v = b - p
    return wp.dot(u, v) / wp.max(wp.length(wp.cross(u, v)), 1.0e-30)


@wp.kernel
def find_nearest_v(
    grid: wp.uint64,
    source: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    radius: float,
    # outputs
    nearest: wp.array(dtype=wp.int32),
):
    """The nearest `source` point of each x; -1 where none is within `radius` (m)."""
    i = wp.tid()
    least = radius * radius
    best = int(-1)
    for j in wp.hash_grid_query(grid, x[i], radius):
        d = wp.length_sq(source[j] - x[i])
        if d < least:
            least = d
            best = j
    nearest[i] = best


@wp.kernel
def keep_apart_l(
    grid: wp.uint64,
    point: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    apart: wp.array(dtype=wp.float32),
    # outputs
    kept: wp.array(dtype=wp.int32),
):
    """Keep each L that lies far enough from all kept before; one thread.

    Args:
        grid: over `point`.
        point: [n] m.
        normal: [n] unit.
        region: [n].
        apart: [regions] least distance of kept ones of a sheet, m.
        kept: [n] zeroed; 1 for those that are kept.
    """
    for i in range(point.shape[0]):
        radius = apart[region[i]]
        free = wp.int32(1)
        for j in wp.hash_grid_query(grid, point[i], radius):
            if kept[j] == 1 and region[j] == region[i] and wp.dot(normal[i], normal[j]) > 0.2:
                if wp.length_sq(point[j] - point[i]) < radius * radius:
                    free = 0
                    break
        kept[i] = free


@wp.kernel
def list_facing_v(
    grid: wp.uint64,
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    reach: wp.array(dtype=float),
    stride: int,
    # outputs
    rows: Neighbors,
    most: wp.array(dtype=wp.int32),
):
    """List the vertices of the same sheet within reach, `stride` at most; `most` remembers how many there were.

    Args:
        grid: hash grid over x.
        x: [n] positions, m.
        normal: [n] outward unit normals.
        region: [n] region.
        reach: [regions] distance, m.
        stride: room of a row.
        rows: the lists.
        most: [1].
    """
    i = rows.first + wp.tid()
    p = x[i]
    own = region[i]
    radius = reach[own]
    first = rows.start[i]
    n = int(0)
    for j in wp.hash_grid_query(grid, p, radius):
        if j != i and region[j] == own and wp.length_sq(x[j] - p) <= radius * radius:
            if wp.dot(normal[i], normal[j]) > FACING:
                if n < stride:
                    rows.index[first + n] = j
                n += 1
    rows.stop[i] = first + wp.min(n, stride)
    if n > stride:
        wp.atomic_max(most, 0, n)


@wp.kernel
def nudge_v(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    reach: wp.array(dtype=float),
    n_e: int,
    # outputs
    nudged: wp.array(dtype=wp.vec3),
):
    """Positions moved along the surface by up to `NUDGE` of the reach, at random: no four lie on a circle any more.

    On a lattice any two opposite corners of a square may be neighbours; all corners must agree on which.

    Args:
        x: [n] positions, m.
        normal: [n] unit normals.
        region: [n] region.
        reach: [regions] m.
        n_e: number of E; rim points after them stay on their rim.
        nudged: [n] m.
    """
    i = wp.tid()
    nudged[i] = x[i]
    if i < n_e:
        e1, e2 = tangent_basis(normal[i])
        state = wp.rand_init(7, i)
        size = NUDGE * reach[region[i]]
        nudged[i] = x[i] + size * ((2.0 * wp.randf(state) - 1.0) * e1 + (2.0 * wp.randf(state) - 1.0) * e2)


@wp.kernel
def find_star_v(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    reach: wp.array(dtype=float),
    rows: Neighbors,
    # outputs
    star: Neighbors,
    weight: wp.array(dtype=float),
):
    """Star of each vertex: the neighbours across the edges of its Voronoi cell, in order.

    Args:
        x: [n] positions, m.
        normal: [n] outward unit normals.
        region: [n] region.
        reach: [regions] as of the lists, m.
        rows: neighbours of the same sheet.
        star: the stars.
        weight: [entries] scratch.
    """
    i = rows.first + wp.tid()
    e1, e2 = tangent_basis(normal[i])
    cut_cell(i, x, e1, e2, normal[i], rows, reach[region[i]], star, weight)


@wp.kernel
def open_star_v(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    ahead: wp.array(dtype=wp.int32),
    behind: wp.array(dtype=wp.int32),
    beyond: wp.array(dtype=wp.int32),
    n_e: int,
    # outputs
    star: Neighbors,
):
    """Stars of rim points, which come after the E: next point of the rim, the film, the one before, what is beyond.

    Args:
        x: [n] positions, m.
        normal: [n] unit normals.
        ahead: [rim] the next point of the rim, which has the film on its left.
        behind: [rim] the one before.
        beyond: [rim] the vertex that closes the mesh beyond this rim.
        n_e: number of E.
        star: the stars.
    """
    k = wp.tid()
    i = n_e + k
    e1 = wp.normalize(x[ahead[k]] - x[i])
    e2 = wp.cross(normal[i], e1)
    back = x[behind[k]] - x[i]
    end = wp.atan2(wp.dot(back, e2), wp.dot(back, e1))
    if end <= 0.0:
        end += TURN
    first = star.start[i]
    kept = int(0)
    least = float(0.0)
    # what lies between, by angle
    for _ in range(star.stop[i] - first):
        best = int(-1)
        low = end
        for m in range(first, star.stop[i]):
            j = star.index[m]
            d = x[j] - x[i]
            angle = wp.atan2(wp.dot(d, e2), wp.dot(d, e1))
            if angle < 0.0:
                angle += TURN
            if angle > least and angle < low and j != ahead[k] and j != behind[k]:
                low = angle
                best = j
        if best >= 0:
            # entries before `kept` are in order already and have smaller angles: swap the next one in
            at = first + kept
            for m in range(at, star.stop[i]):
                if star.index[m] == best:
                    star.index[m] = star.index[at]
                    star.index[at] = best
            kept += 1
            least = low
    k_last = first + kept
    for m in range(kept):
        star.index[k_last - m] = star.index[k_last - m - 1]
    star.index[first] = ahead[k]
    star.index[first + kept + 1] = behind[k]
    star.index[first + kept + 2] = beyond[k]
    star.stop[i] = first + kept + 3


@wp.func
def follows(star: Neighbors, i: int, a: int, b: int) -> bool:
    """Whether b follows a in the star of i."""
    first = star.start[i]
    last = star.stop[i]
    for k in range(first, last):
        if star.index[k] == a:
            n = k + 1
            if n == last:
                n = first
            return star.index[n] == b
    return False


@wp.kernel
def find_agreed_v(
    star: Neighbors,
    # outputs
    agreed: wp.array(dtype=wp.int32),
):
    """Whether each triangle (i, entry, next entry) is in the stars of all three corners. [entries], 0 or 1."""
    i = star.first + wp.tid()
    first = star.start[i]
    last = star.stop[i]
    for k in range(first, last):
        n = k + 1
        if n == last:
            n = first
        a = star.index[k]
        b = star.index[n]
        agreed[k] = wp.where(last - first > 2 and follows(star, a, b, i) and follows(star, b, i, a), 1, 0)


@wp.kernel
def keep_agreed_v(
    star: Neighbors,
    agreed: wp.array(dtype=wp.int32),
    # outputs
    rings: Rings,
):
    """Rings of the edges of agreed triangles. Both ends keep an edge or none, and no two cross."""
    i = star.first + wp.tid()
    first = star.start[i]
    last = star.stop[i]
    kept = int(0)
    for k in range(first, last):
        before = k - 1
        if before < first:
            before = last - 1
        if agreed[k] + agreed[before] > 0:
            rings.index[rings.start[i] + kept] = star.index[k]
            kept += 1
    rings.count[i] = kept


@wp.func
def root_of(piece: wp.array(dtype=wp.int32), i: int) -> int:
    """The first vertex of the piece of i; the way there is made shorter."""
    j = i
    while piece[j] != j:
        piece[j] = piece[piece[j]]
        j = piece[j]
    return j


@wp.kernel
def drop_pieces(
    region: wp.array(dtype=wp.int32),
    largest: wp.array(dtype=wp.int32),
    # outputs
    rings: Rings,
    piece: wp.array(dtype=wp.int32),
    size: wp.array(dtype=wp.int32),
):
    """Empty the rings of all but the largest piece of each region. A single thread.

    Args:
        region: [n] region.
        largest: [regions] first vertex of its largest piece, -1 in.
        rings: the rings.
        piece: [n] scratch.
        size: [n] scratch, 0 in.
    """
    n = region.shape[0]
    for i in range(n):
        piece[i] = i
    for i in range(n):
        for k in range(rings.count[i]):
            a = root_of(piece, i)
            b = root_of(piece, rings.index[rings.start[i] + k])
            if a < b:
                piece[b] = a
            elif b < a:
                piece[a] = b
    for i in range(n):
        a = root_of(piece, i)
        size[a] = size[a] + 1
    for i in range(n):
        if piece[i] == i and rings.count[i] > 0:
            best = largest[region[i]]
            if best < 0 or size[i] > size[best]:
                largest[region[i]] = i
    for i in range(n):
        a = root_of(piece, i)
        if a != largest[region[i]]:
            rings.count[i] = 0


@wp.kernel
def find_open_v(
    rings: Rings,
    # outputs
    opening: wp.array(dtype=wp.vec2i),
    found: wp.array(dtype=wp.int32),
):
    """Edges i -> j whose face is no triangle. A single thread.

    Args:
        rings: the rings.
        opening: [room] the edges.
        found: [1] their number; beyond the room they are counted only.
    """
    n = int(0)
    for i in range(rings.count.shape[0]):
        for k in range(rings.count[i]):
            j = rings.index[rings.start[i] + k]
            a = corner_after(rings, i, j)
            if corner_after(rings, j, a) != i or corner_after(rings, a, i) != j:
                if n < opening.shape[0]:
                    opening[n] = wp.vec2i(i, j)
                n += 1
    found[0] = n


@wp.func
def best_ear(
    rings: Rings,
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    corner: wp.array(dtype=wp.int32),
    count: int,
    lenient: bool,
) -> int:
    """The corner of a hole whose neighbours are nearest to each other, of those that may be joined; -1 for none."""
    best = int(-1)
    least = float(0.0)
    for m in range(count):
        a = corner[(m + count - 1) % count]
        b = corner[m]
        c = corner[(m + 1) % count]
        if a != c and place_in(rings, a, c) < 0 and has_room(rings, a) and has_room(rings, c):
            d = wp.length_sq(x[a] - x[c])
            if (best < 0 or d < least) and (lenient or upright(x, normal, a, b, c) > 0.0):
                best = m
                least = d
    return best


@wp.func
def fill_hole(
    rings: Rings,
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    corner: wp.array(dtype=wp.int32),
    corners: int,
    touched: wp.array(dtype=wp.int32),
) -> bool:
    """Triangulate the face with these corners, ear by ear; whether that was possible."""
    count = int(corners)
    for m in range(count):
        touched[corner[m]] = 1
    while count > 3:
        m = best_ear(rings, x, normal, corner, count, False)
        if m < 0:
            m = best_ear(rings, x, normal, corner, count, True)
        if m < 0:
            return False
        a = corner[(m + count - 1) % count]
        b = corner[m]
        c = corner[(m + 1) % count]
        put_after(rings, a, b, c)
        put_before(rings, c, b, a)
        count -= 1
        for k in range(m, count):
            corner[k] = corner[k + 1]
    return True


@wp.kernel
def fill_openings(
    opening: wp.array(dtype=wp.vec2i),
    found: int,
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    most: int,
    # outputs
    rings: Rings,
    corner: wp.array(dtype=wp.int32),
    touched: wp.array(dtype=wp.int32),
):
    """Triangulate every face of up to `most` corners. A single thread.

    Args:
        opening: [found] edges of faces that are no triangles.
        found: their number.
        x: [n] positions, m.
        normal: [n] outward unit normals.
        most: more corners than these are no hole to fill but the end of the film.
        rings: the rings.
        corner: [most] scratch.
        touched: [n] set to 1 at the corners.
    """
    for f in range(found):
        i = opening[f][0]
        j = opening[f][1]
        count = int(0)
        a = int(i)
        b = int(j)
        while count < most:
            corner[count] = a
            count += 1
            c = corner_after(rings, a, b)
            a = b
            b = c
            if a == i and b == j:
                break
        if a == i and b == j and count > 3:
            fill_hole(rings, x, normal, corner, count, touched)


@wp.func
def inside(x: wp.array(dtype=wp.vec3), p: wp.vec3, a: int, b: int, c: int) -> float:
    """Least barycentric coordinate of p over a triangle: above 0 inside, the less the farther out."""
    n = wp.cross(x[b] - x[a], x[c] - x[a])
    square = wp.max(wp.dot(n, n), 1.0e-30)
    u = wp.dot(wp.cross(x[c] - x[b], p - x[b]), n) / square
    v = wp.dot(wp.cross(x[a] - x[c], p - x[c]), n) / square
    return wp.min(u, wp.min(v, 1.0 - u - v))


@wp.func
def split_triangle(rings: Rings, v: int, a: int, b: int, c: int):
    """Put the vertex v into the triangle a, b, c."""
    first = rings.start[v]
    rings.index[first] = a
    rings.index[first + 1] = b
    rings.index[first + 2] = c
    rings.count[v] = 3
    put_after(rings, a, b, v)
    put_after(rings, b, c, v)
    put_after(rings, c, a, v)


@wp.func
def insert_vertex(
    rings: Rings, x: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), rows: Neighbors, n: int, v: int
) -> bool:
    """Put v into the triangle that holds it best, of those around its neighbours in the mesh; whether there is one."""
    best = float(-1.0e30)
    ia = int(-1)
    ib = int(-1)
    for k in range(rows.start[v], rows.stop[v]):
        i = rows.index[k]
        for m in range(rings.count[i]):
            a = rings.index[rings.start[i] + m]
            b = entry_after(rings, i, m)
            if a < n and b < n and corner_after(rings, a, b) == i:
                fits = has_room(rings, i) and has_room(rings, a) and has_room(rings, b)
                score = inside(x, x[v], i, a, b)
                away = wp.dot(x[v] - x[i], normal[i])
                # of triangles that hold it, the nearest sheet
                score = wp.min(score, 0.0) - wp.abs(away) / wp.length(x[a] - x[b])
                if fits and score > best and upright(x, normal, i, a, b) > 0.0:
                    best = score
                    ia = i
                    ib = a
    if ia < 0:
        return False
    split_triangle(rings, v, ia, ib, corner_after(rings, ia, ib))
    return True


@wp.kernel
def insert_missing(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    n: int,
    # outputs
    rings: Rings,
    touched: wp.array(dtype=wp.int32),
):
    """Put vertices without a ring into the triangle that they lie over. A single thread.

    Args:
        x: [.] positions, m.
        normal: [.] outward unit normals.
        rows: neighbours of the same sheet.
        n: number of vertices of the film.
        rings: the rings.
        touched: [.] set to 1 at what was put in.
    """
    before = int(-1)
    left = int(0)
    while left != before:
        before = left
        left = int(0)
        for v in range(n):
            if rings.count[v] == 0:
                if insert_vertex(rings, x, normal, rows, n, v):
                    touched[v] = 1
                else:
                    left += 1


@wp.func
def should_flip(
    x: wp.array(dtype=wp.vec3), normal: wp.array(dtype=wp.vec3), i: int, j: int, left: int, right: int
) -> bool:
    """Whether left - right is the better diagonal: none of its triangles flipped, or Delaunay where both would do."""
    now = wp.min(upright(x, normal, i, j, left), upright(x, normal, j, i, right))
    then = wp.min(upright(x, normal, i, right, left), upright(x, normal, j, left, right))
    if now <= 0.0 or then <= 0.0:
        return then > now + 1.0e-3
    return cotangent(x[left], x[i], x[j]) + cotangent(x[right], x[i], x[j]) < -FLAT


@wp.kernel
def flip_edges(
    x: wp.array(dtype=wp.vec3),
    normal: wp.array(dtype=wp.vec3),
    n: int,
    # outputs
    rings: Rings,
    touched: wp.array(dtype=wp.int32),
    flipped: wp.array(dtype=wp.int32),
):
    """Flip edges around touched vertices until all are Delaunay, on the surface of triangles. A single thread.

    Args:
        x: [.] positions, m.
        normal: [.] outward unit normals.
        n: number of vertices of the film.
        rings: the rings.
        touched: [.] 1 where to look.
        flipped: [1] number of flips.
    """
    total = int(0)
    for _ in range(PASSES):
        flips = int(0)
        for i in range(n):
            if touched[i] > 0:
                k = int(0)
                while k < rings.count[i]:
                    j = rings.index[rings.start[i] + k]
                    left = corner_after(rings, i, j)
                    right = corner_after(rings, j, i)
                    free = j < n and left < n and right < n and left != right
                    free = free and rings.count[i] > 3 and rings.count[j] > 3
                    free = free and corner_after(rings, j, left) == i and corner_after(rings, i, right) == j
                    free = free and has_room(rings, left) and has_room(rings, right)
                    if free and place_in(rings, left, right) < 0 and should_flip(x, normal, i, j, left, right):
                        take_out(rings, i, j)
                        take_out(rings, j, i)
                        put_after(rings, left, i, right)
                        put_after(rings, right, j, left)
                        touched[left] = 1
                        touched[right] = 1
                        touched[j] = 1
                        flips += 1
                    else:
                        k += 1
        total += flips
        if flips == 0:
            break
    flipped[0] = total


@wp.kernel
def count_faces_v(
    rings: Rings,
    n: int,
    # outputs
    faces: wp.array(dtype=wp.int32),
    edges: wp.array(dtype=wp.int32),
):
    """Triangles of which each vertex is the first, and edges to later vertices.

    Args:
        rings: the rings.
        n: number of vertices of the film; those beyond close its rims and do not count.
        faces: [n].
        edges: [n].
    """
    i = wp.tid()
    found = int(0)
    ahead = int(0)
    for k in range(rings.count[i]):
        a = rings.index[rings.start[i] + k]
        b = entry_after(rings, i, k)
        if a < n and a > i:
            ahead += 1
        if a < n and b < n:
            if i < a and i < b and corner_after(rings, a, b) == i and corner_after(rings, i, a) == b:
                found += 1
    faces[i] = found
    edges[i] = ahead


@wp.func
def edge_of(rings: Rings, start: wp.array(dtype=wp.int32), n: int, a: int, b: int) -> int:
    """Number of the edge between two vertices."""
    low = wp.min(a, b)
    high = wp.max(a, b)
    place = start[low]
    for k in range(rings.count[low]):
        j = rings.index[rings.start[low] + k]
        if j == high:
            return place
        if j < n and j > low:
            place += 1
    return -1


@wp.kernel
def list_faces_v(
    rings: Rings,
    n: int,
    face_start: wp.array(dtype=wp.int32),
    edge_start: wp.array(dtype=wp.int32),
    # outputs
    face: wp.array(dtype=wp.vec3i),
    side: wp.array(dtype=wp.vec3i),
    edge: wp.array(dtype=wp.vec2i),
    face_at: wp.array(dtype=wp.int32),
):
    """The triangles, the numbers of the edges after each of their corners, and the edges, lower vertex first.

    Args:
        rings: the rings.
        n: number of vertices of the film.
        face_start: [n] number of the first triangle of each vertex.
        edge_start: [n] number of its first edge.
        face: [faces] corners.
        side: [faces] edges.
        edge: [edges] ends.
        face_at: [entries of the rings] triangle of a vertex, its entry and the next one; -1 in, and for none.
    """
    i = wp.tid()
    f = face_start[i]
    e = edge_start[i]
    for k in range(rings.count[i]):
        a = rings.index[rings.start[i] + k]
        b = entry_after(rings, i, k)
        if a < n and a > i:
            edge[e] = wp.vec2i(i, a)
            e += 1
        if a < n and b < n and i < a and i < b:
            if corner_after(rings, a, b) == i and corner_after(rings, i, a) == b:
                face[f] = wp.vec3i(i, a, b)
                face_at[rings.start[i] + k] = f
                face_at[rings.start[a] + place_in(rings, a, b)] = f
                face_at[rings.start[b] + place_in(rings, b, i)] = f
                side[f] = wp.vec3i(
                    edge_of(rings, edge_start, n, i, a),
                    edge_of(rings, edge_start, n, a, b),
                    edge_of(rings, edge_start, n, b, i),
                )
                f += 1


@wp.kernel
def mean_near_v(
    grid: wp.uint64,
    x: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    area: wp.array(dtype=float),
    value: wp.array(dtype=float),
    point: wp.array(dtype=wp.vec3),
    of: wp.array(dtype=wp.int32),
    radius: float,
    rounds: int,
    # outputs
    mean: wp.array(dtype=float),
):
    """What particles of a region have near points, (1 - d/r)^2 a the weights; r doubles until there are any. [k].

    Args:
        grid: with the particles.
        x: [n] m.
        region: [n] index of each one's region.
        area: [n] m^2.
        value: [n] what they have on it.
        point: [k] m.
        of: [k] region of each point.
        radius: the first r, m.
        rounds: how often r may double.
        mean: [k] 0 where there are none.
    """
    i = wp.tid()
    r = radius
    for _round in range(rounds + 1):
        weight = float(0.0)
        total = float(0.0)
        query = wp.hash_grid_query(grid, point[i], r)
        j = int(0)
        while wp.hash_grid_query_next(query, j):
            d = wp.length(x[j] - point[i])
            if region[j] == of[i] and d < r:
                w = (1.0 - d / r) * (1.0 - d / r) * area[j]
                weight += w
                total += w * value[j]
        if weight > 0.0:
            mean[i] = total / weight
            return
        r = 2.0 * r
