"""What a run writes its frames with: the USD cache, and what is named on the command line (docs/writers.md)."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import numpy as np

from melp_warp.errors import SCENE_FILE, InputError, in_a_line, require

if TYPE_CHECKING:
    from melp_warp.frame import MeshFrame, ParticleFrame, WholeFrame
    from melp_warp.program.plan import Plan
    from melp_warp.simulation import Simulation

USD = "usd"
WRITERS = {USD: "melp_warp.usd.writer:UsdWriter"}
"""Writers by name. That of USD writes in every run."""


class Writer(Protocol):
    """Writes the frames of a run, one after the other, as they are made.

    What it raises ends the run, in a line.
    """

    def open(self, folder: Path, plan: Plan, simulation: Simulation, there: tuple[int, int] | None) -> None:
        """Begin, before the first frame.

        Args:
            folder: where to write; it is there.
            plan: the run: its scene, its name, its parameters, what is to be exported.
            simulation: in the state that it starts from.
            there: numbers of the first and the last frame that a run that goes on has already; what was written of
                later ones is to be removed. None for a new run.
        """

    def write(self, moment: Moment) -> Mapping[str, str] | None:
        """Write a frame: whole, or not at all. The cache's returns the checksums of its files."""

    def close(self) -> None:
        """End, after the last frame, and where a run ends early."""


def find_writer(name: str) -> type[Writer]:
    """A writer by its name, as "MODULE:CLASS" or as "FILE.py:CLASS".

    Raises:
        InputError: there is none, or it is no writer.
    """
    home, _, kind = WRITERS.get(name, name).rpartition(":")
    require(
        bool(home) and kind.isidentifier(), "--writer", name, f"{', '.join(WRITERS)}, MODULE:CLASS or FILE.py:CLASS"
    )
    try:
        module = _import_file(Path(home)) if home.endswith(".py") else importlib.import_module(home)
    except Exception as error:
        raise InputError(f"--writer {name}: {in_a_line(error)}") from error
    found = getattr(module, kind, None)
    lacking = [verb for verb in ("open", "write", "close") if not callable(getattr(found, verb, None))]
    require(isinstance(found, type) and not lacking, "--writer", name, "a class with open, write and close")
    return found


def find_writers(names: str) -> list[_Extra]:
    """Writers besides that of the cache, from "NAME;NAME".

    Raises:
        InputError: one of them is none, or is given twice.
    """
    given = [name for name in names.split(";") if name]
    made = [_Extra(name, find_writer(name)()) for name in given]
    folders = [one.folder for one in made]
    require(len(set(folders)) == len(folders) and USD not in given, "--writer", names, f"each once, and not {USD}")
    return made


class _Extra:
    """A writer besides that of the cache, with a folder of its own; what it raises is told as its fault."""

    def __init__(self, name: str, writer: Writer):
        self.name, self.folder, self._writer = name, type(writer).__name__, writer

    def open(self, folder: Path, plan: Plan, simulation: Simulation, there: tuple[int, int] | None) -> None:
        own = folder / self.folder
        own.mkdir(parents=True, exist_ok=True)
        self._call(self._writer.open, own, plan, simulation, there)

    def write(self, moment: Moment) -> None:
        self._call(self._writer.write, moment)

    def close(self) -> None:
        self._call(self._writer.close)

    def _call(self, verb: Callable, *given: object) -> None:
        try:
            verb(*given)
        except InputError:
            raise
        except Exception as error:
            raise InputError(f"--writer {self.name}: {verb.__name__}: {in_a_line(error)}") from error


def _import_file(path: Path) -> object:
    name = f"{SCENE_FILE}writer_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


