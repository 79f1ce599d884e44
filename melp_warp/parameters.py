"""Scene parameters: one registry of keys, so that a quantity has the same name, unit and meaning in every scene."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType

from melp_warp.bursting import Bursting, Puncture
from melp_warp.errors import InputError, require
from melp_warp.keys import Key, Value, at_least_zero, count, keys_of, positive
from melp_warp.material import THICKNESS, Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.scene import Scene
from melp_warp.shapes import Shape

__all__ = ["FOAM", "KEYS", "Key", "Parameters", "Value", "Values", "declare"]

_SIZE = (5e-4, 1.0)


def _radius(meaning: str) -> Key:
    return Key("m", meaning, 1e-4, 10.0, spoken="cm", usual=_SIZE)


def _thickness(meaning: str) -> Key:
    return replace(THICKNESS, meaning=meaning)


_OF_SHAPES = {
    "radius": _radius("radius of the film at rest"),
    "width": Key("m", "width of the film", 1e-4, 100.0, spoken="cm", usual=(1e-3, 10.0)),
    "height": Key("m", "height of the film, along its slope", 1e-4, 100.0, spoken="cm", usual=(1e-3, 10.0)),
    "tilt": Key("degrees", "lean of the film: 0 vertical, 90 lying flat", -180.0, 180.0),
    "mode": count("number n of the Legendre mode P_n of the initial shape", 2, 20),
    "amplitude": Key("-", "displacement of the initial shape, relative to radius", -0.5, 0.5, spoken="%"),
    "displacement": at_least_zero(
        "m", "scale of the noise that displaces the initial shape", 10.0, spoken="cm", usual=(0.0, 1.0)
    ),
    "displacement_frequency": positive("1/m", "noise cells per metre of the displacement", 1e4),
    "displacement_octaves": count("octaves of the displacement's noise", 1, 8),
}
_OF_FOAMS = {
    "radius_1": _radius("radius of the first bubble"),
    "radius_2": _radius("radius of the second bubble"),
    "radius_low": _radius("radius of the smallest bubble"),
    "radius_high": _radius("radius of the largest bubble"),
    "thickness_1": _thickness("thickness of the first bubble's film"),
    "thickness_2": _thickness("thickness of the second bubble's film"),
    "bubbles": count("number of bubbles", 1, 10_000),
    "gap": at_least_zero("spacings", "distance between neighbouring bubbles at the start, in E spacings", 100.0),
    "approach_speed": Key("m/s", "speed of each bubble towards the middle at the start", -100.0, 100.0),
    "tension_spread": at_least_zero("-", "difference of surface tension between bubbles, relative", 0.5, spoken="%"),
    "pop_time": Key("s", "time at which a bubble pops (auto: never)", 0.0, 1e6, auto=True),
    "merge_time": Key("s", "time at which a partition breaks (auto: never)", 0.0, 1e6, auto=True),
}
_OF_HOLES = {
    "puncture_time": Key("s", "time at which the film is punctured (auto: never)", 0.0, 1e6, auto=True, spoken="ms"),
    "growth": positive("-", "radius to which the bubble is blown up, over that at the start", 10.0),
    "growth_time": positive("s", "time in which it is blown up", 1e6, spoken="ms"),
    "hole": positive("m", "radius of a hole at the start", 10.0, spoken="mm"),
}
_OF_FIELDS = {
    "noise": Key("-", "unevenness of the initial thickness, relative to thickness", 0.0, 0.95, spoken="%"),
    "noise_frequency": positive("1/m", "noise cells per metre of the initial thickness", 1e4),
    "noise_octaves": count("octaves of the initial thickness's noise", 1, 8),
    "swirl": at_least_zero("m/s", "typical speed of the initial whirls along the film", 100.0),
    "separation": positive("m", "distance between the two vortex centres", 100.0),
    "vortex_radius": positive("m", "core radius a of a vortex, where its speed is largest", 100.0),
    "vortex_speed": Key("m/s", "speed of a vortex at vortex_radius", -100.0, 100.0),
}

KEYS: Mapping[str, Key] = MappingProxyType(
    {
        **_OF_SHAPES,
        **_OF_FOAMS,
        **_OF_HOLES,
        **_OF_FIELDS,
        **keys_of(Material),
        **keys_of(Surroundings),
        **keys_of(Scene),
        **keys_of(Numerics),
        **keys_of(Bursting),
    }
)
"""Every key that a scene may have: those of initial shapes and fields, and the fields of the data classes."""

_MATERIAL = tuple(keys_of(Material))
_FOAM_NUMERICS = ("border", "exchange")
_SINGLE_FILM_NUMERICS = ("layers", "scheme", "curvature", "gradient")
_NUMERICS = tuple(name for name in keys_of(Numerics) if name not in _FOAM_NUMERICS)
_SURROUNDINGS = ("pressure", "air", "air_density", "air_drag", "drag")
_RUN = tuple(name for name in keys_of(Scene) if name != "opening")
_BURSTING = tuple(keys_of(Bursting))

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
    material, surroundings, numerics, bursting = Material(), Surroundings(), Numerics(), Bursting()
    of_numerics = (name for name in _NUMERICS if not (foam and name in _SINGLE_FILM_NUMERICS))
    return {
        **{name: getattr(material, name) for name in _MATERIAL},
        "gravity": 0.0,
        **{name: getattr(surroundings, name) for name in _SURROUNDINGS},
        **{"e_count": 2000, "l_per_e": 16, "seed": 0, "frames": 100, "fps": 60.0, "dt": None},
        **{"slow_motion": 1.0, "slow_from": 0.0, "slow_until": None, "show": "nothing"},
        **{name: getattr(numerics, name) for name in of_numerics},
        **{name: getattr(bursting, name) for name in _BURSTING},
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

    def bursting(self, punctures: Iterable[Puncture] = ()) -> Bursting:
        """How the film bursts: `punctures`, and by itself."""
        return Bursting(tuple(punctures), **{name: self._values[name] for name in _BURSTING if name in self._values})

    def scene(self, name: str, shape: Shape, punctures: Iterable[Puncture] = (), **initial) -> Scene:
        """Put a scene together.

        Args:
            name: the scene's name.
            shape: the film's geometry.
            punctures: holes that are made in it.
            **initial: the initial fields `thickness`, `concentration` and `velocity` of `Scene`, its `gas` and `waves`.

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
            bursting=self.bursting(punctures),
            **{key: self._values[key] for key in (*_RUN, "opening") if key in self._values},
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

    def doubts(self, values: Mapping[str, Value]) -> list[str]:
        """What is odd about values that are allowed, a line each: a radius of 10 m, a temperature of 25 K."""
        return [doubt for name, value in values.items() if (doubt := self.keys[name].doubt(name, value))]

    def _key(self, name: str) -> Key:
        if name in self.keys:
            return self.keys[name]
        near = difflib.get_close_matches(name, self.keys, n=3)
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        raise InputError(f"unknown key {name!r}: {hint}`melp-warp scenes NAME` lists what a scene has")


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
