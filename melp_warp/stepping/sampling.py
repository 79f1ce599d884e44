"""From a scene to the particles it starts with."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import warp as wp

from melp_warp.cluster import Cluster, Wall
from melp_warp.device.launch import compile_kernels
from melp_warp.errors import InputError, require
from melp_warp.features import Features
from melp_warp.scene import Scene
from melp_warp.shapes import Rim, Samples
from melp_warp.stages.advance import Redistribution
from melp_warp.stages.film import ROOM, THICKEST, Film, RimArrays
from melp_warp.stages.state import (
    INCREMENT,
    OFFSET,
    VOLUME,
    BoundaryState,
    Course,
    EulerianState,
    LagrangianState,
    State,
    allocate,
    allocate_beads,
)
from melp_warp.stepping.parts import CARRIERS, NORMAL_MOTIONS, kernel_files
from melp_warp.stepping.stepper import Stepper, make_stepper
from melp_warp.stepping.topology import Stored

RELAXATION_STEPS = 30
MOST_RELAXATION_STEPS = 300
EVEN_ENOUGH = 0.5
"""(delta_max - delta_min)/delta_mean of E at which a start that takes more steps to even out is good enough."""

WAVE = 5.0
"""Fewest E spacings a wave: the curvature of a shorter one is off by over a quarter, h^2 k^2 times `geometry.BLUR`."""

MOST_TURN = 5.0
"""Largest rms angle between normals of E and those of the shape at which it counts as resolved, degrees."""

FAR = 4.0
"""Distance of a film from the origin, in its own sizes, from which on positions are measured from the film."""


def _field(function, points: np.ndarray, default: float, name: str, width: int = 1) -> np.ndarray:
    """Evaluate a scene's field and check it."""
    shape = (len(points),) if width == 1 else (len(points), width)
    if function is None:
        return np.full(shape, default)
    values = _values(function, points, name)
    require(values.shape == shape, name, values.shape, f"a field of shape {shape}")
    if not np.all(np.isfinite(values)):
        bad = int(np.argwhere(~np.isfinite(values))[0][0])
        raise InputError(f"{name} must be finite everywhere, got {values[bad]!r} at {points[bad].tolist()}")
    return values


def _values(function, points: np.ndarray, name: str) -> np.ndarray:
    """What a field's function gives at points."""
    require(callable(function), name, function, "a function of points [n, 3]")
    try:
        given = function(points)
    except TypeError as error:
        if error.__traceback__.tb_next is not None:  # from within the function
            raise
        raise InputError(f"{name} must be a function of points alone: {error}") from None
    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(f"{name} must be a field of numbers, got {str(given)[:60]!r}") from None


def _refuse(bad: np.ndarray, values: np.ndarray, points: np.ndarray, name: str, allowed: str) -> None:
    """Raise for the first of `points` [n, 3] where a field is `bad` [n]."""
    if np.any(bad):
        i = int(np.argmax(bad))
        raise InputError(f"{name} must be {allowed} everywhere, got {values[i]:.3g} at {points[i].tolist()}")


def _check_resolution(scene: Scene, spacing: float) -> None:
    support = scene.numerics.support
    if isinstance(scene.shape, Cluster):
        _check_smallest(scene.shape, scene.e_count, support)
        return
    need = 3.0 * support**2
    require(scene.e_count >= need, "e_count", scene.e_count, f"at least {math.ceil(need)} with support {support:g}")
    size = 2.0 * support * spacing
    extent = float(np.min(scene.shape.extent()))
    require(
        extent >= size,
        "e_count",
        scene.e_count,
        f"larger: the E spacing {spacing:.3g} m asks for a film of at least {size:.3g} m, it is {extent:.3g} m across",
    )


def _check_waves(scene: Scene, spacing: float) -> None:
    """Whether the waves that are known are resolved."""
    for name, length in scene.waves.items():
        need = math.ceil(scene.e_count * (WAVE * spacing / length) ** 2)
        allowed = (
            f"at least {need} for {name}, which asks for waves of {length:.3g} m:"
            f" {length / spacing:.2g} E spacings each, {WAVE:g} are needed"
        )
        require(length >= WAVE * spacing, "e_count", scene.e_count, allowed)


def _check_smallest(cluster: Cluster, e_count: int, support: float) -> None:
    """Whether the smallest bubble, also one to be born, is at least two kernel supports across."""
    need, k = cluster.fewest_e(support), cluster.smallest
    radius = cluster.bubbles[k].radius
    later = "" if len(cluster.initial) == len(cluster.bubbles) else f" for the {len(cluster.initial)} at the start"
    allowed = f"at least {need}{later}: bubble {k}, of radius {radius:.3g} m, must be {2.0 * support:g} spacings across"
    require(e_count >= need, "e_count", e_count, allowed)


