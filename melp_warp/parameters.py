"""Scene parameters: one registry of keys, so that a quantity has the same name, unit and meaning in every scene."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType

import numpy as np

from melp_warp.errors import InputError, require
from melp_warp.material import AIR_MODELS, Material, Surroundings
from melp_warp.numerics import FLOW_SCHEMES, GRADIENTS, OPERATORS, SCHEMES, SOLVERS, Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Shape

Value = float | int | str | None


@dataclass(frozen=True)
class Key:
    """What a parameter is and which values it takes.

    Attributes:
        unit: SI unit, "-" for a plain number.
        meaning: one line.
        low: smallest value.
        high: largest value.
        above: whether `low` itself is refused.
        whole: whether only whole numbers are taken.
        choices: the words it takes instead of numbers; empty for a number.
        auto: whether "auto" (None in Python) is taken as well.
    """

    unit: str
    meaning: str
    low: float = -1e9
    high: float = 1e9
    above: bool = False
    whole: bool = False
    choices: tuple[str, ...] = ()
    auto: bool = False

    @property
    def allowed(self) -> str:
        """The values it takes, in words."""
        if self.choices:
            return "one of " + ", ".join(self.choices)
        kind = "a whole number" if self.whole else "a number"
        low = f"above {self.low:g} and at most" if self.above else f"from {self.low:g} to"
        unit = "" if self.unit == "-" else f" {self.unit}"
        # .15g keeps large whole limits exact
        return f"{kind} {low} {self.high:.15g}{unit}" + (" or auto" if self.auto else "")

    @property
    def limits(self) -> str:
        """The same, short enough for a table; without the unit."""
        if self.choices:
            return " | ".join(self.choices)
        low = f"above {self.low:g}, up" if self.above else f"{self.low:g}"
        return f"{low} to {self.high:.15g}" + (", whole" if self.whole else "") + (" | auto" if self.auto else "")

    def parse(self, name: str, text: str) -> Value:
        """Read a value typed by a user.

        Raises:
            InputError: for text that is not a value of this key.
        """
        text = text.strip()
        if self.choices:
            return self.check(name, text)
        if self.auto and text == "auto":
            return None
        try:
            number = float(text)
        except ValueError:
            raise InputError(f"{name} must be {self.allowed}, got {text!r}") from None
        return self.check(name, number)

    def check(self, name: str, value: Value) -> Value:
        """Return the value, whole numbers as `int` and others as `float`.

        Raises:
            InputError: for a value that this key does not take.
        """
        if value is None and self.auto:
            return None
        if self.choices:
            require(value in self.choices, name, value, self.allowed)
            return value
        number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
        ok = number and bool(np.isfinite(value)) and self.low <= value <= self.high
        ok = ok and not (self.above and value == self.low) and not (self.whole and value != int(value))
        require(ok, name, value, self.allowed)
        return int(value) if self.whole else float(value)


def _positive(unit: str, meaning: str, high: float) -> Key:
    return Key(unit, meaning, 0.0, high, above=True)


def _at_least_zero(unit: str, meaning: str, high: float) -> Key:
    return Key(unit, meaning, 0.0, high)


def _count(meaning: str, low: int, high: int) -> Key:
    return Key("-", meaning, low, high, whole=True)


KEYS: Mapping[str, Key] = MappingProxyType(
    {
        # shape
        "radius": Key("m", "radius of the film at rest", 1e-4, 10.0),
        "width": Key("m", "width of the film", 1e-4, 100.0),
        "height": Key("m", "height of the film, along its slope", 1e-4, 100.0),
        "tilt": Key("degrees", "lean of the film: 0 vertical, 90 lying flat", -180.0, 180.0),
        "mode": _count("number n of the Legendre mode P_n of the initial shape", 2, 20),
        "amplitude": Key("-", "displacement of the initial shape, relative to radius", -0.5, 0.5),
        "displacement": _at_least_zero("m", "scale of the noise that displaces the initial shape", 10.0),
        "displacement_frequency": _positive("1/m", "noise cells per metre of the displacement", 1e4),
        "displacement_octaves": _count("octaves of the displacement's noise", 1, 8),
        # foams
        "radius_1": Key("m", "radius of the first bubble", 1e-4, 10.0),
        "radius_2": Key("m", "radius of the second bubble", 1e-4, 10.0),
        "radius_low": Key("m", "radius of the smallest bubble", 1e-4, 10.0),
        "radius_high": Key("m", "radius of the largest bubble", 1e-4, 10.0),
        "thickness_1": Key("m", "thickness of the first bubble's film", 1e-9, 1e-4),
        "thickness_2": Key("m", "thickness of the second bubble's film", 1e-9, 1e-4),
        "bubbles": _count("number of bubbles", 1, 10_000),
        "gap": _at_least_zero("spacings", "distance between neighbouring bubbles at the start, in E spacings", 100.0),
        "approach_speed": Key("m/s", "speed of each bubble towards the middle at the start", -100.0, 100.0),
        "tension_spread": _at_least_zero("-", "difference of surface tension between bubbles, relative", 0.5),
        "pop_time": Key("s", "time at which a bubble pops (auto: never)", 0.0, 1e6, auto=True),
        "merge_time": Key("s", "time at which a partition breaks (auto: never)", 0.0, 1e6, auto=True),
        # initial film and flow
        "noise": Key("-", "unevenness of the initial thickness, relative to thickness", 0.0, 0.95),
        "noise_frequency": _positive("1/m", "noise cells per metre of the initial thickness", 1e4),
        "noise_octaves": _count("octaves of the initial thickness's noise", 1, 8),
        "swirl": _at_least_zero("m/s", "typical speed of the initial whirls along the film", 100.0),
        "separation": _positive("m", "distance between the two vortex centres", 100.0),
        "vortex_radius": _positive("m", "core radius a of a vortex, where its speed is largest", 100.0),
        "vortex_speed": Key("m/s", "speed of a vortex at vortex_radius", -100.0, 100.0),
        # film
        "thickness": Key("m", "reference thickness eta_0", 1e-9, 1e-4),
        "tension": _positive("N/m", "surface tension of pure water, sigma_0", 10.0),
        "surfactant": _at_least_zero("mol/m^2", "reference surfactant on each side, Gamma_0", 1e-3),
        "density": _positive("kg/m^3", "density of the liquid", 1e5),
        "temperature": _positive("K", "temperature", 1e4),
        "viscosity": _at_least_zero("m^2/s", "kinematic viscosity of the flow in the film", 10.0),
        # surroundings
        "gravity": _at_least_zero("m/s^2", "acceleration of gravity, downwards (-y)", 1e3),
        "pressure": _at_least_zero("Pa", "pressure of the air outside", 1e8),
        "air": Key("-", "inertia of the air that the film moves", choices=AIR_MODELS),
        "air_density": _positive("kg/m^3", "density of the air", 1e3),
        "air_drag": _at_least_zero(
            "-", "factor on the drag of a sphere on a bubble as a whole, where air is on", 100.0
        ),
        "drag": _at_least_zero("Pa s/m", "traction of the air per speed along the film, both sides", 1e3),
        "damping": _at_least_zero("1/s", "rate at which the air takes up the normal motion within a foam", 1e5),
        "exchange": _at_least_zero("1/s", "rate at which liquid crosses between films that touch", 1e5),
        "lift": Key("-", "share of the film's weight that a lighter gas inside carries (1 hovers)", -10.0, 10.0),
        # particles
        "e_count": _count("Eulerian particles", 12, 10_000_000),  # three supports' worth of the smallest support
        "l_per_e": _count("Lagrangian particles per Eulerian particle (0: none)", 0, 1000),
        "seed": _count("seed of everything random", 0, 2**31 - 1),
        # time
        "frames": _count("frames after the first", 0, 1_000_000),
        "fps": _positive("1/s", "frames per simulated second", 1e6),
        "dt": Key("s", "largest time step (auto: set by cfl)", 0.0, 1.0, above=True, auto=True),
        # numerics
        "layers": _count("2 for MELP; 1 for one layer of e_count particles by explicit SPH, without L", 1, 2),
        "support": Key("spacings", "kernel support radius, in E spacings", 2.0, 8.0),
        "scheme": Key("-", "time stepping of the normal motion", choices=SCHEMES),
        "flow": Key("-", "time stepping of the flow along the film", choices=FLOW_SCHEMES),
        "curvature": Key("-", "curvature operator", choices=OPERATORS),
        "solver": Key("-", "solver of the surfactant equation", choices=SOLVERS),
        "tolerance": Key("-", "relative residual at which solves stop", 1e-7, 0.1),
        "max_iterations": Key(
            "-",
            "iterations at which a solve is given up (auto: 100 + sqrt(E) ln(2/tolerance))",
            1,
            10000,
            whole=True,
            auto=True,
        ),
        "cfl": Key("spacings", "largest motion in a step where dt is auto, in E spacings", 0.01, 10.0),
        "l_order": _count("order in time of the Lagrangian motion", 1, 2),
        "affinity": Key("-", "share of the affine part in transfers (1: APIC, 0: PIC)", 0.0, 1.0),
        "flip": Key("-", "share that L keep of their own velocity's departure from the E (0: none, 1: FLIP)", 0.0, 1.0),
        "skin": Key("spacings", "skin of the neighbour lists, in E spacings", 0.05, 4.0),
        "redistribution": Key("-", "share of their unevenness that E lose in a step (0: none)", 0.0, 1.0),
        "spread": Key("-", "relative spread of E density that is left alone", 0.0, 10.0),
        "border": Key("spacings", "gap within which films cling to each other", 0.5, 4.0),
        "xsph": Key("-", "smoothing of the velocity of a single layer, a step", 0.0, 1.0),
        "gradient": Key("-", "Marangoni force of a single layer", choices=GRADIENTS),
        "thickness_time": Key("s", "time in which L thickness relaxes to E thickness", 1e-6, 1e6),
    }
)
"""Every key that a scene may have."""

_MATERIAL = tuple(f.name for f in fields(Material))
_FOAM_NUMERICS = ("border", "exchange")
_SINGLE_FILM_NUMERICS = ("layers", "scheme", "curvature", "gradient")
_NUMERICS = tuple(f.name for f in fields(Numerics) if f.name not in _FOAM_NUMERICS)
_SURROUNDINGS = ("pressure", "air", "air_density", "air_drag", "drag")
_RUN = ("e_count", "l_per_e", "seed", "frames", "fps", "dt")

FOAM: Mapping[str, Value] = MappingProxyType(
    {
        "damping": 5.0,
        "exchange": 0.0,
        "border": 1.0,
        "air": "added_mass",
        "cfl": 0.5,
        "flow": "backward_euler",
        "redistribution": 1.0,
        "spread": 0.02,
    }
)
"""Values with which foams run well: what `declare` is given in every scene of several bubbles."""


def _common_defaults(foam: bool) -> dict[str, Value]:
    """The keys that every scene has, with the values they take where a scene does not say otherwise."""
    material, surroundings, numerics = Material(), Surroundings(), Numerics()
    of_numerics = (name for name in _NUMERICS if not (foam and name in _SINGLE_FILM_NUMERICS))
    return {
        **{name: getattr(material, name) for name in _MATERIAL},
        "gravity": 0.0,
        **{name: getattr(surroundings, name) for name in _SURROUNDINGS},
        **{"e_count": 2000, "l_per_e": 16, "seed": 0, "frames": 100, "fps": 60.0, "dt": None},
        **{name: getattr(numerics, name) for name in of_numerics},
    }


class Values:
    """A scene's parameters with their values, as attributes: `p.radius`, `p.thickness`."""

    def __init__(self, values: Mapping[str, Value]):
        self._values = dict(values)

    def __getattr__(self, name: str) -> Value:
        try:
            return self.__dict__["_values"][name]
        except KeyError:
            raise AttributeError(f"the scene declares no parameter {name!r}") from None

    def as_dict(self) -> dict[str, Value]:
        """Key -> value, in the order of the scene's table."""
        return dict(self._values)

    @property
    def material(self) -> Material:
        """The liquid."""
        return Material(**{name: self._values[name] for name in _MATERIAL})

    @property
    def surroundings(self) -> Surroundings:
        """Gravity along -y, the air, the pressure."""
        given = {name: self._values[name] for name in (*_SURROUNDINGS, "lift", "damping") if name in self._values}
        return Surroundings(gravity=(0.0, -self.gravity, 0.0), **given)

    @property
    def numerics(self) -> Numerics:
        """The discretisation."""
        names = (*_NUMERICS, *_FOAM_NUMERICS)
        return Numerics(**{name: self._values[name] for name in names if name in self._values})

    def scene(self, name: str, shape: Shape, **initial) -> Scene:
        """Put a scene together.

        Args:
            name: the scene's name.
            shape: the film's geometry.
            **initial: the initial fields `thickness`, `concentration` and `velocity` of `Scene`, and its `waves`.

        Returns:
            The scene with this object's material, surroundings, numerics, counts and times.

        Raises:
            InputError: for values that do not go together.
        """
        return Scene(
            name,
            shape,
            material=self.material,
            surroundings=self.surroundings,
            numerics=self.numerics,
            **{key: self._values[key] for key in _RUN},
            **initial,
        )


