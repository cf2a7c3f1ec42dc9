"""Commands with a block of a user's own that has a fault."""

import pytest

SHORT = ["simulation_duration=0.05", "optimization_layer=ConstantParameters"]


@pytest.fixture
def faulty(monkeypatch):
    """Runs a command whose block has a fault, see `faulty_blocks`; returns the exit code."""
    from drake_nonstop.cli.main import main

    def call(fault, *arguments, changes=SHORT, box="load_disturbance"):
        with monkeypatch.context() as patch:
            patch.setenv("FAULT", fault)
            block = f"{box}=!faulty_blocks.FaultyWind {{}}"
            return main([*arguments, "--trust", "--set", block, *changes])

    return call
