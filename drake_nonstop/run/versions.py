"""Versions of this package and of others, as results name them."""

import functools
import sys

from drake_nonstop.version import __version__


def versions(*packages: str) -> dict[str, str | None]:
    """The versions of this package and of others, by their names; None: not installed."""
    found: dict[str, str | None] = {"drake_nonstop": __version__}
    return found | {package: _installed(package, *sys.path) for package in packages}


@functools.cache
def _installed(package: str, *path: str) -> str | None:
    """The version of a package that is found on a path: to read it takes milliseconds."""
    from importlib.metadata import PackageNotFoundError, version  # here: it imports `email`

    try:
        return version(package)
    except PackageNotFoundError:
        return None
