"""Neighbour lists from a grid of cells, stored as one index array with the start and stop of each row."""

import warp as wp

wp.set_module_options({"enable_backward": False})


SAME = wp.constant(0)
OTHER = wp.constant(1)
ALL = wp.constant(2)


@wp.struct
class Neighbors:
    """Row i holds index[start[i]:stop[i]].

    A kernel whose row is `rows.first + wp.tid()` and that writes that row alone is shared by CPU cores, see
    `melp_warp.launch`: each is given its own `first`, which is 0 elsewhere.
    """

    start: wp.array(dtype=wp.int32)
    stop: wp.array(dtype=wp.int32)
    index: wp.array(dtype=wp.int32)
    first: int


@wp.struct
class Cells:
    """Points by the cell they lie in: row c of `points` holds those in cell c of a grid that wraps around.

    There are `side` cells each way, a power of two, of `width` (m). See `cells_around` for what is near a place.
    """

    points: Neighbors
    width: float
    side: int


@wp.func
def cell_coordinate(x: float) -> int:
    """Cell that a coordinate in cells lies in."""
    return int(wp.floor(x))


@wp.func
def cell_number(x: int, y: int, z: int, side: int) -> int:
    """Number of a cell in a grid that wraps around after `side` cells, a power of two, each way."""
    last = side - 1
    return ((z & last) * side + (y & last)) * side + (x & last)


@wp.func
def cells_around(p: wp.vec3, radius: float, cells: Cells):
    """First and last cell each way that reach within `radius` of p, no cell of the grid twice."""
    inverse = 1.0 / cells.width
    low = wp.vec3i()
    high = wp.vec3i()
    for a in range(3):
        low[a] = cell_coordinate((p[a] - radius) * inverse)
        high[a] = wp.min(cell_coordinate((p[a] + radius) * inverse), low[a] + cells.side - 1)
    return low, high


@wp.kernel
def find_cell(x: wp.array(dtype=wp.vec3), cells: Cells, cell: wp.array(dtype=wp.int32)):
    """Cell that each point lies in. [n]."""
    i = wp.tid()
    p = x[i] * (1.0 / cells.width)
    cell[i] = cell_number(cell_coordinate(p[0]), cell_coordinate(p[1]), cell_coordinate(p[2]), cells.side)


@wp.kernel
def fill_neighbors(
    cells: Cells,
    x: wp.array(dtype=wp.vec3),
    source: wp.array(dtype=wp.vec3),
    radius: float,
    region_x: wp.array(dtype=wp.int32),
    region: wp.array(dtype=wp.int32),
    pick: int,
    stride: int,
    # outputs
    rows: Neighbors,
    wanted: wp.array(dtype=wp.int32),
    most: wp.array(dtype=wp.int32),
):
    """List the `source` points within `radius` of each x in rows of room `stride`, in one query.

    `cells` hold the source points. `wanted` is the length of the row asked for; what is beyond `stride` is left out,
    and `most` remembers that. `pick` is SAME for points of the same set and region but not the point itself, OTHER for
    those of other regions, and ALL for the same region of another set; a null `region` stands for a single one. Row
    starts are set beforehand.
    """
    i = rows.first + wp.tid()
    p = x[i]
    first = rows.start[i]
    n = int(0)
    low, high = cells_around(p, radius, cells)
    for cz in range(low[2], high[2] + 1):
        for cy in range(low[1], high[1] + 1):
            for cx in range(low[0], high[0] + 1):
                c = cell_number(cx, cy, cz, cells.side)
                for k in range(cells.points.start[c], cells.points.stop[c]):
                    j = cells.points.index[k]
                    if wp.length_sq(source[j] - p) <= radius * radius:
                        wanted_here = pick != SAME or j != i
                        if region:
                            wanted_here = wanted_here and (region[j] == region_x[i]) != (pick == OTHER)
                        if wanted_here:
                            if n < stride:
                                rows.index[first + n] = j
                            n += 1
    rows.stop[i] = first + wp.min(n, stride)
    wanted[i] = n
    if n > stride:
        wp.atomic_max(most, 0, n)


