"""A socket's example: a wind that grows, on a bubble."""

import warp as wp

from melp_warp import Force, Keyframes, Sphere, declare

PARAMETERS = declare(radius=0.03, e_count=150, l_per_e=2, frames=2)


@wp.func
def blow(x: wp.vec3, t: float, u: wp.vec3, eta: float, speed: float):
    """A wind along x that takes the film along at 20/s."""
    rate = 20.0
    return rate * (wp.vec3(speed, 0.0, 0.0) - u), rate


def build(p):
    """Build the scene."""
    return p.scene("force", Sphere(p.radius), forces=[Force(blow, speed=Keyframes([(0.0, 0.0), (0.02, 0.5)]))])
