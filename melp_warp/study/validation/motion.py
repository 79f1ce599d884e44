"""Cases of films that move as a whole: falls, flights, momentum."""

from __future__ import annotations

import itertools

import numpy as np

from melp_warp.cluster import Bubble, Cluster
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Sphere
from melp_warp.simulation import Simulation
from melp_warp.study.validation.shared import CLEAN, GRAVITY, e_points, l_array, small_giant, steps


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
