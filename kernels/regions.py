"""Sums by region: E are stored region by region, and each region's sum is taken in the same number of parts."""

from typing import Any

import warp as wp

from melp_warp.kernels.neighbors import Neighbors

wp.set_module_options({"enable_backward": False})


@wp.func
def part_region(c: int, first: wp.array(dtype=wp.int32), parts: int) -> int:
    """Region that part c of `parts` belongs to; region g holds E first[g] to first[g + 1]."""
    return c // (parts // (first.shape[0] - 1))


@wp.func
def part_range(c: int, first: wp.array(dtype=wp.int32), parts: int):
    """First and last + 1 of the E in part c of `parts`."""
    per = parts // (first.shape[0] - 1)
    g = part_region(c, first, parts)
    size = (first[g + 1] - first[g] + per - 1) // per
    start = first[g] + (c - g * per) * size
    return start, wp.min(first[g + 1], start + size)


@wp.func
def region_parts(g: int, parts: int, regions: int):
    """First and last + 1 of the parts of region g."""
    per = parts // regions
    return g * per, (g + 1) * per


@wp.func
def region_total(part: wp.array(dtype=Any), g: int, regions: int):
    """Sum of the parts of region g, in order."""
    start, stop = region_parts(g, part.shape[0], regions)
    total = part[start] - part[start]
    for c in range(start, stop):
        total += part[c]
    return total


@wp.kernel
def load_chunks(
    load: wp.array(dtype=float),
    area: wp.array(dtype=float),
    first: wp.array(dtype=wp.int32),
    # outputs
    part: wp.array(dtype=wp.vec2),
):
    """Parts of (sum of a load, sum of the areas) of each region."""
    c = wp.tid()
    start, stop = part_range(c, first, part.shape[0])
    total = wp.vec2()
    for i in range(start, stop):
        total += wp.vec2(load[i], area[i])
    part[c] = total


@wp.func
def balanced_load(load: float, area: float, part: wp.array(dtype=wp.vec2), g: int, regions: int) -> float:
    """Load of an E less its share, by area, of the sum of its region: to that no solution belongs on a closed film."""
    total = region_total(part, g, regions)
    return load - area * total[0] / total[1]


@wp.kernel
def near_chunks(
    region: wp.array(dtype=wp.int32),
    facing: Neighbors,
    first: wp.array(dtype=wp.int32),
    # outputs
    near: wp.array2d(dtype=wp.int32),
):
    """1 for every region of which an E is within reach of one in a part of a region, 0 for the others.

    Args:
        region: [n] region of each E.
        facing: E of other regions near each E.
        first: [regions + 1] first E of each region.
        near: [parts, regions].
    """
    c = facing.first + wp.tid()
    for h in range(near.shape[1]):
        near[c, h] = 0
    start, stop = part_range(c, first, near.shape[0])
    for i in range(start, stop):
        for k in range(facing.start[i], facing.stop[i]):
            near[c, region[facing.index[k]]] = 1


@wp.kernel
def join_clusters_r(
    near: wp.array2d(dtype=wp.int32),
    before: wp.array(dtype=wp.int32),
    # outputs
    cluster: wp.array(dtype=wp.int32),
):
    """The least number among a region's cluster and those of the regions near it, and of the cluster of that number.

    From each region's own number on, a cluster ends up with the number of its first region, the sooner the more are
    joined already. [regions].
    """
    g = wp.tid()
    least = before[g]
    start, stop = region_parts(g, near.shape[0], near.shape[1])
    for c in range(start, stop):
        for h in range(near.shape[1]):
            if near[c, h] == 1:
                least = wp.min(least, before[h])
    cluster[g] = before[least]
