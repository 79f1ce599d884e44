"""What a film's step is made of: its carrier of the flow, its normal motion, and the other parts that it needs."""

from __future__ import annotations

from typing import NamedTuple

from melp_warp.features import Features
from melp_warp.stage import Stage, kernels_of
from melp_warp.stages.advance import EulerianAdvance, LagrangianAdvance
from melp_warp.stages.air_range import AirRange
from melp_warp.stages.carriage import Carriage
from melp_warp.stages.circulation import Circulation
from melp_warp.stages.drag import AirDrag
from melp_warp.stages.exchange import Exchange
from melp_warp.stages.foam import FoamMembrane
from melp_warp.stages.foam_surface import FoamGeometry, FoamLists
from melp_warp.stages.forces import Forces
from melp_warp.stages.free_rim import TornFilm
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.membrane import Membrane
from melp_warp.stages.mixing import Mixing
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.responses import AirResponse, ExplicitResponse, FilmResponse, LumpedResponse
from melp_warp.stages.rim import Rim
from melp_warp.stages.surfactant import Tangential
from melp_warp.stages.transfer import Transfer
from melp_warp.stepping.budget import Budget
from melp_warp.stepping.carriers import Carrier, CirculatingLayers, TwoLayers
from melp_warp.stepping.foam_budget import FoamBudget
from melp_warp.stepping.single_layer import SingleLayer


class NormalMotion(NamedTuple):
    """How the surface moves.

    Attributes:
        motion: what moves it; None for a film that stays where it is.
        lists: who is near whom.
        geometry: how E see the surface.
        budget: where its energy goes.
    """

    motion: type | None
    lists: type
    geometry: type
    budget: type


CARRIERS: dict[str, type[Carrier]] = {
    "none": Carrier,
    "two_layers": TwoLayers,
    "circulation": CirculatingLayers,
    "single_layer": SingleLayer,
}
"""By `Features.carrier`."""

NORMAL_MOTIONS = {
    "none": NormalMotion(None, NeighborLists, Geometry, Budget),
    "membrane": NormalMotion(Membrane, NeighborLists, Geometry, Budget),
    "foam": NormalMotion(FoamMembrane, FoamLists, FoamGeometry, FoamBudget),
}
"""By `Features.normal`."""

RESPONSES = {"film": FilmResponse, "air": AirResponse, "explicit": ExplicitResponse, "lumped": LumpedResponse}
"""By `Features.response`."""

ALWAYS = ("barrier", "diagnostics", "advance", "transfer")
"""Kernel files that any run launches from."""


def parts_of(f: Features) -> dict[str, type | None]:
    """The parts that a film needs, in the order in which they are made; None for those that it goes without.

    Each is made from the film, its state and the parts of its `needs`, by which stages find it in the stepper.
    """
    normal = NORMAL_MOTIONS[f.normal]
    wanted = {
        "lists": normal.lists,
        "geometry": normal.geometry,
        "fields": CARRIERS[f.carrier].fields,
        "edge": f.holed and TornFilm,
        "forces": Forces,
        "rim": f.rim and Rim,
        "transfer": f.lagrangian and Transfer,
        "circulation": f.circulation and Circulation,
        "carriage": f.carried and Carriage,
        "mixing": f.mixes and Mixing,
        "drag": f.dragged and AirDrag,
        "response": RESPONSES.get(f.response),
        "membrane": normal.motion,
        "air_range": f.air_waves and f.closed and AirRange,
        "tangential": f.lagrangian and Tangential,
        "e_advance": f.moving and f.carrier != "single_layer" and EulerianAdvance,
        "l_advance": f.lagrangian and LagrangianAdvance,
        "exchange": f.exchanges and Exchange,
        "budget": f.budget and not f.holed and normal.budget,
    }
    return {name: kind or None for name, kind in wanted.items()}


def stages_of(f: Features) -> list[type[Stage]]:
    """The stages of the film's step in their order, without the scene's own."""
    there = {name for name, kind in parts_of(f).items() if kind is not None}
    return [stage for stage in CARRIERS[f.carrier].stages if there.issuperset(stage.needs)]


def kernel_files(f: Features) -> list[str]:
    """Files of `melp_warp.kernels` whose kernels a run launches."""
    kinds = [*(kind for kind in parts_of(f).values() if kind is not None), *stages_of(f)]
    rims = ("free_rim",) if f.bursts else ()
    start = kernels_of(EulerianAdvance, f) if f.moving else ()  # E are evened out at first
    return sorted({*ALWAYS, *rims, *start, *(file for kind in kinds for file in kernels_of(kind, f))})
