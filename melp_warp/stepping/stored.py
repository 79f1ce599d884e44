"""What the arrays of a checkpoint must fulfil before a run goes on from them, whoever wrote them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Set
from dataclasses import fields

import numpy as np

from melp_warp.cluster import Cluster
from melp_warp.errors import require
from melp_warp.features import Features
from melp_warp.scene import MOST_STEPS_AGAIN, Scene
from melp_warp.stages.film import count_parts
from melp_warp.stages.state import GAS_SLOTS, Course, Declared
from melp_warp.stepping.ledger import CAUSES, STORE, TERMS, Ledger

FARTHEST = 1e6
"""Largest coordinate (m) and speed (m/s)."""

LARGEST = 1e30
"""Largest of all other numbers: products of two must not overflow."""

UNIT = 0.01
"""Largest departure of a normal's length from 1."""

NOT_NEGATIVE = ("mass", "surfactant", "eta")
MOVING = ("x", "u", "v")

PLACES = ("b.mirror", *(f"memory.{name}" for name in ("x", "mirror", "wide", "x_e", "x_l", "place")))

LARGEST_SIZE = 1e6
"""Largest spacing or radius of a film, m, and room of a list."""

LENGTHS = {"e": "e.mass", "n": "e.x", "l": "l.x", "f": "f.x", "d": "d.x", "h": "swept.l"}
"""Arrays that say how many particles there are, by the names of `State.sizes`."""


def check_stored(
    stored: Mapping[str, np.ndarray],
    shapes: Mapping[str, Declared],
    needed: Set[str],
    course: Course,
    scene: Scene,
    boundary: int,
) -> None:
    """Refuse stored arrays that no run can have left: `InputError` names the array.

    Args:
        stored: arrays by name, as `State.numpy` names them.
        shapes: what they are declared to be, see `state.declared`.
        needed: names of those that must be there.
        course: what was stored with them.
        scene: the scene.
        boundary: number of boundary particles that the scene has.
    """
    missing = [name for name in shapes if name in needed and name not in stored]
    require(not missing, "checkpoint", f"one without {', '.join(missing)}", "of this scene")
    regions = len(course.labels)
    boundary = boundary if regions else 0  # no film, no frame
    sizes = {"r": regions, "b": boundary, **{tag: len(stored.get(name, ())) for tag, name in LENGTHS.items()}}
    sizes["p"] = count_parts(regions)
    require(sizes["n"] == sizes["e"] + boundary, "e.x", sizes["n"], f"{boundary} more than e.mass")
    for tag in (tag for tag in "el" if LENGTHS[tag] in stored):
        allowed = "of one particle at least" if regions else "empty, as there is no region"
        require((sizes[tag] > 0) == (regions > 0), LENGTHS[tag], f"{sizes[tag]} particles", allowed)
    for name, array in stored.items():
        _, length, columns, _ = shapes[name]
        wanted = () if length is None else (sizes.get(length, length), *columns)
        require(array.shape == wanted, name, array.shape, f"of shape {wanted} for this scene")
        _check_values(name, array)
    for name in ("ids.e", "ids.l", "ids.d"):
        if name in stored:
            _check_ids(name, stored[name], course.issued[name[-1]])
    for name in ("f.after", "f.before"):
        if name in stored:
            _check_index(name, stored[name], sizes["f"], low=-1)
    if "swept.l" in stored:
        _check_ids("swept.l", stored["swept.l"], course.issued["l"])
        _check_index("swept.rim", stored["swept.rim"], sizes["f"], low=-1)
        _check_index("swept.drop", stored["swept.drop"], course.issued["d"], low=-1)
    for name, most in (("e.region", regions), ("l.region", regions), ("memory.home", sizes["e"])):
        if name in stored and regions:
            _check_index(name, stored[name], most)
    region = stored["e.region"][: sizes["e"]]
    whole = bool((np.diff(region) >= 0).all()) and len(np.unique(region)) == regions
    require(whole, "e.region", "another order", "ascending, with E of every region")
    foam = isinstance(scene.shape, Cluster)
    _check_gas(stored["gas"], course, closed=boundary == 0 and (foam or not course.holed))
    if "f.region" in stored:
        _check_index("f.region", stored["f.region"], max(regions, 1))
        _check_index("f.other", stored["f.other"], max(regions, 1), low=-1)
        torn = {(course.labels.index(k), course.labels.index(j) if j >= 0 else -1) for k, j in course.tears}
        sides = set(zip(stored["f.region"].tolist(), stored["f.other"].tolist(), strict=True))
        right = sides <= (torn if foam else {(0, -1)})
        require(right, "f.region, f.other", sorted(sides)[:5], "of films that are torn")
    frame, time = int(stored["frame"]), float(stored["time"])
    require(0 <= frame <= 1_000_000, "frame", frame, "from 0 to 1000000")
    least = scene.film_time(frame) * (1.0 - 1e-9)
    require(least <= time <= 1e9, "time", time, f"at least {least:.6g} s, the end of frame {frame}")


