"""Validation of vortices along a film, flat and curved, against Euler's equations (SI).

Cases as in `melp_warp.study.validation`. All run with the carrier "circulation" unless told otherwise. The surfactant
makes the films as good as incompressible.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import Rectangle, Sphere
from melp_warp.simulation import Simulation
from melp_warp.study.validation import cost, e_points, l_array
from melp_warp.vortices import gaussian_vortex, sphere_vortex

CARRIER = "circulation"
LEAPFROG_PASSES = (2.3, 4.26, 5.83, 6.98)
"""s at which the quartet of `leapfrog` stands aligned by a spectral solution of Euler's equations."""
LEAPFROG_PLACES = {
    1.0: ((-0.938, 0.373), (-1.483, 0.427)),
    2.0: ((-0.808, 0.563), (-1.107, 0.235)),
    3.0: ((-0.868, 0.461), (-0.414, 0.340)),
    4.0: ((-0.505, 0.247), (-0.260, 0.562)),
}
"""m, where the vortices above the axis are at these times (s) by such a solution in the mirrored film (768 x 192)."""
RADIUS = 0.05
"""m, of the bubbles."""


def vorticity(simulation: Simulation) -> np.ndarray:
    """[n_e] float64 n.curl_s u of what the E flow with, 1/s."""
    stepper = simulation.stepper
    if stepper.rim is not None:
        stepper.rim.mirror_velocity()
    rows = stepper.lists.ee.rows
    start, stop, index = (a.numpy() for a in (rows.start, rows.stop, rows.index))
    gradient = stepper.geometry.gradient.numpy().astype(np.float64)
    u, normal = (a.numpy().astype(np.float64) for a in (simulation.state.e.u, simulation.state.e.normal))
    of = np.repeat(np.arange(len(start)), stop - start)
    pair = np.concatenate([np.arange(a, b) for a, b in zip(start, stop, strict=True)])
    turn = np.sum(normal[of] * np.cross(gradient[pair], u[index[pair]] - u[of]), axis=1)
    return np.bincount(of, turn, minlength=len(start))


def flow_energy(simulation: Simulation) -> float:
    """Kinetic energy that the scene's first flow has at the L, before any transfer, J."""
    scene, lag = simulation.scene, simulation.state.l
    u = scene.velocity(lag.x.numpy().astype(np.float64) + simulation.state.origin)
    return 0.5 * float(np.sum(lag.mass.numpy().astype(np.float64)[:, None] * u**2))


def leapfrog(duration: float = 8.0, every: int = 4, **overrides) -> dict:
    """The scene leapfrog: two vortices of each sign pass through each other (Tao et al. 2024, Figure 11).

    A spectral solution of Euler's equations (1,024 x 512, periodic) stands aligned at 2.3, 4.26, 5.83 and 6.98 s and
    keeps its energy.

    Returns:
        `passes` times at which the vortices above the axis stand in line, s; `exact`, `measured` the second of them;
        `energy_kept` of that of the scene's flow; `peak_at_5` and `peak_start` the largest vorticity, 1/s;
        `apart_until` the last time at which two cores above half of the peak are seen, s; `places_off` the largest
        distance from `LEAPFROG_PLACES`, m.
    """
    script = load_scene("leapfrog")
    values = script.parameters.values({"noise": 0.0, "carrier": CARRIER, **overrides})
    simulation = Simulation(script.build(values))
    energy = flow_energy(simulation)

    def observe():
        x, turn = e_points(simulation), vorticity(simulation)
        first, top = _core(x, turn, values.core)
        second, other = _core(
            x, np.where(np.linalg.norm(x - first, axis=1) < 2.0 * values.core, 0.0, turn), values.core
        )
        return [simulation.time, *first[:2], *second[:2], top, other, simulation.diagnostics()["kinetic_energy"]]

    seen = [observe()]
    for frame in range(round(duration * simulation.scene.fps)):
        simulation.advance_frame()
        if (frame + 1) % every == 0:
            seen.append(observe())
    seen = _tracked(np.array(seen))
    time, top, other = seen[:, 0], seen[:, 5], seen[:, 6]
    apart = other > 0.5 * top
    until = float(time[-1] if apart.all() else time[np.argmin(apart)])
    passes = [t for t in _zeros(time, seen[:, 1] - seen[:, 3]) if 0.25 < t < until]
    return {
        "cost": cost(simulation),
        "exact": LEAPFROG_PASSES[1],
        "measured": passes[1] if len(passes) > 1 else math.nan,
        "error": passes[1] / LEAPFROG_PASSES[1] - 1.0 if len(passes) > 1 else math.nan,
        "passes": passes,
        "apart_until": until,
        "places_off": _places_off(time, seen[:, 1:5]),
        "energy_kept": float(seen[-1, 7] / energy),
        "peak_start": float(top[0]),
        "peak_at_5": float(np.interp(5.0, time, top)),
        **{"e_count": simulation.film.n_e, "l_per_e": values.l_per_e, "duration": duration, **overrides},
        "series": {"time": time, "place": seen[:, 1:5], "peak": top, "energy": seen[:, 7] / energy},
    }


