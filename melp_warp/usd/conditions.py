"""What a frame must fulfil before it is written, and after it is read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from melp_warp.errors import SimulationError, require
from melp_warp.frame import CurveFrame, ParticleFrame, WholeFrame
from melp_warp.usd.schema import (
    ATTRIBUTES,
    LARGEST,
    MOST_REGIONS,
    PACKED_ATTRIBUTES,
    Attribute,
    Frame,
    Layout,
    array_of,
    entries_of,
    with_rows,
)


def check_carried(layout: Layout) -> None:
    """Refuse names that are no primvars, or those of others."""
    taken = {a.name for a in with_rows((*ATTRIBUTES, *PACKED_ATTRIBUTES))}
    right = all(name.isidentifier() and f"primvars:{name}" not in taken for name in layout.carried)
    require(right, "carried", list(layout.carried), "names of primvars of their own")


def check_arrays(label: str, frame: Frame, attributes: Sequence[Attribute]) -> None:
    """Refuse what USD would take silently: wrong shapes and types, NaN, negative thickness, no such corner."""
    count, parts = len(frame.points), getattr(frame, "faces", getattr(frame, "counts", None))
    many = len(parts) if isinstance(parts, np.ndarray) else 0
    stored = [attribute for attribute in attributes if attribute.field]
    for attribute in stored:
        array = array_of(frame, attribute)
        faces = attribute.field == "faces"
        rows = many if faces else entries_of(attribute, count, many)
        shape = (rows, 3) if faces or attribute.columns == 3 else (rows,)
        dtype = str(np.dtype(attribute.dtype))
        got = (array.shape, str(array.dtype)) if isinstance(array, np.ndarray) else type(array).__name__
        require(got == (shape, dtype), f"{label}.{attribute.field}", got, f"an array {list(shape)} of {dtype}")
    for attribute in stored:
        array = array_of(frame, attribute)
        finite = np.isfinite(array.reshape(len(array), -1 if len(array) else 1)).all(axis=1)
        if not finite.all():
            at = _name_of(frame, int(np.argmin(finite)))
            raise SimulationError(f"{label}.{attribute.field} is not finite at {at}")
    for field in ("widths", "thickness"):
        array = getattr(frame, field, np.zeros(0))
        if len(array) and array.min() < 0.0:
            at = int(np.argmin(array))
            raise SimulationError(f"{label}.{field} is negative at {_name_of(frame, at)}: {array[at]}")
    if isinstance(frame, CurveFrame):
        fit = frame.counts.min(initial=2) >= 2 and frame.counts.sum() == count
        require(bool(fit), f"{label}.counts", frame.counts.tolist()[:20], f"two or more each, {count} in all")
        return
    if not isinstance(frame, ParticleFrame):
        low, high = frame.faces.min(initial=0), frame.faces.max(initial=-1)
        require(low >= 0 and high < count, f"{label}.faces", (int(low), int(high)), f"corners from 0 to {count - 1}")
        return
    rising = frame.ids[1:] > frame.ids[:-1]
    if not rising.all():
        at = int(np.argmin(rising))
        require(False, f"{label}.ids", frame.ids[at : at + 2].tolist(), "ascending, each once")


def _name_of(frame: Frame, at: int) -> str:
    return f"particle id {frame.ids[at]}" if isinstance(frame, ParticleFrame) else f"entry {at}"


def check_sizes(path: Path, frame: Frame) -> None:
    """Refuse numbers with which nothing can be drawn or measured, though they can be stored.

    Raises:
        InputError: names the array.
    """
    if not len(frame.points):
        return
    for name in ("points", "velocities", "widths", "normals", "thickness"):
        largest = float(np.abs(getattr(frame, name, np.zeros(1))).max())
        require(largest <= LARGEST, f"{path}: {name}", largest, f"at most {LARGEST:g}")
    if isinstance(frame, WholeFrame) and len(frame.faces):
        low, high = int(min(frame.inside.min(), frame.outside.min())), int(max(frame.inside.max(), frame.outside.max()))
        require(
            -1 <= low <= high < MOST_REGIONS, f"{path}: inside and outside", [low, high], f"-1 to {MOST_REGIONS - 1}"
        )
    if isinstance(frame, ParticleFrame):
        low, high = int(frame.region.min()), int(frame.region.max())
        require(0 <= low <= high < MOST_REGIONS, f"{path}: region", [low, high], f"from 0 to {MOST_REGIONS - 1}")
