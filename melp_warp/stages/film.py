"""What every stage of one film needs to know: sizes, support, material, the rim."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import warp as wp

from melp_warp.cluster import Wall
from melp_warp.device.launch import launch, launch_rows
from melp_warp.features import Features
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.scene_force import Force
from melp_warp.stages.air import AirModel

CONTACT_REACH = 2.5
"""Distance along the sheets within which facing E of different regions act on each other, spacings."""

THICKEST = 1e-3
"""Thickness beyond which water is no film, m: scenes do not start with it, and runs that come to it say so."""

THINNEST = 4e-9
"""Thickness of a Newton black film, m: runs that come below it say so."""

ROOM = 1.4
"""Room of a neighbour list's row over the longest one when the list is made."""

CHUNKS = 64
"""Number of parts in which the sums over a single region are taken; more regions share them, at least four each."""


def count_parts(regions: int) -> int:
    """Number of parts in which sums over particles are taken."""
    return regions * max(4, CHUNKS // regions) if regions else 0


@dataclass(frozen=True)
class RimArrays:
    """What boundary particles are held by, on the device; see `melp_warp.shapes.Rim`."""

    anchors: wp.array
    outward: wp.array
    curvature: wp.array


@dataclass(frozen=True)
class Film:
    """A film's constants, fixed until its regions change or its lists get more room.

    Attributes:
        spacing: mean E spacing dx, m.
        n_e: number of E.
        n_b: number of boundary particles.
        n_l: number of L.
        first: [regions + 1] region g holds E first[g] to first[g + 1].
        tension: [regions] sigma_0, N/m.
        labels: the scene's number of each region.
        seed: of everything random.
        walls: planes that a foam touches.
        forces: those that the scene brings along.
        air: how much air moves along, where it takes part.
        radius: radius of the sphere of the film's volume, for the air's added mass; infinite for an open film, m.
        room: room of a neighbour list's row over the longest one when the list was made.
    """

    device: wp.Device
    features: Features
    material: Material
    surroundings: Surroundings
    numerics: Numerics
    spacing: float
    n_e: int
    n_b: int
    n_l: int
    first: wp.array
    tension: wp.array
    labels: tuple[int, ...] = (0,)
    seed: int = 0
    walls: tuple[Wall, ...] = ()
    forces: tuple[Force, ...] = ()
    air: AirModel = field(default_factory=AirModel)
    rim: RimArrays | None = None
    radius: float = float("inf")
    room: float = ROOM

    @property
    def total(self) -> int:
        """E and boundary particles together."""
        return self.n_e + self.n_b

    @property
    def regions(self) -> int:
        """Number of regions."""
        return self.first.shape[0] - 1

    @property
    def r(self) -> float:
        """Kernel support radius, m."""
        return self.numerics.support * self.spacing

    @property
    def contact_reach(self) -> float:
        """Distance within which E of different regions know of each other, m."""
        return math.hypot(CONTACT_REACH, self.numerics.border) * self.spacing

    def gravity_at(self, time: float) -> wp.vec3:
        """Gravity at a time (s), m/s^2."""
        return wp.vec3(*self.surroundings.gravity_at(time))

    @property
    def height(self) -> wp.vec3:
        """Gravity that is stored as height, see `Surroundings.height`, m/s^2."""
        return wp.vec3(*self.surroundings.height)

    @property
    def stiffness(self) -> float:
        """2 R T Gamma_0/rho, m^3/s^2."""
        m = self.material
        return 2.0 * m.rt * m.surfactant / m.density

    @property
    def slope(self) -> float:
        """R T Gamma_0, N/m."""
        return self.material.rt * self.material.surfactant

    def zeros(self, n: int, dtype=wp.float32) -> wp.array:
        """A zeroed array on the film's device."""
        return wp.zeros(n, dtype=dtype, device=self.device)

    def parts(self, dtype=wp.float32) -> wp.array:
        """Room for the parts of a sum."""
        return self.zeros(count_parts(self.regions), dtype)

    def launch_e(self, kernel, inputs, outputs=()) -> None:
        """One thread an E; kernels over neighbours are shared by CPU cores."""
        launch(kernel, self.n_e, inputs, outputs, self.device)

    def launch_l(self, kernel, inputs, outputs=()) -> None:
        """One thread an L; L write their own entries alone, so CPU cores share them."""
        launch_rows(kernel, self.n_l, inputs, outputs, self.device)

    def launch_parts(self, kernel, inputs, outputs=()) -> None:
        """One thread a part of a sum."""
        launch(kernel, outputs[0].shape[0], inputs, outputs, self.device)

    def launch_regions(self, kernel, inputs, outputs=()) -> None:
        """One thread a region."""
        launch(kernel, self.regions, inputs, outputs, self.device)

    def launch_one(self, kernel, inputs, outputs=()) -> None:
        """A single thread."""
        launch(kernel, 1, inputs, outputs, self.device)
