"""Validation of foams: bubbles that meet, settle and are measured against Plateau's laws and the gas law (SI).

Cases as in `melp_warp.study.validation`. Films carry the air's mass and are damped, which changes how fast a foam comes
to rest, not where.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from melp_warp.cluster import Bubble, Cluster
from melp_warp.errors import SimulationError
from melp_warp.material import Surroundings
from melp_warp.measure.results import Measurement, measure
from melp_warp.numerics import Numerics
from melp_warp.parameters import FOAM
from melp_warp.scene import Scene
from melp_warp.simulation import Simulation
from melp_warp.stepping.sampling import set_up_foam
from melp_warp.stepping.topology import Stored

RADIUS = 0.05
"""m, as in Table 3 of the paper."""
GRAVITY = 9.81
"""m/s^2."""
PLATEAU = 120.0
EDGE = math.degrees(math.acos(-1.0 / 3.0))
DAMPING = 30.0
"""1/s."""


def foam_scene(
    centres,
    radii,
    e_per_bubble: int,
    gap: float = 0.2,
    frames: int = 100,
    l_per_e: int = 0,
    exchange: float = 0.0,
    tension=None,
) -> Scene:
    """Bubbles at `centres` (in units where neighbours touch), spread until neighbours are `gap` spacings apart.

    Nothing outside acts on them, the drag of the air neither: what moves their middle is numerical.

    Args:
        centres: [n, 3] m, of bubbles that touch their neighbours.
        radii: [n] m.
        e_per_bubble: E on the largest bubble.
        gap: distance between neighbours at the start, E spacings.
        frames: 1/240 s each.
        l_per_e: L per E.
        exchange: rate at which L cross, 1/s.
        tension: [n] factors on the tension; 1 each for None.
    """
    centres, radii = np.asarray(centres, dtype=np.float64), np.asarray(radii, dtype=np.float64)
    spacing = float(radii.max()) * math.sqrt(4.0 * math.pi / e_per_bubble)
    factor = 1.0 + gap * spacing / (2.0 * float(radii.mean()))
    factors = np.ones(len(radii)) if tension is None else tension
    bubbles = tuple(
        Bubble(tuple(c.tolist()), float(r), tension=float(t))
        for c, r, t in zip(centres * factor, radii, factors, strict=True)
    )
    return Scene(
        "foam",
        Cluster(bubbles),
        e_count=round(4.0 * math.pi * float((radii**2).sum()) / spacing**2),
        l_per_e=l_per_e,
        surroundings=Surroundings(air=FOAM["air"], air_drag=0.0, damping=DAMPING),
        numerics=Numerics(
            cfl=FOAM["cfl"],
            redistribution=FOAM["redistribution"],
            spread=FOAM["spread"],
            border=FOAM["border"],
            exchange=exchange,
        ),
        frames=frames,
        fps=240.0,
    )


def pair_of(radius_1: float, radius_2: float) -> tuple[np.ndarray, np.ndarray]:
    """Centres and radii of two bubbles that touch."""
    return np.array([[-radius_1, 0.0, 0.0], [radius_2, 0.0, 0.0]]), np.array([radius_1, radius_2])


def ring_of(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Centres and radii of equal bubbles in a ring, or at the corners of a tetrahedron for 4."""
    if count == 4:
        corners = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]])
        return corners * RADIUS / math.sqrt(2.0), np.full(4, RADIUS)
    angle = 2.0 * np.pi * np.arange(count) / count
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    return ring * RADIUS / math.sin(np.pi / count), np.full(count, RADIUS)


