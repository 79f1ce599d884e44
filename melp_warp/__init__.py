"""Soap films, bubbles and foams with the Moving Eulerian-Lagrangian Particle method on NVIDIA Warp."""

__version__ = "0.1.0"
