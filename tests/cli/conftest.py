"""Blocks of a user's own, by which a run ends before its time."""

import os
import sys

import pytest

BLOCKS = '''
import os
import time
from dataclasses import dataclass
from pydrake.systems.framework import LeafSystem

@dataclass(kw_only=True)
class EndsConfig:
    """How it ends a run is in the environment, that scenarios be the same."""

class Ends(LeafSystem):
    def __init__(self, model, config):
        super().__init__()
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self.calc)
        self.end("built")

    def calc(self, context, output):
        output.SetFromVector(6 * [0.0])
        if context.get_time() > 0.02:
            self.end("flown")

    def end(self, when):
        at, _, how = os.environ.get("ENDS", "").partition(" ")
        if at == when:
            del os.environ["ENDS"]
            if how == "raises":
                raise ValueError("the block broke")
            try:
                os.kill(os.getpid(), int(how))
                time.sleep(0.1)
            except KeyboardInterrupt:  # as pybind11 does where it converts arguments
                raise TypeError("incompatible constructor arguments") from None

@dataclass(kw_only=True)
class SpinsConfig:
    begin: float = 0.3  # s

class Spins(Ends):
    def __init__(self, model, config):
        LeafSystem.__init__(self)
        self.begin = config.begin
        self.DeclareVectorOutputPort("planned", 8, self.calc)
        self.end("built")

    def calc(self, context, output):
        if context.get_time() > self.begin:
            open("there", "w").close()
            self.stay()
        output.SetFromVector([2 * context.get_time(), 2.0, 1.2, 0, 0, 0, 0, 0])

    def stay(self):
        while True:
            pass

class SwallowsConfig(SpinsConfig): pass
class Swallows(Spins):
    def stay(self):
        while True:
            try:
                time.sleep(0.01)
            except BaseException:
                pass
'''


@pytest.fixture(scope="session")
def blocks(tmp_path_factory):
    """The folder of the module that has them."""
    folder = tmp_path_factory.mktemp("blocks")
    (folder / "ending_blocks.py").write_text(BLOCKS)
    sys.path.append(str(folder))
    yield folder
    sys.path.remove(str(folder))


@pytest.fixture
def ended(blocks, monkeypatch):
    """Runs a command with a block that ends it: as it is "built" or "flown", by what follows."""
    from drake_nonstop.cli.main import main

    short = ["simulation_duration=0.05", "optimization_layer=ConstantParameters"]
    block = "load_disturbance=!ending_blocks.Ends {}"

    def call(how, *arguments, changes=short):
        monkeypatch.setenv("ENDS", how)
        return main([*arguments, "--trust", "--set", block, *changes])

    yield call
    os.environ.pop("ENDS", None)
