"""The command line: `melp-warp run | scenes | preview | mesh | blender | check | measure | report | tradeoff`."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import traceback
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from melp_warp import __version__
from melp_warp.errors import InputError, SimulationError, from_scene, in_a_line, require
from melp_warp.tables import columns

if TYPE_CHECKING:
    from melp_warp.registry import SceneScript

OK, FAILED, BAD_INPUT = 0, 1, 2


class _Parser(argparse.ArgumentParser):
    """Reports a wrong command line in one line."""

    def error(self, message: str):
        raise InputError(message)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.

    Args:
        arguments: the words after `melp-warp`; None for those of this process.

    Returns:
        The exit code: 0 done, 1 a run or a check failed, 2 bad input, 130 interrupted.
    """
    _open_streams()
    words = sys.argv[1:] if arguments is None else list(arguments)
    try:
        options = _parser().parse_args(words)
        if getattr(options, "verbose", False):
            from melp_warp.device.environment import announce

            announce(True)
        code = options.command(options)
        sys.stdout.flush()
        return code
    except (Exception, KeyboardInterrupt) as error:
        if "--traceback" in words:
            traceback.print_exc()
        return _told(error)
    except SystemExit as end:
        if from_scene(end) is None:  # --help and --version
            raise
        return _report(f"scene file {from_scene(end)}: SystemExit: {end}", BAD_INPUT)


def run_file(path: str) -> int:
    """What a scene file does when it is run as a script: `melp-warp run` on itself, with the script's options."""
    return main(["run", path, *sys.argv[1:]])


def _told(error: BaseException) -> int:
    """Say in a line what went wrong; the exit code."""
    if isinstance(error, InputError):
        return _report(error, BAD_INPUT)
    if isinstance(error, SimulationError):
        return _report(error, FAILED)
    if isinstance(error, KeyboardInterrupt):
        return _report("interrupted", 130)
    where = from_scene(error)
    if where is not None:
        return _report(f"scene file {where}: {in_a_line(error)} (--traceback shows more)", BAD_INPUT)
    if isinstance(error, OSError):
        _leave_stdout()
        if isinstance(error, BrokenPipeError):  # the reader of a pipe has left: nothing more to tell it
            return FAILED
        name = f"{error.filename}: " if error.filename else ""
        return _report(f"{name}{error.strerror or error}", BAD_INPUT)
    if isinstance(error, MemoryError):
        return _report("there is not enough memory", FAILED)
    last = traceback.extract_tb(error.__traceback__)[-1]
    where = f"{Path(last.filename).name}, line {last.lineno}"
    return _report(f"a fault of melp-warp: {where}: {in_a_line(error)} (--traceback shows more)", FAILED)


