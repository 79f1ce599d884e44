"""The solver in float64: with MELP_WARP_PRECISION=64 the package is loaded as if its source said double.

The source is written once, for float32, and read as it stands unless the variable asks otherwise. Warp promotes no
literal and has a type for each precision, so `rewrite` changes the text of a module, line by line, as it is loaded:

* everywhere `wp.float32`, `wp.vec3`, `wp.mat33`, ... become `wp.float64`, `wp.vec3d`, `wp.mat33d`, ..., and so does
  `dtype=float` where Warp is called;
* in kernels, functions and structs `float` and literals become `wp.float64`, in C++ rows `float` becomes `double`;
* a `wp.constant` of a float is a `wp.float64`;
* hash grids take float64 points.

One process has one precision: `install` must run before any other module of the package is loaded.
"""

from __future__ import annotations

import ast
import linecache
import os
import re
import sys
from importlib.machinery import ModuleSpec, SourceFileLoader
from types import CodeType, ModuleType

from melp_warp.errors import require

VARIABLE = "MELP_WARP_PRECISION"
"""Environment variable: 32, the default, or 64. Read by `melp_warp/__init__.py`."""

PICTURES = (
    *("melp_warp.kernels.color", "melp_warp.kernels.raster", "melp_warp.kernels.render", "melp_warp.kernels.tiles"),
    "melp_warp.kernels.whole",
    *("melp_warp.optics", "melp_warp.preview.draw", "melp_warp.preview.surface", "melp_warp.mesh.whole"),
)
"""Modules that stay as they are: they draw, and Warp's meshes hold float32 alone."""

_TYPES = re.compile(r"(vec[234]|mat22|mat33|mat44|quat|transform)f?")
_RANDOM = {"randf", "randn"}
_COMPILED = {"kernel", "func", "func_native", "struct"}


def install() -> None:
    """Load the package's modules in float64 from now on.

    Raises:
        InputError: the variable asks for another precision.
    """
    require(os.environ[VARIABLE] == "64", VARIABLE, os.environ[VARIABLE], "32 or 64")
    sys.meta_path.insert(0, _Finder())


def loader(name: str, path: str) -> SourceFileLoader | None:
    """What loads a scene file in float64; None where the package is in float32, and Python's own loader does."""
    return _Loader(name, path) if any(isinstance(finder, _Finder) for finder in sys.meta_path) else None


def rewrite(source: str) -> str:
    """The text of a module in float64; every line stays where it is."""
    lines = source.encode().splitlines(keepends=True)
    edits = _Edits()
    edits.visit(ast.parse(source))
    for line, start, end, text in sorted(edits.found, reverse=True):
        row = lines[line - 1]
        lines[line - 1] = row[:start] + text.encode() + row[end:]
    return b"".join(lines).decode()


def double_constant(value: float) -> object:
    """A constant of a kernel file."""
    import warp as wp  # by then it is; the package itself does without

    return wp.float64(value) if isinstance(value, float) else value


def double_snippet(code: str) -> str:
    """C++ in double.

    Raises:
        ValueError: it has a type of several floats, which has no namesake.
    """
    code = re.sub(r"\bfloat\b", "double", code)
    code = re.sub(r"(\d\.\d*(?:e[-+]?\d+)?)f\b", r"\1", code)
    code = re.sub(r"\b([a-z]+)f\(", r"\1(", code)
    if "float" in code:
        raise ValueError(f"C++ that cannot be made double: {code}")
    return code


class _Finder:
    """Finds modules of the package where the others do, and has them loaded by `_Loader`."""

    def find_spec(self, name: str, path=None, target=None) -> ModuleSpec | None:
        if not name.startswith("melp_warp.") or name in PICTURES:
            return None
        found = (finder.find_spec(name, path, target) for finder in sys.meta_path if finder is not self)
        spec = next((spec for spec in found if spec is not None), None)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(name, spec.origin)
        return spec


class _Loader(SourceFileLoader):
    """Compiles the rewritten text and hands it to Warp, which reads kernels from `linecache`."""

    def path_stats(self, path: str) -> dict:
        raise OSError("no bytecode: that on disk is of float32")

    def source_to_code(self, data: bytes, path: str, *, _optimize: int = -1) -> CodeType:
        source = rewrite(data.decode())
        linecache.cache[path] = (len(source), None, source.splitlines(keepends=True), path)
        return compile(source, path, "exec", dont_inherit=True, optimize=_optimize)

    def exec_module(self, module: ModuleType) -> None:
        module.double_snippet, module.double_constant = double_snippet, double_constant
        super().exec_module(module)


class _Edits(ast.NodeVisitor):
    """Finds what is to be changed.

    Attributes:
        found: line, first and last + 1 byte in it, and what takes their place.
    """

    def __init__(self):
        self.found: list[tuple[int, int, int, str]] = []
        self._compiled = False  # whether the node is in what Warp compiles

    def _replace(self, node: ast.AST, text: str) -> None:
        self.found.append((node.lineno, node.col_offset, node.end_col_offset, text))

    def _wrap(self, node: ast.AST, before: str, after: str = ")") -> None:
        self.found.append((node.lineno, node.col_offset, node.col_offset, before))
        self.found.append((node.end_lineno, node.end_col_offset, node.end_col_offset, after))

    def visit_FunctionDef(self, node: ast.FunctionDef | ast.ClassDef) -> None:
        decorators = (d.func if isinstance(d, ast.Call) else d for d in node.decorator_list)
        before, self._compiled = self._compiled, self._compiled or any(_of_warp(d) in _COMPILED for d in decorators)
        self.generic_visit(node)
        self._compiled = before

    visit_ClassDef = visit_FunctionDef

    def visit_Call(self, node: ast.Call) -> None:
        called = _of_warp(node.func)
        if called == "HashGrid":
            self._wrap([*node.args, *node.keywords][-1], "", ", dtype=wp.float64")
        elif called == "func_native":
            self._wrap(node.args[0], "double_snippet(")
        elif called in _RANDOM:
            self._wrap(node, "wp.float64(")
        elif called == "constant":
            self._wrap(node.args[0], "double_constant(")
        self.generic_visit(node)
        for keyword in node.keywords if called and not self._compiled else ():
            if keyword.arg == "dtype" and ast.unparse(keyword.value) == "float":
                self._replace(keyword.value, "wp.float64")

    def visit_Attribute(self, node: ast.Attribute) -> None:
        name = _of_warp(node)
        if name == "float32":
            self._replace(node, "wp.float64")
        elif name is not None and (match := _TYPES.fullmatch(name)):
            self._replace(node, f"wp.{match[1]}d")
        self.generic_visit(node)

    def visit_Name(self, node: ast.Name) -> None:
        if self._compiled and node.id == "float":
            self._replace(node, "wp.float64")

    def visit_Constant(self, node: ast.Constant) -> None:
        if self._compiled and isinstance(node.value, float):
            self._wrap(node, "wp.float64(")

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        """Nothing: before Python 3.12 its parts do not know where they are."""


def _of_warp(node: ast.AST) -> str | None:
    """The name in `wp.name`."""
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "wp":
        return node.attr
    return None
