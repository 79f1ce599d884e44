"""Malformed calls and scene files: a line on stderr and an exit code, whatever is typed; never a traceback.

A call that is sound ends where the solver would start.
"""

import argparse
import os
import random
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from melp_warp import cli
from melp_warp.device import environment
from melp_warp.errors import InputError, SimulationError
from melp_warp.frame import ParticleFrame
from melp_warp.preview import draw as preview
from melp_warp.program import runner
from melp_warp.usd.cache import CacheWriter

STOP = "the solver would start"

ODD = (
    *("", " ", "abc", "-", "--", "=", "a=b", "-1", "-5", "0", "1", "1.5", "1e400", "nan", "-inf", "9" * 400, "0x10"),
    *("1_0", "\uff11", "\u00e9", "\udcff", "a" * 5000, "a/../../b", "/dev/null", "/dev/null/x", "/proc/self/x"),
    *("~", "%s %(x)s {0}", "[1]", "None", "auto", "5 parsecs", "1e", "1m/", "3 3", "\n", "x.py", "cuda:7"),
)
"""What may be typed where something else is wanted."""

POSITIONAL = {"run": "drainage", "scenes": "drainage", "tradeoff": "drainage"}
"""The word of each command that its options follow; a cache for all others."""


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    """A cache of one frame."""
    n = 30
    rng = np.random.default_rng(1)
    normals = rng.normal(size=(n, 3))
    normals = (normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32)
    zeros = np.zeros(n, np.int32)
    even = (np.full(n, 0.01, np.float32), normals, np.full(n, 400.0, np.float32))
    frame = ParticleFrame(0.05 * normals, 0.0 * normals, np.arange(n), *even, zeros, zeros)
    folder = tmp_path_factory.mktemp("calls") / "cache"
    CacheWriter(folder, 24.0, {"scene": "test", "seed": 1}, ("Film",)).write(0, {"Film": frame})
    return folder


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """An empty folder to work in, and no solver."""

    def stop(*_):
        raise SimulationError(STOP)

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(runner, "_simulation", stop)
    monkeypatch.setattr(runner, "estimate", stop)
    monkeypatch.setattr(runner, "trade", stop)
    monkeypatch.setattr(preview, "render", lambda film, width, height, *_, **__: np.zeros((height, width, 3), np.uint8))


def calls(cache):
    """Every call: odd words alone, as the name of a scene or a folder, for each option, and for some keys."""
    commands = next(a for a in cli._parser()._actions if isinstance(a, argparse._SubParsersAction)).choices
    made = [[], *([word] for word in ODD)]
    for name, parser in commands.items():
        about = [name, POSITIONAL.get(name, str(cache))]
        made += [[name], *([name, word] for word in ODD), [*about, "--bogus"], [*about, "more", "words"]]
        for action in parser._actions:
            if action.option_strings and action.nargs != 0:
                made += [[*about, action.option_strings[0]], *([*about, action.option_strings[0], w] for w in ODD)]
    for key in ("width", "thickness", "e_count", "air", "dt", "frames", "max_iterations", "radios", ""):
        made += [["run", "drainage", "--set", f"{key}={word}"] for word in ODD]
    return made


def said(code, out, err, arguments):
    """Whether a call ended as calls end."""
    assert code in (0, 1, 2), (arguments, code)
    assert "Traceback" not in out + err, arguments
    assert "a fault of melp-warp" not in err, (arguments, err)
    lines = err.splitlines()
    assert len(lines) <= 2 and all(
        line.startswith(("melp-warp: error: ", "melp-warp: warning: ", "melp-warp: notice: ")) for line in lines
    ), err
    assert code == 0 or lines or (code == 1 and out), (arguments, out, err)
    assert len(err) < 20_000, arguments


@pytest.mark.parametrize("count", [300, pytest.param(10_000, marks=pytest.mark.slow)])
def test_whatever_is_typed(count, cache, capfd):
    everything = calls(cache)
    assert len(everything) > 1500
    for arguments in random.Random(1).sample(everything, min(count, len(everything))):
        try:
            code = cli.main(arguments)
        except SystemExit as end:
            pytest.fail(f"{arguments}: {end}")
        said(code, *capfd.readouterr(), arguments)


