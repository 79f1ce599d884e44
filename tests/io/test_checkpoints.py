"""Checkpoints that anybody may have made: refused in one line before anything changes, or gone on from."""

import io
import json
import random
import zipfile

import numpy as np
import pytest

from melp_warp.errors import InputError, SimulationError
from melp_warp.registry import load_scene
from melp_warp.simulation import Simulation
from melp_warp.stepping import checkpoint

FOAM = {"e_count": 500, "l_per_e": 1, "frames": 2}
FILM = {"e_count": 200, "l_per_e": 2, "frames": 2}


def simulation(name, keys):
    script = load_scene(name)
    return Simulation(script.build(script.parameters.values(keys)))


@pytest.fixture(scope="module", params=["film", "foam"])
def made(request, tmp_path_factory, device):
    """A simulation and the bytes of its checkpoint."""
    path = tmp_path_factory.mktemp("made") / "checkpoint.npz"
    sim = simulation("giant_bubble", FILM) if request.param == "film" else simulation("double_bubble", FOAM)
    sim.advance_frame()
    sim.save_checkpoint(path)
    return sim, path.read_bytes()


def arrays_of(data):
    with np.load(io.BytesIO(data)) as file:
        return dict(file)


def state_of(sim):
    return {name: array.tobytes() for name, array in sim.state.numpy().items()}


