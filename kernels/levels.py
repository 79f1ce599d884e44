"""Ever coarser sets of the points of a film, and what they add to a preconditioner (Bramble, Pasciak and Xu 1990)."""

import warp as wp

from melp_warp.kernels.native import sum_products_of, sum_row, sum_shares, sum_within
from melp_warp.kernels.neighbors import Neighbors

wp.set_module_options({"enable_backward": False})

OPEN = wp.constant(0)
CHOSEN = wp.constant(1)
COVERED = wp.constant(2)

FIRST, SECOND = wp.constant(wp.uint32(0x7FEB352D)), wp.constant(wp.uint32(0x846CA68B))
"""Odd factors of `rank_of`."""

EDGE, FAR_EDGE = wp.constant(2.0), wp.constant(16.0)
"""How soon what a coarser level adds to the finest one, and to others, fades out where points are held."""

STIFF = wp.constant(1.25)
"""Stiffness of a coarse point over the mean of the finer ones that it stands for: on a surface, about the same."""


@wp.func
def rank_of(i: int) -> wp.uint32:
    """A number that no other point has, in no order: each step of the mixing can be undone."""
    h = wp.uint32(i)
    h = (h ^ (h >> wp.uint32(16))) * FIRST
    h = (h ^ (h >> wp.uint32(15))) * SECOND
    return h ^ (h >> wp.uint32(16))


@wp.func
def hat(offset: wp.vec3, r: float) -> float:
    """(1 - d^2/r^2)^2, 0 from r on."""
    inside = wp.max(1.0 - wp.length_sq(offset) / (r * r), 0.0)
    return inside * inside


@wp.kernel
def open_points_p(
    region: wp.array(dtype=wp.int32),
    # outputs
    state: wp.array(dtype=wp.int32),
):
    """Leave it open which points go on to the next level; empty places, of region below 0, do not."""
    i = wp.tid()
    state[i] = wp.where(region[i] < 0, COVERED, OPEN)


@wp.kernel
def choose_points_p(
    x: wp.array(dtype=wp.vec3),
    state: wp.array(dtype=wp.int32),
    rows: Neighbors,
    r: float,
    # outputs
    chosen: wp.array(dtype=wp.int32),
):
    """Choose the open points that rank above all open ones within r (Luby 1986).

    Args:
        x: [n] m.
        state: [n] OPEN, CHOSEN or COVERED.
        rows: neighbours; those of index >= n are none.
        r: m.
        chosen: [n] 1 for those that are chosen now.
    """
    i = rows.first + wp.tid()
    first = wp.where(state[i] == OPEN, 1, 0)
    if first == 1:
        for k in range(rows.start[i], rows.stop[i]):
            j = rows.index[k]
            if j < state.shape[0] and state[j] == OPEN and rank_of(j) > rank_of(i):
                if wp.length_sq(x[j] - x[i]) < r * r:
                    first = 0
    chosen[i] = first


@wp.kernel
def cover_points_p(
    x: wp.array(dtype=wp.vec3),
    chosen: wp.array(dtype=wp.int32),
    rows: Neighbors,
    r: float,
    # outputs
    state: wp.array(dtype=wp.int32),
):
    """Mark the points chosen now, and the open ones within r of them, which will not be. See `choose_points_p`."""
    i = rows.first + wp.tid()
    if state[i] != OPEN:
        return
    if chosen[i] == 1:
        state[i] = CHOSEN
        return
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < state.shape[0] and chosen[j] == 1 and wp.length_sq(x[j] - x[i]) < r * r:
            state[i] = COVERED


@wp.kernel
def count_chosen_chunks(state: wp.array(dtype=wp.int32), part: wp.array(dtype=wp.int32)):
    """Number of chosen points in each part."""
    c = wp.tid()
    size = (state.shape[0] + part.shape[0] - 1) // part.shape[0]
    count = int(0)
    for i in range(c * size, wp.min(state.shape[0], (c + 1) * size)):
        if state[i] == CHOSEN:
            count += 1
    part[c] = count


