"""Building optimizers of torch."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from tempfile import TemporaryDirectory

from nnql_bullet.machine import variable

_CACHE_FOLDER = "TORCHINDUCTOR_CACHE_DIR"


@contextmanager
def without_cache_folder() -> Iterator[None]:
    """Keeps torch from leaving a cache folder of its compiler, which it imports with the first optimizer."""
    if "torch._dynamo" in sys.modules or _CACHE_FOLDER in os.environ:
        yield
        return
    with TemporaryDirectory(prefix="nnql-bullet-") as folder, variable(_CACHE_FOLDER, folder):
        yield
