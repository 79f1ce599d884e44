"""Neighbour lists from a hash grid, stored as one index array with row starts (CSR)."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Neighbors:
    """Row i holds index[start[i]:start[i + 1]]."""

    start: wp.array(dtype=wp.int32)
    index: wp.array(dtype=wp.int32)


@wp.kernel
def count_neighbors(
    grid: wp.uint64,
    x: wp.array(dtype=wp.vec3),
    source: wp.array(dtype=wp.vec3),
    radius: float,
    same: int,
    # outputs
    count: wp.array(dtype=wp.int32),
):
    """Count the `source` points within `radius` of each x; `same` = 1 leaves a point out of its own row."""
    i = wp.tid()
    n = int(0)
    p = x[i]
    for j in wp.hash_grid_query(grid, p, radius):
        if wp.length_sq(source[j] - p) <= radius * radius and (same == 0 or j != i):
            n += 1
    count[i] = n


@wp.kernel
def fill_neighbors(
    grid: wp.uint64,
    x: wp.array(dtype=wp.vec3),
    source: wp.array(dtype=wp.vec3),
    radius: float,
    same: int,
    # outputs
    rows: Neighbors,
    overflow: wp.array(dtype=wp.int32),
):
    """Write the rows counted by `count_neighbors`; `overflow` keeps the largest number of entries wanted."""
    i = wp.tid()
    p = x[i]
    k = rows.start[i]
    for j in wp.hash_grid_query(grid, p, radius):
        if wp.length_sq(source[j] - p) <= radius * radius and (same == 0 or j != i):
            if k < rows.index.shape[0]:
                rows.index[k] = j
            k += 1
    wp.atomic_max(overflow, 0, k)


@wp.kernel
def clamp_rows(capacity: int, start: wp.array(dtype=wp.int32)):
    """Keep row starts inside the index array, so that an overflow never reads beyond it."""
    i = wp.tid()
    start[i] = wp.min(start[i], capacity)


@wp.kernel
def count_columns(rows: Neighbors, limit: int, count: wp.array(dtype=wp.int32)):
    """Count how often each index below `limit` occurs in the rows."""
    i = wp.tid()
    for k in range(rows.start[i], rows.start[i + 1]):
        j = rows.index[k]
        if j < limit:
            wp.atomic_add(count, j, 1)


@wp.kernel
def transpose_rows(
    rows: Neighbors,
    limit: int,
    # outputs
    cursor: wp.array(dtype=wp.int32),
    columns: Neighbors,
    overflow: wp.array(dtype=wp.int32),
):
    """Write the transposed list; `cursor` starts as a copy of its row starts."""
    i = wp.tid()
    for k in range(rows.start[i], rows.start[i + 1]):
        j = rows.index[k]
        if j < limit:
            place = wp.atomic_add(cursor, j, 1)
            if place < columns.index.shape[0]:
                columns.index[place] = i
            else:
                wp.atomic_max(overflow, 0, place + 1)


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