@wp.kernel
def number_chosen_chunks(
    state: wp.array(dtype=wp.int32),
    x: wp.array(dtype=wp.vec3),
    region: wp.array(dtype=wp.int32),
    part: wp.array(dtype=wp.int32),
    # outputs
    place: wp.array(dtype=wp.int32),
    of: wp.array(dtype=wp.int32),
    x_next: wp.array(dtype=wp.vec3),
    region_next: wp.array(dtype=wp.int32),
):
    """Give the chosen points their places on the next level, in their order; those beyond its room have none.

    Args:
        state: [n].
        x: [n] m.
        region: [n].
        part: from `count_chosen_chunks`.
        place: [n] on the next level; -1 for none.
        of: [room] which point has each place.
        x_next: [room] m.
        region_next: [room], below 0 where no point is.
    """
    c = wp.tid()
    size = (state.shape[0] + part.shape[0] - 1) // part.shape[0]
    at = int(0)
    for b in range(c):
        at += part[b]
    for i in range(c * size, wp.min(state.shape[0], (c + 1) * size)):
        place[i] = -1
        if state[i] == CHOSEN:
            if at < of.shape[0]:
                place[i] = at
                of[at] = i
                x_next[at] = x[i]
                region_next[at] = region[i]
            at += 1


@wp.kernel
def empty_places_p(
    x: wp.array(dtype=wp.vec3),
    # outputs
    of: wp.array(dtype=wp.int32),
    x_next: wp.array(dtype=wp.vec3),
    region_next: wp.array(dtype=wp.int32),
):
    """Empty all places of the next level, each of a region of its own, and spread over the film."""
    i = wp.tid()
    of[i] = -1
    x_next[i] = x[i]
    region_next[i] = -1 - i


@wp.kernel
def link_up_p(
    x: wp.array(dtype=wp.vec3),
    place: wp.array(dtype=wp.int32),
    rows: Neighbors,
    r: float,
    room: int,
    # outputs
    up: Neighbors,
    weight: wp.array(dtype=float),
    norm: wp.array(dtype=float),
    wanted: wp.array(dtype=wp.int32),
):
    """Share each point among the places of the next level within r, by `hat`; the shares add up to 1.

    Args:
        x: [n] m.
        place: [n] from `number_chosen_chunks`.
        rows: neighbours; those of index >= n are none.
        r: m.
        room: of the rows.
        up: places near each point.
        weight: [pairs of `up`] the shares.
        norm: [n] 1/sum of the hats; 0 for a point without any place, or with more than there is room for.
        wanted: [n] places near each point.
    """
    i = rows.first + wp.tid()
    first = up.start[i]
    count = int(0)
    total = float(0.0)
    if place[i] >= 0:
        total = 1.0
        if count < room:
            up.index[first] = place[i]
            weight[first] = 1.0
        count += 1
    for k in range(rows.start[i], rows.stop[i]):
        j = rows.index[k]
        if j < place.shape[0] and place[j] >= 0:
            w = hat(x[j] - x[i], r)
            if w > 0.0:
                if count < room:
                    up.index[first + count] = place[j]
                    weight[first + count] = w
                count += 1
                total += w
    wanted[i] = count
    fits = count > 0 and count <= room
    norm[i] = wp.where(fits, 1.0 / wp.max(total, 1.0e-30), 0.0)
    up.stop[i] = first + wp.where(fits, count, 0)
    for k in range(first, up.stop[i]):
        weight[k] = weight[k] * norm[i]


@wp.kernel
def link_down_p(
    x: wp.array(dtype=wp.vec3),
    of: wp.array(dtype=wp.int32),
    norm: wp.array(dtype=float),
    rows: Neighbors,
    r: float,
    # outputs
    down: Neighbors,
    weight: wp.array(dtype=float),
):
    """The shares of `link_up_p` seen from the places of the next level.

    Args:
        x: [n] m.
        of: [room] point at each place.
        norm: [n] from `link_up_p`.
        rows: neighbours of the n points, whose room those of `down` exceed by one.
        r: m.
        down: points near each place.
        weight: [pairs of `down`] the shares.
    """
    c = down.first + wp.tid()
    at = down.start[c]
    i = of[c]
    if i >= 0:
        if norm[i] > 0.0:
            down.index[at] = i
            weight[at] = norm[i]
            at += 1
        for k in range(rows.start[i], rows.stop[i]):
            j = rows.index[k]
            if j < norm.shape[0] and norm[j] > 0.0:
                w = hat(x[j] - x[i], r)
                if w > 0.0:
                    down.index[at] = j
                    weight[at] = w * norm[j]
                    at += 1
    down.stop[c] = at


