"""What the arrays of a checkpoint must fulfil before a run goes on from them, whoever wrote them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from melp_warp.errors import require
from melp_warp.state import GAS_SLOTS

FARTHEST = 1e6
"""Largest coordinate (m) and speed (m/s)."""

LARGEST = 1e30
"""Largest of all other numbers: products of two must not overflow."""

UNIT = 0.01
"""Largest departure of a normal's length from 1."""

NOT_NEGATIVE = ("mass", "surfactant", "eta")
MOVING = ("x", "u", "v")
BY_REGION = ("gas", "motion")


def kinds_of(arrays: Mapping[str, np.ndarray]) -> dict[str, tuple[str, int]]:
    """Kind and number of dimensions of each array, as `files.load_arrays` wants them."""
    return {name: ("f" if np.asarray(a).dtype.kind == "f" else "i", np.ndim(a)) for name, a in arrays.items()}


def check_stored(
    stored: Mapping[str, np.ndarray],
    like: Mapping[str, np.ndarray],
    fps: float,
    bubbles: int | None = None,
    late: Sequence[int] = (),
) -> None:
    """Refuse stored arrays that no run of this scene can have left: `InputError` names the array.

    Args:
        stored: arrays by name, as `State.numpy` and the record of a foam name them.
        like: the same of a simulation of this scene. The number of particles and regions may differ in a foam alone.
        fps: frames a second.
        bubbles: number of bubbles of a foam's scene; None for a single film.
        late: the bubbles that come in the course of a run.
    """
    missing = [name for name in like if name not in stored and name != "origin"]
    require(not missing, "checkpoint", f"one without {', '.join(missing)}", "of this scene")
    regions = len(stored["gas"])
    if bubbles is None:
        sizes = {}
    else:
        _check_labels(stored, bubbles, late)
        regions = len(stored["labels"])
        sizes = {"e": len(stored["e.x"]), "l": len(stored["l.x"]) if "l.x" in stored else len(stored["ids.l"])}
        for kind in "el":
            _check_ids(f"ids.{kind}", stored[f"ids.{kind}"])
    for name, array in stored.items():
        if name in like:
            _check_shape(name, array, np.asarray(like[name]), sizes, regions if bubbles is not None else None)
            _check_values(name, array)
    for kind in "el":
        name = f"{kind}.region"
        if name in stored:
            _check_region(name, stored[name], regions)
    _check_gas(stored["gas"], closed=bubbles is not None or bool(np.asarray(like["gas"])[0, 0] > 0.0))
    frame, time = int(stored["frame"]), float(stored["time"])
    require(0 <= frame <= 1_000_000, "frame", frame, "from 0 to 1000000")
    least = frame / fps * (1.0 - 1e-9)
    require(least <= time <= 1e9, "time", time, f"at least {least:.6g} s, the end of frame {frame}")


def _check_labels(stored: Mapping[str, np.ndarray], bubbles: int, late: Sequence[int]) -> None:
    """Regions are bubbles of the scene, each once, none where all have popped; those to come are others."""
    labels, unborn = stored["labels"].tolist(), stored["unborn"].tolist()
    known = len(set(labels)) == len(labels) and all(0 <= k < bubbles for k in labels)
    require(known, "labels", labels[:20], f"regions of this scene, 0 to {bubbles - 1}, each once")
    other = len(set(unborn)) == len(unborn) and set(unborn) <= set(late) - set(labels)
    require(other, "unborn", unborn[:20], "bubbles of this scene that are still to come, each once")


def _check_ids(name: str, ids: np.ndarray) -> None:
    good = len(ids) == 0 or (int(ids.min()) >= 0 and len(np.unique(ids)) == len(ids))
    require(good, name, "others", "whole numbers from 0, each once")


def _check_shape(name: str, array: np.ndarray, like: np.ndarray, sizes: Mapping[str, int], regions: int | None) -> None:
    """The shape of this scene; in a foam with its own numbers of particles and regions."""
    wanted = like.shape
    if regions is not None and name.startswith(("e.", "l.", "ids.")):
        wanted = (sizes[name.removeprefix("ids.")[0]], *like.shape[1:])
    elif regions is not None and name in BY_REGION:
        wanted = (regions, *like.shape[1:])
    elif name in ("labels", "unborn"):
        return
    require(array.shape == wanted, name, array.shape, f"of shape {wanted} for this scene")
    empty = name.endswith(".x") and len(array) == 0 and regions != 0
    require(not empty, name, "no particles", "of one particle at least")


def _check_values(name: str, array: np.ndarray) -> None:
    """Finite and no larger than the solver can take."""
    field = name.rsplit(".", maxsplit=1)[-1]
    if array.dtype.kind == "f" and array.size:
        require(bool(np.isfinite(array).all()), name, "NaN or infinity", "finite")
        most = FARTHEST if field in MOVING or name in ("origin", "motion") else LARGEST
        largest = float(np.abs(array).max())
        require(largest <= most, name, largest, f"at most {most:g}")
    if field in NOT_NEGATIVE and array.size:
        require(float(array.min()) >= 0.0, name, float(array.min()), "0 or above")
    if field == "eta" and array.size:
        require(float(array.min()) > 0.0, name, float(array.min()), "above 0 m")
    if field == "normal" and array.size:
        length = np.linalg.norm(array.astype(np.float64), axis=1)
        worst = float(length[np.argmax(np.abs(length - 1.0))])
        require(abs(worst - 1.0) <= UNIT, name, worst, "of unit length")


def _check_region(name: str, region: np.ndarray, regions: int) -> None:
    """In range; E region by region, each with E."""
    if regions == 0:
        require(len(region) == 0, name, f"{len(region)} particles", "without particles, as there is no region")
        return
    low, high = int(region.min()), int(region.max())
    require(low >= 0 and high < regions, name, [low, high], f"from 0 to {regions - 1}")
    if name == "e.region":
        whole = bool((np.diff(region) >= 0).all()) and len(np.unique(region)) == regions
        require(whole, name, "another order", "ascending, with E of every region")


def _check_gas(gas: np.ndarray, closed: bool) -> None:
    """What encloses gas has a volume and an amount of it."""
    for slot in ("volume", "amount") if closed and len(gas) else ():
        least = float(gas[:, GAS_SLOTS.index(slot)].min())
        require(least > 0.0, f"gas, {slot}", least, "above 0")
