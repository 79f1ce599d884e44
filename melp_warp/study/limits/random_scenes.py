"""Random scenes within what their keys allow."""

from __future__ import annotations

import math

import numpy as np

from melp_warp.material import GAS_CONSTANT
from melp_warp.parameters import Key, Value, Values
from melp_warp.registry import load_scene, scene_names
from melp_warp.study.limits.judging import Case, Error, Verdict, judge
from melp_warp.study.limits.scenes import carried_out

SMALL = {"e_count": (60, 900), "l_per_e": (0, 6), "frames": (2, 2), "fps": (24.0, 1e6), "bubbles": (2, 4)}
"""Ranges of the keys that decide how long a run takes; the others are drawn from all that they take."""


LEFT_OUT = ("cluster", "foam_mountain")
"""Scenes that need more E than that."""


def draw(key: Key, low: float, high: float, rng: np.random.Generator) -> Value:
    """A value of a key, log-uniform where its range spans decades."""
    if key.choices:
        return str(rng.choice(key.choices))
    if key.auto and rng.random() < 0.5:
        return None
    if low >= 0.0 and high > 30.0 * max(low, 1e-9 * high):
        if low == 0.0 and not key.above and rng.random() < 0.2:
            return key.check("drawn", 0.0)
        value = math.exp(rng.uniform(math.log(max(low, 1e-9 * high)), math.log(high)))
    else:
        value = rng.uniform(low, high)
    value = min(max(value, low), high)
    return round(value) if key.whole else value


def random_scene(seed: int) -> tuple[str, dict[str, Value]]:
    """Name and overrides of a scene with a third of its keys drawn at random, each from its whole range.

    Three of four are made to go together, see `_reconcile`; the others are mostly refused.
    """
    rng = np.random.default_rng(seed)
    name = str(rng.choice([name for name in scene_names() if name not in LEFT_OUT]))
    parameters = load_scene(name).parameters
    overrides = {}
    for one in parameters:
        key = parameters.keys[one]
        if one in SMALL or rng.random() < 1.0 / 3.0:
            overrides[one] = draw(key, *SMALL.get(one, (key.low, key.high)), rng)
    if rng.random() < 0.75:
        _reconcile(overrides, parameters.values(overrides), rng)
    return name, overrides


def _reconcile(overrides: dict[str, Value], p: Values, rng: np.random.Generator) -> None:
    """Change drawn values that are refused together: enough E, L, tension, a shape that is one, not too many steps."""
    overrides["l_per_e"] = max(1, p.l_per_e)
    overrides["e_count"] = max(p.e_count, 500)
    widest = 0.25 * math.sqrt(overrides["e_count"] / (4 if hasattr(p, "border") else 1))
    overrides["support"] = min(p.support, max(2.0, widest))
    overrides["surfactant"] = min(p.surfactant, rng.uniform(0.0, 0.9) * p.tension / (GAS_CONSTANT * p.temperature))
    if p.dt is not None:
        overrides["dt"] = max(p.dt, 0.1 / p.fps)
    if hasattr(p, "displacement"):
        overrides["displacement"] = min(p.displacement, 0.5 * p.radius)
    if hasattr(p, "separation"):
        overrides["separation"] = min(p.separation, 0.5 * p.width)


def run_random(seed: int) -> Verdict:
    """Run a random scene; see `judge`."""
    name, overrides = random_scene(seed)
    script = load_scene(name)

    def run() -> list[Error]:
        scene = script.build(script.parameters.values(overrides))
        return carried_out(scene, scene.frames)

    return judge(Case("random", f"{name}, seed {seed}", run))