@pytest.mark.slow
def test_whatever_is_typed_in_a_shell(cache):
    """241 of them as processes, in which no solver starts: the folder of a run is taken."""
    Path("taken").mkdir()
    Path("taken/mine").write_text("")
    typed = [c for c in calls(cache) if len(c) > 2 and c[0] in ("run", "check", "measure", "scenes")]
    typed = [c for c in typed if "--out" not in c and all(word.isprintable() for word in c)]
    for arguments in random.Random(2).sample(typed, 241):
        done = process([*arguments, *(["--out", "taken"] if arguments[0] == "run" else [])])
        said(done.returncode, done.stdout, done.stderr, arguments)


# --- scene files -----------------------------------------------------------------------------------------------------

HEAD = """
from melp_warp.parameters import declare
from melp_warp.shapes import Sphere

PARAMETERS = declare(radius=0.05, e_count=100, l_per_e=1, frames=1)


def build(p):
    return p.scene("x", Sphere(p.radius))
"""

BAD_SCENES = {
    "build raises": (HEAD.replace("return", "1 / 0\n    return"), "scene.py, line 9, in build: ZeroDivisionError"),
    "a helper raises": (
        HEAD.replace("return", "return helper()\n\n\ndef helper():\n    return {}['x']\n    return"),
        "scene.py, line 13, in helper: KeyError: 'x'",
    ),
    "returns nothing": (HEAD.replace("return", ""), "build(p) must return a Scene, p.scene(...), got None"),
    "returns a word": (HEAD.replace("return p.scene(", "return str("), "in build: TypeError"),
    "takes nothing": (HEAD.replace("build(p)", "build()"), "build must take one argument, p"),
    "a key that it has not": (HEAD.replace("p.radius", "p.height"), "line 9, in build: AttributeError"),
    "a range": (HEAD.replace("e_count=100", "e_count=1"), "e_count must be a whole number from 12"),
    "a range of the shape": (HEAD.replace("Sphere(p.radius)", "Sphere(-1.0)"), "radius must be"),
    "exits": ("import sys\nsys.exit('bye')", "scene.py, line 2, in <module>: SystemExit: bye"),
    "exits in build": (HEAD.replace("return", "raise SystemExit(3)\n    return"), "line 9, in build: SystemExit: 3"),
    "interrupts": (HEAD.replace("return", "raise KeyboardInterrupt\n    return"), "interrupted"),
    "recursion": (HEAD.replace("return", "return build(p)\n    return"), "RecursionError"),
    "no memory": (HEAD.replace("return", "raise MemoryError\n    return"), "MemoryError"),
    "an assertion": (HEAD.replace("return", "assert False\n    return"), "AssertionError: no message"),
    "a message of lines": (HEAD.replace("return", "raise ValueError('a\\nb')\n    return"), "ValueError: a "),
    "no syntax": ("def build(p:\n", "scene.py, line 1: SyntaxError"),
    "null bytes": ("x = 1\0", "scene.py"),
    "nothing": ("", "is not a scene: it must have PARAMETERS"),
    "no build": (HEAD.replace("def build", "def make"), "build(p)"),
    "missing module": ("import nowhere_to_be_found", "scene.py, line 1, in <module>: ModuleNotFoundError"),
    "unknown key": (HEAD.replace("l_per_e", "l_per_f"), "unknown key 'l_per_f': did you mean l_per_e"),
}

BAD_FIELDS = {
    "lambda x: x.nope": "line 9, in <lambda>: AttributeError",
    "lambda x: 1 / 0": "line 9, in <lambda>: ZeroDivisionError",
    "lambda x, y: x": "thickness",
    "lambda x: None": "thickness",
    "lambda x: 'thin'": "thickness",
    "lambda x: x": "thickness",
    "lambda x: [4e-7]": "thickness",
    "lambda x: x[:, 0] * float('nan')": "thickness",
    "lambda x: -abs(x[:, 0])": "thickness",
    "4e-7": "thickness",
    "[4e-7]": "thickness",
}


@pytest.mark.parametrize("name", BAD_SCENES)
def test_a_scene_file_that_fails_is_a_line(name, capfd):
    source, words = BAD_SCENES[name]
    Path("scene.py").write_text(source)
    code = cli.main(["run", "scene.py"])
    told = capfd.readouterr()
    said(2 if code == 130 else code, told.out, told.err, name)
    assert words in told.err
    assert code == (130 if name == "interrupts" else 2)
    assert sorted(path.name for path in Path().iterdir()) in (["__pycache__", "scene.py"], ["scene.py"])


