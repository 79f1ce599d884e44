"""README.md and docs/*.md: every command and every Python block runs as it stands, shortened by frames and size only.

Commands and blocks are read from the pages, so that a new one is covered as soon as it is written. A command is a line
of a code block, or a code span, that starts with a program. A code span that starts with `--` belongs to the command or
to the scene named before it in its paragraph or table row. By default every command line is read and its scene built
at full size, and the README's are run short; all others are run short by `pytest -m slow`.
"""

import argparse
import importlib.util
import json
import math
import os
import re
import shlex
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import NamedTuple

import pytest
import warp as wp

from melp_warp import cli
from melp_warp.program import afterwards, runner
from melp_warp.registry import load_scene, scene_names
from melp_warp.tables import wrap_markdown
from melp_warp.usd.schema import list_frames

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
PROGRAM = re.compile(r"(?:MELP_WARP_\w+=\S+ )*(melp-warp|python|pytest|pip|nvidia_usd_validate)(?= |$)")
PLACEHOLDERS = {
    "NAME": "oscillating_bubble",
    "SCENE": "oscillating_bubble",
    "scenes/NAME.py": str(ROOT / "scenes" / "oscillating_bubble.py"),
    "DIR": "out/cache",
    "FILE": "found.json",
    "N": "1",
    "M": "0.01",
    "key=value": "seed=1",
}
"""Words that stand for something, and what they are here."""

VORTICES = {"core", "vortex_radius", "whirls"}
"""Keys of scenes whose vortices ask for more E than others do."""

NAME_ALONE = re.compile(r"melp-warp (?!scenes)\w+")
"""A code span that names a command, and is none."""

SHORT_TOOLS = {
    "bench.py": "--only cases --case oscillating_bubble --frames 1",
    "figures.py": "--size 64",
    "kills.py": "--kills 1 --out out/one",
    "limits.py": "--only radius --random 1",
    "mesh.py": "--largest 200 --frames 0",
    "tradeoff.py": "--only marangoni --size 0.3 --points 1",
    "validate.py": "--only rest",
    "validate_foams.py": "",
}
"""What makes a tool's run short; none of them then writes a page."""

NEED_NO_SCENE = ("--version", "--help")


class Command(NamedTuple):
    """A command of a page: the file's name, its words as printed, and the same without placeholders."""

    page: str
    printed: str
    words: list[str]


# --- reading the pages -----------------------------------------------------------------------------------------------


def blocks(text):
    """(Text before, whether fenced as Python, code) of each code block, fenced or indented."""
    fenced = re.compile(r"^( *)```(\w*)\n(.*?)^\1```$", re.S | re.M)
    for match in fenced.finditer(text):
        yield text[: match.start()], match[2], textwrap.dedent(match[3])
    rest = fenced.sub("", text)
    for match in re.finditer(r"(?<=\n\n)(?:    .*\n|\n(?=    ))+", rest):
        yield rest[: match.start()], "", textwrap.dedent(match[0])


def paragraphs(text):
    """Paragraphs, items and table rows, without code blocks."""
    text = re.sub(r"^( *)```.*?^\1```$", "", text, flags=re.S | re.M)
    text = re.sub(r"(?<=\n\n)(?:    .*\n|\n(?=    ))+", "", text)
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n|\n(?=[*|] )", text)]


def plain_words(command):
    """The words of a command as printed: alternatives by their first, placeholders by what they stand for here."""
    command = re.split(r" {2,}#?|(?<![\w.#])#", command)[0].replace("\\|", "|")
    command = command.replace("[options]", "").replace("...", "")
    words = shlex.split(re.sub(r"[\[\]](?!')", "", command) if "pip" not in command else command)
    first = [word if "=" in word and "|" not in word else word.split("|")[0] for word in words]
    return [PLACEHOLDERS.get(word, word) for word in first]


def spans(paragraph):
    """The commands in a paragraph's code spans; options alone are given to the command or scene named before."""
    made, before, scene = [], None, None
    for span in re.findall(r"`([^`]+)`", paragraph):
        name = span.split()[0]
        if PROGRAM.match(span) and " " in span and not NAME_ALONE.fullmatch(span):
            before = span
            made.append(span)
        elif name in scene_names():
            scene = name
            if " --" in span:
                made.append(f"melp-warp run {span}")
        elif span.startswith("--set ") and "..." not in span:
            if before and before.startswith("melp-warp run"):
                made.append(f"{before} {span}")
            elif scene:
                made.append(f"melp-warp run {scene} {span}")
    return made


