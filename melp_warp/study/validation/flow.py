"""Cases of the flow along a film: Marangoni waves, decay, vortices."""

from __future__ import annotations

import math

import numpy as np

from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import Rectangle
from melp_warp.simulation import Simulation
from melp_warp.study.validation.shared import (
    cost,
    damped_cosine,
    decay_rate,
    e_concentration,
    e_points,
    e_velocities,
    l_array,
    steps,
)


def elastic_speed(material: Material) -> float:
    """Speed of Marangoni (elastic) waves, sqrt(2 R T Gamma_0/m), m/s."""
    return math.sqrt(2.0 * material.rt * material.surfactant / material.areal_mass)


def marangoni_wave(
    cells: int = 40,
    l_per_e: int = 8,
    width: float = 0.2,
    half_waves: int = 1,
    steps_per_period: float = 80.0,
    periods: float = 2.0,
    amplitude: float = 0.01,
    **numerics,
) -> dict:
    """A standing wave of thickness and surfactant on a flat film: speed sqrt(2 R T Gamma_0/m).

    The film is `cells` E wide and 12 high. gamma is an end-of-step value in (14), so the scheme is backward Euler:
    the wave loses about 2 pi^2/steps_per_period of its amplitude a period (`exact_damping`) and is slower by
    (omega dt)^2/3, about 0.2 % at 80 steps; the kernel's smoothing of gamma slows it by another 0.4 (k dx)^2.

    Returns:
        m/s; `damping` (relative, a period) and what backward Euler's should be.
    """
    material = Material()
    k = half_waves * np.pi / width
    exact = elastic_speed(material)
    dt = 2.0 * np.pi / (exact * k) / steps_per_period

    def wave(x):
        return 1.0 + amplitude * np.cos(k * (x[:, 0] + 0.5 * width))

    scene = Scene(
        "wave",
        Rectangle(width, 12.0 * width / cells),
        12 * cells,
        l_per_e,
        material=material,
        thickness=lambda x: material.thickness * wave(x),
        concentration=lambda x: material.surfactant * wave(x),
        numerics=Numerics(**numerics),
    )
    simulation = Simulation(scene)
    shape = np.cos(k * (e_points(simulation)[:, 0] + 0.5 * width))
    shape -= shape.mean()

    def observe():
        return 2.0 * np.mean(shape * e_concentration(simulation))

    count = round(periods * steps_per_period)
    signal, time = steps(simulation, count, dt, observe), dt * np.arange(count + 1)
    fit = damped_cosine(time, signal, exact * k)
    measured = fit["omega"] / k
    turn = 2.0 * np.pi / steps_per_period
    return {
        "cost": cost(simulation),
        "exact": exact,
        "measured": measured,
        "error": measured / exact - 1.0,
        "damping": 1.0 - math.exp(-2.0 * np.pi * fit["decay"] / fit["omega"]),
        "exact_damping": 1.0 - (1.0 + turn**2) ** (-np.pi / math.atan(turn)),
        "residual": fit["residual"],
        **{"cells": cells, "e_count": simulation.film.n_e, "l_per_e": l_per_e, "k_dx": k * simulation.film.spacing},
        **{"half_waves": half_waves, "dt": dt, "steps_per_period": steps_per_period, **numerics},
        "series": {"time": time, "signal": signal},
    }


