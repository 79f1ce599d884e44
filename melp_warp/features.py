"""What a scene requires: derived from it, never set by hand. A stage that is off is not made."""

from __future__ import annotations

from dataclasses import dataclass

from melp_warp.carried import Carried
from melp_warp.cluster import Cluster
from melp_warp.particle_set import ParticleSet
from melp_warp.scene import Scene
from melp_warp.stage import Stage

COARSE_FROM = 10_000
"""E of a bubble or film from which on solves whose iterations grow with their number get coarser levels."""


@dataclass(frozen=True)
class Features:
    """Which parts a scene needs; `melp_warp.stepping.parts` finds them by the names given here.

    Attributes:
        carrier: of the flow along the film: "none", "two_layers" (L), "circulation" (L, which carry it besides) or
            "single_layer" (E are all particles there are).
        normal: motion of the surface: "none", "membrane", or "foam" where there are several regions or walls to touch.
        response: of a membrane to a load: "film", "air" with its added mass, "explicit" by the present force over the
            mass, or "lumped", the same of a single layer; "none" for others.
        flow: how the flow along the film is stepped: "midpoint", "backward_euler" or, of a single layer, "explicit".
        closed: the film encloses gas.
        floats: it is a single film that does and moves freely as a whole.
        rim: there are boundary particles.
        collects: the rim takes momentum from the L, and liquid that nothing holds off it.
        marangoni: there is surfactant, so (14) takes part.
        viscous: in-plane viscosity.
        recoils: the film floats and its uneven tension pushes liquid along it, so it moves the other way.
        air: the air's added mass takes part in the normal motion.
        dragged: the air's drag holds a closed film back as a whole.
        exchanges: liquid crosses between films that touch.
        mixes: L exchange what they hold where the flow shears them.
        budget: the energy budget is kept, in a foam up to when a film bursts; a single layer has none, nor has a single
            film that may burst or whose gas comes and goes.
        bursts: the film may get holes.
        holed: a single film has got them: what it enclosed, and the air around it, count no more.
        coarse: solves that would take the more iterations the more E there are get coarser levels (stages/levels.py).
        carried: what L carry besides liquid and surfactant.
        stages, sets: parts of the step and particles of the scene's own.
    """

    carrier: str
    normal: str
    response: str
    flow: str
    closed: bool
    floats: bool
    rim: bool
    collects: bool
    marangoni: bool
    viscous: bool
    recoils: bool
    air: bool
    dragged: bool
    exchanges: bool
    mixes: bool
    budget: bool
    bursts: bool
    holed: bool
    coarse: bool
    carried: tuple[Carried, ...]
    stages: tuple[type[Stage], ...]
    sets: tuple[ParticleSet, ...]

    @classmethod
    def of(cls, scene: Scene, holed: bool = False) -> Features:
        """Derive the features of a scene, of a film that is whole or `holed`."""
        foam = isinstance(scene.shape, Cluster)
        holed = holed and not foam  # a foam's other bubbles stay as they are
        carrier, normal = _carrier(scene), _normal(scene)
        flowing, lagrangian = carrier != "none", carrier in _OF_L
        air = normal != "none" and scene.surroundings.air == "added_mass" and not holed
        closed = scene.shape.closed and not holed
        marangoni = flowing and scene.material.surfactant > 0.0
        single = carrier == "single_layer"
        return cls(
            carrier=carrier,
            normal=normal,
            response=_response(scene, air) if normal == "membrane" else "none",
            flow="explicit" if single else scene.numerics.flow,
            closed=closed,
            floats=closed and not foam,
            rim=not scene.shape.closed,
            collects=lagrangian and not scene.shape.closed,
            marangoni=marangoni,
            recoils=marangoni and closed and not foam,
            viscous=flowing and scene.material.viscosity > 0.0,
            exchanges=lagrangian and foam and scene.numerics.exchange > 0.0,
            mixes=lagrangian and scene.numerics.mixing > 0.0,
            air=air,
            dragged=air and closed and scene.surroundings.air_drag > 0.0,
            budget=scene.budget and not without_budget(scene),
            bursts=scene.bursts,
            holed=holed,
            coarse=scene.e_count >= COARSE_FROM * (len(scene.shape.bubbles) if foam else 1),
            carried=scene.carried,
            stages=scene.stages,
            sets=scene.sets,
        )

    @property
    def moving(self) -> bool:
        """Whether the surface moves: normal dynamics, E advance and redistribution."""
        return self.normal != "none"

    @property
    def lagrangian(self) -> bool:
        """Whether there are L: transfers, tangential dynamics, L advance."""
        return self.carrier in _OF_L

    @property
    def circulation(self) -> bool:
        """Whether L carry circulation."""
        return self.carrier == "circulation"

    @property
    def explicit(self) -> bool:
        """Whether the normal motion is stepped by the present force over the mass."""
        return self.response in ("explicit", "lumped")

    @property
    def tears(self) -> bool:
        """Whether particles know of rims that have passed them: in a foam that may burst always."""
        return self.holed or (self.normal == "foam" and self.bursts)

    @property
    def air_waves(self) -> bool:
        """Whether the air's inertia is a function of the surface Laplacian, see `melp_warp.stages.air`."""
        return self.response == "air"


_OF_L = ("two_layers", "circulation")


def without_budget(scene: Scene) -> str:
    """Why a scene can have no energy budget; empty where it can."""
    if scene.numerics.layers == 1:
        return "a single layer has none"
    if scene.breathes:
        return "gas comes and goes"
    if scene.bursts and not isinstance(scene.shape, Cluster):
        return "the film may burst"
    return ""


def _carrier(scene: Scene) -> str:
    if scene.numerics.layers == 1:
        return "single_layer"
    if scene.l_per_e == 0:
        return "none"
    return "circulation" if scene.numerics.carrier == "circulation" else "two_layers"


def _normal(scene: Scene) -> str:
    if scene.shape.flat:
        return "none"
    return "foam" if isinstance(scene.shape, Cluster) else "membrane"


def _response(scene: Scene, air: bool) -> str:
    if scene.numerics.layers == 1:
        return "lumped"
    if scene.numerics.scheme == "explicit":
        return "explicit"
    return "air" if air else "film"