def commands():
    """Every command of every page, each once a page."""
    found = {}
    for page in PAGES:
        text = page.read_text()
        lines = [line for _, _, code in blocks(text) for line in code.splitlines()]
        printed = [part.strip() for line in lines if PROGRAM.match(line) for part in line.split("&&")]
        printed += [command for paragraph in paragraphs(text) for command in spans(paragraph)]
        for command in printed:
            found[page.name, command] = Command(page.name, command, plain_words(command))
    return list(found.values())


def python_blocks():
    """(Page, number, file name or None, code) of every block of Python; a file's name stands before its block."""
    made = []
    for page in PAGES:
        found = [b for b in blocks(page.read_text()) if b[1] == "python" or re.match(r"(from|import) \w", b[2])]
        for number, (before, _, code) in enumerate(found):
            named = re.findall(r"Put this in `(\w+\.py)`", before.rstrip().split("\n\n")[-1])
            made.append((page.name, number, named[0] if named else None, code))
    return made


def own_arguments(command):
    """The words after `melp-warp`; None for another program."""
    words = [word for word in command.words if not re.match(r"MELP_WARP_\w+=", word)]
    if words[0] == "melp-warp":
        return words[1:]
    if words[:3] == ["python", "-m", "melp_warp"]:
        return words[3:] or ["--version"]
    if words[0] == "python" and Path(words[1]).parent.name == "scenes":
        return ["run", *words[1:]]
    return None


COMMANDS = commands()
OWN = [command for command in COMMANDS if own_arguments(command)]
TOOLS = [c for c in COMMANDS if c.words[0] == "python" and c.words[1].startswith("tools/")]
OTHERS = [c for c in COMMANDS if c not in OWN and c not in TOOLS]
HEAVY = ("tradeoff",)
README_RUNS = [c for c in OWN if c.page == "README.md" and own_arguments(c)[0] not in HEAVY]


def of(command):
    return f"{command.page}: {command.printed}"


def test_commands_are_found():
    """Known ones, one of each kind, and no program but those that are tested here."""
    printed = {command.printed for command in COMMANDS}
    for known in ("melp-warp run giant_bubble --preview", "pip install -e .", "melp-warp measure DIR [--frame N]"):
        assert any(command.startswith(known) for command in printed), known
    assert "melp-warp run size_ratio --set ratio=0.4" in printed
    assert "melp-warp run oscillating_bubble --set mode=3" in printed
    assert "melp-warp run giant_bubble --set dt=auto" in printed
    assert len(OWN) > 40 and len(TOOLS) >= 6
    assert {c.words[0] for c in OTHERS} <= {"pip", "pytest", "nvidia_usd_validate"}
    assert any(name == "drop.py" for _, _, name, _ in python_blocks())


# --- as they stand ---------------------------------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path, monkeypatch):
    """An empty working folder that holds the files which pages tell a reader to write."""
    monkeypatch.chdir(tmp_path)
    for _, _, name, code in python_blocks():
        if name:
            (tmp_path / name).write_text(code)
    return tmp_path


@pytest.mark.parametrize("command", OWN, ids=of)
def test_a_command_is_taken_as_it_stands(command, files, monkeypatch, capsys):
    """Options, keys, values and ranges are right and the scene is built; nothing is simulated."""
    for home, works in ((runner, ("run", "estimate", "trade")), (afterwards, ("draw", "write_blender"))):
        for work in works:
            monkeypatch.setattr(home, work, lambda *_, **__: 0)
    arguments = own_arguments(command)
    try:
        options = cli._parser().parse_args(arguments)
    except SystemExit as end:  # --version
        assert end.code == 0 and arguments[0] in NEED_NO_SCENE
        return
    if options.command in (cli._run, cli._scenes):
        assert cli.main(arguments) in (0, None), capsys.readouterr().err


@pytest.mark.parametrize("command", TOOLS, ids=of)
def test_a_tool_is_called_as_it_stands(command, monkeypatch):
    class Parsed(Exception):
        pass

    parse = argparse.ArgumentParser.parse_args

    def parse_alone(self, arguments=None, namespace=None):
        parse(self, arguments, namespace)
        raise Parsed

    tool = ROOT / command.words[1]
    monkeypatch.syspath_prepend(str(tool.parent))
    arguments = [{"oscillating_bubble": "rest"}.get(word, word) for word in command.words[2:]]
    monkeypatch.setattr(sys, "argv", [str(tool), *arguments])
    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_alone)
    spec = importlib.util.spec_from_file_location(f"tool_{tool.stem}", tool)
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, spec.name, module)
    spec.loader.exec_module(module)
    with pytest.raises(Parsed):
        module.main()