def _open_streams() -> None:
    """Give standard streams that are closed a place to go to: what is opened next would get their number."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, this one
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if number == 0 else "w"))


def _leave_stdout() -> None:
    """Drop what stdout still holds where it cannot be written: Python would try again at exit."""
    try:
        sys.stdout.flush()
    except (OSError, ValueError):
        with contextlib.suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _report(message: object, code: int) -> int:
    with contextlib.suppress(OSError):  # a reader of stderr that has left
        print(f"melp-warp: error: {' '.join(str(message).split())}", file=sys.stderr, flush=True)
    return code


def _warn(doubts: Iterable[str]) -> None:
    for doubt in doubts:
        print(f"melp-warp: warning: {doubt}", file=sys.stderr)


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="melp-warp", description="Simulate soap films and bubbles; write them as USD.")
    parser.add_argument("--version", action="version", version=f"melp-warp {__version__}")
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")
    _add_run(commands)
    _add_scenes(commands)
    _add_preview(commands)
    _add_mesh(commands)
    _add_blender(commands)
    _add_check(commands)
    _add_measure(commands)
    _add_report(commands)
    _add_tradeoff(commands)
    for name, command in commands.choices.items():
        command.add_argument("--traceback", action="store_true", help="print Python's traceback with an error")
        if name in ("run", "preview", "tradeoff"):
            command.add_argument("--verbose", action="store_true", help="let Warp say what it starts and compiles")
    return parser


def _path(text: str) -> Path:
    if not text:
        raise argparse.ArgumentTypeError("it must not be empty")
    return Path(text)


def _add_run(commands: argparse._SubParsersAction) -> None:
    run = commands.add_parser("run", help="simulate a scene", description="Simulate a scene and write it as USD.")
    run.add_argument("scene", metavar="NAME|PATH.py", help="a scene of `melp-warp scenes`, or a scene file")
    run.add_argument("--device", default="cpu", help="cpu or cuda:0 (default: cpu)")
    run.add_argument("--frames", metavar="N", help="frames after the first")
    run.add_argument("--fps", metavar="F", help="frames per simulated second")
    step = run.add_mutually_exclusive_group()
    step.add_argument("--dt", metavar="S", help="largest time step, s")
    step.add_argument("--cfl", metavar="C", help="largest motion in a step, E spacings (sets dt to auto)")
    run.add_argument("--seed", metavar="N", help="seed of everything random")
    run.add_argument(
        "--quality",
        metavar="Q",
        default="standard",
        help="draft, standard, fine or paper; keys that are given override it",
    )
    run.add_argument(
        "--set", metavar="KEY=VALUE", nargs="+", action="extend", default=[], help="change numbers of the scene"
    )
    run.add_argument("--out", metavar="DIR", type=_path, help="folder to write, new or empty (default: out/NAME)")
    run.add_argument(
        "--export", choices=("l", "e", "both"), help="particles to write: L, E or both (default: L where there are any)"
    )
    run.add_argument(
        "--full", action="store_true", help="store L to the bit; else their widths, normals and colours are rounded"
    )
    run.add_argument("--mesh", action="store_true", help="write a surface mesh of each region")
    run.add_argument(
        "--triangles", metavar="N", type=int, help="triangles of all meshes of a frame, about; asks for --mesh"
    )
    run.add_argument(
        "--whole", action="store_true", help="write one mesh for the whole foam, partitions once; asks for --mesh"
    )
    run.add_argument(
        "--puncture",
        metavar="X,Y,Z,T[,R]",
        action="append",
        help="puncture the film at the point nearest to X,Y,Z (m) at time T (s), hole of radius R; may be repeated",
    )
    run.add_argument(
        "--writer",
        metavar="FILE.py:CLASS",
        action="append",
        help="write the frames with this, too: a class in a file or, as MODULE:CLASS, in a module; may be repeated",
    )
    run.add_argument("--start", metavar="N", type=int, help="number of the first frame (default: 0)")
    over = run.add_mutually_exclusive_group()
    over.add_argument("--resume", action="store_true", help="go on with the run in DIR, or extend it to more --frames")
    over.add_argument(
        "--branch", metavar="FROM", type=_path, help="go on from the run in FROM with other numbers, in DIR"
    )
    over.add_argument("--overwrite", action="store_true", help="remove the run that DIR holds and start anew")
    run.add_argument(
        "--checkpoint",
        metavar="EVERY",
        default="5min",
        help="write one every N frames, 30s or 5min, besides at start and end (default: 5min; 0: not between)",
    )
    run.add_argument("--max-memory", metavar="SIZE", help="refuse a run that takes more, such as 4GB (default: all)")
    run.add_argument("--max-disk", metavar="SIZE", help="refuse a cache that takes more (default: what is free)")
    run.add_argument("--preview", action="store_true", help="draw preview.png and contact.png at the end")
    run.add_argument("--quiet", action="store_true", help="print nothing but errors")
    run.add_argument("--no-budget", action="store_true", help="keep no energy budget")
    run.add_argument("--strict", action="store_true", help="exit with 1 where the run has notices")
    run.add_argument(
        "--estimate", action="store_true", help="print memory, time and disk of the run from a few steps; write nothing"
    )
    run.set_defaults(command=_run)


def _add_scenes(commands: argparse._SubParsersAction) -> None:
    scenes = commands.add_parser(
        "scenes", help="list the scenes, or the numbers of one", description="List the scenes, or the numbers of one."
    )
    scenes.add_argument("scene", nargs="?", metavar="NAME|PATH.py", help="list this scene's keys")
    scenes.set_defaults(command=_scenes)


def _add_preview(commands: argparse._SubParsersAction) -> None:
    preview = commands.add_parser("preview", help="draw frames", description="Draw frames as pictures or a movie.")
    add = preview.add_argument
    add("folder", metavar="DIR", type=_path, help="folder that a run wrote")
    add("--frame", metavar="N", type=int, help="frame number (default: the last)")
    add("--frames", metavar="A:B[:STEP]", type=_frames, help="frames A to B; `:` for all")
    add("--out", metavar="FILE", type=_path, help="picture, its format by its ending; with # for numbers")
    add("--movie", metavar="FILE", type=_path, help="movie of the frames, .mp4 or .gif (default: of all)")
    add("--fps", metavar="F", type=float, help="pictures a second of the movie (default: the run's)")
    add("--size", metavar="N|WxH", type=_size, default=(800, 800), help="pixels (default: 800)")
    add("--from", dest="toward", metavar="X,Y,Z", type=_vector, help="direction from the film to the camera")
    add("--orbit", metavar="DEG", type=float, default=0.0, help="turn the camera around the film")
    add("--look-at", metavar="X,Y,Z", type=_vector, help="middle of the picture, m")
    add("--eye", metavar="X,Y,Z", type=_vector, help="where the camera stands, m")
    add("--fov", metavar="DEG", type=float, default=22.0, help="angle of view (default: 22)")
    add("--environment", metavar="NAME|FILE", default="auto", help="studio, panel, sky, white or a picture")
    add("--background", metavar="NAME", default="dark", help="dark, light, around or #rrggbb")
    add("--exposure", metavar="X", type=float, help="gain on the light (default: 13)")
    add("--layers", metavar="N", type=int, help="films seen behind one another at most (default: 8)")
    add("--samples", metavar="N", type=int, default=2, help="samples along a pixel's side, 1 to 4 (default: 2)")
    add("--particles", action="store_true", help="draw the particles, not the surface")
    add("--show", metavar="NAME", help="draw what the scene declares, in false colours from dark blue to yellow")
    add("--device", default="cpu", help="cpu or cuda:0 (default: cpu)")
    preview.set_defaults(command=_preview)


def _frames(text: str) -> tuple[int | None, int | None, int]:
    """First and last frame, None for the cache's, and step."""
    parts = text.split(":")
    try:
        if len(parts) in (2, 3):
            first, last, step = (int(part) if part else None for part in [*parts, ""][:3])
            return first, last, 1 if step is None else step
    except ValueError:
        pass
    raise argparse.ArgumentTypeError(f"must be A:B or A:B:STEP in whole numbers, got {text!r}")


