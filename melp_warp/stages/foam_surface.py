"""What E of a foam see: who is near in their own region and in others, and the stars of their Voronoi cells."""

from __future__ import annotations

import warp as wp

from melp_warp.kernels import foam as kf
from melp_warp.kernels.native import CORNERS
from melp_warp.stages.film import Film
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.neighbors import NeighborLists, fixed_rows
from melp_warp.stages.state import State


class FoamLists(NeighborLists):
    """Lists that tell regions apart, and `eo`, from E to those of other regions."""

    several = True


class FoamGeometry(Geometry):
    """The surface of several regions.

    Attributes:
        star: the neighbours across the edges of each Voronoi cell.
        tie: [CORNERS n_e] w_ij of the star's pairs, symmetric: sum_j w_ij (x_j - x_i) is minus the area's gradient.
        vector: [n_e] gradient of the volume of the polyhedron of stars, m^2.
        share: [n_e] each E's share of that polyhedron's area, m^2: with it sheets press and cling. Unlike a cell, whose
            plane and fit say little in a corner, it is never more than the E around are apart.
    """

    kernels = (*Geometry.kernels, "foam")

    def __init__(self, film: Film, state: State, lists: NeighborLists):
        super().__init__(film, state, lists)
        n = film.n_e
        self.star, self.before = fixed_rows(n, CORNERS, film.device), state.memory.facing
        self._found, self.tie = (film.zeros(n * CORNERS) for _ in range(2))
        self.vector, self.share = film.zeros(n, wp.vec3), film.zeros(n)

    def update(self) -> None:
        """The same as of any film, then stars, their ties and the volume's gradient."""
        super().update()
        self.film.launch_e(kf.pair_star_e, [self.star, self._found], [self.tie])
        self.film.launch_e(kf.star_vector_e, [self.state.e.x, self.star], [self.vector, self.share])
