"""How films burst, as a scene says it: punctures, and what becomes of the rims of holes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from melp_warp.errors import InputError, require
from melp_warp.keys import Key, at_least_zero, check_numbers, quantity


@dataclass(frozen=True)
class Puncture:
    """A hole that is made in a film, round or a cut.

    It starts as a hole that has opened from a point or a line: its rim holds the liquid that was there and runs at the
    speed of Taylor and Culick.

    Attributes:
        place: [3] m; the point of the film nearest to it is punctured.
        time: s.
        radius: of the hole at the start, or half of the width of a cut, m; None for one E spacing.
        end: [3] m, where a cut from `place` on ends; None for a round hole. One that runs beyond the frame of an open
            film cuts it in two.
    """

    place: tuple[float, float, float]
    time: float
    radius: float | None = None
    end: tuple[float, float, float] | None = None

    def __post_init__(self):
        ends = [self.place, *([] if self.end is None else [self.end])]
        for point in ends:
            require(len(point) == 3, "puncture", point, "three coordinates, m")
        numbers = [*(c for point in ends for c in point), self.time, *([] if self.radius is None else [self.radius])]
        require(all(map(math.isfinite, numbers)), "puncture", numbers, "finite numbers")
        require(self.time >= 0.0, "time of a puncture", self.time, "at least 0 s, the start")
        require(self.radius is None or self.radius > 0.0, "radius of a puncture", self.radius, "above 0 m")

    @classmethod
    def parse(cls, text: str) -> Puncture:
        """From "x,y,z,t" or "x,y,z,t,radius", in m and s.

        Raises:
            InputError: another number of numbers, or none.
        """
        allowed = "x,y,z,t or x,y,z,t,radius, in m and s"
        parts = text.split(",")
        require(len(parts) in (4, 5), "--puncture", text, allowed)
        try:
            numbers = [float(part) for part in parts]
        except ValueError:
            raise InputError(f"--puncture must be {allowed}, got {text!r}") from None
        return cls(tuple(numbers[:3]), *numbers[3:])


@dataclass(frozen=True)
class Bursting:
    """How a film bursts; nothing of it is there unless a scene punctures or lets rupture.

    Attributes:
        punctures: holes that are made.
        rupture_thickness: where the film gets thinner it breaks; 0 for never.
        breakup: a rim breaks into drops after about so many growth times of the waves along it
            (`kernels.free_rim.advance_rim_f`); 0 for a rim that breaks only where it ends.
    """

    punctures: Sequence[Puncture] = ()
    rupture_thickness: float = quantity(
        at_least_zero("m", "thickness below which the film breaks by itself (0: never)", 1e-3, spoken="nm"), 0.0
    )
    breakup: float = quantity(
        Key("-", "growth times of its waves after which a rim breaks into drops (0: only where it ends)", 0.0, 1e6),
        20.0,
    )

    def __post_init__(self):
        check_numbers(self)
        for one in self.punctures:
            require(isinstance(one, Puncture), "punctures", one, "Puncture(place, time, radius)")
        object.__setattr__(self, "punctures", tuple(sorted(self.punctures, key=lambda one: one.time)))

    @property
    def possible(self) -> bool:
        """Whether the film may burst."""
        return bool(self.punctures) or self.rupture_thickness > 0.0
