"""What L carry besides liquid and surfactant; most goes by kernels that others have."""

import warp as wp

from melp_warp.kernels.free_rim import Chain, give_to_rim, passed_by

wp.set_module_options({"enable_backward": False})


@wp.kernel
def collect_amount_l(
    mass: wp.array(dtype=float),
    # outputs
    held: wp.array(dtype=float),
    collected: wp.array(dtype=float),
):
    """Move what L without liquid hold to what the rim has collected.

    Args:
        mass: [n_l] kg.
        held: [n_l] how much each L holds.
        collected: [n_l] how much the rim has from it, added to.
    """
    i = wp.tid()
    if mass[i] == 0.0:
        collected[i] = collected[i] + held[i]
        held[i] = 0.0


@wp.kernel
def sweep_amount(
    x: wp.array(dtype=wp.vec3),
    held: wp.array(dtype=float),
    home: wp.array(dtype=wp.int32),
    region: wp.array(dtype=wp.int32),
    edge: wp.array(dtype=wp.vec4),
    rim: Chain,
    reach: float,
    behind: wp.array(dtype=wp.int32),
    # outputs
    amount: wp.array(dtype=wp.float64),
):
    """Give what particles hold that a rim has just passed to it, as `free_rim.sweep`, which is to follow. [n_l].

    Args:
        x: [n] m.
        held: [n] how much each holds.
        home: [n] E near each.
        region: [n] index of each one's region.
        edge: [n_e] see `free_rim.find_edge_e`.
        rim: the rims.
        reach: distance of its home within which a particle may meet a rim, m.
        behind: [n] 1 where its liquid is a rim's already.
        amount: [n_f] how much the points of the rims hold.
    """
    i = wp.tid()
    if behind[i] == 1:
        return
    found = passed_by(rim, x[i], region[i], edge[home[i]], reach)
    if found[0] >= 0.0:
        give_to_rim(rim, found, held[i], amount)