def _places_off(time: np.ndarray, place: np.ndarray) -> float:
    """Largest distance of two vortices [n, 4] from where they belong at the times that are known, m."""
    off = [0.0]
    for t, exact in LEAPFROG_PLACES.items():
        if t <= time[-1] + 1e-6:
            cores = np.array([np.interp(t, time, column) for column in place.T]).reshape(2, 2)
            off.append(min(np.linalg.norm(cores - exact[::way], axis=1).max() for way in (1, -1)))
    return float(max(off))


def zonal(e_count: int = 1500, l_per_e: int = 8, turns: float = 5.0, **numerics) -> dict:
    """A bubble's latitudes turn at a rate that grows towards the equator: steady.

    u = z x r (1 + cos(theta)^2) rate/2, whose vorticity is a polynomial of cos(theta).

    Returns:
        `measured` the L2 departure of the vorticity that L see, relative to the first; `energy_kept`, `enstrophy_kept`;
        `exact` 0.
    """
    rate = 2.0

    def flow(x):
        height = x[:, 2:] / np.linalg.norm(x, axis=1)[:, None]
        return 0.5 * rate * (1.0 + height**2) * np.cross([0.0, 0.0, 1.0], x)

    def exact(x):
        height = x[:, 2] / np.linalg.norm(x, axis=1)
        return rate * height * (2.0 * height**2)

    simulation = _bubble(flow, e_count, l_per_e, **numerics)
    start = simulation.diagnostics()
    _run(simulation, turns * 2.0 * np.pi / rate)
    end = simulation.diagnostics()
    wanted, area = exact(e_points(simulation)), _areas(simulation)
    off = np.sum(area * (vorticity(simulation) - wanted) ** 2) / np.sum(area * wanted**2)
    return {
        "cost": cost(simulation),
        "exact": 0.0,
        "measured": float(np.sqrt(off)),
        "error": float(np.sqrt(off)),
        **_kept(simulation, start, end),
        **{"e_count": simulation.film.n_e, "l_per_e": l_per_e, "turns": turns, **numerics},
    }


def haurwitz(e_count: int = 1500, l_per_e: int = 8, turns: float = 5.0, **numerics) -> dict:
    """A Rossby-Haurwitz wave, degree 4 and order 3, in a bubble that turns as a whole at alpha: it drifts as it is.

    psi = -alpha R^2 cos(theta) + A sin(theta)^3 cos(theta) cos(3 phi) solves Euler's equations on the sphere for any
    A; the pattern turns at alpha (1 - 2/(n (n + 1))), n = 4.

    Returns:
        1/s; `amplitude_kept` of the wave's vorticity.
    """
    alpha, n, m = 2.0, 4, 3

    def wave(x):
        s = x / np.linalg.norm(x, axis=1)[:, None]
        return s[:, 2] * ((s[:, 0] + 1j * s[:, 1]) ** m)

    def flow(x):
        r = np.linalg.norm(x, axis=1)[:, None]
        normal, step = x / r, 1e-4
        pairs = [(wave(normal + step * e) - wave(normal - step * e)).real for e in np.eye(3)]
        slope = np.stack(pairs, axis=1) / (2.0 * step)
        return alpha * np.cross([0.0, 0.0, 1.0], x) + 0.3 * alpha * r * np.cross(normal, slope)

    simulation = _bubble(flow, e_count, l_per_e, **numerics)

    def phase():
        return complex(np.sum(_areas(simulation) * vorticity(simulation) * np.conj(wave(e_points(simulation)))))

    start, seen = simulation.diagnostics(), [phase()]
    duration = turns * 2.0 * np.pi / alpha
    _run(simulation, duration, lambda: seen.append(phase()))
    seen = np.array(seen)
    drift = -(np.unwrap(np.angle(seen))[-1] - np.angle(seen[0])) / m / simulation.time
    exact = alpha * (1.0 - 2.0 / (n * (n + 1)))
    return {
        "cost": cost(simulation),
        "exact": exact,
        "measured": float(drift),
        "error": float(drift / exact - 1.0),
        "amplitude_kept": float(abs(seen[-1]) / abs(seen[0])),
        **_kept(simulation, start, simulation.diagnostics()),
        **{"e_count": simulation.film.n_e, "l_per_e": l_per_e, "turns": turns, **numerics},
    }