def settle(scene: Scene) -> tuple[Simulation, Measurement, dict]:
    """Run a scene; its last state as measured, and what was watched on the way.

    Returns:
        The simulation, the measurement of its E, and `steps`, `seconds` (wall time of all steps at that of the usual
        one), `volume_drift` (largest relative change of any region's volume on the way, and of the volume found anew
        from the last surface), `mass_drift`, `surfactant_drift`.
    """
    simulation = Simulation(scene)
    start = simulation.diagnostics()
    steps, drift = 0, 0.0
    volumes = np.array(start["volumes"])
    for _ in range(scene.frames):
        simulation.advance_frame()
        seen = simulation.diagnostics()
        steps += seen["substeps"]
        drift = max(drift, float(np.abs(np.array(seen["volumes"]) / volumes - 1.0).max()))
    measured = measure(simulation.particles("e"), simulation.film.spacing)
    # the logged volumes are those that the gas law was closed with: find them anew from the surface itself
    simulation.stepper.lists.rebuild()
    simulation.stepper.geometry.update()
    drift = max(drift, float(np.abs(simulation.state.gas.numpy()[:, 0] / volumes - 1.0).max()))
    watched = {
        "steps": steps,
        "seconds": steps * float(np.median(simulation.step_seconds)),
        "volume_drift": drift,
        "mass_drift": abs(seen["mass"] / start["mass"] - 1.0),
        "surfactant_drift": abs(seen["surfactant"] / start["surfactant"] - 1.0),
        "speed": seen["max_speed"],
        "e_count": seen["e_count"],
    }
    return simulation, measured, watched


def fall(count: int = 1, e_count: int = 400, l_per_e: int = 0, duration: float = 0.5) -> dict:
    """One bubble, or two side by side that touch, of 400 nm of water falls from rest in air without drag.

    The acceleration is g M/(M + 2 pi rho_air R^3), M the film's mass: half its volume of air outside and all of it
    inside go with it.

    Args:
        count: 1 or 2 bubbles.
        e_count: E on each.
        l_per_e: L per E.
        duration: s.

    Returns:
        m, the height that the middle of the E has gained; `speed_error`: relative, of the mean velocity at the end;
        `aside`: how far it went sideways, relative to the way down.
    """
    centres = RADIUS * np.array([[2.0 * k, 0.0, 0.0] for k in range(count)])
    shape = Cluster(tuple(Bubble(tuple(c.tolist()), RADIUS) for c in centres))
    around = Surroundings(air="added_mass", air_drag=0.0, gravity=(0.0, -GRAVITY, 0.0))
    numerics = Numerics(cfl=FOAM["cfl"])
    scene = Scene("fall", shape, count * e_count, l_per_e, surroundings=around, numerics=numerics, fps=60.0)
    simulation = Simulation(scene)

    def middle():
        return simulation.state.e.x.numpy().astype(np.float64).mean(axis=0)

    start = middle()
    for _ in range(round(scene.fps * duration)):
        simulation.advance_frame()
    moved = middle() - start
    speed = simulation.state.motion.numpy()[:, 1].mean()
    mass = 4.0 * math.pi * RADIUS**2 * scene.material.areal_mass
    exact = -0.5 * GRAVITY * mass / (mass + 2.0 * math.pi * around.air_density * RADIUS**3) * duration**2
    return {
        "exact": exact,
        "measured": float(moved[1]),
        "error": abs(float(moved[1]) / exact - 1.0),
        "speed_error": abs(float(speed) * 0.5 * duration / exact - 1.0),
        "aside": math.hypot(float(moved[0]), float(moved[2])) / abs(exact),
        **{"count": count, "e_count": e_count, "l_per_e": l_per_e, "duration": duration},
    }


