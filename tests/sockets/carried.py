"""A socket's example: a bubble dyed on one side."""

from melp_warp import Carried, Sphere, declare

PARAMETERS = declare(radius=0.03, gravity=9.81, e_count=150, l_per_e=2, frames=2)


def build(p):
    """Build the scene."""
    dye = Carried("dye", "kg/m^2", start=lambda x: 1e-6 * (x[:, 0] > 0.0))
    return p.scene("carried", Sphere(p.radius), carried=[dye])
