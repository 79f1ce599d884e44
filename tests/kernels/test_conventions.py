"""What every kernel file keeps to: device code only, documented, named after the particles it writes."""

import ast
import pkgutil
from pathlib import Path

import pytest

import melp_warp
from melp_warp import kernels

FILES = [Path(kernels.__path__[0]) / f"{info.name}.py" for info in pkgutil.iter_modules(kernels.__path__)]
STAGES = ("advance", "boundary", "foam", "forces", "geometry", "membrane", "redistribute", "single_layer")
STAGES += ("surfactant", "transfer")
SUFFIXES = ("_e", "_l", "_b", "_r", "_chunks")


def parse(path):
    return ast.parse(path.read_text())


def device_functions(tree, *kinds):
    """Functions decorated with @wp.kernel or @wp.func."""
    return [
        node
        for node in ast.walk(tree)
        if isinstance(node, ast.FunctionDef) and any(ast.unparse(d) in kinds for d in node.decorator_list)
    ]


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_documented_and_typed(path):
    """Every kernel, function and struct says what it does; every argument has a type."""
    tree = parse(path)
    assert ast.get_docstring(tree)
    structs = [node for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
    for node in [*device_functions(tree, "wp.kernel", "wp.func"), *structs]:
        assert ast.get_docstring(node), f"{path.stem}.{node.name} has no docstring"
    for node in device_functions(tree, "wp.kernel", "wp.func"):
        for argument in node.args.args:
            assert argument.annotation is not None, f"{path.stem}.{node.name}: {argument.arg} has no type"


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_device_code_only(path):
    """A kernel file imports Warp and its siblings; it launches, allocates and reads back nothing."""
    tree = parse(path)
    allowed = ("warp", "typing", "math", "__future__", "melp_warp.kernels")
    for node in ast.walk(tree):
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        for name in names:
            assert name in allowed or name.startswith("melp_warp.kernels."), f"{path.stem} imports {name}"
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            assert called.split(".")[-1] not in ("launch", "launch_tiled", "numpy", "zeros", "synchronize"), called


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_no_lower_case_numbers(path):
    """A lower-case number of a module would enter its hash through a kernel argument of the same name."""
    for node in parse(path).body:
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant):
            for target in node.targets:
                assert target.id == target.id.upper(), f"{path.stem}.{target.id}"


@pytest.mark.parametrize("path", [p for p in FILES if p.stem in STAGES], ids=lambda p: p.stem)
def test_named_after_what_is_written(path):
    """Kernels of the step with a thread a particle end in the set written, _e, _l or _b; one a region _r; sums _chunks.

    Kernels of a single thread write scalars and are free.
    """
    for node in device_functions(parse(path), "wp.kernel"):
        if "wp.tid()" in ast.unparse(node):
            assert node.name.endswith(SUFFIXES), f"{path.stem}.{node.name}"


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_no_backward_code(path):
    """Files with kernels switch off the reverse pass, which would double what is compiled."""
    tree = parse(path)
    if device_functions(tree, "wp.kernel"):
        assert any("enable_backward" in ast.unparse(node) for node in tree.body if isinstance(node, ast.Expr))


def test_only_launch_launches():
    """Host code launches and captures through `device.launch`; the preview renderer, no part of the step, does not.

    `launch` has what allocates, too, which a graph cannot hold.
    """
    package = Path(melp_warp.__file__).parent
    for path in sorted(package.rglob("*.py")):
        if path.stem not in ("launch", "draw", "surface"):
            for call in ("wp.launch(", "wp.capture_", "wp.ScopedCapture", "wp.utils."):
                assert call not in path.read_text(), f"{path.stem} calls {call} by itself"


def test_stages_copy_by_launch():
    """Within a sequence that each core records, one core alone copies and clears: `launch.copy`, `launch.clear`.

    Lists are built, and films set up, outside of any.
    """
    package = Path(melp_warp.__file__).parent
    stages = [path for path in sorted(package.rglob("*.py")) if "launch_e(" in path.read_text()]
    assert len(stages) > 8
    for path in stages:
        if path.stem not in ("neighbors", "sampling"):
            for call in ("wp.copy(", ".zero_()", ".fill_("):
                assert call not in path.read_text(), f"{path.stem} calls {call} by itself"