def _size(text: str) -> tuple[int, int]:
    """Width and height."""
    width, _, height = text.lower().partition("x")
    try:
        return int(width), int(height or width)
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be N or WxH in pixels, got {text!r}") from None


def _vector(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"must be three numbers X,Y,Z, got {text!r}") from None
    return x, y, z


def _add_mesh(commands: argparse._SubParsersAction) -> None:
    mesh = commands.add_parser(
        "mesh",
        help="put surface meshes into a written cache",
        description="Put a surface mesh of each region into every frame of a cache, in place of those that are there.",
    )
    mesh.add_argument("folder", metavar="DIR", type=_path, help="folder that a run wrote, with E")
    mesh.add_argument("--triangles", metavar="N", type=int, help="triangles of a frame, about (default: as many as L)")
    mesh.add_argument("--whole", action="store_true", help="one mesh for the whole foam, partitions once")
    mesh.set_defaults(command=_mesh)


def _add_blender(commands: argparse._SubParsersAction) -> None:
    words = "write a script that opens the cache in Blender"
    blender = commands.add_parser("blender", help=words, description=f"{words[0].upper()}{words[1:]}.")
    blender.add_argument("folder", metavar="DIR", type=Path, help="folder that a run wrote")
    blender.set_defaults(command=_blender)


def _add_check(commands: argparse._SubParsersAction) -> None:
    check = commands.add_parser(
        "check", help="check a written cache", description="Check that a folder that a run wrote is a sound cache."
    )
    check.add_argument("folder", metavar="DIR", type=_path, help="folder that a run wrote")
    check.set_defaults(command=_check)


def _add_measure(commands: argparse._SubParsersAction) -> None:
    measure = commands.add_parser(
        "measure",
        help="measure the bubbles of a frame",
        description="Measure the bubbles of a frame: volumes, radii, partitions and the angles at which films meet.",
    )
    measure.add_argument("folder", metavar="DIR", type=_path, help="folder that a run wrote")
    measure.add_argument("--frame", metavar="N", type=int, help="frame number (default: the last)")
    measure.add_argument("--json", metavar="FILE", type=_path, help="write all numbers as JSON as well")
    measure.add_argument(
        "--set", choices=("film", "e"), dest="which", help="particles to measure (default: E where the cache has them)"
    )
    measure.add_argument("--spacing", metavar="M", type=float, help="E spacing, m (default: from the particles)")
    measure.set_defaults(command=_measure)


