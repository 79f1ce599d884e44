"""Find scenes: by name among the installed ones, or in a file anywhere."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import pkgutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from melp_warp.errors import InputError
from melp_warp.parameters import Parameters, Values
from melp_warp.scene import Scene

NOT_INSTALLED = "melp-warp is not installed: run `pip install -e .` in the checkout first"


@dataclass(frozen=True)
class SceneScript:
    """A scene that can be run.

    Attributes:
        name: name of the scene's file without .py.
        description: first line of its docstring.
        parameters: what it declares as PARAMETERS.
        build: its `build(p)`, from parameter values to a `Scene`.
    """

    name: str
    description: str
    parameters: Parameters
    build: Callable[[Values], Scene]


def scene_names() -> list[str]:
    """Names of the installed scenes.

    Raises:
        InputError: where the package runs from a checkout that is not installed.
    """
    try:
        import melp_warp.scenes as package
    except ModuleNotFoundError as error:
        raise InputError(NOT_INSTALLED) from error
    return sorted(module.name for module in pkgutil.iter_modules(package.__path__))


def load_scene(name_or_path: str) -> SceneScript:
    """Load an installed scene by name, or any scene by the path of its .py file.

    Raises:
        InputError: for an unknown name, a file that is missing or fails, or one that is not a scene.
    """
    if name_or_path.endswith(".py"):
        return _script(_import_file(Path(name_or_path)), Path(name_or_path).stem)
    names = scene_names()
    if name_or_path not in names:
        near = difflib.get_close_matches(name_or_path, names, n=2)
        hint = f"did you mean {' or '.join(near)}? " if near else ""
        raise InputError(
            f"unknown scene {name_or_path!r}: {hint}scenes are {', '.join(names)}, or the path of a .py file"
        )
    return _script(importlib.import_module(f"melp_warp.scenes.{name_or_path}"), name_or_path)


def _import_file(path: Path) -> ModuleType:
    if not path.is_file():
        raise InputError(f"unknown scene {str(path)!r}: there is no such file")
    # dataclasses and pickles in the file look their module up by name
    name = f"melp_warp_scene_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except InputError:
        raise
    except Exception as error:
        where = f"line {error.lineno}, " if isinstance(error, SyntaxError) else ""
        raise InputError(f"scene file {path} failed: {where}{type(error).__name__}: {_first_line(error)}") from error
    return module


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or ["no message"])[0]


def _script(module: ModuleType, name: str) -> SceneScript:
    parameters, build = getattr(module, "PARAMETERS", None), getattr(module, "build", None)
    if not isinstance(parameters, Parameters) or not callable(build):
        raise InputError(f"{name!r} is not a scene: it must have PARAMETERS = declare(...) and build(p)")
    lines = (module.__doc__ or "").strip().splitlines()
    return SceneScript(name, lines[0] if lines else "", parameters, build)
