"""Caches on disk: what is written, read, checked, and opened in a process of its own."""

from melp_warp.usd.cache import CacheWriter
from melp_warp.usd.forms import flatten, write_look
from melp_warp.usd.layers import read_rims
from melp_warp.usd.reading import read_frame, read_mesh, read_metadata, read_whole
from melp_warp.usd.schema import frame_path, list_frames

__all__ = [
    "CacheWriter",
    "flatten",
    "frame_path",
    "list_frames",
    "read_frame",
    "read_mesh",
    "read_metadata",
    "read_rims",
    "read_whole",
    "write_look",
]
