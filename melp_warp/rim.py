"""Boundary particles on the host: the velocity and the shape of the film continued beyond its rim."""

from __future__ import annotations

from melp_warp.film import Film
from melp_warp.geometry import Geometry
from melp_warp.kernels import boundary as kb
from melp_warp.launch import launch
from melp_warp.neighbors import NeighborLists
from melp_warp.state import State


class Rim:
    """The pinned rim of an open film. Made only for films that have one."""

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry):
        self.film, self.state, self.lists, self.geometry = film, state, lists, geometry

    def mirror_velocity(self) -> None:
        """Give boundary particles the velocity of their mirror points: no motion of the rim, free slip along it."""
        film, e, rim = self.film, self.state.e, self.film.rim
        launch(
            kb.mirror_velocity_b,
            film.n_b,
            [rim.mirror, rim.outward, e.normal, e.x, self.lists.be.rows, self.lists.mirror_reach, film.n_e],
            [e.u],
            film.device,
        )

    def extend(self) -> None:
        """Let the boundary particles follow a moving film; the fits are moved with their particles and a step old."""
        film, e, rim = self.film, self.state.e, self.film.rim
        launch(
            kb.extend_film_b,
            film.n_b,
            [
                *(rim.anchors, rim.curvature, e.x, self.geometry.surface),
                *(self.lists.be.rows, self.lists.mirror_reach, film.n_e),
            ],
            [rim.mirror, e.x, e.normal],
            film.device,
        )
