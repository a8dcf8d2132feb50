"""palpate runs vibrotactile psychophysics, from an ethics-reviewed protocol to published tables.

`palpate.experiment` goes from a protocol file to a dataset, `palpate.analysis` from a dataset to tables. In a checkout
both are folders at its root, where Python finds them; the links beside this file are for type checkers and editors,
which find modules by the names of folders alone. What `import palpate` hands out stands in `library.py`, and is
imported when it is first asked for.
"""

import os

__all__ = ["audit", "compare", "contact", "crinkle", "detect", "identify", "power", "rate", "read", "spectrum"]

__version__ = "0.2.0"

_here = os.path.dirname(os.path.abspath(__file__))  # noqa: PTH100, PTH120
if not os.path.isdir(os.path.join(_here, "experiment", "shipped")):  # noqa: PTH112, PTH118
    # Only a wheel holds the shipped protocols; in a checkout the root comes first, so that no link is ever followed.
    __path__ = [os.path.dirname(_here), *__path__]  # noqa: PTH120


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'palpate' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module("palpate.library"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