def _add_report(commands: argparse._SubParsersAction) -> None:
    report = commands.add_parser(
        "report",
        help="print and draw the energy budget of a run, print the grain of its frames",
        description="Print the energy budget of a run and the grain of its frames; draw budget.png (needs matplotlib).",
    )
    report.add_argument("folder", metavar="DIR", type=_path, help="folder that a run wrote")
    report.set_defaults(command=_report_budget)


def _add_tradeoff(commands: argparse._SubParsersAction) -> None:
    study = commands.add_parser(
        "tradeoff",
        help="measure speed against accuracy for a scene",
        description="Run a scene small over the knobs, against a finer run, and tell error and cost of each.",
    )
    study.add_argument("scene", metavar="NAME|PATH.py", help="a scene of `melp-warp scenes`, or a scene file")
    study.add_argument(
        "--set", metavar="KEY=VALUE", nargs="+", action="extend", default=[], help="change numbers of the scene"
    )
    study.add_argument("--e", metavar="N", type=int, default=400, help="E of the standard run (default: 400)")
    study.add_argument("--frames", metavar="N", type=int, default=12, help="frames of each run (default: 12)")
    study.add_argument("--out", metavar="DIR", type=_path, help="folder for tradeoff.csv, .json and .png; new or empty")
    study.set_defaults(command=_tradeoff)


def _run(options: argparse.Namespace) -> int:
    from melp_warp.bursting import Puncture
    from melp_warp.program import runner
    from melp_warp.program.plan import Every, Plan
    from melp_warp.program.resume import numbers_of, options_of
    from melp_warp.program.room import Room, parse_size
    from melp_warp.quality import find_quality
    from melp_warp.registry import load_scene

    script = load_scene(options.scene)
    quality, given = find_quality(options.quality), script.parameters.parse(_settings(options))
    out = options.out if options.out is not None else Path("out") / script.name
    writes = {
        "export": options.export,
        "full": options.full or None,
        "mesh": True if options.mesh or options.whole or options.triangles is not None else None,
        "triangles": options.triangles,
        "whole": options.whole or None,
        "first": options.start,
        "budget": False if options.no_budget else None,
        "punctures": ";".join(options.puncture) if options.puncture else None,
        "writers": ";".join(options.writer) if options.writer else None,
    }
    for text in options.puncture or ():
        Puncture.parse(text)
    start = None
    if options.resume or options.branch is not None:
        start = runner.start_from(out if options.resume else options.branch)
        require(options.resume or options.branch.resolve() != out.resolve(), "--out", str(out), "another than --branch")
        if options.quality != "standard":
            given = quality.values(script, given).as_dict()
        values = script.parameters.values(numbers_of(start, script.name, given, same=options.resume))
        writes = options_of(start, writes, same=options.resume)
    else:
        values = quality.values(script, given)
        usual = {
            "full": False,
            "mesh": False,
            "whole": False,
            "first": 0,
            "budget": True,
            "punctures": "",
            "writers": "",
        }
        writes = usual | {k: v for k, v in writes.items() if v is not None}
    budget, scene = writes.pop("budget"), script.build(values)
    more = [Puncture.parse(text) for text in writes["punctures"].split(";") if text]
    bursting = replace(scene.bursting, punctures=(*scene.bursting.punctures, *more))
    plan = Plan(
        scene=replace(scene, budget=budget, bursting=bursting),
        name=script.name,
        parameters=values.as_dict(),
        out=out,
        device=options.device,
        preview=options.preview,
        quiet=options.quiet,
        strict=options.strict,
        every=Every.parse(options.checkpoint),
        overwrite=options.overwrite,
        start=start,
        room=Room(parse_size("--max-memory", options.max_memory), parse_size("--max-disk", options.max_disk)),
        **writes,
    )
    if not options.quiet:
        _warn(script.parameters.doubts(given))
    if options.estimate:
        print(runner.estimate(plan).table())
        return OK
    return runner.run(plan)