def surfactant_decay(
    cells: int = 24,
    l_per_e: int = 8,
    width: float = 0.2,
    drag: float = 0.05,
    steps_per_decay: float = 100.0,
    **numerics,
) -> dict:
    """With drag d a mode of surfactant creeps to rest: s^2 + (d/m) s + c^2 k^2 = 0, the slow root.

    For strong drag that is diffusion, rate 2 R T Gamma_0 k^2/d.

    Returns:
        1/s.
    """
    material = Material()
    k, rate = np.pi / width, drag / material.areal_mass
    exact = 0.5 * rate - math.sqrt(0.25 * rate**2 - (elastic_speed(material) * k) ** 2)
    dt = 1.0 / exact / steps_per_decay

    def wave(x):
        return 1.0 + 0.01 * np.cos(k * (x[:, 0] + 0.5 * width))

    scene = Scene(
        "decay",
        Rectangle(width, 12.0 * width / cells),
        12 * cells,
        l_per_e,
        material=material,
        surroundings=Surroundings(drag=drag),
        thickness=lambda x: material.thickness * wave(x),
        concentration=lambda x: material.surfactant * wave(x),
        numerics=Numerics(**numerics),
    )
    simulation = Simulation(scene)
    shape = np.cos(k * (e_points(simulation)[:, 0] + 0.5 * width))
    count = round(1.5 * steps_per_decay)
    signal = steps(simulation, count, dt, lambda: 2.0 * np.mean(shape * e_concentration(simulation)))
    time = dt * np.arange(count + 1)
    late = time > 5.0 / rate
    measured = decay_rate(time[late], signal[late])
    return {
        "exact": exact,
        "measured": measured,
        "error": measured / exact - 1.0,
        **{"cells": cells, "e_count": simulation.film.n_e, "l_per_e": l_per_e, "drag": drag, "dt": dt, **numerics},
        "series": {"time": time, "signal": signal},
    }


def shear_decay(
    viscosity: float = 0.0,
    drag: float = 0.0,
    cells: int = 24,
    l_per_e: int = 8,
    height: float = 0.1,
    count: int = 100,
    dt: float | None = None,
    **numerics,
) -> dict:
    """The shear flow u_x = U cos(k y), k = pi/height, of a film without surfactant decays at nu k^2 + d/m.

    The sides stop it, so only the middle third of a film three times as wide as high is looked at. `count` steps to
    an e-th where dt is not given: both forces are implicit, which makes the rate smaller by half of its product with
    dt; each transfer takes 1/2 (k sigma)^4 with sigma the standard deviation of the kernel along an axis.

    Returns:
        1/s.
    """
    material = Material(viscosity=viscosity, surfactant=0.0)
    k = np.pi / height
    exact = viscosity * k**2 + drag / material.areal_mass
    dt = dt if dt is not None else 1.0 / exact / count
    speed = 1e-3 * height / (count * dt)

    def flow(x):
        return np.outer(speed * np.cos(k * (x[:, 1] + 0.5 * height)), [1.0, 0.0, 0.0])

    scene = Scene(
        "shear",
        Rectangle(3.0 * height, height),
        3 * cells * cells,
        l_per_e,
        material=material,
        surroundings=Surroundings(drag=drag),
        velocity=flow,
        numerics=Numerics(**numerics),
    )
    simulation = Simulation(scene)
    inside = np.abs(e_points(simulation)[:, 0]) < 0.5 * height
    shape = flow(e_points(simulation)) * inside[:, None]
    signal = steps(simulation, count, dt, lambda: np.sum(shape * e_velocities(simulation)) / np.sum(shape * shape))
    time = dt * np.arange(count + 1)
    measured = decay_rate(time[1:], signal[1:])
    return {
        "exact": exact,
        "measured": measured,
        "error": measured / exact - 1.0,
        **{"viscosity": viscosity, "drag": drag, "e_count": simulation.film.n_e, "l_per_e": l_per_e},
        **{"k_dx": k * simulation.film.spacing, "dt": dt, "steps": count, **numerics},
    }


def taylor_green(
    cells: int = 30,
    viscosity: float = 1e-3,
    l_per_e: int = 4,
    width: float = 0.2,
    speed: float = 0.1,
    count: int = 30,
    dt: float = 1.0 / 60.0,
    **numerics,
) -> dict:
    """One Taylor-Green eddy, u = curl sin(kx) sin(ky) with k = pi/width, fills a square and decays at 2 nu k^2.

    Transfers take their share whatever the viscosity is: the same run without viscosity tells how much, and `measured`
    is the rate of the one less that of the other. The rate is that of the part of u along the eddy, from a fifth of the
    run on.

    Returns:
        1/s; `lost` the rate without viscosity, relative to `exact`.
    """
    k = np.pi / width
    exact = 2.0 * viscosity * k * k

    def flow(x):
        a, b = k * (x[:, 0] + 0.5 * width), k * (x[:, 1] + 0.5 * width)
        return speed * np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b), 0.0 * a], axis=1)

    def rate(nu: float) -> float:
        simulation = Simulation(
            Scene(
                "taylor_green",
                Rectangle(width, width),
                cells * cells,
                l_per_e,
                material=Material(viscosity=nu, surfactant=5e-6),
                velocity=flow,
                numerics=Numerics(**numerics),
            )
        )
        mass = l_array(simulation, "mass")[:, None]

        def observe():
            wanted = flow(l_array(simulation, "x"))
            return np.sum(mass * wanted * l_array(simulation, "u")) / np.sum(mass * wanted * wanted)

        signal = steps(simulation, count, dt, observe)
        late = count // 5
        return decay_rate(dt * np.arange(count + 1)[late:], signal[late:])

    whole, lost = rate(viscosity), rate(0.0)
    return {
        "exact": exact,
        "measured": whole - lost,
        "error": (whole - lost) / exact - 1.0,
        "lost": lost / exact,
        **{"cells": cells, "e_count": cells * cells, "l_per_e": l_per_e, "viscosity": viscosity, "dt": dt, **numerics},
    }


