"""Fixtures shared by all tests."""

import pytest
import warp as wp


@pytest.fixture(scope="session")
def device():
    """The device every test runs on."""
    wp.config.log_level = wp.LOG_WARNING
    wp.init()
    return wp.get_device("cpu")
