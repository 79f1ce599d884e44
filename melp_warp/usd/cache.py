"""The USD cache of a run: one binary file a frame, bound by a small root layer with value clips.

    film.usda                 root: open this one
    film.manifest.usda        what the clips hold
    film_stage.usda           the root with a camera and lights, see `write_stage`
    film_look.usda            optional MaterialX look over the root, see `write_look`
    frames/film.000000.usdc   one file a frame

A frame holds point prims and, where they are asked for, a mesh of each region. Each prim has its clips on itself, so
that it can be referenced alone. File number, time code and frame are the same number. The first frame is the initial
state; seconds are the time codes since then divided by the frame rate. The cache is complete and valid after every
`CacheWriter.write`.
"""

from __future__ import annotations

import importlib.metadata
import os
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import numpy as np

import melp_warp
from melp_warp.errors import InputError, require
from melp_warp.optics import DISPLAY_GAIN, WATER_INDEX, display_color
from melp_warp.usd.conditions import check_arrays, check_carried
from melp_warp.usd.layers import Origin, export, frame_layer, manifest_layer, root_layer, set_range
from melp_warp.usd.schema import (
    FRAMES,
    MANIFEST,
    MAX_FRAME,
    NAMES_TAKEN,
    ROOT,
    SCHEMA_VERSION,
    SURFACE,
    THICKNESS_UNIT,
    Frame,
    Layout,
    attributes_of,
    frame_path,
)

_OTHER_RUN = (ROOT, FRAMES, "run.jsonl")


def _checked_metadata(metadata: Mapping, name: str = "metadata") -> dict:
    """A copy of `metadata` that a USD dictionary can hold: nested mappings of names to text, bool and numbers."""
    result = {}
    for key, value in metadata.items():
        require(isinstance(key, str) and key.isidentifier(), f"{name} key", key, "a name of letters, digits and _")
        if isinstance(value, Mapping):
            result[key] = _checked_metadata(value, f"{name}.{key}")
        else:
            value = value.item() if isinstance(value, np.generic) else value
            allowed = isinstance(value, (str, bool, int, float))
            require(allowed, f"{name}.{key}", value, "text, a bool, a number or a mapping of these")
            small = not isinstance(value, int) or -(2**63) <= value < 2**63
            require(small, f"{name}.{key}", value, "within 64 bits")
            result[key] = value
    return result


def _versions() -> dict[str, str]:
    from pxr import Usd

    return {
        "melpWarp": melp_warp.__version__,
        "warp": importlib.metadata.version("warp-lang"),
        "numpy": np.__version__,
        "usd": ".".join(map(str, Usd.GetVersion())),
    }


def _claim(directory: Path) -> None:
    """Create `directory` and its frames folder; `InputError` if it holds another run or cannot be written."""
    if directory.exists() and not directory.is_dir():
        raise InputError(f"output folder {directory} is a file: choose another folder")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for name in _OTHER_RUN:
            if (directory / name).exists():
                raise InputError(f"output folder {directory} already holds a run ({name}): choose another folder")
        (directory / FRAMES).mkdir()
    except OSError as error:
        raise InputError(f"cannot use output folder {directory}: {error.strerror or error}") from error


