"""Pairs of E and L by the home of each L, the E nearest to it.

A wide E:E row of the home holds every E near the L: its list is picked from these, without a grid. The other way round
L are sorted by their homes, and those near an E are in the blocks of the E in its wide row: `rows.gather_blocks`.
"""

import warp as wp

from melp_warp.kernels.native import list_around_home
from melp_warp.kernels.neighbors import Neighbors

wp.set_module_options({"enable_backward": False})

WALK = wp.constant(3)
"""Steps from home to home before an L that went far is looked up in the grid."""


@wp.func
def put_boundary_last(first: int, stop: int, limit: int, index: wp.array(dtype=wp.int32)):
    """Reorder index[first:stop] so that entries from `limit` on are the last."""
    low = int(first)
    high = int(stop - 1)
    while low < high:
        j = index[low]
        if j < limit:
            low += 1
        else:
            index[low] = index[high]
            index[high] = j
            high -= 1


@wp.func
def list_by_grid(
    grid: wp.uint64,
    p: wp.vec3,
    x: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    own: int,
    radius: float,
    limit: int,
    begin: int,
    stride: int,
    out: wp.array(dtype=wp.int32),
) -> wp.vec2i:
    """As `list_around_home`, of all in region `own` (-1: any); the nearest is -1 where there is none."""
    n = int(0)
    nearest = int(-1)
    least = float(1.0e30)
    for j in wp.hash_grid_query(grid, p, radius):
        dd = wp.length_sq(x[j] - p)
        if dd <= radius * radius and (own < 0 or region[j] == own):
            if n < stride:
                out[begin + n] = j
            n += 1
            if j < limit and dd < least:
                least = dd
                nearest = j
    put_boundary_last(begin, begin + wp.min(n, stride), limit, out)
    return wp.vec2i(n, nearest)


@wp.kernel
def part_rows_e(limit: int, rows: Neighbors):
    """Put boundary particles, from index `limit` on, last in their rows."""
    i = rows.first + wp.tid()
    put_boundary_last(rows.start[i], rows.stop[i], limit, rows.index)


