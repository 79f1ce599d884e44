"""Choices of discretisation: frozen, checked when made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from melp_warp.errors import require

SCHEMES = ("backward_euler", "trapezoid", "explicit")
FLOW_SCHEMES = ("backward_euler", "midpoint")
OPERATORS = ("mls", "sph")
SOLVERS = ("cg", "jacobi")
GRADIENTS = ("difference", "symmetric")


@dataclass(frozen=True)
class Numerics:
    """How the equations are discretised and solved.

    Attributes:
        layers: 2 for MELP, E and L; 1 for a single layer of E that carries the film and moves with it by explicit SPH
            (docs/single-layer.md). It has no L, no solves and no redistribution: what says how to do them has no part.
        support: kernel support radius r in E spacings (the paper has 4: see docs/accuracy.md).
        scheme: normal dynamics: "backward_euler" (damps), "trapezoid" (second order, keeps oscillations; taken as the
            implicit midpoint rule, with which it coincides for linear forces) or "explicit" (the paper's symplectic
            Euler step).
        flow: time stepping of the flow along the film: "midpoint" (second order, keeps waves, with paths of L to match;
            see docs/method.md) or "backward_euler" (the paper's (14): damps waves).
        curvature: "mls" (second order) or "sph" (the paper's (21)).
        solver: "cg" or "jacobi" (the paper's relaxed sweeps) for the surfactant equation (14).
        tolerance: relative residual at which conjugate gradients stop.
        max_iterations: iterations or sweeps at which a solve is given up; None for a number that grows with the film,
            `linear.most_iterations`.
        cfl: largest displacement of a particle in a step, in E spacings, where the scene sets no dt; in a single layer
            that of a particle and of the fastest wave together, always.
        l_order: order in time of the L advance, 1 or 2.
        affinity: share of the affine part in the transfer from L to E (7): 1 for APIC (Jiang et al. 2015), 0 for PIC.
        flip: share that L keep of their own velocity's departure from that of the E around them: with it u_L becomes
            sum W^ u_E' + flip (u_L - sum W^ u_E), u_E before and u_E' after the step's forces. 0 for (16), 1 for FLIP,
            with affinity 0 that of Brackbill and Ruppel 1986.
        skin: neighbour-list skin in E spacings: lists live until particles have moved half of it.
        redistribution: share of their unevenness that E lose in a step by redistribution (20), 0 for none.
        spread: (delta_max - delta_min)/delta_mean below which E are left alone.
        xsph: XSPH smoothing of the velocity of a single layer along the film, 0 to 1 (the paper's 0.99): the artificial
            viscosity of its flow. E of MELP have no velocity of their own along the film.
        gradient: Marangoni force of a single layer: "difference", the paper's (21), or "symmetric" in pairs, which
            keeps momentum and energy, but takes the noise of an uneven arrangement for a pressure.
        border: gap within which films of a foam cling to each other, in E spacings; lines are about as wide.
        exchange: rate psi at which L cross between films that touch, (27) and (28), 1/s.
        thickness_time: time in which eta_L relaxes to agree with eta_E, s.
    """

    layers: int = 2
    support: float = 3.0
    scheme: str = "backward_euler"
    flow: str = "midpoint"
    curvature: str = "mls"
    solver: str = "cg"
    tolerance: float = 1e-4
    max_iterations: int | None = None
    cfl: float = 0.99
    l_order: int = 1
    affinity: float = 1.0
    flip: float = 0.0
    skin: float = 0.25
    redistribution: float = 0.3
    spread: float = 0.2
    xsph: float = 0.99
    gradient: str = "difference"
    border: float = 1.0
    exchange: float = 0.0
    thickness_time: float = 0.1

    @property
    def looks_back(self) -> bool:
        """Whether what L carry on depends on the velocity of E before the step's forces."""
        return self.flip > 0.0 or self.flow == "midpoint"

    def __post_init__(self):
        def number(name, low, high):
            value = getattr(self, name)
            ok = isinstance(value, (int, float)) and np.isfinite(value) and low <= value <= high
            require(ok, name, value, f"a number from {low:g} to {high:g}")

        require(self.layers in (1, 2), "layers", self.layers, "1 or 2")
        number("support", 2.0, 8.0)
        require(self.scheme in SCHEMES, "scheme", self.scheme, f"one of {', '.join(SCHEMES)}")
        require(self.flow in FLOW_SCHEMES, "flow", self.flow, f"one of {', '.join(FLOW_SCHEMES)}")
        require(self.curvature in OPERATORS, "curvature", self.curvature, f"one of {', '.join(OPERATORS)}")
        require(self.gradient in GRADIENTS, "gradient", self.gradient, f"one of {', '.join(GRADIENTS)}")
        require(self.solver in SOLVERS, "solver", self.solver, f"one of {', '.join(SOLVERS)}")
        number("tolerance", 1e-7, 0.1)
        most = self.max_iterations
        ok = most is None or (isinstance(most, int) and 1 <= most <= 10000)
        require(ok, "max_iterations", most, "a whole number from 1 to 10000 or None")
        number("cfl", 0.01, 10.0)
        require(self.l_order in (1, 2), "l_order", self.l_order, "1 or 2")
        number("affinity", 0.0, 1.0)
        number("flip", 0.0, 1.0)
        number("skin", 0.05, 4.0)
        number("redistribution", 0.0, 1.0)
        number("spread", 0.0, 10.0)
        number("xsph", 0.0, 1.0)
        number("border", 0.5, 4.0)
        number("exchange", 0.0, 1e5)
        number("thickness_time", 1e-6, 1e6)