def double_bubble(e_per_bubble: int = 1000, ratio: float = 1.0, frames: int = 140, l_per_e: int = 0) -> dict:
    """Two bubbles meet: the three dihedral angles, the partition's curvature, area and volumes.

    Returns:
        `measured`: the three angles, degrees; `error`: the largest deviation from 120; `curvature_error`: relative
        to 1/R_2 - 1/R_1 of the settled caps (for unequal bubbles); `area_error`: relative to the least area.
    """
    centres, radii = pair_of(RADIUS, ratio * RADIUS)
    _, found, watched = settle(foam_scene(centres, radii, e_per_bubble, frames=frames, l_per_e=l_per_e))
    pair = found.pairs[0]
    angles = np.array(pair.angles, dtype=np.float64)
    result = {
        **watched,
        "e_per_bubble": e_per_bubble,
        "ratio": ratio,
        "exact": PLATEAU,
        "measured": angles,
        "error": float(np.abs(angles - PLATEAU).max()),
        "curvature": pair.partition.curvature,
        "expected_curvature": pair.expected,
    }
    if ratio != 1.0:
        result["curvature_error"] = pair.partition.curvature / pair.expected - 1.0
    elif found.fitted_area is not None:
        result["area"], result["area_error"] = found.fitted_area, found.fitted_area / found.least_area - 1.0
    return result


def ring(count: int = 3, e_per_bubble: int = 1000, frames: int = 200) -> dict:
    """Three bubbles in a triangle or four in a tetrahedron: dihedral angles at lines, angles between lines.

    Returns:
        `measured`: all dihedral angles of outer and inner lines; `error`: the largest deviation from 120, degrees;
        `edges`: angles between lines at vertices; `edge_error`: the largest deviation from 109.47, relative.
    """
    centres, radii = ring_of(count)
    _, found, watched = settle(foam_scene(centres, radii, e_per_bubble, frames=frames))
    lines = [a for group in (found.pairs, found.triples) for line in group for a in (line.angles or ()) if a]
    angles = np.array(lines, dtype=np.float64)
    edges = np.array([a for vertex in found.vertices for a in vertex.angles], dtype=np.float64)
    return {
        **watched,
        "e_per_bubble": e_per_bubble,
        "exact": PLATEAU,
        "measured": angles,
        "error": float(np.abs(angles - PLATEAU).max()),
        "mean": float(angles.mean()),
        "edges": edges,
        "edge_error": float(np.abs(edges / EDGE - 1.0).max()) if len(edges) else math.nan,
    }


def static_double_bubble(e_per_bubble: int = 1000, angle: float = PLATEAU, radius: float = RADIUS) -> float:
    """Net pull on the line of a double bubble whose caps meet at `angle`, over the tension of a film.

    The particles sit on the exact caps and partition, their corner rounded over the gap within which sheets cling. With
    outer dihedral angle theta the exact answer is 2 cos(theta/2) - 1.

    Returns:
        Radial force per length over 2 sigma.
    """
    scene = foam_scene(*pair_of(radius, radius), e_per_bubble, gap=10.0)
    simulation = Simulation(scene)
    spacing = simulation.film.spacing
    points, normals = _rounded_cap(radius, math.radians(angle), simulation.scene.numerics.border * spacing, spacing)
    mirror = np.array([-1.0, 1.0, 1.0])
    stored = _stored(simulation, [(points, normals), (points * mirror, normals * mirror)])
    _, stepper = set_up_foam(scene, stored, simulation.state, simulation.film)
    membrane, e = stepper.membrane, stepper.state.e
    dt = 1.0 / 240.0
    membrane.solve(stepper.prepare(dt))
    x, n = e.x.numpy().astype(np.float64), e.normal.numpy().astype(np.float64)
    force = membrane.response.b.numpy().astype(np.float64) / dt
    rho = np.hypot(x[:, 1], x[:, 2])
    radial = (n[:, 1] * x[:, 1] + n[:, 2] * x[:, 2]) / np.maximum(rho, 1e-12)
    line = radius * math.sin(math.radians(angle) / 2.0)
    near = np.hypot(np.abs(x[:, 0]), rho - line) < 6.0 * spacing
    tension = 2.0 * scene.material.film_tension
    return float((force * radial)[near].sum() / (tension * 2.0 * math.pi * line))


