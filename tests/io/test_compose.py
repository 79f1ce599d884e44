"""A cache referenced, instanced, paid, moved in time: every way to bring it into a scene gives exact values."""

import numpy as np
import pytest
from pxr import Sdf, Usd, UsdGeom

from melp_warp.frame import MeshFrame, WholeFrame
from melp_warp.usd.cache import CacheWriter
from melp_warp.usd.forms import flatten, write_stage
from melp_warp.usd.reading import read_frame, read_mesh, read_whole
from melp_warp.usd.schema import ATTRIBUTES, MESH_ATTRIBUTES, WHOLE, attributes_of
from tests.io.test_usd import make_frame

FIRST = 1001
PRIMS = ("Film", "FilmE", "FilmSurface/Region_0", "FilmSurface/Region_3", WHOLE)
COUNTS = (7, 9, 9, 0, 5)
LAST = FIRST + len(COUNTS) - 1


def make_mesh(number):
    """A tetrahedron that grows; another one from frame 2 on has two more corners."""
    n = 4 if number < 2 else 6
    rng = np.random.default_rng(number)
    points = rng.normal(size=(n, 3)).astype(np.float32)
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32)
    values = rng.uniform(100, 900, n).astype(np.float32)
    return MeshFrame(points, 2.0 * points, points, values, np.zeros(n, np.int32), faces)


def make_shared(number):
    """The same tetrahedron with values at the corners of its faces, parted from another region by one of these."""
    mesh = make_mesh(number)
    at, sides = mesh.faces.reshape(-1), np.array([0, 0, 0, 0], np.int32)
    values = np.random.default_rng(number).uniform(100, 900, len(at)).astype(np.float32)
    return WholeFrame(
        *(mesh.points, mesh.velocities, mesh.normals[at], values, np.zeros(len(at), np.int32), mesh.faces),
        *(sides, np.array([3, -1, -1, -1], np.int32)),
    )


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    folder = tmp_path_factory.mktemp("compose") / "run"
    writer = CacheWriter(folder, 24.0, {"scene": "test", "seed": 1}, PRIMS)
    for k, count in enumerate(COUNTS):
        frame = make_frame(count, seed=k)
        frames = {"Film": frame, "FilmE": make_frame(2 * count, seed=10 + k)}
        frames |= {PRIMS[2]: make_mesh(k), PRIMS[3]: make_mesh(k + 5) if k > 0 else MeshFrame.empty()}
        frames[WHOLE] = make_shared(k) if k < 4 else WholeFrame.empty()
        writer.write(FIRST + k, frames)
    return folder


def expected(cache, prim, frame):
    if prim == WHOLE:
        found = read_whole(cache, frame)
        return vars(found) | {"faces": found.faces.reshape(-1)}
    if prim.startswith("FilmSurface/"):
        found = read_mesh(cache, frame, int(prim[-1]))
        return vars(found) | {"faces": found.faces.reshape(-1)}
    return vars(read_frame(cache, frame, prim))


def assert_exact(cache, stage, path, prim, time_of=lambda frame: frame):
    """Every attribute has the values of frame f at time_of(f), on the stage that it was brought to."""
    found = stage.GetPrimAtPath(path)
    assert found, path
    for frame in range(FIRST, LAST + 1):
        wanted = expected(cache, prim, frame)
        for attribute in attributes_of(prim):
            value = found.GetAttribute(attribute.name).Get(float(time_of(frame)))
            assert value is not None, (path, attribute.name, frame)
            if attribute.field:
                np.testing.assert_array_equal(
                    np.array(value).reshape(wanted[attribute.field].shape), wanted[attribute.field]
                )


def new_stage(first=FIRST, last=LAST, fps=24.0):
    stage = Usd.Stage.CreateInMemory()
    stage.SetTimeCodesPerSecond(fps)
    stage.SetStartTimeCode(first)
    stage.SetEndTimeCode(last)
    return stage


@pytest.fixture
def root(cache):
    return str(cache / "film.usda")


@pytest.mark.parametrize("prim", PRIMS)
def test_opened(cache, root, prim):
    assert_exact(cache, Usd.Stage.Open(root), f"/World/{prim}", prim)


@pytest.mark.parametrize("prim", PRIMS)
@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_sublayer_with_offset_and_scale(cache, root, prim, scale):
    """Frame f comes at f scale - 900; meanwhile velocities stay per second of the cache's own time."""
    stage = new_stage()
    layer = stage.GetRootLayer()
    layer.subLayerPaths.append(root)
    layer.subLayerOffsets[0] = Sdf.LayerOffset(-900.0, scale)
    assert_exact(cache, stage, f"/World/{prim}", prim, lambda frame: scale * frame - 900.0)


@pytest.mark.parametrize("prim", PRIMS)
def test_world_referenced(cache, root, prim):
    stage = new_stage()
    stage.DefinePrim("/Scene/Bubble").GetReferences().AddReference(root)
    assert_exact(cache, stage, f"/Scene/Bubble/{prim}", prim)


