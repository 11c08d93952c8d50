"""One thread for linear algebra, so that results do not depend on the number of cores."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_thread_of_blas() -> Iterator[None]:
    """As `one_thread`, where torch is not used."""
    from threadpoolctl import threadpool_limits

    with threadpool_limits(1):
        yield


def one_thread_from_now_on() -> None:
    """Limit torch to one thread in this process."""
    import torch

    torch.set_num_threads(1)


@contextmanager
def one_thread() -> Iterator[None]:
    """Limit torch and BLAS to one thread, so that sums have the same order in every run and workers get the cores."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with one_thread_of_blas():
            yield
    finally:
        torch.set_num_threads(before)
