"""The cache checker: it is silent on a sound cache, and every rule finds its fault."""

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdValidation, Vt

from melp_warp.frame import ParticleFrame
from melp_warp.optics import display_color
from melp_warp.usd.cache import CacheWriter
from melp_warp.usd.check import check_cache
from melp_warp.usd.schema import frame_path

COUNT = 30
FILM = "/World/Film"
FRAME_1 = "frames/film.000001.usdc"
UNEVEN = "not one sample for each frame"
ELSEWHERE = "values from outside the frames"


def make_frame(count=COUNT):
    rng = np.random.default_rng(count)
    normals = rng.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return ParticleFrame(
        points=(0.05 * normals).astype(np.float32),
        velocities=rng.normal(size=(count, 3)).astype(np.float32),
        ids=np.arange(count),
        widths=np.full(count, 1e-3, np.float32),
        normals=normals.astype(np.float32),
        thickness=rng.uniform(5, 1200, count).astype(np.float32),
        region=np.zeros(count, np.int32),
        black_film=np.zeros(count, np.int32),
    )


@pytest.fixture
def cache(tmp_path):
    """Frames 0 to 3."""
    writer = CacheWriter(tmp_path / "run", 24.0, {"scene": "test", "seed": 1})
    for number in range(4):
        writer.write(number, {"Film": make_frame()})
    return tmp_path / "run"


def edit(path, change):
    """Rewrite a layer of the cache."""
    layer = Sdf.Layer.OpenAsAnonymous(str(path))
    change(layer)
    layer.Export(str(path))


def sample(name, change):
    """A fault: the array of one attribute in frame 1 becomes `change(array)`."""

    def apply(cache):
        def change_layer(layer):
            path = f"{FILM}.{name}"
            value = layer.QueryTimeSample(path, 1.0)
            array = np.ascontiguousarray(change(np.array(value)))
            layer.SetTimeSample(path, 1.0, type(value).FromNumpy(array))

        edit(frame_path(cache, 1), change_layer)

    return apply


def put(index, value):
    def change(array):
        array[index] = value
        return array

    return change


def in_frame(change):
    return lambda cache: edit(frame_path(cache, 1), change)


def in_root(change):
    return lambda cache: edit(cache / "film.usda", change)


def in_manifest(change):
    return lambda cache: edit(cache / "film.manifest.usda", change)


def set_info(path, key, value):
    def change(layer):
        layer.GetObjectAtPath(path).SetInfo(key, value)

    return change


def set_layer(name, value):
    return lambda layer: setattr(layer, name, value)


def remove(path):
    def change(layer):
        spec = layer.GetAttributeAtPath(path)
        spec.owner.RemoveProperty(spec)

    return change


def clear_samples(path):
    def change(layer):
        for time in layer.ListTimeSamplesForPath(path):
            layer.EraseTimeSample(path, time)

    return change


def set_clips(**changes):
    def change(layer):
        film = layer.GetPrimAtPath(FILM)
        clips = dict(film.GetInfo("clips")["default"]) | changes
        film.SetInfo("clips", {"default": clips})

    return change


def set_metadata(**changes):
    def change(layer):
        data = dict(layer.customLayerData["melpWarp"]) | changes
        layer.customLayerData = {"melpWarp": {key: value for key, value in data.items() if value is not None}}

    return change


def retype(path, type_name):
    """Replace an attribute by one of another type without samples."""

    def change(layer):
        spec = layer.GetAttributeAtPath(path)
        owner, name = spec.owner, spec.name
        owner.RemoveProperty(spec)
        Sdf.AttributeSpec(owner, name, Sdf.ValueTypeNames.Find(type_name))

    return change


def clear_start(layer):
    layer.ClearStartTimeCode()


def drop_clips(layer):
    layer.GetPrimAtPath(FILM).ClearInfo("clips")


def unbind(layer):
    film = layer.GetPrimAtPath(FILM)
    film.RemoveProperty(film.relationships["material:binding"])


def test_a_sound_cache_has_no_problems(cache):
    assert check_cache(cache) == []


def test_a_sound_cache_with_an_empty_frame(cache):
    writer = CacheWriter(cache.parent / "other", 24.0, {"scene": "test", "seed": 1}, ("Film", "FilmE"))
    for number, count in enumerate((3, 0, 1)):
        writer.write(number, {"Film": make_frame(count), "FilmE": make_frame(2 * count)})
    assert check_cache(cache.parent / "other") == []


