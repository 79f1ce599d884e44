"""Checkpoints: the state of a run in one file, from which it goes on bit for bit.

A checkpoint is a NumPy archive (.npz, not compressed). Its members:

    header      JSON: format and program version, the scene's numbers, the film's, `Course`, `State.seen`, notices
    checksum    SHA-256 of all other members
    e.x, ...    arrays by the names of `State.numpy`, each with the type and the length that `state.py` declares

`write` and `read` are the only ones that know the format. What `read` gives has been checked (stored.py), whoever made
the file.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass, replace

import numpy as np

import melp_warp
from melp_warp.errors import InputError, require
from melp_warp.features import Features
from melp_warp.files import load_arrays, save_arrays
from melp_warp.keyframes import identity, stays
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.stages.air import AirModel
from melp_warp.stages.notices import Notices
from melp_warp.stages.state import Course, State, declared
from melp_warp.stepping.sampling import boundary_count, state_of
from melp_warp.stepping.stored import check_course, check_film, check_notices, check_seen, check_stored

FORMAT = 2
HEADER, CHECKSUM = "header", "checksum"
MOST_TOLD = 6
"""Numbers that differ of which a message tells."""

MAY_CHANGE = ("dt", "material.", "surroundings.", "numerics.", "forces.", "bursting.", "slow_")
"""Numbers of a scene that may change during a run, or what their names begin with."""

OF_BURSTS = ("f.", "d.", "e.behind", "e.swept", "l.behind", "ids.d", "swept.")
"""Arrays, or what their names begin with, of scenes in which films may burst: there is nothing in them at the start."""

STAY = ("material.thickness", "material.surfactant", "numerics.layers", "numerics.support", "numerics.skin")
"""Numbers among those that may not: they say how a run starts, or what its arrays are like."""


@dataclass
class Checkpoint:
    """What a file holds, checked.

    Attributes:
        film: spacing (m), radius (m) and room, see `Film`.
        course: what the host remembers.
        seen: see `State.seen`.
        notices: see `Notices.save`.
        run: what `write` was given of the run, for the command line.
        arrays: by name.
    """

    film: dict[str, float]
    course: Course
    seen: list
    notices: dict
    run: dict
    arrays: dict[str, np.ndarray]

    def make_state(self, scene: Scene, device) -> State:
        """The state, on a device."""
        state = state_of(scene, self.arrays, len(self.course.labels), device, self.course.holed)
        state.course = self.course
        state.seen.refill(self.seen)
        return state


def describe(scene: Scene) -> dict[str, object]:
    """The numbers and choices of a scene by name, as JSON can say them. Fields of points are left out."""
    said = {
        key: value
        for key, value in _flat("", scene)
        if key not in ("name", "frames", "forces", "carried", "stages", "sets")
    }
    for k, one in enumerate(scene.carried):
        said |= dict(_flat(f"carried.{k}", one))
    if type(scene.air_model) is not AirModel:
        told = hashlib.sha256(scene.air_model.describe().encode()).hexdigest()[:16]
        said["surroundings.air_model"] = f"{type(scene.air_model).__name__} {told}"
    for k, stage in enumerate(scene.stages):
        said[f"stages.{k}"] = stage.name
    for k, one in enumerate(scene.sets):
        said |= {f"sets.{k}.{key}": value for key, value in one.describe().items()}
    for k, force in enumerate(scene.forces):
        said |= {f"forces.{k}.{key}": value for key, value in force.describe().items()}
    return said


def _flat(name: str, value: object) -> Iterator[tuple[str, object]]:
    """Names and plain values within a value."""
    if is_dataclass(value):
        yield f"{name}.kind" if name else "kind", type(value).__name__
        for f in fields(value):
            yield from _flat(f"{name}.{f.name}" if name else f.name, getattr(value, f.name))
    elif isinstance(value, (list, tuple)) and any(is_dataclass(one) for one in value):
        for k, one in enumerate(value):
            yield from _flat(f"{name}.{k}", one)
    elif isinstance(value, (list, tuple)) and not all(map(stays, value)):
        yield name, [identity(one) if callable(one) else one for one in value]
    elif isinstance(value, (list, tuple, np.ndarray)):
        yield name, np.asarray(value).tolist()
    elif isinstance(value, np.generic):
        yield name, value.item()
    elif value is None or isinstance(value, (bool, int, float, str)):
        yield name, value


def changed(scene: Scene, numbers: Mapping[str, object]) -> Scene:
    """The scene with some of its numbers changed, of those that may change during a run.

    Raises:
        InputError: a number that there is none of, that may not change, or that is out of range.
    """
    parts = {"material.": Material, "surroundings.": Surroundings, "numerics.": Numerics}
    homes = {f.name: part for part, cls in parts.items() for f in fields(cls)} | {"dt": ""}
    free = sorted(name for name, part in homes.items() if f"{part}{name}" not in STAY)
    for name in numbers:
        require(name in free, "a number that changes during a run", name, f"one of {', '.join(free)}")
    given = {part: {n: v for n, v in numbers.items() if homes[n] == part} for part in parts}
    made = {part[:-1]: replace(getattr(scene, part[:-1]), **values) for part, values in given.items()}
    return replace(scene, **made, **{name: value for name, value in numbers.items() if name == "dt"})


def compare(path: str | os.PathLike, was: Mapping, scene: Scene, changed: bool) -> None:
    """Refuse a checkpoint of another scene, one whose numbers are `was`.

    Raises:
        InputError: tells which numbers differ.
    """
    now = describe(scene)
    require(isinstance(was, dict), f"checkpoint {path}", "one without numbers of its scene", "ours")
    keys = [key for key in {**was, **now} if was.get(key) != now.get(key)]
    if changed:
        keys = [key for key in keys if key in STAY or not key.startswith(MAY_CHANGE)]
    if keys:
        told = [f"{key} is {was.get(key, 'none')!r} there, {now.get(key, 'none')!r} here" for key in keys[:MOST_TOLD]]
        more = f" and {len(keys) - MOST_TOLD} more" if len(keys) > MOST_TOLD else ""
        what = "has numbers that cannot change during a run" if changed else "is of another scene"
        raise InputError(f"checkpoint {path} {what}: {'; '.join(told)}{more}"[:1000])


def write(
    path: str | os.PathLike, scene: Scene, film: Mapping, state: State, notices: Notices, run: Mapping | None = None
) -> None:
    """Write a checkpoint, whole or not at all.

    Args:
        path: the file; one of that name is replaced.
        scene: the scene.
        film: spacing, radius and room.
        state: the state.
        notices: of the run.
        run: what else the command line wants to know again; plain values.

    Raises:
        OSError: it cannot be written; what was there before still is.
    """
    arrays, ours = state.numpy(), declared()
    extras = {name: (array.dtype.kind, array.ndim) for name, array in arrays.items() if name not in ours}
    header = {
        "format": FORMAT,
        **({"extras": extras} if extras else {}),
        "program": melp_warp.__version__,
        "scene": describe(scene),
        "film": dict(film),
        "course": asdict(state.course),
        "seen": [[values.tolist(), list(note)] for values, note in state.seen.contents()],
        "notices": notices.save(),
        "run": dict(run or {}),
    }
    members = {HEADER: np.frombuffer(json.dumps(header).encode(), dtype=np.uint8), **arrays}
    save_arrays(path, {**members, CHECKSUM: checksum(members)})


def checksum(members: Mapping[str, np.ndarray]) -> np.ndarray:
    """SHA-256 of all members but the checksum itself. [32] uint8."""
    total = hashlib.sha256()
    for name in sorted(members):
        if name != CHECKSUM:
            array = np.ascontiguousarray(members[name])
            total.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
            total.update(array.reshape(-1).view(np.uint8).data)
    return np.frombuffer(total.digest(), dtype=np.uint8)


def read_header(path: str | os.PathLike) -> dict:
    """The header of a checkpoint alone, not checked but for its format.

    Raises:
        InputError: the file cannot be read, or is none of this format.
    """
    members = load_arrays(path, {HEADER: ("i", 1)})
    require(HEADER in members and members[HEADER].dtype == np.uint8, f"checkpoint {path}", "one without header", "ours")
    try:
        header = json.loads(members[HEADER].tobytes().decode())
    except (ValueError, RecursionError) as error:
        raise InputError(f"checkpoint {path} cannot be read: {str(error).splitlines()[0]}") from None
    known = isinstance(header, dict) and header.get("format") == FORMAT
    if not known:
        told = f"{header.get('format')} of melp-warp {header.get('program')}" if isinstance(header, dict) else "none"
        raise InputError(f"checkpoint {path} has format {told[:60]}, this melp-warp reads format {FORMAT}")
    lacking = {"scene", "film", "course", "seen", "notices", "run"} - header.keys()
    require(not lacking, f"checkpoint {path}", f"a header without {', '.join(sorted(lacking))}", "ours")
    return header


def read(path: str | os.PathLike, scene: Scene, changed: bool = False) -> Checkpoint:
    """Read a checkpoint of a scene and check it.

    Args:
        path: the file.
        scene: what is to go on.
        changed: whether numbers of the scene that may change during a run may differ from those in the file.

    Raises:
        InputError: the file cannot be read, is damaged, is of another scene, or holds what no run can have left.
    """
    header = read_header(path)
    compare(path, header["scene"], scene, changed)
    shapes, arrays = declared(scene), _load_all(path, scene)
    try:
        if changed:
            _allow_bursts(header, arrays, scene)
        course = check_course(header["course"], scene)
        features = Features.of(scene, course.holed)
        film = check_film(header["film"], scene, features.floats)
        seen = check_seen(header["seen"])
        needed = {name for name, (*_, when) in shapes.items() if when is None or when(features)}
        if not course.labels:
            needed.discard("b.mirror")  # no film, no frame
        given = {name: array for name, array in arrays.items() if name in needed}
        optional = {name for name in needed if changed and name.startswith(("memory.", *OF_BURSTS))}
        boundary = boundary_count(scene, film["spacing"])
        check_stored(given, shapes, needed - optional, course, scene, boundary)
        check_notices(header["notices"])
        require(isinstance(header["run"], dict), "run", header["run"], "names and values")
        _require_sum(arrays)
    except InputError as error:
        raise InputError(f"checkpoint {path} does not fit: {error}") from None
    return Checkpoint(film, course, seen, header["notices"], header["run"], given)


def _allow_bursts(header: dict, arrays: Mapping[str, np.ndarray], scene: Scene) -> None:
    """Let a run go on as one with other punctures, of which those whose time has passed are none, and other tempo.

    Raises:
        InputError: the frames that are done would have ended at other times.
    """
    time, frame = (float(arrays.get(name, np.zeros(())).ravel()[:1].sum()) for name in ("time", "frame"))
    then = scene.film_time(frame)
    require(abs(then - time) <= 1e-6 * max(time, 1e-3), "slow_from", scene.slow_from, f"at least {time:.6g} s, by now")
    if isinstance(header["course"], dict):
        header["course"]["punctured"] = sum(one.time < time - 1e-12 for one in scene.bursting.punctures)
        if not Features.of(scene).budget:
            header["course"]["ledger"] = None


def check_sum(path: str | os.PathLike) -> None:
    """Refuse a file that is not what was written: `InputError`."""
    header = read_header(path)
    try:
        _require_sum(_load_all(path, None, _extras_of(header)))
    except InputError as error:
        raise InputError(f"checkpoint {path} cannot be used: {error}") from None


def _load_all(path: str | os.PathLike, scene: Scene | None, extras: Mapping | None = None) -> dict[str, np.ndarray]:
    """All members that a checkpoint may have, with those of a scene or the `extras` that a header tells of."""
    all_of = declared(scene)
    shapes = {name: (kind, len(columns) + (size is not None)) for name, (kind, size, columns, _) in all_of.items()}
    return load_arrays(path, {**(extras or {}), **shapes, HEADER: ("i", 1), CHECKSUM: ("i", 1)})


def _extras_of(header: Mapping) -> dict[str, tuple[str, int]]:
    """Kind and dimensions of the arrays that a scene has brought along, as a header tells."""
    told = header.get("extras", {})
    known = [["f", 1], ["f", 2], ["f", 3], ["i", 1], ["i", 2], ["i", 3]]
    right = isinstance(told, dict) and all(one in known for one in told.values())
    require(right, "extras", told, "kind and dimensions of arrays")
    return {name: (kind, ndim) for name, (kind, ndim) in told.items()}


def _require_sum(members: Mapping[str, np.ndarray]) -> None:
    right = CHECKSUM in members and np.array_equal(members[CHECKSUM], checksum(members))
    require(right, "checksum", "another", "that of what the file holds: it is damaged")
