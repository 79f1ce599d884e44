"""What a simulation shows of its particles, as NumPy arrays in the units of the cache."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from melp_warp.frame import BLACK_FILM, CurveFrame, ParticleFrame, beads

if TYPE_CHECKING:
    from melp_warp.simulation import Simulation


def particles_of(sim: Simulation, which: str) -> ParticleFrame | CurveFrame:
    """What `Simulation.particles` gives."""
    if which == "rim_curves":
        return sim.burst.curves()
    if which in ("rims", "drops"):
        return sim.burst.particles(which)
    if which in sim.state.sets:
        return _set(sim, which)
    if sim.gone:
        return ParticleFrame.empty(tuple(sim.origin.tolist()), list(sim.scene.shown))
    n = sim.film.n_l if which == "l" else sim.film.n_e
    if which == "l":
        lag = sim.state.l
        x, v, normal, eta = (a.numpy() for a in (lag.x, lag.v, lag.normal, lag.eta))
        area = lag.mass.numpy() / (sim.scene.material.density * eta)
    else:
        sim.stepper.fields.update()
        e = sim.state.e
        x, v, normal = e.x.numpy()[:n], sim.stepper.carrier.velocity_of_e(), e.normal.numpy()[:n]
        eta, area = sim.stepper.fields.eta.numpy(), sim.stepper.geometry.area.numpy()
    source = sim.state.l if which == "l" else sim.state.e
    region = np.array(sim.film.labels, dtype=np.int32)[source.region.numpy()[:n]]
    ids = sim.state.ids[which]
    order = np.argsort(ids, kind="stable")
    if source.behind is not None or (which == "l" and sim.film.features.collects):
        there = area > 0.0  # a wire or a free rim has collected the liquid of the others
        if source.behind is not None:
            there &= source.behind.numpy() == 0
        order = order[there[order]]
    thickness = (eta * 1e9).astype(np.float32)[order]
    return ParticleFrame(
        points=(x + (sim.state.origin - sim.origin)).astype(np.float32)[order],
        velocities=v.astype(np.float32)[order],
        ids=ids[order].astype(np.int64),
        widths=np.sqrt(4.0 / np.pi * area).astype(np.float32)[order],
        normals=normal.astype(np.float32)[order],
        thickness=thickness,
        region=region[order],
        black_film=(thickness <= BLACK_FILM).astype(np.int32),
        origin=tuple(sim.origin.tolist()),
        carried={name: held.astype(np.float32)[order] for name, held in _carried(sim, which, area).items()},
    )


def _set(sim: Simulation, name: str) -> ParticleFrame:
    """A set of the scene's own; as of drops, `thickness` is the diameter."""
    held = {key: array.numpy() for key, array in sim.state.sets[name].items()}
    width = next(one.width for one in sim.scene.sets if one.name == name)
    count, x = len(held["x"]), held["x"] + (sim.state.origin - sim.origin)
    return beads(x, held.get("u", 0.0 * x), np.full(count, width), np.tile([0.0, 1.0, 0.0], (count, 1)), sim.origin)


def _carried(sim: Simulation, which: str, area: np.ndarray) -> dict[str, np.ndarray]:
    """What the scene declares or wants shown, of particles with these areas (m^2), in its units."""
    scene, state, stepper = sim.scene, sim.state, sim.stepper
    if not scene.shown:
        return {}
    if which == "l":
        held, mass = {**state.carried, "circulation": state.l.circulation}, state.l.mass.numpy()
    else:
        stepper.transfer.normalize()
        held = {one.name: stepper.carriage.gather(one.name) for one in scene.carried}
        mass = stepper.carriage.gather_mass().numpy() if scene.carried else None
        if "circulation" in scene.shown:
            stepper.circulation.gather()
            held["circulation"] = stepper.circulation.carried
    found = {one.name: one.shown(held[one.name].numpy(), area, mass) for one in scene.carried}
    return found | {name: held[name].numpy() for name in scene.shown if name not in found}