def _origin(points: np.ndarray) -> np.ndarray:
    """Where to measure positions from: the world's origin, or the middle of a film that is far from it. [3], m."""
    low, high = points.min(axis=0), points.max(axis=0)
    middle = 0.5 * (low + high)
    return middle if np.abs(middle).max() > FAR * (high - low).max() else np.zeros(3)


def _e_state(scene: Scene, device) -> tuple[EulerianState, BoundaryState | None, float, np.ndarray]:
    samples = scene.shape.sample(scene.e_count)
    n_e = len(samples.points)
    spacing = float(np.sqrt(samples.area.sum() / n_e))
    _check_resolution(scene, spacing)
    _check_waves(scene, spacing)
    samples = _in_order(samples, spacing)
    rim = _rim(scene, spacing)
    origin = _origin(samples.points)
    points, normals = samples.points - origin, samples.normals
    boundary = None
    if rim is not None:
        points = np.concatenate([points, rim.points - origin])
        normals = np.concatenate([normals, rim.normals])
        boundary = allocate(BoundaryState, {"b": len(rim.points)}, device)
        boundary.mirror.assign(rim.mirror - origin)
    state = allocate(EulerianState, {"e": n_e, "n": len(points)}, device, Features.of(scene), count=n_e)
    state.x.assign(points)
    state.normal.assign(normals)
    state.region.assign(_regions(samples, len(points)))
    return state, boundary, spacing, origin


def _rim(scene: Scene, spacing: float) -> Rim | None:
    return scene.shape.rim(spacing, (scene.numerics.support + scene.numerics.skin) * spacing)


def boundary_count(scene: Scene, spacing: float) -> int:
    """Number of boundary particles that a film of this E spacing (m) has."""
    rim = _rim(scene, spacing)
    return 0 if rim is None else len(rim.points)


def _regions(samples: Samples, count: int) -> np.ndarray:
    """[count] region of each particle; boundary particles follow those sampled and are of region 0."""
    region = np.zeros(count, dtype=np.int32)
    if samples.region is not None:
        region[: len(samples.region)] = samples.region
    return region