def check_course(stored: object, scene: Scene) -> Course:
    """What the host remembers, from a header."""
    cluster, features = scene.shape if isinstance(scene.shape, Cluster) else None, Features.of(scene)
    names = {f.name for f in fields(Course)}
    right = isinstance(stored, dict) and set(stored) == names
    require(right, "course", sorted(stored)[:20] if isinstance(stored, dict) else stored, "what a run remembers")
    others = ("builds", "labels", "unborn", "shown", "fresh", "pending", "ledger", "punctured", "holed", "tears")
    others += ("left", "issued", "areas", "torn")
    numbers = {k: v for k, v in stored.items() if k not in others}
    for name, value in numbers.items():
        none = name == "layer_speed" and value is None
        _check_number(name, 0.0 if none else value, infinite=name == "cap")
    least = 1.0 / (scene.fps * MOST_STEPS_AGAIN)
    require(stored["cap"] >= least, "cap", stored["cap"], f"at least {least:.3g} s")
    require(stored["speed"] > 0.0, "speed", stored["speed"], "above 0 m/s")
    require(stored["paid"] <= 1.0, "paid", stored["paid"], "from 0 to 1")
    for name in ("fresh", "holed"):
        _check_flag(name, stored[name])
    holes = len(scene.bursting.punctures)
    _check_whole("punctured", [stored["punctured"]])
    require(stored["punctured"] <= holes, "punctured", stored["punctured"], f"at most {holes}, those of this scene")
    bursts = scene.bursts
    _check_tears(stored["tears"], stored["labels"], bursts and cluster is not None)
    require(bursts or not stored["holed"], "holed", stored["holed"], "false for a scene in which nothing bursts")
    for name in ("builds", "labels", "unborn"):
        _check_whole(name, stored[name])
    built = len(stored["builds"]) == 2 and (min(stored["builds"]) >= 1 or not stored["labels"])
    require(built, "builds", stored["builds"], "two numbers above 0")
    issued = stored["issued"]
    right = isinstance(issued, dict) and set(issued) == {"e", "l", "d"}
    require(right, "issued", issued, "numbers given to E, L and drops")
    _check_whole("issued", list(issued.values()))
    torn = stored["torn"]
    require(isinstance(torn, list) and len(torn) == 2, "torn", torn, "two energies, J")
    for energy in torn:
        _check_signed("torn", energy)
    areas = stored["areas"]
    require(isinstance(areas, list), "areas", areas, "a list of areas, m^2")
    for area in areas:
        _check_number("areas", area)
    require(stored["spacing"] > 0.0, "spacing", stored["spacing"], "above 0 m")
    shown = stored["shown"]
    require(isinstance(shown, list) and len(shown) == 3, "shown", shown, "three numbers")
    for value in shown:
        _check_number("shown", abs(value) if isinstance(value, float) else value, most=FARTHEST)
    _check_labels(stored["labels"], stored["unborn"], cluster, stored["holed"])
    left, names = stored["left"], {one.name for one in scene.carried}
    require(isinstance(left, dict) and set(left) == names, "left", left, f"numbers of {', '.join(names) or 'nothing'}")
    for name, value in left.items():
        _check_number(f"left of {name}", abs(value) if isinstance(value, float) else value)
    _check_whole("pending", [stored["pending"]])
    events = len(cluster.events) if cluster else 0
    require(stored["pending"] <= events, "pending", stored["pending"], f"at most {events}, the events of this scene")
    return Course(**{**stored, "ledger": _check_ledger(stored["ledger"], features)})