class CacheWriter:
    """Writes a cache frame by frame; after every frame the cache on disk is complete and can be opened.

    A frame goes to a temporary file first, is flushed to the disk and renamed; the root, whose time range follows
    the frames, is replaced last. A run that is killed leaves all frames before.

    Args:
        directory: output folder; created if needed. It must not hold another run (film.usda, frames/, run.jsonl).
        fps: frames per second, above 0.
        metadata: stored in the root's customLayerData under "melpWarp". Needs "scene" (text) and "seed" (whole
            number); may hold more text, bools, numbers and mappings of these. Schema version, thickness unit,
            refractive index, colour gain and program versions are added.
        prims: names of the prims under /World: point prims, "Film" first, then meshes (`surface_prim`, `WHOLE`).
            Particles have purpose "guide" where there are meshes, and other sets ("FilmE") always: viewers show them
            on demand.
        gain: factor on the reflectance in displayColor.
        index: refractive index of the film.
        origin: where the points of all frames are measured from, m: the prims are translated there, in float64.
        rims: points [k, 3] along each wire that holds the film, from `origin`, m.
        packed: sets of particles whose widths, normals and colours are stored with less precision, in half the bytes
            (packing.py); all else is stored to the bit.
        carried: names and units of what the sets of E and L have in `ParticleFrame.carried`.
        there: first and last frame of a cache in the folder that goes on; None for a new one. The last may be one
            before the first, for none.

    Attributes:
        sums: SHA-256 of the root and the manifest as they are now, by their paths in the folder.

    Raises:
        InputError: an argument is out of range, or the folder holds a run, is a file or cannot be written.
    """

    def __init__(
        self,
        directory: str | os.PathLike,
        fps: float,
        metadata: Mapping,
        prims: Sequence[str] = ("Film",),
        gain: float = DISPLAY_GAIN,
        index: float = WATER_INDEX,
        origin: Origin = (0.0, 0.0, 0.0),
        rims: Sequence[np.ndarray] = (),
        packed: Collection[str] = (),
        carried: Mapping[str, str] | None = None,
        there: tuple[int, int] | None = None,
    ):
        require(np.isscalar(fps) and np.isfinite(fps) and fps > 0.0, "fps", fps, "a number above 0")
        require(isinstance(metadata.get("scene"), str), "metadata.scene", metadata.get("scene"), "text")
        require(
            isinstance(metadata.get("seed"), (int, np.integer)), "metadata.seed", metadata.get("seed"), "a whole number"
        )
        names = len(set(prims)) == len(prims) and not set(prims) & set(NAMES_TAKEN)
        names = names and all(str(p).removeprefix(f"{SURFACE}/").isidentifier() for p in prims)
        require(names and list(prims[:1]) == ["Film"], "prims", list(prims), '"Film" and then other names, each once')
        display_color(np.zeros(0, np.float32), gain, index)  # checks gain and index
        own = {
            "schemaVersion": SCHEMA_VERSION,
            "thicknessUnit": THICKNESS_UNIT,
            "refractiveIndex": float(index),
            "colorGain": float(gain),
            "versions": _versions(),
            **({"carried": dict(carried)} if carried else {}),
        }
        taken = sorted(own.keys() & metadata.keys())
        require(not taken, "metadata", taken, "without the keys that the writer sets")
        require(len(origin) == 3 and bool(np.all(np.isfinite(origin))), "origin", origin, "three finite numbers")
        self.directory = Path(directory)
        self._fps, self._prims, self._gain, self._index = float(fps), tuple(prims), float(gain), float(index)
        self._layout = Layout(frozenset(packed), tuple(carried or ()), tuple(carried or ()))
        check_carried(self._layout)
        self._first: int | None = None
        self._last: int | None = None
        self._origin = tuple(float(x) for x in origin)
        own_metadata = _checked_metadata(metadata) | own
        self._root = root_layer(self._fps, self._prims, self._layout, own_metadata, self._origin, rims)
        if there is None:
            _claim(self.directory)
        self.sums = {MANIFEST: export(manifest_layer(self._fps, self._prims, self._layout), self.directory / MANIFEST)}
        if there is not None and there[0] <= there[1]:
            self._first, self._last = there
            set_range(self._root, *there)
            self.sums[ROOT] = export(self._root, self.directory / ROOT)

    def write(self, frame_index: int, frames: Mapping[str, Frame]) -> dict[str, str]:
        """Add one frame and bring the root up to date.

        Args:
            frame_index: number of the frame, file and time code, 0 to 999999; one more than the frame before.
            frames: a frame for each of the prims. Counts may differ from frame to frame, and be 0.

        Returns:
            SHA-256 of the frame's file, the root and the manifest, by their paths in the folder.

        Raises:
            InputError: a wrong number, prim, shape, type or order of ids, or the disk refused the file (full). The
                frames before stay valid and no temporary file is left.
            SimulationError: a value is not finite, or a width or thickness is negative; the particle is named.
        """
        numbered = isinstance(frame_index, (int, np.integer)) and 0 <= frame_index <= MAX_FRAME
        require(numbered, "frame_index", frame_index, f"a whole number from 0 to {MAX_FRAME}")
        frame_index = int(frame_index)
        follows = self._last is None or frame_index == self._last + 1
        require(follows, "frame_index", frame_index, f"{self._last} + 1, the frame after the one before")
        require(set(frames) == set(self._prims), "frames", sorted(frames), f"one for each of {list(self._prims)}")
        for prim in self._prims:
            check_arrays(
                f"frame {frame_index} {prim}",
                frames[prim],
                attributes_of(prim, self._layout._replace(packed=frozenset())),
            )
            found = frames[prim].origin
            require(
                found == self._origin, f"frame {frame_index} {prim}.origin", found, f"that of the cache, {self._origin}"
            )
        ordered = {prim: frames[prim] for prim in self._prims}
        layer = frame_layer(frame_index, self._fps, ordered, self._layout, self._gain, self._index)
        path = frame_path(self.directory, frame_index)
        digests = {f"{FRAMES}/{path.name}": export(layer, path)}
        first = frame_index if self._first is None else self._first
        set_range(self._root, first, frame_index)
        self.sums[ROOT] = export(self._root, self.directory / ROOT)
        self._first, self._last = first, frame_index
        return digests | self.sums
