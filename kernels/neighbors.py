"""Neighbour lists from a hash grid, stored as one index array with the start and stop of each row."""

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


@wp.kernel
def fill_neighbors(
    grid: wp.uint64,
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
):
    """List the `source` points within `radius` of each x in rows of room `stride`, in one query.

    `wanted` is the length of the row asked for; what is beyond `stride` is left out. `pick` is SAME for
    points of the same set and region but not the point itself, OTHER for those of other regions, and ALL for the same
    region of another set; a null `region` stands for a single one. Row starts are set beforehand.
    """
    i = rows.first + wp.tid()
    p = x[i]
    first = rows.start[i]
    n = int(0)
    for j in wp.hash_grid_query(grid, p, radius):
        wanted_here = pick != SAME or j != i
        if region:
            wanted_here = wanted_here and (region[j] == region_x[i]) != (pick == OTHER)
        if wanted_here and wp.length_sq(source[j] - p) <= radius * radius:
            if n < stride:
                rows.index[first + n] = j
            n += 1
    rows.stop[i] = first + wp.min(n, stride)
    wanted[i] = n


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
def transpose_rows(rows: Neighbors, limit: int, columns: Neighbors):
    """Write the transposed list; columns.stop starts as a copy of columns.start. There is room for every entry."""
    i = wp.tid()
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < limit:
            columns.index[wp.atomic_add(columns.stop, j, 1)] = i


@wp.kernel
def reset_travel(which: int, travel: wp.array(dtype=float)):
    """Forget the distance moved before list `which` was built."""
    travel[which] = 0.0


@wp.kernel
def add_travel(part: wp.array(dtype=float), slot: int, travel: wp.array(dtype=float)):
    """Add the largest part to the distances moved; slot 2 for E, 3 for L. See `melp_warp.neighbors.NeighborLists`."""
    far = float(0.0)
    for c in range(part.shape[0]):
        far = wp.max(far, part[c])
    travel[slot] = far
    travel[1] = travel[1] + far
    if slot == 2:
        travel[0] = travel[0] + far
