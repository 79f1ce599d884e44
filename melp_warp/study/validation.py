"""Validation: runs with a known answer, as functions that return numbers (SI).

Every case builds a `Scene`, runs it and returns a dictionary: `exact`, `measured`, `error` (relative unless its
docstring says otherwise) and the parameters it ran with; `series` holds what a plot needs, `cost` (in the cases that
`melp_warp.study.tradeoff` takes) what the run took, see `cost`. The tests run them small,
the tool `tools/validate.py` runs them at full size and writes docs/validation.md. Any can be called from Python:

    >>> from melp_warp.study.validation import oscillation
    >>> oscillation(mode=2, e_count=1500)["error"]
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from melp_warp.cluster import Bubble, Cluster
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.program.estimate import array_bytes
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Jittered, Rectangle, Sphere, displaced_sphere
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


def _frames(simulation: Simulation, count: int, observe: Callable[[], object]) -> np.ndarray:
    """Advance by `count` frames; what `observe()` returns before the first and after each."""
    seen = [observe()]
    for _ in range(count):
        simulation.advance_frame()
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
    """An array of the L state as float64; that of E in a single layer, where they carry the film."""
    if simulation.has_l:
        return getattr(simulation.state.l, name).numpy().astype(np.float64)
    if name == "eta":
        return e_thickness(simulation)
    of_e = getattr(simulation.state.e, "u" if name == "v" else name)
    return of_e.numpy()[: simulation.film.n_e].astype(np.float64)


def unevenness(simulation: Simulation) -> float:
    """Deviation of the thickness, relative to its mean."""
    found = simulation.diagnostics()
    return found["thickness_std"] / found["thickness_mean"]


def cost(simulation: Simulation) -> dict:
    """What a run took and what it kept.

    Returns:
        `steps`; `seconds`, wall time of all of them at that of the usual one; `simulated`, s; `bytes` of all arrays;
        `mass_error`, of the E against the L they come from; `volume_error`, of the volume found anew from the surface
        against that of the gas law. Relative; 0 where there are no L, no gas.
    """
    count, film = len(simulation.step_seconds), simulation.film
    result = {
        "steps": count,
        "seconds": count * float(np.median(simulation.step_seconds)) if count else 0.0,
        "simulated": simulation.time,
        "bytes": array_bytes(simulation),
        "mass_error": 0.0,
        "volume_error": 0.0,
    }
    if simulation.has_l:
        simulation.stepper.transfer.gather()
        held = float(np.sum(simulation.state.e.mass.numpy(), dtype=np.float64))
        result["mass_error"] = abs(held / l_array(simulation, "mass").sum() - 1.0)
    if film.features.closed:
        volume = simulation.state.gas.numpy()[:, 0].copy()
        simulation.stepper.lists.rebuild()
        simulation.stepper.geometry.update()
        result["volume_error"] = float(np.abs(simulation.state.gas.numpy()[:, 0] / volume - 1.0).max())
    return result


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
    """Rate b of the exponential exp(-b t) through a signal's size, 1/s."""
    return -float(np.polyfit(time, np.log(np.abs(signal)), 1)[0])


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
    radius: float = 0.05,
    e_count: int = 5000,
    l_per_e: int = 0,
    dt: float = 1e-3,
    count: int = 40,
    jitter: float = 0.0,
    **numerics,
) -> dict:
    """A sphere at rest has the gauge pressure 4 sigma/R of the radius that its E have.

    E start `jitter` spacings at most from even places. The surfactant is the trace of `Material()` where there are L;
    sigma is that of the film.

    Returns:
        Also `curvature_error` (rms over the E, against -2/R, relative), `spurious_speed` (m/s, largest of E, relative
        to nothing), `capillary_speed` sqrt(2 sigma/m) to compare it with, and `radius_spread` (max - min, relative).
    """
    material = Material() if l_per_e else CLEAN
    shape = Jittered(Sphere(radius), jitter) if jitter else Sphere(radius)
    simulation = Simulation(Scene("rest", shape, e_count, l_per_e, material=material, numerics=Numerics(**numerics)))
    steps(simulation, count, dt)
    r = np.linalg.norm(e_points(simulation), axis=1)
    kappa = simulation.stepper.geometry.curvature(simulation.state.e.x).numpy().astype(np.float64)
    exact = 4.0 * material.film_tension / r.mean()
    measured = float(simulation.state.gas.numpy()[0, 1])
    return {
        "cost": cost(simulation),
        "exact": exact,
        "measured": measured,
        "error": abs(measured / exact - 1.0),
        "curvature_error": float(np.sqrt(np.mean((0.5 * r.mean() * kappa + 1.0) ** 2))),
        "spurious_speed": float(np.linalg.norm(e_velocities(simulation), axis=1).max()),
        "capillary_speed": math.sqrt(2.0 * material.film_tension / material.areal_mass),
        "radius_spread": float(np.ptp(r) / r.mean()),
        **{"radius": radius, "e_count": e_count, "l_per_e": l_per_e, "dt": dt, "steps": count, "jitter": jitter},
        **numerics,
    }