def _settings(options: argparse.Namespace) -> list[str]:
    """The options that stand for keys, as key=value, and those of --set."""
    given = [(key, getattr(options, key)) for key in ("frames", "fps", "dt", "cfl", "seed")]
    settings = [f"{key}={value}" for key, value in given if value is not None]
    if options.cfl is not None:
        settings.append("dt=auto")
    return settings + options.set


def _scenes(options: argparse.Namespace) -> int:
    from melp_warp.registry import load_scene, scene_names

    if options.scene is None:
        print(columns([(name, load_scene(name).description) for name in scene_names()]))
        return OK
    script = load_scene(options.scene)
    rows = [("key", "value", "unit", "meaning", "allowed")]
    for name, value in script.parameters.defaults.items():
        key = script.parameters.keys[name]
        rows.append(
            (
                name,
                _shown(value),
                key.unit,
                key.meaning,
                key.limits,
            )
        )
    print(f"{script.name}: {script.description}\n")
    print(columns(rows))
    print("\nWhat --quality changes:\n")
    print(columns(_quality_rows(script)))
    return OK


def _quality_rows(script: SceneScript) -> list[tuple[str, ...]]:
    """Header and a row for every key that a quality changes in a scene."""
    from melp_warp.quality import QUALITIES

    columns = {name: quality.values(script).as_dict() for name, quality in QUALITIES.items()}
    keys = [key for key in script.parameters if len({values[key] for values in columns.values()}) > 1]
    return [("key", *columns), *((key, *(_shown(values[key]) for values in columns.values())) for key in keys)]


def _shown(value: object) -> str:
    """A value as it is typed."""
    return "auto" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)


def _preview(options: argparse.Namespace) -> int:
    from melp_warp.preview.pictures import Shot
    from melp_warp.program import afterwards

    given = vars(options) | {"width": options.size[0], "height": options.size[1]}
    require(options.frame is None or options.frames is None, "--frames", options.frames, "left out with --frame")
    if options.frame is not None:
        given["frames"] = (options.frame, options.frame, 1)
    elif options.movie is not None and options.frames is None:
        given["frames"] = (None, None, 1)
    for path in afterwards.draw(Shot(**{name: given[name] for name in Shot.__dataclass_fields__})):
        print(path)
    return OK


def _mesh(options: argparse.Namespace) -> int:
    from melp_warp.program import afterwards

    problems = afterwards.mesh_cache(options.folder, options.triangles, options.whole)
    for problem in problems:
        print(problem)
    if problems:
        return FAILED
    print(f"{options.folder}: every frame has its meshes, all closed")
    return OK


def _blender(options: argparse.Namespace) -> int:
    from melp_warp.program import afterwards

    print(afterwards.write_blender(options.folder))
    return OK


def _check(options: argparse.Namespace) -> int:
    from melp_warp.usd.apart import check_cache

    require(options.folder.is_dir(), "DIR", str(options.folder), "a folder that a run wrote")
    problems = check_cache(options.folder)
    for problem in problems:
        print(problem)
    if problems:
        return FAILED
    print(f"{options.folder}: no problem found")
    return OK


def _measure(options: argparse.Namespace) -> int:
    import json

    from melp_warp.files import replacing
    from melp_warp.measure.results import measure_cache

    found = measure_cache(options.folder, options.frame, options.which, options.spacing)
    if options.json is not None:
        with replacing(options.json) as temporary:
            temporary.write_text(json.dumps(found.to_json(), indent=1, allow_nan=False) + "\n")
    print(found.table())
    return OK


def _report_budget(options: argparse.Namespace) -> int:
    from melp_warp.program.report import draw_budget, print_budget, print_grain, read_budget, read_grain

    lines = read_budget(options.folder)
    print_budget(lines)
    print_grain(read_grain(options.folder))
    print(draw_budget(lines, options.folder / "budget.png"))
    return OK


def _tradeoff(options: argparse.Namespace) -> int:
    from melp_warp.program import runner
    from melp_warp.registry import load_scene

    require(options.e >= 1, "--e", options.e, "a whole number above 0")
    require(options.frames >= 1, "--frames", options.frames, "a whole number above 0")
    script = load_scene(options.scene)
    overrides = script.parameters.parse(options.set)
    _warn(script.parameters.doubts(overrides))
    print(runner.trade(script, overrides, options.e, options.frames, options.out))
    return OK