def _rounded_cap(radius: float, angle: float, fillet: float, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of the bubble at x < 0: a cap, an arc of radius `fillet` and a plane partition, evenly.

    The cap meets the plane x = 0 where the outer dihedral angle is `angle`; the arc touches both.
    """
    centre = -radius * math.cos(angle / 2.0)
    hub = math.sqrt((radius - fillet) ** 2 - (fillet + centre) ** 2)
    turn = math.atan2(hub, -fillet - centre)
    parts = [
        (radius * (math.pi - turn), lambda s: (centre, 0.0, radius, math.pi - s / radius)),
        (fillet * turn, lambda s: (-fillet, hub, fillet, turn - s / fillet)),
    ]
    rows = []
    for length, at in parts:
        count = max(2, round(length / spacing))
        for k in range(count):
            cx, cy, r, phi = at((k + 0.5) * length / count)
            rows.append((cx + r * math.cos(phi), cy + r * math.sin(phi), math.cos(phi), math.sin(phi)))
    count = max(2, round(hub / spacing))
    rows += [(0.0, (k + 0.5) * hub / count, 1.0, 0.0) for k in range(count)]
    points, normals = [], []
    for k, (x, rho, nx, nr) in enumerate(rows):
        around = max(3, round(2.0 * math.pi * rho / spacing))
        phi = 2.0 * math.pi * (np.arange(around) + 0.618 * k) / around
        c, s = np.cos(phi), np.sin(phi)
        points.append(np.stack([np.full(around, x), rho * c, rho * s], axis=1))
        normals.append(np.stack([np.full(around, nx), nr * c, nr * s], axis=1))
    return np.concatenate(points), np.concatenate(normals)


def _stored(simulation: Simulation, regions: list[tuple[np.ndarray, np.ndarray]]) -> Stored:
    """A state at rest with the gas pressure of spheres, E on the given surfaces."""
    foam = Stored.of(simulation.state)
    stored = foam.arrays
    count = [len(points) for points, _ in regions]
    total = sum(count)
    for name in list(stored):
        if name.startswith("e."):
            stored[name] = np.zeros((total, *stored[name].shape[1:]), dtype=stored[name].dtype)
    stored["e.x"][:] = np.concatenate([points for points, _ in regions])
    stored["e.normal"][:] = np.concatenate([normals for _, normals in regions])
    stored["e.region"][:] = np.repeat(np.arange(len(regions)), count)
    material, film = simulation.scene.material, simulation.film
    stored["e.mass"][:] = material.areal_mass * film.spacing**2
    stored["e.surfactant"][:] = material.surfactant * film.spacing**2
    stored["gas"][:, 2] = 0.0
    foam.ids["e"] = np.arange(total)
    return foam


def balancing_angle(e_per_bubble: int = 1000) -> dict:
    """Static test: the outer dihedral angle at which the net pull on a double bubble's line vanishes.

    Returns:
        `measured`, degrees; `error`: its deviation from 120; `series`: angles and pulls.
    """
    angles = np.array([108.0, 114.0, 120.0, 126.0, 132.0])
    pulls = np.array([static_double_bubble(e_per_bubble, a) for a in angles])
    slope, _ = np.polyfit(angles, pulls, 1)
    fit = np.polyfit(pulls, angles, 2)
    measured = float(np.polyval(fit, 0.0))
    return {
        "e_per_bubble": e_per_bubble,
        "exact": PLATEAU,
        "measured": measured,
        "error": measured - PLATEAU,
        "slope": float(slope),
        "series": {"angle": angles, "pull": pulls},
    }


def four_bubbles(e_per_bubble: int = 600, spread: float = 0.05, frames: int = 240) -> dict:
    """Four bubbles in a square meet in one fourfold line, which splits into two threefold ones.

    Returns:
        `measured`: number of pairs that share a partition at the end, 5 after a split (4 around a fourfold line);
        `when`: time of the split, s, nan for none.
    """
    corners = RADIUS * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    tension = 1.0 + spread * np.array([0.5, -0.5, 0.5, -0.5])
    simulation = Simulation(foam_scene(corners, np.full(4, RADIUS), e_per_bubble, frames=frames, tension=tension))
    when, fourfold = math.nan, False
    for _ in range(frames):
        simulation.advance_frame()
        pairs = _partitions(simulation)
        fourfold = fourfold or pairs == 4
        if fourfold and pairs == 5:
            when = simulation.time
            break
    return {"e_per_bubble": e_per_bubble, "exact": 5, "measured": pairs, "when": when, "error": pairs - 5}


def packed(count: int = 300, e_per_bubble: int = 240, frames: int = 200) -> dict:
    """Equal bubbles as densely packed as spheres can be, which cling and become a foam; run to rest.

    Returns:
        `measured`: bubbles left; `speed`, `rms_speed`: largest and root mean square at the end, m/s; `covered`: share
        of all films that is partitions; `volume_drift`: largest relative change of a volume.
    """
    lattice = np.array([p for p in product(range(-9, 10), repeat=3) if sum(p) % 2 == 0], dtype=np.float64)
    nearest = lattice[np.argsort((lattice**2).sum(axis=1), kind="stable")][:count]
    centres = math.sqrt(2.0) * RADIUS * nearest
    simulation = Simulation(foam_scene(centres, np.full(count, RADIUS), e_per_bubble, gap=0.1, frames=frames))
    volumes = np.array(simulation.diagnostics()["volumes"])
    drift = 0.0
    for _ in range(frames):
        simulation.advance_frame()
        seen = simulation.diagnostics()
        drift = max(drift, float(np.abs(np.array(seen["volumes"]) / volumes - 1.0).max()))
    return {
        "e_per_bubble": e_per_bubble,
        "exact": count,
        "measured": len(seen["regions"]),
        "speed": seen["max_speed"],
        "rms_speed": float(np.sqrt((simulation.state.e.u.numpy().astype(np.float64) ** 2).sum(axis=1).mean())),
        "covered": seen["covered"],
        "volume_drift": drift,
    }


def _partitions(simulation: Simulation, least: int = 12) -> int:
    """Number of pairs of regions that share a partition of at least `least` E on each side."""
    region = simulation.state.e.region.numpy()
    partner = simulation.stepper.membrane.find_partners("e")
    count = len(simulation.film.labels)
    shared = np.zeros((count, count), dtype=int)
    np.add.at(shared, (region[partner >= 0], partner[partner >= 0]), 1)
    return int((np.triu(np.minimum(shared, shared.T)) >= least).sum())


def largest_step(e_per_bubble: int = 1000, steps: tuple[float, ...] = (1 / 480, 1 / 240, 1 / 120, 1 / 60)) -> dict:
    """Settle a double bubble to rest, then go on with fixed steps: how far it moves in 0.25 s at each.

    Returns:
        `series`: steps (s), capillary CFL numbers sqrt(2 sigma/(m + A)) dt/dx, angles after (nan: stopped).
    """
    centres, radii = pair_of(RADIUS, RADIUS)
    cfl, angles = [], []
    for dt in steps:
        simulation = Simulation(foam_scene(centres, radii, e_per_bubble, frames=60))
        for _ in range(60):
            simulation.advance_frame()
        try:
            for _ in range(round(0.25 / dt)):
                simulation.step(dt)
                simulation.stepper.check()
            found = measure(simulation.particles("e"), simulation.film.spacing)
            angles.append(float(np.abs(np.array(found.pairs[0].angles, dtype=float) - PLATEAU).max()))
        except SimulationError:
            angles.append(math.nan)
        inertia = simulation.scene.material.areal_mass + float(simulation.stepper.membrane.added.numpy()[0])
        speed = math.sqrt(2.0 * simulation.scene.material.film_tension / inertia)
        cfl.append(speed * dt / simulation.film.spacing)
    return {"e_per_bubble": e_per_bubble, "series": {"dt": np.array(steps), "cfl": np.array(cfl), "error": angles}}
