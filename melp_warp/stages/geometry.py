"""Stage 2 on the host: frames, fits, curvature, areas (Algorithm 2)."""

from __future__ import annotations

import warp as wp

from melp_warp.device.launch import copy
from melp_warp.kernels import cells as kc
from melp_warp.kernels import gas as kv
from melp_warp.kernels import geometry as kg
from melp_warp.kernels.mls import Quadric
from melp_warp.kernels.neighbors import Neighbors
from melp_warp.stages.film import Film
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.state import State

RIM_WEIGHT = 2.0
"""Area of a boundary particle in the pair weights, in squared spacings.

Beyond a pinned rim the film moves against the film inside, x_b = -x_mirror, where the operators hold x_b = 0: a pair
across the rim is about twice as stiff. With 1 a large step of the implicit membrane is unstable at the rim.
"""


BLUR = {"mls": 0.15770, "sph": 0.12077}
"""Error of the discrete curvature of a smooth surface over h^2 lap_s kappa, h = r/3, on even E.

For a height rho^4 the fit has <rho^6>/<rho^4> in place of the square of the support, <> the integral with W over the
plane, and the SPH Laplacian <rho^4>'/<rho^2>' with |W'|/rho: a sixteenth of these for the quintic spline.
"""


class Geometry:
    """The surface as E see it.

    Attributes:
        surface: [n_e] quadratic fits.
        gradient: [pairs] surface-gradient weights.
        inner_gradient: [pairs] the same over E alone (another array only where there is a rim).
        weight: [pairs] a_i a_j K_ij.
        gain: [n_e] what fluxes of (14) count times beside a rim, with the midpoint rule; None elsewhere.
        cell: [n_e] Voronoi areas, m^2.
        area: [n_e] control areas, m^2.
        density: [n_e] number density with boundary particles, 1/m^2.
        near: [pairs] W of each pair of E where they were at the last `update`, 1/m^2; room for such weights between
            the move of E and the next one.
        kappa: [n_e] sum of principal curvatures at the place last asked for, 1/m.
        before: [n] normals by which frames are turned outward, where those of E themselves do not do; else None.
        star, share: empty and None; foams have them (`FoamGeometry`).
    """

    before: wp.array | None = None
    share: wp.array | None = None

    needs = ("lists",)
    kernels = ("geometry", "cells", "gas")

    def __init__(self, film: Film, state: State, lists: NeighborLists):
        self.film, self.state, self.lists = film, state, lists
        pairs = lists.ee.rows.index.shape[0]
        self.surface = film.zeros(film.n_e, Quadric)
        self.gradient = film.zeros(pairs, wp.vec3)
        self.inner_gradient = film.zeros(pairs, wp.vec3) if film.features.rim else self.gradient
        self.weight, self.near = film.zeros(pairs), film.zeros(pairs)
        self.gain = film.zeros(film.n_e) if film.features.rim and film.numerics.flow == "midpoint" else None
        self.cell, self.area, self.density, self._inner, self.kappa = (film.zeros(film.n_e) for _ in range(5))
        self._flux, self._bulge = film.zeros(film.n_e, wp.vec3), film.zeros(film.n_e)
        self._volume = film.parts(wp.vec2d)
        self._steepening = film.zeros(film.n_e, wp.vec3) if film.features.floats else None
        self.star, self._found = Neighbors(), None

    def update(self) -> None:
        """Frames, fits and gradient weights, densities, areas and the volume at the present positions."""
        film, e, rows, memory = self.film, self.state.e, self.lists.ee.rows, self.state.memory
        copy(memory.place, e.x)
        copy(memory.facing, e.normal)
        film.launch_e(kg.orient_frames_e, [e.x, self.before, rows, film.r], [e.normal])
        film.launch_e(kg.fit_surface_e, [e.x, rows, film.r], [e.normal, self.surface, self.kappa, self.gradient])
        if film.features.closed:
            inputs = [self.kappa, rows, self.gradient, film.n_e, film.r]
            film.launch_e(kg.sharpen_normal_e, inputs, [e.normal, self._steepening])
        if film.features.rim:
            film.launch_e(kg.fit_inner_gradient_e, [e.x, self.surface, rows, film.r, film.n_e], [self.inner_gradient])
        self.update_density()
        film.launch_e(
            kc.voronoi_cell_e,
            [e.x, e.normal, self.surface, self._steepening, rows, film.r],
            [self.cell, self._flux, self._bulge, self.star, self._found],
        )
        film.launch_e(kc.control_area_e, [self.cell, self._inner, self.near, rows, film.r, film.n_e], [self.area])
        self._weigh_pairs()
        self.measure_volume()

    def again(self) -> None:
        """What the last `update` found, from where E were then; the state stays as it is."""
        e, gas, memory = self.state.e, self.state.gas, self.state.memory
        kept = [(array, wp.clone(array)) for array in (e.x, e.normal, gas)]
        copy(e.x, memory.place)
        copy(e.normal, memory.facing)
        self.update()
        if memory.area is not None:
            self.set_area(memory.area)
        for array, values in kept:
            copy(array, values)

    def set_area(self, area: wp.array) -> None:
        """Take control areas found otherwise, for a film whose E stay where they are."""
        copy(self.state.memory.area, area)
        copy(self.area, area)
        copy(self.cell, area)
        self._weigh_pairs()
        self.measure_volume()

    def _weigh_pairs(self) -> None:
        film = self.film
        film.launch_e(
            kg.pair_weights_e,
            [self.state.e.x, self.area, self.lists.ee.rows, film.r, film.n_e, RIM_WEIGHT * film.spacing**2],
            [self.weight],
        )
        if self.gain is not None:
            film.launch_e(kg.rim_gain_e, [self.weight, self.lists.ee.rows, film.n_e], [self.gain])

    def blur(self, operator: str) -> float:
        """`BLUR` of an operator, m^2."""
        return BLUR[operator] * (self.film.r / 3.0) ** 2

    def measure_volume(self) -> None:
        """Enclosed volume (11) and area into the gas slots, over the Voronoi cells."""
        film, e = self.film, self.state.e
        film.launch_parts(kv.volume_chunks, [e.x, self.cell, self._flux, self._bulge, film.first], [self._volume])
        film.launch_regions(kv.store_volume_r, [self._volume], [self.state.gas])

    def update_density(self) -> None:
        """Number density (9) at the present positions."""
        film, e = self.film, self.state.e
        film.launch_e(kg.density_e, [e.x, self.lists.ee.rows, film.r, film.n_e], [self.near, self.density, self._inner])

    def curvature(self, x: wp.array) -> wp.array:
        """Curvature of the surface through the points x, by the operator the scene chose. [n_e], 1/m.

        It has the error blur lap_s kappa, for which `Membrane` makes up. The explicit scheme, which cannot, takes the
        paper's fits: on a sphere their quartic part has the opposite sign.
        """
        film, normal, rows = self.film, self.state.e.normal, self.lists.ee.rows
        if film.numerics.curvature == "mls":
            film.launch_e(kg.curvature_mls_e, [x, normal, rows, film.r, not film.features.explicit], [self.kappa])
        else:
            film.launch_e(
                kg.curvature_sph_e, [x, normal, self.area, rows, film.r, film.n_e, film.spacing**2], [self.kappa]
            )
        return self.kappa
