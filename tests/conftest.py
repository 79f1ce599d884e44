"""Fixtures shared by all tests."""

import importlib
import os
import pkgutil
import signal

import pytest
import warp as wp

import melp_warp.kernels

if "PYTEST_XDIST_WORKER" in os.environ:  # a process a core: each works on one thread, with the same bits
    os.environ.setdefault("MELP_WARP_THREADS", "1")


def pytest_sessionstart(session):
    """Compile all kernels, a module a core, before the workers start: each would compile the same ones at once."""
    if getattr(session.config.option, "numprocesses", None) and not hasattr(session.config, "workerinput"):
        wp.config.log_level = wp.LOG_WARNING
        names = [f"melp_warp.kernels.{found.name}" for found in pkgutil.iter_modules(melp_warp.kernels.__path__)]
        modules = [wp.get_module(importlib.import_module(name).__name__) for name in names]
        wp.force_load("cpu", modules=modules, max_workers=os.cpu_count())


@pytest.fixture(scope="session")
def device():
    """The device every test runs on."""
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    return wp.get_device("cpu")


@pytest.fixture
def ctrl_c():
    """Ctrl-C raises KeyboardInterrupt, where the tests run in the background of a shell that has it ignored too."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