def eddy_loss(
    cells: int = 32,
    eddies: int = 2,
    l_per_e: int = 8,
    width: float = 0.1,
    count: int = 60,
    speed: float = 1e-3,
    **numerics,
) -> dict:
    """What the transfers take from square eddies u = curl sin(kx) sin(ky) at each step; the model takes nothing.

    By theory APIC takes 1/2 (K sigma)^4, K^2 = 2 k^2, with sigma^2 the kernel's variance along an axis: a round trip
    is S^2 (1 + (K sigma)^2) with S = exp(-(K sigma)^2/2) for a kernel near a Gaussian.

    Returns:
        Relative loss of speed a step; `error` the difference from theory, which is itself only the first term.
    """
    k, dt = eddies * np.pi / width, 1.0 / 60.0

    def flow(x):
        a, b = k * (x[:, 0] + 0.5 * width), k * (x[:, 1] + 0.5 * width)
        return speed * np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b), np.zeros(len(x))], axis=1)

    scene = Scene(
        "eddies", Rectangle(width, width), cells * cells, l_per_e, velocity=flow, numerics=Numerics(**numerics)
    )
    simulation = Simulation(scene)
    shape = flow(e_points(simulation))
    signal = steps(simulation, count, dt, lambda: np.sum(shape * e_velocities(simulation)) / np.sum(shape * shape))
    measured = 1.0 - (signal[-1] / signal[1]) ** (1.0 / (count - 1)) if signal[-1] > 0.0 else 1.0
    exact = 0.5 * (2.0 * k**2 * kernel_variance(simulation.film.r)) ** 2
    return {
        "exact": exact,
        "measured": float(measured),
        "error": float(measured / exact - 1.0),
        **{"e_count": simulation.film.n_e, "l_per_e": l_per_e, "eddy_dx": cells / eddies, "dt": dt, "steps": count},
        **numerics,
    }


def kernel_variance(r: float) -> float:
    """Variance along an axis of the quintic spline of support r, m^2."""
    s = (np.arange(3000) + 0.5) / 1000.0
    w = sum(c * np.maximum(a - s, 0.0) ** 5 for a, c in ((3.0, 1.0), (2.0, -6.0), (1.0, 15.0)))
    return float(0.5 * np.sum(w * s**3) / np.sum(w * s) * (r / 3.0) ** 2)


def _curl(simulation: Simulation) -> np.ndarray:
    """[n_l] vorticity at the L of a film in the xy plane, 1/s; nan in a single layer, which has no affine part."""
    if not simulation.has_l:
        return np.full(simulation.film.n_e, np.nan)
    affine = l_array(simulation, "affine")
    return affine[:, 1, 0] - affine[:, 0, 1]


def _eye(x: np.ndarray, curl: np.ndarray, near: float) -> tuple[np.ndarray, float]:
    """Centre of the strongest vortex: the centroid of vorticity above half its peak, within `near` m of the peak."""
    peak = np.argmax(curl)
    inside = (np.linalg.norm(x - x[peak], axis=1) < near) & (curl > 0.5 * curl[peak])
    return np.average(x[inside], axis=0, weights=curl[inside]), float(curl[peak])


