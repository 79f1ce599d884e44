"""What the cases share: runs that are observed, fits, and what E and L hold as NumPy arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from melp_warp.material import Material
from melp_warp.program.estimate import array_bytes
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.simulation import Simulation

GRAVITY = 9.81
"""m/s^2."""


CLEAN = Material(surfactant=0.0)
"""Pure water: tension 0.0728 N/m, 400 nm."""


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


def observe_frames(simulation: Simulation, count: int, observe: Callable[[], object]) -> np.ndarray:
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


def small_giant(e_count: int, l_per_e: int, **overrides) -> Scene:
    """The scene giant_bubble with other numbers."""
    script = load_scene("giant_bubble")
    return script.build(script.parameters.values({"e_count": e_count, "l_per_e": l_per_e, **overrides}))
