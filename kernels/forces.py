"""Body accelerations on the film: each force adds its own to one field on E."""

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel
def set_gravity_e(g: wp.vec3, body: wp.array(dtype=wp.vec3)):
    """Start the field of body accelerations with gravity. [n_e], m/s^2."""
    i = wp.tid()
    body[i] = g
