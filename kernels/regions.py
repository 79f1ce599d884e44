"""Sums by region: E are stored region by region, and each region's sum is taken in the same number of parts."""

from typing import Any

import warp as wp

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
