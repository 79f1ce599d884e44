"""The writer of the USD cache of a run: which particles and meshes go to which prim."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from melp_warp.program.writers import Moment, all_regions, mesh_prims, rims_of
from melp_warp.usd.cache import CacheWriter
from melp_warp.usd.reading import store_floors
from melp_warp.usd.schema import DROPS, FREE_RIMS, RIM_CURVES

if TYPE_CHECKING:
    from melp_warp.program.plan import Plan
    from melp_warp.simulation import Simulation


class UsdWriter:
    """Writes a run as USD, see `CacheWriter`. A `melp_warp.program.writers.Writer`."""

    def open(self, folder: Path, plan: Plan, simulation: Simulation, there: tuple[int, int] | None) -> None:
        """Write manifest and root."""
        shown = "l" if simulation.has_l and plan.export != "e" else "e"
        self._sets = {"Film": shown, **({"FilmE": "e"} if plan.export in ("e", "both") else {})}
        if plan.scene.bursts:
            self._sets |= {FREE_RIMS: "rims", RIM_CURVES: "rim_curves", DROPS: "drops"}
        self._sets |= {one.name: one.name for one in plan.scene.sets}
        metadata = {
            "scene": plan.name,
            "seed": plan.scene.seed,
            "device": plan.device,
            "particles": self._sets,
            "parameters": {key: "auto" if value is None else value for key, value in plan.parameters.items()},
        }
        if plan.scene.slow_motion > 1.0:
            slow = {"factor": plan.scene.slow_motion, "from": plan.scene.slow_from}
            ends = {} if plan.scene.slow_until is None else {"until": plan.scene.slow_until}
            metadata["slowMotion"] = slow | ends
        origin = simulation.particles(shown).origin
        floors = [wall for wall in getattr(plan.scene.shape, "walls", ()) if not wall.pops]
        metadata |= store_floors([(np.subtract(wall.point, origin), wall.normal) for wall in floors])
        prims = [*self._sets, *(mesh_prims(all_regions(plan), plan.whole) if plan.mesh else [])]
        packed = [prim for prim, which in self._sets.items() if which == "l" and not plan.full]
        rims = rims_of(plan, origin)
        self._cache = CacheWriter(
            folder,
            plan.scene.fps,
            metadata,
            prims,
            origin=origin,
            rims=rims,
            packed=packed,
            carried=plan.scene.shown,
            there=there,
        )

    def write(self, moment: Moment) -> Mapping[str, str]:
        """Write a frame; SHA-256 of its file, the root and the manifest, by their paths in the folder."""
        prims = {prim: moment.particles(which) for prim, which in self._sets.items()}
        return self._cache.write(moment.number, prims | moment.meshes)

    def close(self) -> None:
        """Nothing is left to do: the cache is complete after every frame."""
