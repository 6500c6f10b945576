"""A cluster of this machine, for what runs on one."""

import importlib.util
import os
import secrets

import pytest


@pytest.fixture(scope="session")
def cluster():
    """A local Ray of its own, that reports to nobody and leaves nothing in the home."""
    if importlib.util.find_spec("ray") is None:
        pytest.skip("the extra ray is not installed")
    before = dict(os.environ)
    os.environ |= {
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_worker_niceness": "0",  # by default others go first
    }
    import ray

    ray.init(
        address="local",
        num_cpus=2,
        object_store_memory=128 << 20,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="ERROR",
    )
    yield ray
    ray.shutdown()
    os.environ.clear()
    os.environ.update(before)
