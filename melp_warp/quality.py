"""Points of the trade between speed and accuracy: `--quality` and every run of `melp_warp.study.tradeoff`.

A point is relative to a scene's own defaults, so that one definition serves every scene. docs/accuracy.md shows where
the named ones lie.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from melp_warp.errors import require
from melp_warp.parameters import Value, Values
from melp_warp.registry import SceneScript

LEAST_E = 60
"""Fewest E that a point asks for, unless the scene itself has fewer."""


@dataclass(frozen=True)
class Quality:
    """A choice of resolution, time step and numerics, relative to a scene's defaults.

    Attributes:
        meaning: one line.
        e: factor on the number of E.
        l: factor on the L per E; a scene with L keeps at least one.
        step: factor on the largest step: on `dt`, and on `cfl` times the spacing.
        keys: values of single keys, which take the place of what the factors give; a scene without one goes without.
        foam_keys: the same, further ones in scenes of several bubbles.
    """

    meaning: str = ""
    e: float = 1.0
    l: float = 1.0  # noqa: E741
    step: float = 1.0
    keys: Mapping[str, Value] = field(default_factory=dict)
    foam_keys: Mapping[str, Value] = field(default_factory=dict)

    def apply(self, defaults: Mapping[str, Value]) -> dict[str, Value]:
        """The keys that this point changes in a scene, with their values.

        Args:
            defaults: the scene's keys and values.

        Returns:
            Overrides for `Parameters.values`.
        """
        count, ratio = defaults["e_count"], defaults["l_per_e"]
        foam = self.foam_keys if "border" in defaults else {}
        wanted = {
            "e_count": max(min(count, LEAST_E), round(self.e * count)),
            "l_per_e": max(1, round(self.l * ratio)),
            "dt": None if defaults["dt"] is None else self.step * defaults["dt"],
            "cfl": self.step * math.sqrt(self.e) * defaults["cfl"],
            **self.keys,
            **foam,
        }
        if ratio == 0:
            wanted["l_per_e"] = 0
        return {key: value for key, value in wanted.items() if key in defaults and value != defaults[key]}

    def values(self, script: SceneScript, overrides: Mapping[str, Value] | None = None) -> Values:
        """A scene's values at this point, with some replaced.

        A foam gets no fewer E than its smallest bubble needs.

        Raises:
            InputError: for overrides that the scene does not take.
        """
        parameters, given = script.parameters, overrides or {}
        values = parameters.values(self.apply(parameters.defaults) | given)
        if "border" not in parameters.defaults or "e_count" in given:
            return values
        fewest = script.build(values).shape.fewest_e(values.support)
        return parameters.values({**values.as_dict(), "e_count": max(values.e_count, fewest)})


QUALITIES: Mapping[str, Quality] = MappingProxyType(
    {
        "draft": Quality("a look at the motion", e=0.5, l=0.5, step=2.0),
        "standard": Quality("the scene's own numbers"),
        "fine": Quality("for the final frames", e=2.0, step=0.5),
        "paper": Quality(
            "the settings of MELP 2022 at the scene's number of E",
            keys={
                "l_per_e": 16,
                "dt": None,
                "cfl": 0.99,
                "support": 4.0,
                "curvature": "sph",
                "solver": "jacobi",
                "flow": "backward_euler",
                "l_order": 1,
                "carrier": "apic",
                "flip": 0.0,
                "xsph": 0.99,
            },
            foam_keys={"cfl": 0.33},
        ),
    }
)
"""What `--quality` takes."""


def find_quality(name: str) -> Quality:
    """The point of that name.

    Raises:
        InputError: there is none.
    """
    require(name in QUALITIES, "--quality", name, f"one of {', '.join(QUALITIES)}")
    return QUALITIES[name]