def test_usd_validators_report_nothing(cache):
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 20
    for path in (cache / "film.usda", frame_path(cache, 2)):
        assert not UsdValidation.ValidationContext(validators).Validate(Usd.Stage.Open(str(path)))


ARRAY_FAULTS = {
    "widths of another count": (
        sample("widths", lambda a: a[:-1]),
        [f"{FRAME_1}: {FILM}.widths: 29 values for 30 points"],
    ),
    "colours of another count": (
        sample("primvars:displayColor", lambda a: np.vstack([a, a[:1]])),
        [f"{FRAME_1}: {FILM}.primvars:displayColor: 31 values for 30 points"],
    ),
    "points not a number": (
        sample("points", put((4, 1), np.nan)),
        [f"{FRAME_1}: {FILM}.points: not finite in 1 entries, first at 4"],
    ),
    "velocities infinite": (
        sample("velocities", put((slice(3, 5), 0), np.inf)),
        [f"{FRAME_1}: {FILM}.velocities: not finite in 2 entries, first at 3"],
    ),
    "colours not finite": (
        sample("primvars:displayColor", put((29, 2), -np.inf)),
        [f"{FRAME_1}: {FILM}.primvars:displayColor: not finite in 1 entries, first at 29"],
    ),
    "ids unsorted": (
        sample("ids", lambda a: a[::-1]),
        [f"{FRAME_1}: {FILM}.ids: not in ascending order, first at entry 1"],
    ),
    "ids twice": (
        sample("ids", put(8, 7)),
        [f"{FRAME_1}: {FILM}.ids: id 7 occurs 2 times"],
    ),
    "ids unsorted and twice": (
        sample("ids", put(8, 2)),
        [
            f"{FRAME_1}: {FILM}.ids: not in ascending order, first at entry 8",
            f"{FRAME_1}: {FILM}.ids: id 2 occurs 2 times",
        ],
    ),
    "region negative": (
        sample("primvars:region", put(3, -1)),
        [f"{FRAME_1}: {FILM}.primvars:region: negative in 1 entries, first at 3"],
    ),
    "black film neither 0 nor 1": (
        sample("primvars:blackFilm", put(2, 255)),
        [f"{FRAME_1}: {FILM}.primvars:blackFilm: neither 0 nor 1 in 1 entries, first at 2"],
    ),
    "colours beyond the gamut": (
        sample("primvars:displayColor", put((6, 0), 1.01)),
        [f"{FRAME_1}: {FILM}.primvars:displayColor: outside 0..1 in 1 entries, first at 6"],
    ),
    "colours of another thickness": (
        sample("primvars:displayColor", lambda a: np.repeat(display_color([900.0]), len(a), axis=0)),
        [f"{FRAME_1}: {FILM}.primvars:displayColor: off by up to "],
    ),
    "extent without widths": (
        sample("extent", lambda a: a * np.float32(0.99)),
        [f"{FRAME_1}: {FILM}.extent: is "],
    ),
    "extent of one vector": (
        sample("extent", lambda a: a[:1]),
        [f"{FRAME_1}: {FILM}.extent: has 1 vectors, must have 2"],
    ),
    "normals not unit": (
        sample("normals", put(5, [0.0, 0.0, 0.999])),
        [f"{FRAME_1}: {FILM}.normals: not of unit length in 1 entries, first at 5: length 0.999"],
    ),
    "negative widths": (
        sample("widths", put(0, -1e-9)),
        [f"{FRAME_1}: {FILM}.widths: negative in 1 entries, first at 0"],
    ),
    "negative thickness": (
        sample("primvars:thickness", put(9, -1.0)),
        [f"{FRAME_1}: {FILM}.primvars:thickness: negative in 1 entries, first at 9"],
    ),
}

