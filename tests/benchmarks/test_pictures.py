"""The pages' pictures, taken of short flights."""

import numpy as np
import pytest
from PIL import Image

from benchmarks import pictures
from benchmarks.__main__ import main


@pytest.mark.nightly("browsers")
@pytest.mark.usefixtures("needs_browser")
def test_the_pictures_show_both_runs_moving(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "SPAN", (7.0, 7.3))
    monkeypatch.setattr(pictures, "FLIGHT", (0.0, 1.0))
    monkeypatch.setattr(pictures, "TURN", 2.0)
    assert main(["pictures", "--out", str(tmp_path)]) == 0
    frames = []
    with Image.open(tmp_path / "line.gif") as animation:
        for index in (0, animation.n_frames - 1):
            animation.seek(index)
            frames.append(np.asarray(animation.convert("RGB")).astype(int))
    first, last = (np.array_split(frame, 2, axis=1) for frame in frames)
    for before, after in zip(first, last, strict=True):
        assert (np.abs(before - after).max(axis=2) > 60).sum() > 100
    reds = [((half[..., 0] > 190) & (half[..., 1:] < 150).all(axis=2)).sum() for half in first]
    assert reds[0] > 2 * reds[1]  # marks of carriers that are too slow
    for name in ("line", "real_scale", "aircraft", "aircraft_check"):
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
