"""Circulation carried by L: vortices that the transfers between L and E do not wear down (docs/vortices.md)."""

from __future__ import annotations

import numpy as np
import warp as wp

from melp_warp.device.launch import launch
from melp_warp.device.linear import LinearOperator
from melp_warp.device.multilevel import MultilevelGradient
from melp_warp.kernels import circulation as kc
from melp_warp.kernels import regions as kr
from melp_warp.stages.film import Film
from melp_warp.stages.geometry import Geometry
from melp_warp.stages.levels import levels_of
from melp_warp.stages.neighbors import NeighborLists
from melp_warp.stages.rim import Rim
from melp_warp.stages.state import State
from melp_warp.stages.surfactant import Tangential
from melp_warp.stages.transfer import Transfer

RESTORE_TOLERANCE = 1e-2
"""Relative residual of the Poisson solve of a step: what it leaves is part of the next step's deficit."""

CURL_STEP = 1e-3
"""Step of the differences that give the curl of a scene's velocity, spacings."""


class Circulation:
    """L carry Omega = n.curl_s u dA along their paths, and E restore it. Made only where a scene asks for it.

    Kelvin's theorem: on a film that moves and stretches, the circulation along a loop of liquid changes by the forces
    along the film alone. Each transfer of velocity from L to E and back blurs a vortex; what an L carries of it stays
    as it is. So in each step E first restore what their velocity lacks of it, delta = Omega_E - a n.curl_s u:
    lap_s psi = delta/a, u += n x grad_s psi, with psi = 0 along a rim. What the forces of the step make is given to
    the L afterwards. Where nothing has a curl, delta is 0 and the velocity stays as it is.

    Attributes:
        carried: [n_e] circulation of the L near each E, m^2/s.
        blurred: [n_e] the same as the weights W give it, before it is sharpened; room for what forces make, besides.
        psi: [n] stream function of what was restored, m^2/s.
    """

    needs = ("lists", "geometry", "transfer", "rim")
    kernels = ("circulation", "levels", "linear", "regions")

    def __init__(
        self,
        film: Film,
        state: State,
        lists: NeighborLists,
        geometry: Geometry,
        transfer: Transfer,
        rim: Rim | None,
    ):
        self.film, self.state, self.lists, self.geometry = film, state, lists, geometry
        self.transfer, self.rim = transfer, rim
        n = film.n_e
        self.carried, self.blurred, self._deficit, self._made = (film.zeros(n) for _ in range(4))
        self._mean = film.parts(wp.vec2) if rim is None else None
        operator = LinearOperator(n, lists.ee.rows, film.device, pair=geometry.weight)
        limits = [RESTORE_TOLERANCE, film.numerics.max_iterations]
        self.solver = MultilevelGradient(operator, film.total, *limits, levels_of(film, lists), energy=True)
        self.psi = self.solver.x

    def gather(self) -> None:
        """Find `carried`. Follows `Transfer.gather`, whose weights and packs it takes."""
        self.transfer.gather_amount(self.state.l.circulation, self.blurred)
        self._sharpen(self.blurred, self.carried)

    def _sharpen(self, blurred: wp.array, amount: wp.array) -> None:
        """Take back what the weights W between L and E blur, to the second order."""
        film, geometry = self.film, self.geometry
        film.launch_e(
            kc.sharpen_e,
            [blurred, geometry.area, self.lists.ee.rows, geometry.weight, film.r, film.n_e],
            [amount],
        )

    def restore(self) -> None:
        """Give E the rotation that their velocity lacks."""
        film, e, geometry, rows = self.film, self.state.e, self.geometry, self.lists.ee.rows
        self.gather()
        film.launch_e(
            kc.find_deficit_e,
            [e.u, e.normal, self.carried, geometry.area, rows, geometry.inner_gradient],
            [self._deficit],
        )
        if self._mean is not None:
            film.launch_parts(kr.load_chunks, [self._deficit, geometry.area, film.first], [self._mean])
        film.launch_e(
            kc.load_stream_e,
            [self._deficit, geometry.area, e.region, self._mean, film.regions],
            [self.solver.b, self.psi],
        )
        self._clear_beyond()
        self.solver.solve()
        self._mirror()
        film.launch_e(kc.add_stream_e, [self.psi, e.normal, rows, geometry.gradient], [e.u])

    def take(self, flow: Tangential, dt: wp.array) -> None:
        """Let L take the circulation that the forces along the film make in a step of dt [1]; follows their solve."""
        film, e, geometry = self.film, self.state.e, self.geometry
        flow.forces.note_braking(flow.theta, dt, flow.push)
        if flow.push is not None and self.rim is not None:
            self.rim.mirror(flow.push)
        film.launch_e(
            kc.make_circulation_e,
            [
                *(
                    flow.fields.eta,
                    flow.fields.gamma,
                    flow.gamma,
                    film.stiffness,
                    flow.forces.still,
                    flow.push,
                    flow.theta,
                ),
                *(e.normal, geometry.area, self.lists.ee.rows),
                *(geometry.inner_gradient, geometry.gradient, film.n_e, dt),
            ],
            [self.blurred],
        )
        self._sharpen(self.blurred, self._made)
        self.transfer.give_made(self._made, self.state.l.circulation)

    def diagnostics(self) -> dict[str, float]:
        """Circulation of all L, m^2/s, and enstrophy sum a omega^2/2 of what the E see of it, m^2/s^2 (reads back)."""
        self.transfer.normalize()
        self.gather()
        area = self.geometry.area.numpy().astype(np.float64)
        carried = self.carried.numpy().astype(np.float64)
        total = self.state.l.circulation.numpy().sum(dtype=np.float64)
        return {"circulation": float(total), "enstrophy": float(0.5 * np.sum(carried**2 / area))}

    def _clear_beyond(self) -> None:
        """Hold psi at 0 beyond the rim, as the solver does."""
        if self.rim is not None:
            launch(kc.clear_beyond_b, self.film.n_b, [self.film.n_e], [self.psi], self.film.device)

    def _mirror(self) -> None:
        """Continue psi beyond the rim."""
        if self.rim is not None:
            film = self.film
            launch(
                kc.mirror_stream_b,
                film.n_b,
                [self.state.b.mirror, self.state.e.x, self.lists.be.rows, self.lists.mirror_reach, film.n_e],
                [self.psi],
                film.device,
            )


def curl_of(velocity, points: np.ndarray, normals: np.ndarray, spacing: float) -> np.ndarray:
    """n.curl of a velocity field at points on a surface, by differences in its tangent plane. [n], 1/s.

    Args:
        velocity: [n, 3] m -> [n, 3] m/s.
        points: [n, 3] m.
        normals: [n, 3] unit normals.
        spacing: of the E, m.
    """
    axis = np.where(np.abs(normals[:, 2:]) > 0.7, [[1.0, 0.0, 0.0]], [[0.0, 0.0, 1.0]])
    e1 = np.cross(axis, normals)
    e1 /= np.linalg.norm(e1, axis=1, keepdims=True)
    e2 = np.cross(normals, e1)
    h = CURL_STEP * spacing

    def slope(along, component):
        change = np.asarray(velocity(points + h * along)) - np.asarray(velocity(points - h * along))
        return np.sum(component * change, axis=1) / (2.0 * h)

    return slope(e1, e2) - slope(e2, e1)
