"""What a scene requires: derived from it, never set by hand. A stage that is off is not made."""

from __future__ import annotations

from dataclasses import dataclass

from melp_warp.carried import Carried
from melp_warp.cluster import Cluster
from melp_warp.particle_set import ParticleSet
from melp_warp.scene import Scene
from melp_warp.stage import Stage


@dataclass(frozen=True)
class Features:
    """Which stages a scene needs.

    Attributes:
        closed: the film encloses gas.
        moving: the surface moves (normal dynamics, E advance and redistribution).
        lagrangian: there are L: transfers, tangential dynamics, L advance.
        rim: there are boundary particles.
        collects: the rim takes momentum from the L, and liquid that nothing holds off it.
        marangoni: there is surfactant, so (14) takes part.
        viscous: in-plane viscosity.
        recoils: the film is closed and its uneven tension pushes liquid along it, so it moves the other way.
        air: the air's added mass takes part in the normal motion.
        dragged: the air's drag holds a closed film back as a whole.
        exchanges: liquid crosses between films that touch.
        foam: there are several regions, or walls, to touch.
        single: E are all particles there are, and carry the film along (`SingleLayer`).
        circulation: L carry circulation.
        mixes: L exchange what they hold where the flow shears them.
        explicit: the normal motion is stepped by the present force over the mass.
        budget: the energy budget is kept, in a foam up to when a film bursts; a single layer has none, nor has a single
            film that may burst or whose gas comes and goes.
        bursts: the film may get holes.
        holed: a single film has got them: what it enclosed, and the air around it, count no more.
        carried: what L carry besides liquid and surfactant.
        stages, sets: parts of the step and particles of the scene's own.
    """

    closed: bool
    moving: bool
    lagrangian: bool
    rim: bool
    collects: bool
    marangoni: bool
    viscous: bool
    recoils: bool
    air: bool
    dragged: bool
    exchanges: bool
    foam: bool
    single: bool
    circulation: bool
    mixes: bool
    explicit: bool
    budget: bool
    bursts: bool
    holed: bool
    carried: tuple[Carried, ...]
    stages: tuple[type[Stage], ...]
    sets: tuple[ParticleSet, ...]

    @classmethod
    def of(cls, scene: Scene, holed: bool = False) -> Features:
        """Derive the features of a scene, of a film that is whole or `holed`."""
        lagrangian = scene.l_per_e > 0
        moving = not scene.shape.flat
        single = scene.numerics.layers == 1
        marangoni = (lagrangian or single) and scene.material.surfactant > 0.0
        foam = isinstance(scene.shape, Cluster)
        holed = holed and not foam  # a foam's other bubbles stay as they are
        air = moving and scene.surroundings.air == "added_mass" and not holed
        closed = scene.shape.closed and not holed
        return cls(
            closed=closed,
            moving=moving,
            lagrangian=lagrangian,
            rim=not scene.shape.closed,
            collects=lagrangian and not scene.shape.closed,
            marangoni=marangoni,
            recoils=marangoni and closed and not foam,
            viscous=(lagrangian or single) and scene.material.viscosity > 0.0,
            exchanges=lagrangian and foam and scene.numerics.exchange > 0.0,
            foam=foam,
            single=single,
            circulation=lagrangian and scene.numerics.carrier == "circulation",
            mixes=lagrangian and scene.numerics.mixing > 0.0,
            explicit=single or (scene.numerics.scheme == "explicit" and not foam),
            air=air,
            dragged=air and closed and scene.surroundings.air_drag > 0.0,
            budget=scene.budget and not (single or (scene.bursts and not foam) or scene.breathes),
            bursts=scene.bursts,
            holed=holed,
            carried=scene.carried,
            stages=scene.stages,
            sets=scene.sets,
        )

    @property
    def tears(self) -> bool:
        """Whether particles know of rims that have passed them: in a foam that may burst always."""
        return self.holed or (self.foam and self.bursts)

    @property
    def air_waves(self) -> bool:
        """Whether the air's inertia is a function of the surface Laplacian, see `melp_warp.stages.air`."""
        return self.air and not (self.foam or self.explicit)

    def kernels(self) -> list[str]:
        """Files of `melp_warp.kernels` whose kernels a run launches."""
        needed = {
            **dict.fromkeys(("neighbors", "geometry", "cells", "gas", "diagnostics", "surfactant", "transfer"), True),
            "forces": True,
            "barrier": True,
            "linear": self.moving or self.circulation or (self.lagrangian and (self.marangoni or self.viscous)),
            "advance": True,
            "redistribute": self.moving,
            "membrane": self.moving and not self.foam,
            "motion": self.moving,
            "drag": self.dragged,
            "air_range": self.air and self.closed and not (self.foam or self.explicit),
            "l_lists": self.lagrangian,
            "circulation": self.circulation or bool(self.carried),
            "carried": bool(self.carried),
            "mixing": self.mixes,
            "boundary": self.rim,
            "single_layer": self.single,
            "foam": self.foam,
            "contact": self.foam,
            "line_forces": self.foam,
            "exchange": self.foam,
            "regions": self.foam,
            "budget": self.budget,
            "free_rim": self.bursts,
        }
        return [name for name, wanted in needed.items() if wanted]
