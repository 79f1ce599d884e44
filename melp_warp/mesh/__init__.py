"""Surfaces made of E and L: a mesh a region, a foam in one piece, films with holes."""

from melp_warp.mesh.surfaces import make_meshes, thin_out
from melp_warp.mesh.whole import make_whole

__all__ = ["make_meshes", "make_whole", "thin_out"]
