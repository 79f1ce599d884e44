"""Cases of whole films: drainage, equilibrium, the giant bubble, what is conserved."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.shapes import Rectangle
from melp_warp.simulation import Simulation
from melp_warp.study.validation.shared import (
    GRAVITY,
    cost,
    e_area,
    e_points,
    e_thickness,
    l_array,
    observe_frames,
    small_giant,
)


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

    seen = observe_frames(simulation, round(duration * fps), observe)
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

    seen = observe_frames(simulation, frames, observe)
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