@pytest.mark.parametrize("field", BAD_FIELDS)
def test_a_field_that_fails_is_a_line(field, monkeypatch, capfd):
    from melp_warp.simulation import Simulation

    monkeypatch.setattr(runner, "_simulation", lambda plan: Simulation(plan.scene, plan.device))
    Path("scene.py").write_text(HEAD.replace("radius)", f"radius), thickness={field}"))
    assert cli.main(["run", "scene.py", "--quiet", "--set", "e_count=400"]) == 2
    told = capfd.readouterr()
    said(2, told.out, told.err, field)
    assert BAD_FIELDS[field] in told.err


def test_traceback_shows_the_rest(capfd):
    Path("scene.py").write_text(BAD_SCENES["build raises"][0])
    assert cli.main(["run", "scene.py", "--traceback"]) == 2
    told = capfd.readouterr().err
    assert told.startswith("Traceback") and told.splitlines()[-1].startswith("melp-warp: error: scene file ")


def test_a_fault_of_ours_is_a_line_too(monkeypatch, capfd):
    monkeypatch.setattr(runner, "run", lambda plan: {}["x"])
    assert cli.main(["run", "drainage"]) == 1
    assert re.fullmatch(
        r"melp-warp: error: a fault of melp-warp: test_calls.py, line \d+: KeyError: 'x' \(--traceback shows more\)\n",
        capfd.readouterr().err,
    )


# --- what a process is given -----------------------------------------------------------------------------------------


def process(arguments, **variables):
    command = [sys.executable, "-m", "melp_warp", *arguments]
    given = {**os.environ, **variables}
    return subprocess.run(command, capture_output=True, text=True, check=False, env=given, timeout=300)


@pytest.mark.parametrize(
    ("variable", "value", "allowed"),
    [
        ("MELP_WARP_THREADS", "abc", "a whole number from 0 to 1024"),
        ("MELP_WARP_GRAPHS", "yes", "a whole number from 0 to 1"),
        ("MELP_WARP_PRECISION", "16", "32 or 64"),
    ],
)
def test_a_variable_that_is_none_is_a_line(variable, value, allowed):
    done = process(["run", "drainage"], **{variable: value})
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"melp-warp: error: {variable} must be {allowed}, got {value!r}\n"


@pytest.mark.parametrize("closed", ["2>&-", "1>&-", "0<&- 1>&- 2>&-"])
def test_closed_streams(closed, cache):
    command = f"{sys.executable} -m melp_warp"
    shell = f"{command} run nowhere {closed}; a=$?; {command} check {cache} {closed}; echo $a $? >&2"
    done = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert done.stderr.splitlines()[-1] == "2 0"


def test_a_full_stdout_is_a_line():
    command = f"{sys.executable} -m melp_warp scenes > /dev/full"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (2, "melp-warp: error: No space left on device\n")


def test_a_reader_of_stderr_that_leaves():
    command = f"{sys.executable} -m melp_warp run nowhere 2> >(exit 0); echo $?"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.stdout == "2\n"


def test_warp_says_nothing_unless_asked():
    quiet, loud = (process(["run", "drainage", "--device", "gpu", *more]) for more in ([], ["--verbose"]))
    assert quiet.returncode == loud.returncode == 2
    assert re.fullmatch(r"melp-warp: error: device must be one of those here, .*, got 'gpu'\n", quiet.stderr)
    assert "Warp" in loud.stdout + loud.stderr


def test_the_library_says_nothing_either():
    code = "from melp_warp.simulation import find_device; find_device('cpu')"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# --- versions --------------------------------------------------------------------------------------------------------


def test_the_oldest_warp_is_the_declared_one():
    project = (Path(__file__).parents[2] / "pyproject.toml").read_text()
    assert f'"warp-lang>={environment.OLDEST_WARP[0]}.{environment.OLDEST_WARP[1]}"' in project


@pytest.mark.parametrize("version", ["1.16.1", "1.9", "0.15.1"])
def test_a_warp_that_is_too_old_is_refused(version):
    with pytest.raises(InputError, match=f"warp-lang {version} is too old: melp-warp needs 1.17 or newer"):
        environment.check_warp(version)


@pytest.mark.parametrize(
    ("version", "new"), [("1.17.0", False), ("1.19.3", False), ("1.20.0.dev1", True), ("2.0", True)]
)
def test_a_warp_that_is_newer_than_tested_is_said(version, new, recwarn):
    environment.check_warp(version)
    assert [str(w.message) for w in recwarn] == [
        f"melp-warp is tested with warp-lang 1.17 to 1.19, this is {version}"
    ] * new