@wp.kernel
def return_strays_l(
    x_e: wp.array(dtype=wp.vec3),
    region_e: wp.array(dtype=wp.int32),
    near: Neighbors,
    region_l: wp.array(dtype=wp.int32),
    n_e: int,
    r: float,
    stride: int,
    # outputs
    x_l: wp.array(dtype=wp.vec3),
    rows: Neighbors,
    wanted: wp.array(dtype=wp.int32),
):
    """Put each L without an E within r onto the nearest E of its region, and list that E and its neighbours for it.

    Its liquid then stays with the film. All E are looked at, which strays, being few, can afford.

    Args:
        x_e: [n] m.
        region_e: [n] region of each E.
        near: E:E neighbours.
        region_l: [n_l] region of each L.
        n_e: number of E; particles from here on are boundary.
        r: support radius, m.
        stride: room of a row of `rows`.
        x_l: [n_l] m.
        rows: L:E neighbours.
        wanted: [n_l] length of the row that was asked for; -1 for a stray.
    """
    i = rows.first + wp.tid()
    p = x_l[i]
    first = rows.start[i]
    astray = bool(True)
    for k in range(first, rows.stop[i]):
        j = rows.index[k]
        if j < n_e and wp.length_sq(x_e[j] - p) < r * r:
            astray = False
            break
    if astray:
        nearest = float(1.0e30)
        home = int(-1)
        for j in range(n_e):
            dd = wp.length_sq(x_e[j] - p)
            if region_e[j] == region_l[i] and dd < nearest:
                nearest = dd
                home = j
        if home >= 0:
            x_l[i] = x_e[home]
            rows.index[first] = home
            n = int(1)
            for k in range(near.start[home], near.stop[home]):
                if n < stride:
                    rows.index[first + n] = near.index[k]
                    n += 1
            rows.stop[i] = first + n
            wanted[i] = -1


@wp.kernel
def count_columns(rows: Neighbors, limit: int, count: wp.array(dtype=wp.int32)):
    """Count how often each index below `limit` occurs in the rows."""
    i = wp.tid()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < limit:
            wp.atomic_add(count, j, 1)


@wp.kernel
def open_columns(count: wp.array(dtype=wp.int32), taken: wp.array(dtype=wp.int32), columns: Neighbors):
    """Give each column room for `count` entries; `taken` starts at 0 and counts the room given."""
    i = wp.tid()
    start = wp.atomic_add(taken, 0, count[i])
    columns.start[i] = start
    columns.stop[i] = start


@wp.kernel
def transpose_rows(rows: Neighbors, limit: int, columns: Neighbors):
    """Write the transposed list into columns that are empty and have room for every entry."""
    i = wp.tid()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < limit:
            columns.index[wp.atomic_add(columns.stop, j, 1)] = i


@wp.kernel
def sort_rows(rows: Neighbors):
    """Put short rows in order: on a GPU they are filled in any."""
    i = rows.first + wp.tid()
    start = rows.start[i]
    for k in range(start + 1, rows.stop[i]):
        j = rows.index[k]
        place = int(k)
        while place > start and rows.index[place - 1] > j:
            rows.index[place] = rows.index[place - 1]
            place -= 1
        rows.index[place] = j


@wp.kernel
def find_stale_e(skin: float, travel: wp.array(dtype=float), stale: wp.array(dtype=wp.int32)):
    """Whether pairs of E could be missing: two may have closed in by twice the way of one."""
    stale[0] = wp.where(2.0 * travel[0] > skin, 1, 0)


@wp.kernel
def find_stale_l(skin: float, travel: wp.array(dtype=float), stale: wp.array(dtype=wp.int32)):
    """Whether pairs of E and L could be missing before a step ends that is up to half as long again as the last one."""
    stale[0] = wp.where(travel[1] + 1.5 * (travel[2] + travel[3]) > skin, 1, 0)


@wp.kernel
def forget_leaps(travel: wp.array(dtype=float)):
    """Forget the largest distances moved in a step so far."""
    travel[4] = 0.0
    travel[5] = 0.0


@wp.kernel
def expire_travel(travel: wp.array(dtype=float)):
    """Make the lists between E and L stale, whatever moved."""
    travel[1] = 1.0e30


@wp.kernel
def count_build(which: int, travel: wp.array(dtype=float), builds: wp.array(dtype=wp.int32)):
    """Count a build of list `which` and forget the distance moved before it."""
    travel[which] = 0.0
    builds[which] = builds[which] + 1


@wp.kernel
def add_travel(part: wp.array(dtype=float), slot: int, travel: wp.array(dtype=float)):
    """Add the largest part to the distances moved; slot 2 for E, 3 for L. See `melp_warp.neighbors.NeighborLists`."""
    far = float(0.0)
    for c in range(part.shape[0]):
        far = wp.max(far, part[c])
    travel[slot] = far
    travel[slot + 2] = wp.max(travel[slot + 2], far)
    travel[1] = travel[1] + far
    if slot == 2:
        travel[0] = travel[0] + far
