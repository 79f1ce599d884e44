"""Beyond the range of the air's linear theory: it is told, and makes no energy.

A(-lap_s) is the added mass of a sphere's waves (see air.py). On a film that is far from a sphere it changes as the
surface moves, while the velocity stays: the air's energy 1/2 u A u then changes by 1/2 u A' u, which no force has done,
and so it does where E are shifted along a steep film with the velocity that they carry. The true air would push back.
Both are of the order of the slope squared, as is the error of A itself.
"""

from __future__ import annotations

import warp as wp

from melp_warp.device.launch import clear
from melp_warp.features import Features
from melp_warp.kernels import air_range as ka
from melp_warp.stages.film import Film
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.notices import Notices
from melp_warp.stages.responses import AirResponse, rational_kernels
from melp_warp.stages.state import State

SLOPE = 0.25
"""Slope beyond which the air is out of its range: root mean square of the sine of the angle between the normal and the
ray from the middle. A is then off by its square, 6 %, and more."""

TOLERANCE = 1e-3
"""Relative residual of A u; that of u A u is its square, as conjugate gradients go."""


class AirRange:
    """Keeps the air from making energy where the film is too steep for its theory. Made for a closed film in air.

    Beyond the range the energy of the normal motion, of film and air, is measured before E move and after: what it has
    grown by is taken from the normal motion. Within it nothing is measured nor changed.
    """

    needs = ("lists", "geometry", "response")

    @staticmethod
    def kernels(features: Features) -> tuple[str, ...]:
        """Files of kernels."""
        return "air_range", *rational_kernels(features)

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry, response: AirResponse):
        self.film, self.state, self.geometry = film, state, geometry
        self.solver = response.make_momentum(lists, TOLERANCE, film.numerics.max_iterations)
        self.found = film.zeros(5, wp.float64)
        self._centre = film.zeros(1, wp.vec3)
        self._middle, self._slopes, self._energy = film.parts(ka.vec4d), film.parts(wp.vec2d), film.parts(wp.float64)

    def measure(self) -> None:
        """Before E move: how steep the film is and, beyond the range, the energy of its normal motion."""
        film, e, area, n = self.film, self.state.e, self.geometry.area, self.film.n_e
        film.launch_parts(ka.centre_chunks, [e.x, area, n], [self._middle])
        film.launch_one(ka.find_centre, [self._middle], [self._centre])
        film.launch_parts(ka.slope_chunks, [e.x, e.normal, area, self._centre, n], [self._slopes])
        film.launch_one(ka.find_slope, [self._slopes], [self.found])
        self._find_energy(int(ka.BEFORE))

    def damp(self) -> None:
        """After E have moved: take from the normal motion what its energy has grown by."""
        self._find_energy(int(ka.AFTER))
        self.film.launch_one(ka.book_taken, [self.found])
        self.film.launch_e(ka.slow_air_e, [self.solver.b, self.state.e.normal, self.found], [self.state.e.u])

    def _find_energy(self, slot: int) -> None:
        film, e, solver = self.film, self.state.e, self.solver
        film.launch_e(ka.load_speed_e, [e.u, e.normal, self.state.motion, self.found, SLOPE], [solver.b])
        solver.solve()
        inputs = [solver.b, solver.x, e.mass, self.geometry.area, film.n_e]
        film.launch_parts(ka.air_energy_chunks, inputs, [self._energy])
        film.launch_one(ka.sum_energy, [self._energy, slot], [self.found])

    def remark(self, notices: Notices) -> None:
        """Note a film that was beyond the range in the frame (reads back)."""
        found = self.found.numpy()
        worst, taken = found[int(ka.WORST)], found[int(ka.TAKEN)]
        if worst > SLOPE:
            text = (
                f"slope {worst:.2g} (rms) where its linear theory goes to {SLOPE:g}: inertia of the air and frequencies"
                f" are off by about {100.0 * worst**2:.2g} %; {taken:.2g} J that it would have made are taken out"
            )
            notices.note("air beyond its range", worst, text)
        clear(self.found)
