"""How a film answers to a load across it: with its own mass, with that of the air, explicitly."""

from __future__ import annotations

import numpy as np
import warp as wp

from melp_warp.device.launch import clear, copy
from melp_warp.device.linear import LinearOperator, RationalLaplacian, Solver
from melp_warp.device.multilevel import MultilevelRational
from melp_warp.device.scalars import Setting
from melp_warp.features import Features
from melp_warp.kernels import membrane as km
from melp_warp.stages import air
from melp_warp.stages.film import Film
from melp_warp.stages.forces import Forces
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.levels import levels_of, make_solver, solver_kernels
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.state import State

SWEEPS = 2
"""Corrections for an uneven film mass where the air takes part; each shrinks the error by |m - mean|/(m + A)."""


def _softer(bent: float, mass: float) -> float:
    """What the bend of a film takes off the matrix, as `kernels.membrane.softening`. kg/m^2."""
    return bent * max(1.0 - 8.0 * bent / mass, 0.0)


def inertial_blur(film: Film, geometry: Geometry) -> float:
    """What the inertia makes up for, m^2; nothing where that jumps at a free rim: the matrix has to stay definite."""
    return 0.0 if film.features.holed else geometry.blur(film.numerics.curvature)


class _Pair:
    """Right-hand side and solution."""

    def __init__(self, film: Film):
        self.b, self.x = film.zeros(film.n_e), film.zeros(film.n_e)


class FilmResponse:
    """Change of normal velocity under a load, (m (1 + blur lap_s) - c (lap_s + 2/R^2)) x = b, without air.

    Attributes:
        inertia: [n_e] what resists a change, kg: see `Forces.heavy`.
        left_out: [1] what of c 2/R^2 is not in the matrix where steps are long, at the mean mass, kg/m^2.
        blur: of the curvature, for which the inertia makes up, m^2.
    """

    needs = ("lists", "geometry", "forces")

    @staticmethod
    def kernels(features: Features) -> tuple[str, ...]:
        """Files of kernels."""
        return "membrane", *solver_kernels(features)

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry, forces: Forces):
        self.film, self.state, self.geometry, self.inertia = film, state, geometry, forces.heavy
        operator = LinearOperator(film.n_e, lists.ee.rows, film.device)
        arguments = [film, lists, operator, film.numerics.tolerance, film.numerics.max_iterations]
        self.load, self.unit = (make_solver(*arguments, x) for x in (state.memory.load, state.memory.unit))
        self.solvers = (self.load, self.unit)
        self.diag, self._operator = operator.diag, operator
        self.blur = inertial_blur(film, geometry)
        self._stiffness, self._left_out = Setting(film.device), Setting(film.device)
        self.left_out = self._left_out.array

    def prepare(self, stiffness: float) -> None:
        """Set c = 2 sigma theta^2 dt^2 (N s^2/m = kg)."""
        self._stiffness.at(stiffness)
        bent = 2.0 * stiffness / self.film.radius**2
        self._left_out.at(bent - _softer(bent, self.film.material.areal_mass))

    def solve(self) -> tuple[wp.array, wp.array]:
        """Responses to the load `load.b` and to the unit pressure `unit.b`, the last ones as first guesses."""
        film, geometry, operator = self.film, self.geometry, self._operator
        film.launch_e(
            km.stiffen_pairs_e,
            [
                *(self.inertia, geometry.area, geometry.weight, operator.rows),
                *(film.n_e, self._stiffness.array, self.blur, 2.0 / film.radius**2),
            ],
            [operator.diag, operator.pair],
        )
        self.load.solve()
        if self.film.features.closed:
            self.unit.solve()
        return self.load.x, self.unit.x

    def report(self) -> tuple[int, float]:
        """Iterations and residual of the last load solve."""
        return self.load.report()


def rational_kernels(features: Features) -> tuple[str, ...]:
    """Files of kernels of `make_rational`."""
    return *solver_kernels(features), *(("poles",) if features.coarse else ())


def make_rational(
    film: Film, lists: NeighborLists, geometry: Geometry, tolerance: float, most: int | None
) -> RationalLaplacian | MultilevelRational:
    """A solver for functions of the surface Laplacian of a film, with at most so many iterations; None for enough."""
    arrays = [geometry.weight, geometry.area, lists.ee.rows]
    last = [tolerance, most, film.device]
    if film.features.coarse:
        return MultilevelRational(film.n_e, film.total, *arrays, *last, levels_of(film, lists))
    return RationalLaplacian(film.n_e, film.total, *arrays, *last)


