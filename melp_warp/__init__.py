"""Soap films, bubbles and foams with the Moving Eulerian-Lagrangian Particle method on NVIDIA Warp.

docs/python.md shows how to use what is exported here; it is loaded when it is first asked for.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING

__version__ = "0.1.0"

if TYPE_CHECKING:
    from melp_warp.carried import Carried
    from melp_warp.cluster import Bubble, Cluster
    from melp_warp.errors import InputError, SimulationError
    from melp_warp.keyframes import Keyframes
    from melp_warp.material import Material, Surroundings
    from melp_warp.numerics import Numerics
    from melp_warp.parameters import Key, declare
    from melp_warp.particle_set import ParticleSet
    from melp_warp.registry import load_scene, scene_names
    from melp_warp.scene import Scene
    from melp_warp.scene_force import Force
    from melp_warp.shapes import Disc, Ellipsoid, Rectangle, Sphere, StarShaped
    from melp_warp.simulation import Simulation
    from melp_warp.stage import Stage
    from melp_warp.stages.air import AirModel
    from melp_warp.usd.cache import CacheWriter
    from melp_warp.usd.reading import read_frame
    from melp_warp.usd.schema import list_frames

_HOMES = {
    "carried": ("Carried",),
    "cluster": ("Bubble", "Cluster"),
    "errors": ("InputError", "SimulationError"),
    "keyframes": ("Keyframes",),
    "material": ("Material", "Surroundings"),
    "numerics": ("Numerics",),
    "parameters": ("Key", "declare"),
    "particle_set": ("ParticleSet",),
    "registry": ("load_scene", "scene_names"),
    "scene": ("Scene",),
    "scene_force": ("Force",),
    "shapes": ("Disc", "Ellipsoid", "Rectangle", "Sphere", "StarShaped"),
    "simulation": ("Simulation",),
    "stage": ("Stage",),
    "stages.air": ("AirModel",),
    "usd": ("CacheWriter", "list_frames", "read_frame"),
}

__all__ = [
    "AirModel",
    "Bubble",
    "CacheWriter",
    "Carried",
    "Cluster",
    "Disc",
    "Ellipsoid",
    "Force",
    "InputError",
    "Key",
    "Keyframes",
    "Material",
    "Numerics",
    "ParticleSet",
    "Rectangle",
    "Scene",
    "Simulation",
    "SimulationError",
    "Sphere",
    "Stage",
    "StarShaped",
    "Surroundings",
    "declare",
    "list_frames",
    "load_scene",
    "read_frame",
    "scene_names",
]


def __getattr__(name: str) -> object:
    for home, names in _HOMES.items():
        if name in names:
            return getattr(importlib.import_module(f"melp_warp.{home}"), name)
    raise AttributeError(f"melp_warp has no {name!r}")


if os.environ.get("MELP_WARP_PRECISION") == "64":  # melp_warp.device.environment refuses others
    from melp_warp.device import float64 as double

    double.install()
    __version__ += "+float64"