@dataclass(frozen=True)
class Parameters:
    """The parameters of one scene.

    Attributes:
        defaults: key -> value, in the order in which they are listed.
        keys: key -> what it is.
    """

    defaults: Mapping[str, Value]
    keys: Mapping[str, Key]

    def __iter__(self) -> Iterator[str]:
        return iter(self.defaults)

    def parse(self, settings: Iterable[str]) -> dict[str, Value]:
        """Read "key=value" texts.

        Raises:
            InputError: for a text without "=", an unknown key, a key given twice or a value that it does not take.
        """
        overrides: dict[str, Value] = {}
        for setting in settings:
            name, equals, text = (part.strip() for part in setting.partition("="))
            require(bool(equals) and bool(name), "--set", setting, "key=value")
            key = self._key(name)
            require(name not in overrides, name, setting, "given once")
            overrides[name] = key.parse(name, text)
        return overrides

    def values(self, overrides: Mapping[str, Value] | None = None) -> Values:
        """The defaults with some values replaced.

        Raises:
            InputError: for an unknown key or a value that it does not take.
        """
        checked = {name: self._key(name).check(name, value) for name, value in (overrides or {}).items()}
        return Values({**self.defaults, **checked})

    def _key(self, name: str) -> Key:
        if name in self.keys:
            return self.keys[name]
        near = difflib.get_close_matches(name, self.keys, n=3)
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        raise InputError(f"unknown key {name!r}: {hint}this scene has {', '.join(self.keys)}")


def declare(**given: Value | tuple[Value, Key]) -> Parameters:
    """Declare a scene's parameters.

    Args:
        **given: `key=value` for a key of `KEYS`; `key=(value, Key(unit, meaning, ...))` for one of the scene's own.

    Returns:
        The given parameters, and those that every scene has with their usual values; those of a foam, which has
        `border`, are without what only single films use.

    Raises:
        InputError: for an unknown key or a value that it does not take.
    """
    own = {name: value for name, value in given.items() if isinstance(value, tuple)}
    taken = sorted(set(own) & set(KEYS))
    require(not taken, "a scene's own key", ", ".join(taken), "none of the common keys")
    known = {**KEYS, **{name: key for name, (_, key) in own.items()}}
    wanted = {**_common_defaults("border" in given), **{name: v[0] if name in own else v for name, v in given.items()}}
    listed = Parameters({}, known)
    defaults = {name: listed._key(name).check(name, value) for name, value in wanted.items()}
    order = [*(name for name in known if name in defaults)]
    return Parameters(
        MappingProxyType({name: defaults[name] for name in order}),
        MappingProxyType({name: known[name] for name in order}),
    )