FRAME_FAULTS = {
    "attribute missing": (
        in_frame(remove(f"{FILM}.velocities")),
        [f"{FRAME_1}: {FILM}.velocities: missing"],
    ),
    "extent missing": (
        in_frame(remove(f"{FILM}.extent")),
        [f"{FRAME_1}: {FILM}.extent: missing"],
    ),
    "attribute without a sample": (
        in_frame(clear_samples(f"{FILM}.ids")),
        [f"{FRAME_1}: {FILM}.ids: has samples at [], must have one at 1"],
    ),
    "sample at another time": (
        in_frame(lambda layer: layer.SetTimeSample(f"{FILM}.ids", 7.0, Vt.Int64Array([1]))),
        [f"{FRAME_1}: {FILM}.ids: has samples at [1.0, 7.0], must have one at 1"],
    ),
    "default in a frame": (
        in_frame(set_info(f"{FILM}.widths", "default", Vt.FloatArray([1.0]))),
        [f"{FRAME_1}: {FILM}.widths: has a default value"],
    ),
    "interpolation": (
        in_frame(set_info(f"{FILM}.widths", "interpolation", "constant")),
        [f"{FRAME_1}: {FILM}.widths: interpolation: is 'constant', must be 'vertex'"],
    ),
    "frame rate": (
        in_frame(set_layer("framesPerSecond", 25.0)),
        [f"{FRAME_1}: framesPerSecond: is 25.0, must be 24.0"],
    ),
    "time codes": (
        in_frame(set_layer("timeCodesPerSecond", 1.0)),
        [f"{FRAME_1}: timeCodesPerSecond: is 1.0, must be 24.0"],
    ),
    "start": (in_frame(set_layer("startTimeCode", 0.0)), [f"{FRAME_1}: startTimeCode: is 0.0, must be 1.0"]),
    "end": (in_frame(set_layer("endTimeCode", 2.0)), [f"{FRAME_1}: endTimeCode: is 2.0, must be 1.0"]),
    "scale": (in_frame(set_info("/", "metersPerUnit", 0.01)), [f"{FRAME_1}: metersPerUnit: is 0.01, must be 1.0"]),
    "up": (in_frame(set_info("/", "upAxis", "Z")), [f"{FRAME_1}: upAxis: is 'Z', must be 'Y'"]),
    "default prim": (in_frame(set_layer("defaultPrim", "Film")), [f"{FRAME_1}: defaultPrim: is 'Film'"]),
    "thickness unit": (
        in_frame(set_metadata(thicknessUnit="um")),
        [f"{FRAME_1}: melpWarp.thicknessUnit: is 'um', must be 'nm'"],
    ),
}

ROOT_FAULTS = {
    "default hides the clips": (
        in_root(set_info(f"{FILM}.widths", "default", Vt.FloatArray([1.0]))),
        [
            "film.usda: /World/Film.widths: has a default value, which hides the frames",
            f"film.usda: {FILM}: widths: the stage has {UNEVEN}",
        ],
    ),
    "samples hide the clips": (
        in_root(lambda layer: [layer.SetTimeSample(f"{FILM}.ids", float(t), Vt.Int64Array([1])) for t in range(4)]),
        [
            "film.usda: /World/Film.ids: has time samples, which hide the frames",
            f"film.usda: {FILM}: ids: the stage has {ELSEWHERE}",
        ],
    ),
    "undeclared attribute": (
        in_root(remove(f"{FILM}.primvars:thickness")),
        [
            "film.usda: /World/Film.primvars:thickness: missing",
            f"film.usda: {FILM}: primvars:thickness: the stage has {UNEVEN}",
        ],
    ),
    "interpolation": (
        in_root(set_info(f"{FILM}.widths", "interpolation", "varying")),
        ["film.usda: /World/Film.widths: interpolation: is 'varying', must be 'vertex'"],
    ),
    "type": (
        in_root(retype(f"{FILM}.points", "float3[]")),
        [
            "film.usda: /World/Film.points: type: is 'float3[]', must be 'point3f[]'",
            "film.usda: UsdValidation: Error: (usdValidation:AttributeTypeMismatch",
        ],
    ),
    "rate of the root": (
        in_root(set_layer("timeCodesPerSecond", 30.0)),
        ["film.usda: timeCodesPerSecond: is 30.0, must be 24.0"],
    ),
    "no start": (
        in_root(clear_start),
        ["film.usda: startTimeCode or endTimeCode is missing"],
    ),
    "end before the frames": (
        in_root(lambda layer: (set_layer("endTimeCode", 1.0)(layer), set_clips(templateEndTime=1.0)(layer))),
        ["frames/film.000003.usdc: outside the range 0 to 1 of film.usda"],
    ),
    "clips shorter than the range": (
        in_root(set_clips(templateEndTime=2.0)),
        ["film.usda: /World/Film: clips templateEndTime: is 2.0, must be 3.0"],
    ),
    "active offset": (
        in_root(set_clips(templateActiveOffset=0.5)),
        ["film.usda: /World/Film: clips templateActiveOffset: is 0.5, must be None"],
    ),
    "no manifest named": (
        in_root(set_clips(manifestAssetPath=Sdf.AssetPath())),
        [
            "film.usda: /World/Film: clips manifestAssetPath: is '', must be './film.manifest.usda'",
        ],
    ),
    "no clips": (
        in_root(drop_clips),
        ["film.usda: /World/Film: has no value clips"],
    ),
    "no material": (in_root(unbind), ["film.usda: /World/Film.material:binding: names no material"]),
    "kind": (in_root(set_info("/World", "kind", "group")), ["film.usda: /World: kind: is 'group', must be"]),
    "thickness unit": (
        in_root(set_metadata(thicknessUnit="um")),
        ["film.usda: melpWarp.thicknessUnit: is 'um', must be 'nm'"],
    ),
    "schema": (in_root(set_metadata(schemaVersion=1)), ["film.usda: melpWarp.schemaVersion: is 1, must be 3"]),
    "no gain": (in_root(set_metadata(colorGain=None)), ["film.usda: melpWarp.colorGain: missing from customLayerData"]),
    "attribute not in the manifest": (
        in_manifest(remove(f"{FILM}.velocities")),
        [
            "film.manifest.usda: /World/Film.velocities: missing",
            f"film.usda: {FILM}: velocities: the stage has {UNEVEN}",
        ],
    ),
}

