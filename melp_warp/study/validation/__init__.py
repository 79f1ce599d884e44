"""Validation: runs with a known answer, as functions that return numbers (SI).

Every case builds a `Scene`, runs it and returns a dictionary: `exact`, `measured`, `error` (relative unless its
docstring says otherwise) and the parameters it ran with; `series` holds what a plot needs, `cost` (in the cases that
`melp_warp.study.tradeoff` takes) what the run took, see `cost`. The tests run them small,
the tool `tools/validate.py` runs them at full size and writes docs/validation.md. Any can be called from Python:

    >>> from melp_warp.study.validation import oscillation
    >>> oscillation(mode=2, e_count=1500)["error"]
"""

from melp_warp.study.validation.film import (
    conservation,
    couder_profile,
    drainage,
    equilibrium,
    giant_bubble,
    thickness_mismatch,
)
from melp_warp.study.validation.flow import (
    eddy_loss,
    elastic_speed,
    kernel_variance,
    marangoni_wave,
    shear_decay,
    surfactant_decay,
    taylor_green,
    taylor_pair,
    taylor_vortex,
)
from melp_warp.study.validation.motion import (
    fall_in_air,
    free_fall,
    free_momentum,
    sphere_fall,
    terminal_fall,
    translation,
)
from melp_warp.study.validation.shared import (
    CLEAN,
    GRAVITY,
    bessel_j0,
    cost,
    damped_cosine,
    decay_rate,
    e_area,
    e_concentration,
    e_points,
    e_thickness,
    e_velocities,
    l_array,
    legendre_amplitude,
    observe_frames,
    order_of,
    small_giant,
    steps,
    unevenness,
)
from melp_warp.study.validation.surface import (
    chord,
    drum,
    midpoint_frequency,
    oscillation,
    oscillation_frequency,
    resting_bubble,
    space_order,
    time_order,
)

__all__ = [
    "CLEAN",
    "GRAVITY",
    "bessel_j0",
    "chord",
    "conservation",
    "cost",
    "couder_profile",
    "damped_cosine",
    "decay_rate",
    "drainage",
    "drum",
    "e_area",
    "e_concentration",
    "e_points",
    "e_thickness",
    "e_velocities",
    "eddy_loss",
    "elastic_speed",
    "equilibrium",
    "fall_in_air",
    "free_fall",
    "free_momentum",
    "giant_bubble",
    "kernel_variance",
    "l_array",
    "legendre_amplitude",
    "marangoni_wave",
    "midpoint_frequency",
    "observe_frames",
    "order_of",
    "oscillation",
    "oscillation_frequency",
    "resting_bubble",
    "shear_decay",
    "small_giant",
    "space_order",
    "sphere_fall",
    "steps",
    "surfactant_decay",
    "taylor_green",
    "taylor_pair",
    "taylor_vortex",
    "terminal_fall",
    "thickness_mismatch",
    "time_order",
    "translation",
    "unevenness",
]
