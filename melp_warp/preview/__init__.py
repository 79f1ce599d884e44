"""Pictures and movies of caches: splats of particles, surfaces with thickness, light, files."""

from melp_warp.preview.draw import Camera, contact_sheet, render, save_image

__all__ = ["Camera", "contact_sheet", "render", "save_image"]
