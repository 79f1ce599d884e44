"""Fixtures shared by all tests."""

import signal

import pytest
import warp as wp


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
