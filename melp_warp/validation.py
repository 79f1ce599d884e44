"""Validation: runs with a known answer, as functions that return numbers (SI).

Every case builds a `Scene`, runs it and returns a dictionary: `exact`, `measured`, `error` (relative unless its docstring
says otherwise) and the parameters it ran with; `series` holds what a plot needs. The tests run them small, the tool
`tools/validate.py` runs them at full size and writes docs/validation.md. Any of them can be called from Python:

    >>> from melp_warp.validation import oscillation
    >>> oscillation(mode=2, e_count=1500)["error"]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from melp_warp.errors import SimulationError
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Rectangle, Sphere, StarShaped, displaced_sphere
from melp_warp.simulation import Simulation

GRAVITY = 9.81
"""m/s^2."""
CLEAN = Material(surfactant=0.0)
"""Pure water: tension 0.0728 N/m, 400 nm."""


# What the cases share


def steps(simulation: Simulation, count: int, dt: float, observe: Callable[[], object] | None = None) -> np.ndarray:
    """Take `count` steps of dt (s), checking each; what `observe()` returns before the first and after each step.

    Raises:
        SimulationError: the state turned non-finite; names the stage and the particle.
    """
    seen = [observe()] if observe else []
    for _ in range(count):
        simulation.step(dt)
        simulation.stepper.check()
        if observe:
            seen.append(observe())
    return np.array(seen)


def e_points(simulation: Simulation) -> np.ndarray:
    """[n_e, 3] float64 positions of E, m."""
    return simulation.state.e.x.numpy()[: simulation.film.n_e].astype(np.float64)


def e_velocities(simulation: Simulation) -> np.ndarray:
    """[n_e, 3] float64 material velocities of E, m/s."""
    return simulation.state.e.u.numpy()[: simulation.film.n_e].astype(np.float64)


def e_thickness(simulation: Simulation) -> np.ndarray:
    """[n_e] float64 thickness of E, m."""
    if simulation.has_l:
        simulation.stepper.transfer.gather()
    simulation.stepper.fields.update()
    return simulation.stepper.fields.eta.numpy().astype(np.float64)


def e_concentration(simulation: Simulation) -> np.ndarray:
    """[n_e] float64 relative concentration Gamma/Gamma_0 of E."""
    if simulation.has_l:
        simulation.stepper.transfer.gather()
    simulation.stepper.fields.update()
    return simulation.stepper.fields.gamma.numpy().astype(np.float64)


def e_area(simulation: Simulation) -> np.ndarray:
    """[n_e] float64 control areas, m^2."""
    return simulation.stepper.geometry.area.numpy().astype(np.float64)


def l_array(simulation: Simulation, name: str) -> np.ndarray:
    """An array of the L state as float64."""
    return getattr(simulation.state.l, name).numpy().astype(np.float64)


def damped_cosine(time: np.ndarray, signal: np.ndarray, omega: float) -> dict:
    """Fit c + exp(-b t) (p cos w t + q sin w t) by least squares, Gauss-Newton on (w, b) with c, p, q eliminated.

    Args:
        time: [n] s.
        signal: [n].
        omega: first guess of w, rad/s.

    Returns:
        `omega` (rad/s), `decay` b (1/s), `residual` (rms, relative to that of the signal).
    """
    t = np.asarray(time) - time[0]
    y = np.asarray(signal, dtype=np.float64)

    def rest(p):
        decay = np.exp(-p[1] * t)
        basis = np.stack([np.ones_like(t), decay * np.cos(p[0] * t), decay * np.sin(p[0] * t)], axis=1)
        return y - basis @ np.linalg.lstsq(basis, y, rcond=None)[0]

    p = np.array([omega, 0.0])
    for _ in range(30):
        now, slope = rest(p), 1e-5 * omega
        jacobian = np.stack([(rest(p + slope * e) - rest(p - slope * e)) / (2.0 * slope) for e in np.eye(2)], axis=1)
        move = np.linalg.lstsq(jacobian, -now, rcond=None)[0]
        move *= min(1.0, 0.1 * omega / np.abs(move).max()) if np.any(move) else 1.0
        p = p + move
        if np.abs(move).max() < 1e-9 * omega:
            break
    size = float(np.sqrt(np.mean((y - y.mean()) ** 2)))
    return {"omega": float(p[0]), "decay": float(p[1]), "residual": float(np.sqrt(np.mean(rest(p) ** 2))) / size}


def decay_rate(time: np.ndarray, signal: np.ndarray) -> float:
    """Rate b of the exponential exp(-b t) through a positive signal, 1/s."""
    return -float(np.polyfit(time, np.log(signal), 1)[0])


def order_of(sizes: Sequence[float], errors: Sequence[float]) -> float:
    """Slope of log(error) over log(size)."""
    return float(np.polyfit(np.log(sizes), np.log(np.abs(errors)), 1)[0])


def legendre_amplitude(points: np.ndarray, mode: int) -> float:
    """Amplitude of P_mode(y/r) in the radius, relative to the mean radius; about the centroid, by least squares."""
    d = points - points.mean(axis=0)
    r = np.linalg.norm(d, axis=1)
    basis = np.polynomial.legendre.legvander(d[:, 1] / r, mode + 4)
    a = np.linalg.lstsq(basis, r, rcond=None)[0]
    return float(a[mode] / a[0])


def bessel_j0(x: np.ndarray) -> np.ndarray:
    """Bessel function J_0 by its integral; the trapezoid rule is exact to rounding for |x| < 20."""
    angle = (np.arange(64) + 0.5) * np.pi / 64
    return np.cos(np.multiply.outer(np.asarray(x), np.sin(angle))).mean(axis=-1)


# Normal motion: E alone


def resting_bubble(
    radius: float = 0.05, e_count: int = 5000, l_per_e: int = 0, dt: float = 1e-3, count: int = 40, **numerics
) -> dict:
    """A sphere at rest has the gauge pressure 4 sigma/R of the radius that its E have.

    The surfactant is the trace of `Material()` where there are L; sigma is that of the film.

    Returns:
        Also `spurious_speed` (m/s, largest of E, relative to nothing), `capillary_speed` sqrt(2 sigma/m) to compare it
        with, and `radius_spread` (max - min, relative).
    """
    material = Material() if l_per_e else CLEAN
    simulation = Simulation(
        Scene("rest", Sphere(radius), e_count, l_per_e, material=material, numerics=Numerics(**numerics))
    )
    steps(simulation, count, dt)
    r = np.linalg.norm(e_points(simulation), axis=1)
    exact = 4.0 * material.film_tension / r.mean()
    measured = float(simulation.state.gas.numpy()[1])
    return {
        "exact": exact,
        "measured": measured,
        "error": abs(measured / exact - 1.0),
        "spurious_speed": float(np.linalg.norm(e_velocities(simulation), axis=1).max()),
        "capillary_speed": math.sqrt(2.0 * material.film_tension / material.areal_mass),
        "radius_spread": float(np.ptp(r) / r.mean()),
        **{"radius": radius, "e_count": e_count, "l_per_e": l_per_e, "dt": dt, "steps": count, **numerics},
    }


def oscillation_frequency(mode: int, radius: float, material: Material, air: str, air_density: float = 1.204) -> float:
    """Angular frequency of mode n of a bubble (Lamb, section 275), rad/s."""
    added = air_density * radius * (2 * mode + 1) / (mode * (mode + 1)) if air == "added_mass" else 0.0
    stiffness = 2.0 * material.film_tension * (mode - 1) * (mode + 2)
    return math.sqrt(stiffness / ((material.areal_mass + added) * radius**2))


def oscillation(
    mode: int = 2,
    e_count: int = 5000,
    steps_per_period: float = 40.0,
    periods: float = 3.0,
    amplitude: float = 0.01,
    air: str = "none",
    radius: float = 0.05,
    scheme: str = "trapezoid",
    **numerics,
) -> dict:
    """A bubble rings in mode n with omega_n^2 = 2 sigma (n-1)(n+2)/((m + m_air) R^2).

    Returns:
        Angular frequencies; also `damping` (relative loss of amplitude a period) and `residual` of the fit.
    """
    exact = oscillation_frequency(mode, radius, CLEAN, air)
    dt = 2.0 * np.pi / exact / steps_per_period
    legendre = np.polynomial.legendre.Legendre.basis(mode)
    scene = Scene(
        "oscillation",
        displaced_sphere(radius, lambda d: amplitude * legendre(d[:, 1])),
        e_count,
        material=CLEAN,
        surroundings=Surroundings(air=air),
        numerics=Numerics(scheme=scheme, **numerics),
    )
    simulation = Simulation(scene)
    count = round(periods * steps_per_period)
    signal = steps(simulation, count, dt, lambda: legendre_amplitude(e_points(simulation), mode))
    time = dt * np.arange(count + 1)
    fit = damped_cosine(time, signal, exact)
    return {
        "exact": exact,
        "measured": fit["omega"],
        "error": fit["omega"] / exact - 1.0,
        "damping": 1.0 - math.exp(-2.0 * np.pi * fit["decay"] / fit["omega"]),
        "residual": fit["residual"],
        "rate": complex(-fit["decay"], fit["omega"]),
        "mode": mode,
        **{
            "e_count": e_count,
            "dt": dt,
            "steps_per_period": steps_per_period,
            "air": air,
            "scheme": scheme,
            **numerics,
        },
        "series": {"time": time, "signal": signal},
    }


def time_order(
    scheme: str = "trapezoid",
    mode: int = 2,
    e_count: int = 600,
    steps_per_period: Sequence[float] = (20.0, 40.0, 80.0),
    reference: float = 640.0,
    periods: float = 1.5,
) -> dict:
    """Order in dt of the normal dynamics: error of the complex rate (damping and frequency) against a finer run.

    Both enter: backward Euler misses the frequency by (omega dt)^2/3 but the damping, omega^2 dt/2, at first order.

    Returns:
        `measured` is the fitted order, `exact` the scheme's; `error` their difference; `errors` |rate - finer|/omega.
    """
    finer = oscillation(mode, e_count, reference, periods, scheme="trapezoid")
    runs = [oscillation(mode, e_count, s, periods, scheme=scheme) for s in steps_per_period]
    errors = [abs(run["rate"] - finer["rate"]) / finer["measured"] for run in runs]
    exact = {"trapezoid": 2.0, "backward_euler": 1.0}[scheme]
    order = order_of([1.0 / s for s in steps_per_period], errors)
    return {
        "exact": exact,
        "measured": order,
        "error": order - exact,
        "errors": errors,
        "scheme": scheme,
        **{"mode": mode, "e_count": e_count, "steps_per_period": tuple(steps_per_period), "reference": reference},
    }


def space_order(mode: int = 3, e_counts: Sequence[int] = (600, 1200, 2500, 5000), **given) -> dict:
    """Order in the spacing of the frequency of mode n, freed of the midpoint rule's own error.

    The midpoint rule turns omega into (2/dt) atan(omega dt/2), which is what `errors` are taken against.

    Returns:
        `measured` is the fitted order over sqrt(1/e_count).
    """
    runs = [oscillation(mode, n, **given) for n in e_counts]
    half = np.pi / np.array([run["steps_per_period"] for run in runs])
    errors = [run["measured"] / run["exact"] * h / math.atan(h) - 1.0 for run, h in zip(runs, half, strict=True)]
    order = order_of([n**-0.5 for n in e_counts], errors)
    return {"exact": 2.0, "measured": order, "error": order - 2.0, "errors": errors, "mode": mode, "e_counts": e_counts}


def drum(
    e_count: int = 1200,
    radius: float = 0.05,
    steps_per_period: float = 80.0,
    periods: float = 1.5,
    amplitude: float = 1e-3,
    **numerics,
) -> dict:
    """A flat round membrane held by its rim: the fundamental omega = 2.404826/R sqrt(2 sigma/m).

    Returns:
        Angular frequencies; `damping` (relative, a period).
    """
    exact = 2.404825557695773 / radius * math.sqrt(2.0 * CLEAN.film_tension / CLEAN.areal_mass)
    speed = amplitude * radius * exact

    def shape(x):
        return bessel_j0(2.404825557695773 * np.hypot(x[:, 0], x[:, 2]) / radius)

    def struck(x):
        return speed * shape(x)[:, None] * np.array([0.0, 1.0, 0.0])

    numerics = {"scheme": "trapezoid", **numerics}
    scene = Scene(
        "drum", Disc(radius, flat=False), e_count, material=CLEAN, velocity=struck, numerics=Numerics(**numerics)
    )
    simulation = Simulation(scene)
    dt = 2.0 * np.pi / exact / steps_per_period

    def height():
        x, a = e_points(simulation), e_area(simulation)
        s = shape(x)
        return float(np.sum(a * s * x[:, 1]) / np.sum(a * s * s))

    count = round(periods * steps_per_period)
    signal, time = steps(simulation, count, dt, height), dt * np.arange(count + 1)
    fit = damped_cosine(time, signal, exact)
    return {
        "exact": exact,
        "measured": fit["omega"],
        "error": fit["omega"] / exact - 1.0,
        "damping": 1.0 - math.exp(-2.0 * np.pi * fit["decay"] / fit["omega"]),
        "residual": fit["residual"],
        **{"e_count": e_count, "radius": radius, "dt": dt, **numerics},
        "series": {"time": time, "signal": signal},
    }


# Rigid motion


def free_fall(
    duration: float = 0.5,
    dt: float = 1.0 / 60.0,
    e_count: int = 600,
    l_per_e: int = 8,
    radius: float = 0.05,
    scheme: str = "backward_euler",
    lift: float = 0.0,
    **numerics,
) -> dict:
    """A closed bubble without air or lift falls as a stone: its centre of mass by g t^2/2, and it stays a sphere.

    A first-order scheme that moves with the velocity of the end of the step falls g t (t + dt)/2; that is the `exact`
    of backward Euler, the trapezoid's is g t^2/2. With `lift=1` it hovers: `exact` 0, `error` in units of g t^2/2.

    Returns:
        m; also `e_error` (the same for the centre of E), `speed_error` (against g t), `radius_spread` of E and L.
    """
    material = Material()
    scene = Scene(
        "fall",
        Sphere(radius),
        e_count,
        l_per_e,
        material=material,
        surroundings=Surroundings(gravity=(0.0, -GRAVITY, 0.0), lift=lift),
        numerics=Numerics(scheme=scheme, **numerics),
    )
    simulation = Simulation(scene)
    count = round(duration / dt)
    mass = l_array(simulation, "mass")

    def centre():
        x = l_array(simulation, "x")
        return (mass @ x)[1] / mass.sum()

    start, e_start = centre(), e_points(simulation)[:, 1].mean()
    steps(simulation, count, dt)
    time = count * dt
    late = dt if scheme == "backward_euler" else 0.0
    scale = -0.5 * GRAVITY * time * (time + late)
    exact = scale if lift == 0.0 else 0.0
    fallen, e_fallen = centre() - start, e_points(simulation)[:, 1].mean() - e_start
    x_e, x_l = e_points(simulation), l_array(simulation, "x")
    r_e, r_l = (np.linalg.norm(x - x_e.mean(axis=0), axis=1) for x in (x_e, x_l))
    velocity = np.array(simulation.diagnostics()["momentum"])[1] / mass.sum()
    return {
        "exact": exact,
        "measured": fallen,
        "error": abs((fallen - exact) / scale),
        "e_error": abs((e_fallen - exact) / scale),
        "speed_error": abs(velocity / (GRAVITY * time) + (1.0 if lift == 0.0 else 0.0)),
        "radius_spread": float(np.ptp(r_e) / r_e.mean()),
        "l_radius_spread": float(np.ptp(r_l) / r_l.mean()),
        "e_spread": float(simulation.stepper.redistribution.spread.numpy()[0]),
        **{"dt": dt, "duration": time, "e_count": e_count, "l_per_e": l_per_e, "scheme": scheme, "lift": lift},
        **numerics,
    }


def fall_in_air(
    e_count: int = 600, l_per_e: int = 0, radius: float = 0.05, dt: float = 1e-3, count: int = 20, **given
) -> dict:
    """A bubble that must push the air starts to fall at g m/(m + 3/2 rho_air R).

    That is the acceleration of the surface, on which the normal part of the weight acts; the liquid of a film whose
    surfactant holds nothing slides along it freely.

    Returns:
        m/s^2.
    """
    surroundings = Surroundings(gravity=(0.0, -GRAVITY, 0.0), air="added_mass")
    material = Material() if l_per_e else CLEAN
    scene = Scene("air", Sphere(radius), e_count, l_per_e, material=material, surroundings=surroundings)
    simulation = Simulation(scene)
    start = e_points(simulation)[:, 1].mean()
    steps(simulation, count, dt)
    time = count * dt
    exact = -GRAVITY * material.areal_mass / (material.areal_mass + 1.5 * surroundings.air_density * radius)
    measured = 2.0 * (e_points(simulation)[:, 1].mean() - start) / (time * (time + dt))
    return {
        "exact": exact,
        "measured": measured,
        "error": abs(measured / exact - 1.0),
        **{"e_count": e_count, "l_per_e": l_per_e, "radius": radius, "dt": dt, "steps": count},
    }


def translation(
    speed: float = 10.0,
    dt: float = 1.0 / 60.0,
    count: int = 100,
    e_count: int = 600,
    l_per_e: int = 8,
    radius: float = 0.05,
    **numerics,
) -> dict:
    """A bubble flying at constant speed keeps its momentum and its even E.

    Returns:
        Momentum (kg m/s); `error` its largest relative departure on the way; `centre_error` of the distance flown;
        `e_spread` the largest (max - min)/mean of the E density.
    """
    scene = Scene(
        "flight",
        Sphere(radius),
        e_count,
        l_per_e,
        velocity=lambda x: np.tile([speed, 0.0, 0.0], (len(x), 1)),
        numerics=Numerics(**numerics),
    )
    simulation = Simulation(scene)
    start = e_points(simulation).mean(axis=0)

    def observe():
        spread = simulation.stepper.redistribution.spread.numpy()[0]
        return [*simulation.diagnostics()["momentum"], spread]

    seen = steps(simulation, count, dt, observe)
    momentum = seen[:, :3]
    exact = float(l_array(simulation, "mass").sum() * speed)
    flown = e_points(simulation).mean(axis=0) - start
    return {
        "exact": exact,
        "measured": float(momentum[-1, 0]),
        "error": float(np.linalg.norm(momentum - [exact, 0.0, 0.0], axis=1).max() / exact),
        "centre_error": float(np.linalg.norm(flown - [speed * count * dt, 0.0, 0.0]) / (speed * count * dt)),
        "e_spread": float(seen[1:, 3].max()),
        **{"speed": speed, "dt": dt, "steps": count, "e_count": e_count, "l_per_e": l_per_e, **numerics},
    }


def free_momentum(frames: int = 60, e_count: int = 600, l_per_e: int = 8, dt: float = 1.0 / 60.0) -> dict:
    """A wobbling bubble left alone (no air, no gravity) keeps its momentum, here nothing.

    Returns:
        `error` is the largest momentum on the way over mass times the rms speed of the film at the start.
    """
    scene = small_giant(e_count, l_per_e, air="none", gravity=0.0, dt=dt)
    simulation = Simulation(scene)
    mass, v = l_array(simulation, "mass"), l_array(simulation, "v")
    scale = mass.sum() * math.sqrt((mass * (v**2).sum(axis=1)).sum() / mass.sum())
    seen = steps(simulation, frames, dt, lambda: simulation.diagnostics()["momentum"])
    worst = float(np.linalg.norm(seen - seen[0], axis=1).max())
    return {
        "exact": 0.0,
        "measured": worst,
        "error": worst / scale,
        **{"frames": frames, "e_count": e_count, "l_per_e": l_per_e, "dt": dt},
    }


def small_giant(e_count: int, l_per_e: int, **overrides) -> Scene:
    """The scene giant_bubble with other numbers."""
    script = load_scene("giant_bubble")
    return script.build(script.parameters.values({"e_count": e_count, "l_per_e": l_per_e, **overrides}))