def _check_ledger(stored: object, features: Features) -> Ledger | None:
    """The energy budget, None where the scene wants none."""
    if not features.budget:
        require(stored is None, "ledger", type(stored).__name__, "none")
        return None
    known = {f.name for f in fields(Ledger)}
    require(isinstance(stored, dict) and set(stored) == known, "ledger", type(stored).__name__, "an energy budget")
    for name in (
        "time",
        "rest",
        "worst",
        "moved",
        "liquid",
        "surfactant",
        *(["owed"] if stored["owed"] is not None else []),
    ):
        _check_signed(name, stored[name])
    require(stored["cause"] in CAUSES, "cause", stored["cause"], f"one of {', '.join(CAUSES)}")
    begun = stored["momentum"] != []
    require(not begun or stored["liquid"] > 0.0, "liquid", stored["liquid"], "above 0 kg")
    for name in ("pushed", "impulse", *(["momentum"] if begun else [])):
        _check_three(name, stored[name])
    stores, flows = ({t.name for t in TERMS if (t.kind == STORE) is is_store} for is_store in (True, False))
    for name in ("stores", "start"):
        _check_terms(name, stored[name], stores, none=True)
    for name in ("flows", "past"):
        _check_terms(name, stored[name], flows)
    air = isinstance(stored["weighed"], dict) and "air" in stored["weighed"]  # another scheme may have had none
    _check_terms("weighed", stored["weighed"], {"gravity", "surfactant", *(["air"] if air else [])}, none=True)
    balance = stored["balance"]
    require(isinstance(balance, dict), "balance", balance, "numbers by name")
    if balance:
        _check_terms("balance", {k: v for k, v in balance.items() if k != "momentum"}, {"liquid", "surfactant"})
        _check_three("balance", balance.get("momentum"))
    return Ledger(**stored)


def _check_tears(tears: object, labels: object, possible: bool) -> None:
    """Torn films are between regions that there are, each once."""
    require(isinstance(tears, list) and (possible or not tears), "tears", tears, "none" if not possible else "a list")
    there = labels if isinstance(labels, list) else []
    for one in tears:
        pair = isinstance(one, list) and len(one) == 2 and all(type(k) is int for k in one)
        right = pair and one[0] in there and (one[1] == -1 or one[1] in there) and one[0] != one[1]
        require(right and tears.count(one) == 1, "tears", one, "two regions that there are, each pair once")


def check_notices(stored: object) -> dict:
    """What was doubted so far, see `Notices.save`."""
    right = isinstance(stored, dict) and set(stored) == {"frames", "spans"} and isinstance(stored["spans"], dict)
    require(right, "notices", type(stored).__name__, "frames and spans")
    _check_whole("notices", [stored["frames"]])
    for span in stored["spans"].values():
        right = isinstance(span, dict) and set(span) == {"frames", "first", "worst", "value"}
        require(right, "notices", span, "frames, first, worst and value of each")
        _check_whole("notices", [span["frames"], span["first"], span["worst"]])
        require(isinstance(span["value"], float), "notices", span["value"], "a number")
    return stored


def _check_terms(name: str, values: object, terms: set[str], none: bool = False) -> None:
    """A number for each term; `none` of them may be there, as before the first step."""
    right = isinstance(values, dict) and (set(values) == terms or (none and values == {}))
    require(right, name, list(values)[:20] if isinstance(values, dict) else values, "terms of the energy budget")
    for value in values.values():
        _check_signed(name, value)


def _check_three(name: str, values: object) -> None:
    require(isinstance(values, list) and len(values) == 3, name, values, "three numbers")
    for value in values:
        _check_signed(name, value)


def _check_signed(name: str, value: object) -> None:
    plain = isinstance(value, (int, float)) and not isinstance(value, bool) and abs(value) <= LARGEST
    require(plain, name, value, f"a number up to {LARGEST:g}")


def check_film(stored: object, scene: Scene, closed: bool) -> dict[str, float]:
    """Spacing, radius and room of a film; one that breathes may have any size that it takes."""
    area, e_count = scene.shape.area, scene.e_count
    swell = max([1.0, *(max(a, 1.0 / a) for _, a in scene.gas)]) ** (1.0 / 3.0) if not scene.opening else 1e3
    names = {"spacing", "radius", "room"}
    require(isinstance(stored, dict) and set(stored) == names, "film", stored, "spacing, radius and room")
    for name, value in stored.items():
        _check_number(name, value, infinite=name == "radius" and not closed, most=LARGEST_SIZE)
    near = 0.5 / swell < stored["spacing"] / math.sqrt(area / e_count) < 2.0 * swell
    require(near, "spacing", stored["spacing"], "that of the scene's particles, m")
    require(1.0 <= stored["room"] <= 100.0, "room", stored["room"], "from 1 to 100")
    size = math.sqrt(area / (4.0 * math.pi))
    require(
        not closed or 0.1 / swell < stored["radius"] / size < 10.0 * swell,
        "radius",
        stored["radius"],
        "that of the film, m",
    )
    return dict(stored)