class Moment:
    """A frame of a run as writers see it. What nobody asks for is not made.

    Args:
        plan: the run.
        simulation: after the frame.

    Attributes:
        number: of the frame, among all frames of the cache.
        simulation: all else there is to know, such as `diagnostics()`.
    """

    def __init__(self, plan: Plan, simulation: Simulation):
        self.number, self.simulation = plan.first + simulation.frame, simulation
        self._plan, self._tempo = plan, plan.scene.tempo(simulation.frame)
        self._made: dict[str, ParticleFrame] = {}
        self._shown: dict[str, ParticleFrame] = {}

    def particles(self, which: str) -> ParticleFrame:
        """L ("l"), E ("e"), free rims ("rims", as "rim_curves") or drops ("drops"); velocities are of what is shown."""
        if which not in self._shown:
            self._shown[which] = self._slowed(self._particles(which))
        return self._shown[which]

    @property
    def meshes(self) -> dict[str, MeshFrame | WholeFrame]:
        """The meshes that the run is to write, by their names in the cache."""
        return self._surfaces[0]

    @property
    def problems(self) -> list[str]:
        """What could not be closed of the meshes."""
        return self._surfaces[1]

    @property
    def empty(self) -> bool:
        """Whether none of what was asked for has any particles."""
        return not any(len(frame.points) for frame in self._made.values())

    @cached_property
    def _surfaces(self) -> tuple[dict[str, MeshFrame | WholeFrame], list[str]]:
        from melp_warp.usd.schema import frame_kind

        plan = self._plan
        if not plan.mesh:
            return {}, []
        e = self._particles("e")
        lagrangian = self._particles("l") if self.simulation.has_l else None
        beads = self._particles("rims") if plan.scene.bursts else None
        rims = rims_of(plan, e.origin)
        made, problems = make_surfaces(e, lagrangian, rims, plan.triangles, plan.whole, beads)
        prims = mesh_prims(all_regions(plan), plan.whole)
        names = list(plan.scene.shown)
        return {p: self._slowed(made.get(p) or frame_kind(p).empty(e.origin, names)) for p in prims}, problems

    def _particles(self, which: str) -> ParticleFrame:
        if which not in self._made:
            self._made[which] = self.simulation.particles(which)
        return self._made[which]

    def _slowed(self, frame):
        """The frame with the velocities of slow motion: a second of what is shown."""
        if self._tempo == 1.0:
            return frame
        return replace(frame, velocities=frame.velocities * np.float32(self._tempo))


def rims_of(plan: Plan, origin: Sequence[float]) -> list[np.ndarray]:
    """Points along each wire that holds the film, from `origin`, m."""
    return [rim - np.array(origin) for rim in plan.scene.shape.edges()]


def all_regions(plan: Plan) -> range:
    """Regions that a scene has at any time, by the numbers of its bubbles."""
    return range(len(getattr(plan.scene.shape, "bubbles", (None,))))


def mesh_prims(regions: Sequence[int], whole: bool) -> list[str]:
    """Names of the meshes of these regions from /World."""
    from melp_warp.usd.schema import WHOLE, surface_prim

    return [WHOLE] if whole else [surface_prim(region) for region in regions]


def make_surfaces(
    e: ParticleFrame,
    lagrangian: ParticleFrame | None,
    rims: Sequence,
    triangles: int | None,
    whole: bool,
    beads: ParticleFrame | None,
) -> tuple[dict, list[str]]:
    """The meshes of a frame by prim, with what the particles carry, and what could not be closed."""
    from melp_warp.mesh.outline import mesh_torn
    from melp_warp.mesh.shade import shade
    from melp_warp.mesh.whole import make_whole
    from melp_warp.usd.schema import WHOLE, surface_prim

    if whole:
        mesh, problems = make_whole(e, lagrangian, rims, triangles)
        shade(mesh, 0, lagrangian or e)
        return {WHOLE: mesh}, problems
    made, problems = mesh_torn(e, lagrangian, rims, beads, triangles)
    for region, mesh in made.items():
        shade(mesh, region, lagrangian or e)
    return {surface_prim(region): mesh for region, mesh in made.items()}, problems
