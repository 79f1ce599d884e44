"""A socket's example: a bubble with air on its inside alone, as in a chamber that is pumped out."""

import numpy as np

from melp_warp import AirModel, Sphere, declare

STEPS = {"frames": 2, "fps": 480.0, "dt": 5e-4, "scheme": "trapezoid"}
PARAMETERS = declare(radius=0.03, air="added_mass", air_drag=0.0, e_count=300, l_per_e=0, thickness=2e-6, **STEPS)


class Inside(AirModel):
    """Mode n moves rho R/n inside: what is left of rho R (2n+1)/(n(n+1)) without the rho R/(n+1) of the outside."""

    def waves(self, lam, density, radius):
        """lambda R^2 = n(n+1)."""
        n = np.sqrt(lam * radius**2 + 0.25) - 0.5
        return density * radius / n

    def rigid(self, density, radius):
        """All of the air inside, mode n = 1."""
        return density * radius


def squeezed(x):
    """A motion of the shape P2, of 1 cm/s, m/s."""
    n = x / np.linalg.norm(x, axis=1, keepdims=True)
    return 0.01 * 0.5 * (3.0 * n[:, 1:2] ** 2 - 1.0) * n


def build(p):
    """Build the scene."""
    return p.scene("air_model", Sphere(p.radius), velocity=squeezed, air_model=Inside())