@pytest.mark.parametrize("command", OTHERS, ids=of)
def test_other_programs_are_called_with_what_there_is(command, files, short_cache):
    """`pip` with extras of this package, which the CI runs; `pytest` with its markers; a validator where it is."""
    project = (ROOT / "pyproject.toml").read_text()
    if command.words[0] == "pip":
        assert command.words[:3] == ["pip", "install", "-e"]
        extras = re.findall(r"\[(\w+)\]", command.words[3])
        assert all(re.search(rf"^{extra} = \[", project, re.M) for extra in extras)
    elif command.words[0] == "pytest":
        marks = [command.words[i + 1] for i, word in enumerate(command.words) if word == "-m"]
        assert all(f'"{mark}: ' in project for mark in marks)
    elif shutil.which(command.words[0]):
        lay_out(command, short_cache)
        subprocess.run(command.words, check=True)


@pytest.mark.parametrize("name", ["run", "preview", "mesh", "check", "measure", "tradeoff"])
def test_every_option_is_documented(name):
    """docs/command-line.md or the subcommand's own page names every option that there is, in a code span or block."""
    text = (ROOT / "docs" / "command-line.md").read_text() + (ROOT / "docs" / "measure.md").read_text()
    parser = next(a for a in cli._parser()._actions if isinstance(a, argparse._SubParsersAction)).choices[name]
    for action in parser._actions:
        for option in action.option_strings:
            if option not in ("-h", "--help"):
                assert re.search(rf"[`\[]{option}\b", text), f"{name} {option} is not documented"