def sphere_pair(e_count: int = 4000, l_per_e: int = 8, turns: float = 1.0, core: float = 0.25, **numerics) -> dict:
    """Two vortices of opposite sign on a bubble run along the equator between them, as point vortices do.

    Gaussian, of radius `core` R. At an angle gamma from each other they turn about the axis at
    Gamma/(4 pi R^2 sin(gamma/2)).

    Returns:
        1/s; `apart` the angle between the vortices at the end over that at the start; `flown` the speed of the bubble
        as a whole over the largest along it.
    """
    circulation, half = 0.02, math.radians(35.0)
    centres = [np.array([math.cos(half), 0.0, side * math.sin(half)]) for side in (1.0, -1.0)]
    a = core * RADIUS

    def flow(x):
        return sum(sphere_vortex(x, c, a, side * circulation) for side, c in zip((1.0, -1.0), centres, strict=True))

    simulation = _bubble(flow, e_count, l_per_e, **numerics)

    def places():
        x, turn, area = e_points(simulation), vorticity(simulation), _areas(simulation)
        x -= area @ x / area.sum()
        found = []
        for side in (1.0, -1.0):
            w = area * np.maximum(side * turn, 0.0) ** 2
            p = w @ x
            found.append(p / np.linalg.norm(p))
        return np.array(found)

    start, seen = simulation.diagnostics(), [places()]
    rate = circulation / (4.0 * np.pi * RADIUS**2 * math.sin(half))
    _run(simulation, turns * 2.0 * np.pi / rate, lambda: seen.append(places()))
    seen = np.array(seen)
    middle = seen.sum(axis=1)
    angle = np.unwrap(np.arctan2(middle[:, 1], middle[:, 0]))
    drift = (angle[-1] - angle[0]) / simulation.time
    end = simulation.diagnostics()
    gamma = [np.arccos(np.clip(p[0] @ p[1], -1.0, 1.0)) for p in (seen[0], seen[-1])]
    return {
        "cost": cost(simulation),
        "exact": rate,
        "measured": float(drift),
        "error": float(drift / rate - 1.0),
        "apart": float(gamma[1] / gamma[0]),
        "flown": float(np.linalg.norm(end["momentum"]) / end["mass"] / end["max_speed"]),
        **_kept(simulation, start, end),
        **{"e_count": simulation.film.n_e, "l_per_e": l_per_e, "turns": turns, "core": core, **numerics},
    }


def lamb_oseen(cells: int = 40, l_per_e: int = 8, viscosity: float = 2e-4, growth: float = 2.0, **numerics) -> dict:
    """A Gaussian vortex widens by viscosity, a^2 = a_0^2 + 4 nu t, whatever it turns at: to `growth` times the first.

    Returns:
        `exact` (4 nu) and `measured` the rate at which a^2 grows by the mean square distance of circulation from the
        middle, less that of the same run without viscosity, m^2/s.
    """
    width = 0.2
    a = width / 12.0
    duration = (growth - 1.0) * a * a / (4.0 * viscosity)
    circulation = 2.0 * np.pi * a * 0.05

    def moment(nu):
        scene = Scene(
            "lamb_oseen",
            Rectangle(width, width),
            cells * cells,
            l_per_e,
            material=Material(viscosity=nu),
            velocity=lambda x: gaussian_vortex(x, a, circulation),
            numerics=Numerics(**{"carrier": CARRIER, **numerics}),
            fps=60.0,
        )
        simulation = Simulation(scene)

        def squared():
            gamma, x = l_array(simulation, "circulation"), l_array(simulation, "x")
            near = np.linalg.norm(x, axis=1) < 4.0 * a * math.sqrt(growth)
            return np.sum(gamma[near] * np.sum(x[near] ** 2, axis=1)) / np.sum(gamma[near])

        first = squared()
        _run(simulation, duration)
        return (squared() - first) / simulation.time, cost(simulation)

    rate, price = moment(viscosity)
    still, _ = moment(0.0)
    return {
        "cost": price,
        "exact": 4.0 * viscosity,
        "measured": float(rate - still),
        "error": float((rate - still) / (4.0 * viscosity) - 1.0),
        **{"cells": cells, "l_per_e": l_per_e, "viscosity": viscosity, **numerics},
    }


def turbulence(turns: float = 20.0, **overrides) -> dict:
    """The scene turbulent_film without dye: energy stays, enstrophy falls through scales below the spacing alone.

    A turnover is 2 pi/(rms vorticity) of the first flow.

    Returns:
        `measured` and `exact` (1) the energy of the flow, relative; `enstrophy_kept`.
    """
    script = load_scene("turbulent_film")
    simulation = Simulation(script.build(script.parameters.values({"noise": 0.0, "carrier": CARRIER, **overrides})))
    energy, start = flow_energy(simulation), simulation.diagnostics()
    area = simulation.scene.shape.width * simulation.scene.shape.height
    rms = (
        math.sqrt(2.0 * start["enstrophy"] / area)
        if "enstrophy" in start
        else math.sqrt(np.mean(vorticity(simulation) ** 2))
    )
    _run(simulation, turns * 2.0 * np.pi / rms)
    end = simulation.diagnostics()
    return {
        "cost": cost(simulation),
        "exact": 1.0,
        "measured": float(end["kinetic_energy"] / energy),
        "error": float(end["kinetic_energy"] / energy - 1.0),
        **({"enstrophy_kept": end["enstrophy"] / start["enstrophy"]} if "enstrophy" in end else {}),
        **{"e_count": simulation.film.n_e, "turns": turns, **overrides},
    }


