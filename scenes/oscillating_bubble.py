"""A bubble ringing in one mode: E particles only, to compare with the exact period.

The mode n of a film in a vacuum has omega^2 = 2 sigma (n-1)(n+2) / (m R^2), with m = density * thickness; with
`--set air=added_mass` the air joins in (Lamb, Hydrodynamics, section 275): m + rho_air R (2n+1)/(n(n+1)).
"""

import numpy as np

try:
    from melp_warp.parameters import Values, declare
    from melp_warp.scene import Scene
    from melp_warp.shapes import displaced_sphere
except ModuleNotFoundError as error:
    raise SystemExit(f"{error}: run `pip install -e .` in the checkout first") from None

PARAMETERS = declare(
    radius=0.05,
    mode=2,
    amplitude=0.05,
    thickness=400e-9,
    surfactant=0.0,
    air="none",
    scheme="trapezoid",
    opening=0.0,
    e_count=2000,
    l_per_e=0,
    frames=100,
    fps=2500.0,
    dt=2e-4,
)


def build(p: Values) -> Scene:
    """Build the scene."""
    legendre = np.polynomial.legendre.Legendre.basis(p.mode)
    shape = displaced_sphere(p.radius, lambda d: p.amplitude * legendre(d[:, 1]))
    return p.scene("oscillating_bubble", shape, waves={"mode": 2.0 * np.pi * p.radius / p.mode} if p.amplitude else {})


if __name__ == "__main__":
    from melp_warp.cli import run_file

    raise SystemExit(run_file(__file__))
