"""The README's pictures, taken in small."""

import numpy as np
import pytest
from PIL import Image

from benchmarks import pictures
from benchmarks.__main__ import main


@pytest.mark.nightly("browsers")
@pytest.mark.usefixtures("needs_browser")
def test_the_pictures_show_both_runs_moving(tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "_SPAN", (7.0, 7.5))
    monkeypatch.setattr(pictures, "_STILL_TIME", 7.2)
    monkeypatch.setattr(pictures, "_FLIGHT", (0.0, 1.0))
    monkeypatch.setattr(pictures, "_TURN", 2)
    assert main(["pictures", "--out", str(tmp_path)]) == 0
    with Image.open(tmp_path / "line.png") as picture:
        still = np.asarray(picture.convert("RGB")).astype(int)
    left, right = np.array_split(still, 2, axis=1)
    reds = [(half[..., 0] > 190) & (half[..., 1:] < 150).all(axis=2) for half in (left, right)]
    assert reds[0].sum() > 300 > 10 * reds[1].sum()  # marks of carriers that are too slow
    frames = []
    with Image.open(tmp_path / "line.gif") as animation:
        assert animation.n_frames == 6
        for index in (0, 5):
            animation.seek(index)
            frames.append(np.asarray(animation.convert("RGB")).astype(int))
    for half in np.array_split(np.abs(frames[0] - frames[1]).max(axis=2), 2, axis=1):
        assert (half > 60).sum() > 200
    with Image.open(tmp_path / "aircraft.png") as picture:
        flying = np.asarray(picture.convert("RGB")).astype(int)
    green = (flying[..., 1] > 120) & (flying[..., 1] > flying[..., 0] + 60)  # far from stall
    assert green[:, : green.shape[1] // 2].sum() > 20
    assert (tmp_path / "aircraft_check.png").stat().st_size > 10_000
