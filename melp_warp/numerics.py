"""Choices of discretisation: frozen, checked when made."""

from __future__ import annotations

from dataclasses import dataclass

from melp_warp.errors import require
from melp_warp.keys import Key, at_least_zero, check_numbers, count, quantity, word

SCHEMES = ("backward_euler", "trapezoid", "explicit")
CARRIERS = ("apic", "circulation")
FLOW_SCHEMES = ("backward_euler", "midpoint")
OPERATORS = ("mls", "sph")
SOLVERS = ("cg", "jacobi")
GRADIENTS = ("difference", "symmetric")


@dataclass(frozen=True)
class Numerics:
    """How the equations are discretised and solved.

    Attributes:
        layers: 2 is MELP. 1 is a single layer that carries the film and moves with it by explicit SPH
            (docs/single-layer.md): it has no L, no solves and no redistribution, and keys about those have no effect.
        support: r, which the paper has at 4 (see docs/accuracy.md).
        scheme: "backward_euler" damps; "trapezoid" is second order and keeps oscillations (taken as the implicit
            midpoint rule, with which it coincides for linear forces); "explicit" is the paper's symplectic Euler step.
        flow: "midpoint" is second order and keeps waves, with paths of L to match (see docs/method.md);
            "backward_euler" is the paper's (14), which damps waves.
        carrier: "apic" is the velocity of L alone; with "circulation" they carry circulation besides, which E restore
            (docs/vortices.md), and `flip` has no part.
        curvature: "mls" is second order, "sph" the paper's (21).
        solver: conjugate gradients, or the paper's relaxed "jacobi" sweeps, for (14).
        max_iterations: None for a number that grows with the film, `linear.most_iterations`.
        cfl: in a single layer the motion of a particle and of the fastest wave together, whatever `dt` is.
        affinity: share of the affine part in the transfer from L to E (7), Jiang et al. 2015.
        flip: u_L becomes sum W^ u_E' + flip (u_L - sum W^ u_E), u_E before and u_E' after the step's forces. 0 for
            (16), 1 for FLIP, with affinity 0 that of Brackbill and Ruppel 1986.
        mixing: C of the diffusion C d^2 |S| between L, d their spacing, S the flow's strain rate (docs/vortices.md).
        skin: lists live until particles have moved half of it.
        redistribution: by (20).
        spread: (delta_max - delta_min)/delta_mean below which E are left alone.
        respacing: factor, or one over it, by which the spacing of E may change as a film stretches or shrinks before E
            are put in or taken out, see stepping/respacing.py; None for E that stay.
        resampling: factor over the mean of their region, or one over it, by which L may clump or thin out before
            they are merged there and split here, see stepping/resampling.py; None for L that stay.
        xsph: the artificial viscosity of a single layer's flow along the film; the paper has 0.99. E of MELP have no
            velocity of their own along the film.
        gradient: "difference" is the paper's (21); "symmetric" in pairs keeps momentum and energy, but takes the noise
            of an uneven arrangement for a pressure.
        border: lines of a foam are about as wide.
        exchange: psi of (27) and (28).
    """

    layers: int = quantity(
        count("2 for MELP; 1 for one layer of e_count particles by explicit SPH, without L", 1, 2), 2
    )
    support: float = quantity(Key("spacings", "kernel support radius, in E spacings", 2.0, 8.0), 3.0)
    scheme: str = quantity(word("time stepping of the normal motion", SCHEMES), "backward_euler")
    flow: str = quantity(word("time stepping of the flow along the film", FLOW_SCHEMES), "midpoint")
    carrier: str = quantity(word("what L carry vortices by", CARRIERS), "apic")
    curvature: str = quantity(word("curvature operator", OPERATORS), "mls")
    solver: str = quantity(word("solver of the surfactant equation", SOLVERS), "cg")
    tolerance: float = quantity(Key("-", "relative residual at which solves stop", 1e-7, 0.1), 1e-4)
    max_iterations: int | None = quantity(
        count("iterations at which a solve is given up (auto: 100 + sqrt(E) ln(2/tolerance))", 1, 10_000, auto=True),
        None,
    )
    cfl: float = quantity(Key("spacings", "largest motion in a step where dt is auto, in E spacings", 0.01, 10.0), 0.99)
    l_order: int = quantity(count("order in time of the Lagrangian motion", 1, 2), 1)
    affinity: float = quantity(Key("-", "share of the affine part in transfers (1: APIC, 0: PIC)", 0.0, 1.0), 1.0)
    flip: float = quantity(
        Key("-", "share that L keep of their own velocity's departure from the E (0: none, 1: FLIP)", 0.0, 1.0), 0.0
    )
    mixing: float = quantity(
        Key("-", "diffusion between L over their spacing squared and the flow's strain rate (0: none)", 0.0, 10.0), 0.0
    )
    skin: float = quantity(Key("spacings", "skin of the neighbour lists, in E spacings", 0.05, 4.0), 0.25)
    redistribution: float = quantity(
        Key("-", "share of their unevenness that E lose in a step (0: none)", 0.0, 1.0), 0.3
    )
    spread: float = quantity(at_least_zero("-", "relative spread of E density that is left alone", 10.0), 0.2)
    respacing: float | None = quantity(
        Key(
            "-",
            "growth of the E spacing at which E come, its inverse at which some go (auto: none)",
            1.05,
            2.0,
            auto=True,
        ),
        None,
    )
    resampling: float | None = quantity(
        Key(
            "-",
            "density of L over the mean at which near ones merge, its inverse at which some are split (auto: never)",
            1.2,
            10.0,
            auto=True,
        ),
        None,
    )
    xsph: float = quantity(Key("-", "smoothing of the velocity of a single layer, a step", 0.0, 1.0), 0.99)
    gradient: str = quantity(word("Marangoni force of a single layer", GRADIENTS), "difference")
    border: float = quantity(Key("spacings", "gap within which films cling to each other", 0.5, 4.0), 1.0)
    exchange: float = quantity(at_least_zero("1/s", "rate at which liquid crosses between films that touch", 1e5), 0.0)
    thickness_time: float = quantity(
        Key("s", "time in which L thickness relaxes to E thickness, without surfactant", 1e-6, 1e6), 0.1
    )

    @property
    def looks_back(self) -> bool:
        """Whether what L carry on depends on the velocity of E before the step's forces."""
        return self.kept > 0.0 or self.flow == "midpoint" or self.carrier == "circulation"

    @property
    def kept(self) -> float:
        """Share of their own velocity's departure that L keep: `flip`, 0 where they carry circulation."""
        return 0.0 if self.carrier == "circulation" else self.flip

    def __post_init__(self):
        check_numbers(self)
        even = self.respacing is None or self.redistribution > 0.0
        require(even, "redistribution", self.redistribution, "above 0 where E come and go: respacing")
