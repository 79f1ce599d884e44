"""Cases of a surface that rests or rings."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Disc, Jittered, Sphere, displaced_sphere
from melp_warp.simulation import Simulation
from melp_warp.study.validation.shared import (
    CLEAN,
    bessel_j0,
    cost,
    damped_cosine,
    e_area,
    e_points,
    e_velocities,
    legendre_amplitude,
    order_of,
    steps,
)


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
