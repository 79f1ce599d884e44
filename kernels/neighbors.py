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
    `melp_warp.device.launch`: each is given its own `first`, which is 0 elsewhere.
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
    most: wp.array(dtype=wp.int32),
):
    """List the `source` points within `radius` of each x in rows of room `stride`, in one query.

    `wanted` is the length of the row asked for; what is beyond `stride` is left out, and `most` remembers that. `pick`
    is SAME for points of the same set and region but not the point itself, OTHER for those of other regions, and ALL
    for the same region of another set; a null `region` stands for a single one. Row starts are set beforehand.
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
    if n > stride:
        wp.atomic_max(most, 0, n)


@wp.kernel
def forget_leaps(travel: wp.array(dtype=float)):
    """Forget the largest distances moved in a step so far."""
    travel[4] = 0.0
    travel[5] = 0.0


@wp.kernel
def find_late(skin: float, which: int, travel: wp.array(dtype=float), late: wp.array(dtype=wp.int32)):
    """Whether list `which` is used when pairs could be missing: two E may have closed in by twice the way of one."""
    if wp.where(which == 0, 2.0, 1.0) * travel[which] > skin:
        late[0] = 1


@wp.kernel
def reset_travel(which: int, travel: wp.array(dtype=float)):
    """Forget the distance moved before list `which` was built."""
    travel[which] = 0.0


@wp.kernel
def add_travel(part: wp.array(dtype=float), slot: int, travel: wp.array(dtype=float)):
    """Add the largest part to the distances moved; slot 2 for E, 3 for L. See `stages.neighbors.NeighborLists`."""
    far = float(0.0)
    for c in range(part.shape[0]):
        far = wp.max(far, part[c])
    travel[slot] = far
    travel[slot + 2] = wp.max(travel[slot + 2], far)
    travel[1] = travel[1] + far
    if slot == 2:
        travel[0] = travel[0] + far
