import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(autouse=True, scope="package")
def one_thread():
    """As in a build: the threads of small matrix products would only wait for each other."""
    with threadpool_limits(1):
        yield