@wp.kernel
def split_diagonal_p(
    diag: wp.array(dtype=float),
    pair: wp.array(dtype=float),
    scale: wp.array(dtype=float),
    rows: Neighbors,
    # outputs
    held: wp.array(dtype=float),
    stiff: wp.array(dtype=float),
    fade: wp.array(dtype=float),
):
    """Tell what ties each unknown to others from what holds it: its own diagonal, and neighbours beyond the unknowns.

    Args:
        diag: [n] of the matrix, see `linear`.
        pair: [pairs].
        scale: [1].
        rows: neighbours.
        held: [n].
        stiff: [n] 0 where pairs take off the diagonal, as those of an inertia do that makes up for a blur.
        fade: [n] s/(s + EDGE h), by which what a coarse level adds is taken.
    """
    i = rows.first + wp.tid()
    tied = sum_within(i, pair, rows, diag.shape[0])
    h = diag[i] + scale[0] * (sum_row(i, pair, rows) - tied)
    s = wp.max(scale[0] * tied, 0.0)
    held[i] = h
    stiff[i] = s
    fade[i] = s / wp.max(s + EDGE * h, 1.0e-30)


@wp.kernel
def coarsen_diagonal_p(
    down: Neighbors,
    weight: wp.array(dtype=float),
    held: wp.array(dtype=float),
    stiff: wp.array(dtype=float),
    fade: wp.array(dtype=float),
    # outputs
    held_next: wp.array(dtype=float),
    stiff_next: wp.array(dtype=float),
    fade_next: wp.array(dtype=float),
    inverse_next: wp.array(dtype=float),
):
    """The same of the next level, and the inverse of its diagonal, 0 at empty places.

    What holds points adds up with the squares of their shares. Stiffness along a surface does not depend on the scale.
    """
    c = down.first + wp.tid()
    h = float(0.0)
    s = float(0.0)
    total = float(0.0)
    for k in range(down.start[c], down.stop[c]):
        i = down.index[k]
        w = weight[k]
        h += w * w * fade[i] * fade[i] * held[i]
        s += w * stiff[i]
        total += w
    s = s / wp.max(total, 1.0e-30)
    held_next[c] = h
    stiff_next[c] = s
    fade_next[c] = s / wp.max(s + FAR_EDGE * h, 1.0e-30)
    whole = h + STIFF * s
    inverse_next[c] = wp.where(whole > 0.0, 1.0 / wp.max(whole, 1.0e-30), 0.0)


@wp.kernel
def restrict_p(
    down: Neighbors,
    weight: wp.array(dtype=float),
    fade: wp.array(dtype=float),
    r: wp.array(dtype=float),
    inverse_next: wp.array(dtype=float),
    # outputs
    r_next: wp.array(dtype=float),
    z_next: wp.array(dtype=float),
):
    """What of a residual each place of the next level stands for, and that over its diagonal."""
    c = down.first + wp.tid()
    total = sum_products_of(c, r, fade, weight, down)
    r_next[c] = total
    z_next[c] = inverse_next[c] * total


@wp.kernel
def add_next_p(
    up: Neighbors,
    weight: wp.array(dtype=float),
    fade: wp.array(dtype=float),
    z_next: wp.array(dtype=float),
    # outputs
    z: wp.array(dtype=float),
):
    """Add to each point what the places of the next level that it is shared among have."""
    i = up.first + wp.tid()
    z[i] = z[i] + fade[i] * sum_shares(i, z_next, weight, up)