def oscillation_frequency(mode: int, radius: float, material: Material, air: str, air_density: float = 1.204) -> float:
    """Angular frequency of mode n of a bubble (Lamb, section 275), rad/s."""
    added = air_density * radius * (2 * mode + 1) / (mode * (mode + 1)) if air == "added_mass" else 0.0
    stiffness = 2.0 * material.film_tension * (mode - 1) * (mode + 2)
    return math.sqrt(stiffness / ((material.areal_mass + added) * radius**2))


def _struck(radius: float, amplitudes: Mapping[int, float], e_count: int, air: str, numerics: Numerics) -> Simulation:
    """A clean bubble displaced by modes P_n with the given amplitudes, relative to the radius."""
    polynomial = np.polynomial.legendre.Legendre(np.zeros(max(amplitudes) + 1))
    for mode, amplitude in amplitudes.items():
        polynomial.coef[mode] = amplitude
    scene = Scene(
        "oscillation",
        displaced_sphere(radius, lambda d: polynomial(d[:, 1])),
        e_count,
        material=CLEAN,
        surroundings=Surroundings(air=air),
        numerics=numerics,
    )
    return Simulation(scene)


def oscillation(
    mode: int = 2,
    e_count: int = 5000,
    steps_per_period: float = 40.0,
    periods: float = 3.0,
    amplitude: float = 0.002,
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
    simulation = _struck(radius, {mode: amplitude}, e_count, air, Numerics(scheme=scheme, **numerics))
    count = round(periods * steps_per_period)
    signal = steps(simulation, count, dt, lambda: legendre_amplitude(e_points(simulation), mode))
    time = dt * np.arange(count + 1)
    fit = damped_cosine(time, signal, exact)
    return {
        "cost": cost(simulation),
        "exact": exact,
        "measured": fit["omega"],
        "error": fit["omega"] / exact - 1.0,
        "damping": 1.0 - math.exp(-2.0 * np.pi * fit["decay"] / fit["omega"]),
        "residual": fit["residual"],
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


def chord(
    modes: Sequence[int] = (2, 5, 8),
    e_count: int = 1200,
    steps_per_period: float = 60.0,
    periods: float = 1.0,
    amplitude: float = 2e-3,
    radius: float = 0.05,
    scheme: str = "trapezoid",
    **numerics,
) -> dict:
    """A bubble rings in several modes at once, each with its own frequency; without air.

    No spacing or step is lucky with all of them, as one can be with a single mode. Steps are counted by the period of
    the last mode, `periods` are those of the first.

    Returns:
        `error` rms departure of the amplitudes over time from the exact cosines, relative to the rms of those;
        `signal` and `exact` [steps + 1, modes] under `series`.
    """
    omega = np.array([oscillation_frequency(mode, radius, CLEAN, "none") for mode in modes])
    dt = 2.0 * np.pi / omega[-1] / steps_per_period
    numbers = Numerics(scheme=scheme, **numerics)
    simulation = _struck(radius, dict.fromkeys(modes, amplitude), e_count, "none", numbers)
    count = round(periods * steps_per_period * omega[-1] / omega[0])
    signal = steps(simulation, count, dt, lambda: [legendre_amplitude(e_points(simulation), n) for n in modes])
    time = dt * np.arange(count + 1)
    exact = signal[0] * np.cos(np.outer(time, omega))
    return {
        "cost": cost(simulation),
        "error": float(np.linalg.norm(signal - exact) / np.linalg.norm(exact)),
        **{"modes": tuple(modes), "e_count": e_count, "dt": dt, "steps_per_period": steps_per_period},
        **{"scheme": scheme, **numerics},
        "series": {"time": time, "signal": signal, "exact": exact},
    }


def time_order(
    scheme: str = "trapezoid",
    mode: int = 2,
    e_count: int = 600,
    steps_per_period: Sequence[int] = (20, 40, 80),
    reference: int = 640,
    periods: float = 1.5,
    **numerics,
) -> dict:
    """Order in dt of the normal dynamics: the amplitude over time against a finer run of the midpoint rule.

    Phase and damping both enter: backward Euler misses the frequency by (omega dt)^2/3 but the damping,
    omega^2 dt/2, at first order. All step counts are multiples of the first, at whose times the runs are compared.

    Returns:
        `measured` is the fitted order, `exact` the scheme's; `error` their difference; `errors` the rms differences,
        relative to the rms amplitude.
    """

    def at_common_times(count, scheme):
        signal = oscillation(mode, e_count, count, periods, scheme=scheme, **numerics)["series"]["signal"]
        return signal[:: count // steps_per_period[0]]

    finer = at_common_times(reference, "trapezoid")
    errors = [
        float(np.linalg.norm(at_common_times(count, scheme) - finer) / np.linalg.norm(finer))
        for count in steps_per_period
    ]
    exact = {"trapezoid": 2.0, "backward_euler": 1.0}[scheme]
    order = order_of([1.0 / s for s in steps_per_period], errors)
    return {
        "exact": exact,
        "measured": order,
        "error": order - exact,
        "errors": errors,
        "scheme": scheme,
        **{"mode": mode, "e_count": e_count, "steps_per_period": tuple(steps_per_period), "reference": reference},
        **numerics,
    }


def midpoint_frequency(mode: int, steps_per_period: float) -> float:
    """Frequency that the midpoint rule makes of omega_n without air, over omega_n.

    2/(omega_n dt) atan(omega_n dt/2), about 1 - (omega_n dt)^2/12.
    """
    angle = 2.0 * np.pi / steps_per_period
    return 2.0 * math.atan(0.5 * angle) / angle


def space_order(mode: int = 6, e_counts: Sequence[int] = (300, 600, 1200), **given) -> dict:
    """Order in the spacing of the frequency of mode n, freed of the midpoint rule's own error: 4 or better.

    Returns:
        `measured` is the fitted order over sqrt(1/e_count).
    """
    numbers = {"steps_per_period": 80.0, "amplitude": 0.005, "tolerance": 1e-6}
    runs = [oscillation(mode, n, **{**numbers, **given}) for n in e_counts]
    errors = [run["measured"] / run["exact"] / midpoint_frequency(mode, run["steps_per_period"]) - 1.0 for run in runs]
    order = order_of([n**-0.5 for n in e_counts], errors)
    return {"exact": 4.0, "measured": order, "error": order - 4.0, "errors": errors, "mode": mode, "e_counts": e_counts}


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

    A first-order scheme that moves with the velocity of the end of the step falls g t (t + dt)/2: that is the `exact`
    where both scheme and flow are backward Euler; it is g t^2/2 elsewhere. With `lift=1` it hovers: `exact` 0, `error`
    in units of g t^2/2.

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
    late = dt if scheme == "backward_euler" == Numerics(**numerics).flow else 0.0
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
        "e_spread": float(simulation.stepper.redistribution.spread.numpy()[0, 0]),
        **{"dt": dt, "duration": time, "e_count": e_count, "l_per_e": l_per_e, "scheme": scheme, "lift": lift},
        **numerics,
    }


def fall_in_air(
    e_count: int = 600,
    l_per_e: int = 0,
    radius: float = 0.05,
    dt: float = 1e-3,
    count: int = 20,
    hanging: bool = False,
) -> dict:
    """A bubble that must push the air starts to fall at g m/(m + 3/2 rho_air R).

    That is the acceleration of the surface, on which the normal part of the weight acts; the liquid slides along it
    freely at first. Once it hangs on the surfactant (`hanging`, after some R/elastic speed = 50 ms) the whole weight
    acts, 4 pi R^2 m g on 4 pi R^2 m + 2 pi rho_air R^3: g m/(m + rho_air R/2), three times as much where the air is
    heavier than the film.

    Returns:
        m/s^2, the mean over the run, or over its second half where the liquid hangs.
    """
    surroundings = Surroundings(gravity=(0.0, -GRAVITY, 0.0), air="added_mass", air_drag=0.0)
    material = Material() if l_per_e else CLEAN
    scene = Scene("air", Sphere(radius), e_count, l_per_e, material=material, surroundings=surroundings)
    simulation = Simulation(scene)

    def centre():
        return e_points(simulation)[:, 1].mean()

    height, time = steps(simulation, count, dt, centre), dt * np.arange(count + 1)
    share = 0.5 if hanging else 1.5
    exact = -GRAVITY * material.areal_mass / (material.areal_mass + share * surroundings.air_density * radius)
    late = slice(count // 2, None) if hanging else slice(None)
    measured = 2.0 * float(np.polyfit(time[late], height[late], 2)[0])
    return {
        "exact": exact,
        "measured": measured,
        "error": abs(measured / exact - 1.0),
        **{"e_count": e_count, "l_per_e": l_per_e, "radius": radius, "dt": dt, "steps": count, "hanging": hanging},
    }


def sphere_fall(mass: float, radius: float, times: np.ndarray, air_drag: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Speed (m/s) and way (m) of a bubble that falls from rest in air, at `times` (s, rising from 0).

    Its film of `mass` (kg), the air inside and half its volume of air outside are moved; a sphere in steady motion has
    the drag of Schiller and Naumann (1933). Integrated by classical Runge-Kutta, 100 steps between two times.
    """
    air, viscosity = Surroundings().air_density, 1.81e-5
    inertia = mass + 2.0 * np.pi * air * radius**3

    def rate(state):
        reynolds = max(2.0 * air * radius * state[0] / viscosity, 1e-12)
        coefficient = max(24.0 / reynolds * (1.0 + 0.15 * reynolds**0.687), 0.44 if reynolds > 1000.0 else 0.0)
        drag = air_drag * 0.5 * air * coefficient * np.pi * radius**2 * state[0] ** 2
        return np.array([(mass * GRAVITY - drag) / inertia, state[0]])

    found = [np.zeros(2)]
    for begin, end in itertools.pairwise(times):
        state, h = found[-1], (end - begin) / 100.0
        for _ in range(100):
            a = rate(state)
            b = rate(state + 0.5 * h * a)
            c = rate(state + 0.5 * h * b)
            state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + rate(state + h * c))
        found.append(state)
    speed, way = np.array(found).T
    return speed, way


def terminal_fall(
    foam: bool = False,
    e_count: int = 400,
    l_per_e: int = 4,
    radius: float = 0.01,
    thickness: float = 1e-6,
    dt: float = 1.0 / 60.0,
    duration: float = 1.5,
    air_drag: float = 1.0,
    **surroundings,
) -> dict:
    """A bubble falls from rest in air that holds it back, as a single film or as a foam of one.

    Returns:
        m/s, the speed at the end, exact by `sphere_fall`; `way_error`: relative, of the way fallen; `largest`: the
        largest difference between the speeds on the way, relative to the last.
    """
    shape = Cluster((Bubble((0.0, 0.0, 0.0), radius),)) if foam else Sphere(radius)
    around = Surroundings(gravity=(0.0, -GRAVITY, 0.0), air="added_mass", air_drag=air_drag, **surroundings)
    material = Material(thickness=thickness)
    simulation = Simulation(
        Scene("terminal", shape, e_count, l_per_e, material=material, surroundings=around, dt=dt, fps=1.0 / dt)
    )
    count = round(duration / dt)

    def observe():
        return [simulation.state.motion.numpy()[0, 1], e_points(simulation)[:, 1].mean()]

    seen = -steps(simulation, count, dt, observe)
    mass = 4.0 * np.pi * radius**2 * material.areal_mass
    speed, way = sphere_fall(mass, radius, dt * np.arange(count + 1), air_drag)
    fallen = seen[-1, 1] - seen[0, 1]
    return {
        "exact": float(speed[-1]),
        "measured": float(seen[-1, 0]),
        "error": abs(float(seen[-1, 0] / speed[-1]) - 1.0),
        "way_error": abs(float(fallen / way[-1]) - 1.0),
        "largest": float(np.abs(seen[:, 0] - speed).max() / speed[-1]),
        **{"foam": foam, "e_count": e_count, "l_per_e": l_per_e, "radius": radius, "thickness": thickness, "dt": dt},
        **{"duration": duration, "air_drag": air_drag},
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
        spread = simulation.stepper.redistribution.spread.numpy()[0, 0]
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


def free_momentum(
    e_count: int = 600, l_per_e: int = 8, dt: float = 1.0 / 480.0, frames: int = 120, **overrides
) -> dict:
    """A wobbling bubble left alone (no air, no gravity; the scene giant_bubble) keeps its momentum.

    Returns:
        `error` is the largest change of momentum over the largest sum of m |v|, both over the run: nothing in the
        scheme makes it zero. Forces of constant tension are freed of their net part, but a step's response to them,
        the motion of E between normals that turn, and the liquid that flows round a bend are not.
    """
    simulation = Simulation(small_giant(e_count, l_per_e, **{"air": "none", "gravity": 0.0, "dt": dt, **overrides}))
    mass = l_array(simulation, "mass")

    def observe():
        v = l_array(simulation, "v")
        return [*(mass @ v), mass @ np.linalg.norm(v, axis=1)]

    seen = steps(simulation, frames, dt, observe)
    worst = float(np.linalg.norm(seen[:, :3] - seen[0, :3], axis=1).max())
    return {
        "exact": 0.0,
        "measured": worst,
        "error": worst / float(seen[:, 3].max()),
        **{"frames": frames, "e_count": e_count, "l_per_e": l_per_e, "dt": dt, **overrides},
    }


def small_giant(e_count: int, l_per_e: int, **overrides) -> Scene:
    """The scene giant_bubble with other numbers."""
    script = load_scene("giant_bubble")
    return script.build(script.parameters.values({"e_count": e_count, "l_per_e": l_per_e, **overrides}))


# Flow along the film


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


def couder_profile(z: np.ndarray, height: float, material: Material, gravity: float = GRAVITY) -> np.ndarray:
    """Thickness of a film at rest at height z above its bottom, relative to eta_0 (Couder et al. 1989, by mass)."""
    length = 2.0 * material.rt * material.surfactant / (material.density * gravity * material.thickness)
    return height / length * np.exp(-z / length) / (1.0 - math.exp(-height / length))


def _profile_errors(simulation: Simulation, exact: Callable[[np.ndarray], np.ndarray]) -> dict:
    """L2 departures of E and L thickness from a profile eta(x)/eta_0, relative to the profile's own size."""
    eta_0 = simulation.scene.material.thickness
    x_e, a_e, eta_e = e_points(simulation), e_area(simulation), e_thickness(simulation) / eta_0
    x_l, eta_l = l_array(simulation, "x"), l_array(simulation, "eta") / eta_0
    a_l = l_array(simulation, "mass") / eta_l
    found = {}
    for name, x, a, eta in (("e", x_e, a_e, eta_e), ("l", x_l, a_l, eta_l)):
        aim = exact(x)
        found[name] = math.sqrt(np.sum(a * (eta - aim) ** 2) / np.sum(a * aim**2))
    return found


def drainage(
    e_count: int = 1200,
    l_per_e: int = 16,
    duration: float = 2.5,
    dt: float = 1.0 / 60.0,
    drag: float = 0.02,
    at_rest: bool = False,
    width: float = 0.15,
    height: float = 0.2,
    fps: float = 60.0,
    **numerics,
) -> dict:
    """An upright film drains until its surfactant carries its weight: the exponential profile, normalised by mass.

    `at_rest` starts from that profile, without drag unless given, and watches whether it stays.

    Returns:
        `error` the L2 error of eta_E against the profile, `l_error` of eta_L, both relative; `max_speed` (m/s, of
        all frames), `amplitude` how far the profile is from an even film, by the same measure; `exact` and `measured`
        the thickness ratio of bottom to top row of E. `waves` under `series` is where the liquid of the L lies,
        frame by frame: its mean of cos(k pi z/height), k from 1 to 4, [frames + 1, 4].
    """
    material = Material()

    def profile(x):
        return couder_profile(x[:, 1] + 0.5 * height, height, material)

    fields = {}
    if at_rest:
        fields = {
            "thickness": lambda x: material.thickness * profile(x),
            "concentration": lambda x: material.surfactant * profile(x),
        }
    scene = Scene(
        "drainage",
        Rectangle(width, height),
        e_count,
        l_per_e,
        material=material,
        surroundings=Surroundings(gravity=(0.0, -GRAVITY, 0.0), drag=drag),
        numerics=Numerics(**numerics),
        fps=fps,
        dt=dt,
        **fields,
    )
    simulation = Simulation(scene)

    def observe() -> list[float]:
        y = l_array(simulation, "x")[:, 1] / height + 0.5
        waves = np.cos(np.pi * np.outer(np.arange(1, 5), y)) @ l_array(simulation, "mass")
        return [simulation.diagnostics()["max_speed"], *waves / l_array(simulation, "mass").sum()]

    seen = _frames(simulation, round(duration * fps), observe)
    speeds = seen[:, 0]
    errors = _profile_errors(simulation, profile)
    x, eta, aim = e_points(simulation), e_thickness(simulation), profile(e_points(simulation))
    low, high = x[:, 1] == x[:, 1].min(), x[:, 1] == x[:, 1].max()
    return {
        "cost": cost(simulation),
        "exact": float(aim[low].mean() / aim[high].mean()),
        "measured": float(eta[low].mean() / eta[high].mean()),
        "error": errors["e"],
        "l_error": errors["l"],
        "amplitude": _profile_errors(simulation, lambda x: np.ones(len(x)))["e"],
        "max_speed": float(speeds.max()),
        "final_speed": float(speeds[-1]),
        **{"e_count": simulation.film.n_e, "l_per_e": l_per_e, "duration": duration, "dt": dt, "drag": drag},
        **{"at_rest": at_rest, **numerics},
        "series": {"z": x[:, 1] + 0.5 * height, "eta": eta, "exact": material.thickness * aim, "speed": speeds}
        | {"waves": seen[:, 1:]},
    }


def equilibrium(e_count: int = 1050, l_per_e: int = 16, duration: float = 5.0, **overrides) -> dict:
    """The scene equilibrium: the variance of the thickness must fall 100-fold and stay so.

    Returns:
        `measured` the factor by which the mass-weighted variance of eta_E fell by the end, `exact` what is to be
        reached; `error` how much the standard deviation of the last second exceeds, at its worst, a tenth of the
        first (0 where it does not); `l_measured` the factor of eta_L.
    """
    script = load_scene("equilibrium")
    values = {"e_count": e_count, "l_per_e": l_per_e, "fps": 30.0, **overrides}
    scene = script.build(script.parameters.values(values))
    simulation = Simulation(scene)
    frames = round(duration * scene.fps)

    def observe():
        area, eta = e_area(simulation), e_thickness(simulation)
        mass, eta_l = l_array(simulation, "mass"), l_array(simulation, "eta")
        return np.average((eta - np.average(eta, weights=area)) ** 2, weights=area), np.average(
            (eta_l - np.average(eta_l, weights=mass)) ** 2, weights=mass
        )

    seen = _frames(simulation, frames, observe)
    fall = seen / seen[0]
    last = fall[-max(1, round(scene.fps)) :]
    return {
        "cost": cost(simulation),
        "exact": 100.0,
        "measured": float(1.0 / fall[-1, 0]),
        "error": float(max(0.0, math.sqrt(last[:, 0].max()) / 0.1 - 1.0)),
        "worst_of_last_second": float(1.0 / last[:, 0].max()),
        "l_measured": float(1.0 / fall[-1, 1]),
        "l_worst_of_last_second": float(1.0 / last[:, 1].max()),
        **{"e_count": simulation.film.n_e, "l_per_e": l_per_e, "duration": duration, **overrides},
        "series": {"time": np.arange(frames + 1) / scene.fps, "variance_e": fall[:, 0], "variance_l": fall[:, 1]},
    }


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


# The whole


def giant_bubble(frames: int = 300, e_count: int = 2000, l_per_e: int = 16, **overrides) -> dict:
    """The scene giant_bubble in steps of 1/60 s stays finite, keeps its gas and loses no L.

    Returns:
        m^3; `error` the volume's drift at the end, relative; `excursion` the largest on the way; `lost` L;
        `thickness_mismatch` the rms of log(eta_L/eta_E) of the last frame, L weighted onto E.
    """
    simulation = Simulation(small_giant(e_count, l_per_e, **overrides))
    start = simulation.diagnostics()
    volumes, lost = [start["volume"]], 0
    for _ in range(frames):
        simulation.advance_frame()
        now = simulation.diagnostics()
        volumes.append(now["volume"])
        lost += now["lost"]
    drift = np.array(volumes) / volumes[0] - 1.0
    finite = all(np.isfinite(a).all() for a in simulation.state.numpy().values())
    return {
        "exact": start["volume"],
        "measured": now["volume"],
        "error": float(abs(drift[-1])),
        "excursion": float(np.abs(drift).max()),
        "lost": lost,
        "finite": finite,
        "thickness_mismatch": thickness_mismatch(simulation),
        "e_spread": now["e_spread"],
        "max_speed": now["max_speed"],
        **{"e_count": simulation.film.n_e, "l_per_e": l_per_e, "frames": frames, **overrides},
        "series": {"frame": np.arange(frames + 1), "drift": drift},
    }


def thickness_mismatch(simulation: Simulation) -> float:
    """Rms over E of log(area that the L claim at their thickness / control area): eta_E against the mean eta_L."""
    transfer = simulation.stepper.transfer
    transfer.gather()
    return float(np.sqrt(np.mean(np.log(transfer.claim.numpy() / e_area(simulation)) ** 2)))


def conservation(scene: Scene, count: int = 1000, dt: float = 1.0 / 60.0, every: int = 20) -> dict:
    """Mass and surfactant of the E, summed in float64, against those of the L they come from, over `count` steps.

    Returns:
        kg; `error` the largest relative departure of mass or surfactant from the first; also each.
    """
    simulation = Simulation(scene)

    def sums():
        simulation.stepper.transfer.gather()
        e = simulation.state.e
        return [float(np.sum(a.numpy(), dtype=np.float64)) for a in (e.mass, e.surfactant)]

    exact = [l_array(simulation, name).sum() for name in ("mass", "surfactant")]
    seen = [sums()]
    for done in range(count):
        simulation.step(dt)
        if (done + 1) % every == 0:
            simulation.stepper.check()
            seen.append([*sums()])
    seen = np.array(seen) / exact - 1.0
    worst = np.abs(seen).max(axis=0)
    still = [l_array(simulation, name).sum() for name in ("mass", "surfactant")]
    same = 1e-6 if simulation.film.features.mixes else 0.0
    assert np.allclose(still, exact, rtol=same, atol=0.0), "L changed their mass or surfactant"
    return {
        "exact": float(exact[0]),
        "measured": float(exact[0] * (1.0 + seen[-1, 0])),
        "error": float(worst.max()),
        "mass_error": float(worst[0]),
        "surfactant_error": float(worst[1]),
        **{"scene": scene.name, "e_count": scene.e_count, "l_per_e": scene.l_per_e, "steps": count, "dt": dt},
    }