class AirResponse:
    """The same with the air's added mass: ((m + A(-lap_s)) (1 + blur lap_s) - c (lap_s + 2/R^2)) x = b.

    Attributes:
        left_out, blur: as those of `FilmResponse`.
    """

    needs = ("lists", "geometry", "forces")

    @staticmethod
    def kernels(features: Features) -> tuple[str, ...]:
        """Files of kernels."""
        return "membrane", *rational_kernels(features)

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry, forces: Forces):
        self.film, self.geometry, self.state, self.inertia = film, geometry, state, forces.inertia
        self.solver = make_rational(film, lists, geometry, film.numerics.tolerance, film.numerics.max_iterations)
        self.solvers = (self.solver,)
        self.load, self.unit = _Pair(film), _Pair(film)
        self.diag = film.zeros(film.n_e)
        self.mean = wp.full(1, film.material.areal_mass, dtype=wp.float32, device=film.device)
        self.low = 2.0 / size_of(film) ** 2
        self.poles = air.fit_poles(
            self.low,
            4.0 * (np.pi / film.spacing) ** 2,
            film.surroundings.air_density,
            film.radius,
            geometry.blur("sph"),
            film.air,
        )
        self.blur = geometry.blur(film.numerics.curvature)
        self._stiffness, self._left_out = -1.0, Setting(film.device)
        self.left_out = self._left_out.array
        self._load_scalar = wp.clone(self.solver.scalar)

    def prepare(self, stiffness: float) -> None:
        """Set c; new partial fractions only where it changed."""
        if stiffness != self._stiffness:
            film = self.film
            mass = film.material.areal_mass
            ringing = mass + film.air.waves(3.0 * self.low, film.surroundings.air_density, film.radius)
            bent = 2.0 * stiffness / film.radius**2
            softer = _softer(bent, float(ringing))
            self._left_out.at(bent - softer)
            new = air.response(mass, stiffness, *self.poles, self.blur, softer)
            self.solver.set_function(*new, self.low)
            self._stiffness = stiffness

    def solve(self) -> tuple[wp.array, wp.array]:
        """As `FilmResponse.solve`."""
        self._respond(self.load)
        copy(self._load_scalar, self.solver.scalar)
        if self.film.features.closed:
            self._respond(self.unit)
        return self.load.x, self.unit.x

    def _respond(self, pair: _Pair) -> None:
        clear(pair.x)
        if self.film.forces:
            clear(self.solver.b)  # what the sweeps of an E that is held go on from
        for sweep in range(SWEEPS):
            self.film.launch_e(
                km.lower_residual_e,
                [pair.b, self.inertia, self.geometry.area, self.mean, pair.x],
                [self.solver.b],
            )
            (self.solver.improve if sweep else self.solver.solve)()
            copy(pair.x, self.solver.x)

    def make_momentum(self, lists: NeighborLists, tolerance: float, most: int | None) -> Solver:
        """A solver for the momentum A(-lap_s) v of the air around a film that moves at v."""
        solver = make_rational(self.film, lists, self.geometry, tolerance, most)
        solver.set_function(*(p.astype(complex) for p in self.poles), self.low)
        return solver

    def report(self) -> tuple[int, float]:
        """Iterations and residual of the last load solve."""
        return self.solver.report(self._load_scalar)


class ExplicitResponse:
    """The present force over the mass, whatever the film does meanwhile.

    Attributes:
        lumped: air that every wave takes along, kg/m^2.
        left_out, blur: 0.
    """

    needs = ("lists", "geometry", "forces")
    kernels = ("membrane",)
    solvers = ()
    lumped = 0.0
    blur = 0.0

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry, forces: Forces):
        self.film, self.geometry = film, geometry
        self.load, self.unit = _Pair(film), _Pair(film)
        self.diag, self.left_out = film.zeros(film.n_e), film.zeros(1)

    def prepare(self, stiffness: float) -> None:
        """There is nothing to set."""

    def solve(self) -> tuple[wp.array, wp.array]:
        """As `FilmResponse.solve`."""
        for pair in (self.load, self.unit):
            inputs = [pair.b, self.diag, self.geometry.area, self.lumped]
            self.film.launch_e(km.explicit_response_e, inputs, [pair.x])
        return self.load.x, self.unit.x


class LumpedResponse(ExplicitResponse):
    """The same with the air that the wave of mode n = 2 takes along."""

    def __init__(self, film: Film, state: State, lists: NeighborLists, geometry: Geometry, forces: Forces):
        super().__init__(film, state, lists, geometry, forces)
        if film.features.air:
            self.lumped = float(film.air.waves(6.0 / size_of(film) ** 2, film.surroundings.air_density, film.radius))


def size_of(film: Film) -> float:
    """Radius of a closed film, and of the disc of the area of an open one, m."""
    return film.radius if np.isfinite(film.radius) else film.spacing * float(np.sqrt(film.n_e / np.pi))
