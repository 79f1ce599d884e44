"""Writers from outside the package, named on the command line."""

import json

import pytest

from melp_warp import cli
from melp_warp.errors import InputError
from melp_warp.program.writers import WRITERS, find_writer
from melp_warp.usd.check import check_cache

COUNTING = """
class Counting:
    def open(self, folder, plan, simulation, there):
        self.path = folder / "seen.txt"
        kept = self.path.read_text().splitlines() if there else []
        self.path.write_text("".join(f"{line}\\n" for line in kept if int(line.split()[0]) <= there[1]))

    def write(self, moment):
        if moment.number == 3 and moment.simulation.scene.seed == 1:
            raise ValueError("three is too many")
        count = len(moment.particles("e").points)
        with self.path.open("a") as file:
            file.write(f"{moment.number} {count} {len(moment.meshes)}\\n")

    def close(self):
        with self.path.open("a") as file:
            file.write("9 closed\\n")


class Half:
    def open(self, folder, plan, simulation, there): ...
"""


@pytest.fixture
def counting(tmp_path):
    path = tmp_path / "counting.py"
    path.write_text(COUNTING)
    return f"{path}:Counting"


def run(out, *more):
    return cli.main(["run", "oscillating_bubble", "--set", "e_count=150", "--out", str(out), "--quiet", *more])


def test_a_writer_gets_every_frame(device, tmp_path, counting):
    """Whole frames, meshes where they are asked for; the cache stays as it is without one."""
    out = tmp_path / "out"
    assert run(out, "--frames", "2", "--mesh", "--writer", counting) == 0
    assert run(tmp_path / "plain", "--frames", "2", "--mesh") == 0
    seen = (out / "writers" / "Counting" / "seen.txt").read_text().splitlines()
    count = seen[0].split()[1]
    assert seen == [f"{k} {count} 1" for k in range(3)] + ["9 closed"]
    assert check_cache(out) == []
    frames = [folder / "frames" / "film.000002.usdc" for folder in (out, tmp_path / "plain")]
    assert frames[0].read_bytes() == frames[1].read_bytes()
    assert not (tmp_path / "plain" / "writers").exists()


def test_it_goes_on_and_is_removed(device, tmp_path, counting):
    out = tmp_path / "out"
    assert run(out, "--frames", "1", "--writer", counting) == 0
    assert run(out, "--frames", "2", "--resume") == 0
    seen = (out / "writers" / "Counting" / "seen.txt").read_text().splitlines()
    assert [line.split()[0] for line in seen] == ["0", "1", "2", "9"]
    assert run(out, "--frames", "2", "--resume", "--writer", "json:JSONDecoder") == 2
    assert run(out, "--frames", "0", "--overwrite") == 0
    assert not (out / "writers").exists()


def test_one_that_fails_ends_the_run(device, tmp_path, counting, capsys):
    """In a line, with the frames before complete and a checkpoint to go on from; it is closed."""
    out = tmp_path / "out"
    assert run(out, "--frames", "5", "--seed", "1", "--writer", counting) == 2
    told = capsys.readouterr().err
    assert "counting.py:Counting: write: ValueError: three is too many" in told and "checkpoint.npz" in told
    assert [json.loads(line)["frame"] for line in (out / "run.jsonl").read_text().splitlines()] == [0, 1, 2]
    assert (out / "writers" / "Counting" / "seen.txt").read_text().splitlines()[-1] == "9 closed"
    assert check_cache(out) == []


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("csv", "--writer must be usd, MODULE:CLASS or FILE.py:CLASS, got 'csv'"),
        ("nowhere_at_all:Kind", "ModuleNotFoundError"),
        ("nowhere.py:Kind", "FileNotFoundError"),
        ("json:JSONDecoder", "a class with open, write and close"),
        ("json:dumps", "a class with open, write and close"),
        ("FILE:Half", "a class with open, write and close"),
    ],
)
def test_what_is_no_writer_is_refused(device, counting, tmp_path, name, told, capsys):
    name = name.replace("FILE", counting.rpartition(":")[0])
    with pytest.raises(InputError) as raised:
        find_writer(name)
    assert told in str(raised.value)
    assert run(tmp_path / "out", "--writer", name) == 2
    assert not (tmp_path / "out").exists()


def test_registered_writers_are_writers():
    assert all(find_writer(name) for name in WRITERS)


def test_each_once(device, tmp_path, counting, capsys):
    assert run(tmp_path / "out", "--writer", counting, "--writer", counting) == 2
    assert "each once" in capsys.readouterr().err