def test_lines_of_pages_are_short():
    """All but rows of tables and code; wrapping changes white space alone, and nothing twice."""
    for path in (*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")):
        text = path.read_text()
        assert wrap_markdown(text) == text, path.name
    long = "* `a b`: " + "word " * 40 + "\n\n| " + "cell " * 40 + "|\n\n```\n" + "code " * 40 + "\n```\n"
    made = wrap_markdown(long)
    assert max(len(line) for line in made.splitlines()[:2]) <= 125 and made.splitlines()[1].startswith("  word")
    assert made.split() == long.split() and made.endswith(long[long.index("| cell") :])


@pytest.mark.parametrize(("tool", "page"), [("limits", "limits"), ("validate", "validation"), ("tradeoff", "accuracy")])
def test_a_tool_has_the_text_of_the_page_that_it_writes(tool, page):
    """What is written into such a page by hand is in its tool as well, which would leave it out the next time."""
    text = re.search(r'^NOTES = """\\\n(.*?)"""$', (ROOT / "tools" / f"{tool}.py").read_text(), re.M | re.S).group(1)
    assert " ".join(text.split()) in " ".join((ROOT / "docs" / f"{page}.md").read_text().split())


# --- run short -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session")
def short_cache(tmp_path_factory):
    """A double bubble of three frames with both particle sets: what pages call out/small, out/bubble and so on."""
    folder = tmp_path_factory.mktemp("docs") / "cache"
    short = ["--frames", "2", "--set", "e_count=300", "l_per_e=2", "approach_speed=0.5"]
    assert cli.main(["run", "double_bubble", "--export", "both", "--quiet", "--out", str(folder), *short]) == 0
    return folder


def lay_out(text, cache):
    """Put a cache where a command or a block reads one, unless it writes it."""
    words = text.words if isinstance(text, Command) else re.findall(r"out/\w+", text)
    for word in words:
        found = re.match(r"out/\w+", word)
        if found and not Path(found[0]).exists():
            shutil.copytree(cache, found[0])


def shortened(arguments):
    """The arguments of a command with fewer frames and particles; nothing else is changed."""
    if arguments[0] == "tradeoff":
        return [*arguments, "--e", "60", "--frames", "1"]
    if arguments[0] == "preview":
        frames = [i + 1 for i, word in enumerate(arguments) if word == "--frame"]
        short = ["1" if i in frames else word for i, word in enumerate(arguments)]
        return [*(re.sub(r"^0:\d+(:\d+)?$", ":", word) for word in short), "--size", "32"]
    if arguments[0] != "run":
        return arguments
    script = load_scene(arguments[1])
    values = script.parameters.values(script.parameters.parse(w for w in arguments if re.match(r"\w+=", w)))
    swirls = VORTICES & script.parameters.defaults.keys()
    sizes = {"e_count": 700 if swirls else 150, "l_per_e": min(2, values.l_per_e)}
    if "border" in script.parameters.defaults:
        sizes["e_count"] = math.ceil(1.1 * script.build(values).shape.fewest_e(values.support))
    given = [re.sub(r"^(e_count|l_per_e)=.*", lambda m: f"{m[1]}={sizes.pop(m[1])}", word) for word in arguments]
    more = ["--set", *(f"{key}={value}" for key, value in sizes.items())] if sizes else []
    return [*given, "--frames", "2", *more]


def run_short(command, cache, monkeypatch):
    """Run one of our own commands, short, and look at what it leaves."""
    arguments = shortened(own_arguments(command))
    if arguments[0] in NEED_NO_SCENE:
        with pytest.raises(SystemExit):
            cli.main(arguments)
        return
    monkeypatch.setattr(afterwards, "PREVIEW_SIZE", 32)
    monkeypatch.setattr(afterwards, "CONTACT_SIZE", 32)
    if arguments[0] != "run":
        lay_out(command, cache)
    settings = dict(word.split("=") for word in command.words if re.match(r"MELP_WARP_\w+=", word))
    if settings:
        whole = [sys.executable, "-m", "melp_warp", *arguments]
        assert subprocess.run(whole, env=os.environ | settings, check=False).returncode == 0
    else:
        assert cli.main(arguments) == 0, arguments
    if arguments[0] == "run" and "--estimate" not in arguments:
        out = arguments[arguments.index("--out") + 1] if "--out" in arguments else f"out/{Path(arguments[1]).stem}"
        assert list_frames(out) == [0, 1, 2]
        assert (Path(out) / "preview.png").exists() == ("--preview" in arguments)


@pytest.mark.parametrize("command", README_RUNS, ids=of)
def test_a_command_of_the_readme_runs(command, files, short_cache, monkeypatch):
    run_short(command, short_cache, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("command", [c for c in OWN if c not in README_RUNS], ids=of)
def test_a_command_runs(command, files, short_cache, monkeypatch):
    run_short(command, short_cache, monkeypatch)


@pytest.mark.slow
@pytest.mark.parametrize("command", TOOLS, ids=of)
def test_a_tool_runs(command, tmp_path):
    """In a copy, so that what a tool writes goes there."""
    for name in ("tools", "docs"):
        shutil.copytree(ROOT / name, tmp_path / name)
    tool, *options = command.words[1:]
    kept = " ".join(word for word in options if word not in ("--write", "--full", "oscillating_bubble", "--large"))
    kept = re.sub(r"--only$|--pages docs", "", kept)
    short = [*shlex.split(kept), *shlex.split(SHORT_TOOLS[Path(tool).name])]
    done = subprocess.run([sys.executable, tool, *short], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]


def in_short_cache(code, cache):
    """The block with frame numbers that the short cache has."""
    last = list_frames(cache)[-1]
    return re.sub(r'(read_frame\("[^"]+", )(\d+)', lambda m: m[1] + str(min(int(m[2]), last)), code)


@pytest.mark.parametrize(
    ("page", "number", "name", "code"), python_blocks(), ids=lambda value: str(value) if len(str(value)) < 30 else ""
)
def test_a_python_block_runs(page, number, name, code, files, short_cache):
    """In a file of its own, as Warp reads a kernel's source from there."""
    lay_out(code, short_cache)
    file = files / (name or "block.py")
    if not name:
        file.write_text(in_short_cache(code, short_cache))
    spec = importlib.util.spec_from_file_location(f"block_{Path(page).stem.replace('-', '_')}_{number}", file)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    if any(isinstance(value, wp.Kernel) for value in vars(module).values()):
        wp.load_module(module, device="cpu")


def test_the_log_has_the_fields_that_the_page_names(short_cache):
    """Not a command, but what follows from one: docs/command-line.md lists what a line of run.jsonl holds."""
    line = json.loads((short_cache / "run.jsonl").read_text().splitlines()[-1])
    assert {"frame", "time", "solvers", "area", "volume", "pressure", "mass", "surfactant", "momentum"} <= set(line)