@pytest.mark.parametrize("prim", PRIMS)
def test_each_prim_referenced(cache, root, prim):
    stage = new_stage()
    stage.DefinePrim("/Scene/Film").GetReferences().AddReference(root, f"/World/{prim}")
    assert_exact(cache, stage, "/Scene/Film", prim)


@pytest.mark.parametrize("prim", PRIMS)
def test_each_prim_referenced_with_an_offset(cache, root, prim):
    stage = new_stage(1, len(COUNTS))
    offset = Sdf.LayerOffset(1.0 - FIRST)
    stage.DefinePrim("/Scene/Film").GetReferences().AddReference(root, f"/World/{prim}", offset)
    assert_exact(cache, stage, "/Scene/Film", prim, lambda frame: frame + 1 - FIRST)


@pytest.mark.parametrize("prim", PRIMS)
def test_paid(cache, root, prim):
    """A payload holds nothing until it is loaded."""
    layer = Sdf.Layer.CreateAnonymous(".usda")
    stage = Usd.Stage.Open(layer, Usd.Stage.LoadNone)
    stage.DefinePrim("/Scene").GetPayloads().AddPayload(root)
    assert not stage.GetPrimAtPath(f"/Scene/{prim}")
    stage.Load()
    assert_exact(cache, stage, f"/Scene/{prim}", prim)


@pytest.mark.parametrize("prim", PRIMS)
def test_instanced(cache, root, prim):
    """Two instances of the whole, and of each prim under a parent, share one prototype and give all values."""
    stage = new_stage()
    for name in ("One", "Two"):
        whole = stage.DefinePrim(f"/Scene/{name}")
        whole.GetReferences().AddReference(root)
        whole.SetInstanceable(True)
        alone = stage.DefinePrim(f"/Alone/{name}")
        alone.GetReferences().AddReference(root, f"/World/{prim}")
        alone.SetInstanceable(True)
    assert len(stage.GetPrototypes()) == 2
    for name in ("One", "Two"):
        assert_exact(cache, stage, f"/Scene/{name}/{prim}", prim)
        assert_exact(cache, stage, f"/Alone/{name}", prim)


def test_one_file(cache, tmp_path):
    stage = Usd.Stage.Open(str(flatten(cache, tmp_path / "flat.usdc")))
    for prim in PRIMS:
        assert_exact(cache, stage, f"/World/{prim}", prim)


def test_camera_and_lights_are_a_layer_of_their_own(cache, root):
    """What is referenced brings none; the stage looks at the film and holds the same values."""
    path = write_stage(cache, (0.0, 0.0, 5.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 30.0)
    stage = Usd.Stage.Open(str(path))
    assert_exact(cache, stage, "/World/Film", "Film")
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/Stage/Camera")).GetCamera(float(FIRST))
    np.testing.assert_allclose(camera.transform.ExtractTranslation(), (0.0, 0.0, 5.0))
    np.testing.assert_allclose(camera.transform.TransformDir((0.0, 0.0, -1.0)), (0.0, 0.0, -1.0), atol=1e-12)
    assert camera.GetFieldOfView(camera.FOVVertical) == pytest.approx(30.0)
    kinds = [prim.GetTypeName() for prim in stage.GetPrimAtPath("/Stage").GetChildren()]
    assert {"Camera", "DomeLight", "DistantLight"} == set(kinds)
    assert not Usd.Stage.Open(root).GetPrimAtPath("/Stage")


def test_one_thing_is_shown_and_has_a_look(cache, root):
    """Meshes where there are any; points are guides. All are bound to the material."""
    stage = Usd.Stage.Open(root)
    purposes = {prim: UsdGeom.Imageable(stage.GetPrimAtPath(f"/World/{prim}")).ComputePurpose() for prim in PRIMS}
    assert purposes == {"Film": "guide", "FilmE": "guide", PRIMS[2]: "default", PRIMS[3]: "default", WHOLE: "default"}
    for prim in PRIMS:
        bound = stage.GetPrimAtPath(f"/World/{prim}").GetRelationship("material:binding").GetTargets()
        assert bound == [Sdf.Path("/World/Looks/SoapFilm")]


def test_meshes_are_as_usd_wants_them(cache, root):
    stage = Usd.Stage.Open(root)
    mesh = UsdGeom.Mesh.Get(stage, "/World/FilmSurface/Region_0")
    assert mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert mesh.GetDoubleSidedAttr().Get() is True
    assert mesh.GetNormalsInterpolation() == "vertex"
    assert {a.name for a in MESH_ATTRIBUTES} - {a.name for a in ATTRIBUTES} == {"faceVertexCounts", "faceVertexIndices"}
    ok, why = UsdGeom.Mesh.ValidateTopology(
        mesh.GetFaceVertexIndicesAttr().Get(FIRST), mesh.GetFaceVertexCountsAttr().Get(FIRST), 4
    )
    assert ok, why