def check_seen(stored: object) -> list:
    """How far particles had moved, from a header."""
    rows = stored if isinstance(stored, list) else [None]
    for row in rows:
        pair = isinstance(row, list) and len(row) == 2 and all(isinstance(part, list) for part in row)
        require(pair and (len(row[0]), len(row[1])) == (6, 4), "seen", row, "six distances and four numbers")
        for value in (*row[0], *row[1]):
            _check_number("seen", value)
        require(row[1][0] > 0.0, "seen", row[1][0], "a step above 0 s")
    require(len(rows) <= 2, "seen", len(rows), "two at most")
    return [(np.array(values), tuple(note)) for values, note in rows]


def _check_number(name: str, value: object, infinite: bool = False, most: float = LARGEST) -> None:
    plain = isinstance(value, (int, float)) and not isinstance(value, bool)
    good = plain and (0.0 <= value <= most or (infinite and value == math.inf))
    require(good, name, value, f"a number from 0 to {most:g}")


def _check_flag(name: str, value: object) -> None:
    require(isinstance(value, bool), name, value, "true or false")


def _check_whole(name: str, values: object) -> None:
    right = isinstance(values, list) and all(type(k) is int and 0 <= k < 2**31 for k in values)
    require(right, name, values, "whole numbers from 0")


def _check_labels(labels: list[int], unborn: list[int], cluster: Cluster | None, holed: bool) -> None:
    """Regions are bubbles of the scene, each once, none where all have popped; those to come are others."""
    bubbles = len(cluster.bubbles) if cluster else 1
    late = {k for k, b in enumerate(cluster.bubbles) if b.born > 0.0} if cluster else set()
    some = len(labels) > 0 or cluster is not None or holed
    known = some and len(set(labels)) == len(labels) and all(k < bubbles for k in labels)
    require(known, "labels", labels[:20], f"regions of this scene, 0 to {bubbles - 1}, each once")
    other = len(set(unborn)) == len(unborn) and set(unborn) <= late - set(labels)
    require(other, "unborn", unborn[:20], "bubbles of this scene that are still to come, each once")


def _check_ids(name: str, ids: np.ndarray, issued: int) -> None:
    good = len(ids) == 0 or (int(ids.min()) >= 0 and int(ids.max()) < issued and len(np.unique(ids)) == len(ids))
    require(good, name, "others", f"whole numbers from 0 to below {issued}, as many as were given, each once")


def _check_values(name: str, array: np.ndarray) -> None:
    """Finite and no larger than the solver can take."""
    field = name.rsplit(".", maxsplit=1)[-1]
    if array.dtype.kind == "f" and array.size:
        require(bool(np.isfinite(array).all()), name, "NaN or infinity", "finite")
        most = FARTHEST if field in MOVING or name in ("origin", "motion") or name in PLACES else LARGEST
        largest = float(np.abs(array).max())
        require(largest <= most, name, largest, f"at most {most:g}")
    if field in NOT_NEGATIVE and array.size:
        require(float(array.min()) >= 0.0, name, float(array.min()), "0 or above")
    if field == "eta" and array.size:
        require(float(array.min()) > 0.0, name, float(array.min()), "above 0 m")
    if field in ("normal", "facing") and array.size:
        length = np.linalg.norm(array.astype(np.float64), axis=1)
        worst = float(length[np.argmax(np.abs(length - 1.0))])
        require(abs(worst - 1.0) <= UNIT, name, worst, "of unit length")


def _check_index(name: str, index: np.ndarray, count: int, low: int = 0) -> None:
    least, most = int(index.min(initial=0)), int(index.max(initial=low))
    require(least >= low and most < count, name, [least, most], f"from {low} to {count - 1}")


def _check_gas(gas: np.ndarray, course: Course, closed: bool) -> None:
    """What encloses gas has a volume and an amount of it; one with a hole may have none."""
    opened = [label in [k for k, j in course.tears if j < 0] for label in course.labels]
    for k, slots in enumerate(gas if closed else ()):
        held = dict(zip(GAS_SLOTS, slots.tolist(), strict=True))
        require(held["volume"] > 0.0, "gas, volume", held["volume"], "above 0")
        right = held["amount"] >= 0.0 if opened[k] else held["amount"] > 0.0
        require(right, "gas, amount", held["amount"], "0 or more for a bubble with a hole" if opened[k] else "above 0")
