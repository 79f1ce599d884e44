"""Soap films, bubbles and foams with the Moving Eulerian-Lagrangian Particle method on NVIDIA Warp."""

import os

__version__ = "0.1.0"

if os.environ.get("MELP_WARP_PRECISION") == "64":  # melp_warp.environment refuses others
    from melp_warp import double

    double.install()
    __version__ += "+float64"
