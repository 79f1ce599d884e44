"""Every kernel compiles for NVIDIA GPUs, on a machine without one."""

import importlib
import pkgutil
import re
import sys

import pytest
import warp as wp

from melp_warp import kernels

ARCHITECTURES = (80, 90)
NAMES = [info.name for info in pkgutil.iter_modules(kernels.__path__)]


def load(name):
    """The Warp module of a kernel file."""
    importlib.import_module(f"{kernels.__name__}.{name}")
    return wp.get_module(f"{kernels.__name__}.{name}")


def test_modules_are_found():
    """The package's files are all seen: the stages of a step among them."""
    assert {"neighbors", "transfer", "geometry", "membrane", "surfactant", "advance", "redistribute"} <= set(NAMES)


@pytest.mark.skipif(sys.platform == "darwin", reason="Warp has no CUDA compiler there")
@pytest.mark.parametrize("name", NAMES)
def test_compiles_to_ptx(name, device, tmp_path):
    """NVRTC turns the module into PTX for sm_80 and sm_90, with an entry for each kernel and each of its overloads.

    Kernels for any type (linear.py) declare what they are used with, so that they can be compiled ahead of time. A file
    of functions alone compiles as part of the kernels that call them.
    """
    module = load(name)
    wanted = {key: len(k.overloads) if k.is_generic else 1 for key, k in module.kernels.items()}
    if not wanted:
        assert module.functions
        return
    assert all(wanted.values()), f"kernels without declared types: {[k for k, n in wanted.items() if n == 0]}"
    paths = wp.compile_aot_module(module, arch=ARCHITECTURES, module_dir=tmp_path, use_ptx=True)
    assert len(paths) == len(ARCHITECTURES)
    for path, arch in zip(paths, ARCHITECTURES, strict=True):
        text = path.read_text()
        assert re.search(rf"\.target\s+sm_{arch}\b", text)
        for key, count in wanted.items():
            entries = re.findall(rf"\.entry\s+{key}_[0-9a-f]+_cuda_kernel_forward\b", text)
            assert len(entries) == count, f"{name}.{key}: {len(entries)} entries in {path.name}, wanted {count}"
