"""Find scenes: by name among the installed ones, or in a file anywhere."""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import inspect
import pkgutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

from melp_warp.device.float64 import loader
from melp_warp.errors import SCENE_FILE, InputError, from_scene, in_a_line
from melp_warp.parameters import Parameters, Value, Values
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

    def scene(self, **numbers: Value) -> Scene:
        """The scene with some of its numbers replaced, SI or as typed: `scene(radius=0.05, thickness="400nm")`.

        Raises:
            InputError: for an unknown key, or a value that it does not take.
        """
        typed = self.parameters.parse(f"{key}={value}" for key, value in numbers.items() if isinstance(value, str))
        return self.build(self.parameters.values({**numbers, **typed}))


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
    name = f"{SCENE_FILE}{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path, loader=loader(name, str(path)))
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        line = error.lineno if isinstance(error, SyntaxError) else None
        where = f"{path}, line {line}" if line else from_scene(error) or str(path)
        raise InputError(f"scene file {where}: {in_a_line(error)}") from error
    return module


def _script(module: ModuleType, name: str) -> SceneScript:
    parameters, build = getattr(module, "PARAMETERS", None), getattr(module, "build", None)
    if not isinstance(parameters, Parameters) or not callable(build):
        raise InputError(f"{name!r} is not a scene: it must have PARAMETERS = declare(...) and build(p)")
    lines = (module.__doc__ or "").strip().splitlines()
    return SceneScript(name, lines[0] if lines else "", parameters, _checked(build, module.__file__))


def _checked(build: Callable, file: str) -> Callable[[Values], Scene]:
    """A scene's `build(p)`, which must return a scene."""

    def checked(values: Values) -> Scene:
        try:
            inspect.signature(build).bind(values)
        except TypeError as error:
            raise InputError(f"scene file {file}: build must take one argument, p: {error}") from error
        scene = build(values)
        if not isinstance(scene, Scene):
            raise InputError(f"scene file {file}: build(p) must return a Scene, p.scene(...), got {scene!r}")
        return scene

    return checked
