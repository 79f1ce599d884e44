"""What L carry besides liquid and surfactant; most goes by kernels that others have."""

import warp as wp

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
