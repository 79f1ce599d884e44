"""What tests/physics/test_double.py compares: the same runs in either precision, one process each.

MELP_WARP_PRECISION=64 python -m tests.precision_runs FOLDER     writes FOLDER/found.npz, checkpoint.npz and cache/
"""

import pkgutil
import sys
from pathlib import Path

import numpy as np
import warp as wp

from melp_warp import cli, kernels
from melp_warp.device.launch import compile_kernels
from melp_warp.registry import load_scene
from melp_warp.scene import Scene
from melp_warp.simulation import Simulation
from melp_warp.study import rounding as precision
from melp_warp.study import validation as v

STEPS = 10
RUNS = {
    # scene: E, L per E, s
    "giant_bubble": (400, 4, 1.0 / 120.0),
    "oscillating_bubble": (400, 4, 1.0 / 480.0),
    "drainage": (300, 4, 1.0 / 120.0),
    "double_bubble": (600, 2, 1.0 / 960.0),
}


def scene(name: str) -> Scene:
    """A scene made small, with its solves to 1e-6: a looser one may stop an iteration apart."""
    script, (e_count, l_per_e, _) = load_scene(name), RUNS[name]
    return script.build(script.parameters.values({"e_count": e_count, "l_per_e": l_per_e, "tolerance": 1e-6}))


def run(name: str) -> tuple[Simulation, dict]:
    """A run of `STEPS` steps.

    Returns:
        The simulation; positions (m) and velocities (m/s) of E, how far E moved at most, pressures (Pa), and relative
        errors of what E hold against the L they have it from and of p V against n R T.
    """
    simulation = Simulation(scene(name))
    e, lag = simulation.state.e, simulation.state.l
    start = e.x.numpy().copy()
    v.steps(simulation, STEPS, RUNS[name][2])
    gas = simulation.state.gas.numpy().copy()
    found = {
        "x": e.x.numpy().copy(),
        "u": e.u.numpy().copy(),
        "pressure": gas[:, 1],
        "moved": np.abs(e.x.numpy() - start).max(),
    }
    if simulation.film.features.closed:
        found["gas"] = np.abs((simulation.film.surroundings.pressure + gas[:, 1]) * gas[:, 0] / gas[:, 2] - 1.0).max()
    simulation.stepper.transfer.l_to_e()
    given = lag.mass.numpy().astype(np.float64)[:, None] * lag.u.numpy()
    held = simulation.stepper.transfer.momentum.numpy().astype(np.float64)
    found["momentum"] = np.linalg.norm(held.sum(axis=0) - given.sum(axis=0)) / np.linalg.norm(given, axis=1).sum()
    for name in ("mass", "surfactant"):
        held, given = (float(getattr(a, name).numpy().sum(dtype=np.float64)) for a in (e, lag))
        found[name] = abs(held - given) / max(given, 1e-30)
    return simulation, found


def all_runs() -> dict:
    """Everything that is compared, by name."""
    found = {f"{name}.{key}": value for name in RUNS for key, value in run(name)[1].items()}
    found["rest.volume"] = v.resting_bubble(e_count=1200, dt=1e-3, count=20)["cost"]["volume_error"]
    simulation = Simulation(v.small_giant(300, 4))
    v.steps(simulation, 2, 1.0 / 120.0)
    found["curvature"] = precision.curvature_error(simulation)
    found["gathered"] = precision.transfer_error(simulation)
    return found


def main(folder: Path) -> None:
    """Compile every kernel file, make all runs, a checkpoint and a cache."""
    wp.config.log_level = wp.LOG_WARNING
    compile_kernels([module.name for module in pkgutil.iter_modules(kernels.__path__)], "cpu")
    np.savez(folder / "found.npz", **all_runs())
    simulation, _ = run("giant_bubble")
    simulation.save_checkpoint(folder / "checkpoint.npz")
    options = ["--device", "cpu", "--set", "e_count=200", "--set", "frames=2", "--out", str(folder / "cache")]
    assert cli.main(["run", "drainage", *options]) == 0


if __name__ == "__main__":
    main(Path(sys.argv[1]))
