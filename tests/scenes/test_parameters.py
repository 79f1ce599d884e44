"""Keys: the same everywhere, read strictly."""

import math
from dataclasses import fields

import pytest

from melp_warp.errors import InputError
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.parameters import KEYS, Key, declare
from melp_warp.registry import load_scene, scene_names
from melp_warp.scene import Scene
from melp_warp.shapes import Sphere
from melp_warp.units import convert


def test_every_number_of_the_data_classes_is_a_key():
    for cls in (Material, Numerics, Surroundings):
        assert {field.name for field in fields(cls)} <= set(KEYS)


def test_defaults_are_those_of_the_data_classes():
    values = declare().values()
    assert values.material == Material()
    assert values.numerics == Numerics()
    assert values.surroundings == Surroundings()


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("thickness=400e-9", 400e-9),
        (" thickness = 4e-7 ", 4e-7),
        ("e_count=1e3", 1000),
        ("e_count=12", 12),
        ("air=added_mass", "added_mass"),
        ("dt=auto", None),
        ("dt=0.01", 0.01),
        ("amplitude=-0.1", -0.1),
        ("thickness=400nm", 400e-9),
        ("thickness=0.4 um", 0.4e-6),
        ("thickness=0.4µm", 0.4e-6),
        ("tension=72.8mN/m", 72.8e-3),
        ("density=1g/cm^3", 1000.0),
        ("temperature=25degC", 298.15),
        ("surfactant=0.1 umol/m^2", 1e-7),
        ("viscosity=1cSt", 1e-6),
        ("drag=1 mPa s/m", 1e-3),
        ("pressure=1atm", 101325.0),
        ("gravity=981cm/s2", 9.81),
        ("amplitude=-10%", -0.1),
        ("fps=24Hz", 24.0),
        ("fps=24fps", 24.0),
        ("dt=2ms", 0.002),
        ("dt=0.5e-3s", 0.0005),
        ("support=3spacings", 3.0),
    ],
)
def test_reads(text, value):
    parameters = declare(amplitude=0.1)
    ((name, read),) = parameters.parse([text]).items()
    assert read == value
    assert type(read) is type(value)
    assert getattr(parameters.values({name: read}), name) == value


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("thicknes=1e-7", ["unknown key 'thicknes': did you mean thickness", "melp-warp scenes"]),
        ("mode=2", ["unknown key 'mode'"]),
        ("thickness", ["--set", "key=value", "'thickness'"]),
        ("=3", ["key=value"]),
        ("thickness=", ["thickness must be", "''"]),
        ("thickness=thin", ["thickness must be a number from 1e-09 to 0.0001 m", "'thin'"]),
        ("thickness=0", ["thickness must be", "from 1e-09", "0.0"]),
        ("thickness=-4e-7", ["thickness must be", "from 1e-09", "got -4e-7"]),
        ("thickness=400", ["thickness must be", "to 0.0001 m, got 400: 400 nm is 400nm or 4e-7"]),
        ("thickness=400nm2", ["thickness must be", "'nm2' is no unit of m"]),
        ("thickness=2cm", ["thickness must be", "got 0.02"]),
        ("radius=3kg", ["radius must be", "'kg' is no unit of m"]),
        ("noise=18", ["noise must be", "18 % is 18% or 0.18"]),
        ("noise=1m", ["noise must be", "'m' is a unit, and this is a plain number"]),
        ("e_count=2 k", ["e_count must be a whole number"]),
        ("dt=1/60", ["dt must be"]),
        ("dt=16", ["dt must be", "16 ms is 16ms or 0.016"]),
        ("tension=72.8", ["72.8 mN/m is 72.8mN/m or 0.0728"]),
        ("tension=0", ["tension must be a number above 0 and at most 10 N/m"]),
        ("radius=0", ["radius must be", "from 0.0001"]),
        ("radius=-1", ["radius must be", "from 0.0001", "-1"]),
        ("gravity=nan", ["gravity must be", "nan"]),
        ("gravity=inf", ["gravity must be", "inf"]),
        ("dt=nan", ["dt must be", "auto", "nan"]),
        ("e_count=0", ["e_count must be a whole number from 12"]),
        ("e_count=-5", ["e_count must be a whole number from 12 to 10000000, got -5"]),
        ("frames=1000000", ["frames must be a whole number from 0 to 999999, got 1000000"]),
        ("e_count=10.5", ["e_count must be a whole number", "10.5"]),
        ("e_count=many", ["e_count must be a whole number", "'many'"]),
        ("seed=-1", ["seed must be a whole number from 0"]),
        ("frames=-1", ["frames must be a whole number from 0"]),
        ("fps=0", ["fps must be", "above 0"]),
        ("air=vacuum", ["air must be one of none, added_mass", "'vacuum'"]),
        ("l_order=3", ["l_order must be a whole number from 1 to 2"]),
    ],
)
def test_refuses(text, words):
    with pytest.raises(InputError) as error:
        declare(radius=0.1, noise=0.1).parse([text])
    for word in words:
        assert word in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("text", "doubt"),
    [
        (
            "radius=10",
            "radius=10: 10 m is unusual for the radius of the film at rest (0.0005 to 1); 10 cm is 10cm or 0.1",
        ),
        ("radius=10m", "radius=10: 10 m is unusual"),
        (
            "temperature=25",
            "temperature=25: 25 K is unusual for the temperature (200 to 400); 25 degC is 25degC or 298.15",
        ),
        ("density=1", "; 1 g/cm^3 is 1g/cm^3 or 1000"),
        ("surfactant=1e-4", "(0 to 3e-05)"),
        ("radius=0.1", ""),
        ("radius=10cm", ""),
        ("dt=auto", ""),
        ("air=added_mass", ""),
    ],
)
def test_what_is_odd_is_named(text, doubt):
    parameters = declare(radius=0.1)
    doubts = parameters.doubts(parameters.parse([text]))
    assert len(doubts) == bool(doubt)
    assert doubt in "".join(doubts)
    assert "0.0001 umol" not in "".join(doubts)