def baroclinic(cells: int = 30, l_per_e: int = 8, steps: int = 8, dt: float = 5e-4, **numerics) -> dict:
    """Surfactant holds up a film that is thicker on one side: d omega/dt = g (d eta/dx)/eta.

    Returns:
        1/s^2, mean over the middle of the film.
    """
    m, g, slope, width = Material(surfactant=4e-6), 9.81, 5.0, 0.1
    scene = Scene(
        "baroclinic",
        Rectangle(width, width),
        cells * cells,
        l_per_e,
        material=m,
        surroundings=Surroundings(gravity=(0.0, -g, 0.0)),
        numerics=Numerics(**{"carrier": CARRIER, **numerics}),
        thickness=lambda x: m.thickness * (1.0 + slope * x[:, 0]),
        concentration=lambda x: m.surfactant - m.density * g * m.thickness * x[:, 1] / (2.0 * m.rt),
        fps=1.0 / dt,
    )
    simulation = Simulation(scene)
    for _ in range(steps):
        simulation.advance_frame()
    x = l_array(simulation, "x")
    area = l_array(simulation, "mass") / (m.density * l_array(simulation, "eta"))
    inner = np.abs(x[:, :2]).max(axis=1) < 0.25 * width
    turn = np.sum(l_array(simulation, "circulation")[inner]) / np.sum(area[inner])
    measured = abs(turn) / simulation.time
    return {
        "cost": cost(simulation),
        "exact": g * slope,
        "measured": float(measured),
        "error": float(measured / (g * slope) - 1.0),
        **{"cells": cells, "l_per_e": l_per_e, "dt": dt, **numerics},
    }


def _bubble(flow, e_count: int, l_per_e: int, **numerics) -> Simulation:
    """A bubble in a vacuum with a slow flow along it, which bends it by less than 1e-3."""
    scene = Scene(
        "bubble",
        Sphere(RADIUS),
        e_count,
        l_per_e,
        material=Material(surfactant=4e-6),
        velocity=flow,
        numerics=Numerics(**{"carrier": CARRIER, **numerics}),
        fps=60.0,
    )
    return Simulation(scene)


def _run(simulation: Simulation, duration: float, observe=lambda: None) -> None:
    for _ in range(round(duration * simulation.scene.fps)):
        simulation.advance_frame()
        observe()


def _areas(simulation: Simulation) -> np.ndarray:
    return simulation.stepper.geometry.area.numpy()[: simulation.film.n_e].astype(np.float64)


def _kept(simulation: Simulation, start: dict, end: dict) -> dict:
    """Energy and enstrophy relative to the first."""
    kept = {"energy_kept": float(end["kinetic_energy"] / start["kinetic_energy"])}
    if "enstrophy" in end:
        kept["enstrophy_kept"] = float(end["enstrophy"] / start["enstrophy"])
    return kept


def _core(x: np.ndarray, turn: np.ndarray, near: float) -> tuple[np.ndarray, float]:
    """Centroid of the vorticity within 1.5 `near` m of its peak, and the peak."""
    peak = np.argmax(turn)
    weight = np.where(np.linalg.norm(x - x[peak], axis=1) < 1.5 * near, np.maximum(turn, 0.0), 0.0)
    return weight @ x / weight.sum(), float(turn[peak])


def _tracked(seen: np.ndarray) -> np.ndarray:
    """Exchange the two cores of a row where they are nearer to the other ones of the row before."""
    seen = seen.copy()
    for before, now in itertools.pairwise(seen):
        p, q = before[1:3], before[3:5]
        a, b = now[1:3].copy(), now[3:5].copy()
        straight = np.linalg.norm(p - a) + np.linalg.norm(q - b)
        if np.linalg.norm(p - b) + np.linalg.norm(q - a) < straight:
            now[1:3], now[3:5] = b, a
    return seen


def _zeros(time: np.ndarray, value: np.ndarray) -> list[float]:
    """Times at which a sampled value changes its sign, by straight lines."""
    turn = np.flatnonzero(value[:-1] * value[1:] < 0.0)
    return [float(time[i] + (time[i + 1] - time[i]) * value[i] / (value[i] - value[i + 1])) for i in turn]
