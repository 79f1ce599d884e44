"""Air: the added mass of the air that a film moves, as a function of the surface Laplacian.

On a sphere mode n moves rho_air R (2n+1)/(n(n+1)) of air per area, inside and outside together. With
lambda = n(n+1)/R^2, an eigenvalue of -lap_s, that is

    A(lambda) = rho_air sqrt(4/lambda + 1/(R lambda)^2),

which for short waves is 2 rho_air/k, the added mass of a plane film. So the air is a function of the operator that
the solver has anyway: exact on a sphere and for short waves anywhere, an approximation on other shapes.
A is replaced by sum_k w_k/(lambda + s_k), and 1/(m + A + c lambda), partial fractions of it, is applied by
multi-shift conjugate gradients (`RationalLaplacian`).
"""

from __future__ import annotations

import inspect

import numpy as np

from melp_warp.errors import require

POLES = 7


class AirModel:
    """How much air moves along with a film, a unit of area; derive from it for another (docs/air.md).

    This one is the added mass of air at rest on both sides, see above. What a film as a whole takes along in a foam is
    that of a sphere, whatever the model. `density` is that of the air, kg/m^3, `radius` that of a sphere of the film's
    volume, m, infinite for an open film.
    """

    def waves(self, lam: np.ndarray, density: float, radius: float) -> np.ndarray:
        """Of waves with eigenvalues lambda of -lap_s, 1/m^2, on a single film; falls as lambda grows. kg/m^2."""
        return added_mass(lam, density, radius)

    def rigid(self, density: float, radius: float) -> float:
        """Of a single film that moves as a whole, kg/m^2."""
        return rigid_added_mass(density, radius)

    def film(self, density: float, radius: np.ndarray) -> np.ndarray:
        """Of the films of a foam, bubbles of these radii, whatever the length of the wave, kg/m^2."""
        return film_added_mass(density, radius)

    def describe(self) -> str:
        """What tells it from another one in a checkpoint: its source and its numbers."""
        return f"{inspect.getsource(type(self))} {sorted(vars(self).items())}"


def check_model(model: object) -> None:
    """Refuse what is no air model.

    Raises:
        InputError: it is none, or it gives masses that no air has.
    """
    require(isinstance(model, AirModel), "air_model", model, "an AirModel")
    lam = np.geomspace(1.0, 1e6, 20)
    for name, found in (
        ("waves", model.waves(lam, 1.2, 0.1)),
        ("rigid", np.array([model.rigid(1.2, 0.1)])),
        ("film", model.film(1.2, np.array([0.1, 0.2]))),
    ):
        found = np.asarray(found, dtype=np.float64)
        right = bool(np.isfinite(found).all()) and bool((found >= 0.0).all()) and found.ndim == 1
        require(right, f"{name} of air_model {type(model).__name__}", found.tolist(), "masses of at least 0 kg/m^2")


def added_mass(lam: np.ndarray, air_density: float, radius: float) -> np.ndarray:
    """A(lambda), kg/m^2, for lambda in 1/m^2 and a bubble of `radius` (infinite: a plane film)."""
    return air_density * np.sqrt(4.0 / lam + 1.0 / (radius * lam) ** 2)


def rigid_added_mass(air_density: float, radius: float) -> float:
    """A of rigid translation (n = 1), 3/2 rho_air R, kg/m^2; 0 for an open film, which cannot translate."""
    return 1.5 * air_density * radius if np.isfinite(radius) else 0.0


def film_added_mass(air_density: float, radius):
    """A of mode n = 2, 5/6 rho_air R, kg/m^2: what a foam's films take along, whatever the length of the wave."""
    return 5.0 / 6.0 * air_density * radius


def fit_poles(
    low: float, high: float, air_density: float, radius: float, blur: float, model: AirModel | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Poles s_k > 0 and weights w_k > 0 with A = sum_k w_k/(lambda + s_k) on [low, high].

    There lambda is that of the SPH Laplacian, lambda (1 - blur (lambda - 2/R^2)) of a wave's own: the kernel's mean
    over the chords of a sphere. A, which is the wave's, is a mean of 1/(lambda + s) over 0 < s < 1/blur.

    Least squares on the relative error, the best of a few ranges of logarithmically spaced poles. Up to 20,000 E it is
    within 0.25 % with a support of two to six spacings, at a million E within 0.8 %. A range of few waves wants fewer
    poles: with all, some weights would not be above 0.

    Returns:
        Poles (1/m^2) and weights (kg/m^4), seven of each or fewer.
    """
    lam = np.geomspace(low, high, 200)
    target = (model or AirModel()).waves(lam * (1.0 + blur * (lam - 2.0 / radius**2)), air_density, radius)
    for count in range(POLES, 0, -1):
        best = (np.inf, None, None)
        for first in (0.05, 0.1, 0.2):
            for last in (0.5, 0.6, 0.7, 0.8, 1.0, 1.5):
                poles = np.geomspace(first * low, last / blur, count)
                columns = 1.0 / (lam[:, None] + poles) / target[:, None]
                weights = np.linalg.lstsq(columns, np.ones_like(lam), rcond=None)[0]
                error = float(np.abs(columns @ weights - 1.0).max())
                if np.all(weights > 0.0) and error < best[0]:
                    best = (error, poles, weights)
        if best[1] is not None:
            return best[1], best[2]
    raise ArithmeticError(f"no poles for the air's added mass between {low:g} and {high:g} 1/m^2")


def response(
    mass: float, stiffness: float, poles: np.ndarray, weights: np.ndarray, blur: float, softer: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Partial fractions of 1/((mass + sum_k w_k/(lambda + s_k))(1 - blur lambda) + stiffness lambda - softer).

    The denominator is the Schur complement of an arrow matrix plus lambda, so its roots are eigenvalues. A pair may be
    complex: the air's inertia falls with lambda while the stiffness grows.

    Args:
        mass: kg/m^2.
        stiffness: coefficient c of lambda, kg, above 0.
        poles: s_k, 1/m^2.
        weights: w_k, kg/m^4.
        blur: of the curvature that the stiffness is that of, m^2; see `Membrane`.
        softer: what bends of the film take off the stiffness, kg/m^2.

    Returns:
        Complex poles p_k and residues g_k with 1/(...) = sum_k g_k/(lambda + p_k).
    """
    mass, stiffness, weights = (
        mass - blur * weights.sum() - softer,
        stiffness - blur * mass,
        weights * (1.0 + blur * poles),
    )
    border = np.sqrt(weights / abs(stiffness))
    arrow = np.diag(np.concatenate([[mass / stiffness], poles]))
    arrow[0, 1:], arrow[1:, 0] = border, -np.sign(stiffness) * border
    new = np.linalg.eigvals(arrow).astype(complex)
    slope = stiffness - np.sum(weights / (poles - new[:, None]) ** 2, axis=1)
    return new, 1.0 / slope
