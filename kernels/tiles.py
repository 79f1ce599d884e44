"""Tiles of a picture: which things each of them holds, in a list that is sorted and not filled by atomics."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def count_tiles(
    boxes: wp.array[wp.vec4i],
    # outputs
    counts: wp.array[wp.int32],
):
    """Number of tiles in each box: first and last tile column, first and last tile row; none in 0 -1 0 -1. [n]."""
    i = wp.tid()
    box = boxes[i]
    counts[i] = (box[1] - box[0] + 1) * (box[3] - box[2] + 1)


@wp.kernel
def list_tiles(
    boxes: wp.array[wp.vec4i],
    columns: int,
    ends: wp.array[wp.int32],
    counts: wp.array[wp.int32],
    # outputs
    tiles: wp.array[wp.int32],
    members: wp.array[wp.int32],
):
    """Pairs (tile, thing) of each thing, in its own range of the list.

    Args:
        boxes: [n] as for `count_tiles`.
        columns: tiles along a row of the picture.
        ends: [n] inclusive running sum of `counts`.
        counts: [n] from `count_tiles`.
        tiles: [pairs] tile of each pair.
        members: [pairs] thing of each pair.
    """
    i = wp.tid()
    box = boxes[i]
    k = ends[i] - counts[i]
    for row in range(box[2], box[3] + 1):
        for column in range(box[0], box[1] + 1):
            tiles[k] = row * columns + column
            members[k] = i
            k += 1


@wp.kernel
def find_tile_ends(
    tiles: wp.array[wp.int32],
    # outputs
    begins: wp.array[wp.int32],
    ends: wp.array[wp.int32],
):
    """Where each tile's run begins and ends in the sorted list of pairs.

    Args:
        tiles: [pairs] ascending.
        begins: [tiles] zeroed.
        ends: [tiles] zeroed: an empty tile has an empty run.
    """
    k = wp.tid()
    tile = tiles[k]
    if k == 0 or tiles[k - 1] != tile:
        begins[tile] = k
    if k == tiles.shape[0] - 1 or tiles[k + 1] != tile:
        ends[tile] = k + 1