@wp.kernel
def fill_neighbors_l(
    grid: wp.uint64,
    x_l: wp.array(dtype=wp.vec3),
    x_e: wp.array(dtype=wp.vec3),
    radius: float,
    region_l: wp.array(dtype=wp.int32),
    region_e: wp.array(dtype=wp.int32),
    wide: Neighbors,
    n_e: int,
    margin: float,
    stride: int,
    # outputs
    home: wp.array(dtype=wp.int32),
    rows: Neighbors,
    wanted: wp.array(dtype=wp.int32),
    most: wp.array(dtype=wp.int32),
):
    """List the E and boundary particles within `radius` of each L, E first, and find its home anew.

    The L is looked for around its old home; one that is nowhere near is looked up in the grid.

    Args:
        grid: of x_e.
        x_l: [n_l] m.
        x_e: [n] m.
        radius: m.
        region_l: [n_l] region of each L; null for a single one.
        region_e: [n] region of each E.
        wide: E:E neighbours within `radius` + `margin`, boundary particles last.
        n_e: number of E; particles from here on are boundary.
        margin: distance from its home within which an L's neighbours are in the wide row, m.
        stride: room of a row.
        home: [n_l] nearest E; that before in, new out; kept where no E is near.
        rows: L:E neighbours; starts are set beforehand.
        wanted: [n_l] length of the row asked for; what is beyond `stride` is left out.
        most: [1] the largest of those, over all builds.
    """
    i = rows.first + wp.tid()
    p = x_l[i]
    first = rows.start[i]
    at = home[i]
    astray = bool(False)
    if region_l:
        astray = region_e[at] != region_l[i]
    n = int(-1)
    for _ in range(WALK):
        if n < 0 and not astray:
            found = list_around_home(at, p, x_e, wide, radius, n_e, first, stride, rows.index)
            if wp.length_sq(x_e[at] - p) <= margin * margin:
                n = found[0]
            at = found[1]
    if n < 0:
        own = int(-1)
        if region_l:
            own = region_l[i]
        found = list_by_grid(grid, p, x_e, region_e, own, radius, n_e, first, stride, rows.index)
        n = found[0]
        if found[1] >= 0:
            at = found[1]
    home[i] = at
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
    home: wp.array(dtype=wp.int32),
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
        home: [n_l] nearest E, where one is near.
        x_l: [n_l] m.
        rows: L:E neighbours.
        wanted: [n_l] length of the row that was asked for; -1 for a stray.
    """
    i = rows.first + wp.tid()
    p = x_l[i]
    first = rows.start[i]
    at = home[i]
    if region_e[at] != region_l[i] or wp.length_sq(x_e[at] - p) >= r * r:
        nearest = float(1.0e30)
        at = int(-1)
        for j in range(n_e):
            dd = wp.length_sq(x_e[j] - p)
            if region_e[j] == region_l[i] and dd < nearest:
                nearest = dd
                at = j
        if at >= 0:
            home[i] = at
            x_l[i] = x_e[at]
            rows.index[first] = at
            n = int(1)
            for k in range(near.start[at], near.stop[at]):
                if n < stride:
                    rows.index[first + n] = near.index[k]
                    n += 1
            put_boundary_last(first, first + n, n_e, rows.index)
            rows.stop[i] = first + n
            wanted[i] = -1


@wp.kernel
def key_l(
    x_l: wp.array(dtype=wp.vec3),
    x_e: wp.array(dtype=wp.vec3),
    home: wp.array(dtype=wp.int32),
    margin: float,
    n_e: int,
    # outputs
    key: wp.array(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
):
    """What L are sorted by: their home, or n_e where it is farther than `margin`; and the order to sort. [n_l]."""
    i = wp.tid()
    key[i] = wp.where(wp.length_sq(x_l[i] - x_e[home[i]]) <= margin * margin, home[i], n_e)
    order[i] = i


@wp.kernel
def start_blocks_l(
    key: wp.array(dtype=wp.int32),
    order: wp.array(dtype=wp.int32),
    region: wp.array(dtype=wp.int32),
    n_l: int,
    # outputs
    start: wp.array(dtype=wp.int32),
    place: wp.array(dtype=wp.int32),
    region_sorted: wp.array(dtype=wp.int32),
):
    """Blocks of equal key: where each starts and, for each L, its place.

    Args:
        key: [n_l] sorted keys.
        order: [n_l] the L of each.
        region: [n_l] region of each L.
        n_l: number of L.
        start: [n_e + 2] first place of each key, n_l beyond the last; thread m writes those that no earlier key has.
        place: [n_l] place of each L.
        region_sorted: [n_l] region of the L at each place.
    """
    m = wp.tid()
    place[order[m]] = m
    region_sorted[m] = region[order[m]]
    before = int(0)
    if m > 0:
        before = key[m - 1] + 1
    for h in range(before, key[m] + 1):
        start[h] = m
    if m == n_l - 1:
        for h in range(key[m] + 1, start.shape[0]):
            start[h] = n_l


@wp.kernel
def measure_blocks_e(
    x_e: wp.array(dtype=wp.vec3),
    x_l: wp.array(dtype=wp.vec3),
    order: wp.array(dtype=wp.int32),
    start: wp.array(dtype=wp.int32),
    skin: float,
    # outputs
    reach: wp.array(dtype=float),
):
    """Largest distance of the L of each block from its home, and a skin for their motion. [n_e], m."""
    i = wp.tid()
    far = float(0.0)
    for m in range(start[i], start[i + 1]):
        far = wp.max(far, wp.length_sq(x_l[order[m]] - x_e[i]))
    reach[i] = wp.sqrt(far) + skin
