"""Caches on disk: what is written, read, checked, and opened in a process of its own."""

from melp_warp.usd.cache import (
    CacheWriter,
    flatten,
    frame_path,
    list_frames,
    read_frame,
    read_mesh,
    read_metadata,
    read_rims,
    read_whole,
    write_look,
)

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
