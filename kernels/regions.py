"""Sums by region: E are stored region by region, and each region's sum is taken in the same number of parts."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.func
def part_range(c: int, first: wp.array(dtype=wp.int32), parts: int):
    """First and last + 1 of the E in part c of `parts`; region g holds E first[g] to first[g + 1]."""
    per = parts // (first.shape[0] - 1)
    g = c // per
    size = (first[g + 1] - first[g] + per - 1) // per
    start = first[g] + (c - g * per) * size
    return start, wp.min(first[g + 1], start + size)