def test_a_scenes_own_numbers_are_not_odd():
    for name in scene_names():
        parameters = load_scene(name).parameters
        assert parameters.doubts(parameters.defaults) == [], name


@pytest.mark.parametrize(
    ("number", "unit", "wanted", "value"),
    [
        (1, "N", "Pa", None),
        (1, "N/m^2", "Pa", 1),
        (1, "kg/m/s^2", "Pa", 1),
        (3, "1/cm", "1/m", 300),
        (3, "/cm", "1/m", 300),
        (180, "degrees", "degrees", 180),
        (math.pi, "rad", "degrees", 180),
        (1, "rad", "-", None),
        (1, "%", "degrees", None),
        (1, "m//s", "m/s", None),
        (1, "m/", "m", None),
        (1, "", "m", None),
        (1, "mmm", "m", None),
        (1, "m s", "s m", 1),
        (1e308, "km", "m", None),
        (0, "degC", "K", 273.15),
    ],
)
def test_units(number, unit, wanted, value):
    converted = convert(float(number), unit, wanted)
    assert converted == value or converted == pytest.approx(value, rel=1e-15)


def test_every_unit_of_a_key_can_be_typed():
    for name, key in KEYS.items():
        if not key.choices:
            assert convert(1.0, key.unit.replace("-", "1"), key.unit) == 1.0, name
        assert not key.spoken or convert(1.0, key.spoken, key.unit) is not None, name


def test_a_range_holds_in_python_too():
    """As it stands once: with the field."""
    for make in (
        lambda: Material(thickness=400.0),
        lambda: Material(density=float("nan")),
        lambda: Numerics(support=9.0),
        lambda: Numerics(scheme="leapfrog"),
        lambda: Surroundings(drag=-1.0),
        lambda: Surroundings(gravity=(0.0, -2000.0, 0.0)),
        lambda: Surroundings(gravity=(0.0, 1.0)),
        lambda: Scene("x", Sphere(0.1), e_count=11),
        lambda: Scene("x", Sphere(0.1), e_count=100.5),
        lambda: Scene("x", Sphere(0.1), e_count=100, frames=1_000_000),
    ):
        with pytest.raises(InputError):
            make()


def test_a_key_given_twice_is_refused():
    with pytest.raises(InputError, match="seed must be given once"):
        declare().parse(["seed=1", "seed=2"])


@pytest.mark.parametrize("bad", [{"radius": "big"}, {"radius": None}, {"radius": True}, {"e_count": 1.5}, {"wings": 2}])
def test_declare_refuses(bad):
    with pytest.raises(InputError, match=next(iter(bad))):
        declare(**bad)


def test_a_scene_may_have_keys_of_its_own():
    parameters = declare(radius=0.1, ripple=(0.01, Key("m", "height of the ripples", 0.0, 1.0)))
    assert parameters.values(parameters.parse(["ripple=0.5"])).ripple == 0.5
    with pytest.raises(InputError, match="ripple must be a number from 0 to 1 m"):
        parameters.parse(["ripple=2"])
    with pytest.raises(InputError, match="none of the common keys"):
        declare(radius=(0.1, Key("m", "something else")))


def test_scene_gets_every_value():
    parameters = declare(radius=0.1, lift=0.5)
    p = parameters.values({"gravity": 9.81, "e_count": 70, "frames": 3, "dt": 0.5, "cfl": 0.2, "density": 900.0})
    scene = p.scene("test", Sphere(p.radius))
    assert scene.surroundings.gravity == (0.0, -9.81, 0.0)
    assert scene.surroundings.lift == 0.5
    assert (scene.e_count, scene.frames, scene.dt) == (70, 3, 0.5)
    assert (scene.numerics.cfl, scene.material.density) == (0.2, 900.0)


def test_a_value_that_is_not_declared_is_named():
    with pytest.raises(AttributeError, match="declares no parameter 'height'"):
        _ = declare().values().height


def test_a_script_makes_scenes_of_numbers_and_texts():
    scene = load_scene("giant_bubble").scene(radius=0.05, displacement="1cm", thickness="400nm", air="none", dt="auto")
    assert (scene.shape.radius, scene.material.thickness, scene.surroundings.air, scene.dt) == (
        0.05,
        4e-7,
        "none",
        None,
    )
    with pytest.raises(InputError, match="unknown key 'radios': did you mean radius"):
        load_scene("giant_bubble").scene(radios=1.0)