FAULTS = {
    f"{group}: {name}": fault
    for group, faults in (("array", ARRAY_FAULTS), ("frame", FRAME_FAULTS), ("root", ROOT_FAULTS))
    for name, fault in faults.items()
}


@pytest.mark.parametrize("name", FAULTS)
def test_every_fault_is_found_and_nothing_else(cache, name):
    fault, expected = FAULTS[name]
    fault(cache)
    found = check_cache(cache)
    assert len(found) == len(expected), found
    for line, start in zip(found, expected, strict=True):
        assert line.startswith(start)
        assert "\n" not in line


@pytest.mark.parametrize(("scale", "median"), [(1e-9, "e-07"), (1e-3, "0."), (1e3, "e+05")])
def test_thickness_in_another_unit(cache, scale, median):
    """Metres, micrometres and picometres in place of nanometres."""
    sample("primvars:thickness", lambda a: a * np.float32(scale))(cache)
    lines = [line for line in check_cache(cache) if ".primvars:thickness" in line]
    assert len(lines) == 1
    assert "is not within 1 to 100000 nanometres: is the unit wrong?" in lines[0]
    assert median in lines[0]


def test_missing_frames(cache):
    frame_path(cache, 2).unlink()
    assert check_cache(cache)[0] == "frames/film.000002.usdc: missing, the range is 0 to 3"


def test_truncated_frame(cache):
    path = frame_path(cache, 2)
    path.write_bytes(path.read_bytes()[:-64])
    found = check_cache(cache)
    assert len(found) == 1
    assert found[0].startswith("frames/film.000002.usdc: ")
    assert "cannot be opened: " in found[0]


def test_leftovers(cache):
    (cache / ".film.tmp.usda").write_text("")
    (cache / "frames" / ".film.000004.tmp.usdc").write_text("")
    end = ": left over from a write that did not finish; it can be deleted"
    assert check_cache(cache) == [f".film.tmp.usda{end}", f"frames/.film.000004.tmp.usdc{end}"]


def test_missing_layers(cache):
    (cache / "film.manifest.usda").unlink()
    assert any(line.startswith("film.manifest.usda: there is no file") for line in check_cache(cache))
    (cache / "film.usda").write_text("not USD")
    found = check_cache(cache)
    assert len(found) == 1
    assert found[0].startswith("film.usda: ")
    assert check_cache(cache / "nothing") == [f"film.usda: there is no file {cache / 'nothing' / 'film.usda'}"]


def test_another_file_pattern(cache):
    in_root(set_clips(templateAssetPath="./frames/film.####.usdc"))(cache)
    (found,) = check_cache(cache)
    assert found.startswith("film.usda: /World/Film: clips templateAssetPath: is './frames/film.####.usdc', must be ")


def test_what_is_taken_from_elsewhere_is_named_and_not_opened(cache):
    """A stage over such a root could open any file there is."""
    in_root(lambda layer: layer.subLayerPaths.append("./nothing.usda"))(cache)
    assert check_cache(cache) == ["film.usda: refers to file ./nothing.usda, which no cache does"]


def test_no_film_in_the_root(cache):
    def drop(layer):
        world = layer.GetPrimAtPath("/World")
        del world.nameChildren["Film"]

    in_root(drop)(cache)
    assert "film.usda: /World/Film: no such point prim" in check_cache(cache)
