"""Fixtures shared by all tests."""

import os
import signal

import pytest
import warp as wp

if "PYTEST_XDIST_WORKER" in os.environ:  # a process a core: each works on one thread, with the same bits
    os.environ.setdefault("MELP_WARP_THREADS", "1")


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