def taylor_pair(separation: float = 0.81, duration: float = 8.0, every: int = 8, **overrides) -> dict:
    """The scene taylor_vortices: two like vortices 0.81 m apart must separate (McKenzie 2007).

    Their distance is that of the centres of vorticity; they count as merged once it is below half of the first.

    Returns:
        m; `exact` the distance at the start, `measured` that at the end, `error` how much they have neared, relative
        (0 where they have parted); `merged` (s, nan for never), `energy_kept`, `peak_kept`.
    """
    script = load_scene("taylor_vortices")
    scene = script.build(script.parameters.values({"separation": separation, **overrides}))
    simulation = Simulation(scene)
    radius = script.parameters.values(overrides).vortex_radius

    def observe():
        x, curl = l_array(simulation, "x"), _curl(simulation)
        first, top = _eye(x, curl, radius)
        away = np.linalg.norm(x - first, axis=1) > radius
        second, other = _eye(x[away], curl[away], radius)
        energy = simulation.diagnostics()["kinetic_energy"]
        return [simulation.time, np.linalg.norm(first - second), max(top, other), energy]

    seen = [observe()]
    for frame in range(round(duration * scene.fps)):
        simulation.advance_frame()
        if (frame + 1) % every == 0:
            seen.append(observe())
    seen = np.array(seen)
    merged = seen[:, 1] < 0.5 * seen[0, 1]
    return {
        "cost": cost(simulation),
        "separation": separation,
        "exact": float(seen[0, 1]),
        "measured": float(seen[-1, 1]),
        "error": float(max(0.0, 1.0 - seen[-1, 1] / seen[0, 1])),
        "merged": float(seen[merged][0, 0]) if np.any(merged) else math.nan,
        "closest": float(seen[:, 1].min()),
        "energy_kept": float(seen[-1, 3] / seen[0, 3]),
        "peak_kept": float(seen[-1, 2] / seen[0, 2]),
        **{"e_count": simulation.film.n_e, "l_per_e": scene.l_per_e, "duration": duration, **overrides},
        "series": {"time": seen[:, 0], "distance": seen[:, 1], "peak": seen[:, 2], "energy": seen[:, 3]},
    }


def taylor_vortex(
    cells: int = 40, l_per_e: int = 16, turns: float = 3.0, radius: float = 0.3, width: float = 2.4, **overrides
) -> dict:
    """One Taylor vortex is steady: its kinetic energy and angular momentum stay.

    Returns:
        `measured` and `exact` (1) the kinetic energy relative to that of the start after `turns` turnovers
        2 pi a/U; `angular_kept` the same of the angular momentum, `peak_kept` of the largest vorticity.
    """
    script = load_scene("taylor_vortices")
    values = script.parameters.values(
        {"width": width, "height": width, "e_count": cells * cells, "l_per_e": l_per_e, "vortex_radius": radius}
        | {"noise": 0.0, "separation": 1e-3, "vortex_speed": 0.5, **overrides}
    )
    simulation = Simulation(script.build(values))
    mass = l_array(simulation, "mass")

    def observe():
        x, v = l_array(simulation, "x"), l_array(simulation, "v")
        turning = np.sum(mass * (x[:, 0] * v[:, 1] - x[:, 1] * v[:, 0]))
        return [simulation.time, 0.5 * np.sum(mass * (v**2).sum(axis=1)), turning, _curl(simulation).max()]

    seen = [observe()]
    turn = 2.0 * np.pi * radius / 1.0
    for _ in range(round(turns * turn * simulation.scene.fps)):
        simulation.advance_frame()
        seen.append(observe())
    seen = np.array(seen)
    kept = seen[-1, 1:] / seen[0, 1:]
    return {
        "cost": cost(simulation),
        "exact": 1.0,
        "measured": float(kept[0]),
        "error": float(kept[0] - 1.0),
        "angular_kept": float(kept[1]),
        "peak_kept": float(kept[2]),
        **{"e_count": simulation.film.n_e, "l_per_e": l_per_e, "turns": turns, "radius_dx": radius * cells / width},
        **overrides,
        "series": {"time": seen[:, 0], "energy": seen[:, 1] / seen[0, 1], "angular": seen[:, 2] / seen[0, 2]},
    }
