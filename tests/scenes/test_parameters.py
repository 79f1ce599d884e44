"""Keys: the same everywhere, read strictly."""

from dataclasses import fields

import pytest

from melp_warp.errors import InputError
from melp_warp.material import Material, Surroundings
from melp_warp.numerics import Numerics
from melp_warp.parameters import KEYS, Key, declare
from melp_warp.shapes import Sphere


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
        ("thicknes=1e-7", ["unknown key 'thicknes'", "did you mean thickness", "e_count"]),
        ("mode=2", ["unknown key 'mode'"]),
        ("thickness", ["--set", "key=value", "'thickness'"]),
        ("=3", ["key=value"]),
        ("thickness=", ["thickness must be", "''"]),
        ("thickness=thin", ["thickness must be a number from 1e-09 to 0.0001 m", "'thin'"]),
        ("thickness=0", ["thickness must be", "from 1e-09", "0.0"]),
        ("thickness=-4e-7", ["thickness must be", "from 1e-09", "-4e-07"]),
        ("thickness=400", ["thickness must be", "to 0.0001 m", "400"]),
        ("tension=0", ["tension must be a number above 0 and at most 10 N/m"]),
        ("radius=0", ["radius must be", "from 0.0001"]),
        ("radius=-1", ["radius must be", "from 0.0001", "-1"]),
        ("gravity=nan", ["gravity must be", "nan"]),
        ("gravity=inf", ["gravity must be", "inf"]),
        ("dt=nan", ["dt must be", "auto", "nan"]),
        ("e_count=0", ["e_count must be a whole number from 12"]),
        ("e_count=-5", ["e_count must be a whole number from 12"]),
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
        declare(radius=0.1).parse([text])
    for word in words:
        assert word in str(error.value)
    assert "\n" not in str(error.value)


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
