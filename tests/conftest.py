"""The tiers of the suite, signals, and fixtures for all tests.

A test without a mark is a unit or a short flight. `slow` ones are left out by `make quick`, and
`nightly` ones, each of a class, run in `make nightly` only.

What loads Drake is imported by the fixtures: the process that starts the workers needs none of it.
"""

import gc
import os
import random
import signal
from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
import pytest

if TYPE_CHECKING:
    from fleet import Fleet

# Why a test takes longer than `make test` can wait: the classes of `nightly`.
CLASSES = {
    "adversary": "bad and extreme inputs",
    "benchmarks": "the claims on speed, and what measures them",
    "browsers": "pages in a headless Chromium",
    "engines": "both engines, both load plants, on everything",
    "examples": "examples, pages and notebooks, executed whole",
    "flights": "flights of many variants of one task, or of long ones",
    "processes": "studies in processes, signals and kills",
    "studies": "drawn loops, tasks and designs beyond two of a property",
}


def pytest_addoption(parser: pytest.Parser) -> None:
    text = "of each class of nightly tests, that many, the same in every run"
    parser.addoption("--sample", type=int, default=0, metavar="N", help=text)


def pytest_configure(config: pytest.Config) -> None:
    # Where the suite is started with SIGINT ignored, as by nohup and some CI runners, Python has no
    # handler for it, and children would ignore it as well.
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    by_class: dict[str, list[pytest.Item]] = {name: [] for name in CLASSES}
    for item in items:
        mark = item.get_closest_marker("nightly")
        if mark is not None:
            if mark.args not in {(name,) for name in CLASSES}:
                remedy = f"give one of {', '.join(CLASSES)}"
                raise pytest.UsageError(f"{item.nodeid}: nightly{mark.args}: {remedy}")
            by_class[mark.args[0]].append(item)
    count = config.getoption("sample")
    if count:
        chosen: set[pytest.Item] = set()
        for name, some in by_class.items():
            chosen |= {*random.Random(name).sample(some, min(count, len(some)))}
        config.hook.pytest_deselected(items=[item for item in items if item not in chosen])
        items[:] = [item for item in items if item in chosen]


def pytest_collection_finish() -> None:
    # What is there by now stays: the collector need not look at it again and again.
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="module", autouse=True)
def little_memory() -> Iterator[None]:
    """After a module what its tests have left behind is freed, if it is much."""
    from memory import free_memory

    yield
    free_memory()


@pytest.fixture
def rng() -> np.random.Generator:
    """Random numbers, the same in every run and for every test."""
    return np.random.default_rng(20240607)


@pytest.fixture(scope="session")
def fleet(tmp_path_factory) -> "Fleet":
    """Flights that all tests of all workers share."""
    from fleet import Fleet

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # each worker has a folder of its own in it
    return Fleet(folder / "fleet")


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Results without the drawing of their diagrams, which takes longer than a short flight."""
    from drake_nonstop.studies import results_folder

    monkeypatch.setattr(results_folder, "draw_diagram", lambda diagram: "<svg/>")


@pytest.fixture
def watched():
    """A new page of a headless Chromium."""
    from pages import WatchedPage, page_or_skip

    with page_or_skip() as page:
        yield WatchedPage(page)


@pytest.fixture
def needs_browser():
    """For a test whose subject opens a browser of its own."""
    from pages import page_or_skip

    with page_or_skip():
        pass
