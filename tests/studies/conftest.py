"""Blocks with faults, for studies of runs that do not complete."""

import sys

import pytest

# A wind with the faults that a block can have.
FAULTY = """
import os
import sys
from dataclasses import dataclass

import numpy as np
from pydrake.systems.framework import LeafSystem


@dataclass(kw_only=True)
class FaultyWindConfig:
    force: float = 0.0
    fault: str = "none"
    seed: int = 0


class FaultyWind(LeafSystem):
    def __init__(self, model, config):
        super().__init__()
        if config.fault == "constructor":
            raise ValueError("no such wind")
        if config.fault == "constructor exits":
            sys.exit(0)
        self.config = config
        self.DeclareVectorOutputPort("disturbance_wrench", 6, self.calc)

    def calc(self, context, output):
        late = context.get_time() > 0.05
        if late and self.config.fault == "raises":
            raise ValueError("the wind broke")
        if late and self.config.fault == "tells threads":
            raise ValueError(f"threads: {os.environ['OPENBLAS_NUM_THREADS']}")
        if late and self.config.fault == "dies":
            os._exit(9)
        if late and self.config.fault == "exits":
            sys.exit(0)
        if late and self.config.fault == "interrupts":
            raise KeyboardInterrupt
        while late and self.config.fault == "hangs":
            pass
        value = np.nan if late and self.config.fault == "diverges" else self.config.force
        output.SetFromVector([0, 0, 0, 0, value, 0])
"""


@pytest.fixture(scope="session")
def faulty_blocks(tmp_path_factory):
    """A folder with the module faulty_blocks, which other processes can import, too."""
    folder = tmp_path_factory.mktemp("blocks")
    (folder / "faulty_blocks.py").write_text(FAULTY)
    sys.path.append(str(folder))
    yield folder
    sys.path.remove(str(folder))