def spoil(array, rng):
    """One array, made wrong in one of many ways."""
    array = array.copy()
    kind = rng.randrange(9)
    at = rng.randrange(max(1, array.size))
    if kind == 0:
        return array[: len(array) // 2] if array.ndim else array.reshape(1)
    if kind == 1:
        return np.concatenate([array, array]) if array.ndim else np.array([0, 1])
    if kind == 2:
        return array.astype(str)
    if kind == 3:
        return array.astype(complex)
    if kind == 4:
        return np.zeros((3, 5, 7, 2))
    if array.size == 0:
        return np.zeros(3)
    if array.dtype.kind == "f":
        array.flat[at] = rng.choice([np.nan, np.inf, -np.inf, 3e38, -1e9, 1e25])
    else:
        values = [-1, 2**31 - 1, -(2**31), 1_000_000, int(array.flat[at]) + 7]
        array.flat[at] = np.int64(rng.choice(values)).astype(array.dtype)
    return array


def seal(arrays, right=True):
    """Give arrays the checksum that they should have."""
    if right and all(a.dtype != object for a in arrays.values()):
        arrays[checkpoint.CHECKSUM] = checkpoint.checksum(arrays)


def garbled(data, rng):
    """The bytes of a checkpoint, made wrong: cut, changed, an array spoiled, left out or compressed."""
    kind = rng.randrange(8)
    if kind == 0:
        return data[: rng.randrange(len(data))]
    if kind == 1:
        changed = bytearray(data)
        for _ in range(rng.choice([1, 4, 64])):
            at, byte = rng.randrange(len(data)), rng.randrange(256)
            changed[at] = byte
        return bytes(changed)
    if kind == 2:
        at = rng.randrange(len(data) - 8)
        return data[:at] + rng.choice([b"\xff" * 8, b"\0" * 8, (2**40).to_bytes(8, "little")]) + data[at + 8 :]
    arrays = arrays_of(data)
    name = rng.choice(sorted(arrays))
    if rng.random() < 0.5:
        name = checkpoint.HEADER
    if kind == 3:
        del arrays[name]
    elif kind == 4:  # a bomb: little on the disk, much in memory
        file = io.BytesIO()
        np.savez_compressed(file, **{**arrays, name: np.zeros(10_000_000)})
        return file.getvalue()
    elif name == checkpoint.HEADER and kind > 5:
        arrays[name] = respelled(arrays[name], rng)
    else:
        arrays[name] = spoil(arrays[name], rng)
    seal(arrays, rng.random() < 0.9)
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


ODD = [None, True, -1, 0, 1e308, -1e-9, float("nan"), float("inf"), 10**30, "x", [], {}, [[]], {"x": 1}, [0, 0, 0]]


def leaves(value, path=()):
    """Paths of all that is in a JSON value, containers too."""
    yield path
    for key, one in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from leaves(one, (*path, key))


def respelled(header, rng):
    """A header with one value changed, left out or added."""
    text = json.loads(header.tobytes())
    path = rng.choice([p for p in leaves(text) if p and p[0] != "scene"])
    at = text
    for key in path[:-1]:
        at = at[key]
    if rng.random() < 0.8:
        at[path[-1]] = rng.choice(ODD)
    else:
        del at[path[-1]]
    return np.frombuffer(json.dumps(text).encode(), dtype=np.uint8)


def load(sim, path, data):
    """Load and go on for a frame; whether it was taken."""
    path.write_bytes(data)
    before = state_of(sim)
    try:
        sim.load_checkpoint(path)
    except InputError as error:
        assert len(str(error).splitlines()) == 1
        assert state_of(sim) == before
        return False
    try:
        sim.advance_frame()
    except SimulationError:
        return True
    for name, array in sim.state.numpy().items():
        assert np.isfinite(array).all(), name
    return True


@pytest.mark.parametrize("count", [25, pytest.param(1000, marks=pytest.mark.slow)])
def test_garbled_checkpoints(made, count, tmp_path):
    sim, data = made
    taken = sum(load(sim, tmp_path / "c.npz", garbled(data, random.Random(seed))) for seed in range(count))
    assert taken < 0.2 * count
    assert load(sim, tmp_path / "c.npz", data)


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("e.region", lambda a: a + 7, "e.region"),
        ("l.region", lambda a: a - 1, "l.region"),
        ("origin", lambda a: a * np.nan, "origin must be finite"),
        ("e.mass", lambda a: a * np.nan, "e.mass must be finite"),
        ("l.mass", lambda a: -a, "l.mass must be 0 or above"),
        ("e.x", lambda a: a * 1e30, "e.x must be at most"),
        ("e.normal", lambda a: a * 2, "e.normal must be of unit length"),
        ("l.eta", lambda a: a * 0, "l.eta must be above 0"),
        ("gas", lambda a: -a, "gas, volume"),
        ("frame", lambda a: a + 10_000, "time must be at least"),
        ("time", lambda a: a - 1.0, "time must be at least"),
        ("e.u", lambda a: a[:, :2], "e.u must be of shape"),
        ("e.u", lambda a: a.astype("U9"), "e.u must have"),
        ("e.x", lambda a: np.array([{"__reduce__": 1}] * len(a), dtype=object), "e.x must have"),
    ],
)
def test_what_no_run_left_is_named(made, name, change, words, tmp_path):
    sim, data = made
    arrays = arrays_of(data)
    arrays[name] = change(arrays[name])
    seal(arrays)
    np.savez(tmp_path / "c.npz", **arrays)
    before = state_of(sim)
    with pytest.raises(InputError, match=words):
        sim.load_checkpoint(tmp_path / "c.npz")
    assert state_of(sim) == before


def test_compressed_members_are_not_inflated(made, tmp_path):
    sim, data = made
    np.savez_compressed(tmp_path / "c.npz", **arrays_of(data))
    with pytest.raises(InputError, match="compressed"):
        sim.load_checkpoint(tmp_path / "c.npz")


def test_members_that_nobody_asks_for_are_not_read(made, tmp_path):
    sim, data = made
    path = tmp_path / "c.npz"
    path.write_bytes(data)
    with zipfile.ZipFile(path, "a", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("bomb.npy", b"\0" * 50_000_000)
    sim.load_checkpoint(path)


def test_a_link_in_place_of_the_temporary_is_not_written_through(made, tmp_path):
    """The name of a temporary cannot be foreseen, and a link in the file's own place is replaced."""
    sim, _ = made
    victim = tmp_path / "victim"
    victim.write_text("mine")
    for name in ("c.npz", "c.npz.tmp", ".c.tmp.npz"):
        (tmp_path / name).symlink_to(victim)
    sim.save_checkpoint(tmp_path / "c.npz")
    assert victim.read_text() == "mine"
    assert not (tmp_path / "c.npz").is_symlink()
    assert sorted(p.name for p in tmp_path.iterdir()) == [".c.tmp.npz", "c.npz", "c.npz.tmp", "victim"]