def spatial_order(points: np.ndarray, cell: float) -> np.ndarray:
    """[n] order that visits points cell by cell along a Z-curve, so that neighbours lie close in memory."""
    q = ((points - points.min(axis=0)) / cell).astype(np.uint64)
    code = np.zeros(len(q), dtype=np.uint64)
    for bit in range(20):
        for axis in range(3):
            code |= ((q[:, axis] >> np.uint64(bit)) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")


def _in_order(samples: Samples, spacing: float) -> Samples:
    """The samples in spatial order, region by region."""
    order = spatial_order(samples.points, spacing)
    region = samples.region
    if region is not None:
        order = order[np.argsort(region[order], kind="stable")]
        region = region[order]
    return Samples(samples.points[order], samples.normals[order], samples.area[order], region)


def _l_state(scene: Scene, n_e: int, spacing: float, origin: np.ndarray, device) -> LagrangianState | None:
    if scene.l_per_e == 0:
        return None
    samples = scene.shape.sample(n_e * scene.l_per_e, offset=0.5)
    order = spatial_order(samples.points, spacing)
    count = len(order)
    state = allocate(LagrangianState, {"l": count}, device, Features.of(scene), count=count)
    state.x.assign(samples.points[order] - origin)
    state.normal.assign(samples.normals[order])
    state.region.assign(_regions(samples, count)[order])
    # While areas are found, eta holds 1/area and mass holds rho: an L then claims rho/(rho eta), its area.
    state.eta.assign(1.0 / samples.area[order])
    state.mass.fill_(scene.material.density)
    return state


def make_film(scene: Scene, device) -> tuple[Film, Stepper]:
    """Sample the scene's shape and set up the stepper with consistent masses, velocities and gas.

    Raises:
        InputError: the scene cannot be sampled as asked.
    """
    features = Features.of(scene)
    compile_kernels(kernel_files(features), device)
    require(
        features.moving or features.carrier != "none",
        "l_per_e",
        scene.l_per_e,
        "at least 1 for a flat film, which has no normal motion",
    )
    e, boundary, spacing, origin = _e_state(scene, device)
    lagrangian = _l_state(scene, e.count, spacing, origin, device)
    labels = scene.shape.initial
    state = State(e, lagrangian, boundary, len(labels), features, origin)
    state.course.labels, state.course.shown = list(labels), origin.tolist()
    film = film_of(scene, state, spacing)
    if features.closed:
        film = replace(film, radius=float(np.sqrt(scene.shape.area / (4.0 * np.pi))))
    if features.moving:
        _relax(scene, film, state)
        state.forget()
        if features.closed:
            film = replace(film, radius=float(np.cbrt(3.0 * state.gas.numpy()[0, 0] / (4.0 * np.pi))))
    stepper = make_stepper(film, state)
    _set_masses(scene, stepper)
    if features.closed:
        _fill_gas(film, stepper)
    _set_velocity(scene, stepper)
    return film, stepper


def unresolved(scene: Scene, stepper: Stepper) -> float:
    """How far the E are from resolving the shape: rms angle of the fitted normals from its own, degrees; 0 if unknown.

    Noise of four E spacings a cell, at which a volume is off by up to a hundredth, gives about `MOST_TURN`.
    """
    e = stepper.state.e
    own = scene.shape.normals(e.x.numpy()[: e.count].astype(np.float64) + stepper.state.origin)
    if own is None:
        return 0.0
    cosine = np.sum(own * e.normal.numpy()[: e.count], axis=1)
    return float(np.degrees(np.sqrt(np.mean(np.arccos(np.clip(cosine, -1.0, 1.0)) ** 2))))


def film_of(scene: Scene, state: State, spacing: float, room: float | None = None, radius: float = math.inf) -> Film:
    """The film around a state, whose particles are `spacing` (m) apart; see `Film` for the others."""
    features = Features.of(scene, state.course.holed)
    device, sizes, labels = state.e.x.device, state.sizes, state.course.labels
    counts = np.bincount(state.e.region.numpy()[: sizes["e"]], minlength=sizes["r"])
    factors = scene.shape.tensions(labels)
    tension = scene.material.tension * np.array(factors, dtype=wp.dtype_to_numpy(wp.float32))
    rim = _rim(scene, spacing) if sizes["e"] else None
    if rim is not None:
        held = (rim.anchors - state.origin, rim.outward, rim.curvature)
        rim = RimArrays(*(wp.array(a, dtype=wp.vec3, device=device) for a in held))
    if room is None:
        room = ROOM * CARRIERS[features.carrier].room
    return Film(
        device=device,
        features=features,
        material=scene.material,
        surroundings=scene.surroundings,
        numerics=scene.numerics,
        spacing=spacing,
        n_e=sizes["e"],
        n_b=sizes["b"],
        n_l=sizes["l"],
        first=wp.array(np.concatenate([[0], np.cumsum(counts)]), dtype=wp.int32, device=device),
        tension=wp.array(tension, dtype=wp.float32, device=device),
        labels=tuple(labels),
        seed=scene.seed,
        walls=_walls_from(state.origin, scene.shape.walls),
        forces=scene.forces,
        air=scene.air_model,
        rim=rim,
        radius=radius,
        room=room,
    )


def _walls_from(origin: np.ndarray, walls: tuple[Wall, ...]) -> tuple[Wall, ...]:
    """The walls as seen from the origin of a state."""
    return tuple(replace(wall, point=tuple(wall.point - origin)) for wall in walls)


def state_of(scene: Scene, stored: dict[str, np.ndarray], regions: int, device, holed: bool = False) -> State:
    """A state of the arrays that `State.numpy` gives, whatever their lengths; what is not there is zero."""
    n_e, n, n_l, n_f, n_d = (len(stored.get(name, ())) for name in ("e.mass", "e.x", "l.x", "f.x", "d.x"))
    features = Features.of(scene, holed)
    e = allocate(EulerianState, {"e": n_e, "n": n}, device, features, count=n_e)
    lagrangian = allocate(LagrangianState, {"l": n_l}, device, features, count=n_l) if "l.x" in stored else None
    boundary = allocate(BoundaryState, {"b": n - n_e}, device) if "b.mirror" in stored else None
    rims, drops = allocate_beads(n_f, n_d, device, features) if features.bursts else (None, None)
    state = State(e, lagrangian, boundary, regions, features, time=float(stored["time"]), f=rims, d=drops)
    state.load(stored)
    return state


def set_up_again(scene: Scene, stored: Stored, before: State, film: Film) -> tuple[Film, Stepper]:
    """Film and stepper of a state of other regions or with other holes; arguments as of `set_up_foam`."""
    set_up = set_up_foam if isinstance(scene.shape, Cluster) else set_up_holed
    return set_up(scene, stored, before, film)


def set_up_foam(scene: Scene, stored: Stored, before: State, film: Film) -> tuple[Film, Stepper]:
    """Film and stepper of a foam whose regions have changed.

    Without regions there is nothing to step: the stepper is then a `NoFilm`.

    Args:
        scene: the scene.
        stored: the foam as it is now.
        before: the state before the change.
        film: the film before it.
    """
    state = state_of(scene, stored.arrays, len(stored.labels), film.device)
    state.ids, state.swept = stored.ids, stored.swept.held
    stays = (
        *("limit", "cap", "speed", "pending", "unborn", "shown", "ledger", "punctured", "holed", "run", "torn", "rest"),
        *("issued", "sprayed", "spacing", "areas"),
    )
    kept = {name: getattr(before.course, name) for name in stays}
    own = {"labels": stored.labels, "spilled": stored.spilled, "tears": stored.tears, "left": stored.left}
    state.course = Course(**kept, crossed=state.time, mixed=state.time, **own)
    film = film_of(scene, state, film.spacing, film.room)
    if not stored.labels:
        return film, make_stepper(film, state)
    stepper = Stepper(film, state)
    stepper.fields.update()
    _fill_new_gas(film, state, new=stored.arrays["gas"][:, VOLUME] == 0.0)
    stepper.membrane.start_motion()
    return film, stepper


def set_up_holed(scene: Scene, stored: Stored, before: State, film: Film) -> tuple[Film, Stepper]:
    """Film and stepper of a film whose holes have changed; a `NoFilm` where all of it is gone.

    What encloses gas keeps the pressure that it had when it was punctured: the air around is far heavier than a film
    and holds its shape for as long as a rim takes. See docs/bursting.md.

    Args:
        scene: the scene.
        stored: the film as it is now.
        before: the state before the change.
        film: the film before it.
    """
    state = state_of(scene, stored.arrays, len(stored.labels), film.device, holed=True)
    state.ids, state.swept = stored.ids, stored.swept.held
    stays = (
        *("limit", "cap", "speed", "reach", "shown", "punctured", "gas", "torn", "rest", "run"),
        *("issued", "sprayed", "spacing"),
    )
    kept = {name: getattr(before.course, name) for name in stays}
    own = {"labels": stored.labels, "left": stored.left}
    state.course = Course(**kept, crossed=state.time, mixed=state.time, holed=True, **own)
    gas = state.gas.numpy()
    gas[:, [INCREMENT, OFFSET]] = 0.0
    state.gas.assign(gas)
    state.motion.zero_()
    if state.border is not None:
        wp.copy(state.border, before.border)
    film = film_of(scene, state, film.spacing, film.room)
    stepper = make_stepper(film, state)
    if stored.labels and "memory.area" in stored.arrays:
        stepper.geometry.set_area(state.memory.area)
    return film, stepper


def _fill_new_gas(film: Film, state: State, new: np.ndarray) -> None:
    """The amount of gas of the regions that are `new` (mask), from their pressure and measured volume."""
    gas = state.gas.numpy().copy()
    gas[new, 2] = (film.surroundings.pressure + gas[new, 1]) * gas[new, 0]
    state.gas.assign(gas)


def _relax(scene: Scene, film: Film, state: State) -> None:
    """Even out the E on a curved shape, keeping them on it."""
    normal, e, origin = NORMAL_MOTIONS[film.features.normal], state.e, state.origin
    lists = normal.lists(film, state)
    geometry = normal.geometry(film, state, lists)
    geometry.update()
    if film.numerics.redistribution == 0.0 or scene.shape.even:
        return

    def put_back() -> None:
        points = e.x.numpy()
        points[: e.count] = scene.shape.project(points[: e.count] + origin) - origin
        e.x.assign(points)

    relax(Redistribution(film, state, lists, geometry), put_back)


def relax(redistribution: Redistribution, put_back: Callable[[], None]) -> None:
    """Even out E along a surface onto which `put_back` puts them after each shift."""
    lists = redistribution.lists
    for done in range(MOST_RELAXATION_STEPS):
        if done >= RELAXATION_STEPS and redistribution.spread.numpy()[:, 0].max() < EVEN_ENOUGH:
            break
        redistribution.even_out()
        put_back()
        lists.rebuild_e()
        redistribution.geometry.update()
    if redistribution.state.l is not None:
        lists.rebuild_l()


def _set_masses(scene: Scene, stepper: Stepper) -> None:
    """Give every particle its area's share of liquid and surfactant."""
    film, state = stepper.film, stepper.state
    stepper.carrier.share_area()
    if state.l is None:
        points = state.e.x.numpy()[: film.n_e] + state.origin
        bubbles = _bubble_of(scene, state.e.region.numpy()[: film.n_e])
        _, mass, amount = liquid(scene, points, stepper.geometry.area.numpy(), bubbles)
        state.e.mass.assign(mass)
        state.e.surfactant.assign(amount)
        return
    lag = state.l
    points, area = lag.x.numpy() + state.origin, 1.0 / lag.eta.numpy().astype(np.float64)
    eta, mass, amount = liquid(scene, points, area, _bubble_of(scene, lag.region.numpy()))
    lag.eta.assign(eta)
    lag.mass.assign(mass)
    lag.surfactant.assign(amount)
    for one in scene.carried:
        state.carried[one.name].assign(one.held(points, mass / (scene.material.density * eta), mass))
    stepper.transfer.gather()


def liquid(scene: Scene, points: np.ndarray, area: np.ndarray, bubbles: np.ndarray | None = None):
    """Thickness (m), mass (kg) and surfactant (mol) of particles that stand for `area`, all [n].

    Args:
        scene: its fields say what the film is like.
        points: [n, 3] m.
        area: [n] m^2.
        bubbles: [n] the scene's number of the bubble that each belongs to, which may have a thickness and a tension of
            its own; None for a single film.

    Raises:
        InputError: the scene's fields are not finite and positive there, or the surfactant leaves no tension.
    """
    m = scene.material
    eta = _field(scene.thickness, points, m.thickness, "thickness").copy()
    tension = np.full(len(points), m.tension)
    for k in () if bubbles is None else np.unique(bubbles):
        bubble, own = scene.shape.bubbles[k], bubbles == k
        tension[own] *= bubble.tension
        if bubble.thickness is not None:
            eta[own] = bubble.thickness
    _refuse(eta <= 0.0, eta, points, "thickness", "above 0 m")
    _refuse(eta > THICKEST, eta, points, "thickness", f"at most {THICKEST:g} m")
    name = "surfactant" if scene.concentration is None else "concentration"
    gamma = _field(scene.concentration, points, m.surfactant, name)
    _refuse(gamma < 0.0, gamma, points, name, "at least 0 mol/m^2")
    most = tension / m.rt
    bound = f"below tension/(R T) = {most.min():.3g} mol/m^2"
    _refuse(gamma >= most, gamma, points, name, bound)
    return eta, m.density * eta * area, gamma * area


def _bubble_of(scene: Scene, region: np.ndarray) -> np.ndarray | None:
    """[n] the scene's number of the bubble of each region [n]; None for a single film."""
    return np.array(scene.shape.initial)[region] if isinstance(scene.shape, Cluster) else None


def _bubbles(scene: Scene):
    """Region index and bubble of those that are there at the start of a foam."""
    if not isinstance(scene.shape, Cluster):
        return []
    return [(k, scene.shape.bubbles[label]) for k, label in enumerate(scene.shape.initial)]


def _set_velocity(scene: Scene, stepper: Stepper) -> None:
    film, state = stepper.film, stepper.state
    u = np.zeros((film.total, 3))
    if scene.velocity is not None:
        points = state.e.x.numpy()[: film.n_e] + state.origin
        u[: film.n_e] = _field(scene.velocity, points, 0.0, "velocity", 3)
    for k, bubble in _bubbles(scene):
        u[state.e.region.numpy() == k] += bubble.velocity
    state.e.u.assign(u)
    if stepper.membrane is not None:
        stepper.membrane.start_motion()
    stepper.carrier.start_flow(scene, u)


def _fill_gas(film: Film, stepper: Stepper) -> None:
    """Gas at the pressure that balances the mean tension of each region's initial shape."""
    stepper.fields.update()
    state, geometry = stepper.state, stepper.geometry
    kappa = geometry.curvature(state.e.x).numpy().astype(np.float64)
    area = geometry.area.numpy().astype(np.float64)
    region = state.e.region.numpy()[: film.n_e]
    sigma = film.tension.numpy()[region] - film.slope * stepper.fields.gamma.numpy().astype(np.float64)
    gas = state.gas.numpy().copy()
    gauge = -np.bincount(region, area * 2.0 * sigma * kappa) / np.bincount(region, area)
    for k, gauge_k in enumerate(gauge.tolist()):
        require(gas[k, 0] > 0.0, "shape", gas[k, 0], "one that encloses a positive volume, m^3")
        pressure = film.surroundings.pressure + gauge_k
        require(pressure > 0.0, "pressure", film.surroundings.pressure, f"above {-gauge_k:.3g} Pa for this shape")
        gas[k, 1], gas[k, 2] = gauge_k, pressure * gas[k, 0]
    state.gas.assign(gas)
