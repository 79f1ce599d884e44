"""What a line of a run's log says of a simulation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import warp as wp

from melp_warp.kernels import diagnostics as kd

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation


def line_of(sim: Simulation) -> dict:
    """Everything worth a line of the run's log; plain numbers (reads back)."""
    film, state, stepper = sim.film, sim.state, sim.stepper
    if sim.gone:
        return _line_of_nothing(sim)
    stepper.settle()
    stepper.fields.update()
    sums = _sums(sim)
    gas = state.gas.numpy()
    closed = film.features.closed
    result = {
        "frame": state.frame,
        "time": state.time,
        "dt": sim.last_dt,
        "substeps": sim.substeps,
        "solvers": stepper.report_solves(),
        "e_count": film.n_e,
        "l_count": film.n_l,
        "area": float(gas[:, 4].sum()),
        "volume": float(gas[:, 0].sum()) if closed else None,
        "pressure": float(gas[0, 1]) if closed else None,
        "e_spread": 0.0,
        **stepper.report(),
        **(_border(sim) if film.features.collects else {}),
        **(sim.burst.diagnostics() if sim.burst is not None else {}),
        "mass": sums[0],
        "surfactant": sums[1],
        **_totals(sim),
        "momentum": sums[2:5].tolist(),
        "kinetic_energy": sums[5],
        "surface_energy": _surface_energy(sim),
        "max_speed": math.sqrt(sums[6]),
        **_thickness(sums),
        "lost": len(stepper.lists.strays),
        "notices": dict(sim.notices.of_frame),
        **({"budget": sim.ledger.line()} if sim.ledger is not None else {}),
        "wall_ms": {name: 1e3 * seconds for name, seconds in stepper.wall.items() if seconds > 0.0},
    }
    return {k: float(v) if isinstance(v, np.floating) else v for k, v in result.items()}


def _line_of_nothing(sim: Simulation) -> dict:
    """The same keys once the last film has popped: sums are 0, and what has no value is None."""
    return {
        "frame": sim.frame,
        "time": sim.time,
        "dt": sim.last_dt,
        "substeps": sim.substeps,
        "solvers": {},
        **dict.fromkeys(("e_count", "l_count"), 0),
        **dict.fromkeys(("area", "volume"), 0.0),
        "pressure": None,
        **{name: [] for name in ("regions", "volumes", "pressures", "gas")},
        "covered": None,
        "spilled": sim.spilled,
        **(_border(sim) if sim.state.border is not None else {}),
        **(sim.burst.diagnostics() if sim.burst is not None else {}),
        **dict.fromkeys(("mass", "surfactant"), 0.0),
        **_totals(sim),
        "momentum": [0.0, 0.0, 0.0],
        **dict.fromkeys(("kinetic_energy", "surface_energy", "max_speed"), 0.0),
        **dict.fromkeys(("thickness_min", "thickness_mean", "thickness_max", "thickness_std"), None),
        "e_spread": 0.0,
        "lost": 0,
        "notices": dict(sim.notices.of_frame),
        **({"budget": sim.ledger.line()} if sim.ledger is not None else {}),
        "wall_ms": {},
    }


def _totals(sim: Simulation) -> dict:
    """All there is of what the scene declares; nothing where it declares none."""
    names, state = [one.name for one in sim.scene.carried], sim.state
    if not names:
        return {}
    if sim.gone:
        totals = {name: float(state.d.more[name].numpy().sum(dtype=np.float64)) if state.d else 0.0 for name in names}
    else:
        totals = {name: sim.stepper.carriage.total(name) for name in names}
    left = {"carried_left": dict(state.course.left)} if any(state.course.left.values()) else {}
    return {"carried": totals, **left}


def _thickness(sums: np.ndarray) -> dict:
    """Thickness in nm; None where the rim has collected all liquid."""
    names = [f"thickness_{name}" for name in ("min", "mean", "max", "std")]
    if sums[10] == 0.0:
        return dict.fromkeys(names)
    mean, square = sums[9] / sums[10], sums[11] / sums[10]
    values = (sums[7], mean, sums[8], math.sqrt(max(square - mean**2, 0.0)))
    return {name: 1e9 * value for name, value in zip(names, values, strict=True)}


def _border(sim: Simulation) -> dict:
    """Liquid (kg) and surfactant (mol) that the rim has collected, momentum that it has taken (kg m/s)."""
    border = sim.state.border.numpy().tolist()
    return {"border_mass": border[0], "border_surfactant": border[1], "rim_impulse": border[2:5]}


def _sums(sim: Simulation) -> np.ndarray:
    film, state = sim.film, sim.state
    if sim.burst is not None and sim.burst.torn:
        return sim.burst.sums()
    if sim.has_l:
        lag = state.l
        arrays = [lag.mass, lag.surfactant, lag.u, lag.v, lag.eta, film.material.density, film.n_l]
    else:
        e = state.e
        arrays = [e.mass, e.surfactant, e.u, e.u, sim.stepper.fields.eta, film.material.density, film.n_e]
    summary = film.parts(kd.vec12d)
    film.launch_parts(kd.summarize_chunks, arrays, [summary])
    parts = summary.numpy()
    total = parts.sum(axis=0)
    total[6], total[7], total[8] = parts[:, 6].max(), parts[:, 7].min(), parts[:, 8].max()
    return total


def _surface_energy(sim: Simulation) -> float:
    film, s = sim.film, sim.stepper
    cover, energy = s.membrane.cover if s.membrane is not None else None, film.parts(wp.float64)
    film.launch_parts(
        kd.energy_chunks,
        [s.geometry.area, s.fields.gamma, sim.state.e.region, film.tension, film.slope, cover, film.n_e],
        [energy],
    )
    return float(energy.numpy().sum())
